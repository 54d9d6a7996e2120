// The exact picture: the newest text at a small size at once, then sharper while nothing changes. Requests of small pictures
// follow each other, so that a drag shows pictures all the time; a sharper one is given up as soon as the text changes.

import { Problem, isAbort } from '/ui/api.js';
import { preview } from './server.js';
import { stages } from './stages.js';

/** @typedef {import('./stages.js').Wanted} Wanted */
/** @typedef {import('./stages.js').Stage} Stage */
/** @typedef {{wanted: Wanted, stage: Stage, blob: Blob, milliseconds: number, isLast: boolean}} Shown `stage` is what was rendered */

/** A first picture that takes longer than this is given up for a newer text. */
const MAX_WAIT_MS = 1500;
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
  /** @type {number | null} */
  #perRay = null;
  #overhead = 8;
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
    } else if (!running.isFirst || performance.now() - running.since > MAX_WAIT_MS) {
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
    let sharpest = 0;
    const list = stages(wanted, this.#perRay, this.#overhead, this.#isDrag, this.aspect);
    for (const [index, stage] of list.entries()) {
      const controller = new AbortController();
      const since = performance.now();
      this.#running = { controller, isFirst: index === 0, since };
      this.dispatchEvent(new Event('state'));
      try {
        const query = { width: stage.width, frame: wanted.frame, samples: stage.samples, layer: wanted.layer, limit_ms: stage.limitMs };
        const { blob, width, samples } = await preview(wanted.text, query, controller.signal);
        const milliseconds = performance.now() - since;
        const rendered = { ...stage, width, samples };
        this.#learn(rendered, milliseconds);
        this.#failures = 0;
        // One that had to be made smaller than the one before does not replace it.
        if (width < sharpest) break;
        sharpest = width;
        this.dispatchEvent(new CustomEvent('picture', { detail: { wanted, stage: rendered, blob, milliseconds, isLast: index === list.length - 1 } }));
      } catch (error) {
        if (!isAbort(error) && !controller.signal.aborted) this.#fail(wanted, version, error);
        break;
      } finally {
        this.#running = null;
      }
      if (version !== this.#version) break;
    }
    this.dispatchEvent(new Event('state'));
    if (version !== this.#version) void this.#run();
  }

  /**
   * @param {Stage} stage
   * @param {number} milliseconds
   */
  #learn(stage, milliseconds) {
    const rays = stage.width ** 2 * this.aspect * stage.samples;
    this.#overhead = Math.min(this.#overhead + 2, milliseconds, 40);
    const perRay = Math.max(1e-7, (milliseconds - Math.min(this.#overhead, milliseconds / 2)) / rays);
    this.#perRay = this.#perRay === null ? perRay : 0.5 * this.#perRay + 0.5 * perRay;
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
