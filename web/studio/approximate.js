// The approximate picture: drawn by the browser's GPU while something moves. The server prints the scene as a program once for
// each structure; while only numbers change, only numbers are sent.

import { Problem, isAbort, messageOf } from '/ui/api.js';
import { shader } from './server.js';

/** @typedef {import('./gpu.js').Renderer} Renderer */
/** @typedef {{text: string, frame: number, width: number, isShown: boolean}} Wanted Not shown, it is only made ready. */

/** Times after which the GPU is not used for a scene. */
const LIMITS = { compileMs: 10_000, drawMs: 1000 };
/** Longest program that is compiled, in characters: that of `carousel` has 1.7 million. */
const MOST_PROGRAM_CHARS = 2 << 20;
/** A GPU that needs longer for a picture gets a smaller one, and one that is fast a larger one. */
const SLOW_MS = 60;
const FAST_MS = 14;
/** Widths of the first picture of a program, of pictures of a slow GPU, and of large ones, in pixels. */
const FIRST_WIDTH = 64;
const LEAST_WIDTH = 160;
const MOST_WIDTH = 1280;
/** Pictures grow to the width of a slow GPU's if that is expected to take less than this. */
const SMALL_MS = LIMITS.drawMs / 2;
/** Times that the GPU is started again after it was lost. */
const MOST_LOSSES = 3;
const LOST = 'the GPU was lost';

/** Draws the newest request. Events: `picture`, `state`, `stop` with the reason why the GPU stops to draw a scene. */
export class Approximate extends EventTarget {
  /** @type {Renderer | null} */
  #renderer = null;
  /** @type {Wanted | null} */
  #wanted = null;
  /** The newest request, until nothing is to be drawn. */
  /** @type {Wanted | null} */
  #newest = null;
  #isRunning = false;
  /** @type {string | null} */
  #program = null;
  /** Width that pictures of the program may have, by the times of those before. */
  #width = FIRST_WIDTH;
  #losses = 0;
  /** Programs that this GPU does not draw, each with the reason. */
  /** @type {Map<string, string>} */
  #refused = new Map();
  /** Whether the text that was asked last is not drawn here. */
  #isRefused = false;
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
      /** @type {Renderer | null} */
      let renderer = null;
      const onLost = () => renderer === this.#renderer && this.#lost(LOST);
      renderer = await createRenderer({ canvas: this.canvas, onLost, limits: LIMITS });
      if (this.#controller.signal.aborted) renderer?.destroy();
      else this.#renderer = renderer;
      if (renderer === null) this.#say('this machine’s GPU can’t be used');
      else if (!this.#isRefused) this.#say(null);
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

  /**
   * The GPU was lost, or left: it is started again.
   * @param {string} reason
   */
  #lost(reason) {
    this.#renderer = null;
    this.#program = null;
    this.#losses += 1;
    this.#say(reason);
    if (this.#losses < MOST_LOSSES) void this.start();
  }

  /** Whether pictures can be drawn. */
  get isReady() {
    return this.#renderer !== null && this.#losses < MOST_LOSSES;
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
    // A text that is refused is asked again when it rests: then it may have changed in more than numbers.
    if (wanted.isShown && this.#isRefused) return;
    this.#wanted = wanted;
    this.#newest = wanted;
    if (!this.#isRunning && this.isReady) void this.#run();
  }

  /** Draws nothing more. */
  pause() {
    this.#wanted = null;
    this.#newest = null;
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
    const width = Math.max(1, Math.round(Math.min(wanted.width, this.#width)));
    const known = this.#program ?? [...this.#refused.keys()].at(-1) ?? null;
    const answer = await shader(wanted.text, { frame: wanted.frame, width, samples: 1, program: known }, this.#controller.signal);
    const refusal = answer.reason ?? this.#refused.get(answer.program) ?? null;
    if (refusal !== null) {
      this.#refuse(refusal);
      return;
    }
    try {
      await this.#compile(renderer, answer);
      await this.#render(renderer, wanted, answer);
    } catch (error) {
      if (this.#controller.signal.aborted) return;
      const reason = error instanceof Error ? error.message : String(error);
      this.#giveUp(answer.program, reason);
      if (renderer.isLost && renderer === this.#renderer) this.#lost(reason);
    }
  }

  /**
   * @param {Renderer} renderer
   * @param {import('./server.js').Shader} answer
   */
  async #compile(renderer, { program, wgsl }) {
    if (wgsl !== null) {
      if (wgsl.length > MOST_PROGRAM_CHARS) throw new Error('the program of this scene is too long for a GPU');
      this.#program = null;
      this.#width = FIRST_WIDTH;
      await renderer.setProgram(wgsl);
      if (renderer.isLost) throw new Error(LOST);
      this.#program = program;
    }
    this.#isRefused = false;
    this.#say(null);
  }

  /**
   * Draws a picture. One that is not shown tells how large a picture may be while something is dragged.
   * @param {Renderer} renderer
   * @param {Wanted} wanted
   * @param {import('./server.js').Shader} answer
   */
  async #render(renderer, wanted, answer) {
    const begin = performance.now();
    renderer.setSize(answer.width, answer.height);
    renderer.setNumbers(answer.uniforms, answer.table);
    const isDrawn = await renderer.draw({ samples: answer.samples });
    if (renderer.isLost) throw new Error(LOST);
    if (!isDrawn) return;
    const milliseconds = performance.now() - begin;
    const hasGrown = this.#learn(milliseconds, wanted.width);
    if (wanted.isShown) this.dispatchEvent(new CustomEvent('picture', { detail: { wanted, width: answer.width, milliseconds } }));
    else if (hasGrown && this.#newest === wanted) this.#wanted = wanted;
  }

  /**
   * Learns from the time of a picture how large the next may be; true if it may be larger.
   * @param {number} milliseconds
   * @param {number} wantedWidth
   */
  #learn(milliseconds, wantedWidth) {
    const before = this.#width;
    const next = Math.min(MOST_WIDTH, wantedWidth, before * 2);
    const small = Math.min(LEAST_WIDTH, next);
    if (milliseconds < FAST_MS) this.#width = Math.max(before, next);
    else if (before < small && milliseconds * (small / before) ** 2 < SMALL_MS) this.#width = small;
    else if (milliseconds > SLOW_MS && before > LEAST_WIDTH) this.#width = Math.max(LEAST_WIDTH, before * 0.8);
    return this.#width > before;
  }

  /**
   * Does not draw a program any more.
   * @param {string} program
   * @param {string} reason
   */
  #giveUp(program, reason) {
    if (this.#refused.has(program)) return;
    this.#refused.set(program, reason);
    this.#program = null;
    this.#refuse(reason);
    this.dispatchEvent(new CustomEvent('stop', { detail: reason }));
  }

  /**
   * Does not draw the text: the server's previews are shown.
   * @param {string} reason
   */
  #refuse(reason) {
    this.#isRefused = true;
    this.#say(reason);
  }

  /** @param {unknown} error */
  #failed(error) {
    if (!(error instanceof Problem)) {
      this.#refuse(messageOf(error));
      return;
    }
    // The exact picture shows an invalid text; the page, a server that does not answer.
    if (error.errors.length > 0 || error.status === 0) return;
    if (error.isUnknownRoute) this.#losses = MOST_LOSSES;
    const isTemporary = error.status >= 500 || error.status === 429;
    if (isTemporary) this.#say(messageOf(error));
    else this.#refuse(messageOf(error));
  }

  stop() {
    this.pause();
    this.#controller.abort();
    this.#renderer?.destroy();
    this.#renderer = null;
  }
}
