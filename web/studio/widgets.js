// Things to hold in the text: numbers that are dragged, and swatches of colors.

import { Decoration, EditorSelection, EditorView, ViewPlugin, WidgetType, keymap } from '/ui/vendor/codemirror.js';
import { hexOf, colorOf, writtenLike } from './color.js';
import { refreshed } from './editor.js';
import { shortened } from '/ui/parts/format.js';
import { nodeAt } from './json.js';
import { dragged, stepped } from './numbers.js';
import { textOf, treeOf } from './tree.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {import('./editor.js').Editor} Editor */
/** @typedef {import('./numbers.js').Range} Range */
/**
 * @typedef {object} Knowledge
 * @property {(node: JsonNode) => Range} rangeOf
 * @property {(node: JsonNode) => boolean} isColor
 */

/** Movement that turns a press into a drag, in pixels. */
const THRESHOLD_PX = 4;
/** Characters around the seen text in which swatches are shown. */
const MARGIN_CHARS = 2000;

/**
 * Fine with Shift, coarse with Alt or Ctrl.
 * @param {{shiftKey: boolean, altKey: boolean, ctrlKey: boolean, metaKey: boolean}} event
 */
const factorOf = (event) => (event.shiftKey ? 0.1 : event.altKey || event.ctrlKey || event.metaKey ? 10 : 1);

/**
 * The number at a position of the text.
 * @param {EditorView} view
 * @param {number} position
 */
export function numberAt(view, position) {
  const tree = treeOf(view.state.doc);
  if (tree === null) return null;
  const node = nodeAt(tree, position);
  if (node.kind !== 'number' || position < node.from || position > node.to) return null;
  return node;
}

/**
 * The numbers of a list whose opening bracket is at a position: they change together.
 * @param {EditorView} view
 * @param {number} position
 */
function vectorAt(view, position) {
  const tree = treeOf(view.state.doc);
  if (tree === null) return null;
  const node = nodeAt(tree, position);
  const isVector = node.kind === 'list' && position <= node.from + 1 && node.children.length >= 2 && node.children.length <= 4;
  return isVector && node.children.every((item) => item.kind === 'number') ? node : null;
}

/**
 * Extensions of the editor.
 * @param {() => Editor} editor
 * @param {Knowledge} knowledge
 */
export function widgets(editor, knowledge) {
  return [dragging(editor, knowledge), stepping(editor, knowledge), swatches(editor, knowledge)];
}

/**
 * Numbers follow a horizontal drag; a vertical one selects text, as everywhere.
 * @param {() => Editor} editor
 * @param {Knowledge} knowledge
 */
function dragging(editor, knowledge) {
  return EditorView.domEventHandlers({
    mousedown(event, view) {
      if (event.button !== 0 || event.detail > 1 || event.target instanceof HTMLInputElement) return false;
      if (!(event.target instanceof Element) || event.target.closest('.tok-number, .tok-mark') === null) return false;
      const position = view.posAtCoords({ x: event.clientX, y: event.clientY });
      if (position === null) return false;
      const number = numberAt(view, position);
      const vector = number === null ? vectorAt(view, position) : null;
      const held = number === null ? (vector?.children ?? []) : [number];
      if (held.length === 0) return false;
      const starts = held.map((node) => ({ at: node.from, length: node.to - node.from, value: Number(node.value), range: knowledge.rangeOf(node) }));
      let origin = { x: event.clientX, factor: factorOf(event) };
      /** @type {'undecided' | 'drag' | 'select'} */
      let state = 'undecided';
      const controller = new AbortController();
      const { signal } = controller;

      /** @param {MouseEvent} move */
      const follow = (move) => {
        const [x, y] = [move.clientX - event.clientX, move.clientY - event.clientY];
        if (state === 'undecided' && Math.hypot(x, y) >= THRESHOLD_PX) {
          state = Math.abs(x) >= Math.abs(y) ? 'drag' : 'select';
          view.dom.classList.toggle('dragging-number', state === 'drag');
          if (state === 'drag') origin.x = move.clientX;
        }
        if (state === 'select') {
          const head = view.posAtCoords({ x: move.clientX, y: move.clientY }, false);
          view.dispatch({ selection: EditorSelection.single(position, head) });
        } else if (state === 'drag') {
          drag(move);
        }
      };

      /** @param {MouseEvent} move */
      const drag = (move) => {
        const factor = factorOf(move);
        if (factor !== origin.factor) {
          // Another modifier goes on from the number that has been reached.
          const text = textOf(view.state.doc);
          for (const start of starts) start.value = Number(text.slice(start.at, start.at + start.length));
          origin = { x: move.clientX, factor };
        }
        let shift = 0;
        const changes = [];
        for (const start of starts) {
          const insert = dragged(start.value, move.clientX - origin.x, factor, start.range);
          const from = start.at;
          changes.push({ from, to: from + start.length, insert });
          start.at = from + shift;
          shift += insert.length - start.length;
          start.length = insert.length;
        }
        const text = textOf(view.state.doc);
        if (changes.some((change) => text.slice(change.from, change.to) !== change.insert)) editor().gesture(changes);
      };

      const end = (/** @type {boolean} */ isDone) => {
        controller.abort();
        view.dom.classList.remove('dragging-number');
        if (state === 'drag' && isDone) editor().endGesture();
        else if (state === 'drag') editor().cancelGesture();
        else if (state === 'undecided') view.dispatch({ selection: EditorSelection.cursor(position) });
        view.focus();
      };
      addEventListener('mousemove', follow, { signal });
      addEventListener('mouseup', () => end(true), { signal });
      addEventListener('blur', () => end(true), { signal });
      addEventListener('keydown', (key) => {
        if (key.key !== 'Escape') return;
        key.preventDefault();
        key.stopPropagation();
        end(false);
      }, { signal, capture: true });
      event.preventDefault();
      return true;
    },
  });
}

/**
 * Numbers change by keys, too.
 * @param {() => Editor} editor
 * @param {Knowledge} knowledge
 */
function stepping(editor, knowledge) {
  /** @param {number} direction @param {number} factor */
  const step = (direction, factor) => (/** @type {EditorView} */ view) => {
    const node = numberAt(view, view.state.selection.main.head);
    if (node === null) return false;
    const insert = stepped(Number(node.value), direction, factor, knowledge.rangeOf(node));
    editor().change([{ from: node.from, to: node.to, insert }], { name: 'input.step', cursor: node.from + insert.length });
    return true;
  };
  return keymap.of([
    { key: 'Ctrl-.', run: step(1, 1), preventDefault: true },
    { key: 'Ctrl-,', run: step(-1, 1), preventDefault: true },
    { key: 'Ctrl-Shift-.', run: step(1, 10), preventDefault: true },
    { key: 'Ctrl-Shift-,', run: step(-1, 10), preventDefault: true },
    { key: 'Ctrl-Alt-.', run: step(1, 0.1), preventDefault: true },
    { key: 'Ctrl-Alt-,', run: step(-1, 0.1), preventDefault: true },
    { key: 'Alt-c', run: openPicker, preventDefault: true },
  ]);
}

/**
 * Opens the color field of the color at the cursor.
 * @param {EditorView} view
 */
function openPicker(view) {
  const tree = treeOf(view.state.doc);
  /** @type {JsonNode | null} */
  let node = tree === null ? null : nodeAt(tree, view.state.selection.main.head);
  if (node?.kind === 'number') node = node.parent;
  const place = node?.from;
  const field = [...view.contentDOM.querySelectorAll('input.swatch')].find((each) => view.posAtDOM(each) === place);
  if (!(field instanceof HTMLInputElement)) return false;
  field.focus();
  try {
    field.showPicker();
  } catch {
    // The field has the focus: Space opens it.
  }
  return true;
}

/** The swatch before a color. */
class Swatch extends WidgetType {
  /**
   * @param {() => Editor} editor
   * @param {string} hex
   * @param {string} label
   * @param {boolean} isEditable
   */
  constructor(editor, hex, label, isEditable) {
    super();
    this.editor = editor;
    this.hex = hex;
    this.label = label;
    this.isEditable = isEditable;
  }

  /** @param {Swatch} other */
  eq(other) {
    return other.hex === this.hex && other.label === this.label && other.isEditable === this.isEditable;
  }

  /** @param {EditorView} view */
  toDOM(view) {
    if (!this.isEditable) {
      const mark = document.createElement('span');
      mark.className = 'swatch';
      mark.style.backgroundColor = this.hex;
      mark.ariaHidden = 'true';
      return mark;
    }
    const field = document.createElement('input');
    field.type = 'color';
    field.className = 'swatch';
    field.tabIndex = -1;
    this.updateDOM(field);
    field.addEventListener('input', () => {
      const tree = treeOf(view.state.doc);
      const node = tree === null ? undefined : nodeAfter(tree, view.posAtDOM(field));
      if (node !== undefined && colorOf(node)?.isEditable) this.editor().gesture([{ from: node.from, to: node.to, insert: writtenLike(field.value, node) }]);
    });
    field.addEventListener('change', () => this.editor().endGesture());
    field.addEventListener('keydown', (event) => {
      if (event.key === 'Escape') view.focus();
    });
    return field;
  }

  /** @param {HTMLElement} field */
  updateDOM(field) {
    if (!(field instanceof HTMLInputElement) || !this.isEditable) return false;
    if (field.value !== this.hex) field.value = this.hex;
    field.title = `${this.label}: choose a color (Alt+C)`;
    field.ariaLabel = `Color ${this.label}`;
    return true;
  }

  ignoreEvent() {
    return true;
  }
}

/**
 * The list or text that begins at a position.
 * @param {JsonNode} tree
 * @param {number} position
 */
function nodeAfter(tree, position) {
  /** @type {JsonNode | null} */
  let node = nodeAt(tree, position);
  while (node !== null && node.from !== position) node = node.parent;
  return node ?? undefined;
}

/**
 * @param {() => Editor} editor
 * @param {Knowledge} knowledge
 */
function swatches(editor, knowledge) {
  /** @param {EditorView} view */
  const decorate = (view) => {
    const tree = treeOf(view.state.doc);
    if (tree === null) return Decoration.none;
    // A line may be longer than what is seen of it.
    const from = (view.visibleRanges[0]?.from ?? 0) - MARGIN_CHARS;
    const to = (view.visibleRanges.at(-1)?.to ?? 0) + MARGIN_CHARS;
    /** @type {import('/ui/vendor/codemirror.js').Range<Decoration>[]} */
    const found = [];
    /** @param {JsonNode} node */
    const visit = (node) => {
      if (node.to < from || node.from > to) return;
      const color = knowledge.isColor(node) ? colorOf(node) : undefined;
      if (color !== undefined) {
        const label = shortened(String(node.key ?? ''));
        found.push(Decoration.widget({ widget: new Swatch(editor, hexOf(color.linear).hex, label, color.isEditable), side: -1 }).range(node.from));
      } else {
        node.children.forEach(visit);
      }
    };
    visit(tree);
    return Decoration.set(found, true);
  };
  return ViewPlugin.fromClass(
    class {
      /** @param {EditorView} view */
      constructor(view) {
        this.decorations = decorate(view);
      }

      /** @param {import('/ui/vendor/codemirror.js').ViewUpdate} update */
      update(update) {
        if (update.docChanged || update.viewportChanged || update.transactions.some((each) => each.effects.some((effect) => effect.is(refreshed)))) this.decorations = decorate(update.view);
      }
    },
    { decorations: (plugin) => plugin.decorations },
  );
}
