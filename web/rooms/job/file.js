// The job file as it was submitted, with line numbers, and errors at their lines.

import { messageOf, request } from '/ui/api.js';
import { CodeView } from '/ui/parts/code_view.js';
import { h, setText } from '/ui/parts/dom.js';
import { size } from '/ui/parts/format.js';
import { find, parseUpTo, pathOfPointer, valueOf } from '/ui/studio/json.js';

/** Larger files are only downloaded. */
const LARGEST = 8_000_000;
/** Files of more values are shown without the places of messages. */
const MOST_NODES = 500_000;
/** A place of a job file in a message: `/scene/objects/2/shape`. */
const POINTER = /(?<![\w/])\/(?:scene|image|frames|camera|name|shapes|numbers|materials|lights|objects)(?:\/[\w~.-]+)*/g;
const LINE = /\bline (\d+)/;

/** Tells by `read` that the file has been read. */
export class JobFile extends EventTarget {
  text = '';
  /** @type {import('/ui/studio/json.js').JsonNode | null} */
  #tree = null;
  #isRead = false;

  /**
   * @param {string} job
   * @param {AbortSignal} signal
   */
  constructor(job, signal) {
    super();
    this.job = job;
    this.signal = signal;
    this.view = new CodeView('The job file');
    this.note = h('p', { class: 'muted small' });
    this.element = h('div', { class: 'job-file' }, this.note, this.view.element);
    signal.addEventListener('abort', () => this.view.observer.disconnect());
  }

  /** Reads the file once. */
  async read() {
    if (this.#isRead) return;
    this.#isRead = true;
    try {
      const response = await request(`/v1/jobs/${this.job}/file`, { signal: this.signal, headers: { accept: '*/*' } });
      const length = Number(response.headers.get('content-length') ?? 0);
      if (length > LARGEST) {
        void response.body?.cancel();
        this.#refuse(length);
        return;
      }
      // The length of a compressed file says little.
      const text = await response.text();
      if (text.length > LARGEST) {
        this.#refuse(text.length);
        return;
      }
      this.text = text;
    } catch (error) {
      if (this.signal.aborted) return;
      this.#isRead = false;
      setText(this.note, messageOf(error));
      return;
    }
    this.#tree = parseUpTo(this.text, MOST_NODES);
    this.view.setText(this.text);
    this.dispatchEvent(new Event('read'));
  }

  /**
   * Says that the file is too large to be shown.
   * @param {number} length
   */
  #refuse(length) {
    setText(this.note, `The file has ${size(length)}: download it to read it.`);
    this.view.element.hidden = true;
  }

  /**
   * The value at a place of the file.
   * @param {string[]} path
   */
  value(path) {
    return this.#tree === null ? undefined : valueOf(find(this.#tree, path));
  }

  /**
   * Line of the place that a message names; null if it names none.
   * @param {string} message
   * @returns {number | null}
   */
  lineOf(message) {
    if (this.#tree === null) return null;
    for (const [pointer] of message.matchAll(POINTER)) {
      // The file may not have the last steps, because they are defaults.
      for (let path = pathOfPointer(pointer.replace(/[.:]+$/, '')); path.length > 0; path = path.slice(0, -1)) {
        const node = find(this.#tree, path);
        if (node) return this.text.slice(0, node.keyFrom >= 0 ? node.keyFrom : node.from).split('\n').length;
      }
    }
    const line = Number(LINE.exec(message)?.[1]);
    return Number.isInteger(line) && line > 0 ? line : null;
  }

  /** @param {{line: number, message: string}[]} marks */
  mark(marks) {
    this.view.mark(new Map(marks.map(({ line, message }) => [line, message])));
  }
}
