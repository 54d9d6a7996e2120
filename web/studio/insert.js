// Where an example goes: at the cursor if its family may stand there, else at the place of the scene that is made for it.

import { compact, indentAt, insertEntry, setMember } from './edits.js';
import { child, find, nodeAt } from './json.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {import('./edits.js').Change} Change */
/** @typedef {import('./nodes.js').NodeTable} NodeTable */
/** @typedef {import('./nodes.js').Kind} Kind */

/** Longest line of a value alone, and of a part of one. */
const [MAX_ALONE_CHARS, MAX_LINE_CHARS] = [72, 100];

/**
 * A value as text: on one line if that is short, else with an entry on each line, behind an indent.
 * @param {unknown} value
 * @param {string} [indent]
 * @param {number} [room] characters of a line
 * @returns {string}
 */
export function pretty(value, indent = '', room = MAX_ALONE_CHARS - indent.length) {
  const line = compact(value);
  if (line.length <= room || typeof value !== 'object' || value === null) return line;
  const deeper = `${indent}  `;
  const entries = Object.entries(value).map(([name, each]) => {
    const key = Array.isArray(value) ? '' : `${JSON.stringify(name)}: `;
    return key + pretty(each, deeper, MAX_LINE_CHARS - deeper.length - key.length - 1);
  });
  const [open, close] = Array.isArray(value) ? '[]' : '{}';
  return `${open}\n${deeper}${entries.join(`,\n${deeper}`)}\n${indent}${close}`;
}

/**
 * Changes that insert an example, where the cursor goes, and where that is in words; or a reason why there is no place.
 * @typedef {{changes: Change[], cursor: number, where: string} | {reason: string}} Insertion
 */

/**
 * @param {string} text
 * @param {JsonNode} root
 * @param {number} position
 * @param {NodeTable} table
 * @param {Kind} kind
 * @returns {Insertion}
 */
export function insertExample(text, root, position, table, kind) {
  return atCursor(text, root, position, table, kind) ?? inScene(text, root, table, kind);
}

/**
 * @param {string} text
 * @param {JsonNode} root
 * @param {number} position
 * @param {NodeTable} table
 * @param {Kind} kind
 * @returns {Insertion | null}
 */
function atCursor(text, root, position, table, kind) {
  /** @type {JsonNode | null} */
  let node = nodeAt(root, position);
  for (; node !== null; node = node.parent) {
    const slot = table.slotAt(node);
    if (slot?.type === 'list' && slot.of.type === 'family' && slot.of.family === kind.family && node.kind === 'list') {
      const before = node.children.findLast((item) => item.to <= position);
      return entryAfter(text, node, before, kind);
    }
    if (slot?.type === 'family' && slot.family === kind.family && (node.kind === 'missing' || isBlank(node) || node.kind === 'text')) {
      const insert = (node.kind === 'missing' ? ' ' : '') + pretty(kind.example, indentAt(text, node.from));
      return { changes: [{ from: node.from, to: node.to, insert }], cursor: node.from + insert.length, where: 'at the cursor' };
    }
  }
  return null;
}

/** @param {JsonNode} node */
const isBlank = (node) => node.kind === 'object' && node.children.length === 0;

/**
 * @param {string} text
 * @param {JsonNode} list
 * @param {JsonNode | undefined} before
 * @param {Kind} kind
 * @returns {Insertion}
 */
function entryAfter(text, list, before, kind) {
  if (before === undefined || before === list.children.at(-1)) {
    const indent = indentAt(text, list.children[0]?.from ?? list.from);
    return ended(insertEntry(text, list, pretty(kind.example, indent)), 'in the list at the cursor');
  }
  const indent = indentAt(text, before.from);
  const hasLines = text.slice(list.from, list.children[0]?.from ?? list.from).includes('\n');
  const insert = `${hasLines ? `,\n${indent}` : ', '}${pretty(kind.example, indent)}`;
  return { changes: [{ from: before.to, to: before.to, insert }], cursor: before.to + insert.length, where: 'in the list at the cursor' };
}

/**
 * @param {Change[]} changes
 * @param {string} where
 * @returns {Insertion}
 */
function ended(changes, where) {
  const [change] = changes;
  return { changes, cursor: change === undefined ? 0 : change.from + change.insert.length, where };
}

/**
 * @param {string} text
 * @param {JsonNode} root
 * @param {NodeTable} table
 * @param {Kind} kind
 * @returns {Insertion}
 */
function inScene(text, root, table, kind) {
  const scene = child(root, 'scene');
  if (scene?.kind !== 'object') return { reason: 'The text has no scene: put the cursor where it may stand, or start with a scene.' };
  const indent = indentAt(text, scene.children[0]?.keyFrom ?? scene.from);
  const deeper = `${indent}  `;
  switch (kind.family) {
    case 'node': {
      const objects = child(scene, 'objects');
      const object = pretty({ shape: kind.example }, objects === undefined ? deeper : indentAt(text, objects.children[0]?.from ?? objects.from));
      if (objects?.kind === 'list') return ended(insertEntry(text, objects, object), 'as a new object');
      return ended(setMember(text, scene, 'objects', `[${object}]`), 'as a new object');
    }
    case 'light': {
      const lights = child(scene, 'lights');
      if (lights?.kind === 'list') return ended(insertEntry(text, lights, pretty(kind.example, deeper)), 'in the lights');
      return ended(setMember(text, scene, 'lights', `[${pretty(kind.example, deeper)}]`), 'in the lights');
    }
    case 'material': {
      const materials = child(scene, 'materials');
      const value = pretty(kind.example, materials?.kind === 'object' ? indentAt(text, materials.children[0]?.keyFrom ?? materials.from) : deeper);
      const name = freeName(kind.name, materials);
      if (materials?.kind === 'object') return ended(insertEntry(text, materials, `${JSON.stringify(name)}: ${value}`), `as the material “${name}”`);
      return ended(setMember(text, scene, 'materials', `{ ${JSON.stringify(name)}: ${value} }`), `as the material “${name}”`);
    }
    case 'background':
      return ended(setMember(text, scene, 'background', pretty(kind.example, indent)), 'as the background');
    case 'projection': {
      const camera = find(scene, ['camera']);
      if (camera?.kind === 'object') return ended(setMember(text, camera, 'projection', pretty(kind.example, deeper)), 'as the camera’s projection');
      return { reason: 'The scene has no camera.' };
    }
    case 'effect':
      return effect(text, scene, table, kind, indent);
    default:
      return { reason: `Put the cursor where a ${kind.family} may stand, for example behind a key of a shape or a material.` };
  }
}

/**
 * @param {string} text
 * @param {JsonNode} scene
 * @param {NodeTable} table
 * @param {Kind} kind
 * @param {string} indent
 * @returns {Insertion}
 */
function effect(text, scene, table, kind, indent) {
  const { example } = kind;
  const value = typeof example === 'object' && example !== null && Object.hasOwn(example, kind.name) ? example[kind.name] : example;
  return table.slotAt(scene) === null ? { reason: 'The table of nodes has no scene.' } : ended(setMember(text, scene, kind.name, pretty(value, indent)), `as the scene’s ${kind.name.replaceAll('_', ' ')}`);
}

/**
 * @param {string} name
 * @param {JsonNode | undefined} object
 */
function freeName(name, object) {
  const taken = new Set(object?.children.map((member) => member.key));
  if (!taken.has(name)) return name;
  let number = 2;
  while (taken.has(`${name}_${number}`)) number += 1;
  return `${name}_${number}`;
}
