// Documentation of the server's table as elements: paragraphs, `code`, *stress* and addresses. All else is text.

import { h } from '/ui/parts/dom.js';

/**
 * Paragraphs of a documentation text.
 * @param {string} text
 * @returns {HTMLElement[]}
 */
export function documentation(text) {
  return text
    .split(/\n\s*\n/)
    .filter((paragraph) => paragraph.trim() !== '')
    .map((paragraph) => h('p', {}, ...inline(paragraph.replaceAll('\n', ' '))));
}

/** @param {string} text */
function inline(text) {
  return text.split(/(`[^`]+`|<https?:\/\/[^>\s]+>)/).map((piece) => {
    if (piece.startsWith('`') && piece.length > 2) return h('code', {}, piece.slice(1, -1));
    if (/^<https?:/.test(piece)) {
      const address = piece.slice(1, -1);
      return h('a', { href: address, target: '_blank', rel: 'noopener noreferrer' }, new URL(address).host);
    }
    return piece;
  });
}
