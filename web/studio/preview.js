// The exact picture: the newest text at a small size at once, then sharper while nothing changes. Requests of small pictures
// follow each other, so that a drag shows pictures all the time; a sharper one is given up as soon as the text changes.

import { Problem } from '/ui/api.js';
import { preview } from './server.js';
import { FIRST_LIMIT_MS, LIMIT_MS, sharper, stages } from './stages.js';

/** @typedef {import('./stages.js').Wanted} Wanted */
/** @typedef {import('./stages.js').Stage} Stage */
/** @typedef {{wanted: Wanted, stage: Stage, blob: Blob, milliseconds: number}} Shown `stage` is what was rendered */

/** A first picture that takes longer than this is given up for a newer text. */
const MAX_WAIT_MS = 1500;
/** After a failure that took longer than this, the server has tried all that it can. */
const MOST_FAILED_MS = 2 * LIMIT_MS;
/** Overhead of a request for a scene that takes no time to prepare. */
const SMALL_OVERHEAD_MS = 40;
const RETRY_MS = [500, 1000, 2000, 4000, 8000];

/** Asks for pictures. Events: `picture` with `Shown`, `problem` with a `Problem` and the text, `state`. */
export class Previewer extends EventTarget {
  /** @type {Wanted | null} */
  #wanted = null;
  #isDrag = false;
  /** Number of the newest request. */
  #version = 0;
  /** @type {{controller: AbortController, isFirst: boolean, since: number} | null} */
  #running = null;
  /** @type {import('./stages.js').Costs} */
  #costs = { perRay: null, overhead: 8, firstLimit: FIRST_LIMIT_MS };
  /** @type {{rays: number, milliseconds: number} | null} The picture before of the same text. */
  #before = null;
  #failures = 0;
  #retry = 0;
  #isStopped = false;
  aspect = 9 / 16;

  /** Whether a request is on its way. */
  get isBusy() {
    return this.#running !== null;
  }

  /**
   * Shows a picture of this text as soon as possible.
   * @param {Wanted} wanted
   * @param {boolean} isDrag whether more changes follow at once
   */
  show(wanted, isDrag) {
    this.#wanted = wanted;
    this.#isDrag = isDrag;
    this.#version += 1;
    clearTimeout(this.#retry);
    const running = this.#running;
    if (running === null) {
      void this.#run();
    } else if (!running.isFirst || performance.now() - running.since > Math.max(MAX_WAIT_MS, 2 * this.#costs.overhead)) {
      running.controller.abort();
    }
  }

  /** Asks for nothing until the next request. */
  pause() {
    this.#wanted = null;
    this.#version += 1;
    clearTimeout(this.#retry);
    this.#running?.controller.abort();
  }

  stop() {
    this.#isStopped = true;
    this.pause();
  }

  async #run() {
    const wanted = this.#wanted;
    if (wanted === null || this.#isStopped) return;
    const version = this.#version;
    const isDrag = this.#isDrag;
    const list = stages(wanted, this.#costs, isDrag, this.aspect);
    let sharpest = 0;
    /** @type {unknown} */
    let error = null;
    this.#before = null;
    for (const [index, stage] of list.entries()) {
      // Where one sample was too much, more are.
      if (stage.samples > 1 && sharpest < stage.width) continue;
      const answer = await this.#ask(wanted, stage, { version, isFirst: index === 0, sharpest });
      error = answer.error;
      if (version !== this.#version || (error !== null && !mayHaveMoreTime(error, answer.milliseconds))) break;
      sharpest = Math.max(sharpest, answer.width);
    }
    if (!isDrag && version === this.#version && (error === null || isTooSlow(error))) sharpest = await this.#refine(wanted, version, sharpest);
    this.dispatchEvent(new Event('state'));
    if (version !== this.#version) void this.#run();
    else if (error !== null && !(sharpest > 0 && isTooSlow(error))) this.#fail(wanted, version, error);
  }

  /**
   * Asks for wider and wider pictures, as long as the server renders all of their pixels; resolves to the width of the last.
   * @param {Wanted} wanted
   * @param {number} version
   * @param {number} sharpest width of the picture that is shown; 0 without one
   */
  async #refine(wanted, version, sharpest) {
    let width = sharpest;
    for (let stage = width === 0 ? null : sharper(width, wanted); stage !== null; stage = sharper(width, wanted)) {
      const answer = await this.#ask(wanted, stage, { version, isFirst: false, sharpest: width });
      if (answer.width < stage.width || version !== this.#version) break;
      width = answer.width;
    }
    return width;
  }

  /**
   * Asks for a picture, and shows it if it is as sharp as the one before.
   * @param {Wanted} wanted
   * @param {Stage} stage
   * @param {{version: number, isFirst: boolean, sharpest: number}} place
   * @returns {Promise<{width: number, error: unknown, milliseconds: number}>} the width that was rendered; 0 after an error
   */
  async #ask(wanted, stage, { version, isFirst, sharpest }) {
    const controller = new AbortController();
    const since = performance.now();
    this.#running = { controller, isFirst, since };
    this.dispatchEvent(new Event('state'));
    const query = { width: stage.width, frame: wanted.frame, samples: stage.samples, layer: wanted.layer, limit_ms: stage.limitMs };
    let result = { width: 0, error: /** @type {unknown} */ (null), milliseconds: 0 };
    try {
      const { blob, width, samples } = await preview(wanted.text, query, controller.signal);
      const milliseconds = performance.now() - since;
      result = { width, error: null, milliseconds };
      this.#failures = 0;
      // A picture that was made smaller took the time of several.
      if (width === stage.width) this.#learn(stage, milliseconds);
      if (width >= sharpest) this.dispatchEvent(new CustomEvent('picture', { detail: { wanted, stage: { ...stage, width, samples }, blob, milliseconds } }));
    } catch (error) {
      result = { width: 0, error, milliseconds: performance.now() - since };
    } finally {
      this.#running = null;
    }
    if (isFirst && version === this.#version) this.#learnLimit(stage, result);
    return result;
  }

  /**
   * Learns what a ray and a request take, by the picture and the smaller one before.
   * @param {Stage} stage
   * @param {number} milliseconds
   */
  #learn(stage, milliseconds) {
    const costs = this.#costs;
    const before = this.#before;
    const rays = stage.width ** 2 * this.aspect * stage.samples;
    let perRay = 0;
    if (before !== null && rays > 2 * before.rays) {
      perRay = (milliseconds - before.milliseconds) / (rays - before.rays);
      costs.overhead = Math.max(0, before.milliseconds - Math.max(0, perRay) * before.rays);
    } else {
      const isLarge = costs.overhead > SMALL_OVERHEAD_MS;
      costs.overhead = Math.min(milliseconds, isLarge ? costs.overhead : Math.min(costs.overhead + 2, SMALL_OVERHEAD_MS));
      perRay = (milliseconds - Math.min(costs.overhead, milliseconds * (isLarge ? 0.95 : 0.5))) / rays;
    }
    this.#before = { rays, milliseconds };
    const known = Math.max(1e-7, perRay);
    costs.perRay = costs.perRay === null ? known : 0.5 * costs.perRay + 0.5 * known;
  }

  /**
   * Learns how much time the server needs for a first picture: a scene of many shapes takes long to prepare.
   * @param {Stage} stage
   * @param {{width: number, error: unknown, milliseconds: number}} result
   */
  #learnLimit(stage, { width, error, milliseconds }) {
    const costs = this.#costs;
    if (error === null ? width < stage.width / 2 : isTooSlow(error)) costs.firstLimit = Math.min(LIMIT_MS, costs.firstLimit * 4);
    else if (milliseconds < costs.firstLimit / 2) costs.firstLimit = Math.max(FIRST_LIMIT_MS, costs.firstLimit / 2);
  }

  /**
   * @param {Wanted} wanted
   * @param {number} version
   * @param {unknown} error
   */
  #fail(wanted, version, error) {
    this.dispatchEvent(new CustomEvent('problem', { detail: { error, text: wanted.text } }));
    const isTemporary = !(error instanceof Problem) || error.status === 0 || error.status >= 500 || error.status === 429;
    if (!isTemporary || version !== this.#version) return;
    const wait = error instanceof Problem && error.retryAfter !== null ? error.retryAfter * 1000 : (RETRY_MS[Math.min(this.#failures, RETRY_MS.length - 1)] ?? 8000);
    this.#failures += 1;
    this.#retry = setTimeout(() => void this.#run(), wait);
  }
}

/**
 * Whether the server could not draw even the smallest picture in time.
 * @param {unknown} error
 */
const isTooSlow = (error) => error instanceof Problem && error.code === 'no_preview';

/**
 * Whether a picture that has failed may succeed with a larger limit.
 * @param {unknown} error
 * @param {number} milliseconds that it took
 */
const mayHaveMoreTime = (error, milliseconds) => isTooSlow(error) && milliseconds < MOST_FAILED_MS;
