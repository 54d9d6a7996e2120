// Which worker rendered which tile, when and how long: a time line, and the same as a table.

import { Problem, getJson, messageOf } from '/ui/api.js';
import { categoryColor, niceTimeStep, prepareCanvas, themeColor } from '/ui/parts/colors.js';
import { h, oncePerFrame, setText } from '/ui/parts/dom.js';
import { clock, count, counted, duration } from '/ui/parts/format.js';

/** @typedef {import('/ui/types.js').Tile} Tile */
/** @typedef {import('/ui/types.js').TileLease} TileLease */
/** @typedef {{lane: string, tile: Tile, lease: TileLease, from: number, to: number}} Bar */

const PAGE = 1000;
/** Tiles that are read at most; more is too fine for a line. */
const MOST = 10_000;
const LANE = 22;
const LABELS = 150;
const AXIS = 22;
const TABLE_ROWS = 300;

/** Tells by `change` that it has been read, and by `choose` (detail: a tile) that one was pressed. */
export class TileLine extends EventTarget {
  /** @type {Tile[]} */
  tiles = [];
  /** @type {unknown} */
  error = null;
  #cursor = /** @type {string | null} */ (null);
  #frame = /** @type {number | null} */ (null);
  #reading = 0;
  /** @type {Bar[]} */
  #bars = [];
  /** @type {string[]} */
  #lanes = [];
  #span = { from: 0, to: 1 };

  /**
   * @param {string} job
   * @param {AbortSignal} signal
   */
  constructor(job, signal) {
    super();
    this.job = job;
    this.signal = signal;
    this.canvas = h('canvas', { role: 'img', 'aria-label': 'Time line of the tiles by worker; the table below has the same' });
    this.tip = h('div', { class: 'tip', hidden: true });
    this.holder = h('div', { class: 'time-line' }, this.canvas, this.tip);
    this.note = h('p', { class: 'muted small' });
    this.table = h('div', { class: 'scroll-x' });
    this.details = h('details', {}, h('summary', {}, 'As a table'), this.table);
    this.details.addEventListener('toggle', () => this.#showTable());
    this.element = h('div', { class: 'tile-line' }, this.holder, this.note, this.details);
    this.draw = oncePerFrame(() => this.#draw());
    this.observer = new ResizeObserver(this.draw);
    this.observer.observe(this.holder);
    this.canvas.addEventListener('pointermove', (event) => this.#hover(event));
    this.canvas.addEventListener('pointerleave', () => (this.tip.hidden = true));
    this.canvas.addEventListener('click', (event) => {
      const bar = this.#barAt(event);
      if (bar) this.dispatchEvent(new CustomEvent('choose', { detail: bar.tile }));
    });
    document.addEventListener('themechange', this.draw, { signal });
    signal.addEventListener('abort', () => this.observer.disconnect());
  }

  /**
   * Reads the tiles of a frame, or of all frames.
   * @param {number | null} frame
   */
  async read(frame) {
    this.#reading += 1;
    const reading = this.#reading;
    /** @type {Tile[]} */
    const tiles = [];
    /** @type {string | null} */
    let cursor = null;
    try {
      do {
        /** @type {{tiles: Tile[], next_cursor: string | null}} */
        const page = await getJson(`/v1/jobs/${this.job}/tiles`, { query: { frame, limit: PAGE, cursor }, signal: this.signal });
        tiles.push(...page.tiles);
        cursor = page.next_cursor;
      } while (cursor !== null && tiles.length < MOST);
      this.error = null;
    } catch (error) {
      if (this.signal.aborted) return;
      this.error = error;
    }
    if (reading !== this.#reading) return;
    this.#frame = frame;
    this.#cursor = cursor;
    if (this.error === null) this.tiles = tiles;
    this.#arrange();
    this.dispatchEvent(new Event('change'));
  }

  /** Whether the server has no such history. */
  get isAbsent() {
    return this.error instanceof Problem && this.error.isUnknownRoute;
  }

  #arrange() {
    const now = Date.now();
    /** @type {Map<string, string>} */
    const names = new Map();
    this.#bars = this.tiles.flatMap((tile) =>
      tile.leases.map((lease) => {
        names.set(lease.worker, `${lease.worker_name} (${lease.device})`);
        const from = Date.parse(lease.started_at);
        return { lane: lease.worker, tile, lease, from, to: lease.ended_at === null ? Math.max(now, from) : Date.parse(lease.ended_at) };
      }),
    );
    const first = new Map();
    for (const bar of this.#bars) first.set(bar.lane, Math.min(first.get(bar.lane) ?? Infinity, bar.from));
    this.#lanes = [...names.keys()].sort((a, b) => first.get(a) - first.get(b));
    this.names = names;
    const from = Math.min(...this.#bars.map((bar) => bar.from));
    const to = Math.max(...this.#bars.map((bar) => bar.to));
    this.#span = this.#bars.length === 0 ? { from: 0, to: 1 } : { from, to: Math.max(to, from + 1) };
    const seconds = (this.#span.to - this.#span.from) / 1000;
    const failed = this.#bars.filter((bar) => bar.lease.outcome === 'failed').length;
    const text =
      this.error !== null
        ? this.isAbsent
          ? 'This server does not tell who rendered which tile.'
          : messageOf(this.error)
        : this.#bars.length === 0
          ? 'No tile has been leased yet.'
          : `${counted(this.tiles.length, 'tile')} by ${counted(this.#lanes.length, 'worker')} in ${duration(seconds)}${failed > 0 ? `; ${counted(failed, 'failure')}` : ''}${this.#cursor === null ? '' : '; the rest is not shown'}.`;
    setText(this.note, text);
    this.holder.hidden = this.#bars.length === 0;
    this.details.hidden = this.#bars.length === 0;
    this.#showTable();
    this.draw();
  }

  #labelWidth() {
    return this.holder.clientWidth < 520 ? 84 : LABELS;
  }

  #draw() {
    const width = this.holder.clientWidth;
    if (width === 0 || this.#bars.length === 0) return;
    const height = this.#lanes.length * LANE + AXIS;
    const context = prepareCanvas(this.canvas, width, height);
    const [text, muted, line, failed] = ['--text', '--muted', '--line', '--failed'].map((name) => themeColor(this.holder, name));
    const labels = this.#labelWidth();
    const { from, to } = this.#span;
    const x = (/** @type {number} */ time) => labels + ((time - from) / (to - from)) * (width - labels - 8);
    context.textBaseline = 'middle';
    const step = niceTimeStep((to - from) / 1000, Math.max(2, (width - labels) / 90));
    for (let second = 0; second <= (to - from) / 1000 + 1e-6; second += step) {
      const at = Math.round(x(from + second * 1000)) + 0.5;
      context.fillStyle = line ?? '';
      context.fillRect(at - 0.5, 0, 1, height - AXIS);
      context.fillStyle = muted ?? '';
      context.textAlign = at > width - 30 ? 'right' : 'center';
      context.fillText(second === 0 ? clock(from) : `+${duration(second)}`, Math.max(at, labels - 10), height - AXIS / 2 + 2);
    }
    const lanes = new Map(this.#lanes.map((lane, index) => [lane, index]));
    for (const bar of this.#bars) {
      const lane = lanes.get(bar.lane) ?? 0;
      const left = x(bar.from);
      const right = Math.max(left + 1.5, x(bar.to) - 0.5);
      context.globalAlpha = bar.lease.outcome === null ? 0.55 : bar.lease.outcome === 'done' ? 1 : 0.85;
      context.fillStyle = bar.lease.outcome === 'done' || bar.lease.outcome === null ? categoryColor(lane) : (failed ?? '');
      context.beginPath();
      context.roundRect(left, lane * LANE + 4, right - left, LANE - 8, Math.min(3, (right - left) / 2));
      context.fill();
    }
    context.globalAlpha = 1;
    context.textAlign = 'left';
    context.fillStyle = text ?? '';
    this.#lanes.forEach((lane, index) => context.fillText(shortened(context, this.names?.get(lane) ?? '', labels - 12), 0, index * LANE + LANE / 2));
  }

  /** @param {MouseEvent} event */
  #barAt(event) {
    const { left, top, width } = this.canvas.getBoundingClientRect();
    const labels = this.#labelWidth();
    const lane = this.#lanes[Math.floor((event.clientY - top) / LANE)];
    const { from, to } = this.#span;
    const scale = (to - from) / (width - labels - 8);
    const time = from + (event.clientX - left - labels) * scale;
    let best = null;
    for (const bar of this.#bars) {
      if (bar.lane !== lane) continue;
      const distance = Math.max(bar.from - time, time - bar.to, 0);
      if (distance <= 3 * scale && (best === null || distance < best.distance)) best = { bar, distance };
    }
    return best?.bar ?? null;
  }

  /** @param {PointerEvent} event */
  #hover(event) {
    const bar = this.#barAt(event);
    this.tip.hidden = bar === null;
    if (!bar) return;
    const { tile, lease } = bar;
    this.tip.replaceChildren(h('b', {}, `Tile ${tile.x}, ${tile.y}${this.#frame === null ? ` of frame ${tile.frame}` : ''}`), h('br'), `${this.names?.get(bar.lane) ?? ''}`, h('br'), `${duration((bar.to - bar.from) / 1000)}, ${lease.outcome ?? 'being rendered'}`);
    const { left, top, width } = this.holder.getBoundingClientRect();
    this.tip.style.left = `${Math.max(0, Math.min(width - this.tip.offsetWidth, event.clientX - left + 12))}px`;
    this.tip.style.top = `${event.clientY - top + 16}px`;
  }

  #showTable() {
    if (!this.details.open) return;
    const bars = [...this.#bars].sort((a, b) => a.from - b.from);
    const rows = bars.slice(0, TABLE_ROWS).map(({ tile, lease, lane, from, to }) =>
      h(
        'tr',
        {},
        h('td', {}, this.names?.get(lane) ?? ''),
        h('td', { class: 'number' }, count(tile.frame)),
        h('td', { class: 'nowrap' }, `${tile.x}, ${tile.y} (${tile.width}×${tile.height})`),
        h('td', { class: 'nowrap' }, clock(from)),
        h('td', { class: 'number nowrap' }, duration((to - from) / 1000)),
        h('td', {}, lease.outcome ?? 'being rendered'),
      ),
    );
    this.table.replaceChildren(
      h(
        'table',
        {},
        h('caption', { class: 'visually-hidden' }, 'Tiles by time'),
        h('thead', {}, h('tr', {}, ...['Worker', 'Frame', 'Tile', 'Started', 'Time', 'Outcome'].map((title) => h('th', { scope: 'col', class: title === 'Frame' || title === 'Time' ? 'number' : false }, title)))),
        h('tbody', {}, ...rows),
      ),
      bars.length > TABLE_ROWS ? h('p', { class: 'muted small' }, `The first ${TABLE_ROWS} of ${count(bars.length)}.`) : '',
    );
  }
}

/**
 * Text that fits a width.
 * @param {CanvasRenderingContext2D} context
 * @param {string} text
 * @param {number} width
 */
function shortened(context, text, width) {
  if (context.measureText(text).width <= width) return text;
  let length = text.length;
  while (length > 1 && context.measureText(`${text.slice(0, length)}…`).width > width) length -= 1;
  return `${text.slice(0, length)}…`;
}
