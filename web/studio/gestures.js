// Gestures on the picture: orbit, pan, dolly, fly and look, by mouse, by touch and by keys. Each is one step of undo.

import { dolly, length, look, move, orbit, pan, subtract } from './camera.js';

/** @typedef {import('./camera.js').View} View */
/**
 * The thing that gestures move.
 * @typedef {object} Target
 * @property {() => View | null} begin The view before a gesture; null if it can't be moved, which the target has said.
 * @property {(view: View) => void} apply
 * @property {() => void} end
 * @property {() => void} cancel
 * @property {(x: number, y: number) => void} pick A place, 0 to 1 from the top left.
 * @property {(x: number, y: number) => void} lookAt
 * @property {() => boolean} isFlying
 */

const THRESHOLD_PX = 3;
/** Movement over the height of the picture turns the camera by this. */
const TURN = Math.PI;
const KEY_TURN = (5 * Math.PI) / 180;
const KEY_PAN = 0.05;
const KEY_DOLLY = 1.12;
/** Parts of the distance to the point looked at that the camera flies in a second. */
const FLY_SPEED = 0.9;
/** Pause that ends a gesture of the wheel or of keys. */
const PAUSE_MS = 350;

/** @type {Record<string, [number, number, number]>} */
const FLY_KEYS = { KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyE: [0, 1, 0], KeyQ: [0, -1, 0] };

export class Gestures {
  /** The view that the gesture has reached, unrounded; null while there is none. */
  /** @type {View | null} */
  #view = null;
  #pauseTimer = 0;
  /** @type {Map<number, {x: number, y: number}>} */
  #pointers = new Map();
  /** @type {{mode: 'orbit' | 'pan' | 'look', isMoved: boolean, button: number} | null} */
  #press = null;
  /** @type {Set<string>} */
  #held = new Set();
  #flyFrame = 0;
  #flyTime = 0;
  #isFast = false;

  /**
   * @param {HTMLElement} element
   * @param {Target} target
   */
  constructor(element, target) {
    this.element = element;
    this.target = target;
    element.addEventListener('pointerdown', (event) => this.#down(event));
    element.addEventListener('pointermove', (event) => this.#moved(event));
    element.addEventListener('pointerup', (event) => this.#up(event));
    element.addEventListener('pointercancel', (event) => this.#up(event));
    element.addEventListener('dblclick', (event) => {
      const at = this.#place(event);
      if (at !== null) target.lookAt(at.x, at.y);
    });
    element.addEventListener('contextmenu', (event) => event.preventDefault());
    element.addEventListener('wheel', (event) => this.#wheel(event), { passive: false });
    element.addEventListener('keydown', (event) => this.#keyDown(event));
    element.addEventListener('keyup', (event) => this.#keyUp(event));
    element.addEventListener('blur', () => this.#release());
  }

  /** Whether a gesture is in progress. */
  get isActive() {
    return this.#view !== null;
  }

  /** Ends what is in progress. */
  finish() {
    this.#release();
    this.#end();
  }

  /** @param {MouseEvent} event */
  #place(event) {
    const { left, top, width, height } = this.element.getBoundingClientRect();
    const [x, y] = [(event.clientX - left) / width, (event.clientY - top) / height];
    return x < 0 || y < 0 || x > 1 || y > 1 ? null : { x, y };
  }

  #begin() {
    if (this.#view === null) this.#view = this.target.begin();
    return this.#view;
  }

  /** @param {View} view */
  #apply(view) {
    this.#view = view;
    this.target.apply(view);
  }

  #end() {
    clearTimeout(this.#pauseTimer);
    if (this.#view === null) return;
    this.#view = null;
    this.target.end();
  }

  /** Ends the gesture if nothing follows. */
  #endSoon() {
    clearTimeout(this.#pauseTimer);
    this.#pauseTimer = setTimeout(() => {
      if (this.#press === null && this.#held.size === 0) this.#end();
    }, PAUSE_MS);
  }

  /** @param {PointerEvent} event */
  #down(event) {
    if (event.button > 2) return;
    this.element.focus({ preventScroll: true });
    try {
      this.element.setPointerCapture(event.pointerId);
    } catch {
      // The pointer has gone already.
    }
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const isPan = event.button !== 0 || event.shiftKey;
    const isLook = event.ctrlKey || event.metaKey || this.target.isFlying();
    if (this.#pointers.size === 1) this.#press = { mode: isPan ? 'pan' : isLook ? 'look' : 'orbit', isMoved: false, button: event.button };
    if (event.button === 1) event.preventDefault();
  }

  /** @param {PointerEvent} event */
  #moved(event) {
    const last = this.#pointers.get(event.pointerId);
    const press = this.#press;
    if (last === undefined || press === null) return;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    if (!press.isMoved && Math.hypot(dx, dy) < THRESHOLD_PX) return;
    press.isMoved = true;
    const before = [...this.#pointers.values()].map((each) => ({ ...each }));
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const view = this.#begin();
    if (view === null) return;
    const height = this.element.clientHeight || 1;
    if (this.#pointers.size >= 2) this.#apply(this.#pinched(view, before, [...this.#pointers.values()], height));
    else if (press.mode === 'pan') this.#apply(pan(view, -dx / height, dy / height));
    else if (press.mode === 'look') this.#apply(look(view, lookAngle(view, -dx / height), lookAngle(view, -dy / height)));
    else this.#apply(orbit(view, (-dx / height) * TURN, (dy / height) * TURN));
  }

  /**
   * @param {View} view
   * @param {{x: number, y: number}[]} before
   * @param {{x: number, y: number}[]} after
   * @param {number} height
   */
  #pinched(view, before, after, height) {
    const [a, b] = before;
    const [c, d] = after;
    if (a === undefined || b === undefined || c === undefined || d === undefined) return view;
    const spread = Math.hypot(a.x - b.x, a.y - b.y) / Math.max(1, Math.hypot(c.x - d.x, c.y - d.y));
    const [x, y] = [(c.x + d.x - a.x - b.x) / 2, (c.y + d.y - a.y - b.y) / 2];
    return pan(dolly(view, spread), -x / height, y / height);
  }

  /** @param {PointerEvent} event */
  #up(event) {
    this.#pointers.delete(event.pointerId);
    const press = this.#press;
    if (press === null || this.#pointers.size > 0) return;
    this.#press = null;
    if (press.isMoved) {
      this.#end();
    } else if (press.button === 0 && event.type === 'pointerup') {
      const at = this.#place(event);
      if (at !== null) this.target.pick(at.x, at.y);
    }
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    event.preventDefault();
    const view = this.#begin();
    if (view === null) return;
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? event.deltaY * 16 : event.deltaY;
    this.#apply(dolly(view, Math.exp(Math.max(-200, Math.min(200, lines)) * (event.ctrlKey ? 0.008 : 0.0016))));
    this.#endSoon();
  }

  /** @param {KeyboardEvent} event */
  #keyDown(event) {
    if (event.key === 'Escape' && this.#view !== null) {
      event.preventDefault();
      this.#release();
      this.#view = null;
      this.#press = null;
      this.target.cancel();
      return;
    }
    if (event.ctrlKey || event.metaKey) return;
    const fly = FLY_KEYS[event.code];
    if (fly !== undefined && !event.altKey) {
      event.preventDefault();
      event.stopPropagation();
      this.#isFast = event.shiftKey;
      this.#held.add(event.code);
      if (this.#flyFrame === 0 && this.#begin() !== null) {
        this.#flyTime = performance.now();
        // A tap moves, too.
        this.#fly(fly, 1 / 12);
        this.#flyFrame = requestAnimationFrame((now) => this.#flyOn(now));
      }
      return;
    }
    const step = keyStep(event);
    if (step === null) return;
    event.preventDefault();
    event.stopPropagation();
    const view = this.#begin();
    if (view === null) return;
    this.#apply(step(view));
    this.#endSoon();
  }

  /** @param {KeyboardEvent} event */
  #keyUp(event) {
    this.#isFast = event.shiftKey;
    if (this.#held.delete(event.code) && this.#held.size === 0) this.#release();
  }

  #release() {
    const wasFlying = this.#flyFrame !== 0;
    this.#held.clear();
    cancelAnimationFrame(this.#flyFrame);
    this.#flyFrame = 0;
    if (wasFlying) this.#endSoon();
  }

  /** @param {number} now */
  #flyOn(now) {
    const seconds = Math.min(0.1, Math.max(0, (now - this.#flyTime) / 1000));
    this.#flyTime = now;
    /** @type {[number, number, number]} */
    const way = [0, 0, 0];
    for (const code of this.#held) FLY_KEYS[code]?.forEach((part, axis) => (way[axis] = (way[axis] ?? 0) + part));
    if (way.some((part) => part !== 0)) this.#fly(way, seconds);
    this.#flyFrame = this.#held.size > 0 ? requestAnimationFrame((next) => this.#flyOn(next)) : 0;
  }

  /**
   * @param {[number, number, number]} way
   * @param {number} seconds
   */
  #fly(way, seconds) {
    const view = this.#view;
    if (view === null) return;
    const reach = length(subtract(view.lookAt, view.position)) * FLY_SPEED * seconds * (this.#isFast ? 3 : 1);
    this.#apply(move(view, way[0] * reach, way[1] * reach, way[2] * reach));
  }
}

/**
 * The angle that a movement by a part of the picture's height turns the view by.
 * @param {View} view
 * @param {number} part
 */
const lookAngle = (view, part) => part * (Math.min(view.fov, 120) * Math.PI) / 180;

/**
 * The movement of a key.
 * @param {KeyboardEvent} event
 * @returns {((view: View) => View) | null}
 */
function keyStep(event) {
  const { key } = event;
  if (key === '+' || key === '=') return (view) => dolly(view, 1 / KEY_DOLLY);
  if (key === '-' || key === '_') return (view) => dolly(view, KEY_DOLLY);
  /** @type {[number, number] | undefined} */
  const way = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] })[key];
  if (way === undefined) return null;
  const [x, y] = way;
  if (event.shiftKey) return (view) => pan(view, x * KEY_PAN, y * KEY_PAN);
  if (event.altKey) return (view) => look(view, -x * KEY_TURN * 0.5, y * KEY_TURN * 0.5);
  return (view) => orbit(view, x * KEY_TURN, y * KEY_TURN);
}
