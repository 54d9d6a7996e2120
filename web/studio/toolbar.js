// The studio's commands, and the tabs of narrow screens.

import { h, setText, svg } from '/ui/parts/dom.js';
import { icon } from '/ui/parts/icons.js';
import { openMenu } from '/ui/parts/menu.js';
import { confirm } from '/ui/parts/dialog.js';
import { ago, counted, duration, short, shortened, size } from '/ui/parts/format.js';
import { session } from '/ui/session.js';
import { openFile, saveFile } from './files.js';
import { isWanted, want } from './recorded.js';

/** @typedef {import('./studio.js').Studio} Studio */
/** @typedef {import('./faults.js').Result} Result */
/** @typedef {import('./studio.js').Tab} Tab */

/** Drafts in the menu. */
const MOST_DRAFTS = 12;

const UNDO = 'M5.2 3.2 2.5 6l2.7 2.8M2.8 6h6.4a3.4 3.4 0 0 1 0 6.8H6';
const REDO = 'M10.8 3.2 13.5 6l-2.7 2.8M13.2 6H6.8a3.4 3.4 0 0 0 0 6.8H10';
const CHEVRON = 'M4.5 6.5 8 10l3.5-3.5';

/**
 * An icon of a path on a grid of 16.
 * @param {string} path
 */
const drawn = (path) =>
  svg('svg', { viewBox: '0 0 16 16', width: 16, height: 16, class: 'icon', 'aria-hidden': 'true' }, svg('path', { d: path, fill: 'none', stroke: 'currentColor', 'stroke-width': 1.5, 'stroke-linecap': 'round', 'stroke-linejoin': 'round' }));

export class Toolbar {
  #name = h('span', { class: 'draft-name ellipsis' }, 'untitled');
  #kept = h('span', { class: 'kept small' });
  #plan = h('span', { class: 'plan small muted', role: 'status' });
  #gpu = h('span', { class: 'gpu small muted' });

  /** @param {Studio} studio */
  constructor(studio) {
    this.studio = studio;
    const tool = (/** @type {string} */ path, /** @type {string} */ label, /** @type {() => void} */ run) =>
      h('button', { type: 'button', class: 'ghost', 'aria-label': label, title: label, on: { click: run } }, drawn(path));
    this.draftButton = h('button', { type: 'button', class: 'button draft', 'aria-haspopup': 'menu', 'aria-expanded': 'false', title: 'Drafts and files', on: { click: () => void this.#openDrafts() } }, icon('edit'), this.#name, drawn(CHEVRON));
    this.undoButton = tool(UNDO, 'Undo (Ctrl+Z)', () => void studio.editor.undo());
    this.redoButton = tool(REDO, 'Redo (Ctrl+Shift+Z)', () => void studio.editor.redo());
    this.formatButton = h('button', { type: 'button', class: 'button', title: 'Format the text (Shift+Alt+F)', on: { click: () => void studio.editor.format() } }, 'Format');
    this.examplesButton = h('button', { type: 'button', class: 'button wide-only', 'aria-pressed': 'false', on: { click: () => (studio.examples.isOpen ? studio.examples.close() : studio.tab('examples')) } }, icon('plus'), 'Examples');
    this.priceButton = h('button', { type: 'button', class: 'button wide-only', 'aria-pressed': 'false', title: 'Its price before a render', on: { click: () => (studio.price.isOpen ? studio.price.close() : studio.tab('price')) } }, 'Price');
    this.renderButton = h('button', { type: 'button', class: 'button primary', title: 'Render (Ctrl+Enter)', on: { click: () => void studio.render() } }, icon('play'), 'Render');
    const recorded = h('input', { type: 'checkbox', checked: isWanted(), on: { change: () => want(recorded.checked) } });
    this.recordedChoice = h('label', { class: 'check wide-only', title: 'The farm keeps the tiles of a render, and the next one renders only those that the edit can change. The picture is the same.' }, recorded, 'Only what changed');
    this.element = h(
      'div',
      { class: 'studio-bar', role: 'toolbar', 'aria-label': 'Studio' },
      this.draftButton,
      this.#kept,
      this.undoButton,
      this.redoButton,
      this.formatButton,
      this.examplesButton,
      h('span', { class: 'grow' }),
      this.#gpu,
      this.#plan,
      this.priceButton,
      this.recordedChoice,
      this.renderButton,
    );
    const tab = (/** @type {Tab} */ name, /** @type {string} */ label) => h('button', { type: 'button', 'aria-pressed': String(name === 'text'), 'data-tab': name, on: { click: () => studio.tab(name) } }, label);
    this.tabs = h('div', { class: 'tabs segments', role: 'group', 'aria-label': 'Below the picture' }, tab('text', 'Text'), tab('examples', 'Examples'), tab('price', 'Price'));
    this.showRights();
  }

  /** Shows what the caller may do. */
  showRights() {
    this.renderButton.hidden = !session.maySubmit;
    this.recordedChoice.hidden = !session.maySubmit;
    this.priceButton.hidden = !session.mayPreview;
  }

  /** Shows what is open. */
  showTab() {
    const { studio } = this;
    for (const button of this.tabs.querySelectorAll('button')) button.setAttribute('aria-pressed', String(button.dataset['tab'] === studio.shownTab));
    this.examplesButton.setAttribute('aria-pressed', String(studio.examples.isOpen));
    this.priceButton.setAttribute('aria-pressed', String(studio.price.isOpen));
  }

  showHistory() {
    this.undoButton.disabled = !this.studio.editor.canUndo;
    this.redoButton.disabled = !this.studio.editor.canRedo;
  }

  showDraft() {
    const { drafts } = this.studio;
    setText(this.#name, shortened(drafts.current.name));
    const { problem } = drafts;
    setText(this.#kept, problem === null ? '' : 'Not kept');
    this.#kept.title = problem ?? '';
    this.#kept.classList.toggle('problem', problem !== null);
    this.showHistory();
  }

  /**
   * Shows the time that the job takes, in short.
   * @param {Result | null} result
   */
  showPlan(result) {
    const plan = result?.plan ?? null;
    if (plan === null) {
      setText(this.#plan, result?.state === 'invalid' ? 'has errors' : '');
      this.#plan.title = '';
      return;
    }
    const { estimate } = plan;
    const seconds = estimate?.seconds ?? null;
    const time = estimate === null ? '' : seconds === null ? `${duration(estimate.core_seconds)} of one core` : `about ${duration(seconds)}`;
    const frames = plan.frames > 1 ? counted(plan.frames, 'frame') : '';
    setText(this.#plan, [time, frames].filter((part) => part !== '').join(' · '));
    this.#plan.title = [`${short(plan.rays)} rays in ${counted(plan.tiles, 'tile')}`, estimate === null ? '' : `${duration(estimate.core_seconds)} of one core, ${size(estimate.memory_bytes)} of memory`].filter((part) => part !== '').join('; ');
  }

  /** @param {import('./approximate.js').Approximate} approximate */
  showApproximate(approximate) {
    const { reason } = approximate;
    setText(this.#gpu, reason === null || reason === 'starting' ? '' : 'exact previews only');
    this.#gpu.title = reason === null ? '' : `While something is dragged, small exact previews are shown: ${reason}`;
  }

  /** @param {boolean} isRendering */
  setRendering(isRendering) {
    this.renderButton.disabled = isRendering;
  }

  async #openDrafts() {
    const { studio } = this;
    const drafts = await studio.drafts.list();
    openMenu(this.draftButton, [
      { label: 'New draft from a scene…', icon: 'plus', run: () => studio.tab('examples') },
      { label: 'Empty draft', icon: 'edit', run: () => studio.openText('{}\n') },
      { label: 'Open a file…', icon: 'up', run: () => openFile(studio) },
      { label: 'Save as a file', icon: 'download', run: () => saveFile(studio) },
      { label: 'Delete this draft…', icon: 'trash', isDanger: true, run: () => void this.#delete() },
      null,
      ...drafts.slice(0, MOST_DRAFTS).map((draft) => ({
        label: `${shortened(draft.name)} · ${ago(draft.updatedAt)}, ${size(draft.size)}`,
        checked: draft.id === studio.drafts.current.id,
        run: () => void studio.openDraft(draft.id),
      })),
    ]);
  }

  async #delete() {
    const { studio } = this;
    const { id, name } = studio.drafts.current;
    const isSure = await confirm({ title: `Delete the draft “${shortened(name)}”?`, body: ['It is kept nowhere but in this browser, and cannot be brought back.'], action: 'Delete' });
    if (!isSure) return;
    const [next] = (await studio.drafts.list()).filter((draft) => draft.id !== id);
    await studio.drafts.delete(id);
    if (next === undefined) studio.openText('{}\n');
    else await studio.openDraft(next.id);
  }
}
