// The base of all rooms: a lifetime, a title, and a heading that gets the focus.

import { append, h } from '/ui/parts/dom.js';

/** @typedef {{room: string, id: string | null, query: URLSearchParams}} Place */

/** Base of the rooms. A room is made when it is entered, and removed when it is left. */
export class Room extends HTMLElement {
  #controller = new AbortController();
  /** Where the page is. The router sets it before the room is entered. */
  /** @type {Place} */
  place = { room: '', id: null, query: new URLSearchParams() };

  /** Aborts when the room is left: requests, streams and listeners take it. */
  get signal() {
    return this.#controller.signal;
  }

  connectedCallback() {
    if (this.#controller.signal.aborted) this.#controller = new AbortController();
    this.enter();
  }

  disconnectedCallback() {
    this.#controller.abort();
    this.leave();
  }

  /** Fills the room. */
  enter() {}

  /** Called when the room has been left. */
  leave() {}

  /** Called when only the query of the address has changed. */
  moved() {}

  /**
   * Sets the document's title and the heading's text.
   * @param {string} text
   */
  setTitle(text) {
    document.title = `${text} – sdfarm`;
  }

  /**
   * Listens until the room is left.
   * @param {EventTarget} target
   * @param {string} event
   * @param {(event: any) => void} listener
   */
  listen(target, event, listener) {
    target.addEventListener(event, listener, { signal: this.signal });
  }

  /**
   * Calls a function at an interval until the room is left, and not while the page is hidden.
   * @param {number} milliseconds
   * @param {() => void} work
   */
  every(milliseconds, work) {
    const timer = setInterval(() => {
      if (!document.hidden) work();
    }, milliseconds);
    this.signal.addEventListener('abort', () => clearInterval(timer));
  }
}

/**
 * Makes a room's heading.
 * @param {string} text
 * @param {...import('/ui/parts/dom.js').Child} more
 */
export function heading(text, ...more) {
  return h('h1', { tabindex: -1 }, text, ...more);
}

/**
 * Shows that there is nothing, why, and what to do.
 * @param {string} title
 * @param {...import('/ui/parts/dom.js').Child} more
 */
export function emptyState(title, ...more) {
  const element = h('div', { class: 'empty' }, h('h2', {}, title));
  append(element, more);
  return element;
}
