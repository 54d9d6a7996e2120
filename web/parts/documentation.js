// Documentation texts as elements: paragraphs, lists, blocks of code, `code`, **stress** and addresses. All else is text.

import { h } from '/ui/parts/dom.js';

/**
 * Elements of a documentation text.
 * @param {string} text
 * @returns {HTMLElement[]}
 */
export function documentation(text) {
  /** @type {HTMLElement[]} */
  const elements = [];
  const blocks = text.replace(/\r/g, '').split(/(```[\s\S]*?(?:```|$))|\n\s*\n/).filter((block) => block !== undefined && block.trim() !== '');
  for (const block of blocks) {
    if (block.startsWith('```')) {
      const code = block.replace(/^```[^\n]*\n?/, '').replace(/\n?```$/, '');
      elements.push(h('pre', {}, h('code', {}, code)));
    } else if (/^\s*[-*] /.test(block)) {
      const items = block.split(/\n(?=\s*[-*] )/).map((item) => item.replace(/^\s*[-*] /, ''));
      elements.push(h('ul', {}, ...items.map((item) => h('li', {}, ...inline(item.replaceAll('\n', ' '))))));
    } else {
      elements.push(h('p', {}, ...inline(block.replaceAll('\n', ' '))));
    }
  }
  return elements;
}

/** @param {string} text */
function inline(text) {
  return text.split(/(`[^`]+`|\*\*[^*]+\*\*|<https?:\/\/[^>\s]+>|\[[^\]]+\]\([^)\s]+\))/).map((piece) => {
    if (piece.startsWith('`') && piece.length > 2) return h('code', {}, piece.slice(1, -1));
    if (piece.startsWith('**') && piece.length > 4) return h('strong', {}, piece.slice(2, -2));
    const link = /^\[([^\]]+)\]\((https?:\/\/[^)]+)\)$/.exec(piece);
    const address = link?.[2] ?? (/^<https?:/.test(piece) ? piece.slice(1, -1) : null);
    if (address) return h('a', { href: address, target: '_blank', rel: 'noopener noreferrer' }, link?.[1] ?? new URL(address).host);
    // Links between pages of the repository lead nowhere here.
    return piece.replace(/^\[([^\]]+)\]\([^)]+\)$/, '$1');
  });
}
