// The workers: what they hold, how fast they are, what went wrong; drain, quarantine and release; the pool's size.

import { Problem, getJson, messageOf, send } from '/ui/api.js';
import { confirm } from '/ui/parts/dialog.js';
import { h, setText } from '/ui/parts/dom.js';
import { ago, count, counted, dateTime, short, shortId } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { openMenu } from '/ui/parts/menu.js';
import { toast, toastError } from '/ui/parts/toast.js';
import { session } from '/ui/session.js';

/** @typedef {import('/ui/types.js').Worker} Worker */

const MOST_POOL = 256;
/** Workers that are listed; the rest is counted. */
const LISTED = 200;

/** @param {Worker} worker */
function stateOf(worker) {
  if (worker.quarantined || worker.state === 'quarantined') return { text: 'quarantined', kind: 'failed' };
  if (worker.draining || worker.state === 'draining') return { text: 'draining', kind: 'paused' };
  if (worker.state === 'starting') return { text: 'starting', kind: 'queued' };
  return worker.leases > 0 ? { text: 'rendering', kind: 'running' } : { text: 'ready', kind: 'succeeded' };
}

/** The workers' panel. */
export class Workers {
  /** @type {number | null} The number that the pool should have. */
  #target = null;
  #isSetting = false;

  /** @param {AbortSignal} signal */
  constructor(signal) {
    this.signal = signal;
    this.summary = h('span', { class: 'muted' });
    this.poolNumber = h('output', { class: 'pool-number', 'aria-label': 'Workers of this machine' });
    const step = (/** @type {number} */ by, /** @type {string} */ label, /** @type {'plus' | 'minus'} */ name) => h('button', { type: 'button', class: 'button icon-only', 'aria-label': label, title: label, on: { click: () => void this.resize(by) } }, icon(name));
    this.minus = step(-1, 'One worker fewer on this machine', 'minus');
    this.plus = step(1, 'One more worker on this machine', 'plus');
    this.pool = h('div', { class: 'pool', role: 'group', 'aria-label': 'Workers on the server’s machine', hidden: true }, h('span', { class: 'muted' }, 'This machine'), this.minus, this.poolNumber, this.plus);
    this.body = h('tbody');
    this.table = h(
      'table',
      { class: 'workers' },
      h('caption', { class: 'visually-hidden' }, 'Workers'),
      h('thead', {}, h('tr', {}, ...['Worker', 'State', 'Holds', 'Rays/s', 'Since', 'Last seen', 'Errors', ''].map((title) => h('th', { scope: 'col', class: title === 'Rays/s' || title === 'Errors' ? 'number' : false }, title === '' ? h('span', { class: 'visually-hidden' }, 'Actions') : title)))),
      this.body,
    );
    this.holder = h('div', { class: 'scroll-x' }, this.table);
    this.note = h('p', { class: 'empty-line', hidden: true });
    this.element = h('section', { class: 'panel' }, h('div', { class: 'panel-head' }, h('h2', {}, 'Workers'), this.summary, this.pool), this.note, this.holder);
  }

  async read() {
    try {
      const [list, pool] = await Promise.all([getJson('/v1/workers', { signal: this.signal }), getJson('/v1/pool', { signal: this.signal })]);
      this.#show(list.workers);
      if (!this.#isSetting) this.#showPool(pool.workers);
    } catch (error) {
      if (this.signal.aborted) return;
      this.#say(messageOf(error));
    }
  }

  /** @param {string} text */
  #say(text) {
    setText(this.note, text);
    this.note.hidden = text === '';
    this.holder.hidden = text !== '';
  }

  /** @param {number} number */
  #showPool(number) {
    this.#target = number;
    this.pool.hidden = false;
    setText(this.poolNumber, count(number));
    this.minus.hidden = !session.mayAdminister;
    this.plus.hidden = !session.mayAdminister;
    this.minus.disabled = number <= 0;
    this.plus.disabled = number >= MOST_POOL;
  }

  /**
   * Changes the number of the server's own workers.
   * @param {number} by
   */
  async resize(by) {
    if (this.#target === null || !session.mayAdminister) return;
    const workers = Math.max(0, Math.min(MOST_POOL, this.#target + by));
    if (workers === 0 && this.#target > 0) {
      const isMeant = await confirm({ title: 'Stop the last worker of this machine?', body: [h('p', {}, 'Jobs wait until there is a worker again. Its tiles are finished or handed back; nothing is lost.')], action: 'Stop it' });
      if (!isMeant) return;
    }
    this.#isSetting = true;
    this.#showPool(workers);
    try {
      const pool = await send('PUT', '/v1/pool', { json: { workers } });
      this.#showPool(pool.workers);
    } catch (error) {
      toastError('The number of workers could not be changed', error);
    }
    this.#isSetting = false;
    await this.read();
  }

  /** @param {Worker[]} workers */
  #show(workers) {
    const ready = workers.filter((worker) => worker.state === 'ready' && !worker.quarantined && !worker.draining);
    const speed = ready.reduce((sum, worker) => sum + (worker.rays_per_second ?? 0), 0);
    setText(this.summary, workers.length === 0 ? '' : `${count(ready.length)} of ${count(workers.length)} ready${speed > 0 ? `, ${short(speed)} rays/s together` : ''}`);
    this.#say(workers.length === 0 ? 'No worker is connected. Add one on this machine with +, or start one elsewhere: sdfarm worker --server ' + location.origin : '');
    const focused = document.activeElement instanceof HTMLElement && this.body.contains(document.activeElement) ? document.activeElement.closest('tr')?.dataset['worker'] : undefined;
    const sorted = [...workers].sort((a, b) => a.name.localeCompare(b.name, 'en', { numeric: true }) || (a.id < b.id ? -1 : 1));
    this.body.replaceChildren(...sorted.slice(0, LISTED).map((worker) => this.#row(worker)));
    if (sorted.length > LISTED) this.body.append(h('tr', {}, h('td', { colspan: 8, class: 'muted' }, `and ${counted(sorted.length - LISTED, 'more worker')}`)));
    const again = focused === undefined ? null : this.body.querySelector(`[data-worker="${CSS.escape(focused)}"] button`);
    if (again instanceof HTMLElement) again.focus();
  }

  /** @param {Worker} worker */
  #row(worker) {
    const state = stateOf(worker);
    const holds = worker.holds ?? [];
    const held =
      holds.length > 0
        ? holds.slice(0, 3).map((hold) => h('div', { class: 'ellipsis' }, h('a', { href: `#/jobs/${hold.job}${hold.frame > 0 ? `?frame=${hold.frame}` : ''}` }, hold.name), h('span', { class: 'muted' }, ` frame ${hold.frame}, ${counted(hold.tiles, 'tile')}`)))
        : [worker.leases > 0 ? counted(worker.leases, 'lease') : h('span', { class: 'muted' }, 'nothing')];
    const errors = worker.errors ?? 0;
    const actions = session.mayAdminister && worker.quarantined !== undefined ? h('button', { type: 'button', class: 'ghost', 'aria-haspopup': 'menu', 'aria-expanded': 'false', 'aria-label': `Actions for ${worker.name}`, on: { click: (event) => this.#openMenu(worker, event.currentTarget) } }, icon('more')) : null;
    return h(
      'tr',
      { 'data-worker': worker.id },
      h('td', {}, h('b', { class: 'worker-name' }, worker.name), h('div', { class: 'muted small' }, `${worker.device}${worker.pool === true ? ', this machine' : ''} · `, h('span', { class: 'mono' }, shortId(worker.id)))),
      h('td', {}, h('span', { class: `state ${state.kind}` }, state.text)),
      h('td', { class: 'holds' }, ...held),
      h('td', { class: 'number nowrap' }, worker.rays_per_second === null ? '–' : short(worker.rays_per_second)),
      h('td', { class: 'nowrap muted', title: worker.registered_at ? dateTime(worker.registered_at) : false }, worker.registered_at ? ago(worker.registered_at) : '–'),
      h('td', { class: 'nowrap muted', title: worker.last_seen_at ? dateTime(worker.last_seen_at) : false }, worker.last_seen_at ? ago(worker.last_seen_at) : '–'),
      h('td', { class: 'number' }, errors === 0 ? h('span', { class: 'muted' }, '0') : h('span', { class: 'state failed', title: worker.last_error ?? false }, count(errors)), worker.last_error ? h('div', { class: 'muted small last-error' }, worker.last_error) : null),
      h('td', { class: 'number' }, actions),
    );
  }

  /**
   * @param {Worker} worker
   * @param {HTMLElement} anchor
   */
  #openMenu(worker, anchor) {
    const isQuarantined = worker.quarantined === true;
    openMenu(anchor, [
      { label: 'Drain', icon: 'down', isDisabled: worker.draining === true, run: () => void this.#change(worker, 'drain') },
      isQuarantined ? { label: 'Release', icon: 'play', run: () => void this.#change(worker, 'release') } : { label: 'Quarantine', icon: 'pause', run: () => void this.#change(worker, 'quarantine') },
    ]);
  }

  /**
   * @param {Worker} worker
   * @param {'drain' | 'quarantine' | 'release'} action
   */
  async #change(worker, action) {
    const texts = {
      drain: { title: `Drain ${worker.name}?`, body: `It finishes its tiles, takes no more, and exits.${worker.pool ? ' The server starts another in its place, unless the pool is made smaller.' : ''}`, action: 'Drain it', done: `${worker.name} is draining` },
      quarantine: { title: `Quarantine ${worker.name}?`, body: 'It takes no more work, and stays connected until it is released.', action: 'Quarantine it', done: `${worker.name} is in quarantine` },
      release: { title: '', body: '', action: '', done: `${worker.name} takes work again` },
    };
    const text = texts[action];
    if (action !== 'release' && !(await confirm({ title: text.title, body: [h('p', {}, text.body)], action: text.action, isDanger: false }))) return;
    try {
      await send('POST', `/v1/workers/${worker.id}/${action}`);
      toast(text.done);
    } catch (error) {
      const isGone = error instanceof Problem && error.status === 404 && !error.isUnknownRoute;
      toastError(isGone ? `${worker.name} has ended` : text.action || 'Release', error);
    }
    await this.read();
  }
}
