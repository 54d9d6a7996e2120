// The queue: unfinished jobs in the order in which they are rendered, moved by dragging, buttons or keys; and by submitter.

import { getJson, messageOf, send } from '/ui/api.js';
import { farmEvents } from '/ui/events.js';
import { h, oncePerFrame, setText } from '/ui/parts/dom.js';
import { count, counted, percent, timeLeft } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { toastError } from '/ui/parts/toast.js';
import { stateOf } from '/ui/rooms/jobs/list.js';
import { session } from '/ui/session.js';

/** @typedef {import('/ui/types.js').Job} Job */

const LISTED = 100;
const READ = 500;
/** Sorts jobs without a place last. */
const LAST = Number.MAX_SAFE_INTEGER;

/** @param {Job} job */
const isUnfinished = (job) => job.state === 'queued' || job.state === 'running';

/** The queue's panel. */
export class Queue {
  /** @type {Map<string, Job>} */
  #jobs = new Map();
  #view = /** @type {'place' | 'submitter'} */ ('place');
  #isMore = false;
  /** @type {string | null} */
  #dragged = null;

  /** @param {AbortSignal} signal */
  constructor(signal) {
    this.signal = signal;
    this.summary = h('span', { class: 'muted' });
    const choice = (/** @type {'place' | 'submitter'} */ view, /** @type {string} */ label) => h('button', { type: 'button', 'aria-pressed': String(view === this.#view), 'data-view': view, on: { click: () => this.#setView(view) } }, label);
    this.views = h('div', { class: 'segments', role: 'group', 'aria-label': 'Order of the queue' }, choice('place', 'By place'), choice('submitter', 'By submitter'));
    this.body = h('div', { class: 'queue-body' });
    this.element = h('section', { class: 'panel queue' }, h('div', { class: 'panel-head' }, h('h2', {}, 'Queue'), this.summary, this.views), this.body);
    this.draw = oncePerFrame(() => this.#draw());
    const take = (/** @type {Job} */ job) => {
      if (isUnfinished(job)) this.#jobs.set(job.id, job);
      else this.#jobs.delete(job.id);
      this.draw();
    };
    farmEvents.addEventListener('job', (event) => take(/** @type {CustomEvent<Job>} */ (event).detail), { signal });
    farmEvents.addEventListener('deleted', (event) => (this.#jobs.delete(/** @type {CustomEvent<string>} */ (event).detail), this.draw()), { signal });
  }

  async read() {
    try {
      const pages = await Promise.all(['running', 'queued'].map((state) => getJson('/v1/jobs', { query: { state, limit: READ }, signal: this.signal })));
      this.#jobs = new Map(pages.flatMap((page) => page.jobs).map((job) => [job.id, job]));
      this.#isMore = pages.some((page) => page.next_cursor !== null);
      this.draw();
    } catch (error) {
      if (!this.signal.aborted) this.body.replaceChildren(h('p', { class: 'empty-line' }, messageOf(error)));
    }
  }

  /** @param {'place' | 'submitter'} view */
  #setView(view) {
    this.#view = view;
    for (const button of this.views.children) button.setAttribute('aria-pressed', String(/** @type {HTMLElement} */ (button).dataset['view'] === view));
    this.draw();
  }

  #draw() {
    if (this.#dragged !== null) return;
    const jobs = [...this.#jobs.values()].sort((a, b) => (a.queue_position ?? LAST) - (b.queue_position ?? LAST) || b.priority - a.priority || (a.id < b.id ? -1 : 1));
    setText(this.summary, jobs.length === 0 ? '' : `${this.#isMore ? 'more than ' : ''}${counted(jobs.length, 'job')}`);
    if (jobs.length === 0) {
      this.body.replaceChildren(h('p', { class: 'empty-line' }, 'Nothing waits: every job is finished.'));
      return;
    }
    const focus = document.activeElement instanceof HTMLElement && this.body.contains(document.activeElement) ? [document.activeElement.closest('[data-job]')?.getAttribute('data-job'), document.activeElement.dataset['move']] : null;
    this.body.replaceChildren(this.#view === 'place' ? this.#places(jobs) : this.#submitters(jobs));
    if (focus) {
      const again = this.body.querySelector(`[data-job="${CSS.escape(focus[0] ?? '')}"] [data-move="${focus[1] ?? ''}"]`);
      if (again instanceof HTMLElement) again.focus();
    }
  }

  /** @param {Job[]} jobs */
  #places(jobs) {
    const shown = jobs.slice(0, LISTED);
    const items = shown.map((job, index) => this.#item(job, index, shown));
    const list = h('ol', { class: 'queue-list' }, ...items);
    if (jobs.length > shown.length) list.append(h('li', { class: 'muted empty-line' }, `and ${count(jobs.length - shown.length)} more`));
    return list;
  }

  /**
   * @param {Job} job
   * @param {number} index
   * @param {Job[]} jobs
   */
  #item(job, index, jobs) {
    const state = stateOf(job);
    const canMove = session.mayChange(job) && job.queue_position !== undefined;
    const move = (/** @type {string} */ name, /** @type {string} */ label, /** @type {import('/ui/parts/icons.js').IconName} */ shape, /** @type {object | null} */ target) =>
      h('button', { type: 'button', class: 'ghost', 'data-move': name, 'aria-label': `${label}: ${job.name}`, title: label, disabled: target === null, on: { click: () => target && void this.#move(job, target) } }, icon(shape));
    const [before, after] = [jobs[index - 1], jobs[index + 1]];
    const item = h(
      'li',
      { 'data-job': job.id, draggable: canMove ? 'true' : false },
      h('span', { class: 'place muted' }, job.queue_position ?? index + 1),
      h('span', { class: `state ${state}`, title: state }, h('span', { class: 'visually-hidden' }, state)),
      h('a', { href: `#/jobs/${job.id}`, class: 'ellipsis queue-name', draggable: 'false' }, job.name),
      h('span', { class: 'muted ellipsis queue-submitter' }, job.submitter),
      h('span', { class: 'muted nowrap queue-priority', title: 'Priority' }, job.priority === 0 ? '' : `${job.priority > 0 ? '+' : '−'}${Math.abs(job.priority)}`),
      h('span', { class: 'number nowrap' }, percent(job.progress)),
      h('span', { class: 'number nowrap muted queue-left' }, job.eta_seconds === null || job.paused ? '' : timeLeft(job.eta_seconds)),
      canMove ? h('span', { class: 'moves' }, move('first', 'To the front', 'top', index === 0 ? null : { first: true }), move('up', 'Up', 'up', before ? { before: before.id } : null), move('down', 'Down', 'down', after ? { after: after.id } : null)) : null,
    );
    if (canMove) this.#makeDraggable(item, job);
    return item;
  }

  /**
   * @param {HTMLElement} item
   * @param {Job} job
   */
  #makeDraggable(item, job) {
    item.addEventListener('dragstart', (event) => {
      this.#dragged = job.id;
      event.dataTransfer?.setData('text/plain', job.name);
      item.classList.add('dragged');
    });
    item.addEventListener('dragend', () => {
      this.#dragged = null;
      this.draw();
    });
    item.addEventListener('dragover', (event) => {
      if (this.#dragged === null || this.#dragged === job.id) return;
      event.preventDefault();
      const { top, height } = item.getBoundingClientRect();
      item.dataset['drop'] = event.clientY < top + height / 2 ? 'before' : 'after';
    });
    item.addEventListener('dragleave', () => delete item.dataset['drop']);
    item.addEventListener('drop', (event) => {
      event.preventDefault();
      const moved = this.#jobs.get(this.#dragged ?? '');
      const side = item.dataset['drop'];
      this.#dragged = null;
      if (moved) void this.#move(moved, side === 'after' ? { after: job.id } : { before: job.id });
    });
  }

  /**
   * @param {Job} job
   * @param {object} target
   */
  async #move(job, target) {
    try {
      await send('POST', `/v1/jobs/${job.id}/move`, { json: target });
    } catch (error) {
      toastError(`${job.name} could not be moved`, error);
    }
    await this.read();
  }

  /** @param {Job[]} jobs */
  #submitters(jobs) {
    const groups = [...Map.groupBy(jobs, (job) => job.submitter)];
    const rows = groups.map(([name, own]) => {
      const running = own.filter((job) => job.state === 'running').length;
      const priorities = own.map((job) => job.priority);
      const left = own.reduce((sum, job) => sum + job.tiles.total - job.tiles.done, 0);
      const [low, high] = [Math.min(...priorities), Math.max(...priorities)];
      return { name, running, queued: own.length - running, left, priority: low === high ? String(low) : `${low} to ${high}`, progress: own.reduce((sum, job) => sum + job.progress, 0) / own.length };
    });
    rows.sort((a, b) => b.left - a.left);
    const most = Math.max(1, ...rows.map((row) => row.left));
    return h(
      'div',
      { class: 'scroll-x' },
      h(
        'table',
        {},
        h('caption', { class: 'visually-hidden' }, 'Unfinished jobs by submitter'),
        h('thead', {}, h('tr', {}, ...['Submitter', 'Running', 'Queued', 'Priority', 'Tiles left'].map((title) => h('th', { scope: 'col', class: title === 'Submitter' || title === 'Tiles left' ? false : 'number' }, title)))),
        h('tbody', {}, ...rows.map((row) => h('tr', {}, h('td', { class: 'submitter-name' }, row.name), h('td', { class: 'number' }, count(row.running)), h('td', { class: 'number' }, count(row.queued)), h('td', { class: 'number nowrap' }, row.priority), h('td', {}, h('span', { class: 'bar-cell' }, h('i', { css: { width: `${(row.left / most) * 100}%` } }), h('span', {}, count(row.left)))))))
      ),
    );
  }
}
