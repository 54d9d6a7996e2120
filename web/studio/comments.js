// The entries of a job file's text and the comments that belong to each, for formatting. A comment on the line of a value
// belongs to that value; other comments belong to what comes after them.

/** @typedef {'open' | 'close' | 'comma' | 'colon' | 'scalar' | 'line' | 'block'} TokenKind */
/** @typedef {{kind: TokenKind, text: string, breaks: number}} Token `breaks`: line breaks before it, at most 2 */
/**
 * @typedef {object} Comment
 * @property {string} text
 * @property {'line' | 'block' | 'long'} form `long` is a block of several lines
 * @property {boolean} followsBlank
 * @property {boolean} sharesStart whether something else is before it on its line
 * @property {boolean} isLast whether nothing is after it on its line
 */
/**
 * @typedef {object} Entry
 * @property {string | null} key with its quotes
 * @property {string | Container} value
 * @property {Comment[]} leading
 * @property {Comment[]} inside between key and value
 * @property {Comment[]} trailing
 * @property {boolean} followsBlank
 */

const MAX_DEPTH = 256;
/** No comments: shared, because few entries have any. @type {Comment[]} */
const NONE = [];
/** @type {[Comment[], Comment[]]} */
const BOTH_NONE = [NONE, NONE];
/** @type {Record<number, TokenKind>} */
const PUNCTUATION = { 123: 'open', 91: 'open', 125: 'close', 93: 'close', 44: 'comma', 58: 'colon' };
/** Characters that end a number or a word. */
const ENDS = new Set([...' \t\r\n,:]}[{"/'].map((letter) => letter.charCodeAt(0)));
const SCALAR = /^(?:true|false|null|-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?|"(?:[^"\\\u0000-\u001f]|\\(?:["\\/bfnrt]|u[0-9a-fA-F]{4}))*")$/;

/**
 * Characters of a text; one outside the basic plane counts once.
 * @param {string} text
 */
export function charsOf(text) {
  let chars = text.length;
  for (let at = 0; at < text.length; at += 1) if ((text.charCodeAt(at) & 0xfc00) === 0xdc00) chars -= 1;
  return chars;
}

/** A list or an object; the whole text is one with one entry. */
export class Container {
  /** @param {boolean} isObject */
  constructor(isObject) {
    this.isObject = isObject;
    /** @type {Entry[]} */
    this.entries = [];
    /** @type {Comment[]} */
    this.openComments = [];
    /** @type {Comment[]} */
    this.endComments = [];
    /** @type {number | null} Its length on one line, or null if it needs several. */
    this.flatChars = null;
  }

  isBare() {
    return this.entries.length === 0 && this.endComments.length === 0 && this.openComments.length === 0;
  }

  /**
   * Whether its lines are filled: a list of numbers, texts, or short lists of them, without comments.
   * @param {number} maxChars
   */
  isFilled(maxChars) {
    const isSilent = (/** @type {Entry} */ entry) => entry.leading.length + entry.inside.length + entry.trailing.length === 0;
    const isSimple = (/** @type {Entry} */ entry) =>
      isSilent(entry) &&
      (typeof entry.value === 'string' ||
        (!entry.value.isObject &&
          entry.value.flatChars !== null &&
          entry.value.flatChars <= maxChars &&
          entry.value.entries.every((each) => typeof each.value === 'string')));
    const hasComments = this.openComments.length + this.endComments.length > 0;
    return !this.isObject && this.entries.length > 0 && !hasComments && this.entries.every(isSimple);
  }
}

/**
 * Length of a value on one line, or null if it needs several.
 * @param {string | Container} value
 */
export const widthOf = (value) => (typeof value === 'string' ? charsOf(value) : value.flatChars);

/** @param {Comment[]} comments */
function widthOfComments(comments) {
  let chars = 0;
  for (const comment of comments) {
    if (comment.form !== 'block') return null;
    chars += charsOf(comment.text) + 1;
  }
  return chars;
}

/** @param {Entry} entry */
function widthOfEntry(entry) {
  const parts = [widthOfComments(entry.leading), widthOfComments(entry.inside), widthOfComments(entry.trailing), widthOf(entry.value)];
  let chars = entry.key === null ? 0 : charsOf(entry.key) + 2;
  for (const part of parts) {
    if (part === null) return null;
    chars += part;
  }
  return chars;
}

/**
 * @param {Comment[]} first
 * @param {Comment[]} second
 */
const both = (first, second) => (second.length === 0 ? first : first.length === 0 ? second : [...first, ...second]);

const isOwnLine = (/** @type {Comment} */ comment) => comment.form !== 'block' || comment.isLast;

/** @param {Container} container */
function flatChars(container) {
  const { isObject, entries, openComments, endComments } = container;
  if (openComments.length > 0 || (entries.length > 0 && endComments.length > 0) || endComments.some(isOwnLine)) return null;
  if (entries.some((entry) => entry.leading.some(isOwnLine))) return null;
  const comments = widthOfComments(endComments);
  if (comments === null) return null;
  let chars = 2 + (isObject && !container.isBare() ? 2 : 0) + 2 * Math.max(0, entries.length - 1) + Math.max(0, comments - 1);
  for (const entry of entries) {
    const width = widthOfEntry(entry);
    if (width === null) return null;
    chars += width;
  }
  return chars;
}

/** Ends the reading of a text that is not JSON. */
class NotJson extends Error {}

class Reader {
  /** @param {string} text */
  constructor(text) {
    this.text = text;
    this.at = text.startsWith('\ufeff') ? 1 : 0;
    this.next = this.scan();
    this.depth = 0;
  }

  /** @returns {Token | null} */
  scan() {
    const { text } = this;
    let breaks = 0;
    let code = text.charCodeAt(this.at);
    while (code === 32 || code === 9 || code === 13 || code === 10) {
      if (code === 10) breaks = Math.min(2, breaks + 1);
      this.at += 1;
      code = text.charCodeAt(this.at);
    }
    if (this.at >= text.length) return null;
    const from = this.at;
    const one = PUNCTUATION[code];
    let kind = one ?? 'scalar';
    let to = from + 1;
    if (text.startsWith('//', from)) {
      kind = 'line';
      const end = text.indexOf('\n', from);
      to = end < 0 ? text.length : end;
    } else if (text.startsWith('/*', from)) {
      kind = 'block';
      to = text.indexOf('*/', from + 2) + 2;
      if (to < from + 2) throw new NotJson('the comment has no end');
    } else if (one !== undefined) {
      this.at = to;
      return { kind, text: text.charAt(from), breaks };
    } else if (code === 34) {
      while (to < text.length && text.charCodeAt(to) !== 34) to += text.charCodeAt(to) === 92 ? 2 : 1;
      to += 1;
    } else {
      while (to < text.length && !ENDS.has(text.charCodeAt(to))) to += 1;
    }
    this.at = to;
    const word = text.slice(from, to);
    if (kind === 'scalar' && !SCALAR.test(word)) throw new NotJson(`not a value: ${word.slice(0, 40)}`);
    return { kind, text: kind === 'line' ? word.replace(/[ \t\r\f]+$/, '') : word, breaks };
  }

  take() {
    const token = this.next;
    if (token === null) throw new NotJson('the text ends too early');
    this.next = this.scan();
    return token;
  }

  /** @param {TokenKind} kind */
  expect(kind) {
    const token = this.take();
    if (token.kind !== kind) throw new NotJson(`${kind} expected`);
    return token;
  }

  /** @returns {Comment[]} */
  comments() {
    if (this.next?.kind !== 'line' && this.next?.kind !== 'block') return NONE;
    const comments = [];
    while (this.next?.kind === 'line' || this.next?.kind === 'block') {
      const token = this.take();
      const form = token.kind === 'line' ? 'line' : token.text.includes('\n') ? 'long' : 'block';
      comments.push({
        text: token.text,
        form: /** @type {Comment['form']} */ (form),
        followsBlank: token.breaks > 1,
        sharesStart: token.breaks === 0,
        isLast: form === 'line' || this.next === null || this.next.breaks > 0,
      });
    }
    return comments;
  }

  /**
   * @param {Comment[]} leading
   * @param {boolean} hasKey
   * @returns {Entry}
   */
  entry(leading, hasKey) {
    let followsBlank = (this.next?.breaks ?? 0) > 1;
    let key = null;
    /** @type {Comment[]} */
    let between = [];
    if (hasKey) {
      key = this.expect('scalar').text;
      if (!key.startsWith('"')) throw new NotJson('a key has quotes');
      between = this.comments();
      this.expect('colon');
      between = [...between, ...this.comments()];
    }
    // A comment that cannot be on the line of its value is moved before the key, and those before it, too.
    const inside = between.length === 0 ? NONE : between.splice(between.findLastIndex((comment) => comment.form !== 'block') + 1);
    for (const comment of between) {
      comment.followsBlank = followsBlank;
      followsBlank = false;
    }
    const token = this.take();
    if (token.kind !== 'scalar' && token.kind !== 'open') throw new NotJson('a value is missing');
    const value = token.kind === 'open' ? this.container(token.text === '{') : token.text;
    return { key, value, leading: both(leading, between), inside, trailing: NONE, followsBlank };
  }

  /** @param {boolean} isObject */
  container(isObject) {
    this.depth += 1;
    if (this.depth > MAX_DEPTH) throw new NotJson('it nests too deep');
    const container = new Container(isObject);
    let [open, pending] = onLine(this.comments());
    const lastOpen = open.at(-1);
    if (lastOpen !== undefined && !lastOpen.isLast) {
      pending = [...open, ...pending];
      open = [];
    }
    container.openComments = open;
    while (this.next !== null && this.next.kind !== 'close') {
      const entry = this.entry(pending, isObject);
      [entry.trailing, pending] = onLine(this.comments());
      if (this.next?.kind === 'comma') {
        this.take();
        const [more, after] = onLine(this.comments());
        const endsLine = more.at(-1)?.isLast === true || (after.length === 0 && this.kindOfNext() === 'close');
        const hasRoom = pending.length === 0 && entry.trailing.at(-1)?.form !== 'line';
        if (endsLine && hasRoom) entry.trailing = both(entry.trailing, more);
        else pending = both(pending, more);
        pending = both(pending, after);
      } else if (this.kindOfNext() !== 'close') {
        throw new NotJson('a comma is missing');
      }
      container.entries.push(entry);
    }
    if (this.expect('close').text !== (isObject ? '}' : ']')) throw new NotJson('the brackets do not match');
    container.endComments = pending;
    container.flatChars = flatChars(container);
    this.depth -= 1;
    return container;
  }

  kindOfNext() {
    return this.next?.kind;
  }
}

/**
 * Comments on the line of the token before them, and the others.
 * @param {Comment[]} comments
 * @returns {[Comment[], Comment[]]}
 */
function onLine(comments) {
  if (comments.length === 0) return BOTH_NONE;
  const end = comments.findIndex((comment) => !comment.sharesStart);
  return end < 0 ? [comments, []] : [comments.slice(0, end), comments.slice(end)];
}

/**
 * Reads a text; null if it is not JSON with comments and trailing commas.
 * @param {string} text
 * @returns {Container | null}
 */
export function read(text) {
  try {
    const reader = new Reader(text);
    const file = new Container(false);
    const entry = reader.entry(reader.comments(), false);
    [entry.trailing, file.endComments] = onLine(reader.comments());
    if (reader.next !== null) return null;
    file.entries.push(entry);
    return file;
  } catch (error) {
    if (error instanceof NotJson) return null;
    throw error;
  }
}
