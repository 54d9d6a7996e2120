// Formats the text of a job file exactly as `sdfarm fmt` does: a list or an object that fits on a line is one line, a longer one
// has an entry on each line, and a list of numbers fills its lines. Comments, the text of numbers and the order of keys stay.

import { charsOf, read, widthOf } from './comments.js';

/** @typedef {import('./comments.js').Container} Container */
/** @typedef {import('./comments.js').Entry} Entry */
/** @typedef {import('./comments.js').Comment} Comment */

const MAX_LINE_CHARS = 100;
const MAX_FILLED_CHARS = 40;
const INDENT = '  ';

class Printer {
  constructor() {
    /** @type {string[]} */
    this.out = [];
    this.column = 0;
    this.depth = 0;
  }

  /** @param {Container} file */
  file(file) {
    file.entries.forEach((entry, index) => this.lineOf(entry, index === 0, ''));
    this.commentLines(file.endComments, file.entries.length === 0);
    return this.out.join('');
  }

  /**
   * Prints an entry that has its lines for itself, with the comments before and after it.
   * @param {Entry} entry
   * @param {boolean} isFirst
   * @param {string} comma
   */
  lineOf(entry, isFirst, comma) {
    this.commentsBefore(entry.leading, isFirst);
    if (this.column === 0) this.beginLine(entry.followsBlank && !(isFirst && entry.leading.length === 0));
    this.entry(entry, comma.length);
    this.put(comma);
    for (const comment of entry.trailing) {
      this.put(' ');
      this.putComment(comment);
    }
    this.endLine();
  }

  /**
   * @param {Comment[]} comments
   * @param {boolean} isFirst
   */
  commentsBefore(comments, isFirst) {
    comments.forEach((comment, index) => {
      if (this.column === 0) this.beginLine(comment.followsBlank && !(isFirst && index === 0));
      this.putComment(comment);
      if (comment.form !== 'block' || comment.isLast) this.endLine();
      else this.put(' ');
    });
  }

  /**
   * @param {Comment[]} comments
   * @param {boolean} isFirst
   */
  commentLines(comments, isFirst) {
    comments.forEach((comment, index) => {
      this.beginLine(comment.followsBlank && !(isFirst && index === 0));
      this.putComment(comment);
      this.endLine();
    });
  }

  /**
   * @param {Entry} entry
   * @param {number} commaChars
   */
  entry(entry, commaChars) {
    this.key(entry);
    const { value } = entry;
    if (typeof value === 'string') {
      this.put(value);
    } else if (value.entries.length === 0 && value.flatChars !== null) {
      this.flat(value);
    } else if (value.flatChars !== null && this.depth > 0 && this.column + value.flatChars + commaChars <= MAX_LINE_CHARS) {
      this.flat(value);
    } else {
      this.broken(value);
    }
  }

  /** @param {Entry} entry */
  key(entry) {
    if (entry.key !== null) this.put(`${entry.key}: `);
    for (const comment of entry.inside) {
      this.putComment(comment);
      this.put(' ');
    }
  }

  /** @param {Container} container */
  flat(container) {
    const pad = container.isObject && !container.isBare() ? ' ' : '';
    this.put(container.isObject ? '{' : '[');
    this.put(pad);
    container.endComments.forEach((comment, index) => {
      this.put(index === 0 ? '' : ' ');
      this.putComment(comment);
    });
    container.entries.forEach((entry, index) => {
      this.put(index === 0 ? '' : ', ');
      this.commentsBefore(entry.leading, true);
      this.key(entry);
      if (typeof entry.value === 'string') this.put(entry.value);
      else this.flat(entry.value);
      for (const comment of entry.trailing) {
        this.put(' ');
        this.putComment(comment);
      }
    });
    this.put(pad);
    this.put(container.isObject ? '}' : ']');
  }

  /** @param {Container} container */
  broken(container) {
    this.put(container.isObject ? '{' : '[');
    for (const comment of container.openComments) {
      this.put(' ');
      this.putComment(comment);
    }
    this.endLine();
    this.depth += 1;
    if (container.isFilled(MAX_FILLED_CHARS)) {
      this.filled(container);
    } else {
      const last = container.entries.length - 1;
      container.entries.forEach((entry, index) => this.lineOf(entry, index === 0, index === last ? '' : ','));
      this.commentLines(container.endComments, container.entries.length === 0);
    }
    this.depth -= 1;
    this.beginLine(false);
    this.put(container.isObject ? '}' : ']');
  }

  /** @param {Container} container */
  filled(container) {
    const last = container.entries.length - 1;
    container.entries.forEach((entry, index) => {
      const comma = index === last ? '' : ',';
      const chars = (widthOf(entry.value) ?? 0) + comma.length;
      if (this.column > 0 && this.column + 1 + chars > MAX_LINE_CHARS) this.endLine();
      if (this.column === 0) this.beginLine(false);
      else this.put(' ');
      this.entry(entry, comma.length);
      this.put(comma);
    });
    this.endLine();
  }

  /** @param {boolean} isAfterBlank */
  beginLine(isAfterBlank) {
    if (isAfterBlank) this.out.push('\n');
    for (let level = 0; level < this.depth; level += 1) this.put(INDENT);
  }

  endLine() {
    this.out.push('\n');
    this.column = 0;
  }

  /** @param {string} text */
  put(text) {
    if (text === '') return;
    this.out.push(text);
    this.column += charsOf(text);
  }

  /** @param {Comment} comment */
  putComment(comment) {
    const [first = '', ...rest] = comment.text.split('\n').map((line) => line.replace(/[ \t\r\n\f]+$/, ''));
    const starts = rest.map((line) => line.replace(/^[ \t\r\n\f]+/, ''));
    const hasStars = starts.every((line) => line.startsWith('*'));
    this.put(first);
    rest.forEach((line, index) => {
      this.endLine();
      if (hasStars) {
        this.beginLine(false);
        this.put(' ');
      }
      this.put(hasStars ? (starts[index] ?? '') : line);
    });
  }
}

/**
 * The text, formatted, or null if it is not JSON with comments.
 * @param {string} text
 * @returns {string | null}
 */
export function format(text) {
  const file = read(text);
  return file === null ? null : new Printer().file(file);
}
