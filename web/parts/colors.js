// Colors of drawings on a canvas, which the stylesheet does not reach.

/** Hues that differ, also for people who see few colors, because their lightness alternates. */
const HUES = [262, 30, 150, 330, 200, 85, 300, 120];

/** Whether the page is dark now. */
export function isDark() {
  const chosen = document.documentElement.dataset['theme'];
  return chosen === 'dark' || (chosen !== 'light' && matchMedia('(prefers-color-scheme: dark)').matches);
}

/**
 * Color number `index` of a list of equals.
 * @param {number} index
 */
export function categoryColor(index) {
  const hue = HUES[index % HUES.length];
  const lightness = (isDark() ? 0.7 : 0.6) + (index % 2 === 0 ? 0 : 0.08);
  return `oklch(${lightness} 0.13 ${hue})`;
}

/**
 * A color of the stylesheet as it is now.
 * @param {Element} element
 * @param {string} name
 */
export function themeColor(element, name) {
  const probe = document.createElement('i');
  probe.style.color = `var(${name})`;
  probe.hidden = true;
  element.append(probe);
  const color = getComputedStyle(probe).color;
  probe.remove();
  return color;
}

/**
 * Prepares a canvas for drawing in CSS pixels; clears it.
 * @param {HTMLCanvasElement} canvas
 * @param {number} width
 * @param {number} height
 */
export function prepareCanvas(canvas, width, height) {
  const ratio = devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(width * ratio));
  canvas.height = Math.max(1, Math.round(height * ratio));
  canvas.style.width = `${width}px`;
  canvas.style.height = `${height}px`;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = '11px Inter, system-ui, sans-serif';
  return context;
}

/**
 * Round steps for an axis: about `wanted` marks up to `most`.
 * @param {number} most
 * @param {number} wanted
 */
export function niceStep(most, wanted) {
  const raw = Math.max(most / Math.max(1, wanted), 1e-9);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((each) => each * power >= raw) ?? 10;
  return step * power;
}

/**
 * Round steps of time, in seconds.
 * @param {number} seconds
 * @param {number} wanted
 */
export function niceTimeStep(seconds, wanted) {
  const raw = seconds / Math.max(1, wanted);
  if (raw < 1) return niceStep(seconds, wanted);
  return [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14_400, 43_200, 86_400].find((step) => step >= raw) ?? niceStep(seconds / 86_400, wanted) * 86_400;
}
