// The table of kinds that the server has (`GET /v1/schema/nodes`), and what it says of a place in a job: which kinds may stand
// there, which keys are missing, and the range of a number.

import { child } from './json.js';

/** @typedef {import('./json.js').JsonNode} JsonNode */
/**
 * The values that a key, or a kind, can have.
 * @typedef {object} Shape
 * @property {string} kind number, integer, boolean, text, word, vec2, vec3, color, a family, object or map; with an s for a
 *   list of them
 * @property {string[]} of families and objects that it can be, or that a list or a map has
 * @property {{word: string | number | boolean, documentation: string}[]} words
 * @property {number | null} minimum
 * @property {number | null} maximum
 */
/**
 * @typedef {Shape & {name: string, required: boolean, default: any, example: any, unit: string | null, documentation: string}} Key
 */
/**
 * @typedef {object} Kind
 * @property {string} name
 * @property {string} family
 * @property {string} title
 * @property {string} documentation
 * @property {Key[]} keys
 * @property {boolean} is_choice whether an object has exactly one of the keys
 * @property {Shape | null} value the value of a kind that is no object
 * @property {any} example
 * @property {string | null} picture
 */
/**
 * Things that may stand at a place.
 * @typedef {{type: 'kind', kind: Kind}
 *   | {type: 'family', family: string}
 *   | {type: 'list', of: Slot}
 *   | {type: 'map', of: Slot}
 *   | {type: 'plain', shape: Shape}} Slot
 */

/** Families in the order of the examples. */
export const FAMILIES = /** @type {const} */ ([
  ['node', 'Shapes'],
  ['profile', 'Profiles'],
  ['material', 'Materials'],
  ['texture', 'Textures'],
  ['light', 'Lights'],
  ['background', 'Backgrounds'],
  ['projection', 'Projections'],
  ['effect', 'Effects'],
]);

/** Kinds of values that are no objects. */
const SIMPLE = new Set(['number', 'integer', 'boolean', 'text', 'word', 'vec2', 'vec3', 'color', 'object', 'map']);

/** Names of a scene that are offered. */
const MOST_NAMES = 1000;

/** The kind of the whole job. */
const ROOT = 'job';

export class NodeTable {
  /** @type {Map<string, Kind[]>} */
  #families = new Map();
  /** @type {Map<string, Kind>} */
  #documents = new Map();

  /** @param {{kinds: Kind[]}} table */
  constructor(table) {
    this.kinds = table.kinds;
    for (const kind of table.kinds) {
      const family = this.#families.get(kind.family) ?? [];
      family.push(kind);
      this.#families.set(kind.family, family);
      if (kind.family === 'document' || kind.family === 'effect') this.#documents.set(kind.name, kind);
    }
  }

  /** @param {string} name */
  family(name) {
    return this.#families.get(name) ?? [];
  }

  /**
   * @param {string} family
   * @param {string} name
   */
  kind(family, name) {
    return this.#families.get(family)?.find((kind) => kind.name === name);
  }

  /** @returns {Slot | null} */
  root() {
    const kind = this.#documents.get(ROOT);
    return kind === undefined ? null : { type: 'kind', kind };
  }

  /**
   * Things that may stand where a value of a shape does.
   * @param {Shape} shape
   * @returns {Slot}
   */
  slotOf(shape) {
    const { kind, of } = shape;
    if (kind === 'map') return { type: 'map', of: this.#inner(shape, 'text') };
    if (this.#isFamily(kind)) return { type: 'family', family: kind };
    if (kind === 'object') return this.#inner(shape, 'object');
    const single = /^(.+?)s$/.exec(kind)?.[1];
    // A list of lists has two.
    if (single !== undefined && (SIMPLE.has(single.replace(/s$/, '')) || this.#isFamily(single))) {
      return { type: 'list', of: this.#isFamily(single) ? { type: 'family', family: single } : single === 'object' ? this.#inner(shape, 'object') : this.slotOf({ ...shape, kind: single, of }) };
    }
    return { type: 'plain', shape };
  }

  /** @param {string} name */
  #isFamily(name) {
    return name !== 'document' && name !== 'effect' && this.#families.has(name);
  }

  /**
   * The content of a list, a map or an object.
   * @param {Shape} shape
   * @param {string} other its kind if it can be several things
   * @returns {Slot}
   */
  #inner(shape, other) {
    const [first, ...more] = shape.of;
    if (first === undefined || more.length > 0) return { type: 'plain', shape: { ...shape, kind: other } };
    return this.#named(first) ?? { type: 'plain', shape: { ...shape, kind: first } };
  }

  /**
   * A family or an object by its name.
   * @param {string} name
   * @returns {Slot | null}
   */
  #named(name) {
    if (this.#isFamily(name)) return { type: 'family', family: name };
    const kind = this.#documents.get(name);
    return kind === undefined ? null : { type: 'kind', kind };
  }

  /**
   * The values of a kind.
   * @param {Kind} kind
   * @returns {Slot}
   */
  #valueOf(kind) {
    return kind.value === null || kind.value === undefined ? { type: 'kind', kind } : this.slotOf(kind.value);
  }

  /**
   * Things that may stand where a node is; null where the table does not know.
   * @param {JsonNode} node
   * @returns {Slot | null}
   */
  slotAt(node) {
    if (node.parent === null) return this.root();
    const outer = this.slotAt(node.parent);
    return outer === null ? null : this.#inside(outer, node);
  }

  /**
   * @param {Slot} outer
   * @param {JsonNode} node
   * @returns {Slot | null}
   */
  #inside(outer, node) {
    const step = String(node.key);
    if (outer.type === 'kind') {
      const key = outer.kind.keys.find((each) => each.name === step);
      return key === undefined ? null : this.slotOf(key);
    }
    if (outer.type === 'family') {
      const kind = this.kind(outer.family, step);
      return kind === undefined ? null : this.#valueOf(kind);
    }
    if (outer.type === 'list' || outer.type === 'map') return outer.of;
    // A number in a vector has what is said of the whole.
    if (node.parent?.kind === 'list') return outer;
    // A track, a formula, or another object in place of a plain value.
    for (const name of outer.shape.of) {
      const slot = this.#named(name);
      const inner = slot === null || slot.type === 'plain' ? null : this.#inside(slot, node);
      if (inner !== null) return inner;
    }
    return null;
  }

  /**
   * Kinds whose keys an object at a place may have: one, or several for a plain value that can be an object.
   * @param {Slot} slot
   * @returns {Kind[]}
   */
  objectsOf(slot) {
    if (slot.type === 'kind') return [slot.kind];
    if (slot.type !== 'plain') return [];
    return slot.shape.of.flatMap((name) => this.#documents.get(name) ?? []);
  }

  /**
   * Families that an object at a place may belong to.
   * @param {Slot} slot
   * @returns {string[]}
   */
  familiesOf(slot) {
    if (slot.type === 'family') return [slot.family];
    return slot.type === 'plain' ? slot.shape.of.filter((name) => this.#isFamily(name)) : [];
  }

  /**
   * The key whose value a node is, with its kind.
   * @param {JsonNode} node
   * @returns {{key: Key, kind: Kind} | null}
   */
  keyAt(node) {
    if (node.parent === null || typeof node.key !== 'string') return null;
    const outer = this.slotAt(node.parent);
    for (const kind of outer === null ? [] : this.objectsOf(outer)) {
      const key = kind.keys.find((each) => each.name === node.key);
      if (key !== undefined) return { key, kind };
    }
    return null;
  }

  /**
   * The key that says what a number, a vector or a color is: its own, or that of the list it is in.
   * @param {JsonNode} node
   */
  describe(node) {
    /** @type {JsonNode | null} */
    let at = node;
    while (at !== null && typeof at.key === 'number') at = at.parent;
    return at === null ? null : this.keyAt(at);
  }

  /**
   * The kind that a node writes out: `sphere` for `{"sphere": …}` and for its key.
   * @param {JsonNode} node
   * @returns {Kind | null}
   */
  kindAt(node) {
    const slot = this.slotAt(node);
    if (slot?.type === 'kind') return slot.kind;
    const only = node.kind === 'object' && node.children.length === 1 ? node.children[0] : undefined;
    return slot?.type === 'family' && only !== undefined ? (this.kind(slot.family, String(only.key)) ?? null) : null;
  }

  /**
   * Keys of a kind that an object does not have, required ones first.
   * @param {Kind} kind
   * @param {JsonNode} object
   */
  missingKeys(kind, object) {
    return kind.keys.filter((key) => child(object, key.name) === undefined).sort((a, b) => Number(b.required) - Number(a.required));
  }

  /**
   * A value to begin with: the default, or that of an example.
   * @param {Kind} kind
   * @param {Key} key
   */
  startOf(kind, key) {
    const example = exampleValue(kind)?.[key.name];
    const word = key.words[0]?.word;
    return key.default ?? example ?? key.example ?? word ?? { color: '#8899aa', vec3: [0, 0, 0], vec2: [0, 0], number: 1, integer: 1, boolean: true, text: '' }[key.kind];
  }
}

/**
 * The value of an example under the kind's name, or the example itself.
 * @param {Kind} kind
 * @returns {Record<string, any> | undefined}
 */
export function exampleValue(kind) {
  const { example } = kind;
  if (typeof example !== 'object' || example === null) return undefined;
  return Object.hasOwn(example, kind.name) ? example[kind.name] : example;
}

/**
 * The names under `scene.materials`, `scene.shapes` or `scene.numbers`.
 * @param {JsonNode} root
 * @param {'materials' | 'shapes' | 'numbers'} list
 */
export function namesOf(root, list) {
  return (child(child(root, 'scene'), list)?.children ?? []).slice(0, MOST_NAMES).map((member) => String(member.key));
}
