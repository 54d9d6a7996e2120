// The room Job: its picture as it grows, its frames, who rendered it, its errors and its file.

import { Problem, getJson, messageOf } from '/ui/api.js';
import { farmEvents, follow } from '/ui/events.js';
import { append, h, setText } from '/ui/parts/dom.js';
import { count, counted, duration, dateTime, percent } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { openMenu } from '/ui/parts/menu.js';
import { Room, emptyState, heading } from '/ui/parts/room.js';
import { addShortcuts } from '/ui/parts/shortcuts.js';
import { toast, toastError } from '/ui/parts/toast.js';
import { FilmStrip } from '/ui/rooms/job/frames.js';
import { JobFile } from '/ui/rooms/job/file.js';
import { Picture } from '/ui/rooms/job/picture.js';
import { copy, download, fileName, share } from '/ui/rooms/job/share.js';
import { TileLine } from '/ui/rooms/job/tiles.js';
import { showVerification, verify } from '/ui/rooms/job/verify.js';
import { ACTIONS, act, isPossible } from '/ui/rooms/jobs/actions.js';
import { stateOf, timeText } from '/ui/rooms/jobs/list.js';
import { session } from '/ui/session.js';

/** @typedef {import('/ui/types.js').Job} Job */
/** @typedef {import('/ui/types.js').Tile} Tile */
/** @typedef {import('/ui/rooms/jobs/actions.js').ActionName} ActionName */

/** Time between two readings of the tiles of a job that is being rendered. */
const TILES_MS = 1200;

class JobRoom extends Room {
  #isGone = false;
  /** @type {Job | null} */
  job = null;
  #tilesTimer = 0;
  #lastTiles = 0;
  #isFollowing = false;
  /** @type {import('/ui/rooms/job/viewer.js').Mark[]} */
  #differs = [];

  get #id() {
    return this.place.id ?? '';
  }

  enter() {
    this.setTitle('Job');
    this.#isGone = false;
    this.heading = heading('Job');
    this.head = h('div', { class: 'room-head job-title' }, h('a', { href: '#/jobs', class: 'back', 'aria-label': 'All jobs' }, icon('back'), 'Jobs'), this.heading);
    append(this, [this.head]);
    void this.#start();
  }

  leave() {
    clearTimeout(this.#tilesTimer);
  }

  async #start() {
    try {
      this.job = /** @type {Job} */ (await getJson(`/v1/jobs/${encodeURIComponent(this.#id)}`, { signal: this.signal }));
    } catch (error) {
      if (this.signal.aborted) return;
      const isUnknown = error instanceof Problem && error.status === 404;
      append(this, [emptyState(isUnknown ? 'No such job' : 'The job could not be read', h('p', {}, messageOf(error)), h('a', { class: 'button', href: '#/jobs' }, 'All jobs'))]);
      return;
    }
    this.#build(this.job);
    this.#show(this.job);
    this.#addShortcuts();
    const { film, file } = /** @type {{film: FilmStrip, file: JobFile}} */ (this);
    this.listen(farmEvents, 'job', (event) => event.detail.id === this.job?.id && this.#take(event.detail));
    this.listen(farmEvents, 'deleted', (event) => event.detail === this.job?.id && this.#gone());
    this.listen(farmEvents, 'open', () => void this.#readAgain());
    this.listen(session, 'change', () => this.job && this.#showActions(this.job));
    this.listen(file, 'read', () => this.#fileRead());
    void file.read();
    film.current = Number(this.place.query.get('frame')) || 0;
    try {
      await film.read();
    } catch (error) {
      if (!this.signal.aborted) toastError('The frames could not be read', error);
    }
    this.#follow();
    void this.#readTiles();
    const other = this.place.query.get('with');
    if (other) void this.#compareWith(other);
  }

  /** @param {Job} job */
  #build(job) {
    const picture = new Picture(job.id, this.signal);
    const film = new FilmStrip(job.id, this.signal);
    const tiles = new TileLine(job.id, this.signal);
    const file = new JobFile(job.id, this.signal);
    this.picture = picture;
    this.film = film;
    this.tiles = tiles;
    this.file = file;
    this.state = h('span', { class: 'state' });
    this.actions = h('div', { class: 'job-actions', role: 'toolbar', 'aria-label': 'Actions' });
    append(/** @type {HTMLElement} */ (this.head), [this.state, h('span', { class: 'grow' }), this.actions]);
    this.meter = h('div', { class: 'meter', role: 'progressbar', 'aria-label': 'Progress', 'aria-valuemin': 0, 'aria-valuemax': 100 }, h('i'));
    this.status = h('p', { class: 'muted job-status' });
    this.facts = h('dl', { class: 'facts' });
    this.messages = h('section', { class: 'panel messages', hidden: true });
    this.tileScope = h('select', { 'aria-label': 'Frames of the time line', hidden: job.frames.total < 2, on: { change: () => void this.#readTiles() } }, h('option', { value: 'one' }, 'This frame'), h('option', { value: 'all' }, 'All frames'));
    const showTiles = h('input', { type: 'checkbox', checked: true, on: { change: () => this.#mark() } });
    this.showTiles = showTiles;
    picture.tools.prepend(h('label', { class: 'check tool' }, showTiles, 'Tiles'));
    append(this, [
      h('div', { class: 'job-progress' }, this.meter, this.status),
      h(
        'div',
        { class: 'job-columns' },
        h('div', { class: 'panel picture-panel' }, picture.tools, picture.viewer.element, film.element),
        h('div', { class: 'job-side' }, this.messages, h('section', { class: 'panel' }, h('div', { class: 'panel-head' }, h('h2', {}, 'About')), h('div', { class: 'panel-body' }, this.facts))),
      ),
      h('section', { class: 'panel' }, h('div', { class: 'panel-head' }, h('h2', {}, 'Time line'), this.tileScope), h('div', { class: 'panel-body' }, tiles.element)),
      h(
        'section',
        { class: 'panel', id: 'job-file' },
        h('div', { class: 'panel-head' }, h('h2', {}, 'Job file'), h('button', { type: 'button', class: 'button', on: { click: () => void this.#copyFile() } }, icon('copy'), 'Copy'), h('button', { type: 'button', class: 'button', on: { click: () => this.#downloadFile() } }, icon('download'), 'Download')),
        file.element,
      ),
    ]);
    this.listen(film, 'frame', (event) => this.#frameChosen(event.detail));
    this.listen(film, 'show', (event) => picture.viewer.draw(event.detail));
    this.listen(picture, 'compare', () => this.#keepPlace());
    this.listen(tiles, 'change', () => this.#mark());
    this.listen(tiles, 'choose', (event) => this.#tileChosen(event.detail));
  }

  /** @param {Job} job */
  #take(job) {
    const wasFinal = this.job !== null && this.job.state !== 'queued' && this.job.state !== 'running';
    this.job = { ...this.job, ...job };
    this.#show(this.job);
    if (wasFinal && (job.state === 'queued' || job.state === 'running')) this.#follow();
  }

  async #readAgain() {
    try {
      this.#take(await getJson(`/v1/jobs/${this.#id}`, { signal: this.signal }));
      await this.film?.read();
      this.picture?.changed();
      this.#planTiles();
    } catch (error) {
      if (error instanceof Problem && error.status === 404) this.#gone();
    }
  }

  #gone() {
    // The event and a read in progress may both find out.
    if (this.signal.aborted || this.#isGone) return;
    this.#isGone = true;
    toast(`${this.job?.name ?? 'The job'} has been deleted`);
    location.hash = '#/jobs';
  }

  /** @param {Job} job */
  #show(job) {
    const state = stateOf(job);
    this.setTitle(job.name);
    if (this.heading) setText(this.heading, job.name);
    if (this.state) {
      setText(this.state, state);
      this.state.className = `state ${state}`;
    }
    if (this.meter) {
      this.meter.className = `meter ${state}`;
      this.meter.setAttribute('aria-valuenow', String(Math.floor(job.progress * 100)));
      const fill = this.meter.firstElementChild;
      if (fill instanceof HTMLElement) fill.style.setProperty('--done', String(job.progress));
    }
    if (this.status) {
      const parts = [percent(job.progress), `${count(job.tiles.done)} of ${counted(job.tiles.total, 'tile')}`, job.frames.total > 1 ? `${count(job.frames.done)} of ${counted(job.frames.total, 'frame')}` : '', timeText(job), job.queue_position ? `place ${job.queue_position} in the queue` : ''];
      setText(this.status, parts.filter((part) => part !== '').join(' · '));
    }
    this.#showFacts(job);
    this.#showMessages(job);
    this.#showActions(job);
  }

  /** @param {Job} job */
  #showFacts(job) {
    const size = this.picture?.viewer.size;
    const samples = this.file?.value(['image', 'samples']);
    const id = h('button', { type: 'button', class: 'link mono small', title: 'Copy the id', on: { click: () => void copy(job.id).then((isDone) => isDone || toast(job.id)) } }, job.id);
    /** @type {[string, string | Node | null][]} */
    const facts = [
      ['Id', id],
      ['Submitter', job.submitter],
      ['Priority', String(job.priority).replace('-', '−')],
      ['Picture', this.isSized && size ? `${size.width} × ${size.height}${typeof samples === 'number' ? `, ${counted(samples, 'sample')}` : ''}` : null],
      ['Frames', job.frames.total > 1 ? `${count(job.frames.total)}${this.film ? `, ${this.film.fps} a second` : ''}` : null],
      ['Kept tiles', job.based_on === null ? null : this.#kept(job, job.based_on)],
      ['Recorded', job.based_on === null && job.recorded ? 'its tiles are kept for edits' : null],
      ['Submitted', dateTime(job.created_at)],
      ['Started', job.started_at ? dateTime(job.started_at) : null],
      ['Finished', job.finished_at ? dateTime(job.finished_at) : null],
      ['Took', job.started_at && job.finished_at ? duration((Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000) : null],
    ];
    this.facts?.replaceChildren(...facts.flatMap(([name, value]) => (value === null ? [] : [h('dt', {}, name), h('dd', {}, value)])));
  }

  /**
   * The tiles that an edit did not change, with a way to the job before.
   * @param {Job} job
   * @param {string} earlier
   */
  #kept(job, earlier) {
    const link = h('a', { href: `#/jobs/${encodeURIComponent(earlier)}?with=${encodeURIComponent(job.id)}`, title: 'Open it, compared with this job' }, 'the job before');
    return h('span', {}, `${count(job.tiles_kept)} of ${count(job.tiles.total)}, of `, link);
  }

  /** @param {Job} job */
  #showMessages(job) {
    const { messages, file } = this;
    if (!messages || !file) return;
    messages.hidden = job.errors.length + job.warnings.length === 0;
    const item = (/** @type {string} */ kind) => (/** @type {string} */ text) => {
      const line = file.lineOf(text);
      const link = line === null ? null : h('button', { type: 'button', class: 'link', on: { click: () => this.#revealLine(line) } }, `Line ${line}`);
      return h('li', { class: kind }, icon('warning'), h('span', {}, text, ' ', link));
    };
    messages.replaceChildren(
      h('div', { class: 'panel-head' }, h('h2', {}, job.errors.length > 0 ? counted(job.errors.length, 'error') : counted(job.warnings.length, 'warning'))),
      h('ul', {}, ...job.errors.map(item('error')), ...job.warnings.map(item('warning'))),
    );
    const marks = [...job.warnings, ...job.errors].flatMap((message) => {
      const line = file.lineOf(message);
      return line === null ? [] : [{ line, message }];
    });
    file.mark(marks);
  }

  /** @param {number} line */
  #revealLine(line) {
    this.querySelector('#job-file')?.scrollIntoView({ block: 'center' });
    this.file?.view.reveal(line);
    this.file?.view.element.focus({ preventScroll: true });
  }

  /** @param {Job} job */
  #showActions(job) {
    const { actions } = this;
    if (!actions) return;
    const shown = /** @type {ActionName[]} */ (['pause', 'resume', 'cancel', 'retry']).filter((name) => isPossible(name, [job]));
    const hasPicture = job.frames.done > 0;
    const key = `${shown.join(' ')} ${hasPicture} ${session.caller?.scope}`;
    if (actions.dataset['key'] === key) return;
    actions.dataset['key'] = key;
    const button = (/** @type {string} */ label, /** @type {import('/ui/parts/icons.js').IconName} */ name, /** @type {(event: MouseEvent) => void} */ run, kind = '') => h('button', { type: 'button', class: `button ${kind}`, title: label, on: { click: run } }, icon(name), h('span', {}, label));
    const more = button('More', 'more', () => this.#openMore(more));
    more.setAttribute('aria-haspopup', 'menu');
    more.setAttribute('aria-expanded', 'false');
    const children = [
      ...shown.map((name) => button(ACTIONS[name].label, ACTIONS[name].icon, () => void this.#act(name))),
      h('a', { class: 'button', href: `#/studio?job=${job.id}`, title: 'Edit a copy in the studio (e)' }, icon('edit'), h('span', {}, 'Edit a copy')),
      hasPicture ? button('Verify', 'shield', (event) => void this.#verify(/** @type {HTMLButtonElement} */ (event.currentTarget))) : null,
      hasPicture ? button('Download', 'download', () => void this.#downloadPicture(), 'primary') : null,
      more,
    ];
    actions.replaceChildren(...children.filter((child) => child !== null));
  }

  /** @param {HTMLElement} anchor */
  #openMore(anchor) {
    const { job, film } = this;
    if (!job || !film) return;
    const bulk = /** @type {ActionName[]} */ (['priority', 'first', 'move', 'delete']).filter((name) => isPossible(name, [job]));
    openMenu(anchor, [
      { label: 'Share a link…', icon: 'link', run: () => void share(job, film.current, film.frame?.state === 'stored') },
      ...(job.frames.total > 1 ? [/** @type {const} */ ({ label: 'Download all frames', icon: 'download', isDisabled: job.frames.done === 0, run: () => void download(`/v1/jobs/${job.id}/frames.zip`, `${fileName(job.name)}.zip`, job.frames.done < job.frames.total ? { partial: true } : {}) })] : []),
      { label: 'Download the job file', icon: 'download', run: () => this.#downloadFile() },
      ...(bulk.length > 0 ? [null] : []),
      ...bulk.map((name) => ({ label: `${ACTIONS[name].label}${name === 'first' ? '' : '…'}`, icon: ACTIONS[name].icon, isDanger: name === 'delete', run: () => void this.#act(name) })),
    ]);
  }

  /** @param {ActionName} name */
  async #act(name) {
    if (this.job === null || !isPossible(name, [this.job])) return;
    const others = name === 'move' ? await this.#waiting() : [];
    await act(name, [this.job], {
      changed: (job) => job && this.#take(job),
      deleted: () => (location.hash = '#/jobs'),
      others: () => others,
    });
  }

  /** @returns {Promise<Job[]>} */
  async #waiting() {
    const pages = await Promise.all(['running', 'queued'].map((state) => getJson('/v1/jobs', { query: { state, limit: 200 }, signal: this.signal })));
    return pages.flatMap((page) => page.jobs);
  }

  /** @param {HTMLButtonElement} button */
  async #verify(button) {
    const { job, film } = this;
    if (!job || !film) return;
    if (film.frame?.state !== 'stored') {
      toast('This frame is not stored yet.', { kind: 'error' });
      return;
    }
    button.disabled = true;
    button.classList.add('busy');
    try {
      /** @type {number | null | undefined} */
      let tiles;
      while (tiles !== null) {
        const result = await verify(job.id, film.current, this.signal, tiles);
        this.#differs = result.differs.map((rectangle) => ({ ...rectangle, kind: 'differs', title: 'These pixels differ from the job' }));
        this.#mark();
        tiles = await showVerification(result, film.frame?.file ?? job.name);
      }
    } catch (error) {
      toastError('The picture could not be verified', error);
    }
    button.disabled = false;
    button.classList.remove('busy');
  }

  #downloadPicture() {
    const { job, film } = this;
    if (!job || !film) return;
    const frame = film.frame;
    if (frame?.state === 'stored') return download(`/v1/jobs/${job.id}/frames/${frame.number}/image`, frame.file ?? `${fileName(job.name)}.png`);
    return download(`/v1/jobs/${job.id}/frames/${film.current}/preview`, `${fileName(job.name)}-preview.png`, { width: 2048 });
  }

  #downloadFile() {
    if (this.job) void download(`/v1/jobs/${this.job.id}/file`, `${fileName(this.job.name)}.json`);
  }

  async #copyFile() {
    if (this.file?.text && !(await copy(this.file.text))) toast('The browser does not allow it here: download the file.', { kind: 'error' });
  }

  #fileRead() {
    const { file, film, picture, job } = this;
    if (!file || !film || !picture || !job) return;
    const [width, height, fps] = [['image', 'width'], ['image', 'height'], ['frames', 'fps']].map((path) => file.value(path));
    if (typeof width === 'number' && typeof height === 'number' && width > 0 && height > 0) {
      this.isSized = true;
      picture.setSize(width, height);
    }
    if (typeof fps === 'number' && fps > 0) film.fps = Math.min(60, fps);
    this.#show(job);
    this.#mark();
  }

  /** @param {number} number */
  #frameChosen(number) {
    const { film, picture } = this;
    if (!film || !picture || film.isPlaying) return;
    picture.show(number, film.frame);
    this.#differs = [];
    this.#keepPlace();
    if (this.tileScope?.value === 'one') this.#planTiles(0);
    else this.#mark();
  }

  /** @param {Tile} tile */
  #tileChosen(tile) {
    this.film?.choose(tile.frame);
    this.picture?.viewer.element.scrollIntoView({ block: 'nearest' });
    this.picture?.viewer.setMarks([{ x: tile.x, y: tile.y, width: tile.width, height: tile.height, kind: 'leased', title: 'The chosen tile' }]);
  }

  /** Keeps frame and comparison in the address, so that it can be shared. */
  #keepPlace() {
    const here = `#/jobs/${this.#id}`;
    // Another room may have been asked for, and not have been entered yet.
    if (location.hash.split('?')[0] !== here) return;
    const query = new URLSearchParams();
    if (this.film && this.film.current > 0) query.set('frame', String(this.film.current));
    if (this.picture?.other) query.set('with', this.picture.other.id);
    const text = query.toString();
    history.replaceState(null, '', `${here}${text === '' ? '' : `?${text}`}`);
  }

  /** @param {string} id */
  async #compareWith(id) {
    try {
      this.picture?.setOther(await getJson(`/v1/jobs/${encodeURIComponent(id)}`, { signal: this.signal }));
    } catch (error) {
      toastError('The other job could not be read', error);
    }
  }

  #follow() {
    if (this.#isFollowing || this.job === null) return;
    this.#isFollowing = true;
    void follow(`/v1/jobs/${this.job.id}/events`, { signal: this.signal, onMessage: (message) => this.#heard(message) }).finally(() => {
      this.#isFollowing = false;
      if (!this.signal.aborted) void this.#readJob();
    });
  }

  /** @param {import('/ui/events.js').Message} message */
  #heard({ event, data }) {
    const { job, film, picture } = this;
    if (!job || !film || !picture) return;
    const value = JSON.parse(data);
    if (event === 'progress') {
      this.#take({ ...job, progress: Math.max(job.progress, value.progress), tiles: value.tiles });
    } else if (event === 'tile') {
      if (value.frame === film.current) picture.changed();
      this.#planTiles();
    } else if (event === 'frame') {
      film.update(value.frame, { state: 'stored', picture: value.picture, size_bytes: value.size_bytes, image: value.image });
      void this.#frameStored(value.frame);
    } else if (event === 'state' || event === 'snapshot') {
      void this.#readJob();
      this.#planTiles();
    }
  }

  async #readJob() {
    try {
      this.#take(await getJson(`/v1/jobs/${this.#id}`, { signal: this.signal }));
    } catch (error) {
      if (error instanceof Problem && error.status === 404) this.#gone();
    }
  }

  /** @param {number} number */
  async #frameStored(number) {
    const { film, picture } = this;
    if (!film || !picture || number !== film.current || film.isPlaying) return;
    // The file's name is not in the event.
    const page = await getJson(`/v1/jobs/${this.#id}/frames`, { query: { limit: 1, cursor: number }, signal: this.signal }).catch(() => null);
    const frame = page?.frames.find((/** @type {{number: number}} */ each) => each.number === number);
    if (frame) film.update(number, frame);
    picture.show(number, film.frame);
  }

  /** @param {number} [wait] */
  #planTiles(wait = Math.max(0, this.#lastTiles + TILES_MS - performance.now())) {
    if (this.tiles?.isAbsent) return;
    clearTimeout(this.#tilesTimer);
    this.#tilesTimer = setTimeout(() => void this.#readTiles(), wait);
  }

  async #readTiles() {
    this.#lastTiles = performance.now();
    await this.tiles?.read(this.tileScope?.value === 'all' ? null : (this.film?.current ?? 0));
  }

  /** Draws the rectangles that are being rendered, and those that differ. */
  #mark() {
    const { tiles, picture, film } = this;
    if (!tiles || !picture || !film) return;
    const leased = this.showTiles?.checked ? tiles.tiles.filter((tile) => tile.state === 'leased' && tile.frame === film.current) : [];
    const marks = leased.map((tile) => {
      const lease = tile.leases.find((each) => each.ended_at === null);
      return { x: tile.x, y: tile.y, width: tile.width, height: tile.height, kind: /** @type {const} */ ('leased'), title: lease ? `Rendered by ${lease.worker_name} (${lease.device})` : 'Being rendered' };
    });
    picture.viewer.setMarks([...marks, ...this.#differs]);
  }

  #addShortcuts() {
    const group = 'Job';
    const film = () => /** @type {FilmStrip} */ (this.film);
    const hasFilm = (this.job?.frames.total ?? 1) > 1;
    addShortcuts(
      [
        ...(hasFilm
          ? [
              { keys: 'k', text: 'Play, stop', group, run: () => film().toggle() },
              { keys: ',', text: 'Previous frame', group, run: () => (film().stop(), film().choose(film().current - 1)) },
              { keys: '.', text: 'Next frame', group, run: () => (film().stop(), film().choose(film().current + 1)) },
              { keys: 'l', text: 'Loop', group, run: () => film().setLooping(!film().isLooping) },
            ]
          : []),
        { keys: '+', text: 'Zoom in (− out, 0 fits, 1 one to one)', group, run: () => this.picture?.viewer.zoom(1.5) },
        { keys: '-', text: 'Zoom out', group, run: () => this.picture?.viewer.zoom(1 / 1.5) },
        { keys: '0', text: 'Fit the picture', group, run: () => this.picture?.viewer.fit() },
        { keys: '1', text: 'One to one', group, run: () => this.picture?.viewer.actual() },
        { keys: 'Shift+ArrowRight', text: 'Read the value of a pixel, with the focus on the picture', group },
        { keys: 'w', text: 'Compare with another job', group, run: () => void this.picture?.compare() },
        { keys: 'e', text: 'Edit a copy', group, run: () => (location.hash = `#/studio?job=${this.#id}`) },
        { keys: 'd', text: 'Download the picture', group, run: () => void this.#downloadPicture() },
        { keys: 'p', text: 'Pause', group, run: () => void this.#act('pause') },
        { keys: 'u', text: 'Resume', group, run: () => void this.#act('resume') },
        { keys: 'c', text: 'Cancel…', group, run: () => void this.#act('cancel') },
        { keys: 'r', text: 'Retry', group, run: () => void this.#act('retry') },
        { keys: 'y', text: 'Priority…', group, run: () => void this.#act('priority') },
        { keys: 'Delete', text: 'Delete…', group, run: () => void this.#act('delete') },
      ],
      this.signal,
    );
  }
}

customElements.define('room-job', JobRoom);
