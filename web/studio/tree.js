// The tree of the text in the editor, made once for each version of the text, and not for texts so large that typing would wait.

import { parseUpTo } from './json.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {import('/ui/vendor/codemirror.js').Text} Text */

/** Longest text whose tree is kept, in characters. */
export const MAX_TREE_CHARS = 2 << 20;
/** Most values of a text whose tree is kept: the tree is made at each change. */
export const MAX_TREE_NODES = 300_000;

/** @type {WeakMap<Text, string>} */
const texts = new WeakMap();
/** @type {WeakMap<Text, JsonNode | null>} */
const trees = new WeakMap();

/**
 * The text of a document.
 * @param {Text} doc
 */
export function textOf(doc) {
  let text = texts.get(doc);
  if (text === undefined) {
    text = doc.toString();
    texts.set(doc, text);
  }
  return text;
}

/**
 * The tree of a document, or null if it is too large.
 * @param {Text} doc
 */
export function treeOf(doc) {
  if (doc.length > MAX_TREE_CHARS) return null;
  let tree = trees.get(doc);
  if (tree === undefined) {
    tree = parseUpTo(textOf(doc), MAX_TREE_NODES);
    trees.set(doc, tree);
  }
  return tree;
}
