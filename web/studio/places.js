// Where the faults that a server tells are in the text.

import { find, pathOfPointer } from './json.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {{pointer: string, message: string, line: number, column: number}} Fault */
/** @typedef {{from: number, to: number, severity: 'error' | 'warning', message: string}} Mark */

/**
 * The position of a line and a column that count bytes of UTF-8, from 1.
 * @param {string} text
 * @param {number} line
 * @param {number} column
 */
export function positionOf(text, line, column) {
  let start = 0;
  for (let at = 1; at < line; at += 1) {
    const end = text.indexOf('\n', start);
    if (end < 0) return text.length;
    start = end + 1;
  }
  let bytes = column - 1;
  let position = start;
  while (bytes > 0 && position < text.length && text.charCodeAt(position) !== 10) {
    const code = text.codePointAt(position) ?? 0;
    bytes -= code < 0x80 ? 1 : code < 0x800 ? 2 : code < 0x10000 ? 3 : 4;
    position += code < 0x10000 ? 1 : 2;
  }
  return position;
}

/**
 * The text that a fault is about: its key if the key is wrong, else its value, or the first characters of a long one.
 * @param {string} text
 * @param {JsonNode | null} tree
 * @param {Fault} fault
 * @returns {Mark}
 */
export function markOf(text, tree, fault) {
  const at = Math.min(text.length, positionOf(text, fault.line, fault.column));
  const node = tree === null || fault.pointer === '' ? undefined : find(tree, pathOfPointer(fault.pointer));
  /** @type {[number, number]} */
  let [from, to] = [at, at + 1];
  if (node !== undefined && at >= node.keyFrom && at < node.keyTo) [from, to] = [node.keyFrom, node.keyTo];
  else if (node !== undefined && node.children.length > 0) [from, to] = node.keyFrom < 0 ? [node.from, node.from + 1] : [node.keyFrom, node.keyTo];
  else if (node !== undefined) [from, to] = [node.from, Math.max(node.to, node.from + 1)];
  if (from >= text.length) from = Math.max(0, text.length - 1);
  return { from, to: Math.min(text.length, Math.max(to, from + 1)), severity: 'error', message: fault.message };
}

/**
 * Where a warning belongs, if it begins with a pointer or names one.
 * @param {JsonNode | null} tree
 * @param {string} warning
 * @returns {Mark}
 */
export function markOfWarning(tree, warning) {
  const pointer = /(?:^|\s|`)(\/(?:scene|image|frames)[^\s:`,)]*)/.exec(warning)?.[1];
  const node = tree === null || pointer === undefined ? undefined : find(tree, pathOfPointer(pointer));
  const [from, to] = node === undefined ? [0, 1] : node.keyFrom < 0 ? [node.from, Math.min(node.to, node.from + 1)] : [node.keyFrom, node.keyTo];
  return { from, to, severity: 'warning', message: warning };
}
