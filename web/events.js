// Server-sent events by fetch, because an EventSource cannot send a key.

import { Problem, isAbort, request } from '/ui/api.js';
import { connection } from '/ui/connection.js';
import { session } from '/ui/session.js';

/** Silence after which a stream counts as broken: the server writes something every 15 s. */
const SILENCE_MS = 40_000;
const FIRST_RETRY_MS = 500;
const LAST_RETRY_MS = 15_000;

/** @typedef {{event: string, data: string, id: string | null}} Message */

/** Parses a stream of events in pieces. */
export class EventParser {
  #rest = '';
  #event = '';
  /** @type {string[]} */
  #data = [];
  /** @type {string | null} */
  #id = null;

  /**
   * Adds text; returns the events that it completes.
   * @param {string} text
   * @returns {Message[]}
   */
  push(text) {
    const lines = (this.#rest + text).split('\n');
    this.#rest = lines.pop() ?? '';
    /** @type {Message[]} */
    const messages = [];
    for (const raw of lines) {
      const line = raw.endsWith('\r') ? raw.slice(0, -1) : raw;
      if (line === '') {
        if (this.#data.length > 0) messages.push({ event: this.#event || 'message', data: this.#data.join('\n'), id: this.#id });
        this.#event = '';
        this.#data = [];
        continue;
      }
      const colon = line.indexOf(':');
      const field = colon < 0 ? line : line.slice(0, colon);
      const value = colon < 0 ? '' : line.slice(colon + 1).replace(/^ /, '');
      if (field === 'event') this.#event = value;
      else if (field === 'data') this.#data.push(value);
      else if (field === 'id') this.#id = value;
    }
    return messages;
  }
}

/**
 * Waits, at most until the signal aborts or an attempt is asked for.
 * @param {number} milliseconds
 * @param {AbortSignal} signal
 * @returns {Promise<void>}
 */
function pause(milliseconds, signal) {
  return new Promise((resolve) => {
    const end = () => {
      clearTimeout(timer);
      signal.removeEventListener('abort', end);
      connection.removeEventListener('retry', end);
      window.removeEventListener('online', end);
      resolve();
    };
    const timer = setTimeout(end, milliseconds);
    signal.addEventListener('abort', end);
    connection.addEventListener('retry', end);
    window.addEventListener('online', end);
  });
}

/**
 * Reads a stream once, until it ends.
 * @param {string} path
 * @param {string | null} lastId
 * @param {AbortSignal} outer
 * @param {(message: Message) => void} onMessage
 * @param {() => void} onHeard
 * @returns {Promise<boolean>} Whether the server has said that nothing follows.
 */
async function read(path, lastId, outer, onMessage, onHeard) {
  const silence = new AbortController();
  let timer = 0;
  const listen = () => {
    clearTimeout(timer);
    timer = setTimeout(() => silence.abort(), SILENCE_MS);
  };
  const signal = AbortSignal.any([outer, silence.signal]);
  listen();
  try {
    const headers = { accept: 'text/event-stream', ...(lastId === null ? {} : { 'last-event-id': lastId }) };
    const response = await request(path, { headers, signal });
    onHeard();
    if (response.status === 204 || response.body === null) return true;
    const parser = new EventParser();
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return false;
      listen();
      onHeard();
      for (const message of parser.push(value)) onMessage(message);
    }
  } catch (error) {
    if (outer.aborted) throw error;
    if (silence.signal.aborted || isAbort(error) || !(error instanceof Problem)) return false;
    throw error;
  } finally {
    clearTimeout(timer);
  }
}

/**
 * Follows a stream and opens it again whenever it breaks, until the signal aborts, the server says that nothing follows,
 * or the server refuses it.
 * @param {string} path
 * @param {{signal: AbortSignal, onMessage: (message: Message) => void, onOpen?: () => void, isFarm?: boolean}} options
 *   `onOpen` is called at each start; `isFarm` is the stream by which the page knows whether the farm answers.
 */
export async function follow(path, { signal, onMessage, onOpen, isFarm = false }) {
  /** @type {string | null} */
  let lastId = null;
  let delay = FIRST_RETRY_MS;
  while (!signal.aborted) {
    let isOpen = false;
    try {
      const isOver = await read(
        path,
        lastId,
        signal,
        (message) => {
          lastId = message.id ?? lastId;
          onMessage(message);
        },
        () => {
          delay = FIRST_RETRY_MS;
          if (isFarm) connection.heard();
          if (!isOpen) onOpen?.();
          isOpen = true;
        },
      );
      if (isOver) return;
    } catch (error) {
      if (signal.aborted) return;
      // The server answers, and will not answer otherwise: a wrong key, or no such route.
      const status = error instanceof Problem ? error.status : 0;
      if (status === 404 || status === 405) {
        if (isFarm) connection.quiet();
        return;
      }
      if (status === 401 || status === 403) return;
    }
    const wait = delay * (0.75 + Math.random() / 2);
    delay = Math.min(delay * 2, LAST_RETRY_MS);
    if (isFarm) connection.willRetry(Date.now() + wait);
    await pause(wait, signal);
  }
}

/**
 * The farm's events, for all rooms: `job` (detail: the job), `deleted` (detail: its id), `farm` (detail: counts), and `open`
 * each time the stream starts, or the server cannot tell what has changed, when lists are to be read again.
 */
class FarmEvents extends EventTarget {
  /** @type {AbortController | null} */
  #running = null;
  /** The newest counts. */
  /** @type {import('/ui/types.js').FarmCounts | null} */
  counts = null;

  /** Starts, or starts again with another key. */
  start() {
    this.#running?.abort();
    const controller = new AbortController();
    this.#running = controller;
    void follow('/v1/events', {
      signal: controller.signal,
      isFarm: true,
      onOpen: () => this.dispatchEvent(new Event('open')),
      onMessage: (message) => this.#take(message),
    });
  }

  /** Stops. */
  stop() {
    this.#running?.abort();
    this.#running = null;
  }

  /** @param {Message} message */
  #take({ event, data }) {
    if (event === 'resync') this.dispatchEvent(new Event('open'));
    if (!['job', 'deleted', 'farm'].includes(event)) return;
    const value = JSON.parse(data);
    if (event === 'farm') this.counts = value.farm ?? value;
    const detail = event === 'deleted' ? value.id : event === 'farm' ? this.counts : value;
    this.dispatchEvent(new CustomEvent(event, { detail }));
  }
}

export const farmEvents = new FarmEvents();

session.addEventListener('change', () => {
  if (session.isLocked) farmEvents.stop();
});
