// The sizes in which an exact picture is asked for: small first, then sharper, by what the scene has cost before.

/**
 * @typedef {object} Wanted
 * @property {string} text
 * @property {number} frame
 * @property {string} layer
 * @property {number} width of the place where it is shown, in pixels of the screen
 * @property {number} jobWidth
 * @property {number} jobSamples
 */
/** @typedef {{width: number, samples: number, limitMs: number}} Stage `limitMs`: time after which the server renders fewer pixels */
/**
 * Costs of pictures, in milliseconds: a ray, or null if it is unknown; a request, with what the server prepares for
 * it; and the limit of a first picture, from which even its smallest could be rendered.
 * @typedef {{perRay: number | null, overhead: number, firstLimit: number}} Costs
 */

/** Width of the first picture while nothing is known of the scene's cost. */
const FIRST_WIDTH = 240;
const LEAST_WIDTH = 96;
const MOST_WIDTH = 1280;
/** Width that is asked for first where the scene is cheap. */
const USUAL_WIDTH = 480;
/** Time that the first picture is planned to take, and after which the server makes it smaller. */
const FIRST_MS = 90;
const DRAG_MS = 60;
export const FIRST_LIMIT_MS = 250;
/** Time of the first picture, in terms of the time that the server prepares a scene for. */
const PREPARED = 1.3;
/** Time that the sharpest picture may take. */
const LAST_MS = 4000;
/** Most that a server spends on a picture. */
export const LIMIT_MS = 5000;
const MOST_SAMPLES = 16;

/**
 * Width of the sharpest picture.
 * @param {Wanted} wanted
 */
export const mostWidth = (wanted) => Math.max(16, Math.min(MOST_WIDTH, wanted.jobWidth, Math.ceil(wanted.width)));

/**
 * The next picture, if the server has made the picture of every stage smaller; null if the sharpest is as wide as it may be.
 * @param {number} width of the sharpest so far
 * @param {Wanted} wanted
 * @returns {Stage | null}
 */
export function sharper(width, wanted) {
  const most = mostWidth(wanted);
  return width >= most ? null : { width: Math.min(most, Math.max(LEAST_WIDTH, width * 2)), samples: 1, limitMs: LIMIT_MS };
}

/**
 * The sizes in which a picture is asked for, by what a pixel's sample costs.
 * @param {Wanted} wanted
 * @param {Costs} costs
 * @param {boolean} isDrag
 * @param {number} aspect height over width
 * @returns {Stage[]}
 */
export function stages(wanted, { perRay, overhead, firstLimit }, isDrag, aspect) {
  const most = mostWidth(wanted);
  const widthFor = (/** @type {number} */ milliseconds) =>
    perRay === null ? FIRST_WIDTH : Math.sqrt(Math.max(1, Math.max(milliseconds, PREPARED * overhead) - overhead) / (perRay * Math.max(aspect, 0.05)));
  const fits = Math.min(most, USUAL_WIDTH, Math.max(LEAST_WIDTH, Math.floor(widthFor(isDrag ? DRAG_MS : FIRST_MS) / 16) * 16));
  const list = [{ width: fits, samples: 1, limitMs: firstLimit }];
  if (isDrag) return list;
  const middle = Math.min(most, Math.max(fits, USUAL_WIDTH));
  if (middle > fits * 1.4) list.push({ width: middle, samples: 1, limitMs: LIMIT_MS });
  if (most > (list.at(-1)?.width ?? 0) * 1.2) list.push({ width: most, samples: 1, limitMs: LIMIT_MS });
  const samples = Math.min(MOST_SAMPLES, wanted.jobSamples);
  const last = list.at(-1);
  const cost = perRay === null || last === undefined ? 0 : perRay * last.width ** 2 * aspect;
  if (samples > 1 && last !== undefined && cost * samples < LAST_MS) list.push({ width: last.width, samples, limitMs: LIMIT_MS });
  else if (samples > 1 && last !== undefined && cost * 4 < LAST_MS) list.push({ width: last.width, samples: Math.min(4, samples), limitMs: LIMIT_MS });
  return list;
}
