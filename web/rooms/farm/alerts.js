// The farm's alerts with their cures, and its disk.

import { Problem, getJson, messageOf, sentence } from '/ui/api.js';
import { append, h } from '/ui/parts/dom.js';
import { ago, percent, size } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';

/** @typedef {import('/ui/types.js').Alert} Alert */

/** The alerts, worst first. */
export class Alerts {
  #shown = '';

  /** @param {AbortSignal} signal */
  constructor(signal) {
    this.signal = signal;
    this.element = h('div', { class: 'alerts', role: 'region', 'aria-label': 'Alerts' });
  }

  async read() {
    try {
      const { alerts } = await getJson('/v1/alerts', { signal: this.signal });
      this.#show(alerts);
    } catch (error) {
      if (this.signal.aborted) return;
      if (error instanceof Problem && error.isUnknownRoute) this.element.replaceChildren();
      else this.element.replaceChildren(h('p', { class: 'alert warning' }, icon('warning'), messageOf(error)));
      this.#shown = '';
    }
  }

  /** @param {Alert[]} alerts */
  #show(alerts) {
    const key = JSON.stringify(alerts);
    if (key === this.#shown) return;
    this.#shown = key;
    const sorted = [...alerts].sort((a, b) => Number(b.severity === 'critical') - Number(a.severity === 'critical'));
    this.element.replaceChildren();
    append(
      this.element,
      sorted.length === 0
        ? [h('p', { class: 'alert fine' }, icon('check'), 'All is well: nothing needs you.')]
        : sorted.map((alert) =>
            h(
              'div',
              { class: `alert ${alert.severity}` },
              icon('warning'),
              h('div', {}, h('p', {}, h('b', {}, ...withCode(sentence(alert.message))), alert.since ? h('span', { class: 'small since' }, ` since ${ago(alert.since)}`) : null), h('p', {}, ...withCode(sentence(alert.cure)))),
            ),
          ),
    );
  }
}

/**
 * Text whose parts between backticks are commands.
 * @param {string} text
 */
const withCode = (text) => text.split('`').map((part, index) => (index % 2 === 1 ? h('code', {}, part) : part));

/** The farm's disk. */
export class Disk {
  /** @param {AbortSignal} signal */
  constructor(signal) {
    this.signal = signal;
    this.body = h('div', { class: 'panel-body disk' });
    this.element = h('section', { class: 'panel', hidden: true }, h('div', { class: 'panel-head' }, h('h2', {}, 'Disk')), this.body);
  }

  /**
   * Shows the disk of an answer.
   * @param {{free_bytes: number, total_bytes: number, pictures_bytes: number | null, blobs_bytes: number | null} | null | undefined} disk
   */
  show(disk) {
    this.element.hidden = !disk;
    if (!disk) return;
    const { free_bytes: free, total_bytes: total } = disk;
    // In a bucket they take no place on the disk.
    const [pictures, blobs] = [disk.pictures_bytes ?? 0, disk.blobs_bytes ?? 0];
    const other = Math.max(0, total - free - pictures - blobs);
    const parts = [
      { name: 'Pictures', bytes: pictures, color: '--accent' },
      { name: 'Tiles', bytes: blobs, color: '--running' },
      { name: 'Other', bytes: other, color: '--cancelled' },
      { name: 'Free', bytes: free, color: '--line-strong' },
    ];
    this.body.replaceChildren(
      h('div', { class: 'disk-bar', role: 'img', 'aria-label': `${percent(1 - free / Math.max(1, total))} of the disk is used` }, ...parts.slice(0, 3).map((part) => h('i', { css: { width: `${(part.bytes / Math.max(1, total)) * 100}%`, background: `var(${part.color})` } }))),
      h('dl', { class: 'disk-legend' }, ...parts.map((part) => h('div', {}, h('dt', {}, h('i', { css: { background: `var(${part.color})` } }), part.name), h('dd', {}, size(part.bytes))))),
      h('p', { class: 'muted small' }, `${size(free)} of ${size(total)} free.`),
    );
  }
}
