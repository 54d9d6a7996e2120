// The studio: its editor is loaded when the room is entered, so that the first page stays small.

import { messageOf } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { Room, emptyState, heading } from '/ui/parts/room.js';

/** Address of the studio itself. */
const STUDIO = '/ui/studio/studio.js';

class StudioRoom extends Room {
  enter() {
    this.setTitle('Studio');
    this.append(heading('Studio'));
    void this.#load();
  }

  async #load() {
    try {
      const studio = await import(STUDIO);
      if (!this.signal.aborted) studio.open(this);
    } catch (error) {
      this.append(emptyState('The studio could not be loaded', h('p', {}, messageOf(error))));
    }
  }
}

customElements.define('room-studio', StudioRoom);
