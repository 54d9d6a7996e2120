// Shipped scenes and examples of every kind, one click away.

import { h, setText } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';
import { messageOf } from '/ui/api.js';
import { size } from '/ui/parts/format.js';
import { FAMILIES } from './nodes.js';
import { scenes } from './server.js';

/** @typedef {import('./nodes.js').NodeTable} NodeTable */
/** @typedef {import('./nodes.js').Kind} Kind */

/** Events: `scene` with a name, `kind` with a `Kind`, `close`. */
export class Examples extends EventTarget {
  #search = h('input', { type: 'search', placeholder: 'Search shapes, materials, lights…', 'aria-label': 'Search the examples', on: { input: () => this.#filter() } });
  #scenes = h('div', { class: 'scene-list' });
  #kinds = h('div', { class: 'kind-list' });
  #count = h('p', { class: 'muted small', role: 'status' });
  #areScenesLoaded = false;

  /** @param {AbortSignal} signal */
  constructor(signal) {
    super();
    this.signal = signal;
    this.element = h(
      'aside',
      { class: 'examples', 'aria-label': 'Scenes and examples', hidden: true, on: { keydown: (event) => this.#key(event) } },
      h('div', { class: 'examples-head' }, h('h2', {}, 'Scenes and examples'), h('button', { type: 'button', class: 'ghost', 'aria-label': 'Close the examples', on: { click: () => this.close() } }, icon('cross'))),
      this.#search,
      this.#count,
      h('div', { class: 'examples-body' }, h('section', {}, h('h3', {}, 'Scenes'), this.#scenes), this.#kinds),
    );
  }

  get isOpen() {
    return !this.element.hidden;
  }

  close() {
    this.dispatchEvent(new Event('close'));
  }

  /** Shows or hides the list. @param {boolean} isOpen */
  toggle(isOpen) {
    this.element.hidden = !isOpen;
    if (!isOpen) return;
    // On a touch screen the focus would open a keyboard over the list.
    if (matchMedia('(pointer: fine)').matches) this.#search.focus();
    if (!this.#areScenesLoaded) void this.#loadScenes();
  }

  async #loadScenes() {
    try {
      const list = await scenes(this.signal);
      this.#areScenesLoaded = true;
      this.#scenes.replaceChildren(
        ...list.scenes.map((scene) =>
          h('button', { type: 'button', class: 'scene-item', title: `${scene.title} (${size(scene.bytes)})`, 'data-words': `${scene.name} ${scene.title}`.toLowerCase(), on: { click: () => this.dispatchEvent(new CustomEvent('scene', { detail: scene.name })) } }, h('strong', {}, scene.name)),
        ),
      );
      this.#filter();
    } catch (error) {
      if (!this.signal.aborted) this.#scenes.replaceChildren(h('p', { class: 'muted' }, messageOf(error)));
    }
  }

  /**
   * Takes the table of kinds.
   * @param {NodeTable} table
   */
  setTable(table) {
    const families = FAMILIES.flatMap(([family, title]) => {
      const kinds = table.family(family).filter((kind) => kind.example !== null && kind.example !== undefined);
      return kinds.length === 0 ? [] : [h('section', {}, h('h3', {}, title), h('div', { class: 'kind-grid' }, ...kinds.map((kind) => this.#item(kind))))];
    });
    this.#kinds.replaceChildren(...families);
    this.#filter();
  }

  /** @param {Kind} kind */
  #item(kind) {
    const picture = kind.picture === null ? h('span', { class: 'no-picture' }) : h('img', { src: kind.picture, alt: '', loading: 'lazy', width: 96, height: 72 });
    return h(
      'button',
      { type: 'button', class: 'kind-item', title: kind.title, 'data-words': `${kind.name} ${kind.family} ${kind.title}`.toLowerCase(), on: { click: () => this.dispatchEvent(new CustomEvent('kind', { detail: kind })) } },
      picture,
      h('span', {}, kind.name),
    );
  }

  #filter() {
    const words = this.#search.value.toLowerCase().split(/\s+/).filter((word) => word !== '');
    let shown = 0;
    for (const item of this.element.querySelectorAll('[data-words]')) {
      if (!(item instanceof HTMLElement)) continue;
      item.hidden = !words.every((word) => item.dataset['words']?.includes(word));
      if (!item.hidden) shown += 1;
    }
    for (const section of this.element.querySelectorAll('section')) section.hidden = section.querySelector('[data-words]') !== null && section.querySelector('[data-words]:not([hidden])') === null;
    setText(this.#count, words.length === 0 ? 'A click inserts an example at the cursor; a scene opens as a new draft.' : `${shown} found`);
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (event.key === 'Escape') {
      event.preventDefault();
      this.close();
    } else if (event.key === 'ArrowDown' && event.target === this.#search) {
      event.preventDefault();
      const first = this.element.querySelector('[data-words]:not([hidden])');
      if (first instanceof HTMLElement) first.focus();
    }
  }
}
