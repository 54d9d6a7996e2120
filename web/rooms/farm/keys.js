// Keys: created, shown once, revoked.

import { getJson, messageOf, send } from '/ui/api.js';
import { confirm, showDialog } from '/ui/parts/dialog.js';
import { h, setText } from '/ui/parts/dom.js';
import { ago, dateTime } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { toast, toastError } from '/ui/parts/toast.js';
import { copy } from '/ui/rooms/job/share.js';
import { session } from '/ui/session.js';

/** @typedef {import('/ui/types.js').Key} Key */

const SCOPES = [
  { name: 'submit', text: 'submit jobs, and see and change jobs of its own name' },
  { name: 'read', text: 'see every job, the workers and the history' },
  { name: 'worker', text: 'render: for sdfarm worker on other machines' },
  { name: 'admin', text: 'everything, keys and the audit log included' },
];
const DAY = 86_400;

/** The keys' panel, for administrators. */
export class Keys {
  /** @param {AbortSignal} signal */
  constructor(signal) {
    this.signal = signal;
    this.create = h('button', { type: 'button', class: 'button', on: { click: () => void this.#create() } }, icon('plus'), 'New key');
    this.all = h('input', { type: 'checkbox', on: { change: () => void this.read() } });
    this.body = h('div', { class: 'scroll-x' });
    this.element = h('section', { class: 'panel' }, h('div', { class: 'panel-head' }, h('h2', {}, 'Keys'), h('label', { class: 'check muted' }, this.all, 'Revoked and expired too'), this.create), this.body);
  }

  async read() {
    this.create.hidden = !session.mayAdminister;
    try {
      const answer = await getJson('/v1/keys', { signal: this.signal });
      this.#show(answer.keys);
    } catch (error) {
      if (!this.signal.aborted) this.body.replaceChildren(h('p', { class: 'empty-line' }, messageOf(error)));
    }
  }

  /** @param {Key[]} keys */
  #show(keys) {
    const shown = keys.filter((key) => this.all.checked || key.state === 'live');
    if (keys.length === 0) {
      this.body.replaceChildren(h('p', { class: 'empty-line' }, 'This farm has no keys: every program on this machine may use it. The first key, which must be an administrator’s, closes it to everyone without one.'));
      return;
    }
    this.body.replaceChildren(
      h(
        'table',
        {},
        h('caption', { class: 'visually-hidden' }, 'Keys'),
        h('thead', {}, h('tr', {}, ...['Name', 'Scopes', 'State', 'Created', 'Last used', 'Expires', ''].map((title) => h('th', { scope: 'col' }, title === '' ? h('span', { class: 'visually-hidden' }, 'Actions') : title)))),
        h('tbody', {}, ...shown.map((key) => this.#row(key))),
      ),
    );
  }

  /** @param {Key} key */
  #row(key) {
    const kind = key.state === 'live' ? 'succeeded' : 'cancelled';
    return h(
      'tr',
      {},
      h('td', {}, h('b', {}, key.name), h('div', { class: 'muted small mono' }, key.id)),
      h('td', {}, key.scopes.join(', ')),
      h('td', {}, h('span', { class: `state ${kind}` }, key.state)),
      h('td', { class: 'nowrap muted', title: dateTime(key.created_at) }, ago(key.created_at)),
      h('td', { class: 'nowrap muted', title: key.last_used_at ? dateTime(key.last_used_at) : false }, key.last_used_at ? ago(key.last_used_at) : 'never'),
      h('td', { class: 'nowrap muted' }, key.expires_at ? dateTime(key.expires_at) : 'never'),
      h('td', { class: 'number' }, key.state === 'live' && session.mayAdminister ? h('button', { type: 'button', class: 'button', on: { click: () => void this.#revoke(key) } }, 'Revoke') : null),
    );
  }

  async #create() {
    // Asked now, because the list may not be here yet: only a farm's first key is an administrator's unless chosen.
    let isFirst;
    try {
      isFirst = (await getJson('/v1/keys', { signal: this.signal })).keys.length === 0;
    } catch (error) {
      if (!this.signal.aborted) toastError('The keys could not be read', error);
      return;
    }
    const name = h('input', { type: 'text', id: 'key-name', required: true, maxlength: 64, pattern: '[A-Za-z0-9._\\-]+', autocomplete: 'off', spellcheck: 'false', placeholder: 'anna', title: 'Letters, digits, dots, dashes and underscores' });
    const boxes = SCOPES.map((scope) => h('input', { type: 'checkbox', value: scope.name, checked: scope.name === (isFirst ? 'admin' : 'submit') }));
    const expiry = h('select', { id: 'key-expiry' }, ...[['', 'Never'], [String(DAY), 'In a day'], [String(30 * DAY), 'In 30 days'], [String(90 * DAY), 'In 90 days'], [String(365 * DAY), 'In a year']].map(([value, label]) => h('option', { value }, label)));
    const message = h('p', { class: 'field-error', role: 'alert' });
    /** @type {{secret: string, key: Key} | null} */
    let issued = null;
    await showDialog({
      title: 'New key',
      body: [
        ...(isFirst ? [h('p', {}, 'It is the first key of this farm: from then on every request needs one, also on this machine. It must be an administrator’s.')] : []),
        h('label', { for: 'key-name' }, 'Name of its owner'),
        name,
        h('fieldset', { class: 'scopes' }, h('legend', {}, 'It may'), ...SCOPES.map((scope, index) => h('label', { class: 'check' }, /** @type {HTMLElement} */ (boxes[index]), h('span', {}, h('b', {}, scope.name), ` – ${scope.text}`)))),
        h('label', { for: 'key-expiry' }, 'Expires'),
        expiry,
        message,
      ],
      actions: [{ label: 'Create the key', value: 'create', kind: 'primary' }],
      onOpen: () => name.focus(),
      before: async () => {
        const scopes = boxes.filter((box) => box.checked).map((box) => box.value);
        if (scopes.length === 0) {
          setText(message, 'Choose the scopes of the key.');
          return false;
        }
        try {
          issued = await send('POST', '/v1/keys', { json: { name: name.value, scopes, ...(expiry.value === '' ? {} : { expires_in_seconds: Number(expiry.value) }) } });
          return true;
        } catch (error) {
          setText(message, messageOf(error));
          return false;
        }
      },
    });
    if (issued !== null) await this.#showOnce(issued, isFirst);
    await this.read();
  }

  /**
   * @param {{secret: string, key: Key}} issued
   * @param {boolean} isFirst
   */
  async #showOnce({ secret, key }, isFirst) {
    const field = h('input', { type: 'text', readonly: true, value: secret, class: 'mono', 'aria-label': 'The key' });
    await showDialog({
      title: `The key of ${key.name}`,
      body: [
        h('p', {}, h('b', {}, 'It is shown only now.'), ' The farm stores a hash of it; if it is lost, revoke it and create another.'),
        field,
        h('p', { class: 'muted small' }, 'In a shell: ', h('code', {}, 'export SDFARM_KEY=…')),
        ...(isFirst ? [h('p', {}, 'This page goes on with this key, in the memory of this tab. Keep it: without it you are locked out.')] : []),
      ],
      actions: [{ label: 'Copy', value: 'copy', kind: 'primary' }],
      cancel: 'I have kept it',
      onOpen: () => field.select(),
      before: async () => {
        if (!(await copy(secret))) field.select();
        return false;
      },
    });
    // The farm is closed now, and this tab would be locked out.
    if (isFirst) {
      session.signIn(secret, false);
      document.dispatchEvent(new Event('keychange'));
    }
  }

  /** @param {Key} key */
  async #revoke(key) {
    const isMeant = await confirm({ title: `Revoke the key of ${key.name}?`, body: [h('p', {}, 'Requests with it are refused from now on, and its open ones are ended: workers that registered with it stop. Its jobs stay. This cannot be undone.'), h('p', { class: 'muted small mono' }, key.id)], action: 'Revoke it' });
    if (!isMeant) return;
    try {
      await send('DELETE', `/v1/keys/${key.id}`);
      toast(`Revoked the key of ${key.name}`);
    } catch (error) {
      toastError('The key could not be revoked', error);
    }
    await this.read();
  }
}
