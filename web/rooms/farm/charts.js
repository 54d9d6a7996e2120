// The last hour at a glance: small charts that share one cursor, and the same numbers as a table.

import { Problem, getJson, messageOf } from '/ui/api.js';
import { niceStep } from '/ui/parts/colors.js';
import { append, h, oncePerFrame, setText, svg } from '/ui/parts/dom.js';
import { clock, count, percent, short } from '/ui/parts/format.js';

/** @typedef {import('/ui/types.js').History} History */
/** @typedef {import('/ui/types.js').HistoryPoint} HistoryPoint */
/** @typedef {{title: string, color: string, value: (point: HistoryPoint, step: number) => number, text: (value: number) => string, most?: number}} Measure */

/** @type {Measure[]} */
const MEASURES = [
  { title: 'Throughput', color: '--running', value: (point, step) => point.rays / step, text: (value) => `${short(value)} rays/s` },
  { title: 'Utilization', color: '--succeeded', value: (point) => point.busy, text: percent, most: 1 },
  { title: 'Waiting tiles', color: '--paused', value: (point) => point.queued_tiles, text: (value) => count(Math.round(value)) },
  { title: 'Workers', color: '--accent', value: (point) => point.workers, text: (value) => count(Math.round(value)) },
];
const HEIGHT = 96;
const TOP = 8;
/** Room above the highest value, for the label of the scale. */
const HEADROOM = 1.1;
const RANGES = /** @type {const} */ ([[900, '15 min'], [3600, '1 hour'], [86_400, '1 day'], [604_800, '1 week']]);
const POINTS = 120;

class Chart {
  /** @type {number[]} */
  #values = [];
  /** @type {HistoryPoint[]} */
  #points = [];

  /**
   * @param {Measure} measure
   * @param {(index: number | null) => void} choose
   */
  constructor(measure, choose) {
    this.measure = measure;
    this.area = svg('path', { class: 'chart-area' });
    this.line = svg('path', { class: 'chart-line' });
    this.grid = svg('g', { class: 'chart-grid' });
    this.cursor = svg('line', { class: 'chart-cursor', y1: 0, y2: HEIGHT, visibility: 'hidden' });
    this.dot = svg('circle', { class: 'chart-dot', r: 3.5, visibility: 'hidden' });
    this.svg = svg('svg', { class: 'chart-picture', height: HEIGHT, preserveAspectRatio: 'none', 'aria-hidden': 'true' }, this.grid, this.area, this.line, this.cursor, this.dot);
    this.now = h('output', { class: 'chart-now', 'aria-live': 'off' });
    this.when = h('span', { class: 'muted small' });
    this.most = h('span', { class: 'chart-most muted small' });
    this.plot = h('div', { class: 'chart-plot', tabindex: 0, role: 'slider', 'aria-label': `${measure.title} over time`, 'aria-valuemin': 0, 'aria-valuemax': 0, 'aria-valuenow': 0 }, this.svg, this.most);
    this.element = h('div', { class: 'chart', css: { '--chart': `var(${measure.color})` } }, h('div', { class: 'chart-head' }, h('h3', {}, measure.title), this.when, this.now), this.plot);
    this.plot.addEventListener('pointermove', (event) => choose(this.#indexAt(event.clientX)));
    this.plot.addEventListener('pointerleave', () => choose(null));
    this.plot.addEventListener('blur', () => choose(null));
    let at = -1;
    this.plot.addEventListener('keydown', (event) => {
      const last = this.#values.length - 1;
      const from = at < 0 ? last : Math.min(at, last);
      /** @type {Record<string, number>} */
      const targets = { ArrowLeft: from - 1, ArrowRight: from + 1, Home: 0, End: last, PageUp: from - 10, PageDown: from + 10 };
      const target = targets[event.key];
      if (target === undefined) return;
      event.preventDefault();
      at = Math.max(0, Math.min(last, target));
      choose(at);
    });
  }

  /** @param {number} x */
  #indexAt(x) {
    const { left, width } = this.plot.getBoundingClientRect();
    const last = this.#values.length - 1;
    return last < 1 ? null : Math.max(0, Math.min(last, Math.round(((x - left) / width) * last)));
  }

  /** @param {History} history */
  show(history) {
    this.#points = history.points;
    this.#values = history.points.map((point) => this.measure.value(point, history.step_seconds));
    this.plot.setAttribute('aria-valuemax', String(Math.max(0, this.#values.length - 1)));
    this.draw();
  }

  draw() {
    const width = this.plot.clientWidth;
    const values = this.#values;
    if (width === 0 || values.length < 2) return;
    const highest = Math.max(...values);
    const step = niceStep(highest || 1, 4);
    const most = this.measure.most ?? Math.max(step, Math.ceil((highest * HEADROOM) / step) * step);
    this.svg.setAttribute('viewBox', `0 0 ${width} ${HEIGHT}`);
    this.svg.setAttribute('width', String(width));
    const x = (/** @type {number} */ index) => (index / (values.length - 1)) * width;
    const y = (/** @type {number} */ value) => HEIGHT - 1 - (value / most) * (HEIGHT - TOP - 1);
    this.place = (/** @type {number} */ index) => ({ x: x(index), y: y(values[index] ?? 0) });
    const path = values.map((value, index) => `${index === 0 ? 'M' : 'L'}${x(index).toFixed(1)} ${y(value).toFixed(1)}`).join('');
    this.line.setAttribute('d', path);
    this.area.setAttribute('d', `${path}L${width} ${HEIGHT}L0 ${HEIGHT}Z`);
    this.grid.replaceChildren(...[1, 0.5].map((part) => svg('line', { x1: 0, x2: width, y1: y(most * part), y2: y(most * part) })));
    setText(this.most, this.measure.text(most));
    this.mark(null);
  }

  /** @param {number | null} index */
  mark(index) {
    const values = this.#values;
    const at = index ?? values.length - 1;
    const value = values[at];
    if (value === undefined) return;
    setText(this.now, this.measure.text(value));
    setText(this.when, index === null ? '' : clock(this.#points[at]?.at ?? 0, false));
    this.plot.setAttribute('aria-valuenow', String(at));
    this.plot.setAttribute('aria-valuetext', `${clock(this.#points[at]?.at ?? 0, false)}: ${this.measure.text(value)}`);
    const visibility = index === null ? 'hidden' : 'visible';
    this.cursor.setAttribute('visibility', visibility);
    this.dot.setAttribute('visibility', visibility);
    const place = this.place?.(at);
    if (!place) return;
    this.cursor.setAttribute('x1', String(place.x));
    this.cursor.setAttribute('x2', String(place.x));
    this.dot.setAttribute('cx', String(place.x));
    this.dot.setAttribute('cy', String(place.y));
  }
}

/** The charts' panel. */
export class Charts {
  #seconds = 3600;
  /** @type {History | null} */
  #history = null;

  /** @param {AbortSignal} signal */
  constructor(signal) {
    this.signal = signal;
    this.charts = MEASURES.map((measure) => new Chart(measure, (index) => this.charts.forEach((chart) => chart.mark(index))));
    this.grid = h('div', { class: 'charts' }, ...this.charts.map((chart) => chart.element));
    this.note = h('p', { class: 'empty-line', hidden: true });
    this.table = h('div', { class: 'scroll-x table-tall', tabindex: 0, role: 'region', 'aria-label': 'History' });
    this.details = h('details', { class: 'chart-table' }, h('summary', {}, 'As a table'), this.table);
    this.details.addEventListener('toggle', () => this.#showTable());
    this.ranges = h(
      'div',
      { class: 'segments', role: 'group', 'aria-label': 'Time shown' },
      ...RANGES.map(([seconds, label]) => h('button', { type: 'button', 'aria-pressed': String(seconds === this.#seconds), 'data-seconds': seconds, on: { click: () => this.#setRange(seconds) } }, label)),
    );
    this.element = h('section', { class: 'panel' }, h('div', { class: 'panel-head' }, h('h2', {}, 'History'), this.ranges), this.note, this.grid, this.details);
    const draw = oncePerFrame(() => this.charts.forEach((chart) => chart.draw()));
    const observer = new ResizeObserver(draw);
    observer.observe(this.grid);
    signal.addEventListener('abort', () => observer.disconnect());
  }

  /** @param {number} seconds */
  #setRange(seconds) {
    this.#seconds = seconds;
    for (const button of this.ranges.children) button.setAttribute('aria-pressed', String(Number(/** @type {HTMLElement} */ (button).dataset['seconds']) === seconds));
    void this.read();
  }

  async read() {
    try {
      this.#history = /** @type {History} */ (await getJson('/v1/history', { query: { seconds: this.#seconds, points: POINTS }, signal: this.signal }));
    } catch (error) {
      if (this.signal.aborted) return;
      const isAbsent = error instanceof Problem && error.isUnknownRoute;
      this.#say(isAbsent ? 'This server keeps no history. Its metrics for Prometheus are at /metrics.' : messageOf(error));
      return;
    }
    if (this.#history.points.length < 2) {
      this.#say('There is no history yet: the first point is written within a minute.');
      return;
    }
    this.#say('');
    this.charts.forEach((chart) => this.#history && chart.show(this.#history));
    this.#showTable();
  }

  /** @param {string} text */
  #say(text) {
    setText(this.note, text);
    this.note.hidden = text === '';
    this.grid.hidden = text !== '';
    this.details.hidden = text !== '';
  }

  #showTable() {
    const history = this.#history;
    if (!this.details.open || history === null) return;
    const rows = [...history.points].reverse().map((point) =>
      h('tr', {}, h('td', { class: 'nowrap' }, clock(point.at)), ...MEASURES.map((measure) => h('td', { class: 'number' }, measure.text(measure.value(point, history.step_seconds)))), h('td', { class: 'number' }, count(point.frames)), h('td', { class: 'number' }, count(point.jobs_running)), h('td', { class: 'number' }, count(point.jobs_queued))),
    );
    const titles = [...MEASURES.map((measure) => measure.title), 'Frames', 'Running jobs', 'Queued jobs'];
    const table = h('table', {}, h('caption', { class: 'visually-hidden' }, 'History, newest first'), h('thead', {}, h('tr', {}, h('th', { scope: 'col' }, 'Time'), ...titles.map((title) => h('th', { scope: 'col', class: 'number' }, title)))), h('tbody', {}, ...rows));
    this.table.replaceChildren();
    append(this.table, [table]);
  }
}
