// Hostile texts in the studio: names of megabytes, and texts that take long to read. No task of the page may take long.

import assert from 'node:assert/strict';
import { checkTime, PHONE } from '../browser.js';
import { csg, stopFarm, studio } from '../studio.js';

export const after = stopFarm;

/** Most letters that are shown at one place: a name, and the words around it. */
const MOST_SHOWN = 600;
/** Time that a task of the page may take, in milliseconds, on an idle machine, also with a text of 30 MiB, and at most. */
const TASK_MS = 200;
const LARGE_TASK_MS = 500;
const MOST_TASK_MS = 2000;
/** The text that is kept, checked and shown as a whole takes longer than its names. */
const LARGE = 'a name of 30 MiB';

/**
 * Makes the hostile texts, in the page: it has no time to receive them. `places` are pieces of the text that the cursor is put behind.
 * @param {string} valid
 */
function hostileTexts(valid) {
  const job = JSON.parse(valid);
  const name = 'x'.repeat(1_900_000);
  const many = (count, make) => Object.fromEntries(Array.from({ length: count }, (_, index) => make(index)));
  const scene = (change) => JSON.stringify({ ...job, scene: { ...job.scene, ...change } }, null, 2);
  const [object, ...more] = job.scene.objects;
  const half = name.slice(0, 900_000);
  return {
    'the name of the job': { text: JSON.stringify({ ...job, name }, null, 2), places: ['"name": "x'] },
    'the name of an object': { text: scene({ objects: [{ ...object, name }, ...more] }), places: ['"shape": '] },
    'the key of a material, and its use': { text: scene({ materials: { ...job.scene.materials, [half]: { diffuse: { kd: '#123456' } } }, objects: [{ ...object, material: half }] }), places: ['"kd": ', '"shape": '] },
    'the name of a shape': { text: scene({ shapes: { [name]: object.shape } }), places: ['"shapes": {', 'xxx": {'] },
    'a kind': { text: scene({ objects: [{ shape: { [name]: { radius: 1.5 } } }] }), places: ['"radius": '] },
    'a key of the job': { text: JSON.stringify({ ...job, [name]: 1.5 }, null, 2), places: ['xxx": '] },
    'a name of escapes': { text: JSON.stringify({ ...job, name: '\n"'.repeat(400_000) }, null, 2), places: ['"name": "'] },
    'a name of words': { text: JSON.stringify({ ...job, name: 'ab cd-'.repeat(300_000) }, null, 2), places: ['"name": "ab'] },
    'a name that ends in many dots': { text: JSON.stringify({ ...job, name: `${'.'.repeat(1_900_000)}a` }, null, 2), places: ['"name": "'] },
    'colors below a long key': { text: scene({ materials: { [name]: { diffuse: many(1000, (index) => [`kd${index}`, '#123456']) } } }), places: ['"kd0": '] },
    'a color of spaces': { text: JSON.stringify({ ...job, name: '', color: `rgb(1${' '.repeat(1_900_000)}` }, null, 2), places: ['"color": "rgb'] },
    'many materials': { text: scene({ materials: many(100_000, (index) => [`m${index}`, {}]) }), places: ['"material": "', '"materials": {'] },
    'many names on a line': { text: JSON.stringify({ ...job, scene: { ...job.scene, materials: many(100_000, (index) => [`m${index}`, 1]) } }), places: ['"materials":{', '"m50000":'] },
    'brackets that close nothing': { text: `${'{"a":'.repeat(511)}{${']'.repeat(2_000_000)}`, places: ['{"a":', '{]'] },
    'colons': { text: `{${':'.repeat(2_000_000)}`, places: ['{:'] },
    'numbers on a line': { text: `{"scene":{"background":[${'0,'.repeat(900_000)}0]}}`, places: ['"background":[', '0]'] },
    'a name of 30 MiB': { text: JSON.stringify({ ...job, name: 'x'.repeat(30 << 20) }, null, 2), places: ['"name": "x'] },
  };
}

/** Opens a text and works in it; says how long the longest task took, and the longest text that is shown beside the editor's. */
async function workIn(page, name) {
  await page.evaluate((each) => {
    globalThis.longest = 0;
    document.querySelector('room-studio').studio.openText(globalThis.texts[each].text);
  }, name);
  await page.waitForSelector('.fault-count.has-errors, .fault-count.valid', { timeout: 60_000 });
  for (const place of await page.evaluate((each) => globalThis.texts[each].places, name)) {
    await page.evaluate((piece) => {
      const { editor } = document.querySelector('room-studio').studio;
      editor.show(editor.text.indexOf(piece) + piece.length, { focus: true });
    }, place);
    await page.keyboard.press('Control+Space');
    await page.waitForTimeout(100);
    await page.keyboard.press('Escape');
    await page.keyboard.press('Control+.');
    await page.keyboard.type('7');
    await page.waitForTimeout(100);
  }
  await page.locator('.draft').click();
  await page.waitForSelector('.menu');
  const shown = await page.evaluate(() => {
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT, (node) => (node.parentElement.closest('.cm-content') ? NodeFilter.FILTER_REJECT : NodeFilter.FILTER_ACCEPT));
    let most = 0;
    while (texts.nextNode()) most = Math.max(most, texts.currentNode.length);
    return most;
  });
  await page.keyboard.press('Escape');
  await page.keyboard.press('F8');
  await page.waitForTimeout(200);
  return { shown, longest: await page.evaluate(() => globalThis.longest) };
}

/** Works in each of the texts. */
async function workInAll(page) {
  await page.evaluate(() => {
    globalThis.longest = 0;
    new PerformanceObserver((list) => {
      for (const { duration } of list.getEntries()) globalThis.longest = Math.max(globalThis.longest, duration);
    }).observe({ type: 'longtask' });
  });
  await page.evaluate(`globalThis.texts = (${hostileTexts})(${JSON.stringify(csg)})`);
  for (const name of await page.evaluate(() => Object.keys(globalThis.texts))) {
    const { shown, longest } = await workIn(page, name);
    assert.ok(shown <= MOST_SHOWN, `${name}: ${shown} letters are shown at one place`);
    assert.ok(longest <= MOST_TASK_MS, `${name}: a task of the page took ${longest} ms`);
    checkTime(longest <= (name === LARGE ? LARGE_TASK_MS : TASK_MS), `${name}: a task of the page took ${longest} ms`);
  }
}

export async function names_of_megabytes_are_cut_and_do_not_hold_the_page_up() {
  await workInAll(await studio());
}

export async function names_of_megabytes_do_not_hold_a_phone_up() {
  await workInAll(await studio({ size: PHONE }));
}
