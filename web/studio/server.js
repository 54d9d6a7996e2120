// Requests of the studio: checks, pictures, places, prices, formatted texts and jobs. Texts above a size are sent compressed.

import { getJson, request, send } from '/ui/api.js';

/** @typedef {import('/ui/api.js').Options} Options */
/** @typedef {{pointer: string, message: string, line: number, column: number}} Fault */
/** @typedef {{seconds: number | null, core_seconds: number, rays: number, memory_bytes: number}} Estimate */
/** @typedef {{valid: true, tiles: number, frames: number, rays: number, estimate: Estimate | null, warnings: string[]}} DryRun */
/**
 * @typedef {object} Picked
 * @property {number | null} object
 * @property {string | null} name
 * @property {string | null} pointer
 * @property {string | null} material
 * @property {string | null} material_pointer
 * @property {[number, number, number] | null} position
 * @property {[number, number, number] | null} normal
 * @property {number | null} distance
 */
/** @typedef {{pointer: string, from: number | null, to: number | null, saves_seconds: number, saves_share: number, message: string}} Saving */
/** @typedef {{columns: number, rows: number, seconds: number[], steps: number[]}} PriceMap */
/**
 * @typedef {object} Price
 * @property {number | null} seconds
 * @property {number | null} seconds_low
 * @property {number | null} seconds_high
 * @property {number} core_seconds
 * @property {{amount: number, currency: string} | null} cost
 * @property {PriceMap | null} map
 * @property {Saving[]} savings
 */
/** @typedef {{program: string, wgsl: string | null, uniforms: number[], table: number[], samples: number, width: number, height: number, reason: string | null}} Shader */
/** @typedef {{name: string, title: string, bytes: number}} SceneInfo */

/** Texts above this are compressed. */
const COMPRESS_CHARS = 64 << 10;

/** Largest program, with its numbers, that is read: 2 MiB of text, and as many words as a server sends at most. */
const MOST_SHADER_BYTES = 28 << 20;
/** Characters that are compressed in one task of the page. */
const PIECE_CHARS = 1 << 19;

/** The text that was compressed last: its check, its picture and its program are requested together. */
let compressedText = '';
/** @type {Promise<Blob> | null} */
let compressed = null;

/**
 * A text in pieces, each in a task of its own, so that a large one does not hold the page up.
 * @param {string} text
 * @returns {ReadableStream<string>}
 */
function inPieces(text) {
  let at = 0;
  return new ReadableStream({
    async pull(controller) {
      await new Promise((resolve) => setTimeout(resolve));
      controller.enqueue(text.slice(at, at + PIECE_CHARS));
      at += PIECE_CHARS;
      if (at >= text.length) controller.close();
    },
  }, { highWaterMark: 0 });
}

/**
 * @param {string} text
 * @returns {Promise<Blob>}
 */
function compress(text) {
  if (compressed === null || text !== compressedText) {
    compressedText = text;
    compressed = new Response(inPieces(text).pipeThrough(new TextEncoderStream()).pipeThrough(new CompressionStream('gzip'))).blob();
  }
  return compressed;
}

/**
 * A text as a body, with the headers that it needs.
 * @param {string} text
 * @returns {Promise<{body: BodyInit, headers: Record<string, string>}>}
 */
async function bodyOf(text) {
  if (text.length < COMPRESS_CHARS || typeof CompressionStream === 'undefined') return { body: text, headers: {} };
  return { body: await compress(text), headers: { 'content-encoding': 'gzip' } };
}

/**
 * @param {string} text
 * @param {NonNullable<Options['query']>} query
 * @param {AbortSignal} signal
 * @returns {Promise<Options>}
 */
const posted = async (text, query, signal) => ({ method: 'POST', query, signal, ...(await bodyOf(text)) });

/**
 * Checks a job; an invalid one is a `Problem` with its errors.
 * @param {string} text
 * @param {AbortSignal} signal
 * @returns {Promise<DryRun>}
 */
export const check = async (text, signal) => getJson('/v1/jobs', await posted(text, { dry_run: true }, signal));

/**
 * The exact picture of a frame. One that takes longer than the limit is that of a smaller job, scaled up: `width` is its
 * width, and `samples` its samples.
 * @param {string} text
 * @param {{width: number, frame: number, samples: number, layer: string, limit_ms: number}} query
 * @param {AbortSignal} signal
 * @returns {Promise<{blob: Blob, width: number, samples: number}>}
 */
export async function preview(text, query, signal) {
  const options = await posted(text, query, signal);
  const response = await request('/v1/preview', { ...options, headers: { ...options.headers, accept: 'image/png' } });
  const { headers } = response;
  return { blob: await response.blob(), width: Number(headers.get('preview-width')) || query.width, samples: Number(headers.get('preview-samples')) || query.samples };
}

/**
 * The surface at a place of the picture, 0 to 1 from the top left.
 * @param {string} text
 * @param {{x: number, y: number, frame: number}} query
 * @param {AbortSignal} signal
 * @returns {Promise<Picked>}
 */
export const pick = async (text, query, signal) => getJson('/v1/pick', await posted(text, query, signal));

/**
 * The program and the numbers of an approximate picture.
 * @param {string} text
 * @param {{frame: number, width: number, samples: number, program: string | null}} query
 * @param {AbortSignal} signal
 * @returns {Promise<Shader>}
 */
export async function shader(text, query, signal) {
  const response = await request('/v1/shader', await posted(text, query, signal));
  return JSON.parse(await textUpTo(response, MOST_SHADER_BYTES));
}

/**
 * The text of an answer; an error if it is longer than is wanted.
 * @param {Response} response
 * @param {number} mostBytes
 */
async function textUpTo(response, mostBytes) {
  const reader = response.body?.getReader();
  const decoder = new TextDecoder();
  let text = '';
  let size = 0;
  for (;;) {
    const { done, value } = (await reader?.read()) ?? { done: true, value: undefined };
    if (done) return text + decoder.decode();
    size += value.length;
    if (size > mostBytes) {
      void reader?.cancel();
      throw new Error('the program of this scene is too large for a browser');
    }
    text += decoder.decode(value, { stream: true });
  }
}

/**
 * The price of a job.
 * @param {string} text
 * @param {boolean} map
 * @param {AbortSignal} signal
 * @returns {Promise<Price>}
 */
export const price = async (text, map, signal) => getJson('/v1/price', await posted(text, { map }, signal));

/**
 * The text, as `sdfarm fmt` formats it; what is not JSON is a `Problem`.
 * @param {string} text
 * @returns {Promise<string>}
 */
export async function format(text) {
  const { body, headers } = await bodyOf(text);
  return (await request('/v1/format', { method: 'POST', body, headers })).text();
}

/**
 * Submits a job once, whatever happens to the answer.
 * @param {string} text
 * @param {string} key
 * @param {import('/ui/api.js').Options['query']} [query]
 * @returns {Promise<{id: string}>}
 */
export async function submit(text, key, query = {}) {
  const { body, headers } = await bodyOf(text);
  return send('POST', '/v1/jobs', { query, body, headers: { ...headers, 'idempotency-key': key } });
}

/**
 * The file of a job, as it was submitted.
 * @param {string} id
 * @param {AbortSignal} signal
 */
export const jobFile = async (id, signal) => (await request(`/v1/jobs/${encodeURIComponent(id)}/file`, { signal })).text();

/**
 * @param {AbortSignal} signal
 * @returns {Promise<{kinds: import('./nodes.js').Kind[]}>}
 */
export const nodeTable = (signal) => getJson('/v1/schema/nodes', { signal });

/**
 * @param {AbortSignal} signal
 * @returns {Promise<{scenes: SceneInfo[]}>}
 */
export const scenes = (signal) => getJson('/v1/scenes', { signal });

/**
 * @param {string} name
 * @param {AbortSignal} signal
 */
export const sceneFile = async (name, signal) => (await request(`/v1/scenes/${encodeURIComponent(name)}`, { signal })).text();
