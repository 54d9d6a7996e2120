// Whether the farm answers, and since when it does not.

/** @typedef {'connecting' | 'live' | 'lost' | 'quiet'} ConnectionState */

class Connection extends EventTarget {
  /** @type {ConnectionState} */
  state = 'connecting';
  /** Time of the newest word from the farm, in milliseconds. */
  heardAt = Date.now();
  /** Time of the next attempt, in milliseconds; null while none is planned. */
  /** @type {number | null} */
  retryAt = null;

  /** @param {ConnectionState} state */
  #become(state) {
    if (this.state === state) return;
    this.state = state;
    this.dispatchEvent(new Event('change'));
  }

  /** A request was answered. */
  answered() {
    if (this.state !== 'lost') this.heardAt = Date.now();
  }

  /** The stream of events has sent something. */
  heard() {
    this.heardAt = Date.now();
    this.retryAt = null;
    this.#become('live');
  }

  /** The server has no stream of events: what is seen is as old as the last request. */
  quiet() {
    this.#become('quiet');
  }

  /** The farm does not answer. */
  lost() {
    this.#become('lost');
  }

  /**
   * The stream will be opened again at this time.
   * @param {number} time
   */
  willRetry(time) {
    this.retryAt = time;
    this.#become('lost');
  }

  /** Asks for an attempt now. */
  retryNow() {
    this.dispatchEvent(new Event('retry'));
  }
}

export const connection = new Connection();
