// The studio: a job's text beside its live picture.

import { isAbort, messageOf, Problem } from '/ui/api.js';
import { h, isTyping } from '/ui/parts/dom.js';
import { shortened } from '/ui/parts/format.js';
import { addShortcuts } from '/ui/parts/shortcuts.js';
import { toast, toastError } from '/ui/parts/toast.js';
import { session } from '/ui/session.js';
import { keymap, nextDiagnostic } from '/ui/vendor/codemirror.js';
import { Approximate } from './approximate.js';
import { assist } from './assist.js';
import { Drafts } from './drafts.js';
import { Editor } from './editor.js';
import { Examples } from './examples.js';
import { Checker } from './faults.js';
import { Gestures } from './gestures.js';
import { insertExample } from './insert.js';
import { Inspector } from './inspector.js';
import { find, pathOfPointer } from './json.js';
import { NodeTable } from './nodes.js';
import { objectOf, shownOf } from './document.js';
import { Picture } from './picture.js';
import { Previewer } from './preview.js';
import { PricePanel, drawMap } from './price.js';
import { submitDraft } from './recorded.js';
import { jobFile, nodeTable, sceneFile } from './server.js';
import { SHORTCUTS } from './shortcuts.js';
import { separator } from './split.js';
import { Timeline } from './timeline.js';
import { Toolbar } from './toolbar.js';
import { openFile, saveFile, takeDrops } from './files.js';
import { Viewpoint } from './viewpoint.js';
import { widgets } from './widgets.js';

/** @typedef {import('/ui/parts/room.js').Room} Room */
/** @typedef {import('./json.js').JsonNode} JsonNode */

/** The text of a first visit, if the server has no scenes. */
const FIRST_TEXT = `{
  "name": "first",
  "scene": {
    "camera": { "position": [0, 1.5, 5], "look_at": [0, 0, 0] },
    "materials": { "clay": { "diffuse": { "kd": "#d9894a" } } },
    "objects": [
      { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } },
      { "material": "clay", "shape": { "sphere": { "radius": 1 } } }
    ]
  },
  "image": { "width": 960, "height": 540 }
}
`;
const FIRST_SCENE = 'csg';
/** @typedef {'text' | 'examples' | 'price'} Tab */

/** Screens on which the picture is above the text. */
const NARROW = '(max-width: 760px)';
/** Texts above this are not shown at every change. */
const LARGE_CHARS = 1 << 20;
const LARGE_QUIET_MS = 1200;

/**
 * Opens the studio in a room.
 * @param {Room} room
 */
export async function open(room) {
  const sheet = h('link', { rel: 'stylesheet', href: '/ui/studio/studio.css' });
  const isStyled = new Promise((resolve) => {
    sheet.addEventListener('load', resolve);
    sheet.addEventListener('error', resolve);
  });
  room.append(sheet);
  await isStyled;
  if (room.signal.aborted) return null;
  const studio = new Studio(room);
  await studio.start();
  return studio;
}

export class Studio {
  /** @type {NodeTable | null} */
  table = null;
  drafts = new Drafts();
  timeline = new Timeline();
  picture = new Picture();
  previewer = new Previewer();
  price = new PricePanel();
  #submitKey = { text: '', key: '' };
  #largeTimer = 0;
  /** @type {import('./faults.js').Result | null} */
  #result = null;
  #root;

  /** @param {Room} room */
  constructor(room) {
    this.room = room;
    this.approximate = new Approximate(this.picture.approximate);
    this.examples = new Examples(room.signal);
    this.toolbar = new Toolbar(this);
    const host = h('div', { class: 'editor' });
    const knowledge = { rangeOf: (/** @type {JsonNode} */ node) => this.#rangeOf(node), isColor: (/** @type {JsonNode} */ node) => this.#isColor(node) };
    /** @type {Editor} */
    this.editor = new Editor(host, [
      keymap.of([
        { key: 'Mod-s', run: () => (saveFile(this), true), preventDefault: true },
        { key: 'Mod-o', run: () => (openFile(this), true), preventDefault: true },
        { key: 'Mod-Enter', run: () => (void this.render(), true), preventDefault: true },
        { key: 'Escape', run: () => /** @type {boolean} */ (this.#closeHelp()) },
      ]),
      assist(() => this.table),
      widgets(() => this.editor, knowledge),
    ]);
    this.inspector = new Inspector(() => this.editor, knowledge.rangeOf, () => (nextDiagnostic(this.editor.view), this.editor.view.focus()));
    this.help = h('div', { class: 'help-strip', role: 'status', hidden: true });
    this.checker = new Checker(() => this.editor.text, () => this.editor.tree);
    this.viewpoint = new Viewpoint(this);
    this.gestures = new Gestures(this.picture.stage, this.viewpoint);
    const text = h('section', { class: 'text-room', 'aria-label': 'Text' }, host, this.help, this.inspector.element);
    const side = h('div', { class: 'picture-side' }, this.picture.element, this.timeline.element, this.picture.status, this.price.element);
    const body = h('div', { class: 'studio-body' });
    body.append(this.examples.element, text, separator(body), side);
    this.#root = h('div', { class: 'studio', 'data-tab': 'text' }, this.toolbar.element, this.toolbar.tabs, body);
    takeDrops(this.#root, this);
    this.#listen();
  }

  #listen() {
    const { room, editor, previewer, approximate, picture, timeline, price, examples, drafts } = this;
    room.listen(editor, 'edit', (/** @type {CustomEvent} */ event) => this.#edited(event.detail.isGesture, event.detail.isLoad === true));
    room.listen(editor, 'cursor', () => this.#cursorMoved());
    room.listen(editor, 'note', (/** @type {CustomEvent} */ event) => toast(event.detail, { kind: 'error' }));
    room.listen(editor.view.dom, 'show-help', (/** @type {CustomEvent} */ event) => {
      this.help.replaceChildren(...event.detail);
      this.help.hidden = false;
    });
    room.listen(this.checker, 'result', (/** @type {CustomEvent} */ event) => this.#checked(event.detail));
    room.listen(previewer, 'picture', (/** @type {CustomEvent} */ event) => void this.#shown(event.detail));
    room.listen(previewer, 'problem', (/** @type {CustomEvent} */ event) => this.#failed(event.detail));
    room.listen(previewer, 'state', () => {
      picture.setBusy(previewer.isBusy);
      // At rest the GPU's program is made ready for the next drag.
      const isAtRest = !previewer.isBusy && !editor.isInGesture && !timeline.isPlaying && this.#result?.state !== 'invalid';
      if (isAtRest && approximate.isReady && editor.tree !== null) approximate.show({ text: editor.text, frame: timeline.frame, width: picture.pixels, isShown: false });
    });
    room.listen(approximate, 'picture', (/** @type {CustomEvent} */ event) => {
      if (editor.isInGesture || timeline.isPlaying) picture.showApproximate(event.detail.width, event.detail.milliseconds);
    });
    room.listen(approximate, 'state', () => {
      this.toolbar.showApproximate(approximate);
      // A GPU that stops in the middle of a drag leaves it to the server's previews.
      if (!approximate.isWarm && (editor.isInGesture || timeline.isPlaying)) this.show(true);
    });
    room.listen(approximate, 'stop', (/** @type {CustomEvent} */ event) => toast(`Exact previews are shown while this scene is dragged: ${event.detail}.`, { kind: 'error' }));
    room.listen(picture, 'layer', () => this.show(false));
    room.listen(picture, 'mark', (/** @type {CustomEvent} */ event) => {
      const { action, x, y } = event.detail;
      void (action === 'pick' ? this.viewpoint.pick(x, y) : this.viewpoint.lookAt(x, y));
    });
    let pixels = 0;
    room.listen(picture, 'resize', () => {
      if (picture.pixels > pixels * 1.2 && this.editor.text !== '') this.show(false);
      pixels = Math.max(pixels, picture.pixels);
    });
    room.listen(timeline, 'frame', () => this.show(timeline.isPlaying));
    room.listen(timeline, 'playing', () => this.show(timeline.isPlaying));
    room.listen(price, 'map', (/** @type {CustomEvent} */ event) => {
      picture.map.hidden = event.detail === null;
      if (event.detail !== null) drawMap(picture.map, event.detail);
    });
    room.listen(price, 'save', (/** @type {CustomEvent} */ event) => this.#save(event.detail));
    room.listen(price, 'close', () => this.#closed('price'));
    room.listen(examples, 'scene', (/** @type {CustomEvent} */ event) => void this.openScene(event.detail));
    room.listen(examples, 'kind', (/** @type {CustomEvent} */ event) => this.#insert(event.detail));
    room.listen(examples, 'close', () => this.#closed('examples'));
    room.listen(drafts, 'state', () => this.toolbar.showDraft());
    room.listen(drafts, 'split', () => toast('Another tab changes the same draft: this text is now a draft of its own.'));
    room.listen(globalThis, 'beforeunload', (/** @type {BeforeUnloadEvent} */ event) => {
      if (drafts.isUnkept) event.preventDefault();
    });
    room.listen(globalThis, 'pagehide', () => drafts.leave());
    room.listen(document, 'visibilitychange', () => document.hidden && drafts.leave());
    room.listen(document, 'keydown', (/** @type {KeyboardEvent} */ event) => this.#key(event));
    room.listen(session, 'change', () => this.toolbar.showRights());
    const narrow = matchMedia(NARROW);
    room.listen(narrow, 'change', () => editor.wrap(narrow.matches));
    editor.wrap(narrow.matches);
    room.signal.addEventListener('abort', () => this.stop());
    addShortcuts([...SHORTCUTS, { keys: ' ', text: 'Play or pause the time', group: 'Studio: picture', run: () => timeline.toggle() }], room.signal);
  }

  async start() {
    this.room.append(this.#root);
    void this.approximate.start();
    void this.#loadTable();
    const last = await this.drafts.open();
    if (this.room.signal.aborted) return;
    if (await this.#openQuery()) return;
    if (last !== null) {
      this.drafts.use(last);
      this.editor.load(last.text);
    } else {
      await this.#openFirst();
    }
  }

  /** Opens what the address asks for: a job, or a scene. */
  async #openQuery() {
    const { query } = this.room.place;
    const [job, scene] = [query.get('job'), query.get('scene')];
    if (job === null && scene === null) return false;
    // A reload opens the draft, with its changes.
    history.replaceState(history.state, '', '#/studio');
    try {
      if (job !== null) this.openText(await jobFile(job, this.room.signal));
      else if (scene !== null) await this.openScene(scene);
      return this.editor.text !== '';
    } catch (error) {
      toastError('The job’s file could not be opened', error);
      return false;
    }
  }

  /** Name of the tab that a narrow screen shows below the picture. */
  get shownTab() {
    return this.#root.dataset['tab'] ?? 'text';
  }

  /** The address has changed while the studio is open. */
  moved() {
    void this.#openQuery();
  }

  async #openFirst() {
    let text = FIRST_TEXT;
    try {
      text = await sceneFile(FIRST_SCENE, this.room.signal);
    } catch (error) {
      if (isAbort(error)) return;
    }
    if (this.editor.text === '') this.openText(text);
  }

  async #loadTable() {
    try {
      this.table = new NodeTable(await nodeTable(this.room.signal));
      this.examples.setTable(this.table);
      this.editor.refresh();
    } catch (error) {
      if (isAbort(error)) return;
      setTimeout(() => !this.room.signal.aborted && void this.#loadTable(), 5000);
    }
  }

  /**
   * Opens a text as a new draft.
   * @param {string} text
   */
  openText(text) {
    this.drafts.begin('untitled', text);
    this.editor.load(text);
    this.tab('text');
  }

  /** @param {string} name */
  async openScene(name) {
    try {
      this.openText(await sceneFile(name, this.room.signal));
      toast(`“${name}” is open as a new draft.`);
    } catch (error) {
      toastError('The scene could not be opened', error);
    }
  }

  /** @param {string} id */
  async openDraft(id) {
    await this.drafts.flush();
    const draft = await this.drafts.get(id);
    if (draft === null) {
      toast('This draft has been deleted.', { kind: 'error' });
      return;
    }
    this.drafts.use(draft);
    this.editor.load(draft.text);
  }

  /**
   * @param {boolean} isGesture
   * @param {boolean} isLoad
   */
  #edited(isGesture, isLoad) {
    const { text, tree } = this.editor;
    const name = tree === null ? this.drafts.current.name : shortened(String(find(tree, ['name'])?.value ?? '')) || 'untitled';
    if (isLoad) {
      this.#result = null;
      this.timeline.pause();
    } else if (!isGesture) {
      this.drafts.changed(text, name);
    }
    if (isLoad) this.drafts.current.name = name;
    this.toolbar.showDraft();
    this.price.expire();
    this.checker.changed();
    clearTimeout(this.#largeTimer);
    if (text.length > LARGE_CHARS && !isLoad) this.#largeTimer = setTimeout(() => this.show(false), LARGE_QUIET_MS);
    else this.show(isGesture);
  }

  /**
   * Shows the picture of the text.
   * @param {boolean} isDrag whether more changes follow at once
   */
  show(isDrag) {
    const { text, tree } = this.editor;
    if (text === '') {
      this.previewer.pause();
      this.picture.showOld('Empty', 'The text is empty: choose a scene or an example, or open a file.');
      return;
    }
    const shown = shownOf(tree);
    if (shown !== null) {
      this.timeline.setFrames(shown.frames, shown.fps);
      this.picture.setAspect(shown.aspect);
      this.previewer.aspect = shown.aspect;
    }
    const { frame } = this.timeline;
    const width = this.picture.pixels;
    const canApproximate = this.approximate.isReady && this.picture.layer === 'color';
    if (isDrag && canApproximate) this.approximate.show({ text, frame, width, isShown: true });
    else this.approximate.pause();
    if (isDrag && canApproximate && this.approximate.isWarm) {
      this.previewer.pause();
      return;
    }
    this.previewer.show({ text, frame, layer: this.picture.layer, width, jobWidth: shown?.width ?? 1280, jobSamples: shown?.samples ?? 1 }, isDrag);
  }

  /** @param {import('./preview.js').Shown} shown */
  async #shown(shown) {
    try {
      await this.picture.showExact(shown);
    } catch {
      this.picture.showOld('No picture', 'The browser could not show the picture.');
      return;
    }
    if (shown.wanted.text !== this.editor.text && !this.editor.isInGesture) this.picture.showOld('Older', 'The picture of the text before the last change');
    this.toolbar.showPlan(this.#result);
  }

  /** @param {{error: unknown, text: string}} detail */
  #failed({ error, text }) {
    if (error instanceof Problem && error.errors.length > 0) {
      if (text === this.editor.text) this.checker.report(text, error);
      this.picture.showOld('Last valid', 'The text has errors: this is the picture of the last valid text.');
    } else {
      this.picture.showOld('Not live', messageOf(error));
    }
  }

  /** @param {import('./faults.js').Result} result */
  #checked(result) {
    this.#result = result;
    this.editor.setMarks(result.marks);
    this.inspector.showFaults(result);
    this.toolbar.showPlan(result);
  }

  #cursorMoved() {
    this.inspector.showCursor();
    this.toolbar.showHistory();
    const { tree } = this.editor;
    if (!this.help.hidden) this.#closeHelp();
    this.picture.status.textContent = tree === null ? '' : (objectOf(tree, this.editor.cursor) ?? '');
  }

  #closeHelp() {
    if (this.help.hidden) return false;
    this.help.hidden = true;
    return true;
  }

  /** @param {import('./nodes.js').Kind} kind */
  #insert(kind) {
    const { tree, text, cursor } = this.editor;
    if (tree === null || this.table === null) return;
    const result = insertExample(text, tree, cursor, this.table, kind);
    if ('reason' in result) {
      toast(result.reason, { kind: 'error' });
      return;
    }
    this.editor.change(result.changes, { name: 'input.example', cursor: result.cursor });
    toast(`${kind.name} is inserted ${result.where}.`, { action: { label: 'Undo', run: () => void this.editor.undo() } });
  }

  /** @param {import('./server.js').Saving} saving */
  #save({ pointer, from, to }) {
    const path = pathOfPointer(pointer);
    const entries = [{ path, value: to === null ? null : JSON.stringify(to) }];
    // The picture keeps its proportions.
    const height = this.editor.tree === null ? undefined : find(this.editor.tree, ['image', 'height']);
    if (pointer === '/image/width' && from !== null && to !== null && height?.kind === 'number') {
      entries.push({ path: ['image', 'height'], value: String(Math.max(1, Math.round((Number(height.value) * to) / from))) });
    }
    this.editor.setPaths(entries);
    void this.price.open(this.editor.text);
  }

  /** Submits the job, and goes to it. */
  async render() {
    if (!session.maySubmit) return;
    this.gestures.finish();
    this.editor.endGesture();
    const { text } = this.editor;
    // The same text under the same key is the same job, whatever became of the first answer.
    if (this.#submitKey.text !== text) this.#submitKey = { text, key: crypto.getRandomValues(new Uint32Array(4)).join('-') };
    this.toolbar.setRendering(true);
    try {
      const job = await submitDraft(this.drafts.current.id, text, this.#submitKey.key);
      this.#submitKey = { text: '', key: '' };
      await this.drafts.flush();
      location.hash = `#/jobs/${encodeURIComponent(job.id)}`;
    } catch (error) {
      if (error instanceof Problem && error.errors.length > 0) this.checker.report(text, error);
      toastError('The job was not submitted', error);
    } finally {
      this.toolbar.setRendering(false);
    }
  }

  /**
   * Shows the text, the examples or the price: one of them on a narrow screen, else beside each other.
   * @param {Tab} name
   */
  tab(name) {
    this.#root.dataset['tab'] = name;
    const isNarrow = matchMedia(NARROW).matches;
    if (name === 'examples') this.examples.toggle(true);
    else if (isNarrow) this.examples.toggle(false);
    if (name === 'price') void this.price.open(this.editor.text);
    else if (isNarrow && this.price.isOpen) this.price.close();
    this.toolbar.showTab();
  }

  /** @param {'examples' | 'price'} name */
  #closed(name) {
    if (name === 'examples') this.examples.toggle(false);
    if (this.#root.dataset['tab'] === name) this.#root.dataset['tab'] = 'text';
    this.toolbar.showTab();
  }

  /** @param {JsonNode} node */
  #rangeOf(node) {
    const key = this.table?.describe(node)?.key;
    if (key === undefined) return {};
    return { minimum: key.minimum ?? null, maximum: key.maximum ?? null, unit: key.unit ?? null, isWhole: key.kind === 'integer' };
  }

  /** @param {JsonNode} node */
  #isColor(node) {
    if (node.kind === 'text') return /^(#[0-9a-f]{3,6}$|rgb\()/i.test(String(node.value));
    const slot = this.table?.slotAt(node);
    return slot?.type === 'plain' && slot.shape.kind === 'color' ? true : node.children[0]?.key === 'kelvin';
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (event.defaultPrevented || !(event.ctrlKey || event.metaKey) || event.altKey || document.querySelector('dialog[open]')) return;
    /** @type {Record<string, () => void>} */
    const actions = { s: () => saveFile(this), o: () => openFile(this), Enter: () => void this.render() };
    if (!isTyping(event)) Object.assign(actions, { z: () => void (event.shiftKey ? this.editor.redo() : this.editor.undo()), y: () => void this.editor.redo() });
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (action === undefined) return;
    event.preventDefault();
    action();
  }

  stop() {
    this.gestures.finish();
    this.editor.endGesture();
    this.drafts.leave();
    this.timeline.stop();
    this.previewer.stop();
    this.approximate.stop();
    this.checker.stop();
    clearTimeout(this.#largeTimer);
    this.viewpoint.stop();
    this.editor.destroy();
  }
}
