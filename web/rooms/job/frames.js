// The film strip: the frames of a job as small pictures, a slider, and playback.

import { getBlob, getJson } from '/ui/api.js';
import { h, oncePerFrame, setText } from '/ui/parts/dom.js';
import { count } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { showThumbnail } from '/ui/parts/thumbnails.js';

/** @typedef {import('/ui/types.js').Frame} Frame */

const CELL = 104;
const PAGE = 1000;
/** Frames read ahead while playing, and kept decoded. */
const AHEAD = 16;
const KEPT = 96;
const PLAY_WIDTH = 960;

/** Tells by `frame` (detail: its number) that another frame is chosen, and by `show` (detail: a bitmap) what playback shows. */
export class FilmStrip extends EventTarget {
  /** @type {Frame[]} */
  frames = [];
  current = 0;
  isPlaying = false;
  isLooping = true;
  fps = 24;
  /** @type {Map<number, Promise<ImageBitmap | null>>} */
  #decoded = new Map();
  /** @type {Map<number, HTMLElement>} */
  #cells = new Map();
  #timer = 0;

  /**
   * @param {string} job
   * @param {AbortSignal} signal
   */
  constructor(job, signal) {
    super();
    this.job = job;
    this.signal = signal;
    this.play = h('button', { type: 'button', class: 'button icon-only', on: { click: () => this.toggle() } });
    this.loop = h('button', { type: 'button', class: 'button icon-only', 'aria-label': 'Loop', title: 'Loop (l)', 'aria-pressed': 'true', on: { click: () => this.setLooping(!this.isLooping) } }, icon('loop'));
    this.slider = h('input', { type: 'range', min: 0, max: 0, value: 0, step: 1, 'aria-label': 'Frame', class: 'grow' });
    this.slider.addEventListener('input', () => this.choose(Number(this.slider.value)));
    this.number = h('span', { class: 'mono nowrap' });
    const step = (/** @type {number} */ by, /** @type {string} */ label, /** @type {'back' | 'next'} */ name) =>
      h('button', { type: 'button', class: 'button icon-only', 'aria-label': label, title: label, on: { click: () => (this.stop(), this.choose(this.current + by)) } }, icon(name));
    this.controls = h('div', { class: 'film-controls' }, step(-1, 'Previous frame (,)', 'back'), this.play, step(1, 'Next frame (.)', 'next'), this.loop, this.slider, this.number);
    this.inner = h('div', { class: 'film-inner' });
    this.strip = h('div', { class: 'film', tabindex: 0, role: 'listbox', 'aria-label': 'Frames' }, this.inner);
    this.strip.addEventListener('keydown', (event) => this.#press(event));
    this.inner.addEventListener('click', (event) => {
      const cell = event.target instanceof Element ? event.target.closest('.film-cell') : null;
      if (cell instanceof HTMLElement) this.choose(Number(cell.dataset['frame']));
    });
    this.draw = oncePerFrame(() => this.#draw());
    this.strip.addEventListener('scroll', this.draw, { passive: true });
    this.observer = new ResizeObserver(this.draw);
    this.observer.observe(this.strip);
    this.element = h('div', { class: 'film-panel', hidden: true }, this.controls, this.strip);
    signal.addEventListener('abort', () => {
      this.stop();
      this.observer.disconnect();
    });
    this.#showPlaying();
  }

  /** Reads all frames. */
  async read() {
    /** @type {Frame[]} */
    const frames = [];
    /** @type {string | null} */
    let cursor = null;
    do {
      /** @type {{frames: Frame[], next_cursor: string | null}} */
      const page = await getJson(`/v1/jobs/${this.job}/frames`, { query: { limit: PAGE, cursor }, signal: this.signal });
      frames.push(...page.frames);
      cursor = page.next_cursor;
    } while (cursor !== null);
    this.frames = frames;
    this.element.hidden = frames.length < 2;
    this.slider.max = String(Math.max(0, frames.length - 1));
    this.inner.style.width = `${frames.length * CELL}px`;
    this.choose(Math.min(this.current, Math.max(0, frames.length - 1)), true);
  }

  /**
   * A frame's picture has been stored, or lost.
   * @param {number} number
   * @param {Partial<Frame>} change
   */
  update(number, change) {
    const frame = this.frames[number];
    if (!frame) return;
    this.frames[number] = { ...frame, ...change };
    this.#decoded.delete(number);
    this.draw();
  }

  /** The chosen frame. */
  get frame() {
    return this.frames[this.current] ?? null;
  }

  /**
   * @param {number} number
   * @param {boolean} [isForced]
   */
  choose(number, isForced = false) {
    const frame = Math.max(0, Math.min(this.frames.length - 1, number));
    if (frame === this.current && !isForced) return;
    this.current = Math.max(0, frame);
    this.slider.value = String(this.current);
    this.slider.setAttribute('aria-valuetext', `Frame ${this.current} of ${this.frames.length}`);
    setText(this.number, `${count(this.current)} / ${count(Math.max(0, this.frames.length - 1))}`);
    this.#reveal();
    this.draw();
    this.dispatchEvent(new CustomEvent('frame', { detail: this.current }));
  }

  #reveal() {
    const left = this.current * CELL;
    const { scrollLeft, clientWidth } = this.strip;
    if (left < scrollLeft || left + CELL > scrollLeft + clientWidth) this.strip.scrollLeft = left - (clientWidth - CELL) / 2;
  }

  #draw() {
    if (this.element.hidden) return;
    const first = Math.max(0, Math.floor(this.strip.scrollLeft / CELL) - 2);
    const last = Math.min(this.frames.length, Math.ceil((this.strip.scrollLeft + this.strip.clientWidth) / CELL) + 2);
    for (const [number, cell] of this.#cells) {
      if (number >= first && number < last) continue;
      cell.remove();
      this.#cells.delete(number);
    }
    for (let number = first; number < last; number += 1) {
      const frame = this.frames[number];
      if (!frame) continue;
      let cell = this.#cells.get(number);
      if (!cell) {
        cell = h('div', { class: 'film-cell', role: 'option', id: `frame-${number}`, 'data-frame': number }, h('span', { class: 'picture' }), h('span', { class: 'film-number' }, number));
        cell.style.left = `${number * CELL}px`;
        this.#cells.set(number, cell);
        this.inner.append(cell);
      }
      const isChosen = number === this.current;
      cell.setAttribute('aria-selected', String(isChosen));
      cell.setAttribute('aria-label', `Frame ${number}, ${frame.state}`);
      cell.dataset['state'] = frame.state;
      const picture = cell.firstElementChild;
      if (picture instanceof HTMLElement) showThumbnail(picture, frame.state === 'stored' ? `/v1/jobs/${this.job}/frames/${number}/thumbnail?width=160#${frame.picture ?? ''}` : null);
    }
    this.strip.setAttribute('aria-activedescendant', `frame-${this.current}`);
  }

  /** @param {KeyboardEvent} event */
  #press(event) {
    /** @type {Record<string, number>} */
    const targets = { ArrowRight: this.current + 1, ArrowLeft: this.current - 1, Home: 0, End: this.frames.length - 1, PageDown: this.current + 10, PageUp: this.current - 10 };
    const target = targets[event.key];
    if (target === undefined) return;
    event.preventDefault();
    this.choose(target);
  }

  /** @param {boolean} isLooping */
  setLooping(isLooping) {
    this.isLooping = isLooping;
    this.loop.setAttribute('aria-pressed', String(isLooping));
  }

  toggle() {
    if (this.isPlaying) this.stop();
    else void this.start();
  }

  stop() {
    if (!this.isPlaying) return;
    this.isPlaying = false;
    clearTimeout(this.#timer);
    this.#showPlaying();
    this.dispatchEvent(new CustomEvent('frame', { detail: this.current }));
  }

  #showPlaying() {
    this.play.replaceChildren(icon(this.isPlaying ? 'pause' : 'play'));
    const label = this.isPlaying ? 'Stop' : 'Play';
    this.play.setAttribute('aria-label', label);
    this.play.title = `${label} (k)`;
  }

  /** Plays the stored frames, at the job's rate or as fast as they arrive. */
  async start() {
    const stored = this.frames.filter((frame) => frame.state === 'stored').map((frame) => frame.number);
    if (stored.length < 2 || this.isPlaying) return;
    this.isPlaying = true;
    this.#showPlaying();
    let at = Math.max(0, stored.findIndex((number) => number >= this.current));
    if (at >= stored.length - 1 && !this.isLooping) at = 0;
    let due = performance.now();
    while (this.isPlaying && !this.signal.aborted) {
      for (let ahead = 0; ahead < Math.min(AHEAD, stored.length); ahead += 1) void this.#bitmap(stored[(at + ahead) % stored.length] ?? 0);
      const number = stored[at] ?? 0;
      const bitmap = await this.#bitmap(number);
      due = Math.max(due + 1000 / this.fps, performance.now());
      if (!this.isPlaying) break;
      this.choose(number);
      if (bitmap) this.dispatchEvent(new CustomEvent('show', { detail: bitmap }));
      await new Promise((resolve) => (this.#timer = setTimeout(resolve, due - performance.now())));
      at += 1;
      if (at < stored.length) continue;
      if (!this.isLooping) return this.stop();
      at = 0;
    }
  }

  /**
   * A frame as playback shows it.
   * @param {number} number
   */
  #bitmap(number) {
    const known = this.#decoded.get(number);
    if (known) return known;
    const bitmap = this.#decode(number);
    this.#decoded.set(number, bitmap);
    for (const old of this.#decoded.keys()) {
      if (this.#decoded.size <= KEPT) break;
      this.#decoded.delete(old);
    }
    return bitmap;
  }

  /** @param {number} number */
  async #decode(number) {
    try {
      const blob = await getBlob(`/v1/jobs/${this.job}/frames/${number}/thumbnail`, { query: { width: PLAY_WIDTH }, signal: this.signal, cache: 'default' });
      return await createImageBitmap(blob);
    } catch {
      this.#decoded.delete(number);
      return null;
    }
  }
}
