// The studio in the browser: pages with a text in the editor, and what the cases ask of them.

import { createRequire } from 'node:module';
import { readFileSync } from 'node:fs';
import { resolve } from 'node:path';
import { DESKTOP, open } from './browser.js';
import { Farm } from './farm.js';

export const csg = readFileSync('scenes/csg.json', 'utf8');
export const turntable = readFileSync('scenes/turntable.json', 'utf8');

const TIMEOUT_MS = 15_000;
/** Messages of the browser about answers that the studio expects while a text is not valid, of a long layout, and of a GPU that starts while the page is left. */
const EXPECTED = [/status of (400|422)/, /Measure loop restarted/, /valid external Instance reference no longer exists/];

let farm;
/** The farm of the studio's cases. */
export const startFarm = async () => (farm ??= await Farm.start());
/** Ends it. */
export function stopFarm() {
  farm?.stop();
  farm = undefined;
}

/**
 * Opens the studio with a text; null is what a first visit has.
 */
export async function studio({ text = csg, size = DESKTOP, theme = 'light', init, gpu = false, expected = [] } = {}) {
  const page = await open(await startFarm(), '#/studio', { size, theme, gpu, expected: [...EXPECTED, ...expected], ...(init ? { init } : {}) });
  await ready(page, text);
  return page;
}

/** Waits for the editor, and gives it a text. */
export async function ready(page, text) {
  page.setDefaultTimeout(TIMEOUT_MS);
  await page.waitForSelector('.cm-content');
  if (text === null) return;
  await page.waitForFunction(() => document.querySelector('.stage')?.dataset.version && document.querySelector('room-studio').studio.table);
  await setText(page, text);
}

/** A browser of its own, which may crash. */
export const ownBrowser = () =>
  createRequire(resolve('.tools/page/package.json'))('playwright-core').chromium.launch({ executablePath: process.env.SDFARM_BROWSER, args: ['--no-sandbox', '--disable-dev-shm-usage'] });

export const textOf = (page) => page.evaluate(() => document.querySelector('room-studio').studio.editor.text);
export const versionOf = (page) => page.evaluate(() => Number(document.querySelector('.stage').dataset.version ?? 0));
export const jobOf = async (page) => JSON.parse(await textOf(page));

/** Gives the editor a text, as opening a file does, and waits for its picture or its faults. */
export async function setText(page, text) {
  const version = await versionOf(page);
  await page.evaluate((each) => document.querySelector('room-studio').studio.openText(each), text);
  await page.waitForFunction((old) => Number(document.querySelector('.stage').dataset.version) > old || document.querySelector('.has-errors'), version);
}

/** Waits for the exact picture of what is in the editor. */
export async function settled(page) {
  await page.waitForFunction(() => document.querySelector('.badge.exact')?.textContent === 'Exact' && !document.querySelector('room-studio').studio.previewer.isBusy, null, { timeout: 60_000 });
}

/** Puts the cursor behind a piece of the text. */
export async function cursorAfter(page, piece) {
  await page.evaluate((each) => {
    const { editor } = document.querySelector('room-studio').studio;
    const at = editor.text.indexOf(each);
    if (at < 0) throw new Error(`not in the text: ${each}`);
    editor.show(at + each.length, { focus: true });
  }, piece);
}

/** The middle of the text of a piece, on the screen. */
export async function placeOf(page, piece, offset = 1) {
  await cursorAfter(page, piece);
  return page.evaluate(([each, more]) => {
    const { editor } = document.querySelector('room-studio').studio;
    const at = editor.text.indexOf(each) + each.length - more;
    const [start, end] = [editor.view.coordsAtPos(at, 1), editor.view.coordsAtPos(at + 1, -1)];
    return { x: (start.left + end.right) / 2, y: (start.top + start.bottom) / 2 };
  }, [piece, offset]);
}

/** The picture's rectangle. */
export const stageBox = (page) => page.locator('.stage').boundingBox();
