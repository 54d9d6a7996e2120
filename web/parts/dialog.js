// Dialogs: modal, closed by Escape, and the focus returns to where it was.

import { h } from '/ui/parts/dom.js';

let titles = 0;

/**
 * Shows a dialog; the promise has the button's value when it closes, or null.
 * @param {{title: string, body: (Node | string)[], actions?: {label: string, value: string, kind?: 'primary' | 'danger'}[], cancel?: string | null, wide?: boolean, onOpen?: (dialog: HTMLDialogElement) => void, before?: (value: string) => Promise<boolean> | boolean}} options
 *   `before` may keep the dialog open by returning false.
 * @returns {Promise<string | null>}
 */
export function showDialog({ title, body, actions = [], cancel = 'Cancel', wide = false, onOpen, before }) {
  titles += 1;
  const id = `dialog-${titles}`;
  const last = document.activeElement;
  const { promise, resolve } = withResolvers();
  const form = h('form', { method: 'dialog', on: { submit: (event) => void submit(event) } });
  const dialog = h('dialog', { 'aria-labelledby': id, class: wide ? 'wide' : false }, form);
  const buttons = actions.map(({ label, value, kind }) => h('button', { type: 'submit', value, class: `button ${kind ?? ''}` }, label));
  const cancelButton = cancel === null ? null : h('button', { type: 'button', class: 'button', on: { click: () => dialog.close() } }, cancel);
  const first = buttons[0];

  /** @param {SubmitEvent} event */
  async function submit(event) {
    event.preventDefault();
    const button = event.submitter instanceof HTMLButtonElement ? event.submitter : first;
    const value = button?.value ?? '';
    if (before) {
      buttons.forEach((each) => (each.disabled = true));
      const isDone = await before(value);
      buttons.forEach((each) => (each.disabled = false));
      if (!isDone) return;
    }
    dialog.close(value);
  }

  form.append(
    h('h2', { id }, title),
    h('div', { class: 'dialog-body' }, ...body),
    h('div', { class: 'dialog-actions' }, cancelButton, ...buttons),
  );
  dialog.addEventListener('close', () => {
    dialog.remove();
    if (last instanceof HTMLElement && last.isConnected) last.focus();
    resolve(dialog.returnValue === '' ? null : dialog.returnValue);
  });
  // A press outside closes it, as Escape does.
  dialog.addEventListener('pointerdown', (event) => {
    const { left, right, top, bottom } = dialog.getBoundingClientRect();
    const isOutside = event.clientX < left || event.clientX > right || event.clientY < top || event.clientY > bottom;
    if (event.target === dialog && isOutside && cancel !== null) dialog.close();
  });
  document.body.append(dialog);
  dialog.showModal();
  onOpen?.(dialog);
  return promise;
}

/**
 * Asks before something is lost.
 * @param {{title: string, body: (Node | string)[], action: string, isDanger?: boolean}} options
 */
export async function confirm({ title, body, action, isDanger = true }) {
  const value = await showDialog({
    title,
    body,
    actions: [{ label: action, value: 'yes', kind: isDanger ? 'danger' : 'primary' }],
    onOpen: (dialog) => {
      // The safe answer has the focus.
      const cancel = dialog.querySelector('.dialog-actions .button');
      if (cancel instanceof HTMLElement) cancel.focus();
    },
  });
  return value === 'yes';
}

/** @returns {{promise: Promise<string | null>, resolve: (value: string | null) => void}} */
function withResolvers() {
  /** @type {(value: string | null) => void} */
  let resolve = () => {};
  const promise = /** @type {Promise<string | null>} */ (new Promise((done) => (resolve = done)));
  return { promise, resolve };
}
