// Takes job files that are dropped on the page or chosen, and shows the server's errors at their lines.

import { Problem, messageOf, request } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { showDialog } from '/ui/parts/dialog.js';
import { counted, size } from '/ui/parts/format.js';
import { toast } from '/ui/parts/toast.js';
import { session } from '/ui/session.js';

/** @typedef {import('/ui/types.js').Job} Job */

/** Lines around an error that are shown. */
const CONTEXT = 2;
const MOST_ERRORS = 20;
const LINE_LETTERS = 160;

/** Largest job file that a server takes. */
const LARGEST_BYTES = 32 << 20;

/**
 * Submits a job file; shows what is wrong with it.
 * @param {string} name Name of the file, for messages.
 * @param {string | Blob} content A blob is sent as it is, so that the server sees bytes that are no text.
 * @returns {Promise<Job | null>}
 */
export async function submitJob(name, content) {
  if (content instanceof Blob && content.size > LARGEST_BYTES) {
    toast(`${name} was not submitted: it has ${size(content.size)}, and a job file has at most 32 MiB.`, { kind: 'error' });
    return null;
  }
  try {
    const headers = { 'idempotency-key': crypto.randomUUID?.() ?? `page-${Date.now()}-${Math.random()}` };
    const response = await request('/v1/jobs', { method: 'POST', body: content, headers });
    return await response.json();
  } catch (error) {
    if (error instanceof Problem && error.errors.length > 0) await showErrors(name, typeof content === 'string' ? content : await content.text(), error);
    else toast(`${name} was not submitted: ${messageOf(error)}`, { kind: 'error' });
    return null;
  }
}

/**
 * @param {string} name
 * @param {string} text
 * @param {Problem} problem
 */
async function showErrors(name, text, problem) {
  const lines = text.split('\n');
  const shown = problem.errors.slice(0, MOST_ERRORS);
  await showDialog({
    title: `${name} has ${counted(problem.errors.length, 'error')}`,
    body: [
      h('p', { class: 'muted' }, 'Nothing was submitted. Each error is shown at its line of the file.'),
      ...shown.map((fault) => h('div', { class: 'fault' }, h('p', {}, fault.message), excerpt(lines, fault))),
      shown.length < problem.errors.length ? h('p', { class: 'muted' }, `… and ${problem.errors.length - shown.length} more.`) : '',
    ],
    cancel: 'Close',
    wide: true,
  });
}

/**
 * The lines around an error.
 * @param {string[]} lines
 * @param {{line: number, column: number, pointer?: string}} fault
 */
export function excerpt(lines, fault) {
  const first = Math.max(1, fault.line - CONTEXT);
  const last = Math.min(lines.length, fault.line + CONTEXT);
  const rows = [];
  for (let number = first; number <= last; number += 1) {
    const line = (lines[number - 1] ?? '').slice(0, LINE_LETTERS);
    rows.push(h('div', { class: number === fault.line ? 'code-line wrong' : 'code-line' }, h('span', { class: 'line-number' }, number), h('code', {}, line || ' ')));
  }
  return h('div', { class: 'excerpt', role: 'group', 'aria-label': `Line ${fault.line}, column ${fault.column}` }, ...rows);
}

/**
 * Submits files one after the other.
 * @param {Iterable<File>} files
 * @param {(job: Job) => void} submitted
 */
export async function submitFiles(files, submitted) {
  for (const file of files) {
    const job = await submitJob(file.name, file);
    if (job === null) continue;
    submitted(job);
    toast(`Submitted ${job.name}`, { action: { label: 'Open', run: () => (location.hash = `#/jobs/${job.id}`) } });
  }
}

/**
 * Lets files be dropped on a room.
 * @param {import('/ui/parts/room.js').Room} room
 * @param {(job: Job) => void} submitted
 */
export function acceptFiles(room, submitted) {
  const veil = h('div', { class: 'drop-veil', hidden: true }, h('p', {}, 'Drop job files to submit them'));
  room.append(veil);
  let depth = 0;
  const hasFiles = (/** @type {DragEvent} */ event) => session.maySubmit && (event.dataTransfer?.types.includes('Files') ?? false);
  const show = (/** @type {number} */ change) => {
    depth = Math.max(0, depth + change);
    veil.hidden = depth === 0;
  };
  room.listen(window, 'dragenter', (event) => hasFiles(event) && (event.preventDefault(), show(1)));
  room.listen(window, 'dragleave', (event) => hasFiles(event) && show(-1));
  room.listen(window, 'dragover', (event) => hasFiles(event) && event.preventDefault());
  room.listen(window, 'drop', (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    show(-depth);
    void submitFiles([...event.dataTransfer.files], submitted);
  });
}
