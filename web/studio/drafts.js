// Drafts in the browser: every change is kept, so that a reload or a crash of the tab loses nothing. Texts are in IndexedDB; the
// newest text that is not too long is also written to local storage at once, which a crash does not undo.

/**
 * @typedef {object} Draft
 * @property {string} id
 * @property {string} name
 * @property {string} text
 * @property {number} updatedAt milliseconds
 * @property {number} revision increases with every write
 */
/** @typedef {Omit<Draft, 'text'> & {size: number}} DraftInfo */

const DATABASE = 'sdfarm.studio';
const STORE = 'drafts';
const JOURNAL = 'sdfarm.studio.journal.';
const CURRENT = 'sdfarm.studio.current';
/** Texts up to this are written to local storage at each change. */
const JOURNAL_CHARS = 300_000;
const WRITE_MS = 300;

/**
 * @template T
 * @param {IDBRequest<T>} request
 * @returns {Promise<T>}
 */
const done = (request) =>
  new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error ?? new Error('the browser’s storage failed'));
  });

/**
 * Calls a function with one value after the other, so that long texts are not in memory together.
 * @param {IDBRequest<IDBCursorWithValue | null>} request
 * @param {(value: any) => void} work
 * @returns {Promise<void>}
 */
const each = (request, work) =>
  new Promise((resolve, reject) => {
    request.onerror = () => reject(request.error ?? new Error('the browser’s storage failed'));
    request.onsuccess = () => {
      const cursor = request.result;
      if (cursor === null) return resolve();
      work(cursor.value);
      cursor.continue();
    };
  });

/** @returns {Promise<IDBDatabase>} */
function openDatabase() {
  const request = indexedDB.open(DATABASE, 1);
  request.onupgradeneeded = () => request.result.createObjectStore(STORE, { keyPath: 'id' });
  return done(request);
}

const newId = () => [...crypto.getRandomValues(new Uint8Array(8))].map((byte) => byte.toString(16).padStart(2, '0')).join('');

/** Events: `state` when it has become possible or impossible to keep drafts. */
export class Drafts extends EventTarget {
  /** @type {IDBDatabase | null} */
  #database = null;
  /** The draft in the editor. */
  /** @type {Draft} */
  current = { id: newId(), name: 'untitled', text: '', updatedAt: Date.now(), revision: 0 };
  #isDirty = false;
  /** The text with which the current draft began, if it began in this visit. */
  /** @type {string | null} */
  #origin = null;
  #timer = 0;
  /** Why the draft can't be kept, or null. */
  /** @type {string | null} */
  problem = null;
  /** @type {Promise<void>} */
  #writing = Promise.resolve();

  /** Opens the storage, and the draft that this tab, or the browser, had last; null if there is none. */
  async open() {
    try {
      this.#database = await openDatabase();
      this.#database.onversionchange = () => this.#database?.close();
    } catch {
      this.#database = null;
    }
    await this.#recover();
    const id = read(sessionStorage, CURRENT) ?? read(localStorage, CURRENT);
    return id === null ? null : this.get(id);
  }

  /** Takes over texts that were written to local storage by a tab that has ended. */
  async #recover() {
    for (const key of keysOf(localStorage)) {
      if (!key.startsWith(JOURNAL)) continue;
      const draft = parsed(read(localStorage, key));
      if (draft === null) continue;
      const stored = await this.#stored(draft.id);
      if (stored !== null && stored.updatedAt >= draft.updatedAt) {
        remove(localStorage, key);
      } else if (await this.#write({ ...draft, revision: (stored?.revision ?? 0) + 1 })) {
        remove(localStorage, key);
      }
    }
  }

  /** @param {string} id */
  async #stored(id) {
    if (this.#database === null) return null;
    try {
      return /** @type {Draft | undefined} */ (await done(this.#database.transaction(STORE).objectStore(STORE).get(id))) ?? null;
    } catch {
      return null;
    }
  }

  /**
   * A draft by its id.
   * @param {string} id
   * @returns {Promise<Draft | null>}
   */
  async get(id) {
    return (await this.#stored(id)) ?? parsed(read(localStorage, JOURNAL + id));
  }

  /**
   * All drafts, newest first.
   * @returns {Promise<DraftInfo[]>}
   */
  async list() {
    await this.flush();
    /** @type {Map<string, DraftInfo>} */
    const found = new Map();
    const add = (/** @type {Draft} */ draft) => found.set(draft.id, { id: draft.id, name: draft.name, updatedAt: draft.updatedAt, revision: draft.revision, size: draft.text.length });
    for (const key of keysOf(localStorage)) {
      const draft = key.startsWith(JOURNAL) ? parsed(read(localStorage, key)) : null;
      if (draft !== null) add(draft);
    }
    if (this.#database !== null) {
      try {
        await each(this.#database.transaction(STORE).objectStore(STORE).openCursor(), add);
      } catch {
        // The drafts of local storage are shown.
      }
    }
    return [...found.values()].sort((a, b) => b.updatedAt - a.updatedAt);
  }

  /**
   * Makes a draft the one in the editor. The one before is deleted if it is what it began with: a scene, a job or a file.
   * @param {Draft} draft
   */
  use(draft) {
    const before = this.current;
    const isUnchanged = before.text !== '' && before.text === this.#origin;
    if (before.id !== draft.id && isUnchanged) this.#queue(() => this.delete(before.id));
    else if (before !== draft && this.#isDirty) this.#queue(() => this.#store(before));
    this.#origin = null;
    this.current = draft;
    this.#isDirty = false;
    clearTimeout(this.#timer);
    write(sessionStorage, CURRENT, draft.id);
    write(localStorage, CURRENT, draft.id);
  }

  /**
   * Begins a new draft, which is kept from its first text on.
   * @param {string} name
   * @param {string} text
   */
  begin(name, text) {
    this.use({ id: newId(), name, text, updatedAt: Date.now(), revision: 0 });
    this.#origin = text;
    this.changed(text, name);
  }

  /**
   * The text in the editor has changed.
   * @param {string} text
   * @param {string} name
   */
  changed(text, name) {
    const { current } = this;
    current.text = text;
    current.name = name;
    current.updatedAt = Date.now();
    this.#isDirty = true;
    if (text.length <= JOURNAL_CHARS) this.#journal();
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => void this.flush(), WRITE_MS);
  }

  /** Writes the text to local storage; false if it has no room. */
  #journal() {
    return write(localStorage, JOURNAL + this.current.id, JSON.stringify(this.current));
  }

  /** The page may end at once: what is not written is written as well as possible. */
  leave() {
    if (this.#isDirty) {
      this.#journal();
      void this.flush();
    }
  }

  /** Whether the text in the editor is not kept anywhere. */
  get isUnkept() {
    return this.problem !== null && this.current.text !== '';
  }

  /**
   * Does one thing after the other.
   * @param {() => Promise<void>} work
   */
  #queue(work) {
    this.#writing = this.#writing.then(work);
    return this.#writing;
  }

  /** Writes what has changed. */
  async flush() {
    clearTimeout(this.#timer);
    await this.#queue(async () => {
      if (!this.#isDirty) return;
      this.#isDirty = false;
      await this.#store(this.current);
    });
  }

  /** @param {Draft} draft */
  async #store(draft) {
    const stored = await this.#stored(draft.id);
    if (stored !== null && stored.revision !== draft.revision && stored.text !== draft.text) {
      // Another tab writes the same draft: this text becomes a draft of its own.
      remove(localStorage, JOURNAL + draft.id);
      draft.id = newId();
      draft.name = `${draft.name} (another tab)`;
      draft.revision = 0;
      if (draft === this.current) this.use(draft);
      this.dispatchEvent(new Event('split'));
    }
    draft.revision += 1;
    const isWritten = await this.#write({ ...draft });
    const isNewer = draft === this.current && this.#isDirty;
    if (isWritten && !isNewer) remove(localStorage, JOURNAL + draft.id);
    const isKept = isWritten || write(localStorage, JOURNAL + draft.id, JSON.stringify(draft));
    this.#say(isKept ? null : 'The browser has no room for this draft: save it as a file, or delete older drafts.');
  }

  /**
   * @param {Draft} draft
   * @returns {Promise<boolean>}
   */
  async #write(draft) {
    const database = this.#database;
    if (database === null) return false;
    try {
      await new Promise((resolve, reject) => {
        const transaction = database.transaction(STORE, 'readwrite');
        transaction.oncomplete = () => resolve(undefined);
        transaction.onabort = () => reject(transaction.error ?? new Error('no room'));
        transaction.onerror = () => reject(transaction.error ?? new Error('no room'));
        transaction.objectStore(STORE).put(draft);
      });
      return true;
    } catch {
      return false;
    }
  }

  /** @param {string | null} problem */
  #say(problem) {
    if (problem === this.problem) return;
    this.problem = problem;
    this.dispatchEvent(new Event('state'));
  }

  /**
   * Deletes a draft.
   * @param {string} id
   */
  async delete(id) {
    remove(localStorage, JOURNAL + id);
    if (this.#database === null) return;
    try {
      await done(this.#database.transaction(STORE, 'readwrite').objectStore(STORE).delete(id));
    } catch {
      // It is gone from local storage, and the list shows what is left.
    }
    if (this.problem !== null) {
      this.#isDirty = true;
      await this.flush();
    }
  }
}

/** @param {Storage} storage */
function keysOf(storage) {
  try {
    return Object.keys(storage);
  } catch {
    return [];
  }
}

/**
 * @param {Storage} storage
 * @param {string} key
 */
function read(storage, key) {
  try {
    return storage.getItem(key);
  } catch {
    return null;
  }
}

/**
 * @param {Storage} storage
 * @param {string} key
 * @param {string} value
 */
function write(storage, key, value) {
  try {
    storage.setItem(key, value);
    return true;
  } catch {
    return false;
  }
}

/**
 * @param {Storage} storage
 * @param {string} key
 */
function remove(storage, key) {
  try {
    storage.removeItem(key);
  } catch {
    // There is nothing to remove.
  }
}

/**
 * @param {string | null} text
 * @returns {Draft | null}
 */
function parsed(text) {
  if (text === null) return null;
  try {
    const draft = JSON.parse(text);
    const isDraft = typeof draft?.id === 'string' && typeof draft.text === 'string' && typeof draft.updatedAt === 'number';
    return isDraft ? { id: draft.id, name: String(draft.name), text: draft.text, updatedAt: draft.updatedAt, revision: Number(draft.revision) || 0 } : null;
  } catch {
    return null;
  }
}
