// The editor of a job's text. It knows positions and changes; its extensions know what a job means.

import {
  Annotation,
  Compartment,
  EditorSelection,
  EditorState,
  EditorView,
  HighlightStyle,
  StateEffect,
  bracketMatching,
  closeBrackets,
  closeBracketsKeymap,
  codeFolding,
  completionKeymap,
  defaultKeymap,
  drawSelection,
  dropCursor,
  foldGutter,
  foldKeymap,
  highlightActiveLine,
  highlightActiveLineGutter,
  highlightSelectionMatches,
  highlightSpecialChars,
  history,
  historyKeymap,
  indentOnInput,
  indentUnit,
  isolateHistory,
  job,
  keymap,
  lineNumbers,
  lintGutter,
  lintKeymap,
  redo,
  redoDepth,
  search,
  searchKeymap,
  setDiagnostics,
  syntaxHighlighting,
  tags,
  tooltips,
  undo,
  undoDepth,
} from '/ui/vendor/codemirror.js';
import { messageOf } from '/ui/api.js';
import { removeAt, setPath } from './edits.js';
import { nodeAt } from './json.js';
import { format } from './server.js';
import { textOf, treeOf } from './tree.js';

/** @typedef {import('/ui/vendor/codemirror.js').Extension} Extension */
/** @typedef {import('./edits.js').Change} Change */
/** @typedef {import('./places.js').Mark} Mark */

/** Marks changes that a gesture makes. */
const inGesture = Annotation.define();

/** Says that what is known of the text has changed, but not the text. */
export const refreshed = StateEffect.define();

/** Longest line of a text that is colored, and of one whose lines are broken, which costs a second for each million characters. */
const [MAX_COLORED_CHARS, MAX_WRAPPED_CHARS] = [1_000_000, 100_000];
/** Typing within this time is one step of undo. */
const JOIN_MS = 500;

/** Colors come from the style sheet, so that a theme needs no new editor. */
const highlighting = HighlightStyle.define([
  { tag: tags.propertyName, class: 'tok-key' },
  { tag: tags.string, class: 'tok-text' },
  { tag: tags.number, class: 'tok-number' },
  { tag: [tags.bool, tags.null], class: 'tok-word' },
  { tag: [tags.lineComment, tags.blockComment], class: 'tok-comment' },
  { tag: [tags.separator, tags.squareBracket, tags.brace], class: 'tok-mark' },
]);

export class Editor extends EventTarget {
  /** Whether a gesture has changed something, and goes on. */
  isInGesture = false;
  /** Whether long lines are broken. */
  #wrapping = new Compartment();
  #isWrapped = false;
  /** The marks that are shown, and the text that they are of. */
  #marks = '';
  /** @type {import('/ui/vendor/codemirror.js').Text | null} */
  #markedDoc = null;
  /** Time of the last change, in milliseconds. */
  #changedAt = 0;
  /** @type {Extension[]} */
  #extensions;

  /**
   * @param {HTMLElement} parent
   * @param {Extension[]} more
   */
  constructor(parent, more) {
    super();
    this.#extensions = [
      lineNumbers(),
      foldGutter({ markerDOM: foldMarker }),
      codeFolding({ placeholderText: '…' }),
      lintGutter({ hoverTime: 200 }),
      highlightSpecialChars(),
      // A gesture has no limit in time; typing joins for half a second, as is usual.
      history({
        newGroupDelay: 1e9,
        joinToEvent: (transaction, isAdjacent) =>
          transaction.annotation(inGesture) === true || (isAdjacent && Date.now() - this.#changedAt < JOIN_MS),
      }),
      drawSelection(),
      dropCursor(),
      EditorState.allowMultipleSelections.of(true),
      EditorState.tabSize.of(2),
      indentUnit.of('  '),
      indentOnInput(),
      closeBrackets(),
      highlightActiveLine(),
      highlightActiveLineGutter(),
      highlightSelectionMatches(),
      search({ top: true }),
      tooltips({ position: 'fixed' }),
      syntaxHighlighting(highlighting),
      this.#wrapping.of([]),
      EditorView.contentAttributes.of({ 'aria-label': 'Job file', spellcheck: 'false' }),
      ...more,
      keymap.of([
        { key: 'Shift-Alt-f', run: () => (void this.format(), true) },
        ...closeBracketsKeymap,
        ...defaultKeymap,
        ...searchKeymap,
        ...historyKeymap,
        ...foldKeymap,
        ...completionKeymap,
        ...lintKeymap,
      ]),
      EditorView.updateListener.of((update) => {
        if (update.docChanged) {
          this.#changedAt = Date.now();
          const isGesture = update.transactions.some((transaction) => transaction.annotation(inGesture));
          this.dispatchEvent(new CustomEvent('edit', { detail: { isGesture } }));
        }
        if (update.selectionSet || update.docChanged) this.dispatchEvent(new Event('cursor'));
      }),
    ];
    this.view = new EditorView({ parent, state: this.#newState('') });
  }

  /** @param {string} text */
  #newState(text) {
    return EditorState.create({
      doc: text,
      // A language, and the search of a bracket's other half, cost a pause for each million characters of one line; such a
      // text is shown plain.
      extensions: [...this.#extensions, ...(hasLongLine(text, MAX_COLORED_CHARS) ? [] : [job(), bracketMatching()])],
    });
  }

  get doc() {
    return this.view.state.doc;
  }

  get text() {
    return textOf(this.doc);
  }

  /** The tree of the text, or null if it is too large. */
  get tree() {
    return treeOf(this.doc);
  }

  get cursor() {
    return this.view.state.selection.main.head;
  }

  /** The deepest node at the cursor, or null if the text is too large. */
  nodeAtCursor() {
    const { tree } = this;
    return tree === null ? null : nodeAt(tree, this.cursor);
  }

  get canUndo() {
    return undoDepth(this.view.state) > 0;
  }

  get canRedo() {
    return redoDepth(this.view.state) > 0;
  }

  undo() {
    this.endGesture();
    return undo(this.view);
  }

  redo() {
    return redo(this.view);
  }

  /**
   * Shows another document, without a way back by undo.
   * @param {string} text
   */
  load(text) {
    this.isInGesture = false;
    this.view.setState(this.#newState(text));
    this.wrap(this.#isWrapped);
    this.view.dispatch({ effects: EditorView.scrollIntoView(0, { x: 'start', y: 'start' }) });
    this.dispatchEvent(new CustomEvent('edit', { detail: { isGesture: false, isLoad: true } }));
    this.dispatchEvent(new Event('cursor'));
  }

  /**
   * Changes the text in one step.
   * @param {Change[]} changes
   * @param {{name?: string, cursor?: number, isVisible?: boolean}} [options]
   */
  change(changes, { name = 'input', cursor, isVisible = true } = {}) {
    if (changes.length === 0) return;
    this.endGesture();
    this.view.dispatch({
      changes,
      ...(cursor === undefined ? {} : { selection: EditorSelection.cursor(cursor) }),
      scrollIntoView: isVisible,
      userEvent: name,
      annotations: isolateHistory.of('full'),
    });
  }

  /**
   * Changes the text as a part of a gesture, such as a drag: all its changes are one step of undo.
   * @param {Change[]} changes
   */
  gesture(changes) {
    if (changes.length === 0) return;
    const isFirst = !this.isInGesture;
    this.isInGesture = true;
    this.view.dispatch({ changes, annotations: [inGesture.of(true), ...(isFirst ? [isolateHistory.of('before')] : [])] });
  }

  /** Ends a gesture. */
  endGesture() {
    if (!this.isInGesture) return;
    this.isInGesture = false;
    this.view.dispatch({ annotations: isolateHistory.of('after') });
    this.dispatchEvent(new CustomEvent('edit', { detail: { isGesture: false } }));
  }

  /** Takes the changes of a gesture back. */
  cancelGesture() {
    if (!this.isInGesture) return;
    this.endGesture();
    undo(this.view);
  }

  /**
   * Puts the cursor at a place and shows it.
   * @param {number} from
   * @param {{to?: number, focus?: boolean}} [options]
   */
  show(from, { to = from, focus = false } = {}) {
    const end = Math.min(this.doc.length, Math.max(from, to));
    this.view.dispatch({
      selection: EditorSelection.single(Math.min(from, end), end),
      effects: EditorView.scrollIntoView(Math.min(from, end), { y: 'center' }),
    });
    if (focus) this.view.focus();
  }

  /** @param {Mark[]} marks */
  setMarks(marks) {
    // The same marks again would close what is shown of them.
    const key = JSON.stringify(marks);
    if (key === this.#marks && this.doc === this.#markedDoc) return;
    this.#marks = key;
    this.#markedDoc = this.doc;
    this.view.dispatch(setDiagnostics(this.view.state, marks));
  }

  /** Formats the text, by the server, unless it is changed in the meantime. */
  async format() {
    this.endGesture();
    const { doc, text } = this;
    try {
      const formatted = await format(text);
      if (this.doc !== doc || formatted === text) return;
      this.change([difference(text, formatted)], { name: 'format', cursor: samePlace(text, this.cursor, formatted) });
    } catch (error) {
      this.dispatchEvent(new CustomEvent('note', { detail: messageOf(error) }));
    }
  }

  /**
   * Sets values at paths of the job, or removes them, in one step.
   * @param {{path: (string | number)[], value: string | null}[]} entries values as JSON; null removes
   */
  setPaths(entries) {
    const { tree, text } = this;
    if (tree !== null) this.change(entries.flatMap(({ path, value }) => (value === null ? removeAt(tree, path) : setPath(text, tree, path, value))));
  }

  /**
   * Breaks long lines, or lets them scroll, as very long ones always do.
   * @param {boolean} isWrapped
   */
  wrap(isWrapped) {
    this.#isWrapped = isWrapped;
    const isBroken = isWrapped && !hasLongLine(this.text, MAX_WRAPPED_CHARS);
    this.view.dispatch({ effects: this.#wrapping.reconfigure(isBroken ? EditorView.lineWrapping : []) });
  }

  /** Makes decorations again, because what is known of the text has changed. */
  refresh() {
    this.view.dispatch({ effects: refreshed.of(null) });
  }

  destroy() {
    this.view.destroy();
  }
}

/** @param {boolean} isOpen */
function foldMarker(isOpen) {
  const mark = document.createElement('span');
  mark.className = isOpen ? 'fold open' : 'fold';
  mark.title = isOpen ? 'Fold the lines' : 'Unfold the lines';
  mark.textContent = isOpen ? '⌄' : '›';
  return mark;
}

/**
 * @param {string} text
 * @param {number} most characters of a line that is not long
 */
function hasLongLine(text, most) {
  for (let at = 0; at < text.length; ) {
    const end = text.indexOf('\n', at);
    if ((end < 0 ? text.length : end) - at > most) return true;
    if (end < 0) return false;
    at = end + 1;
  }
  return false;
}

/**
 * The one change between two texts, without what is equal at their ends.
 * @param {string} before
 * @param {string} after
 * @returns {Change}
 */
export function difference(before, after) {
  let from = 0;
  const most = Math.min(before.length, after.length);
  while (from < most && before.charCodeAt(from) === after.charCodeAt(from)) from += 1;
  let tail = 0;
  while (tail < most - from && before.charCodeAt(before.length - 1 - tail) === after.charCodeAt(after.length - 1 - tail)) tail += 1;
  return { from, to: before.length - tail, insert: after.slice(from, after.length - tail) };
}

/**
 * The position in a formatted text of what is at a position before: what is no space stays before it.
 * @param {string} before
 * @param {number} position
 * @param {string} after
 */
function samePlace(before, position, after) {
  let left = before.slice(0, position).replace(/\s+/g, '').length;
  for (let at = 0; at < after.length; at += 1) {
    if (left === 0) return at;
    if (!/\s/.test(after.charAt(at))) left -= 1;
  }
  return after.length;
}
