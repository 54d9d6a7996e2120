// The audit log: who changed what, newest first.

import { getJson, messageOf } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { dateTime, shortId } from '/ui/parts/format.js';

/** @typedef {import('/ui/types.js').AuditEntry} AuditEntry */

const PAGE = 50;

/** The log's panel, for administrators. */
export class Audit {
  /** @type {string | null} */
  #cursor = null;

  /** @param {AbortSignal} signal */
  constructor(signal) {
    this.signal = signal;
    this.rows = h('tbody');
    this.more = h('button', { type: 'button', class: 'button', hidden: true, on: { click: () => void this.#readMore() } }, 'Load more');
    this.note = h('p', { class: 'empty-line', hidden: true });
    this.table = h(
      'table',
      { class: 'audit' },
      h('caption', { class: 'visually-hidden' }, 'Audit log, newest first'),
      h('thead', {}, h('tr', {}, ...['Time', 'Who', 'Change', 'Answer', 'From'].map((title) => h('th', { scope: 'col' }, title)))),
      this.rows,
    );
    this.element = h('section', { class: 'panel' }, h('div', { class: 'panel-head' }, h('h2', {}, 'Audit log'), this.more), this.note, h('div', { class: 'scroll-x table-tall', tabindex: 0, role: 'region', 'aria-label': 'Audit log' }, this.table));
  }

  async read() {
    this.#cursor = null;
    await this.#page(true);
  }

  #readMore() {
    return this.#page(false);
  }

  /** @param {boolean} isFirst */
  async #page(isFirst) {
    try {
      const page = await getJson('/v1/audit', { query: { limit: PAGE, cursor: isFirst ? null : this.#cursor }, signal: this.signal });
      this.#cursor = page.next_cursor;
      this.more.hidden = page.next_cursor === null;
      const rows = page.entries.map(row);
      if (isFirst) this.rows.replaceChildren(...rows);
      else this.rows.append(...rows);
      const isEmpty = this.rows.children.length === 0;
      this.note.hidden = !isEmpty;
      this.note.textContent = isEmpty ? 'Nothing has been changed yet.' : '';
      this.table.hidden = isEmpty;
    } catch (error) {
      if (this.signal.aborted) return;
      this.note.hidden = false;
      this.note.textContent = messageOf(error);
    }
  }
}

/** @param {AuditEntry} entry */
function row(entry) {
  const isRefused = entry.status >= 400;
  return h(
    'tr',
    {},
    h('td', { class: 'nowrap muted' }, dateTime(entry.at)),
    h('td', {}, entry.who),
    h('td', {}, h('span', { class: 'mono small' }, `${entry.method} ${entry.route}`), entry.job ? h('a', { href: `#/jobs/${entry.job}`, class: 'mono small job-link' }, shortId(entry.job)) : null),
    h('td', { class: isRefused ? 'failed-text nowrap' : 'nowrap' }, `${entry.status}${entry.code ? ` ${entry.code}` : ''}${entry.times > 1 ? ` × ${entry.times}` : ''}`),
    h('td', { class: 'muted mono small' }, entry.address),
  );
}
