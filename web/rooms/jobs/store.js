// The jobs that are seen: read by pages, kept true by the farm's events, filtered and sorted.

import { getJson } from '/ui/api.js';
import { farmEvents } from '/ui/events.js';

/** @typedef {import('/ui/types.js').Job} Job */
/** @typedef {import('/ui/types.js').JobState} JobState */
/** @typedef {import('/ui/types.js').JobPage} JobPage */
/** @typedef {'newest' | 'name' | 'state' | 'progress' | 'left' | 'submitter' | 'priority' | 'frames' | 'queue'} SortKey */

const FIRST_PAGE = 200;
const PAGE = 1000;

const STATE_ORDER = { running: 0, queued: 1, failed: 2, cancelled: 3, succeeded: 4 };
/** Sorts jobs without a number last. */
const LAST = Number.MAX_SAFE_INTEGER;

/** Orders text as people do. */
const TEXT = new Intl.Collator('en', { numeric: true, sensitivity: 'base' });

/** @type {Record<SortKey, (a: Job, b: Job) => number>} */
const ORDERS = {
  newest: (a, b) => (a.id < b.id ? 1 : a.id > b.id ? -1 : 0),
  name: (a, b) => TEXT.compare(a.name, b.name),
  state: (a, b) => STATE_ORDER[a.state] - STATE_ORDER[b.state] || Number(a.paused) - Number(b.paused),
  progress: (a, b) => b.progress - a.progress,
  left: (a, b) => (a.eta_seconds ?? LAST) - (b.eta_seconds ?? LAST),
  submitter: (a, b) => TEXT.compare(a.submitter, b.submitter),
  priority: (a, b) => b.priority - a.priority,
  frames: (a, b) => b.frames.total - a.frames.total,
  queue: (a, b) => (a.queue_position ?? LAST) - (b.queue_position ?? LAST),
};

/** Tells of changes by `change`; `shown` is what is seen, in its order. */
export class JobStore extends EventTarget {
  /** @type {Map<string, Job>} */
  #jobs = new Map();
  /** @type {string | null} */
  #cursor = null;
  #isPlanned = false;
  /** Number of the newest reading. */
  #reading = 0;
  /** The first reading that may be shown: answers to older ones are dropped. */
  #oldestShown = 0;
  /** @type {AbortSignal} */
  #signal;
  /** @type {Job[]} */
  shown = [];
  /** @type {JobState | null} */
  state = null;
  filter = '';
  /** @type {{key: SortKey, isReversed: boolean}} */
  sort = { key: 'newest', isReversed: false };
  isLoading = false;
  /** @type {unknown} The error of the last reading. */
  error = null;
  /** Whether something has been read. */
  isRead = false;

  /**
   * Jobs that changed while the list was read; null for those that were deleted.
   * @type {Map<string, Job | null>}
   */
  #arrived = new Map();

  /** @param {AbortSignal} signal */
  constructor(signal) {
    super();
    this.#signal = signal;
    const options = { signal };
    farmEvents.addEventListener('job', (event) => this.#take(/** @type {CustomEvent<Job>} */ (event).detail), options);
    farmEvents.addEventListener('deleted', (event) => this.remove(/** @type {CustomEvent<string>} */ (event).detail), options);
    farmEvents.addEventListener('open', () => void this.read(), options);
  }

  /** Number of jobs that have been read. */
  get size() {
    return this.#jobs.size;
  }

  /** Whether the server has more. */
  get hasMore() {
    return this.#cursor !== null;
  }

  /** @param {string} id */
  get(id) {
    return this.#jobs.get(id);
  }

  /** Reads the list from its start, as far as it had been read. */
  async read() {
    this.#reading += 1;
    const reading = this.#reading;
    const wanted = Math.max(FIRST_PAGE, this.#jobs.size);
    /** @type {Map<string, Job>} */
    const jobs = new Map();
    this.isLoading = true;
    this.#changed();
    try {
      /** @type {string | null} */
      let cursor = null;
      do {
        /** @type {JobPage} */
        const page = await this.#page(cursor, Math.min(PAGE, wanted - jobs.size));
        if (reading < this.#oldestShown) return;
        for (const job of page.jobs) jobs.set(job.id, job);
        cursor = page.next_cursor;
      } while (cursor !== null && jobs.size < wanted);
      // The stream's start asks for another reading; this one is shown until that one arrives.
      this.#oldestShown = reading;
      this.#jobs = jobs;
      this.#cursor = cursor;
      this.error = null;
      this.isRead = true;
      // Changes that arrived meanwhile may be newer than the list.
      const arrived = [...this.#arrived];
      if (reading === this.#reading) this.#arrived.clear();
      for (const [id, job] of arrived) {
        if (job === null) this.#jobs.delete(id);
        else this.#apply(job);
      }
    } catch (error) {
      if (this.#signal.aborted) return;
      this.error = error;
    }
    this.isLoading = reading !== this.#reading;
    this.#changed();
  }

  /** Reads the next page. */
  async readMore() {
    if (this.isLoading || this.#cursor === null) return;
    const reading = this.#reading;
    this.isLoading = true;
    this.#changed();
    try {
      const page = await this.#page(this.#cursor, PAGE);
      if (reading !== this.#reading) return;
      for (const job of page.jobs) this.#jobs.set(job.id, job);
      this.#cursor = page.next_cursor;
      this.error = null;
    } catch (error) {
      if (this.#signal.aborted) return;
      this.error = error;
    }
    this.isLoading = false;
    this.#changed();
  }

  /**
   * @param {string | null} cursor
   * @param {number} limit
   * @returns {Promise<JobPage>}
   */
  #page(cursor, limit) {
    return getJson('/v1/jobs', { query: { limit, cursor, state: this.state }, signal: this.#signal });
  }

  /** Asks the server for jobs of this name or id, which may not have been read. */
  async find() {
    const text = this.filter.trim();
    if (text.length < 3 || this.#cursor === null) return;
    const page = /** @type {JobPage} */ (await getJson('/v1/jobs', { query: { match: text, limit: 100 }, signal: this.#signal }));
    for (const job of page.jobs) if (this.state === null || job.state === this.state) this.#jobs.set(job.id, job);
    this.#changed();
  }

  /** @param {JobState | null} state */
  setState(state) {
    this.state = state;
    this.#jobs.clear();
    this.#cursor = null;
    this.#oldestShown = this.#reading + 1;
    void this.read();
  }

  /** @param {string} text */
  setFilter(text) {
    this.filter = text;
    this.#changed();
  }

  /** @param {{key: SortKey, isReversed: boolean}} sort */
  setSort(sort) {
    this.sort = sort;
    this.#changed();
  }

  /**
   * Takes a job as it is now, from an event or from the answer to a change.
   * @param {Job} job
   */
  #take(job) {
    if (this.isLoading) this.#arrived.set(job.id, job);
    this.#apply(job);
  }

  /** @param {Job} job */
  #apply(job) {
    const fits = this.state === null || job.state === this.state;
    if (!fits) {
      if (this.#jobs.delete(job.id)) this.#changed();
      return;
    }
    // A job older than the last page belongs to a later one.
    if (!this.#jobs.has(job.id) && this.#cursor !== null && job.id < this.#oldest()) return;
    this.#jobs.set(job.id, { ...this.#jobs.get(job.id), ...job });
    this.#changed();
  }

  #oldest() {
    let oldest = '~';
    for (const id of this.#jobs.keys()) if (id < oldest) oldest = id;
    return oldest;
  }

  /** @param {Job | null} job */
  put(job) {
    if (job !== null) this.#take(job);
  }

  /** @param {string} id */
  remove(id) {
    if (this.isLoading) this.#arrived.set(id, null);
    if (this.#jobs.delete(id)) this.#changed();
  }

  #changed() {
    if (this.#isPlanned) return;
    this.#isPlanned = true;
    requestAnimationFrame(() => {
      this.#isPlanned = false;
      this.#arrange();
      this.dispatchEvent(new Event('change'));
    });
  }

  #arrange() {
    const words = this.filter.trim().toLowerCase().split(/\s+/).filter(Boolean);
    let jobs = [...this.#jobs.values()];
    if (words.length > 0) {
      jobs = jobs.filter((job) => {
        const text = `${job.name} ${job.submitter} ${job.id}`.toLowerCase();
        return words.every((word) => text.includes(word));
      });
    }
    const order = ORDERS[this.sort.key];
    const sign = this.sort.isReversed ? -1 : 1;
    jobs.sort((a, b) => sign * order(a, b) || ORDERS.newest(a, b));
    this.shown = jobs;
  }
}
