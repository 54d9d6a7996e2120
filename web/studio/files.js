// Job files on the person's disk.

import { toast } from '/ui/parts/toast.js';
import { shortened, size } from '/ui/parts/format.js';
import { h } from '/ui/parts/dom.js';

/** @typedef {import('./studio.js').Studio} Studio */

/** Largest job file that a server takes. */
export const MAX_FILE_BYTES = 32 << 20;

/**
 * Lets a person choose a file, and opens it as a new draft.
 * @param {Studio} studio
 */
export function openFile(studio) {
  const field = h('input', { type: 'file', accept: '.json,.jsonc,application/json' });
  field.addEventListener('change', () => {
    const [file] = field.files ?? [];
    if (file !== undefined) void readFile(studio, file);
  });
  field.click();
}

/**
 * Opens a file as a new draft. It need not be a valid job: the editor says what is wrong with it.
 * @param {Studio} studio
 * @param {File} file
 */
export async function readFile(studio, file) {
  if (file.size > MAX_FILE_BYTES) {
    toast(`${file.name} has ${size(file.size)}, but a job file has up to 32 MiB: write equal shapes as copies or scatter.`, { kind: 'error' });
    return;
  }
  try {
    const text = new TextDecoder('utf-8', { fatal: true }).decode(await file.arrayBuffer());
    if (text.includes('\0')) throw new TypeError('it has zero bytes');
    studio.openText(text);
  } catch {
    toast(`${file.name} is not a text in UTF-8: choose a job file.`, { kind: 'error' });
  }
}

/**
 * Saves the text as a file named after the job.
 * @param {Studio} studio
 */
export function saveFile(studio) {
  const address = URL.createObjectURL(new Blob([studio.editor.text], { type: 'application/json' }));
  h('a', { href: address, download: `${fileName(studio.drafts.current.name)}.json` }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/**
 * A job's name as a file's name.
 * @param {string} name
 */
export function fileName(name) {
  const safe = shortened(name).normalize().replace(/[\u0000-\u001f\u007f"*/:<>?\\|]+/g, '-').replace(/^[.\s-]+|[.\s-]+$/g, '');
  return safe.slice(0, 100) || 'job';
}

/**
 * Opens files that are dropped on an element.
 * @param {HTMLElement} element
 * @param {Studio} studio
 */
export function takeDrops(element, studio) {
  const isFile = (/** @type {DragEvent} */ event) => event.dataTransfer?.types.includes('Files') ?? false;
  element.addEventListener('dragover', (event) => {
    if (isFile(event)) event.preventDefault();
  });
  element.addEventListener(
    'drop',
    (event) => {
      const [file] = event.dataTransfer?.files ?? [];
      if (file === undefined) return;
      event.preventDefault();
      event.stopPropagation();
      void readFile(studio, file);
    },
    { capture: true },
  );
}
