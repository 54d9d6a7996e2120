// How numbers change when they are dragged or stepped: by amounts that suit their size, and within their range.

import { written } from './edits.js';

/**
 * The range of a number, and whether it is whole.
 * @typedef {{minimum?: number | null, maximum?: number | null, isWhole?: boolean}} Range
 */

/** Movement over which a whole number changes by one, in pixels. */
const WHOLE_PX = 6;

/**
 * The step of a number: about a hundredth of it.
 * @param {number} value
 * @param {Range} range
 */
export function stepOf(value, range) {
  if (range.isWhole === true) return 1;
  const size = Math.max(Math.abs(value), 0.1);
  return 10 ** (Math.floor(Math.log10(size)) - 2);
}

/**
 * A number within its range.
 * @param {number} value
 * @param {Range} range
 */
export function clamped(value, range) {
  const low = range.minimum ?? -1e6;
  const high = range.maximum ?? 1e6;
  return Math.min(high, Math.max(low, range.isWhole === true ? Math.round(value) : value));
}

/**
 * The text of a number after a movement.
 * @param {number} start the number before it
 * @param {number} pixels to the right
 * @param {number} factor 1, 0.1 for fine or 10 for coarse changes
 * @param {Range} range
 */
export function dragged(start, pixels, factor, range) {
  const step = stepOf(start, range) * (range.isWhole === true ? Math.max(1, factor) : factor);
  const moved = range.isWhole === true ? Math.trunc(pixels / (factor < 1 ? WHOLE_PX * 4 : WHOLE_PX)) : pixels;
  return textOf(snapped(start, moved * step, step), step, range);
}

/**
 * The text of a number after steps by the keyboard; a step is ten times what a pixel is.
 * @param {number} start
 * @param {number} steps
 * @param {number} factor
 * @param {Range} range
 */
export function stepped(start, steps, factor, range) {
  if (range.isWhole === true) return textOf(start + steps * Math.max(1, factor), 1, range);
  const step = stepOf(start, range) * factor;
  return textOf(snapped(start, steps * step * 10, step), step, range);
}

/**
 * A number moved to a multiple of its step, so that it stays short.
 * @param {number} start
 * @param {number} by
 * @param {number} step
 */
const snapped = (start, by, step) => (by === 0 ? start : Math.round((start + by) / step) * step);

/**
 * @param {number} value
 * @param {number} step
 * @param {Range} range
 */
function textOf(value, step, range) {
  const digits = range.isWhole === true ? 0 : Math.max(0, Math.min(8, Math.ceil(-Math.log10(step) - 1e-9)));
  const limited = clamped(value, range);
  // A limit may have more digits than a step.
  return limited === value ? written(limited, digits) : written(limited, 6);
}

/**
 * Ends of a slider for a number: its range if that is short, else room around it.
 * @param {number} value
 * @param {Range} range
 * @returns {{low: number, high: number, step: number}}
 */
export function slider(value, range) {
  const [least, most] = [range.minimum ?? -1e6, range.maximum ?? 1e6];
  const room = Math.max(1, Math.abs(value) * 2);
  let [low, high] = most - least <= 1000 ? [least, most] : [Math.max(least, value - room), Math.min(most, value + room)];
  if (range.isWhole === true) [low, high] = [Math.floor(low), Math.ceil(high)];
  const step = range.isWhole === true ? 1 : 10 ** (Math.floor(Math.log10(high - low || 1)) - 3);
  return { low, high, step };
}
