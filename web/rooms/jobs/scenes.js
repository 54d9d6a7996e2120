// The shipped scenes, each a click away, with small pictures where the server draws them.

import { Problem, getJson, request } from '/ui/api.js';
import { h } from '/ui/parts/dom.js';
import { toastError } from '/ui/parts/toast.js';
import { submitJob } from '/ui/rooms/jobs/submit.js';
import { session } from '/ui/session.js';

/** @typedef {{name: string, title: string}} Scene */

const WIDTH = 220;
const AT_ONCE = 2;

/**
 * Letters of a name, without those that only part words.
 * @param {string} name
 */
const plain = (name) => name.toLowerCase().replace(/[^a-z0-9]/g, '');

/** A grid of scenes. */
export class Scenes {
  /** @type {(() => Promise<void>)[]} Pictures that are seen and not drawn yet. */
  #waiting = [];
  #drawing = 0;
  #isDrawn = session.mayPreview;

  /** @param {AbortSignal} signal */
  constructor(signal) {
    this.signal = signal;
    this.element = h('div', { class: 'scene-grid' });
    this.observer = new IntersectionObserver((entries) => entries.forEach((entry) => this.#seen(entry)), { root: this.element });
    signal.addEventListener('abort', () => this.observer.disconnect());
  }

  async read() {
    try {
      const { scenes } = await getJson('/v1/scenes', { signal: this.signal });
      this.element.replaceChildren(...scenes.map((/** @type {Scene} */ scene) => this.#button(scene)));
    } catch {
      this.element.replaceChildren(h('p', { class: 'muted' }, 'In a terminal: ', h('code', {}, 'sdfarm demo'), ' renders a first picture.'));
    }
  }

  /** @param {Scene} scene */
  #button(scene) {
    const picture = h('span', { class: 'picture', 'data-scene': scene.name, hidden: !this.#isDrawn });
    const button = h('button', { type: 'button', class: 'scene-button' }, picture, h('b', {}, scene.name), plain(scene.title) === plain(scene.name) ? null : h('span', { class: 'muted' }, scene.title));
    button.addEventListener('click', async () => {
      button.disabled = true;
      try {
        const job = await submitJob(scene.name, await this.#file(scene.name));
        if (job !== null) location.hash = `#/jobs/${job.id}`;
      } catch (error) {
        toastError(scene.name, error);
      }
      button.disabled = false;
    });
    if (this.#isDrawn) this.observer.observe(picture);
    return button;
  }

  /** @param {string} name */
  async #file(name) {
    const response = await request(`/v1/scenes/${encodeURIComponent(name)}`, { signal: this.signal, cache: 'default' });
    return response.text();
  }

  /** @param {IntersectionObserverEntry} entry */
  #seen({ isIntersecting, target }) {
    if (!isIntersecting || !(target instanceof HTMLElement)) return;
    this.observer.unobserve(target);
    this.#waiting.push(() => this.#draw(target));
    void this.#next();
  }

  async #next() {
    while (this.#drawing < AT_ONCE && this.#isDrawn && !this.signal.aborted) {
      const draw = this.#waiting.shift();
      if (draw === undefined) return;
      this.#drawing += 1;
      await draw().finally(() => (this.#drawing -= 1));
    }
  }

  /** @param {HTMLElement} holder */
  async #draw(holder) {
    try {
      const body = await this.#file(holder.dataset['scene'] ?? '');
      const response = await request('/v1/preview', { method: 'POST', query: { width: WIDTH, samples: 1 }, body, signal: this.signal, headers: { accept: '*/*' } });
      const image = new Image();
      image.alt = '';
      const url = URL.createObjectURL(await response.blob());
      image.addEventListener('load', () => URL.revokeObjectURL(url));
      image.src = url;
      holder.replaceChildren(image);
    } catch (error) {
      // A server without previews of job files draws none of them.
      if (!(error instanceof Problem) || !error.isUnknownRoute) return;
      this.#isDrawn = false;
      for (const each of this.element.querySelectorAll('.picture')) /** @type {HTMLElement} */ (each).hidden = true;
    }
  }
}
