// The page: which room is shown, by the address after the `#`, and the shortcuts of all rooms.

import { messageOf, readCaller } from '/ui/api.js';
import { nextTheme, startChrome } from '/ui/chrome.js';
import { connection } from '/ui/connection.js';
import { farmEvents } from '/ui/events.js';
import { h } from '/ui/parts/dom.js';
import { addShortcuts, showShortcuts } from '/ui/parts/shortcuts.js';
import { session } from '/ui/session.js';
import { askForKey } from '/ui/sign_in.js';

/** @typedef {import('/ui/parts/room.js').Place} Place */
/** @typedef {import('/ui/parts/room.js').Room} Room */

/** Rooms by the first word of the address: the element's name, its title, and its file, which is loaded when it is entered. */
/** @type {Record<string, {tag: string, title: string, load: () => Promise<unknown>}>} */
const ROOMS = {
  jobs: { tag: 'room-jobs', title: 'Jobs', load: () => import('/ui/rooms/jobs.js') },
  job: { tag: 'room-job', title: 'Job', load: () => import('/ui/rooms/job.js') },
  studio: { tag: 'room-studio', title: 'Studio', load: () => import('/ui/rooms/studio.js') },
  farm: { tag: 'room-farm', title: 'Farm', load: () => import('/ui/rooms/farm.js') },
  help: { tag: 'room-help', title: 'Help', load: () => import('/ui/rooms/help.js') },
};

const main = /** @type {HTMLElement} */ (document.getElementById('room'));
/** @type {Room | null} */
let room = null;
let visits = 0;

/** @returns {Place} */
function place() {
  const [path = '', query = ''] = location.hash.replace(/^#\/?/, '').split('?');
  const [first = '', second] = path.split('/').map(decode);
  const name = first === 'jobs' && second ? 'job' : first;
  return { room: Object.hasOwn(ROOMS, name) ? name : 'jobs', id: second || null, query: new URLSearchParams(query) };
}

/** @param {string} text */
function decode(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

/** Enters the room of the address. */
async function enter() {
  const to = place();
  const definition = ROOMS[to.room];
  if (definition === undefined) return;
  if (room !== null && room.place.room === to.room && room.place.id === to.id) {
    room.place = to;
    room.moved();
    return;
  }
  visits += 1;
  const visit = visits;
  document.title = `${definition.title} – sdfarm`;
  document.body.dataset['room'] = to.room;
  for (const link of document.querySelectorAll('.rooms a')) {
    const isHere = link instanceof HTMLElement && link.dataset['room'] === (to.room === 'job' ? 'jobs' : to.room);
    if (isHere) link.setAttribute('aria-current', 'page');
    else link.removeAttribute('aria-current');
  }
  try {
    await definition.load();
  } catch (error) {
    if (visit === visits) showFailure(definition.title, error);
    return;
  }
  if (visit !== visits) return;
  const next = /** @type {Room} */ (document.createElement(definition.tag));
  next.place = to;
  const isFirst = room === null;
  room = next;
  main.replaceChildren(next);
  scrollTo(0, 0);
  // The first room does not take the focus from the start of the page.
  if (!isFirst) focusHeading();
}

function focusHeading() {
  const title = main.querySelector('h1');
  (title instanceof HTMLElement ? title : main).focus({ preventScroll: true });
}

/**
 * @param {string} title
 * @param {unknown} error
 */
function showFailure(title, error) {
  room = null;
  const button = h('button', { type: 'button', class: 'button primary', on: { click: () => location.reload() } }, 'Reload the page');
  main.replaceChildren(h('div', { class: 'empty' }, h('h1', { tabindex: -1 }, `${title} could not be loaded`), h('p', {}, messageOf(error)), button));
  focusHeading();
}

/** @param {string} name */
const go = (name) => () => {
  location.hash = `#/${name}`;
};

addShortcuts([
  { keys: 'g j', text: 'Go to the jobs', group: 'Everywhere', run: go('jobs') },
  { keys: 'g s', text: 'Go to the studio', group: 'Everywhere', run: go('studio') },
  { keys: 'g f', text: 'Go to the farm', group: 'Everywhere', run: go('farm') },
  { keys: 'g h', text: 'Go to the help', group: 'Everywhere', run: go('help') },
  { keys: 't', text: 'Change the theme: as the system, light, dark', group: 'Everywhere', run: nextTheme },
  { keys: '?', text: 'Show the shortcuts', group: 'Everywhere', run: showShortcuts },
]);

/** Learns who calls, then enters the room. */
async function start() {
  startChrome();
  try {
    await readCaller();
  } catch (error) {
    if (session.caller === null) {
      connection.lost();
      showFailure('The farm', error);
      connection.addEventListener('retry', () => location.reload(), { once: true });
      setTimeout(() => location.reload(), 5000);
      return;
    }
  }
  addEventListener('hashchange', () => void enter());
  document.addEventListener('signedin', () => {
    // Another caller sees another farm.
    room = null;
    void enter();
  });
  if (session.isLocked) {
    await askForKey();
  } else {
    farmEvents.start();
    await enter();
  }
}

void start();
