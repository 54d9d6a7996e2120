// Reads from a job's text: its size, its frames, and which object a place belongs to.

import { shortened } from '../parts/format.js';
import { child, find, nodeAt, pathOf } from './json.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */

/** Letters of a key that are shown in a place. */
const MOST_STEP_LETTERS = 60;

/**
 * Number at a path, or another if it is not a plain number.
 * @param {JsonNode} root
 * @param {string[]} path
 * @param {number} other
 */
function numberAt(root, path, other) {
  const node = find(root, path);
  return node?.kind === 'number' && Number.isFinite(node.value) ? Number(node.value) : other;
}

/**
 * Size and frames of the pictures; null while the text has no size.
 * @param {JsonNode | null} root
 */
export function shownOf(root) {
  if (root === null) return null;
  let [width, height] = [numberAt(root, ['image', 'width'], 0), numberAt(root, ['image', 'height'], 0)];
  const region = find(root, ['image', 'region'])?.children ?? [];
  if (region.length === 4 && region.every((item) => item.kind === 'number')) [width, height] = [Number(region[2]?.value), Number(region[3]?.value)];
  if (!(width >= 1 && height >= 1)) return null;
  return {
    width,
    aspect: height / width,
    samples: numberAt(root, ['image', 'samples'], 4),
    frames: numberAt(root, ['frames', 'count'], 1),
    fps: numberAt(root, ['frames', 'fps'], 24),
  };
}

/**
 * The keys that lead to a node, to be shown.
 * @param {JsonNode} node
 */
export const placeOf = (node) => shortened(pathOf(node).map((step) => shortened(String(step), MOST_STEP_LETTERS)).join(' › '));

/**
 * The object that a position is in, in words; null outside of objects.
 * @param {JsonNode} root
 * @param {number} position
 */
export function objectOf(root, position) {
  /** @type {JsonNode | null} */
  let node = nodeAt(root, position);
  for (; node !== null && node.parent !== null; node = node.parent) {
    if (typeof node.key === 'number' && node.parent.key === 'objects') return objectName(node, node.key);
    if (typeof node.key === 'number' && node.parent.key === 'lights') return `Light ${node.key + 1}: ${shortened(String(node.children[0]?.key ?? ''))}`;
    const place = pathOf(node);
    if (place.length === 3 && place[0] === 'scene' && place[1] === 'materials') return `Material ${shortened(String(place[2]))}`;
    if (place.length === 3 && place[0] === 'scene' && place[1] === 'shapes') return `Shape ${shortened(String(place[2]))}`;
    if (place.length === 2 && place[1] === 'camera') return 'Camera';
  }
  return null;
}

/**
 * @param {JsonNode} object
 * @param {number} index
 */
function objectName(object, index) {
  const name = child(object, 'name');
  const material = child(object, 'material');
  const shape = child(object, 'shape')?.children[0]?.key;
  const called = name?.kind === 'text' && name.value !== '' ? `“${shortened(String(name.value))}”` : shortened(String(shape ?? ''));
  return [`Object ${index + 1}`, called === '' ? '' : `: ${called}`, material?.kind === 'text' ? `, ${shortened(String(material.value))}` : ''].join('');
}
