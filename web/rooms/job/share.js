// Downloads of a job's pictures and file, and links that need no key.

import { address, getBlob, request, send } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { showDialog } from '/ui/parts/dialog.js';
import { dateTime } from '/ui/parts/format.js';
import { toast, toastError } from '/ui/parts/toast.js';
import { session } from '/ui/session.js';

/** Time until the address of saved bytes is revoked, in which the browser begins to save. */
const SAVED_MS = 60_000;

/**
 * Saves what a path returns as a file. Without a key the browser does it, so that no size is too large.
 * @param {string} path
 * @param {string} name
 * @param {import('/ui/api.js').Options['query']} [query]
 */
export async function download(path, name, query) {
  try {
    if (session.key === null) {
      // Asked first, so that an error is a message instead of a file; past the cache, whose entry would be locked until the end.
      const controller = new AbortController();
      await request(path, { ...(query ? { query } : {}), signal: controller.signal, cache: 'no-store', headers: { accept: '*/*' } });
      controller.abort();
      save(address(path, query), name);
      return;
    }
    const url = URL.createObjectURL(await getBlob(path, query ? { query } : {}));
    save(url, name);
    setTimeout(() => URL.revokeObjectURL(url), SAVED_MS);
  } catch (error) {
    toastError(`${name} could not be saved`, error);
  }
}

/**
 * @param {string} url
 * @param {string} name
 */
function save(url, name) {
  const link = h('a', { href: url, download: name, hidden: true });
  document.body.append(link);
  link.click();
  link.remove();
}

/**
 * A name without letters that file systems refuse.
 * @param {string} name
 */
export const fileName = (name) => name.replace(/[^\p{L}\p{N} ._-]+/gu, '-').slice(0, 100) || 'job';

/**
 * Puts a text into the clipboard; browsers refuse it on plain HTTP from another machine.
 * @param {string} text
 */
export async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    toast('Copied');
    return true;
  } catch {
    return false;
  }
}

/**
 * Creates a signed link to a frame and shows it.
 * @param {{id: string, name: string}} job
 * @param {number} frame
 * @param {boolean} isStored
 */
export async function share(job, frame, isStored) {
  const days = h('select', { id: 'link-days' }, ...[[1, 'a day'], [7, 'a week'], [30, '30 days'], [365, 'a year']].map(([value, label]) => h('option', { value, selected: value === 7 }, label)));
  const chosen = await showDialog({
    title: `Share ${job.name}`,
    body: [
      h('p', {}, isStored ? 'A link lets anyone who has it see this picture, without a key, until it expires.' : 'A link lets anyone who has it see the finished part of this picture, without a key, until it expires.'),
      h('label', { for: 'link-days' }, 'Valid for'),
      days,
    ],
    actions: [{ label: 'Create the link', value: 'make', kind: 'primary' }],
    onOpen: () => days.focus(),
  });
  if (chosen === null) return;
  try {
    const link = await send('POST', `/v1/jobs/${job.id}/frames/${frame}/link`, { json: { expires_in_seconds: Number(days.value) * 86_400, shows: isStored ? 'image' : 'preview' } });
    const url = new URL(link.url, location.href).href;
    const field = h('input', { type: 'text', readonly: true, value: url, 'aria-label': 'Link', class: 'mono' });
    await showDialog({
      title: 'The link',
      body: [field, h('p', { class: 'muted' }, link.expires_at ? `Valid until ${dateTime(link.expires_at)}.` : '')],
      actions: [{ label: 'Copy', value: 'copy', kind: 'primary' }],
      cancel: 'Close',
      onOpen: () => field.select(),
      before: async () => {
        const isCopied = await copy(url);
        if (!isCopied) field.select();
        return isCopied;
      },
    });
  } catch (error) {
    toastError('The link could not be created', error);
  }
}
