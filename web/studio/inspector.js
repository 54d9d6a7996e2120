// The line below the text: how many faults it has, where the cursor is, and a slider for the number at the cursor.

import { h, setText } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';
import { counted, shortened } from '/ui/parts/format.js';
import { placeOf } from './document.js';
import { written } from './edits.js';
import { clamped, slider } from './numbers.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {import('./editor.js').Editor} Editor */
/** @typedef {import('./faults.js').Result} Result */

export class Inspector {
  #faults = h('button', { type: 'button', class: 'fault-count', title: 'Show the next fault (F8)', disabled: true });
  #path = h('span', { class: 'cursor-path mono small', title: 'Place of the cursor' });
  #name = h('label', { class: 'mono small', for: 'number-slider' });
  #slider = h('input', { type: 'range', id: 'number-slider' });
  #unit = h('span', { class: 'muted small' });
  #number = h('span', { class: 'number-slider', hidden: true }, this.#name, this.#slider, this.#unit);
  #isSliding = false;

  /**
   * @param {() => Editor} editor
   * @param {(node: JsonNode) => import('./numbers.js').Range & {unit?: string | null}} rangeOf
   * @param {() => void} showNextFault
   */
  constructor(editor, rangeOf, showNextFault) {
    this.editor = editor;
    this.rangeOf = rangeOf;
    this.#faults.addEventListener('click', showNextFault);
    this.#slider.addEventListener('input', () => this.#slid());
    this.#slider.addEventListener('change', () => {
      this.#isSliding = false;
      this.editor().endGesture();
    });
    this.element = h('div', { class: 'inspector' }, this.#faults, this.#path, this.#number);
  }

  /** @param {Result} result */
  showFaults({ marks, state, message }) {
    const errors = marks.filter((mark) => mark.severity === 'error').length;
    const warnings = marks.length - errors;
    const words = [errors > 0 ? counted(errors, 'error') : '', warnings > 0 ? counted(warnings, 'warning') : ''].filter((word) => word !== '');
    const text = words.length > 0 ? words.join(', ') : state === 'valid' ? 'Valid' : 'Not checked';
    this.#faults.className = `fault-count ${errors > 0 ? 'has-errors' : warnings > 0 ? 'has-warnings' : state}`;
    this.#faults.disabled = marks.length === 0;
    this.#faults.title = message === '' ? 'Show the next fault (F8)' : message;
    this.#faults.replaceChildren(icon(errors + warnings > 0 ? 'warning' : state === 'valid' ? 'check' : 'again', 14), text);
  }

  /** The cursor has moved, or the text has changed. */
  showCursor() {
    const editor = this.editor();
    const { tree } = editor;
    const node = tree === null ? null : editor.nodeAtCursor();
    setText(this.#path, node === null ? '' : placeOf(node));
    if (this.#isSliding) return;
    const isNumber = node?.kind === 'number';
    this.#number.hidden = !isNumber;
    if (!isNumber || node === null) return;
    const value = Number(node.value);
    const range = this.rangeOf(node);
    const { low, high, step } = slider(value, range);
    this.#slider.min = String(low);
    this.#slider.max = String(high);
    this.#slider.step = String(step);
    this.#slider.value = String(value);
    setText(this.#name, nameOf(node));
    setText(this.#unit, range.unit ?? '');
  }

  #slid() {
    const editor = this.editor();
    const node = editor.tree === null ? null : editor.nodeAtCursor();
    if (node?.kind !== 'number') return;
    this.#isSliding = true;
    const step = Number(this.#slider.step);
    const digits = Math.max(0, Math.min(8, Math.ceil(-Math.log10(step) - 1e-9)));
    editor.gesture([{ from: node.from, to: node.to, insert: written(clamped(Number(this.#slider.value), this.rangeOf(node)), digits) }]);
  }
}

/**
 * The key of a number, with its place in a list: `position.y`.
 * @param {JsonNode} node
 */
function nameOf(node) {
  const [last, before] = [node.key, node.parent?.key];
  if (typeof last !== 'number') return shortened(String(last ?? ''));
  const isVector = (node.parent?.children.length ?? 0) <= 3;
  return `${shortened(String(before ?? ''))}.${isVector ? ('xyz'[last] ?? last) : last}`;
}
