// Writes numbers, times and sizes for people.

const COUNT = new Intl.NumberFormat('en', { maximumFractionDigits: 0 });

/** @param {number} value */
export const count = (value) => COUNT.format(value);

/**
 * A count with its noun: `1 job`, `3 jobs`.
 * @param {number} value
 * @param {string} noun
 * @param {string} [plural]
 */
export function counted(value, noun, plural = `${noun}s`) {
  return `${COUNT.format(value)} ${value === 1 ? noun : plural}`;
}

/**
 * Size of bytes: `3.4 MB`.
 * @param {number} bytes
 */
export function size(bytes) {
  const units = ['B', 'kB', 'MB', 'GB', 'TB', 'PB'];
  let value = bytes;
  let unit = 0;
  while (value >= 999.5 && unit < units.length - 1) {
    value /= 1000;
    unit += 1;
  }
  return `${unit === 0 || value >= 99.5 ? value.toFixed(0) : value.toFixed(1)} ${units[unit]}`;
}

/**
 * A large number with a prefix: `12.3 M`.
 * @param {number} value
 */
export function short(value) {
  const units = ['', ' k', ' M', ' G', ' T'];
  let scaled = Math.abs(value);
  let unit = 0;
  while (scaled >= 999.5 && unit < units.length - 1) {
    scaled /= 1000;
    unit += 1;
  }
  const digits = unit === 0 ? (Number.isInteger(value) ? 0 : 1) : scaled >= 99.5 ? 0 : 1;
  return `${value < 0 ? '−' : ''}${scaled.toFixed(digits)}${units[unit]}`;
}

/**
 * Length of time: `350 ms`, `4.2 s`, `3 min 05 s`, `2 h 10 min`, `3 d 4 h`.
 * @param {number} seconds
 */
export function duration(seconds) {
  if (seconds < 0.9995) return `${Math.max(0, Math.round(seconds * 1000))} ms`;
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  const two = (/** @type {number} */ value) => String(value).padStart(2, '0');
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${two(whole % 60)} s`;
  const minutes = Math.round(seconds / 60);
  if (minutes < 1440) return `${Math.floor(minutes / 60)} h ${two(minutes % 60)} min`;
  const hours = Math.round(seconds / 3600);
  return `${Math.floor(hours / 24)} d ${hours % 24} h`;
}

/**
 * Time left, less precise than a duration, so that it does not flicker.
 * @param {number} seconds
 */
export function timeLeft(seconds) {
  if (seconds < 1) return '< 1 s';
  if (seconds < 60) return `${Math.round(seconds)} s`;
  if (seconds < 3600) return `${Math.round(seconds / 60)} min`;
  return duration(seconds);
}

/**
 * Time that has passed: `just now`, `5 min ago`, `yesterday`, `12 Mar`.
 * @param {string | number | Date} time
 * @param {number} [now]
 */
export function ago(time, now = Date.now()) {
  const then = new Date(time);
  const seconds = (now - then.getTime()) / 1000;
  if (Number.isNaN(seconds)) return '';
  if (seconds < 10) return 'just now';
  if (seconds < 60) return `${Math.floor(seconds)} s ago`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ago`;
  if (seconds < 86_400) return `${Math.floor(seconds / 3600)} h ago`;
  if (seconds < 2 * 86_400) return 'yesterday';
  if (seconds < 7 * 86_400) return `${Math.floor(seconds / 86_400)} d ago`;
  return then.toLocaleDateString('en', { day: 'numeric', month: 'short', year: seconds > 300 * 86_400 ? 'numeric' : undefined });
}

/**
 * Date and time, for titles and tables.
 * @param {string | number | Date} time
 */
export function dateTime(time) {
  const date = new Date(time);
  return Number.isNaN(date.getTime())
    ? ''
    : date.toLocaleString('en', { year: 'numeric', month: 'short', day: 'numeric', hour: '2-digit', minute: '2-digit', second: '2-digit', hour12: false });
}

/**
 * Clock time: `14:03:27`.
 * @param {string | number | Date} time
 * @param {boolean} [withSeconds]
 */
export function clock(time, withSeconds = true) {
  return new Date(time).toLocaleTimeString('en', { hour: '2-digit', minute: '2-digit', ...(withSeconds ? { second: '2-digit' } : {}), hour12: false });
}

/**
 * A fraction in percent, never rounded up to 100.
 * @param {number} fraction
 */
export const percent = (fraction) => `${Math.floor(fraction * 100)} %`;

/** Letters of a name that are shown: more than a valid name has. */
const SHOWN_LETTERS = 400;

/**
 * A name as it is shown: a job file may have names of megabytes, which take seconds to lay out also where they are not seen.
 * @param {string} name
 * @param {number} [letters] most that are shown
 */
export function shortened(name, letters = SHOWN_LETTERS) {
  if (name.length <= letters) return name;
  const last = name.charCodeAt(letters - 2);
  // A pair of code units is not cut in two.
  return `${name.slice(0, last >= 0xd800 && last < 0xdc00 ? letters - 2 : letters - 1)}…`;
}

/**
 * The last characters of an id, which are random.
 * @param {string} id
 */
export const shortId = (id) => id.slice(-8);
