// Verifies a stored picture: renders a sample of its tiles again, and says whether the bytes are the same.

import { send } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { showDialog } from '/ui/parts/dialog.js';
import { counted, percent } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';

const FIRST_TILES = 8;
/** Most tiles of one request. */
const MOST_TILES = 64;

/**
 * @typedef {object} Verification
 * @property {boolean} same
 * @property {number} tiles_checked
 * @property {number} tiles_total
 * @property {number} [finds_one_tile] Chance that a change of one tile would have been found.
 * @property {{x: number, y: number, width: number, height: number}[]} differs
 * @property {string[]} [findings]
 * @property {{worker: string, device: string}[] | null} made_by
 * @property {number | string} picture_version
 * @property {string | null} scene
 * @property {string} version
 */

/**
 * Asks the server to verify a frame.
 * @param {string} job
 * @param {number} frame
 * @param {AbortSignal} signal
 * @param {number} [tiles]
 * @returns {Promise<Verification>}
 */
export function verify(job, frame, signal, tiles = FIRST_TILES) {
  return send('POST', `/v1/jobs/${job}/frames/${frame}/verify`, { query: { tiles }, signal });
}

/** @param {Verification} result */
function verdict({ same, tiles_checked: checked, tiles_total: total, differs, findings = [] }) {
  if (!same) {
    const tiles = differs.length === 0 ? 'The file differs from its job.' : `${counted(differs.length, 'tile')} of the ${checked} that were rendered again ${differs.length === 1 ? 'differs, and is' : 'differ, and are'} framed in red in the picture.`;
    return [tiles, ...findings].join(' ');
  }
  if (checked < total) return `${checked} of ${total} tiles were rendered again: every byte is the same.`;
  return total === 1 ? 'Its one tile was rendered again: every byte is the same.' : `All ${total} tiles were rendered again: every byte is the same.`;
}

/**
 * Shows the result; resolves to the number of tiles that are to be verified next, or null.
 * @param {Verification} result
 * @param {string} name
 * @returns {Promise<number | null>}
 */
export async function showVerification(result, name) {
  const { same, tiles_checked: checked, tiles_total: total, finds_one_tile: probability } = result;
  const more = Math.min(total, MOST_TILES);
  const makers = new Map((result.made_by ?? []).map((maker) => [`${maker.worker} ${maker.device}`, maker]));
  /** @type {[string, string | null][]} */
  const facts = [
    ['Picture', name],
    ['Made by', makers.size > 0 ? [...makers.values()].map((maker) => `${maker.worker} (${maker.device})`).join(', ') : null],
    ['Release', `sdfarm ${result.version}, picture version ${result.picture_version}`],
    ['Certainty', same && checked < total && probability !== undefined ? `a change in one tile would have been found with a probability of ${percent(probability)}` : null],
    ['Scene', result.scene],
  ];
  const chosen = await showDialog({
    title: same ? 'The picture is what its job says' : 'The picture is not what its job says',
    body: [
      h('p', { class: `verdict ${same ? 'succeeded' : 'failed'}` }, icon(same ? 'shield' : 'warning', 20), h('span', {}, verdict(result))),
      h('dl', { class: 'facts' }, ...facts.flatMap(([title, value]) => (value === null ? [] : [h('dt', {}, title), h('dd', { class: title === 'Scene' ? 'mono small' : false }, value)]))),
    ],
    actions: checked < more ? [{ label: more === total ? `Verify all ${total} tiles` : `Verify ${more} tiles`, value: 'more', kind: 'primary' }] : [],
    cancel: 'Close',
  });
  return chosen === 'more' ? more : null;
}
