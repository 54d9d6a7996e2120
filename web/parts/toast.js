// Short messages at the edge of the page.

import { isAbort, messageOf } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';

const SHOWN_MS = 6000;
const MOST = 4;

/**
 * Shows a message for some seconds; an error stays until it is closed.
 * @param {string} text
 * @param {{kind?: 'done' | 'error', action?: {label: string, run: () => void}}} [options]
 */
export function toast(text, { kind = 'done', action } = {}) {
  const list = document.getElementById('toasts');
  if (list === null) return;
  const close = () => item.remove();
  const item = h(
    'div',
    { class: `toast ${kind}` },
    icon(kind === 'error' ? 'warning' : 'check'),
    h('span', {}, text),
    action && h('button', { type: 'button', class: 'link', on: { click: () => (close(), action.run()) } }, action.label),
    h('button', { type: 'button', class: 'ghost', 'aria-label': 'Close the message', on: { click: close } }, icon('cross', 14)),
  );
  list.append(item);
  while (list.children.length > MOST) list.firstElementChild?.remove();
  if (kind === 'done') setTimeout(close, SHOWN_MS);
}

/**
 * Shows why something could not be done; says nothing of what was aborted.
 * @param {string} what
 * @param {unknown} error
 */
export function toastError(what, error) {
  if (!isAbort(error)) toast(`${what}: ${messageOf(error)}`, { kind: 'error' });
}
