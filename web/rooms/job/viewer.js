// Shows a picture to the pixel: zoom, pan, the value under the pointer, exposure, rectangles over it, and a wipe to another.

import { h, setText, svg } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';

/** @typedef {{x: number, y: number, width: number, height: number}} Rectangle */
/** @typedef {Rectangle & {kind: 'leased' | 'differs', title?: string}} Mark */

const LARGEST_SCALE = 64;
/** Scale from which pixels are shown as squares. */
const SQUARES = 2;
const KEY_PAN = 60;
const WHEEL_SPEED = 0.0016;

/** Tells by `probe` (detail: the pixel, or null) that the pointer is on another pixel. */
export class Viewer extends EventTarget {
  #size = { width: 16, height: 9 };
  #scale = 1;
  #x = 0;
  #y = 0;
  /** Whether the picture is fitted when the room for it changes. */
  #isFitted = true;
  /** @type {Map<number, PointerEvent>} */
  #pointers = new Map();
  /** @type {{x: number, y: number} | null} */
  #probe = null;
  #hasPicture = false;

  constructor() {
    super();
    this.canvas = h('canvas', { class: 'viewer-picture', width: 1, height: 1, role: 'img', 'aria-label': 'The picture' });
    this.other = h('canvas', { class: 'viewer-picture viewer-other', width: 1, height: 1, hidden: true });
    this.context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext('2d', { willReadFrequently: true }));
    this.marks = svg('svg', { class: 'viewer-marks', 'aria-hidden': 'true', preserveAspectRatio: 'none' });
    this.cross = svg('rect', { class: 'viewer-probe', width: 1, height: 1, visibility: 'hidden' });
    this.stage = h('div', { class: 'viewer-stage' }, this.canvas, this.other, this.marks);
    this.slope = ['R', 'G', 'B'].map((channel) => document.createElementNS('http://www.w3.org/2000/svg', /** @type {'feFuncR'} */ (`feFunc${channel}`)));
    for (const each of this.slope) each.setAttribute('type', 'linear');
    const filter = svg('filter', { id: 'exposure', 'color-interpolation-filters': 'linearRGB' }, svg('feComponentTransfer', {}, ...this.slope));
    this.divider = h('input', { type: 'range', min: 0, max: 100, step: 0.5, value: 50, class: 'wipe', 'aria-label': 'Part of the width that shows this job', hidden: true });
    this.divider.addEventListener('input', () => this.#placeWipe());
    this.line = h('div', { class: 'wipe-line', hidden: true });
    this.values = h('output', { class: 'viewer-values', 'aria-label': 'Value of the pixel', 'aria-live': 'off' });
    this.zoomText = h('button', { type: 'button', class: 'ghost', title: 'Fit the picture (0)', on: { click: () => this.fit() } }, 'Fit');
    const zoom = h(
      'div',
      { class: 'viewer-zoom' },
      h('button', { type: 'button', class: 'ghost', 'aria-label': 'Zoom out', title: 'Zoom out (−)', on: { click: () => this.zoom(1 / 1.5) } }, icon('minus')),
      this.zoomText,
      h('button', { type: 'button', class: 'ghost', 'aria-label': 'Zoom in', title: 'Zoom in (+)', on: { click: () => this.zoom(1.5) } }, icon('plus')),
      h('button', { type: 'button', class: 'ghost', 'aria-label': '1:1, one to one', title: 'One pixel of the picture for one of the screen (1)', on: { click: () => this.actual() } }, '1:1'),
    );
    this.message = h('p', { class: 'viewer-message', hidden: true });
    this.surface = h('div', { class: 'viewer-surface', tabindex: 0, role: 'group', 'aria-label': 'Picture: + and − zoom, arrows move it, Shift with arrows reads pixels' }, this.stage, this.line);
    this.element = h('div', { class: 'viewer' }, svg('svg', { width: 0, height: 0, class: 'visually-hidden', 'aria-hidden': 'true' }, filter), this.surface, this.divider, this.message, h('div', { class: 'viewer-hud' }, this.values, zoom));
    this.#listen();
    this.observer = new ResizeObserver(() => this.#resized());
    this.observer.observe(this.surface);
  }

  /** Size of the picture, in its own pixels. */
  get size() {
    return this.#size;
  }

  /**
   * Sets the size of the picture, which its drawings are scaled to.
   * @param {number} width
   * @param {number} height
   */
  setSize(width, height) {
    if (width === this.#size.width && height === this.#size.height) return;
    this.#size = { width, height };
    this.marks.setAttribute('viewBox', `0 0 ${width} ${height}`);
    this.element.style.setProperty('--aspect', String(width / height));
    for (const part of [this.canvas, this.other, this.marks, this.stage]) {
      part.style.width = `${width}px`;
      part.style.height = `${height}px`;
    }
    this.fit();
  }

  /**
   * Draws a picture.
   * @param {ImageBitmap} bitmap
   */
  draw(bitmap) {
    paint(this.canvas, bitmap);
    this.#hasPicture = true;
    this.setMessage('');
    if (this.#probe) this.#tellProbe();
  }

  /** Shows no picture. */
  clear() {
    this.#hasPicture = false;
    this.canvas.width = 1;
    this.canvas.height = 1;
  }

  /** @param {string} text */
  setMessage(text) {
    setText(this.message, text);
    this.message.hidden = text === '';
  }

  /**
   * Draws what it is compared with, or ends the comparison.
   * @param {ImageBitmap | null} bitmap
   */
  drawOther(bitmap) {
    const isShown = bitmap !== null;
    if (bitmap !== null) paint(this.other, bitmap);
    this.other.hidden = !isShown;
    this.divider.hidden = !isShown;
    this.line.hidden = !isShown;
    this.#place();
  }

  /**
   * Multiplies the light by a power of two.
   * @param {number} stops
   */
  setExposure(stops) {
    for (const each of this.slope) each.setAttribute('slope', String(2 ** stops));
    const filter = stops === 0 ? '' : 'url(#exposure)';
    this.canvas.style.filter = filter;
    this.other.style.filter = filter;
  }

  /** @param {Mark[]} marks */
  setMarks(marks) {
    const { width, height } = this.#size;
    this.marks.setAttribute('viewBox', `0 0 ${width} ${height}`);
    this.marks.replaceChildren(
      ...marks.map((mark) => svg('rect', { x: mark.x, y: mark.y, width: mark.width, height: mark.height, class: `mark ${mark.kind}` }, mark.title ? svg('title', {}, mark.title) : null)),
      this.cross,
    );
  }

  /** Color of a pixel as it is shown, from 0 to 255 with alpha; null without a picture. */
  /**
   * @param {number} x
   * @param {number} y
   */
  colorAt(x, y) {
    if (!this.#hasPicture) return null;
    const { width, height } = this.#size;
    const column = Math.min(this.canvas.width - 1, Math.floor(((x + 0.5) / width) * this.canvas.width));
    const row = Math.min(this.canvas.height - 1, Math.floor(((y + 0.5) / height) * this.canvas.height));
    return this.context.getImageData(column, row, 1, 1).data;
  }

  /** Shows the whole picture. */
  fit() {
    const { clientWidth, clientHeight } = this.surface;
    const scale = Math.min(clientWidth / this.#size.width, clientHeight / this.#size.height);
    if (!Number.isFinite(scale) || scale <= 0) return;
    this.#isFitted = true;
    this.#scale = scale;
    this.#x = (clientWidth - this.#size.width * scale) / 2;
    this.#y = (clientHeight - this.#size.height * scale) / 2;
    this.#place();
  }

  /** Shows one pixel of the picture as one of the screen. */
  actual() {
    this.zoom(1 / devicePixelRatio / this.#scale);
  }

  /**
   * Zooms around a point of the surface, by default its center.
   * @param {number} factor
   * @param {number} [atX]
   * @param {number} [atY]
   */
  zoom(factor, atX = this.surface.clientWidth / 2, atY = this.surface.clientHeight / 2) {
    const smallest = Math.min(1, this.surface.clientWidth / this.#size.width, this.surface.clientHeight / this.#size.height) / 2;
    const scale = Math.max(smallest, Math.min(LARGEST_SCALE, this.#scale * factor));
    const change = scale / this.#scale;
    this.#isFitted = false;
    this.#x = atX - (atX - this.#x) * change;
    this.#y = atY - (atY - this.#y) * change;
    this.#scale = scale;
    this.#place();
  }

  /**
   * @param {number} x
   * @param {number} y
   */
  pan(x, y) {
    this.#isFitted = false;
    this.#x += x;
    this.#y += y;
    this.#place();
  }

  #resized() {
    if (this.#isFitted) this.fit();
    else this.#place();
  }

  #place() {
    const { clientWidth, clientHeight } = this.surface;
    const [width, height] = [this.#size.width * this.#scale, this.#size.height * this.#scale];
    // A quarter of the picture, or of the surface, stays in sight.
    const [keptX, keptY] = [Math.min(width, clientWidth) / 4, Math.min(height, clientHeight) / 4];
    this.#x = Math.max(keptX - width, Math.min(clientWidth - keptX, this.#x));
    this.#y = Math.max(keptY - height, Math.min(clientHeight - keptY, this.#y));
    this.stage.style.transform = `translate(${this.#x}px, ${this.#y}px) scale(${this.#scale})`;
    this.stage.classList.toggle('squares', this.#scale * devicePixelRatio >= SQUARES);
    const text = `${Math.round(this.#scale * devicePixelRatio * 100)} %`;
    setText(this.zoomText, text);
    this.zoomText.setAttribute('aria-label', `${text}: fit the picture`);
    this.#placeWipe();
  }

  #placeWipe() {
    if (this.other.hidden) return;
    // The divider spans the surface, and the picture may be larger.
    const at = (Number(this.divider.value) / 100) * this.surface.clientWidth;
    const inside = Math.max(0, Math.min(this.#size.width, (at - this.#x) / this.#scale));
    this.other.style.clipPath = `inset(0 0 0 ${inside}px)`;
    this.line.style.transform = `translateX(${at}px)`;
  }

  #listen() {
    const { surface } = this;
    surface.addEventListener('wheel', (event) => this.#wheel(event), { passive: false });
    surface.addEventListener('pointerdown', (event) => this.#down(event));
    surface.addEventListener('pointermove', (event) => this.#move(event));
    for (const name of /** @type {const} */ (['pointerup', 'pointercancel'])) surface.addEventListener(name, (event) => void this.#pointers.delete(event.pointerId));
    surface.addEventListener('pointerleave', () => this.setProbe(null));
    surface.addEventListener('dblclick', (event) => {
      const { left, top } = surface.getBoundingClientRect();
      if (this.#isFitted) this.zoom(Math.max(2, 1 / devicePixelRatio / this.#scale), event.clientX - left, event.clientY - top);
      else this.fit();
    });
    surface.addEventListener('keydown', (event) => this.#press(event));
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    // The page scrolls as usual until the picture has been chosen.
    const isMeant = event.ctrlKey || !this.#isFitted || this.element.contains(document.activeElement);
    if (!isMeant) return;
    event.preventDefault();
    const { left, top } = this.surface.getBoundingClientRect();
    const distance = event.deltaY * (event.deltaMode === 1 ? 20 : 1) * (event.ctrlKey ? 4 : 1);
    this.zoom(Math.exp(-distance * WHEEL_SPEED), event.clientX - left, event.clientY - top);
  }

  /** @param {PointerEvent} event */
  #down(event) {
    if (event.button !== 0) return;
    this.#pointers.set(event.pointerId, event);
    this.surface.setPointerCapture(event.pointerId);
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const { left, top } = this.surface.getBoundingClientRect();
    const before = this.#pointers.get(event.pointerId);
    if (before !== undefined) {
      const others = [...this.#pointers.values()].filter((pointer) => pointer.pointerId !== event.pointerId);
      const [other] = others;
      if (other) {
        const old = Math.hypot(before.clientX - other.clientX, before.clientY - other.clientY);
        const now = Math.hypot(event.clientX - other.clientX, event.clientY - other.clientY);
        if (old > 0) this.zoom(now / old, (event.clientX + other.clientX) / 2 - left, (event.clientY + other.clientY) / 2 - top);
      }
      const share = others.length > 0 ? 0.5 : 1;
      this.pan((event.clientX - before.clientX) * share, (event.clientY - before.clientY) * share);
      this.#pointers.set(event.pointerId, event);
    }
    const x = Math.floor((event.clientX - left - this.#x) / this.#scale);
    const y = Math.floor((event.clientY - top - this.#y) / this.#scale);
    const isInside = x >= 0 && y >= 0 && x < this.#size.width && y < this.#size.height;
    this.setProbe(isInside ? { x, y } : null);
  }

  /**
   * Chooses the pixel whose value is shown.
   * @param {{x: number, y: number} | null} pixel
   * @param {boolean} [isMarked]
   */
  setProbe(pixel, isMarked = false) {
    const isSame = pixel?.x === this.#probe?.x && pixel?.y === this.#probe?.y;
    this.cross.setAttribute('visibility', isMarked && pixel ? 'visible' : 'hidden');
    this.cross.setAttribute('x', String(pixel?.x ?? 0));
    this.cross.setAttribute('y', String(pixel?.y ?? 0));
    this.#probe = pixel;
    if (!isSame) this.#tellProbe();
  }

  #tellProbe() {
    this.dispatchEvent(new CustomEvent('probe', { detail: this.#probe }));
  }

  /** @param {KeyboardEvent} event */
  #press(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    /** @type {Record<string, [number, number]>} */
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const arrow = arrows[event.key];
    /** @type {Record<string, () => void>} */
    const keys = { '+': () => this.zoom(1.5), '=': () => this.zoom(1.5), '-': () => this.zoom(1 / 1.5), '0': () => this.fit(), '1': () => this.actual() };
    if (arrow && event.shiftKey) {
      const at = this.#probe ?? { x: Math.floor(this.#size.width / 2), y: Math.floor(this.#size.height / 2) };
      const x = Math.max(0, Math.min(this.#size.width - 1, at.x + arrow[0]));
      const y = Math.max(0, Math.min(this.#size.height - 1, at.y + arrow[1]));
      this.setProbe({ x, y }, true);
    } else if (arrow) {
      this.pan(-arrow[0] * KEY_PAN, -arrow[1] * KEY_PAN);
    } else if (keys[event.key]) {
      keys[event.key]?.();
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
  }
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {ImageBitmap} bitmap
 */
function paint(canvas, bitmap) {
  if (canvas.width !== bitmap.width) canvas.width = bitmap.width;
  if (canvas.height !== bitmap.height) canvas.height = bitmap.height;
  const context = canvas.getContext('2d', { willReadFrequently: true });
  context?.clearRect(0, 0, canvas.width, canvas.height);
  context?.drawImage(bitmap, 0, 0);
}
