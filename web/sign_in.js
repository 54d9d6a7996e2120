// Asks for a key when the farm needs one.

import { Problem, messageOf, readCaller } from '/ui/api.js';
import { farmEvents } from '/ui/events.js';
import { h } from '/ui/parts/dom.js';
import { showDialog } from '/ui/parts/dialog.js';
import { session } from '/ui/session.js';

let isOpen = false;

/**
 * Shows the dialog until a key is accepted, or it is closed.
 * @param {string} [reason]
 */
export async function askForKey(reason = '') {
  if (isOpen) return;
  isOpen = true;
  const before = session.key;
  const message = h('p', { class: 'field-error', role: 'alert' }, reason);
  const input = h('input', { type: 'password', id: 'key', autocomplete: 'off', spellcheck: 'false', autocapitalize: 'off', placeholder: 'sdf_…', required: true });
  const keep = h('input', { type: 'checkbox', id: 'keep-key' });
  const chosen = await showDialog({
    title: 'This farm needs a key',
    body: [
      h('p', {}, 'An administrator of the farm creates keys, in the room Farm or with ', h('code', {}, 'sdfarm key new'), '. The key is kept in the memory of this tab, and sent to this farm alone.'),
      h('label', { for: 'key' }, 'Key'),
      input,
      h('label', { class: 'check', for: 'keep-key' }, keep, 'Keep it until this tab is closed, so that a reload does not ask again'),
      message,
    ],
    actions: [{ label: 'Sign in', value: 'in', kind: 'primary' }],
    cancel: session.caller?.name == null ? null : 'Cancel',
    onOpen: () => input.focus(),
    before: async () => {
      const key = input.value.trim();
      if (!/^[\x21-\x7e]+$/.test(key)) {
        message.textContent = 'A key is sdf_ and 43 characters.';
        input.focus();
        return false;
      }
      session.signIn(key, keep.checked);
      try {
        await readCaller();
        return true;
      } catch (error) {
        message.textContent = messageOf(error);
        input.focus();
        input.select();
        return false;
      }
    },
  });
  isOpen = false;
  if (chosen === null) {
    // The old key stays, as if nothing had been asked.
    if (before !== null && session.key !== before) session.signIn(before, false);
    return;
  }
  farmEvents.start();
  document.dispatchEvent(new Event('signedin'));
}

// A key that is refused while the page is used has been revoked, or has expired.
session.addEventListener('refused', (event) => {
  const problem = /** @type {CustomEvent} */ (event).detail;
  if (problem instanceof Problem && session.caller !== null && !isOpen) void askForKey(session.key === null ? '' : messageOf(problem));
});
