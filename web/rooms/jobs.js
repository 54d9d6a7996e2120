// The room Jobs: the live list of jobs, and what can be done to one or many.

import { messageOf } from '/ui/api.js';
import { connection } from '/ui/connection.js';
import { farmEvents } from '/ui/events.js';
import { append, h, setText, whenQuiet } from '/ui/parts/dom.js';
import { count, counted } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { openMenu } from '/ui/parts/menu.js';
import { Room, emptyState, heading } from '/ui/parts/room.js';
import { keepSetting, readSetting } from '/ui/parts/settings.js';
import { addShortcuts } from '/ui/parts/shortcuts.js';
import { toastError } from '/ui/parts/toast.js';
import { ACTIONS, act, isPossible } from '/ui/rooms/jobs/actions.js';
import { COLUMNS, JobList } from '/ui/rooms/jobs/list.js';
import { Scenes } from '/ui/rooms/jobs/scenes.js';
import { JobStore } from '/ui/rooms/jobs/store.js';
import { acceptFiles, submitFiles } from '/ui/rooms/jobs/submit.js';
import { session } from '/ui/session.js';

/** @typedef {import('/ui/types.js').Job} Job */
/** @typedef {import('/ui/types.js').JobState} JobState */
/** @typedef {import('/ui/rooms/jobs/actions.js').ActionName} ActionName */

const STATES = /** @type {const} */ (['running', 'queued', 'succeeded', 'failed', 'cancelled']);
/** @type {ActionName[]} */
const BULK = ['pause', 'resume', 'cancel', 'retry', 'priority', 'first', 'move', 'delete'];
/** Columns that are hidden until they are chosen. */
const HIDDEN = ['queue'];
const FILTER_MS = 350;
const REFRESH_MS = 20_000;

class JobsRoom extends Room {
  /** Text of the empty list, so that it is written once. */
  nothingShown = '';

  enter() {
    this.setTitle('Jobs');
    this.store = new JobStore(this.signal);
    this.list = new JobList();
    /** @type {Set<string>} */
    this.hiddenColumns = new Set(readSetting('jobs.hidden', HIDDEN));
    this.store.sort = readSetting('jobs.sort', this.store.sort);
    const wanted = this.place.query.get('state');
    this.store.state = STATES.find((state) => state === wanted) ?? null;
    this.#build();
    acceptFiles(this, (job) => this.store?.put(job));
    this.listen(this.store, 'change', () => this.#show());
    this.listen(this.list, 'select', () => this.#showSelection());
    this.listen(this.list, 'sort', (event) => this.#sortBy(event.detail));
    this.listen(this.list, 'enter', (event) => (location.hash = `#/jobs/${event.detail.id}`));
    this.listen(this.list, 'menu', (event) => this.#openMenu(event.detail.job, event.detail.button));
    this.listen(this.list, 'end', () => this.store?.error == null && void this.store?.readMore());
    this.listen(farmEvents, 'farm', () => this.#showCounts());
    this.listen(session, 'change', () => this.#show());
    this.listen(connection, 'change', () => this.#show());
    this.every(REFRESH_MS, () => this.list?.refresh());
    this.#addShortcuts();
    this.list.setColumns(this.hiddenColumns, this.store.sort);
    this.#showCounts();
    void this.store.read();
  }

  leave() {
    this.list?.observer.disconnect();
  }

  #build() {
    const { store, list } = /** @type {{store: JobStore, list: JobList}} */ (this);
    this.filter = h('input', {
      type: 'search',
      placeholder: 'Filter by name, submitter or id',
      'aria-label': 'Filter the jobs',
      autocomplete: 'off',
      spellcheck: 'false',
      class: 'filter',
    });
    const find = whenQuiet(FILTER_MS, () => void store.find().catch((error) => toastError('The search', error)));
    this.filter.addEventListener('input', () => {
      store.setFilter(this.filter?.value ?? '');
      find();
    });
    this.filter.addEventListener('keydown', (event) => {
      if (event.key === 'Escape' && this.filter?.value === '') list.element.focus();
      if (event.key === 'ArrowDown' || event.key === 'Enter') {
        event.preventDefault();
        list.element.focus();
      }
    });
    this.chips = h('div', { class: 'segments chips', role: 'group', 'aria-label': 'State' });
    const columns = h('button', { type: 'button', class: 'button icon-only', 'aria-label': 'Columns', title: 'Columns', 'aria-haspopup': 'menu', 'aria-expanded': 'false', on: { click: () => this.#openColumns(columns) } }, icon('columns'));
    this.files = h('input', { type: 'file', accept: '.json,application/json', multiple: true, hidden: true, 'aria-label': 'Job files' });
    this.files.addEventListener('change', () => {
      void submitFiles([...(this.files?.files ?? [])], (job) => store.put(job));
      if (this.files) this.files.value = '';
    });
    this.submitButton = h('button', { type: 'button', class: 'button primary', on: { click: () => this.files?.click() } }, icon('plus'), 'Submit a file');
    this.refreshButton = h('button', { type: 'button', class: 'button', on: { click: () => void store.read() } }, icon('again'), 'Refresh');
    this.tools = h('div', { class: 'room-head tools' }, heading('Jobs'), this.chips, this.filter, columns, this.refreshButton, this.submitButton, this.files);
    this.bulk = h('div', { class: 'bulk', role: 'toolbar', 'aria-label': 'Actions for the selected jobs', hidden: true });
    this.foot = h('div', { class: 'job-foot muted small', role: 'status' });
    this.nothing = h('div', { class: 'nothing', hidden: true });
    this.panel = h('div', { class: 'panel jobs-panel' }, list.element, this.nothing, this.foot);
    append(this, [this.tools, this.panel, this.bulk]);
  }

  #effects() {
    const store = /** @type {JobStore} */ (this.store);
    return { changed: (/** @type {Job | null} */ job) => store.put(job), deleted: (/** @type {string} */ id) => store.remove(id), others: () => store.shown };
  }

  #show() {
    const { store, list, foot, nothing } = this;
    if (!store || !list || !foot || !nothing) return;
    list.setJobs(store.shown);
    if (this.refreshButton) this.refreshButton.hidden = connection.state !== 'quiet';
    if (this.submitButton) this.submitButton.hidden = !session.maySubmit;
    const isEmpty = store.shown.length === 0;
    list.element.hidden = isEmpty;
    nothing.hidden = !isEmpty;
    if (isEmpty) this.#showNothing();
    else this.nothingShown = '';
    foot.replaceChildren();
    if (isEmpty) return;
    const shown = store.shown.length === store.size ? counted(store.size, 'job') : `${count(store.shown.length)} of ${counted(store.size, 'job')}`;
    append(foot, [h('span', {}, store.hasMore ? `${shown} read` : shown)]);
    if (store.error !== null) append(foot, [h('span', { class: 'field-error' }, messageOf(store.error))]);
    if (store.hasMore) append(foot, [h('button', { type: 'button', class: 'link', disabled: store.isLoading, on: { click: () => void store.readMore() } }, store.isLoading ? 'Loading…' : 'Load more')]);
  }

  #showNothing() {
    const { store, nothing } = this;
    if (!store || !nothing) return;
    const kind = store.isLoading && !store.isRead ? 'loading' : store.error !== null ? `error ${messageOf(store.error)}` : store.filter.trim() !== '' ? 'filter' : store.state !== null ? store.state : 'first';
    if (this.nothingShown === kind) return;
    this.nothingShown = kind;
    if (kind === 'loading') {
      nothing.replaceChildren();
    } else if (store.error !== null) {
      nothing.replaceChildren(emptyState('The jobs could not be read', h('p', {}, messageOf(store.error)), h('button', { type: 'button', class: 'button', on: { click: () => void store.read() } }, 'Try again')));
    } else if (kind === 'filter') {
      nothing.replaceChildren(emptyState('No job fits the filter', h('p', {}, `Nothing that has been read has “${store.filter.trim()}” in its name, submitter or id.`), h('button', { type: 'button', class: 'button', on: { click: () => this.#clearFilter() } }, 'Clear the filter')));
    } else if (kind !== 'first') {
      nothing.replaceChildren(emptyState(`No job is ${kind}`, h('button', { type: 'button', class: 'button', on: { click: () => this.#setState(null) } }, 'Show all jobs')));
    } else {
      this.#showFirstSteps();
    }
  }

  #showFirstSteps() {
    const canSubmit = session.maySubmit;
    const scenes = canSubmit ? new Scenes(this.signal) : null;
    this.nothing?.replaceChildren(
      emptyState(
        'No jobs yet',
        h('p', {}, canSubmit ? 'A job is a scene, written as JSON, and the pictures that are wanted of it. Drop a job file here, write one in the studio, or render one of the scenes that come with sdfarm:' : 'Jobs appear here when they are submitted.'),
        scenes?.element,
        canSubmit ? h('p', {}, h('a', { href: '#/studio' }, 'Write a scene in the studio'), ' · ', h('a', { href: '#/help' }, 'First steps')) : null,
      ),
    );
    void scenes?.read();
  }

  #showCounts() {
    const counts = farmEvents.counts;
    const chip = (/** @type {JobState | null} */ state, /** @type {string} */ label) => {
      const number = counts === null || state === null ? null : counts[state];
      return h(
        'button',
        { type: 'button', 'aria-pressed': String(this.store?.state === state), on: { click: () => this.#setState(state) } },
        label,
        number ? h('span', { class: 'count' }, count(number)) : null,
      );
    };
    const focused = [...(this.chips?.children ?? [])].findIndex((button) => button === document.activeElement);
    this.chips?.replaceChildren(chip(null, 'All'), ...STATES.map((state) => chip(state, state.slice(0, 1).toUpperCase() + state.slice(1))));
    const again = focused < 0 ? null : this.chips?.children[focused];
    if (again instanceof HTMLElement) again.focus();
  }

  /** @param {JobState | null} state */
  #setState(state) {
    this.store?.setState(state);
    this.list?.clearSelection();
    if (this.list) this.list.element.scrollTop = 0;
    this.nothingShown = '';
    this.#showCounts();
    history.replaceState(null, '', state === null ? '#/jobs' : `#/jobs?state=${state}`);
  }

  #clearFilter() {
    if (this.filter) this.filter.value = '';
    this.store?.setFilter('');
    this.filter?.focus();
  }

  /** @param {import('/ui/rooms/jobs/store.js').SortKey} key */
  #sortBy(key) {
    const { store, list } = this;
    if (!store || !list) return;
    store.setSort({ key, isReversed: store.sort.key === key && !store.sort.isReversed });
    keepSetting('jobs.sort', store.sort);
    list.setColumns(this.hiddenColumns ?? new Set(), store.sort);
  }

  /** @param {HTMLElement} button */
  #openColumns(button) {
    const hidden = this.hiddenColumns ?? new Set();
    const apply = () => {
      keepSetting('jobs.hidden', [...hidden]);
      this.list?.setColumns(hidden, this.store?.sort ?? { key: 'newest', isReversed: false });
    };
    const sorts = COLUMNS.filter((column) => column.sort !== null);
    openMenu(button, [
      ...COLUMNS.filter((column) => column.isOptional).map((column) => ({
        label: column.title,
        checked: !hidden.has(column.key),
        run: () => {
          if (!hidden.delete(column.key)) hidden.add(column.key);
          apply();
        },
      })),
      null,
      ...sorts.map((column) => ({ label: `Sort by ${column.title.toLowerCase()}`, checked: this.store?.sort.key === column.sort, run: () => column.sort && this.#sortBy(column.sort) })),
    ]);
  }

  /**
   * @param {Job} job
   * @param {HTMLElement} button
   */
  #openMenu(job, button) {
    const actions = BULK.filter((name) => isPossible(name, [job])).map((name) => ({
      label: `${ACTIONS[name].label}${['cancel', 'priority', 'move', 'delete'].includes(name) ? '…' : ''}`,
      icon: ACTIONS[name].icon,
      isDanger: name === 'delete',
      run: () => void act(name, [job], this.#effects()),
    }));
    openMenu(button, [
      { label: 'Open', icon: 'next', run: () => (location.hash = `#/jobs/${job.id}`) },
      { label: 'Edit a copy', icon: 'edit', run: () => (location.hash = `#/studio?job=${job.id}`) },
      ...(actions.length > 0 ? [null, ...actions] : []),
    ]);
  }

  #showSelection() {
    const { bulk, list } = this;
    if (!bulk || !list) return;
    const jobs = list.selection;
    bulk.hidden = jobs.length === 0;
    if (bulk.hidden) return;
    const possible = BULK.filter((name) => isPossible(name, jobs));
    if (!this.bulkCount) this.bulkCount = h('b');
    setText(this.bulkCount, `${count(jobs.length)} selected`);
    const key = possible.join(' ');
    if (bulk.dataset['actions'] === key) return;
    bulk.dataset['actions'] = key;
    bulk.replaceChildren(
      this.bulkCount,
      ...possible.map((name) =>
        h('button', { type: 'button', class: name === 'delete' ? 'button danger' : 'button', on: { click: () => void act(name, list.selection, this.#effects()) } }, icon(ACTIONS[name].icon), h('span', {}, ACTIONS[name].label)),
      ),
      possible.length === 0 ? h('span', { class: 'muted' }, 'Nothing can be done to these.') : '',
      h('button', { type: 'button', class: 'ghost', 'aria-label': 'Clear the selection', on: { click: () => (list.clearSelection(), list.element.focus()) } }, icon('cross')),
    );
  }

  #addShortcuts() {
    const group = 'Jobs';
    const list = /** @type {JobList} */ (this.list);
    const action = (/** @type {ActionName} */ name) => () => list.chosen.length > 0 && void act(name, list.chosen, this.#effects());
    addShortcuts(
      [
        { keys: '/', text: 'Filter', group, run: () => this.filter?.focus() },
        { keys: 'ArrowDown', text: 'Next job (↑ previous, Home, End, page keys)', group, run: () => (list.element.focus(), list.element.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowDown' }))) },
        { keys: 'Enter', text: 'Open the job', group },
        { keys: ' ', text: 'Select the job', group },
        { keys: 'Shift+ArrowDown', text: 'Select several', group },
        { keys: 'Escape', text: 'Clear the selection', group, run: () => list.clearSelection() },
        { keys: 'p', text: 'Pause', group, run: action('pause') },
        { keys: 'u', text: 'Resume', group, run: action('resume') },
        { keys: 'c', text: 'Cancel…', group, run: action('cancel') },
        { keys: 'r', text: 'Retry', group, run: action('retry') },
        { keys: 'y', text: 'Priority…', group, run: action('priority') },
        { keys: 'f', text: 'Move to the front of the queue', group, run: action('first') },
        { keys: 'm', text: 'Move in the queue…', group, run: action('move') },
        { keys: 'Delete', text: 'Delete…', group, run: action('delete') },
        { keys: 'n', text: 'Submit a job file', group, run: () => session.maySubmit && this.files?.click() },
      ],
      this.signal,
    );
  }
}

customElements.define('room-jobs', JobsRoom);
