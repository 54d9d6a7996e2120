// The caller: the key, which lives in memory or, if asked, in session storage, and what it may do.

/**
 * @typedef {'read' | 'submit' | 'admin' | 'worker'} Scope
 * @typedef {{needs_key: boolean, name: string | null, scope: Scope | null, scopes?: Scope[] | null, read_only: boolean, version: string}} Caller
 */

const STORED_KEY = 'sdfarm.key';

class Session extends EventTarget {
  /** @type {string | null} */
  #key = null;
  /** @type {Caller | null} */
  #caller = null;

  constructor() {
    super();
    try {
      this.#key = sessionStorage.getItem(STORED_KEY);
    } catch {
      // Storage is off: the key is asked for.
    }
  }

  /** The key, if there is one. */
  get key() {
    return this.#key;
  }

  /** The caller, by the server; null until it has answered. */
  get caller() {
    return this.#caller;
  }

  /** @param {Caller | null} caller */
  set caller(caller) {
    this.#caller = caller;
    this.dispatchEvent(new Event('change'));
  }

  /**
   * Takes a key; it is stored until the tab is closed if `isKept`.
   * @param {string} key
   * @param {boolean} isKept
   */
  signIn(key, isKept) {
    this.#key = key;
    try {
      if (isKept) sessionStorage.setItem(STORED_KEY, key);
      else sessionStorage.removeItem(STORED_KEY);
    } catch {
      // Storage is off: the key stays in memory.
    }
  }

  /** Forgets the key. */
  signOut() {
    this.#key = null;
    try {
      sessionStorage.removeItem(STORED_KEY);
    } catch {
      // It was never stored.
    }
    this.caller = null;
  }

  /** Whether a key is asked for, and none is accepted. */
  get isLocked() {
    const caller = this.#caller;
    return caller !== null && caller.needs_key && caller.name === null;
  }

  /** @param {Scope} scope */
  #has(scope) {
    const caller = this.#caller;
    if (caller === null) return false;
    if (!caller.needs_key) return true;
    const scopes = caller.scopes ?? (caller.scope === null ? [] : [caller.scope]);
    return scopes.includes('admin') || scopes.includes(scope);
  }

  /** Whether the caller may see the whole farm: workers, throughput, jobs of others. */
  get mayRead() {
    return this.#has('read');
  }

  /** Whether the caller may ask for previews and prices, which change nothing. */
  get mayPreview() {
    return this.#has('submit');
  }

  /** Whether the caller may submit jobs. */
  get maySubmit() {
    return this.#has('submit') && !this.isReadOnly;
  }

  /** Whether the caller may act on the farm itself. */
  get mayAdminister() {
    return this.#has('admin') && !this.isReadOnly;
  }

  /** Whether the caller may see keys and the audit log. */
  get mayAudit() {
    return this.#has('admin');
  }

  /** Whether the server refuses changes from browsers. */
  get isReadOnly() {
    return this.#caller?.read_only ?? true;
  }

  /**
   * Whether the caller may change a job of this submitter.
   * @param {{submitter: string}} job
   */
  mayChange(job) {
    if (this.isReadOnly) return false;
    return this.#has('admin') || (this.#has('submit') && this.#caller?.name === job.submitter);
  }
}

export const session = new Session();
