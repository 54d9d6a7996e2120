// The studio: its editor is loaded when the room is entered, so that the first page stays small.

import { messageOf } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { Room, emptyState } from '/ui/parts/room.js';

/** Address of the studio itself. */
const STUDIO = '/ui/studio/studio.js';

class StudioRoom extends Room {
  /** @type {import('/ui/studio/studio.js').Studio | null} */
  studio = null;

  enter() {
    this.setTitle('Studio');
    this.append(h('h1', { class: 'visually-hidden', tabindex: -1 }, 'Studio'));
    void this.#load();
  }

  moved() {
    this.studio?.moved();
  }

  leave() {
    this.studio = null;
    this.replaceChildren();
  }

  async #load() {
    const { signal } = this;
    try {
      const studio = await import(STUDIO);
      if (!signal.aborted) this.studio = await studio.open(this);
    } catch (error) {
      if (!signal.aborted) this.append(emptyState('The studio could not be loaded', h('p', {}, messageOf(error))));
    }
  }
}

customElements.define('room-studio', StudioRoom);
