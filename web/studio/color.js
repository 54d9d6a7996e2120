// Colors of a job file: linear light in lists, sRGB in texts, and what a color field of the browser shows of them.

/** @typedef {import('./json.js').JsonNode} JsonNode */
/** @typedef {[number, number, number]} Rgb */

/** Longest text that can be a color. */
const LONGEST_CHARS = 200;

/**
 * sRGB of linear light, 0 to 1 (IEC 61966-2-1).
 * @param {number} light
 */
export const encode = (light) => (light <= 0.003_130_8 ? light * 12.92 : 1.055 * light ** (1 / 2.4) - 0.055);

/**
 * Linear light of sRGB, 0 to 1.
 * @param {number} value
 */
export const decode = (value) => (value <= 0.040_45 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);

/**
 * `#rrggbb` of linear light; light above 1 keeps its hue, by the factor that is returned with it.
 * @param {Rgb} linear
 * @returns {{hex: string, strength: number}}
 */
export function hexOf(linear) {
  const strength = Math.max(1, ...linear);
  const bytes = linear.map((light) => Math.round(255 * encode(Math.min(1, Math.max(0, light / strength)))));
  return { hex: `#${bytes.map((byte) => byte.toString(16).padStart(2, '0')).join('')}`, strength };
}

/**
 * Linear light of `#rrggbb`.
 * @param {string} hex
 * @returns {Rgb}
 */
export function linearOf(hex) {
  const byte = (/** @type {number} */ at) => decode(Number.parseInt(hex.slice(at, at + 2), 16) / 255);
  return [byte(1), byte(3), byte(5)];
}

/**
 * The sRGB text of a job file as linear light: `#rgb`, `#rrggbb`, `rgb(255, 128, 0)`, in percent too.
 * @param {string} text
 * @returns {Rgb | undefined}
 */
export function parseText(text) {
  if (text.length > LONGEST_CHARS) return undefined;
  const hex = /^#([0-9a-f]{3}|[0-9a-f]{6})$/i.exec(text.trim())?.[1];
  if (hex !== undefined) return linearOf(`#${hex.length === 3 ? [...hex].map((digit) => digit + digit).join('') : hex}`);
  const parts = /^rgb\(\s*([\d.]+%?)\s*[, ]\s*([\d.]+%?)\s*[, ]\s*([\d.]+%?)\s*\)$/i.exec(text.trim())?.slice(1);
  if (parts === undefined) return undefined;
  const [red, green, blue] = parts.map((part) => decode(Math.min(1, Number.parseFloat(part) / (part.endsWith('%') ? 100 : 255))));
  return red === undefined || green === undefined || blue === undefined || [red, green, blue].some(Number.isNaN) ? undefined : [red, green, blue];
}

/**
 * The color of a black body, its brightest channel 1: for a swatch only (Tanner Helland, "How to convert temperature to
 * RGB": <https://tannerhelland.com/2012/09/18/convert-temperature-rgb-algorithm-code.html>).
 * @param {number} kelvin
 * @returns {Rgb}
 */
export function blackBody(kelvin) {
  const t = kelvin / 100;
  const red = t <= 66 ? 255 : 329.698_727_446 * (t - 60) ** -0.133_204_759_2;
  const green = t <= 66 ? 99.470_802_586_1 * Math.log(t) - 161.119_568_166_1 : 288.122_169_528_3 * (t - 60) ** -0.075_514_849_2;
  const blue = t >= 66 ? 255 : t <= 19 ? 0 : 138.517_731_223_1 * Math.log(t - 10) - 305.044_792_730_7;
  const [r, g, b] = [red, green, blue].map((value) => decode(Math.min(255, Math.max(0, value)) / 255));
  return [r ?? 0, g ?? 0, b ?? 0];
}

/**
 * The color that a node of the text is, as linear light, and whether a color field can change it.
 * @param {JsonNode} node
 * @returns {{linear: Rgb, isEditable: boolean} | undefined}
 */
export function colorOf(node) {
  if (node.kind === 'text') {
    const linear = parseText(String(node.value));
    return linear && { linear, isEditable: node.isClosed };
  }
  if (node.kind === 'list' && node.children.length === 3 && node.children.every((item) => item.kind === 'number')) {
    const [red, green, blue] = node.children.map((item) => Number(item.value));
    return { linear: [red ?? 0, green ?? 0, blue ?? 0], isEditable: node.isClosed };
  }
  const kelvin = node.kind === 'object' && node.children.length === 1 ? node.children[0] : undefined;
  if (kelvin?.key === 'kelvin' && kelvin.kind === 'number') return { linear: blackBody(Number(kelvin.value)), isEditable: false };
  return undefined;
}

/**
 * The text of a color in the notation of the text that it replaces: a list stays a list, and keeps a strength above 1.
 * @param {string} hex
 * @param {JsonNode} before
 */
export function writtenLike(hex, before) {
  if (before.kind === 'text') return JSON.stringify(hex);
  const strength = Math.max(1, ...before.children.map((item) => Number(item.value)));
  return `[${linearOf(hex).map((light) => Number((light * strength).toPrecision(3))).join(', ')}]`;
}
