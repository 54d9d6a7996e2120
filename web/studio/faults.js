// Checks the text at the server while it is written: its errors, its warnings, and what it would take to render it.

import { Problem, isAbort } from '/ui/api.js';
import { markOf, markOfWarning } from './places.js';
import { check } from './server.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {import('./server.js').DryRun} DryRun */
/** @typedef {import('./places.js').Mark} Mark */
/** @typedef {{marks: Mark[], plan: DryRun | null, state: 'valid' | 'invalid' | 'unknown', message: string}} Result */

/** Time without a change after which the text is checked. */
const QUIET_MS = 250;
const LARGE_QUIET_MS = 1200;
const LARGE_CHARS = 1 << 20;
const RETRY_MS = 3000;

/** Checks the newest text, and says what it found. Events: `result` with a `Result`. */
export class Checker extends EventTarget {
  #timer = 0;
  /** @type {AbortController | null} */
  #running = null;

  /**
   * @param {() => string} text
   * @param {() => JsonNode | null} tree
   */
  constructor(text, tree) {
    super();
    this.text = text;
    this.tree = tree;
  }

  /** The text has changed. */
  changed() {
    this.#running?.abort();
    this.#plan(this.text().length > LARGE_CHARS ? LARGE_QUIET_MS : QUIET_MS);
  }

  /** Checks at once. */
  now() {
    this.#plan(0);
  }

  /** @param {number} milliseconds */
  #plan(milliseconds) {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => void this.#check(), milliseconds);
  }

  async #check() {
    this.#running?.abort();
    const running = new AbortController();
    this.#running = running;
    const text = this.text();
    try {
      const plan = await check(text, running.signal);
      const tree = this.tree();
      this.#tell({ marks: plan.warnings.map((warning) => markOfWarning(tree, warning)), plan, state: 'valid', message: '' });
    } catch (error) {
      if (isAbort(error) || running.signal.aborted) return;
      if (error instanceof Problem && error.errors.length > 0) {
        this.report(text, error);
      } else {
        const message = error instanceof Error ? error.message : String(error);
        this.#tell({ marks: [], plan: null, state: 'unknown', message });
        if (!(error instanceof Problem) || error.status === 0 || error.status >= 500 || error.status === 429) this.#plan(RETRY_MS);
      }
    } finally {
      if (this.#running === running) this.#running = null;
    }
  }

  /**
   * Another request was answered with the text's errors.
   * @param {string} text
   * @param {Problem} problem
   */
  report(text, problem) {
    const tree = this.tree();
    this.#tell({ marks: problem.errors.map((fault) => markOf(text, tree, fault)), plan: null, state: 'invalid', message: '' });
  }

  /** @param {Result} result */
  #tell(result) {
    this.dispatchEvent(new CustomEvent('result', { detail: result }));
  }

  stop() {
    clearTimeout(this.#timer);
    this.#running?.abort();
  }
}
