// The live picture: the exact one and the approximate one on top of each other, and what is said of them.

import { h, setText } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';
import { duration } from '/ui/parts/format.js';

/** @typedef {import('./preview.js').Shown} Shown */

const LAYERS = /** @type {const} */ ([
  ['color', 'Color'],
  ['depth', 'Depth'],
  ['normal', 'Normals'],
  ['albedo', 'Albedo'],
  ['object', 'Objects'],
  ['steps', 'Steps'],
  ['samples', 'Samples'],
  ['noisy', 'Before the denoiser'],
  ['motion', 'Motion'],
  ['crypto_object', 'Matte of objects'],
  ['crypto_material', 'Matte of materials'],
  ['position', 'Positions'],
]);

const HELP =
  'Arrow keys circle the scene, with Shift they move the view, with Alt they turn it; plus and minus come nearer and go away; W, A, S, D, Q and E fly. ' +
  'C shows a crosshair: arrow keys move it, Enter selects the object at it, L looks at it, Escape hides it.';

/** Events: `layer`, `resize`, `fly`, `mark` with a place and what is asked for it. */
export class Picture extends EventTarget {
  /** @type {HTMLCanvasElement} */
  exact = h('canvas', { class: 'exact', width: 16, height: 9 });
  /** @type {HTMLCanvasElement} */
  approximate = h('canvas', { class: 'approximate', width: 16, height: 9, hidden: true });
  /** @type {HTMLCanvasElement} */
  map = h('canvas', { class: 'cost-map', width: 1, height: 1, hidden: true });
  #crosshair = h('div', { class: 'crosshair', hidden: true, 'aria-hidden': 'true' });
  #at = { x: 0.5, y: 0.5 };
  #aspect = 9 / 16;
  #badge = h('span', { class: 'badge exact', role: 'status' }, 'No picture yet');
  #size = h('span', { class: 'muted small figures' });
  #busy = h('span', { class: 'busy', hidden: true, 'aria-hidden': 'true' });
  #cover = h('p', { class: 'picture-cover', hidden: true });
  #isFlying = false;

  constructor() {
    super();
    const stage = h(
      'div',
      { class: 'stage', tabindex: 0, role: 'application', 'aria-label': 'Live picture', 'aria-describedby': 'stage-help' },
      this.exact,
      this.approximate,
      this.map,
      this.#crosshair,
    );
    this.stage = stage;
    this.layers = h(
      'select',
      { class: 'layer', 'aria-label': 'Layer', title: 'The layer that is shown', on: { change: () => this.dispatchEvent(new Event('layer')) } },
      ...LAYERS.map(([value, label]) => h('option', { value }, label)),
    );
    this.flyButton = h(
      'button',
      { type: 'button', class: 'button', 'aria-pressed': 'false', title: 'Fly: a drag looks around, W A S D moves (f)', on: { click: () => this.toggleFly() } },
      'Fly',
    );
    this.frame = h('div', { class: 'picture-frame' }, stage, this.#cover);
    this.bar = h('div', { class: 'picture-bar' }, this.#badge, this.#busy, this.#size, h('span', { class: 'grow' }), this.flyButton, this.layers);
    this.status = h('p', { class: 'picture-status', role: 'status' });
    this.element = h(
      'section',
      { class: 'picture-room', 'aria-label': 'Live picture' },
      this.bar,
      this.frame,
      h('p', { id: 'stage-help', class: 'visually-hidden' }, HELP),
    );
    new ResizeObserver(() => this.#fit()).observe(this.frame);
    stage.addEventListener('keydown', (event) => this.#key(event), { capture: true });
  }

  get layer() {
    return this.layers.value;
  }

  get isFlying() {
    return this.#isFlying;
  }

  /** Width of the picture in pixels of the screen. */
  get pixels() {
    return Math.max(1, this.stage.clientWidth) * Math.min(2, devicePixelRatio || 1);
  }

  toggleFly() {
    this.#isFlying = !this.#isFlying;
    this.flyButton.setAttribute('aria-pressed', String(this.#isFlying));
    this.stage.classList.toggle('flying', this.#isFlying);
    this.stage.focus({ preventScroll: true });
  }

  /** @param {number} aspect height over width */
  setAspect(aspect) {
    if (!Number.isFinite(aspect) || aspect <= 0 || aspect === this.#aspect) return;
    this.#aspect = aspect;
    this.#fit();
  }

  get aspect() {
    return this.#aspect;
  }

  #fit() {
    const { clientWidth, clientHeight } = this.frame;
    const width = Math.max(1, Math.min(clientWidth, clientHeight / this.#aspect));
    this.stage.style.width = `${Math.floor(width)}px`;
    this.stage.style.height = `${Math.floor(width * this.#aspect)}px`;
    this.dispatchEvent(new Event('resize'));
  }

  /**
   * Shows an exact picture.
   * @param {Shown} shown
   */
  async showExact(shown) {
    const bitmap = await createImageBitmap(shown.blob);
    this.exact.width = bitmap.width;
    this.exact.height = bitmap.height;
    this.exact.getContext('2d')?.drawImage(bitmap, 0, 0);
    const width = Math.min(bitmap.width, shown.stage.width);
    const height = Math.round((width * bitmap.height) / bitmap.width);
    bitmap.close();
    this.approximate.hidden = true;
    this.stage.classList.remove('is-old');
    this.#cover.hidden = true;
    this.#say('exact', 'Exact', 'Exact: as the farm renders it');
    setText(this.#size, `${width} × ${height}${shown.stage.samples > 1 ? `, ${shown.stage.samples} samples` : ''} · ${duration(shown.milliseconds / 1000)}`);
    this.stage.dataset['width'] = String(width);
    this.stage.dataset['version'] = String(Number(this.stage.dataset['version'] ?? 0) + 1);
  }

  /**
   * Shows that the approximate picture is seen.
   * @param {number} width
   * @param {number} milliseconds
   */
  showApproximate(width, milliseconds) {
    this.approximate.hidden = false;
    this.stage.classList.remove('is-old');
    this.#cover.hidden = true;
    this.#say('approximate', 'Approximate', 'Approximate: drawn by this machine’s GPU until you let go');
    setText(this.#size, `${width} × ${Math.round(width * this.#aspect)} · ${duration(milliseconds / 1000)}`);
  }

  /**
   * Shows that what is seen is not the text's picture.
   * @param {string} badge
   * @param {string} reason
   */
  showOld(badge, reason) {
    this.stage.classList.add('is-old');
    this.#say('old', badge, reason);
    if (this.stage.dataset['version'] === undefined) {
      this.#cover.hidden = false;
      setText(this.#cover, reason);
    }
  }

  /**
   * @param {string} kind
   * @param {string} text
   * @param {string} title
   */
  #say(kind, text, title) {
    this.#badge.className = `badge ${kind}`;
    this.#badge.title = title;
    setText(this.#badge, text);
  }

  /** @param {boolean} isBusy */
  setBusy(isBusy) {
    this.#busy.hidden = !isBusy;
  }

  /**
   * Marks the place that was picked.
   * @param {number} x
   * @param {number} y
   */
  flash(x, y) {
    const mark = h('div', { class: 'picked', css: { left: `${x * 100}%`, top: `${y * 100}%` } });
    this.stage.append(mark);
    setTimeout(() => mark.remove(), 700);
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const isShown = !this.#crosshair.hidden;
    const step = event.shiftKey ? 0.1 : 0.02;
    /** @type {Record<string, [number, number]>} */
    const ways = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const way = ways[event.key];
    if (event.key === 'c') this.#showCrosshair(!isShown);
    else if (event.key === 'f') this.toggleFly();
    else if (isShown && way !== undefined) this.#moveCrosshair(way);
    else if (isShown && event.key === 'Escape') this.#showCrosshair(false);
    else if (event.key === 'Enter') this.#ask('pick');
    else if (event.key === 'l') this.#ask('look');
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  /** @param {'pick' | 'look'} action */
  #ask(action) {
    this.dispatchEvent(new CustomEvent('mark', { detail: { action, ...this.#at } }));
  }

  /** @param {boolean} isShown */
  #showCrosshair(isShown) {
    this.#crosshair.hidden = !isShown;
    if (!isShown) this.#at = { x: 0.5, y: 0.5 };
    this.#moveCrosshair([0, 0]);
  }

  /** @param {[number, number]} way */
  #moveCrosshair([x, y]) {
    this.#at = { x: Math.min(1, Math.max(0, this.#at.x + x)), y: Math.min(1, Math.max(0, this.#at.y + y)) };
    this.#crosshair.style.left = `${this.#at.x * 100}%`;
    this.#crosshair.style.top = `${this.#at.y * 100}%`;
  }
}

/** A button with an icon. @param {import('/ui/parts/icons.js').IconName} name @param {string} label @param {() => void} run */
export function iconButton(name, label, run) {
  return h('button', { type: 'button', class: 'ghost', 'aria-label': label, title: label, on: { click: run } }, icon(name));
}
