// The room Help: first steps, the language of job files with pictures, the API, shortcuts.

import { Problem, getJson, messageOf, request } from '/ui/api.js';
import { append, h, setText } from '/ui/parts/dom.js';
import { documentation } from '/ui/parts/documentation.js';
import { icon } from '/ui/parts/icons.js';
import { Room, heading } from '/ui/parts/room.js';
import { addShortcuts, keyCaps } from '/ui/parts/shortcuts.js';
import { session } from '/ui/session.js';
import { compact } from '/ui/rooms/help/example.js';
import { submitJob } from '/ui/rooms/jobs/submit.js';

/** @typedef {import('/ui/types.js').Kind} Kind */
/** @typedef {import('/ui/types.js').KindKey} KindKey */

/** Families, those that are looked for most first, and their titles. */
/** @type {[string, string][]} */
const FAMILIES = [
  ['node', 'Shapes and operators'],
  ['profile', 'Profiles'],
  ['material', 'Materials'],
  ['texture', 'Textures'],
  ['light', 'Lights'],
  ['background', 'Backgrounds'],
  ['projection', 'Projections'],
  ['effect', 'Effects'],
  ['document', 'Parts of a job file'],
];

/** Shortcuts of the other rooms, which add theirs only while they are open. */
/** @type {[string, [string, string][]][]} */
const SHORTCUTS = [
  ['Everywhere', [['g j', 'Jobs'], ['g s', 'Studio'], ['g f', 'Farm'], ['g h', 'Help'], ['t', 'Theme'], ['?', 'The shortcuts of the room']]],
  ['Jobs', [['/', 'Filter'], ['ArrowDown', 'Next job'], ['Enter', 'Open'], [' ', 'Select'], ['Shift+ArrowDown', 'Select several'], ['p', 'Pause'], ['u', 'Resume'], ['c', 'Cancel'], ['r', 'Retry'], ['y', 'Priority'], ['f', 'To the front of the queue'], ['m', 'Move in the queue'], ['Delete', 'Delete'], ['n', 'Submit a file']]],
  ['Job', [['k', 'Play'], [',', 'Previous frame'], ['.', 'Next frame'], ['l', 'Loop'], ['+', 'Zoom in'], ['-', 'Zoom out'], ['0', 'Fit'], ['1', 'One to one'], ['w', 'Compare'], ['e', 'Edit a copy'], ['d', 'Download']]],
  ['Farm', [['+', 'One more worker'], ['-', 'One fewer'], ['p', 'Pause the farm']]],
];

/** Pictures are loaded when they are this near. */
const PICTURE_MARGIN = '240px';

class HelpRoom extends Room {
  /** @type {Kind[]} */
  kinds = [];

  enter() {
    this.setTitle('Help');
    this.search = h('input', { type: 'search', placeholder: 'Search the job language', 'aria-label': 'Search the job language', class: 'filter', autocomplete: 'off', spellcheck: 'false' });
    this.search.addEventListener('input', () => this.#filter());
    this.contents = h('nav', { class: 'help-contents', 'aria-label': 'Contents' });
    this.language = h('div', { class: 'language' });
    this.found = h('p', { class: 'muted', role: 'status' });
    const version = session.caller?.version;
    append(this, [
      h('div', { class: 'room-head' }, heading('Help'), h('span', { class: 'muted' }, version ? `sdfarm ${version}` : ''), this.search),
      h(
        'div',
        { class: 'help-columns' },
        this.contents,
        h('div', { class: 'help-body' }, this.#firstSteps(), h('section', { class: 'panel', id: 'help-language' }, h('div', { class: 'panel-head' }, h('h2', {}, 'The job language'), this.found), this.language), this.#api(), this.#shortcuts()),
      ),
    ]);
    this.listen(this.contents, 'click', (event) => this.#follow(event));
    addShortcuts([{ keys: '/', text: 'Search the job language', group: 'Help', run: () => this.search?.focus() }], this.signal);
    this.pictures = new IntersectionObserver((entries) => this.#load(entries), { rootMargin: PICTURE_MARGIN });
    this.#showContents();
    void this.#read();
  }

  leave() {
    this.pictures?.disconnect();
  }

  /**
   * Loads the pictures that are seen, or nearly: a browser's own lazy loading begins thousands of pixels before.
   * @param {IntersectionObserverEntry[]} entries
   */
  #load(entries) {
    for (const { target, isIntersecting } of entries) {
      if (!isIntersecting || !(target instanceof HTMLImageElement)) continue;
      target.src = target.dataset['source'] ?? '';
      this.pictures?.unobserve(target);
    }
  }

  #firstSteps() {
    const step = (/** @type {string} */ title, /** @type {import('/ui/parts/dom.js').Child[]} */ ...body) => h('li', {}, h('h3', {}, title), ...body.filter((child) => child instanceof Node));
    return h(
      'section',
      { class: 'panel', id: 'help-first' },
      h('div', { class: 'panel-head' }, h('h2', {}, 'First steps')),
      h(
        'ol',
        { class: 'steps' },
        step('Look at a scene', h('p', {}, 'The ', h('a', { href: '#/studio' }, 'studio'), ' has the scenes that come with sdfarm, and examples of every shape. The picture beside the text follows what you write.')),
        step('Write a job', h('p', {}, 'A job file is JSON: what the scene has, and how large the picture is. This is a whole one:'), this.#firstJob()),
        step('Submit it', h('p', {}, 'Press Render in the studio, drop a file on the room ', h('a', { href: '#/jobs' }, 'Jobs'), ', or use the command line:'), h('pre', { class: 'example' }, h('code', {}, `sdfarm submit job.json --wait -o picture.png --server ${location.origin}`))),
        step('Watch it grow', h('p', {}, 'The room of the job shows each tile when it is finished, who rendered it, and every frame of an animation.')),
        step('Render faster', h('p', {}, 'Each worker on another machine makes the farm faster, and none changes a picture by a bit:'), h('pre', { class: 'example' }, h('code', {}, `sdfarm worker --server ${location.origin}`))),
      ),
    );
  }

  /** The first job, which is a file, so that a test can check it. */
  #firstJob() {
    const code = h('code');
    const button = h('button', { type: 'button', class: 'button', hidden: true }, icon('play'), 'Render it');
    request('/ui/rooms/help/first.json', { signal: this.signal })
      .then((response) => response.text())
      .then((text) => {
        setText(code, text.trimEnd());
        button.hidden = !session.maySubmit;
        button.addEventListener('click', async () => {
          const job = await submitJob('first.json', text);
          if (job !== null) location.hash = `#/jobs/${job.id}`;
        });
      })
      .catch((error) => setText(code, messageOf(error)));
    return h('div', { class: 'first-job' }, h('pre', { class: 'example' }, code), button);
  }

  #api() {
    const link = (/** @type {string} */ href, /** @type {string} */ title, /** @type {string} */ text) => h('li', {}, h('a', { href }, title), ` – ${text}`);
    return h(
      'section',
      { class: 'panel', id: 'help-api' },
      h('div', { class: 'panel-head' }, h('h2', {}, 'The API')),
      h(
        'div',
        { class: 'panel-body prose' },
        h('p', {}, 'All that this page does, it does by the HTTP API, which is open to your programs. With keys, they send ', h('code', {}, 'Authorization: Bearer KEY'), '.'),
        h('ul', {}, link('/docs/', 'Reference', 'every route, to read and to try'), link('/openapi.json', 'OpenAPI 3.1', 'for generated clients'), link('/v1/schema/job', 'JSON Schema of a job file', 'for editors'), link('/readyz', 'Health', 'for balancers; metrics for Prometheus are at /metrics')),
      ),
    );
  }

  #shortcuts() {
    return h(
      'section',
      { class: 'panel', id: 'help-shortcuts' },
      h('div', { class: 'panel-head' }, h('h2', {}, 'Shortcuts')),
      h('div', { class: 'panel-body shortcut-grid' }, ...SHORTCUTS.map(([group, list]) => h('section', { class: 'shortcuts' }, h('h3', {}, group), h('dl', {}, ...list.flatMap(([keys, text]) => [h('dt', {}, keyCaps(keys)), h('dd', {}, text)]))))),
    );
  }

  async #read() {
    try {
      const table = await getJson('/v1/schema/nodes', { signal: this.signal, cache: 'default' });
      this.kinds = table.kinds;
      this.#filter();
      this.#showContents();
      const wanted = this.place.query.get('kind');
      if (wanted) this.#reveal(`kind-${wanted}`);
    } catch (error) {
      if (this.signal.aborted) return;
      const isAbsent = error instanceof Problem && error.isUnknownRoute;
      this.language?.replaceChildren(h('p', { class: 'empty-line' }, isAbsent ? 'This server does not describe the language to the page. ' : `${messageOf(error)} `, h('a', { href: '/v1/schema/job' }, 'The JSON Schema'), ' has all of it.'));
    }
  }

  #showContents() {
    const families = FAMILIES.filter(([family]) => this.kinds.some((kind) => kind.family === family));
    const link = (/** @type {string} */ id, /** @type {string} */ title, kind = '') => h('a', { href: '#/help', 'data-target': id, class: kind }, title);
    this.contents?.replaceChildren(link('help-first', 'First steps'), link('help-language', 'The job language'), ...families.map(([family, title]) => link(`family-${family}`, title, 'inner')), link('help-api', 'The API'), link('help-shortcuts', 'Shortcuts'));
  }

  /** @param {MouseEvent} event */
  #follow(event) {
    const target = event.target instanceof HTMLElement ? event.target.closest('a')?.dataset['target'] : undefined;
    if (!target) return;
    event.preventDefault();
    this.#reveal(target);
  }

  /** @param {string} id */
  #reveal(id) {
    const section = document.getElementById(id);
    if (!section) return;
    section.tabIndex = -1;
    section.scrollIntoView({ block: 'start', behavior: 'smooth' });
    section.focus({ preventScroll: true });
  }

  #filter() {
    const words = (this.search?.value ?? '').trim().toLowerCase().split(/\s+/).filter(Boolean);
    const fits = (/** @type {Kind} */ kind) => {
      const text = `${kind.name} ${kind.title} ${kind.family} ${kind.documentation} ${kind.keys.map((key) => key.name).join(' ')}`.toLowerCase();
      return words.every((word) => text.includes(word));
    };
    const rank = (/** @type {Kind} */ kind) => (words.length > 0 && words.every((word) => kind.name.includes(word)) ? 0 : 1);
    const kinds = this.kinds.filter(fits).sort((a, b) => rank(a) - rank(b));
    if (this.found) setText(this.found, words.length === 0 ? '' : `${kinds.length} of ${this.kinds.length}`);
    const groups = FAMILIES.map(([family, title]) => ({ family, title, kinds: kinds.filter((kind) => kind.family === family) })).filter((group) => group.kinds.length > 0);
    this.pictures?.disconnect();
    this.language?.replaceChildren(
      ...groups.map((group) => h('section', { class: 'family', id: `family-${group.family}` }, h('h3', {}, group.title, h('span', { class: 'muted' }, ` ${group.kinds.length}`)), h('div', { class: 'kinds' }, ...group.kinds.map((kind) => this.#kind(kind))))),
      kinds.length === 0 && this.kinds.length > 0 ? h('p', { class: 'empty-line' }, 'Nothing has these words.') : '',
    );
  }

  /** @param {Kind} kind */
  #kind(kind) {
    const picture = kind.picture === null ? null : h('img', { 'data-source': kind.picture, alt: '', width: 112, height: 84 });
    if (picture !== null) this.pictures?.observe(picture);
    const body = h('div', { class: 'kind-body' });
    const details = h('details', { class: 'kind', id: `kind-${kind.name}` }, h('summary', {}, picture, h('span', { class: 'kind-title' }, h('b', { class: 'mono' }, kind.name), h('span', { class: 'muted' }, kind.title.replaceAll('`', '')))), body);
    // Most are never opened.
    details.addEventListener('toggle', () => {
      if (!details.open || body.childElementCount > 0) return;
      append(body, [
        ...(kind.documentation.trim() === kind.title.trim() ? [] : documentation(kind.documentation)),
        kind.keys.length > 0 ? keyTable(kind.keys) : null,
        h('pre', { class: 'example' }, h('code', {}, compact(kind.example))),
      ]);
    });
    return details;
  }
}

/** @param {KindKey[]} keys */
function keyTable(keys) {
  return h(
    'div',
    { class: 'scroll-x' },
    h(
      'table',
      { class: 'keys-table' },
      h('thead', {}, h('tr', {}, ...['Key', 'Value', 'Default', 'Meaning'].map((title) => h('th', { scope: 'col' }, title)))),
      h('tbody', {}, ...keys.map((key) => h('tr', {}, h('td', { class: 'mono nowrap' }, key.name), h('td', { class: 'nowrap' }, key.kind, range(key)), h('td', { class: 'mono' }, key.required ? h('span', { class: 'muted' }, 'required') : key.default === null || key.default === undefined ? '' : compact(key.default)), h('td', {}, ...documentation(key.documentation))))),
    ),
  );
}

/** @param {KindKey} key */
function range(key) {
  const { minimum, maximum, unit } = key;
  const digits = (/** @type {unknown} */ value) => Number(value).toLocaleString('en', { maximumFractionDigits: 20 });
  const has = (/** @type {unknown} */ value) => value !== null && value !== undefined;
  const text = has(minimum) && has(maximum) ? `, ${digits(minimum)} to ${digits(maximum)}` : has(minimum) ? `, from ${digits(minimum)}` : has(maximum) ? `, to ${digits(maximum)}` : '';
  return h('span', { class: 'muted' }, `${text}${unit ? ` ${unit}` : ''}`);
}

customElements.define('room-help', HelpRoom);
