// The time of an animated job: a slider over its frames, play, pause and loop.

import { h, setText } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';

/** Events: `frame`, `playing`. */
export class Timeline extends EventTarget {
  #count = 1;
  #fps = 24;
  #frame = 0;
  #isLooping = true;
  /** Time and frame at which it began to play; null while it does not. */
  /** @type {{time: number, frame: number} | null} */
  #start = null;
  #request = 0;
  #slider = h('input', { type: 'range', min: 0, max: 0, step: 1, value: 0, 'aria-label': 'Frame', class: 'grow', on: { input: () => this.#slid() } });
  #label = h('output', { class: 'figures small nowrap' });
  #play = h('button', { type: 'button', class: 'ghost', on: { click: () => this.toggle() } });
  #loop = h('button', { type: 'button', class: 'ghost', 'aria-pressed': 'true', 'aria-label': 'Loop', title: 'Loop', on: { click: () => this.#toggleLoop() } }, icon('loop'));

  constructor() {
    super();
    this.element = h('div', { class: 'timeline', role: 'group', 'aria-label': 'Time', hidden: true }, this.#play, this.#slider, this.#label, this.#loop);
    this.#show();
  }

  get frame() {
    return this.#frame;
  }

  get isPlaying() {
    return this.#start !== null;
  }

  /**
   * Takes the frames of the text.
   * @param {number} count
   * @param {number} fps
   */
  setFrames(count, fps) {
    const whole = Number.isInteger(count) && count >= 1 ? Math.min(count, 100_000) : 1;
    this.#fps = fps > 0 ? fps : 24;
    if (whole !== this.#count) {
      this.#count = whole;
      this.#slider.max = String(whole - 1);
      if (whole === 1) this.pause();
      if (this.#frame > whole - 1) this.setFrame(whole - 1);
    }
    this.element.hidden = whole === 1;
    this.#show();
  }

  /** @param {number} frame */
  setFrame(frame) {
    const next = Math.min(this.#count - 1, Math.max(0, Math.round(frame)));
    if (next === this.#frame) return;
    this.#frame = next;
    this.#show();
    this.dispatchEvent(new Event('frame'));
  }

  #slid() {
    this.pause();
    this.setFrame(Number(this.#slider.value));
  }

  toggle() {
    if (this.isPlaying) this.pause();
    else this.play();
  }

  play() {
    if (this.#count < 2 || this.isPlaying) return;
    const from = this.#frame === this.#count - 1 ? 0 : this.#frame;
    this.#start = { time: performance.now(), frame: from };
    this.#request = requestAnimationFrame(() => this.#tick());
    this.#show();
    this.dispatchEvent(new Event('playing'));
  }

  pause() {
    if (!this.isPlaying) return;
    this.#start = null;
    cancelAnimationFrame(this.#request);
    this.#show();
    this.dispatchEvent(new Event('playing'));
  }

  #tick() {
    if (this.#start === null) return;
    const passed = Math.floor(((performance.now() - this.#start.time) / 1000) * this.#fps);
    const frame = this.#start.frame + passed;
    if (frame >= this.#count && !this.#isLooping) {
      this.setFrame(this.#count - 1);
      this.pause();
      return;
    }
    this.setFrame(frame % this.#count);
    this.#request = requestAnimationFrame(() => this.#tick());
  }

  #toggleLoop() {
    this.#isLooping = !this.#isLooping;
    this.#loop.setAttribute('aria-pressed', String(this.#isLooping));
  }

  #show() {
    const seconds = (this.#frame / this.#fps).toFixed(2);
    setText(this.#label, `${this.#frame} / ${this.#count - 1} · ${seconds} s`);
    this.#slider.value = String(this.#frame);
    this.#slider.setAttribute('aria-valuetext', `Frame ${this.#frame}, ${seconds} seconds`);
    const isPlaying = this.isPlaying;
    if (this.#play.dataset['playing'] === String(isPlaying)) return;
    this.#play.dataset['playing'] = String(isPlaying);
    this.#play.replaceChildren(icon(isPlaying ? 'pause' : 'play'));
    this.#play.setAttribute('aria-label', isPlaying ? 'Pause' : 'Play');
    this.#play.title = isPlaying ? 'Pause (Space)' : 'Play (Space)';
  }

  stop() {
    this.pause();
  }
}
