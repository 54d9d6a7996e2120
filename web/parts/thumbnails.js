// Small pictures of jobs: requested with the key, a few at a time, and kept as bytes.

import { Problem, getBlob, isAbort } from '/ui/api.js';

const AT_ONCE = 3;
const KEPT = 400;
/** Wait before a picture that the server had no room for is requested again, in seconds. */
const BUSY_SECONDS = 1;

/** @type {Map<string, Blob | null>} The newest last; null where there is no picture. */
const kept = new Map();
/** @type {Map<string, Set<HTMLElement>>} What waits for a picture, the newest last. */
const wanted = new Map();
/** @type {Set<string>} */
const running = new Set();

/**
 * Path of a job's thumbnail, or null if it has no picture yet.
 * @param {import('/ui/types.js').Job} job
 * @param {number} [width]
 */
export function thumbnailPath(job, width = 160) {
  if (job.state === 'succeeded') return `/v1/jobs/${job.id}/frames/0/thumbnail?width=${width}`;
  // A preview costs the server more: it is requested again when another tenth is finished.
  if (job.progress > 0 && job.state !== 'queued') return `/v1/jobs/${job.id}/frames/0/preview?width=${width}#${Math.floor(job.progress * 10)}`;
  return null;
}

/**
 * Shows a picture in a holder. What was there stays until the new one has arrived.
 * @param {HTMLElement} holder
 * @param {string | null} path
 */
export function showThumbnail(holder, path) {
  const before = holder.dataset['path'] ?? '';
  if (before === (path ?? '')) return;
  if (before !== '') wanted.get(before)?.delete(holder);
  const isSamePicture = path !== null && before.split(/[?#]/)[0]?.split('/')[3] === path.split('/')[3];
  if (!isSamePicture) holder.replaceChildren();
  holder.dataset['path'] = path ?? '';
  if (path === null) return;
  const blob = kept.get(path);
  if (blob !== undefined) {
    kept.delete(path);
    kept.set(path, blob);
    put(holder, blob);
    return;
  }
  const holders = wanted.get(path) ?? new Set();
  wanted.delete(path);
  wanted.set(path, holders.add(holder));
  pump();
}

/**
 * Shows bytes as a picture; their address is valid only until it is decoded.
 * @param {HTMLElement} holder
 * @param {Blob | null} blob
 */
function put(holder, blob) {
  if (blob === null) {
    holder.replaceChildren();
    return;
  }
  const image = new Image();
  image.alt = '';
  image.decoding = 'async';
  const url = URL.createObjectURL(blob);
  const end = () => URL.revokeObjectURL(url);
  image.addEventListener('load', () => {
    end();
    if (holder.dataset['path'] === image.dataset['path']) holder.replaceChildren(image);
  });
  image.addEventListener('error', end);
  image.dataset['path'] = holder.dataset['path'] ?? '';
  image.src = url;
}

function pump() {
  while (running.size < AT_ONCE) {
    // The newest request is for a picture that is seen now.
    const next = [...wanted].reverse().find(([path, holders]) => holders.size > 0 && !running.has(path));
    if (next === undefined) break;
    void load(next[0]);
  }
  for (const [path, holders] of wanted) if (holders.size === 0 && !running.has(path)) wanted.delete(path);
}

/** @param {string} path */
async function load(path) {
  running.add(path);
  /** @type {Blob | null} */
  let blob = null;
  try {
    blob = await getBlob(path.split('#')[0] ?? path, { cache: 'default' });
  } catch (error) {
    const isBusy = error instanceof Problem && (error.status === 429 || error.status === 503);
    if (isBusy || isAbort(error)) {
      const seconds = (error instanceof Problem && error.retryAfter) || BUSY_SECONDS;
      setTimeout(() => (running.delete(path), pump()), seconds * 1000);
      return;
    }
  }
  running.delete(path);
  kept.set(path, blob);
  for (const old of kept.keys()) {
    if (kept.size <= KEPT) break;
    kept.delete(old);
  }
  for (const holder of wanted.get(path) ?? []) {
    if (holder.dataset['path'] === path) put(holder, blob);
  }
  wanted.delete(path);
  pump();
}
