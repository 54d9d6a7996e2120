// Menus that open at a button.

import { h } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';

/** @typedef {{label: string, run: () => void, icon?: import('/ui/parts/icons.js').IconName, isDanger?: boolean, isDisabled?: boolean, checked?: boolean}} MenuItem */

/**
 * Opens a menu below an element. Arrows move, Enter chooses, Escape closes.
 * @param {HTMLElement} anchor
 * @param {(MenuItem | null)[]} items `null` is a line.
 */
export function openMenu(anchor, items) {
  const buttons = items.map((item) =>
    item === null
      ? h('hr')
      : h(
          'button',
          {
            type: 'button',
            role: item.checked === undefined ? 'menuitem' : 'menuitemcheckbox',
            'aria-checked': item.checked === undefined ? undefined : String(item.checked),
            tabindex: -1,
            disabled: item.isDisabled,
            class: item.isDanger ? 'danger' : false,
            on: { click: () => choose(item) },
          },
          item.checked === undefined ? item.icon && icon(item.icon) : h('span', { class: 'tick' }, item.checked ? icon('check', 14) : null),
          item.label,
        ),
  );
  const menu = h('div', { class: 'menu', role: 'menu', popover: 'auto' }, ...buttons);
  const enabled = () => buttons.filter((button) => button instanceof HTMLButtonElement && !button.disabled);

  /** @param {MenuItem} item */
  function choose(item) {
    menu.hidePopover();
    item.run();
  }

  menu.addEventListener('keydown', (event) => {
    const list = enabled();
    const at = list.findIndex((button) => button === document.activeElement);
    /** @type {Record<string, number>} */
    const targets = { ArrowDown: at + 1, ArrowUp: at - 1 + list.length, Home: 0, End: list.length - 1 };
    const target = targets[event.key];
    if (target !== undefined) {
      event.preventDefault();
      event.stopPropagation();
      list[target % list.length]?.focus();
    } else if (event.key === 'Tab') {
      menu.hidePopover();
    }
  });
  menu.addEventListener('toggle', (event) => {
    if (/** @type {ToggleEvent} */ (event).newState !== 'closed') return;
    anchor.setAttribute('aria-expanded', 'false');
    const hadFocus = menu.contains(document.activeElement) || document.activeElement === document.body;
    menu.remove();
    if (hadFocus && anchor.isConnected) anchor.focus();
  });
  document.body.append(menu);
  menu.showPopover();
  anchor.setAttribute('aria-expanded', 'true');
  place(menu, anchor);
  enabled()[0]?.focus();
}

/**
 * @param {HTMLElement} menu
 * @param {HTMLElement} anchor
 */
function place(menu, anchor) {
  const at = anchor.getBoundingClientRect();
  const { width, height } = menu.getBoundingClientRect();
  const left = Math.max(8, Math.min(at.left, innerWidth - width - 8));
  const isBelow = at.bottom + height + 8 < innerHeight || at.top < height + 8;
  menu.style.left = `${left}px`;
  menu.style.top = `${isBelow ? Math.min(at.bottom + 4, innerHeight - height - 8) : at.top - height - 4}px`;
}
