// The price of a job on this farm, before it is rendered: time and money with their error, where the time goes, and the
// numbers that would save most.

import { isAbort, messageOf, sentence } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { duration, shortened } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { price } from './server.js';

/** @typedef {import('./server.js').Price} Price */
/** @typedef {import('./server.js').PriceMap} PriceMap */
/** @typedef {import('./server.js').Saving} Saving */

/**
 * The time with its error: `12 s (9.1 s to 17 s)`.
 * @param {Price} value
 */
export function timeText(value) {
  if (value.seconds === null) return `${duration(value.core_seconds)} of one core (no worker is ready)`;
  const { seconds_low: low, seconds_high: high } = value;
  return `${duration(value.seconds)}${low === null || high === null ? '' : ` (${duration(low)} to ${duration(high)})`}`;
}

/**
 * @param {{amount: number, currency: string}} cost
 */
export function costText({ amount, currency }) {
  const digits = amount >= 100 ? 0 : amount >= 0.1 ? 2 : 4;
  return `${amount.toFixed(digits)} ${currency}`;
}

/**
 * Draws a map on a canvas, a pixel for each cell: from nothing to bright for the most expensive.
 * @param {HTMLCanvasElement} canvas
 * @param {PriceMap} map
 */
export function drawMap(canvas, map) {
  canvas.width = map.columns;
  canvas.height = map.rows;
  const context = canvas.getContext('2d');
  if (context === null) return;
  const most = Math.max(...map.seconds, 1e-12);
  const image = context.createImageData(map.columns, map.rows);
  map.seconds.forEach((seconds, cell) => {
    const heat = Math.sqrt(Math.max(0, seconds) / most);
    image.data.set(heatColor(heat), cell * 4);
  });
  context.putImageData(image, 0, 0);
}

/**
 * A color from blue over magenta to yellow, more opaque where it is hotter.
 * @param {number} heat 0 to 1
 */
function heatColor(heat) {
  const stops = [[20, 20, 90], [120, 20, 140], [225, 70, 90], [252, 170, 60], [255, 245, 160]];
  const at = Math.min(stops.length - 1.001, heat * (stops.length - 1));
  const [low, high] = [stops[Math.floor(at)] ?? [0, 0, 0], stops[Math.floor(at) + 1] ?? [0, 0, 0]];
  const part = at - Math.floor(at);
  return [...low.map((value, index) => Math.round(value + ((high[index] ?? 0) - value) * part)), Math.round(90 + 140 * heat)];
}

/** The panel with the price. Events: `map` with a map or null, `save` with a `Saving`, `close`. */
export class PricePanel extends EventTarget {
  /** @type {AbortController | null} */
  #running = null;
  #body = h('div', { class: 'price-body', 'aria-live': 'polite' });
  #mapToggle = h('input', { type: 'checkbox', on: { change: () => this.#showMap() } });
  /** @type {PriceMap | null} */
  #map = null;

  constructor() {
    super();
    this.element = h(
      'section',
      { class: 'price-panel', 'aria-label': 'Price', hidden: true, on: { keydown: (event) => event.key === 'Escape' && this.close() } },
      h('div', { class: 'panel-line' }, h('h2', {}, 'Price'), h('button', { type: 'button', class: 'ghost', 'aria-label': 'Close the price', on: { click: () => this.close() } }, icon('cross'))),
      this.#body,
    );
  }

  get isOpen() {
    return !this.element.hidden;
  }

  close() {
    this.#running?.abort();
    this.element.hidden = true;
    this.dispatchEvent(new CustomEvent('map', { detail: null }));
    this.dispatchEvent(new Event('close'));
  }

  /** The text has changed: the price is of an older one. */
  expire() {
    if (!this.isOpen || this.element.classList.contains('is-old')) return;
    this.element.classList.add('is-old');
    this.dispatchEvent(new CustomEvent('map', { detail: null }));
  }

  /**
   * Measures the price of a text.
   * @param {string} text
   */
  async open(text) {
    this.#running?.abort();
    const running = new AbortController();
    this.#running = running;
    this.element.hidden = false;
    this.element.classList.remove('is-old');
    this.#body.replaceChildren(h('p', { class: 'muted' }, 'Rendering a sample of the picture…'));
    try {
      this.#show(await price(text, true, running.signal));
    } catch (error) {
      if (!isAbort(error)) this.#body.replaceChildren(h('p', { class: 'field-error' }, messageOf(error)));
    }
  }

  /** @param {Price} value */
  #show(value) {
    this.#map = value.map;
    const facts = h(
      'dl',
      { class: 'facts' },
      h('dt', {}, 'Time on this farm'),
      h('dd', {}, timeText(value)),
      h('dt', {}, 'Work'),
      h('dd', {}, `${duration(value.core_seconds)} of one core`),
      ...(value.cost === null ? [] : [h('dt', {}, 'Cost'), h('dd', {}, costText(value.cost))]),
    );
    const toggle = value.map === null ? null : h('label', { class: 'check' }, this.#mapToggle, 'Show where the time goes');
    const savings = value.savings.map((saving) => this.#saving(saving));
    this.#body.replaceChildren(
      facts,
      ...(toggle === null ? [] : [toggle]),
      ...(savings.length === 0 ? [] : [h('h3', {}, 'Savings'), h('ul', { class: 'savings' }, ...savings)]),
    );
    this.#showMap();
  }

  /** @param {Saving} saving */
  #saving(saving) {
    const { pointer, from, to } = saving;
    const name = shortened(pointer.split('/').at(-1) ?? pointer);
    const change = to === null ? `without ${name}` : from === null ? `${name}: ${to}` : `${name}: ${from} → ${to}`;
    return h(
      'li',
      {},
      h('div', {}, h('code', { title: shortened(pointer) }, change), ' ', h('strong', {}, `−${Math.round(saving.saves_share * 100)} %, ${duration(saving.saves_seconds)}`), h('p', { class: 'muted small' }, sentence(saving.message.replace(/^[\w.]+: /, '')))),
      h('button', { type: 'button', class: 'button', 'aria-label': `Apply: ${change}`, on: { click: () => this.dispatchEvent(new CustomEvent('save', { detail: saving })) } }, 'Apply'),
    );
  }

  #showMap() {
    this.dispatchEvent(new CustomEvent('map', { detail: this.#mapToggle.checked ? this.#map : null }));
  }
}
