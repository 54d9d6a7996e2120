// Moves the camera of the text, and finds what is seen at a place of the picture.

import { Problem, isAbort, messageOf } from '/ui/api.js';
import { isInGroup, lookAtPoint, readCamera, writeCamera } from './camera.js';
import { objectOf, placeOf } from './document.js';
import { find, pathOfPointer } from './json.js';
import { pick } from './server.js';

/** @typedef {import('./camera.js').View} View */
/** @typedef {import('./studio.js').Studio} Studio */

/** The thing that gestures move: the camera in the text of a studio. */
export class Viewpoint {
  #picking = new AbortController();

  /** @param {Studio} studio */
  constructor(studio) {
    this.studio = studio;
  }

  isFlying() {
    return this.studio.picture.isFlying;
  }

  /** Begins to move the camera; null if it can't be moved, which is said. */
  begin() {
    const { editor, timeline } = this.studio;
    if (editor.tree === null) return this.#say('The file is too large to move its camera here: change its numbers in the text.');
    const { view, reason } = readCamera(editor.tree, timeline.frame);
    return view ?? this.#say(`The view can’t be moved: ${reason}.`);
  }

  /** @param {View} view */
  apply(view) {
    const { editor } = this.studio;
    if (editor.tree !== null) editor.gesture(writeCamera(editor.tree, view));
  }

  end() {
    this.studio.editor.endGesture();
  }

  cancel() {
    this.studio.editor.cancelGesture();
  }

  /**
   * @param {string} text
   * @returns {null}
   */
  #say(text) {
    this.studio.picture.status.textContent = text;
    return null;
  }

  /**
   * Finds the surface at a place of the picture, 0 to 1 from the top left.
   * @param {number} x
   * @param {number} y
   */
  async #ask(x, y) {
    this.#picking.abort();
    this.#picking = new AbortController();
    try {
      return await pick(this.studio.editor.text, { x, y, frame: this.studio.timeline.frame }, this.#picking.signal);
    } catch (error) {
      if (!isAbort(error)) this.#say(error instanceof Problem && error.errors.length > 0 ? 'The text has errors: nothing can be selected.' : messageOf(error));
      return null;
    }
  }

  /**
   * Selects the object at a place of the picture: the cursor goes to its line.
   * @param {number} x
   * @param {number} y
   */
  async pick(x, y) {
    const { editor, picture } = this.studio;
    const picked = await this.#ask(x, y);
    if (picked === null) return;
    picture.flash(x, y);
    const { tree } = editor;
    const node = picked.pointer === null || tree === null ? undefined : find(tree, pathOfPointer(picked.pointer));
    if (node === undefined || tree === null) {
      this.#say(picked.pointer === null ? 'Nothing is there but the background.' : 'The object is not in the text any more.');
      return;
    }
    editor.show(node.keyFrom < 0 ? node.from : node.keyFrom);
    const name = objectOf(tree, editor.cursor) ?? placeOf(node);
    const distance = picked.distance === null ? '' : `, ${Number(picked.distance.toPrecision(3))} away`;
    this.#say(`${name}${distance}`);
  }

  /**
   * The camera looks at what is at a place of the picture.
   * @param {number} x
   * @param {number} y
   */
  async lookAt(x, y) {
    const { editor } = this.studio;
    const view = this.begin();
    if (view === null) return;
    if (editor.tree !== null && isInGroup(editor.tree)) {
      this.#say('The camera moves with a group: change its look_at in the text.');
      return;
    }
    const picked = await this.#ask(x, y);
    if (picked === null || editor.tree === null) return;
    if (picked.position === null) this.#say('Nothing is there to look at.');
    else editor.change(writeCamera(editor.tree, lookAtPoint(view, picked.position)), { name: 'camera', isVisible: false });
  }

  stop() {
    this.#picking.abort();
  }
}
