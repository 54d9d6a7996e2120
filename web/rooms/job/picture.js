// The picture of the room Job: which one is shown of a frame, its layers, its exposure, its values, and a comparison.

import { Problem, getBlob, getJson, isAbort, messageOf } from '/ui/api.js';
import { append, h, setText, whenQuiet } from '/ui/parts/dom.js';
import { showDialog } from '/ui/parts/dialog.js';
import { ago } from '/ui/parts/format.js';
import { icon } from '/ui/parts/icons.js';
import { showThumbnail, thumbnailPath } from '/ui/parts/thumbnails.js';
import { toastError } from '/ui/parts/toast.js';
import { Viewer } from '/ui/rooms/job/viewer.js';

/** @typedef {import('/ui/types.js').Job} Job */
/** @typedef {import('/ui/types.js').Frame} Frame */
/** @typedef {{layers: string[], width: number, height: number, format: string}} Layers */

/** Widest picture that the server draws. */
const WIDEST = 2048;
/** Widest preview of a frame that is being rendered. */
const LARGEST_PREVIEW = 1280;
/** Time between two previews of a frame that is being rendered. */
const PREVIEW_MS = 900;
const PROBE_MS = 90;
const EXPOSURE_MS = 160;
const CANDIDATES = 60;
/** Channels of color, in their order. */
const CHANNELS = ['R', 'G', 'B', 'A'];

/** Shows one frame of a job. Tells by `compare` that another job was chosen to compare with, or none. */
export class Picture extends EventTarget {
  #frame = 0;
  /** @type {Frame | null} */
  #view = null;
  /** @type {Layers | null} */
  #layers = null;
  #layer = 'color';
  #stops = 0;
  #loading = new AbortController();
  #lastPreview = 0;
  #timer = 0;
  /** The shown picture, so that it is not loaded twice. */
  #shown = '';
  #isSized = false;
  /** Whether a preview is on its way, and whether more has been rendered since it was requested. */
  #preview = { frame: -1, isStale: false };
  #hasPixels = true;
  /** @type {Job | null} */
  other = null;

  /**
   * @param {string} job
   * @param {AbortSignal} signal
   */
  constructor(job, signal) {
    super();
    this.job = job;
    this.signal = signal;
    this.viewer = new Viewer();
    this.layerSelect = h('select', { 'aria-label': 'Layer', on: { change: () => this.setLayer(this.layerSelect.value) } });
    this.layerLabel = h('label', { class: 'tool', hidden: true }, h('span', {}, 'Layer'), this.layerSelect);
    this.exposure = h('input', { type: 'range', min: -6, max: 6, step: 0.1, value: 0, 'aria-label': 'Exposure in stops' });
    this.exposureText = h('button', { type: 'button', class: 'link mono', title: 'No exposure', on: { click: () => this.setExposure(0) } }, '0.0');
    this.exposure.addEventListener('input', () => this.setExposure(Number(this.exposure.value)));
    this.compareButton = h('button', { type: 'button', class: 'button', title: 'Compare with another job (w)', on: { click: () => void this.compare() } }, icon('wipe'), h('span', {}, 'Compare'));
    this.tools = h('div', { class: 'viewer-tools' }, this.layerLabel, h('label', { class: 'tool' }, h('span', {}, 'Exposure'), this.exposure, this.exposureText), h('span', { class: 'grow' }), this.compareButton);
    const probe = whenQuiet(PROBE_MS, (/** @type {{x: number, y: number}} */ pixel) => void this.#readPixel(pixel));
    this.viewer.addEventListener('probe', (event) => {
      const pixel = /** @type {CustomEvent} */ (event).detail;
      this.#showPixel(pixel, null);
      if (pixel && this.#view?.state === 'stored' && this.#hasPixels) probe(pixel);
    });
    this.load = whenQuiet(EXPOSURE_MS, () => void this.#load());
    signal.addEventListener('abort', () => {
      this.#loading.abort();
      clearTimeout(this.#timer);
      this.viewer.observer.disconnect();
    });
  }

  /**
   * Sets the size of the job's pictures.
   * @param {number} width
   * @param {number} height
   */
  setSize(width, height) {
    this.#isSized = true;
    this.viewer.setSize(width, height);
  }

  /**
   * Shows a frame.
   * @param {number} number
   * @param {Frame | null} view
   */
  show(number, view) {
    const isOther = number !== this.#frame;
    const isStored = view?.state === 'stored';
    const key = `${number} ${view?.picture ?? ''}`;
    this.#frame = number;
    this.#view = view;
    if (isStored && this.#shown !== key) {
      this.#layers = null;
      void this.#readLayers(key);
    }
    if (isOther || isStored) void this.#load();
    else this.changed();
    if (isOther && this.other) void this.#loadOther();
  }

  /** More of the frame is rendered: its preview is loaded again, if that is not too soon. */
  changed() {
    if (this.#view?.state === 'stored') return;
    clearTimeout(this.#timer);
    const wait = Math.max(0, this.#lastPreview + PREVIEW_MS - performance.now());
    this.#timer = setTimeout(() => void this.#load(), wait);
  }

  /** @returns {{path: string, query: Record<string, string | number>, isWhole: boolean}} */
  #source() {
    const base = `/v1/jobs/${this.job}/frames/${this.#frame}`;
    const width = Math.min(WIDEST, Math.max(1, this.viewer.size.width));
    if (this.#view?.state !== 'stored') {
      // A preview is drawn beside what the farm renders: it is as large as it is seen, so that it comes soon.
      const seen = Math.min(width, LARGEST_PREVIEW, Math.ceil(this.viewer.surface.clientWidth * devicePixelRatio));
      return { path: `${base}/preview`, query: { width: Math.max(16, this.#isSized ? seen : LARGEST_PREVIEW) }, isWhole: false };
    }
    const isExr = this.#view.file?.endsWith('.exr') ?? false;
    if (this.#layers !== null && (isExr || this.#layer !== 'color')) {
      return { path: `${base}/layers/${this.#layer}`, query: { width, ...(isOfLight(this.#layer) && this.#stops !== 0 ? { exposure: this.#stops } : {}) }, isWhole: this.#layer !== 'color' || isExr };
    }
    return isExr ? { path: `${base}/thumbnail`, query: { width }, isWhole: false } : { path: `${base}/image`, query: {}, isWhole: false };
  }

  async #load() {
    const isStored = this.#view?.state === 'stored';
    if (!isStored && this.#preview.frame === this.#frame) {
      // A busy farm may take longer for a preview than until the next tile: what is on its way is shown first.
      this.#preview.isStale = true;
      return;
    }
    this.#loading.abort();
    const loading = new AbortController();
    this.#loading = loading;
    const preview = { frame: isStored ? -1 : this.#frame, isStale: false };
    this.#preview = preview;
    await this.#loadNow(loading, isStored);
    if (this.#preview !== preview) return;
    this.#preview = { frame: -1, isStale: false };
    if (preview.isStale) this.changed();
  }

  /**
   * @param {AbortController} loading
   * @param {boolean} isStored
   */
  async #loadNow(loading, isStored) {
    const key = `${this.#frame} ${this.#view?.picture ?? ''}`;
    const { path, query, isWhole } = this.#source();
    this.#lastPreview = performance.now();
    try {
      const blob = await getBlob(path, { query, signal: AbortSignal.any([loading.signal, this.signal]), ...(isStored ? { cache: /** @type {const} */ ('default') } : {}) });
      const bitmap = await createImageBitmap(blob);
      if (loading.signal.aborted) return;
      if (!this.#isSized) this.viewer.setSize(bitmap.width, bitmap.height);
      this.viewer.draw(bitmap);
      bitmap.close();
      this.#shown = isStored ? key : '';
      // The server has applied the exposure to a layer with more light than a PNG has.
      this.viewer.setExposure(isWhole ? 0 : this.#stops);
    } catch (error) {
      if (isAbort(error) || loading.signal.aborted || this.signal.aborted) return;
      if (error instanceof Problem && (error.status === 429 || error.status === 503)) {
        this.#timer = setTimeout(() => void this.#load(), (error.retryAfter ?? 2) * 1000);
        if (error.status === 429) return;
      }
      if (this.#shown === '') this.viewer.setMessage(messageOf(error));
    }
  }

  /** @param {string} key */
  async #readLayers(key) {
    try {
      const layers = /** @type {Layers} */ (await getJson(`/v1/jobs/${this.job}/frames/${this.#frame}/layers`, { signal: this.signal }));
      if (key !== `${this.#frame} ${this.#view?.picture ?? ''}`) return;
      this.#layers = layers;
      this.setSize(layers.width, layers.height);
    } catch (error) {
      // Without the route, the picture is shown as it is.
      if (this.signal.aborted) return;
      if (!(error instanceof Problem)) throw error;
    }
    const layers = this.#layers?.layers ?? [];
    this.layerLabel.hidden = layers.length < 2;
    this.layerSelect.replaceChildren(...layers.map((name) => h('option', { value: name, selected: name === this.#layer }, name)));
    if (!layers.includes(this.#layer)) this.#layer = 'color';
    const isExr = this.#view?.file?.endsWith('.exr') ?? false;
    if (isExr || this.#layer !== 'color') void this.#load();
  }

  /** @param {string} layer */
  setLayer(layer) {
    this.#layer = layer;
    this.exposure.disabled = !isOfLight(layer);
    void this.#load();
  }

  /** @param {number} stops */
  setExposure(stops) {
    this.#stops = stops;
    this.exposure.value = String(stops);
    setText(this.exposureText, `${stops > 0 ? '+' : stops < 0 ? '−' : ''}${Math.abs(stops).toFixed(1)}`);
    if (this.#source().isWhole) this.load();
    else this.viewer.setExposure(stops);
  }

  /**
   * @param {{x: number, y: number} | null} pixel
   * @param {Record<string, number | null> | null} values By channel; null is infinite.
   */
  #showPixel(pixel, values) {
    const { values: output } = this.viewer;
    const color = pixel === null ? null : this.viewer.colorAt(pixel.x, pixel.y);
    if (pixel === null || color === null) {
      output.replaceChildren();
      return;
    }
    const [red = 0, green = 0, blue = 0, alpha = 255] = color;
    const swatch = h('i', { class: 'swatch', css: { background: `rgb(${red} ${green} ${blue} / ${alpha / 255})` } });
    const text =
      values === null
        ? [red, green, blue].join(' ')
        : inOrder(Object.keys(values)).map((name) => `${name} ${written(values[name] ?? null)}`).join('  ');
    output.replaceChildren();
    append(output, [h('span', { class: 'mono' }, `${pixel.x}, ${pixel.y}`), swatch, h('span', { class: 'mono' }, text)]);
  }

  /** @param {{x: number, y: number}} pixel */
  async #readPixel(pixel) {
    try {
      const { values } = await getJson(`/v1/jobs/${this.job}/frames/${this.#frame}/pixel`, { query: pixel, signal: this.signal });
      this.#showPixel(pixel, values);
    } catch (error) {
      if (error instanceof Problem && error.status === 404) this.#hasPixels = false;
    }
  }

  /** Lets another job be chosen, or ends the comparison. */
  async compare() {
    if (this.other) {
      this.setOther(null);
      return;
    }
    try {
      const page = /** @type {import('/ui/types.js').JobPage} */ (await getJson('/v1/jobs', { query: { limit: CANDIDATES }, signal: this.signal }));
      const jobs = page.jobs.filter((job) => job.id !== this.job && job.progress > 0);
      const chosen = await showDialog({
        title: 'Compare with',
        body: jobs.length === 0 ? ['No other job has a picture.'] : [h('div', { class: 'candidates' }, ...jobs.map(candidate))],
        wide: true,
      });
      const other = jobs.find((job) => job.id === chosen);
      if (other) this.setOther(other);
    } catch (error) {
      toastError('The jobs could not be read', error);
    }
  }

  /**
   * Compares with a job, or with none.
   * @param {Job | null} job
   */
  setOther(job) {
    this.other = job;
    this.compareButton.setAttribute('aria-pressed', String(job !== null));
    setText(/** @type {Element} */ (this.compareButton.querySelector('span')), job === null ? 'Compare' : `Right: ${job.name}`);
    this.dispatchEvent(new Event('compare'));
    if (job === null) this.viewer.drawOther(null);
    else void this.#loadOther();
  }

  async #loadOther() {
    const { other } = this;
    if (other === null) return;
    const frame = Math.min(this.#frame, other.frames.total - 1);
    try {
      const blob = await getBlob(`/v1/jobs/${other.id}/frames/${frame}/preview`, { query: { width: WIDEST }, signal: this.signal });
      const bitmap = await createImageBitmap(blob);
      if (this.other === other) this.viewer.drawOther(bitmap);
      bitmap.close();
    } catch (error) {
      if (this.signal.aborted) return;
      toastError(`${other.name} could not be shown`, error);
      this.setOther(null);
    }
  }
}

/** @param {Job} job */
function candidate(job) {
  const picture = h('span', { class: 'picture' });
  showThumbnail(picture, thumbnailPath(job));
  return h('button', { type: 'submit', value: job.id, class: 'candidate' }, picture, h('span', { class: 'ellipsis' }, job.name), h('span', { class: 'muted small' }, ago(job.created_at)));
}

/**
 * Whether a layer has colors of light, which an exposure brightens.
 * @param {string} layer
 */
function isOfLight(layer) {
  return layer === 'color' || layer === 'noisy' || layer.startsWith('light.');
}

/**
 * Channels as people name them: red, green, blue, alpha, and then the layers.
 * @param {string[]} names
 */
function inOrder(names) {
  const place = (/** @type {string} */ name) => CHANNELS.indexOf(name) + 1 || CHANNELS.length + 1;
  return names.sort((a, b) => place(a) - place(b) || (a < b ? -1 : 1));
}

/** @param {number | null} value */
function written(value) {
  if (value === null) return '∞';
  if (Number.isInteger(value) && Math.abs(value) < 1e6) return String(value);
  const size = Math.abs(value);
  return size >= 1e5 || (size > 0 && size < 1e-3) ? value.toExponential(2) : value.toPrecision(4);
}
