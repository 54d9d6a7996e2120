// Completion and help in the editor, from the server's table of kinds and the text itself.

import { EditorView, autocompletion, hoverTooltip, startCompletion, keymap, tooltips } from '/ui/vendor/codemirror.js';
import { h } from '/ui/parts/dom.js';
import { shortened } from '/ui/parts/format.js';
import { documentation } from './documentation.js';
import { pretty } from './insert.js';
import { indentAt } from './edits.js';
import { nodeAt, pathOf, placeAt } from './json.js';
import { namesOf } from './nodes.js';
import { textOf, treeOf } from './tree.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {import('./json.js').Place} Place */
/** @typedef {import('./nodes.js').NodeTable} NodeTable */
/** @typedef {import('./nodes.js').Kind} Kind */
/** @typedef {import('./nodes.js').Key} Key */
/** @typedef {import('./nodes.js').Slot} Slot */
/** @typedef {import('/ui/vendor/codemirror.js').Completion} Completion */
/** @typedef {import('/ui/vendor/codemirror.js').CompletionContext} CompletionContext */

/**
 * Extensions of the editor. The table may come later: until then nothing is offered.
 * @param {() => NodeTable | null} table
 */
export function assist(table) {
  return [
    autocompletion({
      override: [(context) => complete(context, table())],
      icons: false,
      maxRenderedOptions: 200,
      activateOnTypingDelay: 60,
      optionClass: (option) => `option-${option.type ?? 'plain'}`,
    }),
    hoverTooltip((view, position) => help(view, position, table()), { hoverTime: 350 }),
    keymap.of([{ key: 'Ctrl-Space', run: startCompletion }, { key: 'Alt-h', run: (view) => helpAtCursor(view, table()) }]),
    tooltips({ position: 'fixed' }),
  ];
}

/**
 * @param {CompletionContext} context
 * @param {NodeTable | null} table
 */
function complete(context, table) {
  const tree = treeOf(context.state.doc);
  if (table === null || tree === null) return null;
  const place = placeAt(tree, context.pos);
  if (place === null) return null;
  const text = textOf(context.state.doc);
  const isQuoted = text.charAt(place.from) === '"' && context.pos > place.from;
  const from = place.to === place.from ? context.pos : place.from + (isQuoted ? 1 : 0);
  const isBare = from === context.pos && !isQuoted;
  if (isBare && !context.explicit && !/[{[:]\s?$/.test(text.slice(Math.max(0, context.pos - 2), context.pos))) return null;
  if (place.node.kind === 'object' && place.part === 'value') return null;
  const options = place.part === 'key' ? keyOptions(table, place, context.pos) : valueOptions(table, tree, place);
  return options.length === 0 ? null : { from, options, validFor: /^[\w$#. -]*$/ };
}

/**
 * @param {NodeTable} table
 * @param {Place} place
 * @param {number} position
 * @returns {Completion[]}
 */
function keyOptions(table, place, position) {
  const slot = table.slotAt(place.node);
  const other = place.node.children.filter((member) => !(position >= member.keyFrom && position <= member.keyTo));
  if (slot === null) return [];
  const has = new Set(other.map((member) => member.key));
  // An object of a family has one key.
  const families = other.length > 0 ? [] : table.familiesOf(slot);
  const kinds = families.flatMap((family) => table.family(family).filter((kind) => typeof kind.example !== 'string').map((kind, index) => kindOption(kind, false, index)));
  const keys = table.objectsOf(slot).flatMap((kind) => (kind.is_choice && other.length > 0 ? [] : kind.keys.filter((key) => !has.has(key.name)).map((key) => keyOption(table, kind, key))));
  return [...keys, ...kinds];
}

/**
 * @param {NodeTable} table
 * @param {Kind} kind
 * @param {Key} key
 * @returns {Completion}
 */
const keyOption = (table, kind, key) => ({
  label: key.name,
  type: key.required ? 'required' : 'key',
  detail: key.required ? `${key.kind}, needed` : key.kind,
  boost: key.required ? 50 : 0,
  info: () => panel(keyHelp(key, kind)),
  apply: applyKey(JSON.stringify(key.name), startText(table, kind, key)),
});

/**
 * @param {NodeTable} table
 * @param {Kind} kind
 * @param {Key} key
 */
function startText(table, kind, key) {
  const value = table.startOf(kind, key);
  if (value !== undefined && value !== null) return value;
  const slot = table.slotOf(key);
  if (slot.type === 'list') return [];
  if (slot.type === 'family') return table.family(slot.family)[0]?.example ?? {};
  return slot.type === 'plain' ? 0 : {};
}

/**
 * @param {NodeTable} table
 * @param {JsonNode} tree
 * @param {Place} place
 * @returns {Completion[]}
 */
function valueOptions(table, tree, place) {
  const inList = place.node.kind === 'list';
  const outer = table.slotAt(place.node);
  const slot = inList && outer?.type === 'list' ? outer.of : outer;
  const path = pathOf(place.node);
  if (path.at(-1) === 'use' || (path.at(-1) === 'shape' && path.at(-2) === 'use')) return namesOf(tree, 'shapes').map((name) => plain(name, 'shape of this scene', name));
  if (slot === null) return [];
  if (slot.type === 'family') {
    const kinds = table.family(slot.family).map((kind, index) => kindOption(kind, true, index));
    const names = slot.family === 'material' && path.at(-1) !== undefined && path.at(-2) !== 'materials' ? namesOf(tree, 'materials').map((name) => plain(name, 'material of this scene', name, 60)) : [];
    const uses = slot.family === 'node' ? namesOf(tree, 'shapes').map((name) => plain(`use ${name}`, 'shape of this scene', { use: name }, -5)) : [];
    return [...names, ...kinds, ...uses];
  }
  if (slot.type === 'kind') {
    const required = slot.kind.keys.filter((key) => key.required);
    return [plain(slot.kind.name, slot.kind.title, slot.kind.example ?? Object.fromEntries(required.map((key) => [key.name, startText(table, slot.kind, key)])))];
  }
  if (slot.type === 'list') return [plain('[ ]', 'a list', [])];
  return slot.type === 'plain' ? plainOptions(table, slot, table.describe(place.node)?.key ?? null, namesOf(tree, 'numbers')) : [];
}

/**
 * @param {NodeTable} table
 * @param {Slot & {type: 'plain'}} slot
 * @param {Key | null} key
 * @param {string[]} numbers
 * @returns {Completion[]}
 */
function plainOptions(table, slot, key, numbers) {
  const { shape } = slot;
  const usual = key?.default;
  /** @type {Completion[]} */
  const options = shape.words.map(({ word, documentation }) => plain(String(word), documentation || (usual === word ? 'default' : ''), word, usual === word ? 10 : 0));
  if (shape.kind === 'boolean') options.push(plain('true', '', true), plain('false', '', false));
  if (usual !== null && usual !== undefined && options.length === 0) options.push(plain(pretty(usual), 'default', usual));
  if (shape.kind === 'color') options.push(plain('#8899aa', 'sRGB', '#8899aa'), plain('[0.5, 0.5, 0.5]', 'linear light', [0.5, 0.5, 0.5]), plain('kelvin', 'a black body', { kelvin: 3200 }));
  if (shape.kind === 'number' || shape.kind === 'integer') {
    options.push(...numbers.map((name) => plain(name, 'number of this scene', { expr: name }, -5)));
    options.push(plain('formula', 'such as 2 * t', { expr: '2 * t' }, -10), plain('track', 'a number over time', { keys: [[0, 0], [1, 1]] }, -10));
  }
  options.push(...table.familiesOf(slot).flatMap((family) => table.family(family).map((kind, index) => kindOption(kind, true, index))));
  return options;
}

/**
 * @param {string} label
 * @param {string} detail
 * @param {unknown} value
 * @param {number} [boost]
 * @returns {Completion}
 */
const plain = (label, detail, value, boost = 0) => ({ label: shortened(label), detail, type: 'value', boost, apply: applyValue(value) });

/**
 * @param {Kind} kind
 * @param {boolean} isValue whether the braces around it are to be written, too
 * @param {number} index its place in the table, which begins with the usual ones
 * @returns {Completion}
 */
function kindOption(kind, isValue, index) {
  const inner = kind.example?.[kind.name] ?? (kind.value?.kind === 'text' ? '' : {});
  return {
    label: kind.name,
    type: kind.family,
    sortText: String(index).padStart(4, '0'),
    detail: kind.title.replace(/\.$/, ''),
    info: () => panel(kindHelp(kind)),
    apply: isValue ? applyValue(kind.example ?? { [kind.name]: inner }) : applyKey(JSON.stringify(kind.name), inner),
  };
}

/**
 * Replaces the key at the cursor, and adds its value if it has none.
 * @param {string} key
 * @param {unknown} value
 */
function applyKey(key, value) {
  return (/** @type {EditorView} */ view) => {
    const tree = treeOf(view.state.doc);
    const position = view.state.selection.main.head;
    const place = tree === null ? null : placeAt(tree, position);
    if (place === null) return;
    const text = textOf(view.state.doc);
    const member = place.node.children.find((each) => each.keyFrom === place.from && each.keyTo === place.to);
    const hasValue = member !== undefined && (member.kind !== 'missing' || member.from > member.keyTo);
    const before = text.slice(0, place.from).trimEnd().at(-1);
    const comma = before !== undefined && !'{,'.includes(before) && place.node.children.length > 0 && !before.match(/[*/]/) ? ', ' : '';
    if (hasValue) {
      view.dispatch({ changes: { from: place.from, to: place.to, insert: comma + key }, selection: { anchor: place.from + comma.length + key.length }, userEvent: 'input.complete' });
      return;
    }
    const start = pretty(value, indentAt(text, place.from));
    // A number gets no digits that the value of a default in floating point has.
    insertPiece(view, place, `${comma}${key}: `, start);
  };
}

/** @param {unknown} value */
function applyValue(value) {
  return (/** @type {EditorView} */ view) => {
    const tree = treeOf(view.state.doc);
    const position = view.state.selection.main.head;
    const place = tree === null ? null : placeAt(tree, position);
    if (place === null) return;
    const text = textOf(view.state.doc);
    const space = text.charAt(place.from - 1) === ':' ? ' ' : '';
    insertPiece(view, place, space, pretty(value, indentAt(text, place.from)));
  };
}

/**
 * Inserts text, a comma if something follows, and selects its first number or text.
 * @param {EditorView} view
 * @param {Place} place
 * @param {string} head
 * @param {string} value
 */
function insertPiece(view, place, head, value) {
  const text = textOf(view.state.doc);
  const next = /^\s*(.)/s.exec(text.slice(place.to, place.to + 400))?.[1] ?? '';
  const comma = '"{['.includes(next) && next !== '' ? ',' : '';
  const first = /-?\d[\d.e+-]*|"[^"]*"(?!\s*:)/i.exec(value);
  const from = place.from + head.length + (first === null ? value.length : first.index + (first[0].startsWith('"') ? 1 : 0));
  const to = first === null ? from : place.from + head.length + first.index + first[0].length - (first[0].startsWith('"') ? 1 : 0);
  view.dispatch({
    changes: { from: place.from, to: place.to, insert: `${head}${value}${comma}` },
    selection: { anchor: from, head: to },
    scrollIntoView: true,
    userEvent: 'input.complete',
  });
}

/** @param {Node[]} children */
const panel = (children) => h('div', { class: 'help-panel' }, ...children);

/**
 * Help on a kind.
 * @param {Kind} kind
 * @returns {HTMLElement[]}
 */
export function kindHelp(kind) {
  const title = h('p', { class: 'help-title' }, h('strong', {}, kind.name), h('span', { class: 'help-kind' }, kind.family));
  const picture = kind.picture === null ? null : h('img', { src: kind.picture, alt: '', width: 160, height: 120, loading: 'lazy' });
  const keys = kind.keys.map((key) => `${key.name}${key.required ? '' : '?'}`).join(', ');
  return [title, picture, ...documentation(kind.documentation || kind.title), keys === '' ? null : h('p', { class: 'muted' }, keys)].filter((each) => each !== null);
}

/**
 * Help on a key.
 * @param {Key} key
 * @param {Kind} kind
 * @returns {HTMLElement[]}
 */
export function keyHelp(key, kind) {
  const title = h('p', { class: 'help-title' }, h('strong', {}, key.name), h('span', { class: 'help-kind' }, `${key.kind} of ${kind.name}`));
  const facts = [
    key.required ? 'needed' : key.default === null || key.default === undefined ? 'may be absent' : `default ${pretty(key.default)}`,
    rangeText(key),
    key.unit ? `in ${key.unit}` : '',
    key.words.map(({ word }) => String(word)).join(', '),
  ].filter((fact) => fact !== '');
  return [title, ...documentation(key.documentation), h('p', { class: 'muted' }, facts.join(' · '))];
}

/** @param {Key} key */
export function rangeText(key) {
  const [low, high] = [key.minimum ?? null, key.maximum ?? null];
  if (low !== null && high !== null) return `${low} to ${high}`;
  return low !== null ? `at least ${low}` : high !== null ? `at most ${high}` : '';
}

/**
 * @param {JsonNode} tree
 * @param {number} position
 * @param {NodeTable} table
 */
function helpFor(tree, position, table) {
  const node = nodeAt(tree, position);
  const isOnKey = position >= node.keyFrom && position <= node.keyTo;
  if (!isOnKey && node.children.length > 0) return null;
  const range = isOnKey ? { from: node.keyFrom, to: node.keyTo } : { from: node.from, to: node.to };
  const outer = node.parent === null ? null : table.slotAt(node.parent);
  if (isOnKey && outer?.type === 'family') {
    const kind = table.kind(outer.family, String(node.key));
    return kind === undefined ? null : { ...range, content: kindHelp(kind) };
  }
  const known = table.describe(node);
  if (known === null) return null;
  const slot = table.slotOf(known.key);
  const more = slot.type === 'kind' && isOnKey ? slot.kind : null;
  return { ...range, content: [...keyHelp(known.key, known.kind), ...(more?.picture ? kindHelp(more) : [])] };
}

/**
 * @param {EditorView} view
 * @param {number} position
 * @param {NodeTable | null} table
 */
function help(view, position, table) {
  const tree = treeOf(view.state.doc);
  const found = tree === null || table === null ? null : helpFor(tree, position, table);
  return found === null ? null : { pos: found.from, end: found.to, above: true, create: () => ({ dom: panel(found.content) }) };
}

/**
 * Shows the help of the cursor's place below the text, for the keyboard.
 * @param {EditorView} view
 * @param {NodeTable | null} table
 */
function helpAtCursor(view, table) {
  const tree = treeOf(view.state.doc);
  const found = tree === null || table === null ? null : helpFor(tree, view.state.selection.main.head, table);
  view.dom.dispatchEvent(new CustomEvent('show-help', { bubbles: true, detail: found?.content ?? [h('p', {}, 'There is no help for this place.')] }));
  return true;
}
