// Keyboard shortcuts, and the overlay that lists them.

import { h, isTyping } from '/ui/parts/dom.js';
import { showDialog } from '/ui/parts/dialog.js';

/** Time within which the second key of a sequence counts. */
const SEQUENCE_MS = 1200;

/**
 * @typedef {object} Shortcut
 * @property {string} keys A key as `KeyboardEvent.key` names it, or two with a space: `g j`. `Shift+` may be before it.
 * @property {string} text What it does.
 * @property {string} group
 * @property {(event: KeyboardEvent) => void} [run] Absent where the shortcut is handled elsewhere and only listed.
 */

/** @type {Set<Shortcut>} */
const shortcuts = new Set();
let pending = '';
let pendingTimer = 0;

/**
 * Adds shortcuts until the signal aborts.
 * @param {Shortcut[]} list
 * @param {AbortSignal} [signal]
 */
export function addShortcuts(list, signal) {
  for (const shortcut of list) shortcuts.add(shortcut);
  signal?.addEventListener('abort', () => {
    for (const shortcut of list) shortcuts.delete(shortcut);
  });
}

/** Every shortcut that applies now, by group. */
export function shortcutGroups() {
  return Map.groupBy(shortcuts, (shortcut) => shortcut.group);
}

/** @param {KeyboardEvent} event */
function handle(event) {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || isTyping(event) || isPress(event)) return;
  if (document.querySelector('dialog[open], [popover]:popover-open')) return;
  const key = event.shiftKey && event.key.length > 1 ? `Shift+${event.key}` : event.key;
  const candidates = pending === '' ? [key] : [`${pending} ${key}`, key];
  const isStart = [...shortcuts].some((shortcut) => shortcut.keys.startsWith(`${key} `));
  clearTimeout(pendingTimer);
  pending = '';
  for (const keys of candidates) {
    // A room's shortcuts come after the page's, and go first.
    const found = [...shortcuts].reverse().find((shortcut) => shortcut.keys === keys && shortcut.run);
    if (found) {
      event.preventDefault();
      found.run?.(event);
      return;
    }
  }
  if (isStart) {
    pending = key;
    pendingTimer = setTimeout(() => (pending = ''), SEQUENCE_MS);
  }
}

/**
 * Whether a key presses the control that has the focus.
 * @param {KeyboardEvent} event
 */
function isPress(event) {
  const target = event.composedPath()[0];
  return (event.key === ' ' || event.key === 'Enter') && target instanceof Element && target.closest('button, a, input, select, summary') !== null;
}

addEventListener('keydown', handle);

/** @type {Record<string, string>} */
const NAMES = { ArrowUp: '↑', ArrowDown: '↓', ArrowLeft: '←', ArrowRight: '→', ' ': 'Space', Escape: 'Esc', Delete: 'Del' };

/**
 * A shortcut's keys as elements.
 * @param {string} keys
 */
export function keyCaps(keys) {
  const parts = keys === ' ' ? [' '] : keys.split(' ').flatMap((part) => part.split(/(?<=Shift)\+/));
  return h('span', { class: 'keys' }, ...parts.map((part) => h('kbd', {}, NAMES[part] ?? part)));
}

/** Lists of the shortcuts, as elements. */
export function shortcutTables() {
  return [...shortcutGroups()].map(([group, list]) =>
    h(
      'section',
      { class: 'shortcuts' },
      h('h3', {}, group),
      h('dl', {}, ...list.flatMap((shortcut) => [h('dt', {}, keyCaps(shortcut.keys)), h('dd', {}, shortcut.text)])),
    ),
  );
}

/** Shows the overlay. */
export function showShortcuts() {
  if (document.querySelector('dialog[open]')) return;
  void showDialog({ title: 'Keyboard shortcuts', body: [h('div', { class: 'shortcut-grid' }, ...shortcutTables())], cancel: 'Close', wide: true });
}
