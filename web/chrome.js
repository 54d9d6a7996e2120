// The frame around the rooms: the farm at a glance, the caller, the theme, and the bar that says when what is seen is old.

import { connection } from '/ui/connection.js';
import { farmEvents } from '/ui/events.js';
import { count, duration } from '/ui/parts/format.js';
import { h, setText } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';
import { openMenu } from '/ui/parts/menu.js';
import { showShortcuts } from '/ui/parts/shortcuts.js';
import { session } from '/ui/session.js';
import { askForKey } from '/ui/sign_in.js';

/** Silence that need not be shown. */
const GRACE_MS = 1500;

const THEMES = /** @type {const} */ (['auto', 'light', 'dark']);
/** @typedef {(typeof THEMES)[number]} Theme */

/** @returns {Theme} */
function theme() {
  const chosen = document.documentElement.dataset['theme'];
  return chosen === 'light' || chosen === 'dark' ? chosen : 'auto';
}

/** @param {Theme} chosen */
function setTheme(chosen) {
  if (chosen === 'auto') delete document.documentElement.dataset['theme'];
  else document.documentElement.dataset['theme'] = chosen;
  try {
    localStorage.setItem('sdfarm.theme', chosen);
  } catch {
    // Storage is off: the theme is kept until the page is closed.
  }
  showTheme();
  document.dispatchEvent(new Event('themechange'));
}

/** Goes on to the next theme: the system's, light, dark. */
export function nextTheme() {
  setTheme(THEMES[(THEMES.indexOf(theme()) + 1) % THEMES.length] ?? 'auto');
}

const THEME_NAMES = { auto: 'as the system', light: 'light', dark: 'dark' };
const themeButton = h('button', { type: 'button', class: 'ghost theme', on: { click: nextTheme } });

function showTheme() {
  const chosen = theme();
  themeButton.replaceChildren(icon(chosen === 'auto' ? 'auto' : chosen === 'light' ? 'sun' : 'moon'));
  themeButton.setAttribute('aria-label', `Theme: ${THEME_NAMES[chosen]}`);
  themeButton.title = `Theme: ${THEME_NAMES[chosen]} (t)`;
}

const glance = h('a', { class: 'glance', href: '#/farm', hidden: true });
const light = h('span', { class: 'light', role: 'img' });
const callerButton = h('button', { type: 'button', class: 'ghost caller', 'aria-haspopup': 'menu', 'aria-expanded': 'false', hidden: true, on: { click: () => openCallerMenu() } });
const helpButton = h('button', { type: 'button', class: 'ghost help', 'aria-label': 'Keyboard shortcuts', title: 'Keyboard shortcuts (?)', on: { click: showShortcuts } }, '?');

function openCallerMenu() {
  openMenu(callerButton, [
    { label: 'Use another key…', icon: 'key', run: () => void askForKey() },
    { label: 'Forget the key', icon: 'cross', run: () => { session.signOut(); location.reload(); } },
  ]);
}

function showCaller() {
  const caller = session.caller;
  callerButton.hidden = caller === null || !caller.needs_key;
  if (caller === null || callerButton.hidden) return;
  const scopes = caller.scopes ?? (caller.scope === null ? [] : [caller.scope]);
  callerButton.replaceChildren(icon('person'), h('span', {}, caller.name || 'Key'));
  callerButton.title = caller.name === null ? 'No key is given' : `Key of ${caller.name || 'an unknown name'}: ${scopes.join(', ')}`;
  callerButton.setAttribute('aria-label', callerButton.title);
  document.body.classList.toggle('read-only', caller.read_only);
}

function showGlance() {
  const counts = farmEvents.counts;
  glance.hidden = counts === null || !session.mayRead;
  if (counts === null) return;
  const parts = [
    counts.paused ? h('b', { class: 'paused' }, 'Farm paused') : null,
    h('span', {}, h('b', {}, count(counts.running)), ' running'),
    h('span', {}, h('b', {}, count(counts.queued)), ' queued'),
    h('span', { class: counts.workers_ready === 0 ? 'failed' : false }, h('b', {}, count(counts.workers_ready)), counts.workers_ready === 1 ? ' worker' : ' workers'),
  ];
  glance.replaceChildren(...parts.filter((part) => part !== null));
}

const STATES = { connecting: 'Connecting to the farm', live: 'Live: changes are seen at once', lost: 'The farm does not answer', quiet: 'This server sends no live events: reload to see changes' };
const age = h('span');
const notice = h('div', { class: 'notice', hidden: true }, icon('warning'), age, h('button', { type: 'button', class: 'link', on: { click: () => connection.retryNow() } }, 'Try now'));

function showConnection() {
  const { state } = connection;
  light.className = `light ${state}`;
  light.title = STATES[state];
  light.setAttribute('aria-label', STATES[state]);
  document.body.classList.toggle('stale', state === 'lost');
  showAge();
}

function showAge() {
  const silence = Date.now() - connection.heardAt;
  const isShown = connection.state === 'lost' && silence > GRACE_MS;
  notice.hidden = !isShown;
  if (!isShown) return;
  const retry = connection.retryAt === null ? 0 : Math.max(0, Math.ceil((connection.retryAt - Date.now()) / 1000));
  const next = retry > 0 ? ` The next attempt is in ${retry} s.` : ' Trying again…';
  setText(age, `The farm does not answer. What you see is ${duration(Math.max(1, Math.round(silence / 1000)))} old.${next}`);
}

/** Fills the bar, and keeps it true. */
export function startChrome() {
  document.getElementById('bar-end')?.append(glance, light, callerButton, themeButton, helpButton);
  document.getElementById('notice')?.append(notice);
  showTheme();
  showConnection();
  session.addEventListener('change', () => {
    showCaller();
    showGlance();
  });
  farmEvents.addEventListener('farm', showGlance);
  connection.addEventListener('change', showConnection);
  setInterval(showAge, 1000);
}
