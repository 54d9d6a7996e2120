// The line between the text and the picture: it is dragged, and moved by keys.

import { h } from '/ui/parts/dom.js';

const STORED = 'sdfarm.studio.split';
const LEAST = 20;
const MOST = 80;
const USUAL = 50;
const KEY_STEP = 2;

/**
 * Makes a separator that sets the property `--split` of an element: the fraction of its width that the text has.
 * @param {HTMLElement} container
 */
export function separator(container) {
  let percent = stored();
  const line = h('div', { class: 'separator', role: 'separator', tabindex: 0, 'aria-orientation': 'vertical', 'aria-label': 'Width of the text', 'aria-valuemin': LEAST, 'aria-valuemax': MOST });

  /** @param {number} next */
  function set(next) {
    percent = Math.min(MOST, Math.max(LEAST, next));
    container.style.setProperty('--split', String(percent / 100));
    line.setAttribute('aria-valuenow', String(Math.round(percent)));
  }

  function keep() {
    try {
      localStorage.setItem(STORED, String(percent));
    } catch {
      // It is kept until the page is closed.
    }
  }

  line.addEventListener('pointerdown', (event) => {
    if (event.button !== 0) return;
    event.preventDefault();
    line.focus();
    line.setPointerCapture(event.pointerId);
  });
  line.addEventListener('pointermove', (event) => {
    if (!line.hasPointerCapture(event.pointerId)) return;
    // The examples may be left of the text.
    const left = line.previousElementSibling?.getBoundingClientRect().left ?? 0;
    set(((event.clientX - left) / (container.getBoundingClientRect().right - left)) * 100);
  });
  line.addEventListener('lostpointercapture', keep);
  line.addEventListener('dblclick', () => {
    set(USUAL);
    keep();
  });
  line.addEventListener('keydown', (event) => {
    /** @type {Record<string, number>} */
    const targets = { ArrowLeft: percent - KEY_STEP, ArrowRight: percent + KEY_STEP, Home: LEAST, End: MOST };
    const target = targets[event.key];
    if (target === undefined) return;
    event.preventDefault();
    set(target);
    keep();
  });
  set(percent);
  return line;
}

function stored() {
  try {
    const percent = Number(localStorage.getItem(STORED));
    return percent >= LEAST && percent <= MOST ? percent : USUAL;
  } catch {
    return USUAL;
  }
}
