// Movements of a job's camera, as pure functions of its view. Angles are in radians but for the field of view, lengths in scene
// units; axes are right-handed with y up, as in job files.

import { find, numbersOf } from './json.js';
import { setNumbers } from './edits.js';

/** @typedef {[number, number, number]} Vec3 */
/** @typedef {import('./json.js').JsonNode} JsonNode */
/**
 * @typedef {object} View
 * @property {Vec3} position
 * @property {Vec3} lookAt
 * @property {Vec3} up a unit vector
 * @property {number} fov degrees from top to bottom; of a panorama 180
 * @property {number | null} height of an orthographic picture, in scene units
 * @property {number} turn angle of the turntable at this frame
 */

/** The least angle between the view and `up`. */
const POLE = 0.015;

/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @param {Vec3} a @param {number} factor @returns {Vec3} */
export const times = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];
/** @param {Vec3} a @param {Vec3} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {Vec3} a */
export const length = (a) => Math.hypot(...a);
/** @param {Vec3} a @returns {Vec3} */
export const unit = (a) => times(a, 1 / (length(a) || 1));

/**
 * A vector turned about a unit axis, counter-clockwise seen from its tip (Rodrigues).
 * @param {Vec3} v
 * @param {Vec3} axis
 * @param {number} angle
 * @returns {Vec3}
 */
export function rotate(v, axis, angle) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return add(add(times(v, cos), times(cross(axis, v), sin)), times(axis, dot(axis, v) * (1 - cos)));
}

/**
 * Forward, right and up of the picture.
 * @param {View} view
 */
export function axes(view) {
  const forward = unit(subtract(view.lookAt, view.position));
  const side = cross(forward, view.up);
  const right = unit(length(side) > 1e-9 ? side : [1, 0, 0]);
  return { forward, right, up: cross(right, forward) };
}

/**
 * Turns a direction about `up` and about the right, but never over the pole.
 * @param {Vec3} direction
 * @param {Vec3} up
 * @param {number} yaw
 * @param {number} pitch
 * @returns {Vec3}
 */
function rotated(direction, up, yaw, pitch) {
  const side = cross(direction, up);
  const right = unit(length(side) > 1e-9 ? side : [1, 0, 0]);
  const polar = Math.acos(Math.min(1, Math.max(-1, dot(unit(direction), up))));
  const angle = Math.min(polar - POLE, Math.max(polar - Math.PI + POLE, pitch));
  return rotate(rotate(direction, right, angle), up, yaw);
}

/**
 * The camera circles the point that it looks at.
 * @param {View} view
 * @param {number} yaw counter-clockwise from above
 * @param {number} pitch positive lifts the camera
 * @returns {View}
 */
export function orbit(view, yaw, pitch) {
  return { ...view, position: add(view.lookAt, rotated(subtract(view.position, view.lookAt), view.up, yaw, pitch)) };
}

/**
 * The camera looks elsewhere from where it is.
 * @param {View} view
 * @param {number} yaw to the left
 * @param {number} pitch upward
 * @returns {View}
 */
export function look(view, yaw, pitch) {
  return { ...view, lookAt: add(view.position, rotated(subtract(view.lookAt, view.position), view.up, yaw, pitch)) };
}

/**
 * The camera looks at a point.
 * @param {View} view
 * @param {Vec3} point
 * @returns {View}
 */
export function lookAtPoint(view, point) {
  return length(subtract(point, view.position)) > 1e-6 ? { ...view, lookAt: point } : view;
}

/**
 * The height of what the picture shows at the distance of the point that the camera looks at.
 * @param {View} view
 */
export function shownHeight(view) {
  if (view.height !== null) return view.height;
  return 2 * length(subtract(view.lookAt, view.position)) * Math.tan((Math.min(view.fov, 120) * Math.PI) / 360);
}

/**
 * The camera moves sideways with what it looks at, by fractions of the picture's height.
 * @param {View} view
 * @param {number} right
 * @param {number} up
 * @returns {View}
 */
export function pan(view, right, up) {
  const size = shownHeight(view);
  return move(view, right * size, up * size, 0);
}

/**
 * The camera moves and keeps its direction; lengths are in scene units.
 * @param {View} view
 * @param {number} right
 * @param {number} up
 * @param {number} forward
 * @returns {View}
 */
export function move(view, right, up, forward) {
  const axis = axes(view);
  const way = add(add(times(axis.right, right), times(axis.up, up)), times(axis.forward, forward));
  // A turntable has turned the camera at this frame, so the way that is seen is turned with it.
  const seen = rotate(way, view.up, view.turn);
  return { ...view, position: add(view.position, seen), lookAt: add(view.lookAt, seen) };
}

/**
 * The camera comes nearer to the point that it looks at: factors below 1. An orthographic camera shows less.
 * @param {View} view
 * @param {number} factor
 * @returns {View}
 */
export function dolly(view, factor) {
  if (view.height !== null) return { ...view, height: Math.min(1e6, Math.max(1e-6, view.height * factor)) };
  const way = subtract(view.position, view.lookAt);
  const distance = Math.min(1e6, Math.max(1e-4, length(way) * factor));
  return { ...view, position: add(view.lookAt, times(unit(way), distance)) };
}

/**
 * Digits after the point that a coordinate needs at the scale of a view: a thousandth of what is seen.
 * @param {View} view
 */
export function digits(view) {
  const size = view.height ?? length(subtract(view.lookAt, view.position));
  return Math.min(6, Math.max(1, Math.ceil(3 - Math.log10(size || 1))));
}

/**
 * The camera of a text, or why it can't be moved.
 * @param {JsonNode} root
 * @param {number} frame
 * @returns {{view: View, reason: null} | {view: null, reason: string}}
 */
export function readCamera(root, frame) {
  const camera = find(root, ['scene', 'camera']);
  if (camera?.kind !== 'object') return { view: null, reason: 'the scene has no camera' };
  const position = numbersOf(find(camera, ['position']), 3);
  const lookAt = numbersOf(find(camera, ['look_at']), 3);
  if (position === undefined) return { view: null, reason: 'the camera’s position is not three plain numbers: change its track or formula in the text' };
  if (lookAt === undefined) return { view: null, reason: 'the camera’s look_at is not three plain numbers: change it in the text' };
  const up = numbersOf(find(camera, ['up']), 3) ?? [0, 1, 0];
  const projection = find(camera, ['projection']);
  const height = find(camera, ['projection', 'orthographic', 'height']);
  if (projection?.kind === 'object' && height?.kind !== 'number') return { view: null, reason: 'the height of the projection is not a plain number: change it in the text' };
  const fov = find(camera, ['fov']);
  const isPanorama = projection?.kind === 'text' && projection.value === 'panorama';
  const turns = find(camera, ['turntable']) === undefined ? 0 : Number(find(camera, ['turntable', 'turns'])?.value ?? 1);
  const count = Number(find(root, ['frames', 'count'])?.value ?? 1);
  const view = {
    position: /** @type {Vec3} */ (position),
    lookAt: /** @type {Vec3} */ (lookAt),
    up: unit(/** @type {Vec3} */ (up)),
    fov: isPanorama ? 180 : fov?.kind === 'number' ? Number(fov.value) : 40,
    height: height?.kind === 'number' ? Number(height.value) : null,
    turn: turns === 0 || !(count > 0) ? 0 : (2 * Math.PI * turns * frame) / count,
  };
  if (length(subtract(view.lookAt, view.position)) < 1e-9) return { view: null, reason: 'the camera’s position and look_at are the same point' };
  return { view, reason: null };
}

/**
 * @param {JsonNode | undefined} groups
 * @returns {boolean}
 */
function hasCamera(groups) {
  return groups?.children.some((group) => find(group, ['camera'])?.value === true || hasCamera(find(group, ['groups']))) ?? false;
}

/**
 * Whether the camera moves with a group, so that its numbers are not places in the world.
 * @param {JsonNode} root
 */
export function isInGroup(root) {
  return hasCamera(find(root, ['scene', 'groups']));
}

/**
 * Changes of the text that give the camera a view.
 * @param {JsonNode} root
 * @param {View} view
 */
export function writeCamera(root, view) {
  const camera = find(root, ['scene', 'camera']);
  const places = digits(view);
  const height = find(camera, ['projection', 'orthographic', 'height']);
  return [
    ...setNumbers(find(camera, ['position']), view.position, places),
    ...setNumbers(find(camera, ['look_at']), view.lookAt, places),
    ...(view.height !== null && height?.kind === 'number' && Number(height.value) !== Number(view.height.toPrecision(4))
      ? [{ from: height.from, to: height.to, insert: String(Number(view.height.toPrecision(4))) }]
      : []),
  ];
}
