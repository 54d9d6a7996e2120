// Changes of a text that set values at paths: the least text is replaced, so that comments, spaces and undo steps stay good.

import { child, find, numbersOf } from './json.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {{from: number, to: number, insert: string}} Change */

/**
 * A number as a person writes it: at most a number of digits after the point, and none that say nothing.
 * @param {number} value
 * @param {number} [digits]
 */
export function written(value, digits = 4) {
  if (!Number.isFinite(value)) return '0';
  const size = Math.abs(value);
  if (size >= 1e15 || (size > 0 && size < 10 ** -digits)) return Number(value.toPrecision(4)).toString();
  const text = value.toFixed(digits);
  const short = text.includes('.') ? text.replace(/\.?0+$/, '') : text;
  return short === '-0' ? '0' : short;
}

/**
 * A value as text on one line, in the form that formatting gives it.
 * @param {unknown} value
 * @returns {string}
 */
export function compact(value) {
  if (Array.isArray(value)) return `[${value.map(compact).join(', ')}]`;
  if (typeof value === 'number') return written(value, 6);
  if (typeof value === 'object' && value !== null) {
    const members = Object.entries(value).map(([key, each]) => `${JSON.stringify(key)}: ${compact(each)}`);
    return members.length === 0 ? '{}' : `{ ${members.join(', ')} }`;
  }
  return JSON.stringify(value) ?? 'null';
}

/**
 * Changes that give a list of numbers other ones, each number by itself.
 * @param {JsonNode | undefined} node
 * @param {readonly number[]} numbers
 * @param {number} [digits]
 * @returns {Change[]}
 */
export function setNumbers(node, numbers, digits = 4) {
  if (node === undefined || numbersOf(node, numbers.length) === undefined) return [];
  return node.children.flatMap((item, index) => {
    const insert = written(numbers[index] ?? 0, digits);
    return Number(item.value) === Number(insert) ? [] : [{ from: item.from, to: item.to, insert }];
  });
}

/**
 * Spaces at the start of the line of a position.
 * @param {string} text
 * @param {number} position
 */
export function indentAt(text, position) {
  const start = text.lastIndexOf('\n', position - 1) + 1;
  return /^[ \t]*/.exec(text.slice(start, position))?.[0] ?? '';
}

/**
 * Changes that set the member of an object, which is added at its end if it is missing.
 * @param {string} text
 * @param {JsonNode} object
 * @param {string} key
 * @param {string} value as JSON
 * @returns {Change[]}
 */
export function setMember(text, object, key, value) {
  const member = child(object, key);
  if (member !== undefined) return text.slice(member.from, member.to) === value ? [] : [{ from: member.from, to: member.to, insert: value }];
  return insertEntry(text, object, `${JSON.stringify(key)}: ${value}`);
}

/**
 * Changes that add an entry to the end of a list or an object, on a line of its own if the others have theirs.
 * @param {string} text
 * @param {JsonNode} container
 * @param {string} entry
 * @returns {Change[]}
 */
export function insertEntry(text, container, entry) {
  const last = container.children.at(-1);
  const close = container.isClosed ? container.to - 1 : container.to;
  if (last === undefined) {
    const isObject = container.kind === 'object';
    const isEmpty = text.slice(container.from + 1, close).trim() === '';
    if (!isEmpty) return [{ from: close, to: close, insert: entry }];
    return [{ from: container.from + 1, to: close, insert: isObject ? ` ${entry} ` : entry }];
  }
  const first = container.children[0] ?? last;
  const start = first.keyFrom < 0 ? first.from : first.keyFrom;
  const hasLines = text.slice(container.from, start).includes('\n');
  const glue = hasLines ? `,\n${indentAt(text, start)}` : ', ';
  const comma = /^\s*,/.exec(text.slice(last.to, close));
  if (comma !== null) return [{ from: last.to, to: last.to + comma[0].length, insert: `${glue}${entry}` }];
  return [{ from: last.to, to: last.to, insert: `${glue}${entry}` }];
}

/**
 * Changes that set the value at a path; objects that are missing on the way are added.
 * @param {string} text
 * @param {JsonNode} root
 * @param {readonly (string | number)[]} path
 * @param {string} value as JSON
 * @returns {Change[]}
 */
export function setPath(text, root, path, value) {
  let node = root;
  for (const [depth, step] of path.entries()) {
    const next = child(node, step);
    if (next !== undefined && next.kind !== 'missing') {
      node = next;
    } else if (node.kind === 'object') {
      const rest = path.slice(depth + 1).reduceRight((/** @type {string} */ inner, key) => `{ ${JSON.stringify(String(key))}: ${inner} }`, value);
      return setMember(text, node, String(step), rest);
    } else {
      return [];
    }
  }
  return text.slice(node.from, node.to) === value ? [] : [{ from: node.from, to: node.to, insert: value }];
}

/**
 * Changes that remove the member or the item at a path, with its comma.
 * @param {JsonNode} root
 * @param {readonly (string | number)[]} path
 * @returns {Change[]}
 */
export function removeAt(root, path) {
  const node = find(root, path);
  const siblings = node?.parent?.children ?? [];
  const at = node === undefined ? -1 : siblings.indexOf(node);
  if (node === undefined || at < 0) return [];
  const [before, after] = [siblings[at - 1], siblings[at + 1]];
  const startOf = (/** @type {JsonNode} */ each) => (each.keyFrom < 0 ? each.from : each.keyFrom);
  if (after !== undefined) return [{ from: startOf(node), to: startOf(after), insert: '' }];
  return [{ from: before?.to ?? startOf(node), to: node.to, insert: '' }];
}

/**
 * The text after changes that do not overlap.
 * @param {string} text
 * @param {readonly Change[]} changes
 */
export function applied(text, changes) {
  let result = '';
  let at = 0;
  for (const { from, to, insert } of [...changes].sort((a, b) => a.from - b.from)) {
    result += text.slice(at, from) + insert;
    at = to;
  }
  return result + text.slice(at);
}
