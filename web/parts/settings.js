// Choices of this browser that are kept: columns, order, what is folded.

/**
 * Reads a kept choice.
 * @template T
 * @param {string} name
 * @param {T} absent
 * @returns {T}
 */
export function readSetting(name, absent) {
  try {
    const text = localStorage.getItem(`sdfarm.${name}`);
    return text === null ? absent : JSON.parse(text);
  } catch {
    return absent;
  }
}

/**
 * Keeps a choice.
 * @param {string} name
 * @param {unknown} value
 */
export function keepSetting(name, value) {
  try {
    localStorage.setItem(`sdfarm.${name}`, JSON.stringify(value));
  } catch {
    // Storage is off or full: the choice lasts until the page is closed.
  }
}
