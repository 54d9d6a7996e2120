// A list of jobs that draws only the rows that are seen, so that ten thousand scroll as ten do.

import { h, setText } from '/ui/parts/dom.js';
import { ago, count, duration, dateTime, percent, shortId, timeLeft } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { showThumbnail, thumbnailPath } from '/ui/parts/thumbnails.js';

/** @typedef {import('/ui/types.js').Job} Job */
/** @typedef {import('/ui/rooms/jobs/store.js').SortKey} SortKey */
/** @typedef {{key: string, title: string, sort: SortKey | null, width: string, isOptional: boolean, isNumber?: boolean}} Column */

/** @type {Column[]} */
export const COLUMNS = [
  { key: 'name', title: 'Job', sort: 'name', width: 'minmax(180px, 1fr)', isOptional: false },
  { key: 'state', title: 'State', sort: 'state', width: '112px', isOptional: false },
  { key: 'progress', title: 'Progress', sort: 'progress', width: 'minmax(120px, 220px)', isOptional: false },
  { key: 'left', title: 'Time', sort: 'left', width: '110px', isOptional: true, isNumber: true },
  { key: 'frames', title: 'Frames', sort: 'frames', width: '92px', isOptional: true, isNumber: true },
  { key: 'submitter', title: 'Submitter', sort: 'submitter', width: '124px', isOptional: true },
  { key: 'priority', title: 'Priority', sort: 'priority', width: '78px', isOptional: true, isNumber: true },
  { key: 'queue', title: 'Place', sort: 'queue', width: '70px', isOptional: true, isNumber: true },
  { key: 'created', title: 'Submitted', sort: 'newest', width: '108px', isOptional: true },
];

/** Rows beyond the edges that are drawn as well. */
const MARGIN = 4;
/** Rest after which pictures are requested. */
const SETTLED_MS = 90;

/** @param {Job} job */
export const stateOf = (job) => (job.paused && (job.state === 'queued' || job.state === 'running') ? 'paused' : job.state);

/**
 * Time left of an unfinished job, or time that a finished one took.
 * @param {Job} job
 */
export function timeText(job) {
  if (job.state === 'queued' || job.state === 'running') {
    return job.eta_seconds === null || job.paused ? '' : `${timeLeft(job.eta_seconds)} left`;
  }
  if (job.started_at === null || job.finished_at === null) return '';
  return `took ${duration((Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000)}`;
}

class Row {
  box = h('input', { type: 'checkbox', tabindex: -1 });
  picture = h('span', { class: 'picture' });
  link = h('a', { tabindex: -1 });
  id = h('span', { class: 'muted small mono' });
  state = h('span', { class: 'state' });
  fill = h('i');
  meter = h('span', { class: 'meter', role: 'progressbar', 'aria-valuemin': 0, 'aria-valuemax': 100 }, this.fill);
  done = h('span', { class: 'muted small' });
  left = h('span', { class: 'number' });
  frames = h('span', { class: 'number' });
  submitter = h('span', { class: 'ellipsis' });
  priority = h('span', { class: 'number' });
  queue = h('span', { class: 'number' });
  created = h('span', { class: 'muted' });
  more = h('button', { type: 'button', class: 'ghost', tabindex: -1, 'aria-haspopup': 'menu' }, icon('more'));
  index = -1;
  /** @type {Job | null} */
  job = null;
  isSelected = false;
  isActive = false;

  constructor() {
    const cell = (/** @type {string} */ name, /** @type {Node[]} */ ...children) => h('div', { role: 'gridcell', class: `cell ${name}` }, ...children);
    this.element = h(
      'div',
      { role: 'row', class: 'job-row' },
      cell('box', h('label', {}, this.box)),
      cell('picture-cell', this.picture),
      cell('name', h('div', { class: 'ellipsis' }, this.link), this.id),
      cell('state-cell', this.state),
      cell('progress', this.meter, this.done),
      cell('left', this.left),
      cell('frames', this.frames),
      cell('submitter', this.submitter),
      cell('priority', this.priority),
      cell('queue', this.queue),
      cell('created', this.created),
      cell('more', this.more),
    );
  }

  /**
   * Shows a job; only what has changed is written.
   * @param {number} index
   * @param {Job} job
   * @param {number} now
   */
  show(index, job, now) {
    if (this.index !== index) {
      this.index = index;
      this.element.setAttribute('aria-rowindex', String(index + 2));
    }
    const isOther = this.job?.id !== job.id;
    if (this.job === job) return;
    this.job = job;
    const state = stateOf(job);
    if (isOther) {
      this.element.id = `job-${job.id}`;
      this.link.href = `#/jobs/${job.id}`;
      setText(this.id, shortId(job.id));
      this.created.title = dateTime(job.created_at);
      this.box.setAttribute('aria-label', `Select ${job.name}`);
      this.more.setAttribute('aria-label', `Actions for ${job.name}`);
      this.meter.setAttribute('aria-label', `Progress of ${job.name}`);
    }
    setText(this.link, job.name);
    setText(this.state, state);
    this.state.className = `state ${state}`;
    this.meter.className = `meter ${state}`;
    this.meter.setAttribute('aria-valuenow', String(Math.floor(job.progress * 100)));
    this.fill.style.setProperty('--done', String(job.progress));
    setText(this.done, job.state === 'succeeded' ? '' : percent(job.progress));
    setText(this.left, timeText(job));
    setText(this.frames, job.frames.total === 1 ? '1' : `${count(job.frames.done)} / ${count(job.frames.total)}`);
    setText(this.submitter, job.submitter);
    setText(this.priority, job.priority === 0 ? '0' : String(job.priority).replace('-', '−'));
    setText(this.queue, job.queue_position ? String(job.queue_position) : '');
    setText(this.created, ago(job.created_at, now));
    this.element.classList.toggle('has-errors', job.errors.length > 0);
  }

  /**
   * @param {boolean} isSelected
   * @param {boolean} isActive
   */
  mark(isSelected, isActive) {
    if (isSelected !== this.isSelected || !this.element.hasAttribute('aria-selected')) {
      this.isSelected = isSelected;
      this.element.setAttribute('aria-selected', String(isSelected));
    }
    if (this.box.checked !== isSelected) this.box.checked = isSelected;
    if (isActive !== this.isActive) {
      this.isActive = isActive;
      this.element.classList.toggle('active', isActive);
    }
  }
}

/**
 * Tells by `select` that the selection has changed, by `sort` (detail: the key) that a title was pressed, by `menu` (detail: the
 * job and the button) that its actions are asked for, by `enter` (detail: the job) that it is opened, and by `end` that the last
 * rows are seen.
 */
export class JobList extends EventTarget {
  /** @type {Row[]} */
  #rows = [];
  /** @type {Job[]} */
  #jobs = [];
  /** @type {Set<string>} */
  #selected = new Set();
  #active = -1;
  /** @type {string | null} The active job, which stays active when the order changes. */
  #activeId = null;
  #anchor = -1;
  #settled = 0;
  #isPlanned = false;
  #height = 52;

  constructor() {
    super();
    this.head = h('div', { role: 'row', class: 'job-row head', 'aria-rowindex': 1 });
    this.body = h('div', { role: 'rowgroup', class: 'job-body' });
    this.element = h(
      'div',
      { class: 'job-list', role: 'grid', tabindex: 0, 'aria-label': 'Jobs', 'aria-multiselectable': 'true' },
      h('div', { role: 'rowgroup', class: 'job-head' }, this.head),
      this.body,
    );
    this.element.addEventListener('scroll', () => this.#plan(), { passive: true });
    this.element.addEventListener('keydown', (event) => this.#press(event));
    this.element.addEventListener('focus', () => {
      if (this.#active < 0 && this.#jobs.length > 0) this.#moveTo(0, false);
    });
    this.body.addEventListener('click', (event) => this.#click(event));
    this.observer = new ResizeObserver(() => this.#plan());
    this.observer.observe(this.element);
  }

  /** The selected jobs, in their order. */
  get selection() {
    return this.#jobs.filter((job) => this.#selected.has(job.id));
  }

  /** The jobs that a key acts on: the selected ones, or the active one. */
  get chosen() {
    const selection = this.selection;
    const active = this.#jobs[this.#active];
    return selection.length > 0 ? selection : active ? [active] : [];
  }

  clearSelection() {
    if (this.#selected.size === 0) return;
    this.#selected.clear();
    this.#changedSelection();
  }

  /** Selects every job that is shown. */
  selectAll() {
    for (const job of this.#jobs) this.#selected.add(job.id);
    this.#changedSelection();
  }

  /**
   * @param {Set<string>} hidden Columns that are not shown.
   * @param {{key: SortKey, isReversed: boolean}} sort
   */
  setColumns(hidden, sort) {
    const shown = COLUMNS.filter((column) => !hidden.has(column.key));
    this.element.style.setProperty('--columns', `36px 68px ${shown.map((column) => column.width).join(' ')} 40px`);
    for (const column of COLUMNS) this.element.classList.toggle(`no-${column.key}`, hidden.has(column.key));
    const titles = COLUMNS.map((column) => {
      const isSorted = column.sort === sort.key;
      const button = h('button', { type: 'button', tabindex: -1, on: { click: () => this.#tell('sort', column.sort) } }, column.title, isSorted ? icon(sort.isReversed ? 'up' : 'down', 12) : null);
      return h(
        'div',
        { role: 'columnheader', class: `cell ${column.key === 'state' ? 'state-cell' : column.key}${column.isNumber ? ' number' : ''}`, 'aria-sort': isSorted ? (sort.isReversed ? 'descending' : 'ascending') : undefined },
        button,
      );
    });
    const all = h('input', { type: 'checkbox', 'aria-label': 'Select all jobs that are shown', tabindex: -1 });
    all.addEventListener('change', () => (all.checked ? this.selectAll() : this.clearSelection()));
    this.all = all;
    this.head.replaceChildren(
      h('div', { role: 'columnheader', class: 'cell box' }, h('label', {}, all)),
      h('div', { role: 'columnheader', class: 'cell picture-cell' }, h('span', { class: 'visually-hidden' }, 'Picture')),
      ...titles,
      h('div', { role: 'columnheader', class: 'cell more' }, h('span', { class: 'visually-hidden' }, 'Actions')),
    );
    this.#showAll();
  }

  /** @param {Job[]} jobs */
  setJobs(jobs) {
    this.#jobs = jobs;
    if (this.#selected.size > 0) {
      const known = new Set(jobs.map((job) => job.id));
      const before = this.#selected.size;
      for (const id of this.#selected) if (!known.has(id)) this.#selected.delete(id);
      if (before !== this.#selected.size) this.#changedSelection();
    }
    if (this.#activeId !== null) this.#active = jobs.findIndex((job) => job.id === this.#activeId);
    this.element.setAttribute('aria-rowcount', String(jobs.length + 1));
    this.#plan();
  }

  #plan() {
    if (this.#isPlanned) return;
    this.#isPlanned = true;
    requestAnimationFrame(() => {
      this.#isPlanned = false;
      this.#draw();
    });
  }

  #draw() {
    const list = this.element;
    const height = matchMedia('(max-width: 760px)').matches ? 84 : 52;
    if (height !== this.#height) this.#height = height;
    this.body.style.height = `${this.#jobs.length * height}px`;
    const head = this.head.offsetHeight;
    const first = Math.max(0, Math.floor(list.scrollTop / height) - MARGIN);
    const last = Math.min(this.#jobs.length, Math.ceil((list.scrollTop + list.clientHeight - head) / height) + MARGIN);
    const needed = Math.max(0, last - first);
    while (this.#rows.length < needed) this.#addRow();
    const size = this.#rows.length;
    const now = Date.now();
    const seen = new Set();
    for (let index = first; index < last; index += 1) {
      // A row keeps its element while it is seen.
      const row = this.#rows[index % size];
      const job = this.#jobs[index];
      if (row === undefined || job === undefined) continue;
      seen.add(row);
      if (row.index !== index) row.element.style.transform = `translateY(${index * height}px)`;
      row.show(index, job, now);
      row.mark(this.#selected.has(job.id), index === this.#active);
      row.element.hidden = false;
    }
    for (const row of this.#rows) {
      if (seen.has(row)) continue;
      row.element.hidden = true;
      row.index = -1;
    }
    const active = this.#jobs[this.#active];
    if (active && this.#active >= first && this.#active < last) list.setAttribute('aria-activedescendant', `job-${active.id}`);
    else list.removeAttribute('aria-activedescendant');
    clearTimeout(this.#settled);
    this.#settled = setTimeout(() => this.#showPictures(), SETTLED_MS);
    if (last >= this.#jobs.length - 20) this.#tell('end', null);
  }

  #addRow() {
    const row = new Row();
    this.#rows.push(row);
    this.body.append(row.element);
    // The rows' places depend on their number.
    for (const each of this.#rows) each.index = -1;
  }

  #showPictures() {
    for (const row of this.#rows) if (row.index >= 0 && row.job) showThumbnail(row.picture, thumbnailPath(row.job));
  }

  /** Draws all rows again, as times pass. */
  refresh() {
    for (const row of this.#rows) row.job = null;
    this.#plan();
  }

  #changedSelection() {
    this.#showAll();
    this.#plan();
    this.#tell('select', null);
  }

  #showAll() {
    if (!this.all) return;
    this.all.checked = this.#selected.size > 0 && this.#selected.size >= this.#jobs.length;
    this.all.indeterminate = this.#selected.size > 0 && !this.all.checked;
  }

  /**
   * @param {string} event
   * @param {unknown} detail
   */
  #tell(event, detail) {
    this.dispatchEvent(new CustomEvent(event, { detail }));
  }

  /**
   * @param {number} index
   * @param {boolean} isExtending
   */
  #moveTo(index, isExtending) {
    const target = Math.max(0, Math.min(this.#jobs.length - 1, index));
    if (this.#jobs.length === 0) return;
    if (isExtending) {
      if (this.#anchor < 0) this.#anchor = Math.max(0, this.#active);
      this.#selected.clear();
      const [from, to] = [Math.min(this.#anchor, target), Math.max(this.#anchor, target)];
      for (let each = from; each <= to; each += 1) this.#selected.add(this.#jobs[each]?.id ?? '');
      this.#changedSelection();
    } else {
      this.#anchor = -1;
    }
    this.#active = target;
    this.#activeId = this.#jobs[target]?.id ?? null;
    const top = target * this.#height;
    const seen = this.element.clientHeight - this.head.offsetHeight;
    if (top < this.element.scrollTop) this.element.scrollTop = top;
    else if (top + this.#height > this.element.scrollTop + seen) this.element.scrollTop = top + this.#height - seen;
    this.#plan();
  }

  /** @param {string} id */
  #toggle(id) {
    if (!this.#selected.delete(id)) this.#selected.add(id);
    this.#changedSelection();
  }

  /** @param {KeyboardEvent} event */
  #press(event) {
    if (event.target !== this.element || event.altKey) return;
    const isCommand = event.ctrlKey || event.metaKey;
    const page = Math.max(1, Math.floor(this.element.clientHeight / this.#height) - 2);
    const active = this.#jobs[this.#active];
    /** @type {Record<string, () => void>} */
    const keys = isCommand
      ? { a: () => this.selectAll() }
      : {
          ArrowDown: () => this.#moveTo(this.#active + 1, event.shiftKey),
          ArrowUp: () => this.#moveTo(this.#active - 1, event.shiftKey),
          PageDown: () => this.#moveTo(this.#active + page, event.shiftKey),
          PageUp: () => this.#moveTo(this.#active - page, event.shiftKey),
          Home: () => this.#moveTo(0, event.shiftKey),
          End: () => this.#moveTo(this.#jobs.length - 1, event.shiftKey),
          ' ': () => active && this.#toggle(active.id),
          Enter: () => active && this.#tell('enter', active),
        };
    const run = keys[event.key];
    if (run === undefined) return;
    event.preventDefault();
    run();
  }

  /** @param {MouseEvent} event */
  #click(event) {
    const target = event.target instanceof Element ? event.target : null;
    const row = this.#rows.find((each) => each.element.contains(target));
    const job = row?.job;
    if (!row || !job) return;
    const index = row.index;
    if (row.more.contains(target)) {
      this.#setActive(index);
      this.#tell('menu', { job, button: row.more });
    } else if (target?.closest('.cell.box')) {
      event.preventDefault();
      if (event.shiftKey && this.#active >= 0) {
        this.#anchor = this.#anchor < 0 ? this.#active : this.#anchor;
        this.#moveTo(index, true);
      } else {
        this.#setActive(index);
        this.#toggle(job.id);
      }
      // The browser sets the box after the event; it shows what is selected.
      setTimeout(() => row.mark(this.#selected.has(row.job?.id ?? ''), row.isActive));
    } else if (event.ctrlKey || event.metaKey) {
      if (target?.closest('a')) return;
      this.#setActive(index);
      this.#toggle(job.id);
    } else if (event.shiftKey) {
      event.preventDefault();
      if (this.#active < 0) this.#setActive(index);
      this.#moveTo(index, true);
    } else if (!target?.closest('a') && getSelection()?.isCollapsed !== false) {
      this.#setActive(index);
      this.#tell('enter', job);
    }
  }

  /** @param {number} index */
  #setActive(index) {
    this.#active = index;
    this.#activeId = this.#jobs[index]?.id ?? null;
    this.#anchor = -1;
    this.#plan();
  }
}
