// Shows a text with line numbers, of any length: only the lines that are seen are drawn.

import { h, oncePerFrame } from '/ui/parts/dom.js';

const LINE = 20;
const MARGIN = 20;
/** Letters of a line that are shown. */
const LETTERS = 4000;

/** Words of JSON with comments: keys, texts, numbers, words, comments. */
const WORDS = /("(?:[^"\\]|\\.)*"?)(\s*:)?|(-?\d[\d.eE+-]*)|\b(true|false|null)\b|(\/\/.*$)|(\/\*.*?(?:\*\/|$))/g;

/**
 * A line of JSON in colors.
 * @param {string} line
 */
function colored(line) {
  const text = line.length > LETTERS ? `${line.slice(0, LETTERS)} …` : line;
  const parts = [];
  let from = 0;
  for (const match of text.matchAll(WORDS)) {
    const [whole, string, colon, number, word] = match;
    if (match.index > from) parts.push(text.slice(from, match.index));
    const kind = string !== undefined ? (colon !== undefined ? 'key' : 'text') : number !== undefined ? 'number' : word !== undefined ? 'word' : 'comment';
    const colored = string ?? whole;
    parts.push(h('span', { class: `code-${kind}` }, colored));
    if (colon !== undefined) parts.push(colon);
    from = match.index + whole.length;
  }
  parts.push(text.slice(from));
  return parts;
}

export class CodeView {
  /** @type {string[]} */
  #lines = [];
  /** @type {Map<number, string>} Messages by line, from 1. */
  #marked = new Map();

  /** @param {string} label */
  constructor(label) {
    this.inner = h('div', { class: 'code-inner' });
    this.element = h('div', { class: 'code-view', tabindex: 0, role: 'region', 'aria-label': label }, this.inner);
    this.draw = oncePerFrame(() => this.#draw());
    this.element.addEventListener('scroll', this.draw, { passive: true });
    this.observer = new ResizeObserver(this.draw);
    this.observer.observe(this.element);
  }

  /** @param {string} text */
  setText(text) {
    this.#lines = text.split(/\r?\n/);
    if (this.#lines.at(-1) === '') this.#lines.pop();
    this.draw();
  }

  /** @param {Map<number, string>} marked */
  mark(marked) {
    this.#marked = marked;
    this.draw();
  }

  /**
   * Scrolls to a line.
   * @param {number} number
   */
  reveal(number) {
    this.element.scrollTop = Math.max(0, (number - 1) * LINE - this.element.clientHeight / 2 + LINE);
    this.draw();
  }

  #draw() {
    const first = Math.max(0, Math.floor(this.element.scrollTop / LINE) - MARGIN);
    const last = Math.min(this.#lines.length, Math.ceil((this.element.scrollTop + this.element.clientHeight) / LINE) + MARGIN);
    this.inner.style.height = `${this.#lines.length * LINE}px`;
    const rows = [];
    for (let index = first; index < last; index += 1) {
      const message = this.#marked.get(index + 1);
      rows.push(
        h(
          'div',
          { class: message === undefined ? 'code-line' : 'code-line wrong', title: message, css: { top: `${index * LINE}px` } },
          h('span', { class: 'line-number' }, index + 1),
          h('code', {}, ...colored(this.#lines[index] ?? '')),
          message === undefined ? null : h('span', { class: 'code-message' }, message),
        ),
      );
    }
    this.inner.replaceChildren(...rows);
  }
}
