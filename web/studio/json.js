// Reads the text of a job file into a tree with positions: JSON with comments and trailing commas, also while it is being
// typed. It never fails: what is missing becomes a node of kind `missing`. Errors are the server's to report.

/**
 * A value and its place. Its key is a text in an object, an index in a list, and null at the root.
 * @typedef {object} JsonNode
 * @property {'object' | 'list' | 'text' | 'number' | 'word' | 'missing'} kind `word` is true, false, null or not JSON
 * @property {number} from
 * @property {number} to
 * @property {string | number | boolean | null | undefined} value of a text, a number or a word
 * @property {string | number | null} key
 * @property {number} keyFrom −1 without a key in the text
 * @property {number} keyTo
 * @property {boolean} isClosed whether a bracket or a quote ends it
 * @property {JsonNode | null} parent
 * @property {JsonNode[]} children
 */

/** @typedef {string | number} Step */

const MAX_DEPTH = 512;
/** @type {Map<string, boolean | null>} */
const WORDS = new Map([['true', true], ['false', false], ['null', null]]);
/** Characters that end a number or a word. */
const ENDS = new Uint8Array(128);
for (const letter of ' \t\r\n,:]}[{"/') ENDS[letter.charCodeAt(0)] = 1;
/** @param {number} code */
const isEnd = (code) => code < 128 && ENDS[code] === 1;

/** Ends the reading of a text with more nodes than are wanted. */
class TooManyNodes extends Error {}

class Parser {
  /** Lists that are open where the text is read. */
  openLists = 0;

  /**
   * @param {string} text
   * @param {number} mostNodes
   */
  constructor(text, mostNodes) {
    this.text = text;
    this.at = 0;
    this.nodesLeft = mostNodes;
  }

  /** Counts a node that is made. */
  count() {
    this.nodesLeft -= 1;
    if (this.nodesLeft < 0) throw new TooManyNodes();
  }

  /** Skips spaces and comments. */
  skip() {
    const { text } = this;
    for (;;) {
      const code = text.charCodeAt(this.at);
      if (code === 32 || code === 10 || code === 13 || code === 9 || code === 0xfeff) {
        this.at += 1;
      } else if (code === 47 && text.charCodeAt(this.at + 1) === 47) {
        const end = text.indexOf('\n', this.at);
        this.at = end < 0 ? text.length : end;
      } else if (code === 47 && text.charCodeAt(this.at + 1) === 42) {
        const end = text.indexOf('*/', this.at + 2);
        this.at = end < 0 ? text.length : end + 2;
      } else {
        return;
      }
    }
  }

  /**
   * End of the string that begins here: after its quote, or at the end of its line.
   * @param {number} from
   * @returns {[number, boolean]}
   */
  stringEnd(from) {
    const { text } = this;
    for (let at = from + 1; at < text.length; at += 1) {
      const code = text.charCodeAt(at);
      if (code === 34) return [at + 1, true];
      if (code === 92) at += 1;
      else if (code === 10) return [at, false];
    }
    return [text.length, false];
  }

  /**
   * @param {JsonNode | null} parent
   * @param {Step | null} key
   * @param {number} depth
   * @returns {JsonNode}
   */
  value(parent, key, depth) {
    this.count();
    this.skip();
    const { text } = this;
    const from = this.at;
    const code = text.charCodeAt(from);
    /** @type {JsonNode} */
    const node = { kind: 'missing', from, to: from, value: undefined, key, keyFrom: -1, keyTo: -1, isClosed: true, parent, children: [] };
    if ((code === 123 || code === 91) && depth < MAX_DEPTH) {
      node.kind = code === 123 ? 'object' : 'list';
      this.at += 1;
      if (code === 123) this.members(node, depth + 1);
      else this.list(node, depth + 1);
      node.to = this.at;
    } else if (code === 34) {
      const [end, isClosed] = this.stringEnd(from);
      node.kind = 'text';
      node.isClosed = isClosed;
      node.value = unquoted(text.slice(from, end));
      node.to = this.at = end;
    } else if (!isEnd(code) && from < text.length) {
      this.at = this.wordEnd(from);
      node.to = this.at;
      const word = text.slice(from, node.to);
      const number = code === 45 || (code >= 48 && code <= 57) ? Number(word) : NaN;
      node.kind = Number.isNaN(number) ? 'word' : 'number';
      node.value = node.kind === 'number' ? number : WORDS.get(word);
    }
    return node;
  }

  /** @param {number} from */
  wordEnd(from) {
    let at = from;
    while (at < this.text.length && !isEnd(this.text.charCodeAt(at))) at += 1;
    // A slash that begins no comment belongs to nothing: it is passed, so that parsing goes on.
    return Math.max(at, from + 1);
  }

  /**
   * @param {JsonNode} node
   * @param {number} depth
   */
  members(node, depth) {
    const { text } = this;
    for (;;) {
      this.skip();
      const from = this.at;
      const code = text.charCodeAt(from);
      if (from >= text.length || code === 93) {
        node.isClosed = false;
        // A `]` is that of a list around the object, if there is one.
        if (code === 93 && this.openLists === 0) this.at += 1;
        else return;
        continue;
      }
      if (code === 125) {
        this.at += 1;
        return;
      }
      if (code === 44) {
        this.at += 1;
        continue;
      }
      let name = '';
      let to = from;
      if (code === 34) {
        [to] = this.stringEnd(from);
        name = unquoted(text.slice(from, to));
      } else if (code !== 58 && code !== 123 && code !== 91) {
        to = this.wordEnd(from);
        name = text.slice(from, to);
      }
      this.at = to;
      this.skip();
      /** @type {JsonNode} */
      let child;
      if (text.charCodeAt(this.at) === 58) {
        this.at += 1;
        const colon = this.at;
        child = this.value(node, name, depth);
        if (child.kind === 'missing') {
          child.from = child.to = colon;
        }
      } else if (code === 123 || code === 91) {
        child = this.value(node, name, depth);
      } else {
        this.count();
        child = { kind: 'missing', from: to, to, value: undefined, key: name, keyFrom: from, keyTo: to, isClosed: true, parent: node, children: [] };
        this.at = to;
      }
      if (this.at === from) {
        // An object that is too deep to be read: its bracket is passed.
        this.at += 1;
        continue;
      }
      child.keyFrom = from;
      child.keyTo = to;
      node.children.push(child);
    }
  }

  /**
   * @param {JsonNode} node
   * @param {number} depth
   */
  list(node, depth) {
    this.openLists += 1;
    this.items(node, depth);
    this.openLists -= 1;
  }

  /**
   * @param {JsonNode} node
   * @param {number} depth
   */
  items(node, depth) {
    const { text } = this;
    for (;;) {
      this.skip();
      const code = text.charCodeAt(this.at);
      if (this.at >= text.length || code === 125) {
        node.isClosed = false;
        return;
      }
      if (code === 93) {
        this.at += 1;
        return;
      }
      if (code === 44 || code === 58) {
        this.at += 1;
        continue;
      }
      const from = this.at;
      const item = this.value(node, node.children.length, depth);
      // A character that begins no value is passed.
      if (this.at === from) this.at += 1;
      else node.children.push(item);
    }
  }
}

/**
 * The text that a string stands for; without its escapes if they are wrong.
 * @param {string} quoted
 */
function unquoted(quoted) {
  if (!quoted.includes('\\')) return quoted.slice(1, quoted.length > 1 && quoted.endsWith('"') ? -1 : undefined);
  try {
    return String(JSON.parse(quoted));
  } catch {
    return quoted.replace(/^"|"$/g, '');
  }
}

/**
 * Reads a text.
 * @param {string} text
 * @returns {JsonNode}
 */
export function parse(text) {
  return new Parser(text, Infinity).value(null, null, 0);
}

/**
 * Reads a text; null if it has more nodes than are wanted.
 * @param {string} text
 * @param {number} mostNodes
 * @returns {JsonNode | null}
 */
export function parseUpTo(text, mostNodes) {
  try {
    return new Parser(text, mostNodes).value(null, null, 0);
  } catch (error) {
    if (error instanceof TooManyNodes) return null;
    throw error;
  }
}

/**
 * The child with a key or an index; of duplicate keys the last, as the value of an object has.
 * @param {JsonNode | null | undefined} node
 * @param {Step} step
 */
export function child(node, step) {
  if (node?.kind === 'list') return node.children[Number(step)];
  return node?.kind === 'object' ? node.children.findLast((member) => member.key === String(step)) : undefined;
}

/**
 * The node at a path, if it exists.
 * @param {JsonNode | null | undefined} root
 * @param {readonly Step[]} path
 */
export function find(root, path) {
  let node = root;
  for (const step of path) node = child(node, step);
  return node ?? undefined;
}

/**
 * The path of a node from the root.
 * @param {JsonNode} node
 * @returns {Step[]}
 */
export function pathOf(node) {
  const path = [];
  for (let at = node; at.parent !== null; at = at.parent) path.push(at.key ?? '');
  return path.reverse();
}

/**
 * A JSON pointer (RFC 6901).
 * @param {readonly Step[]} path
 */
export const pointer = (path) => path.map((step) => `/${String(step).replaceAll('~', '~0').replaceAll('/', '~1')}`).join('');

/**
 * The path of a JSON pointer.
 * @param {string} text
 */
export const pathOfPointer = (text) =>
  text === '' ? [] : text.slice(1).split('/').map((step) => step.replaceAll('~1', '/').replaceAll('~0', '~'));

/**
 * The deepest node whose text, or whose key, has a position in it or at its ends.
 * @param {JsonNode} root
 * @param {number} position
 */
export function nodeAt(root, position) {
  let node = root;
  for (;;) {
    const inside = node.children.find((each) => position >= (each.keyFrom < 0 ? each.from : each.keyFrom) && position <= each.to);
    if (inside === undefined) return node;
    node = inside;
  }
}

/**
 * A node as a JavaScript value; what is missing is undefined.
 * @param {JsonNode | undefined} node
 * @returns {any}
 */
export function valueOf(node) {
  if (node === undefined) return undefined;
  if (node.kind === 'list') return node.children.map(valueOf);
  if (node.kind === 'object') return Object.fromEntries(node.children.map((member) => [member.key, valueOf(member)]));
  return node.value;
}

/**
 * A list of numbers that are written as such, or undefined.
 * @param {JsonNode | undefined} node
 * @param {number} length
 * @returns {number[] | undefined}
 */
export function numbersOf(node, length) {
  if (node?.kind !== 'list' || node.children.length !== length) return undefined;
  const numbers = node.children.map((item) => (item.kind === 'number' ? Number(item.value) : NaN));
  return numbers.every(Number.isFinite) ? numbers : undefined;
}

/**
 * Where a position is, for completion: at a key or at a value, and the range that a completion replaces.
 * @typedef {{part: 'key' | 'value', node: JsonNode, key: string, from: number, to: number}} Place
 * For a key, `node` is the object; for a value, the node of the value or of the list that it is to stand in.
 */

/**
 * @param {JsonNode} root
 * @param {number} position
 * @returns {Place | null}
 */
export function placeAt(root, position) {
  /** @type {JsonNode} */
  let node = root;
  for (;;) {
    if (node.kind === 'object') {
      if (position <= node.from || (node.isClosed && position >= node.to)) return null;
      const at = node.children.find((member) => position >= member.keyFrom && position <= Math.max(member.to, member.keyTo));
      if (at === undefined) {
        // Behind a colon, and spaces, a value is missing.
        const before = node.children.findLast((member) => member.keyTo < position);
        if (before?.kind === 'missing' && before.from > before.keyTo && !hasNext(node, before, position)) {
          return { part: 'value', node: before, key: String(before.key), from: position, to: position };
        }
        return { part: 'key', node, key: '', from: position, to: position };
      }
      if (position <= at.keyTo) return { part: 'key', node, key: String(at.key), from: at.keyFrom, to: at.keyTo };
      if (at.kind === 'missing' || position <= at.from) return { part: 'value', node: at, key: String(at.key), from: position, to: position };
      node = at;
    } else if (node.kind === 'list') {
      if (position <= node.from || (node.isClosed && position >= node.to)) return null;
      const at = node.children.find((item) => position >= item.from && position <= item.to);
      if (at === undefined) return { part: 'value', node, key: '', from: position, to: position };
      node = at;
    } else {
      return { part: 'value', node, key: String(node.key ?? ''), from: node.from, to: node.to };
    }
  }
}

/**
 * Whether another member begins between one and a position.
 * @param {JsonNode} node
 * @param {JsonNode} member
 * @param {number} position
 */
const hasNext = (node, member, position) => node.children.some((other) => other.keyFrom > member.keyTo && other.keyFrom < position);
