// Icons as paths on a grid of 16, drawn with the color of the text.

import { svg } from '/ui/parts/dom.js';

const PATHS = {
  pause: 'M5.5 3.5v9M10.5 3.5v9',
  play: 'M5 3.2v9.6l7.5-4.8z',
  stop: 'M4.5 4.5h7v7h-7z',
  cross: 'M4 4l8 8M12 4l-8 8',
  again: 'M12.7 8a4.7 4.7 0 1 1-1.4-3.35M12.8 2.5v2.7h-2.7',
  trash: 'M3 4.5h10M6.5 4.5v-1.5h3v1.5M4.5 4.5l.6 8.5h5.8l.6-8.5M6.8 7v3.7M9.2 7v3.7',
  up: 'M8 12.5v-9M4.5 7l3.5-3.5 3.5 3.5',
  down: 'M8 3.5v9M4.5 9l3.5 3.5 3.5-3.5',
  top: 'M3.5 3h9M8 13v-7M4.8 9l3.2-3.2 3.2 3.2',
  more: 'M8 3.7v.01M8 8v.01M8 12.3v.01',
  plus: 'M8 3.5v9M3.5 8h9',
  minus: 'M3.5 8h9',
  sun: 'M8 5.2a2.8 2.8 0 1 1 0 5.6 2.8 2.8 0 0 1 0-5.6M8 1.5v1.2M8 13.3v1.2M1.5 8h1.2M13.3 8h1.2M3.4 3.4l.85.85M11.75 11.75l.85.85M3.4 12.6l.85-.85M11.75 4.25l.85-.85',
  moon: 'M13 9.4a5.4 5.4 0 0 1-6.4-6.4 5.4 5.4 0 1 0 6.4 6.4z',
  auto: 'M8 2.5a5.5 5.5 0 1 1 0 11 5.5 5.5 0 0 1 0-11v11M8 5.5l4.3 0M8 8h5.4M8 10.5h4.7',
  search: 'M7 3a4 4 0 1 1 0 8 4 4 0 0 1 0-8M10 10l3.3 3.3',
  download: 'M8 2.5v7.5M4.8 7l3.2 3.2 3.2-3.2M3 13h10',
  link: 'M6.7 9.3a2.6 2.6 0 0 1 0-3.6l2.1-2.1a2.55 2.55 0 0 1 3.6 3.6l-1.2 1.2M9.3 6.7a2.6 2.6 0 0 1 0 3.6l-2.1 2.1a2.55 2.55 0 0 1-3.6-3.6l1.2-1.2',
  edit: 'M3 13l.6-2.9 7-7 2.3 2.3-7 7zM9.3 4.4l2.3 2.3',
  check: 'M3.2 8.5l3.2 3.2 6.4-7.2',
  shield: 'M8 2l5 1.8v3.9c0 3-2 5.3-5 6.3-3-1-5-3.3-5-6.3v-3.9zM5.7 7.9l1.7 1.7 3-3.2',
  warning: 'M8 2.5l6 10.8h-12zM8 6.7v3M8 11.6v.01',
  columns: 'M3 3.5h10v9h-10zM6.3 3.5v9M9.7 3.5v9',
  key: 'M5.5 7.5a3 3 0 1 1 0 5.99 3 3 0 0 1 0-5.99M7.6 8.4l5.4-5.4M10.5 5.5l2 2',
  person: 'M8 2.7a2.7 2.7 0 1 1 0 5.4 2.7 2.7 0 0 1 0-5.4M2.8 13.5c.5-2.6 2.5-4 5.2-4s4.7 1.4 5.2 4',
  back: 'M9.5 3.5l-4.5 4.5 4.5 4.5',
  next: 'M6.5 3.5l4.5 4.5-4.5 4.5',
  fit: 'M3 6v-3h3M13 6v-3h-3M3 10v3h3M13 10v3h-3',
  loop: 'M4 6.5a2 2 0 0 1 2-2h6M10 2.5l2 2-2 2M12 9.5a2 2 0 0 1-2 2h-6M6 13.5l-2-2 2-2',
  copy: 'M5.5 5.5h7v7.5h-7zM3.5 10.5v-7.5h6.5',
  wipe: 'M2.5 3.5h11v9h-11zM8 2v12',
  flag: 'M4 14v-11.5M4 3h7.5l-1.7 2.6 1.7 2.6h-7.5',
};

/** @typedef {keyof typeof PATHS} IconName */

/**
 * Makes an icon, which readers of the screen skip.
 * @param {IconName} name
 * @param {number} [pixels]
 */
export function icon(name, pixels = 16) {
  const path = svg('path', { d: PATHS[name], fill: 'none', stroke: 'currentColor', 'stroke-width': name === 'more' ? 2 : 1.5, 'stroke-linecap': 'round', 'stroke-linejoin': 'round' });
  return svg('svg', { viewBox: '0 0 16 16', width: pixels, height: pixels, class: 'icon', 'aria-hidden': 'true', focusable: 'false' }, path);
}
