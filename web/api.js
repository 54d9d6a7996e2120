// Requests to the server: with the key, and with readable errors.

import { connection } from '/ui/connection.js';
import { session } from '/ui/session.js';

/** @typedef {{pointer: string, message: string, line: number, column: number}} Fault */

/** An answer that is not a success, or no answer at all. */
export class Problem extends Error {
  /**
   * @param {string} message
   * @param {{status?: number, code?: string, errors?: Fault[], requestId?: string | null, retryAfter?: number | null}} [more]
   */
  constructor(message, more = {}) {
    super(message);
    this.name = 'Problem';
    /** Status of the answer; 0 if there was none. */
    this.status = more.status ?? 0;
    /** Stable name of the problem. */
    this.code = more.code ?? '';
    /** @type {Fault[]} */
    this.errors = more.errors ?? [];
    this.requestId = more.requestId ?? null;
    /** Seconds after which a request may be repeated. */
    this.retryAfter = more.retryAfter ?? null;
  }

  /** Whether the server does not have the route, because it is of another version. */
  get isUnknownRoute() {
    return this.code === 'unknown_route' || this.code === 'wrong_method';
  }
}

/** @param {unknown} error */
export const isAbort = (error) => error instanceof DOMException && error.name === 'AbortError';

/**
 * A text for any error.
 * @param {unknown} error
 */
export function messageOf(error) {
  if (error instanceof Problem && error.isUnknownRoute) return 'This server does not offer that: it is of another version than the page.';
  if (error instanceof Error) return sentence(error.message);
  return String(error);
}

/**
 * A text with a capital letter and an end.
 * @param {string} text
 */
export function sentence(text) {
  const trimmed = text.trim();
  const first = trimmed.slice(0, 1).toUpperCase() + trimmed.slice(1);
  return /[.!?…]$/.test(first) ? first : `${first}.`;
}

/** @param {Response} response */
async function problemOf(response) {
  const retryAfter = Number(response.headers.get('retry-after')) || null;
  const status = response.status;
  try {
    const body = await response.json();
    return new Problem(body.detail ?? body.title ?? `the server answered ${status}`, {
      status,
      code: body.code ?? '',
      errors: body.errors ?? [],
      requestId: body.request_id ?? null,
      retryAfter,
    });
  } catch {
    return new Problem(`the server answered ${status} ${response.statusText}`.trim(), { status, retryAfter });
  }
}

/**
 * @typedef {object} Options
 * @property {string} [method]
 * @property {Record<string, string | number | boolean | null | undefined>} [query] Left out where null or undefined.
 * @property {unknown} [json] A value to send as JSON.
 * @property {BodyInit} [body] Bytes to send as a job file is sent.
 * @property {Record<string, string>} [headers]
 * @property {AbortSignal} [signal]
 * @property {RequestCache} [cache] `no-cache` by default: what the browser has is compared by its tag.
 */

/**
 * Address of a path with its query.
 * @param {string} path
 * @param {Options['query']} [query]
 */
export function address(path, query = {}) {
  const pairs = Object.entries(query).flatMap(([name, value]) => (value === null || value === undefined ? [] : [[name, String(value)]]));
  return pairs.length === 0 ? path : `${path}?${new URLSearchParams(pairs)}`;
}

/**
 * Requests a path. Every answer but a success becomes a `Problem`.
 * @param {string} path
 * @param {Options} [options]
 * @returns {Promise<Response>}
 */
export async function request(path, options = {}) {
  const { method = 'GET', query, json, body, signal, cache = 'no-cache' } = options;
  const headers = new Headers(options.headers);
  if (!headers.has('accept')) headers.set('accept', 'application/json');
  if (session.key !== null) headers.set('authorization', `Bearer ${session.key}`);
  if (json !== undefined || body !== undefined) headers.set('content-type', 'application/json');
  const payload = json === undefined ? body : JSON.stringify(json);
  let response;
  try {
    response = await fetch(address(path, query), {
      method,
      headers,
      credentials: 'omit',
      cache,
      ...(payload === undefined ? {} : { body: payload }),
      ...(signal === undefined ? {} : { signal }),
    });
  } catch (error) {
    if (isAbort(error) || signal?.aborted) throw error;
    connection.lost();
    throw new Problem('the farm does not answer: it may be restarting, or the network is down');
  }
  connection.answered();
  // 304 has the text that the browser has cached.
  if (response.ok) return response;
  const problem = await problemOf(response);
  if (problem.status === 401) session.dispatchEvent(new CustomEvent('refused', { detail: problem }));
  throw problem;
}

/**
 * Requests JSON.
 * @param {string} path
 * @param {Options} [options]
 * @returns {Promise<any>}
 */
export async function getJson(path, options = {}) {
  const response = await request(path, options);
  return response.status === 204 ? null : response.json();
}

/**
 * Sends a change; returns the JSON of the answer, or null if it has none.
 * @param {string} method
 * @param {string} path
 * @param {Options} [options]
 * @returns {Promise<any>}
 */
export async function send(method, path, options = {}) {
  const response = await request(path, { ...options, method });
  const text = await response.text();
  return text === '' ? null : JSON.parse(text);
}

/**
 * Requests a picture; the caller shows the blob and revokes its address.
 * @param {string} path
 * @param {Options} [options]
 */
export async function getBlob(path, options = {}) {
  const response = await request(path, { ...options, headers: { accept: '*/*', ...options.headers } });
  return response.blob();
}

/**
 * Reads who calls. A server without the route tells what it can on its start page.
 * @param {AbortSignal} [signal]
 */
export async function readCaller(signal) {
  const options = signal === undefined ? {} : { signal };
  try {
    session.caller = await getJson('/v1/caller', options);
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    const start = error.status === 0 ? null : await getJson('/', options);
    if (start === null) throw error;
    const isRefused = error.status === 401;
    // The server refuses what the key may not do.
    session.caller = {
      needs_key: start.needs_key,
      name: start.needs_key && (session.key === null || isRefused) ? null : '',
      scope: start.needs_key ? 'admin' : null,
      read_only: false,
      version: start.version,
    };
    if (isRefused) throw error;
  }
}
