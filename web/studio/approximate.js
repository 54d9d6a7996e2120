// The approximate picture: drawn by the browser's GPU while something moves. The server prints the scene as a program once for
// each structure; while only numbers change, only numbers are sent.

import { Problem, isAbort } from '/ui/api.js';
import { shader } from './server.js';

/** @typedef {import('./gpu.js').Renderer} Renderer */
/** @typedef {{text: string, frame: number, width: number, isShown: boolean}} Wanted Not shown, it is only made ready. */

/** A GPU that needs longer for a picture gets a smaller one. */
const SLOW_MS = 60;
const FAST_MS = 14;
const LEAST_WIDTH = 160;
const MOST_WIDTH = 1280;
/** Programs that are not tried again after an error. */
const MOST_ERRORS = 3;

/** Draws the newest request. Events: `picture`, `state`. */
export class Approximate extends EventTarget {
  /** @type {Renderer | null} */
  #renderer = null;
  /** @type {Wanted | null} */
  #wanted = null;
  #isRunning = false;
  /** @type {string | null} */
  #program = null;
  #scale = 0.75;
  #errors = 0;
  /** Why this scene is not drawn here, or null. */
  /** @type {string | null} */
  reason = 'starting';
  /** @type {AbortController} */
  #controller = new AbortController();

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super();
    this.canvas = canvas;
  }

  /** Starts the GPU, if there is one. */
  async start() {
    if (!('gpu' in navigator) || !navigator.gpu) {
      this.#say(isSecureContext ? 'this browser has no WebGPU' : 'WebGPU needs https or this machine’s own address');
      return;
    }
    try {
      const { createRenderer } = await import('./gpu.js');
      this.#renderer = await createRenderer({ canvas: this.canvas, onLost: () => this.#lost() });
      this.#say(this.#renderer === null ? 'this machine’s GPU can’t be used' : null);
    } catch (error) {
      this.#say(error instanceof Error ? error.message : String(error));
    }
  }

  /** @param {string | null} reason */
  #say(reason) {
    if (this.reason === reason) return;
    this.reason = reason;
    this.dispatchEvent(new Event('state'));
  }

  #lost() {
    this.#renderer = null;
    this.#program = null;
    this.#errors += 1;
    this.#say('the GPU was lost');
    if (this.#errors < MOST_ERRORS) void this.start();
  }

  /** Whether pictures can be drawn. */
  get isReady() {
    return this.#renderer !== null && this.#errors < MOST_ERRORS;
  }

  /** Whether a program is ready, so that a picture comes at once. */
  get isWarm() {
    return this.#program !== null && this.reason === null;
  }

  /**
   * Draws this text as soon as the one before is drawn.
   * @param {Wanted} wanted
   */
  show(wanted) {
    this.#wanted = wanted;
    if (!this.#isRunning && this.isReady) void this.#run();
  }

  /** Draws nothing more. */
  pause() {
    this.#wanted = null;
  }

  async #run() {
    this.#isRunning = true;
    try {
      while (this.#wanted !== null && this.#renderer !== null) {
        const wanted = this.#wanted;
        this.#wanted = null;
        await this.#draw(this.#renderer, wanted);
      }
    } catch (error) {
      if (!isAbort(error)) this.#failed(error);
    } finally {
      this.#isRunning = false;
    }
  }

  /**
   * @param {Renderer} renderer
   * @param {Wanted} wanted
   */
  async #draw(renderer, wanted) {
    const width = Math.round(Math.min(MOST_WIDTH, Math.max(LEAST_WIDTH, wanted.width * this.#scale)));
    const answer = await shader(wanted.text, { frame: wanted.frame, width, samples: 1, program: this.#program }, this.#controller.signal);
    if (answer.reason !== null) {
      this.#say(answer.reason);
      return;
    }
    if (answer.wgsl !== null) {
      this.#program = null;
      await renderer.setProgram(answer.wgsl);
      this.#program = answer.program;
    }
    this.#say(null);
    if (!wanted.isShown) return;
    const begin = performance.now();
    renderer.setSize(answer.width, answer.height);
    renderer.setNumbers(answer.uniforms, answer.table);
    const isDrawn = await renderer.draw({ samples: answer.samples });
    const milliseconds = performance.now() - begin;
    if (milliseconds > SLOW_MS) this.#scale = Math.max(0.15, this.#scale * 0.8);
    else if (milliseconds < FAST_MS) this.#scale = Math.min(1, this.#scale * 1.1);
    if (isDrawn) this.dispatchEvent(new CustomEvent('picture', { detail: { wanted, width: answer.width, milliseconds } }));
  }

  /** @param {unknown} error */
  #failed(error) {
    // The exact picture shows an invalid text; the page, a server that does not answer.
    if (error instanceof Problem && (error.errors.length > 0 || error.status === 0)) return;
    this.#program = null;
    if (error instanceof Problem && error.isUnknownRoute) this.#errors = MOST_ERRORS;
    else this.#errors += 1;
    this.#say(error instanceof Error ? error.message : String(error));
  }

  stop() {
    this.pause();
    this.#controller.abort();
    this.#renderer?.destroy();
    this.#renderer = null;
  }
}
