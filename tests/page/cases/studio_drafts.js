// The studio’s drafts and files, what is left when the farm or the tab goes away, and accessibility.

import assert from 'node:assert/strict';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { checkAccessibility } from '../browser.js';
import { csg, cursorAfter, ownBrowser, ready, setText, settled, startFarm, studio, textOf, versionOf, stopFarm } from '../studio.js';

/** Folder of files to open. */
let files;
const folder = () => (files ??= mkdtempSync(join(tmpdir(), 'sdfarm-files-')));
export function after() {
  stopFarm();
  if (files) rmSync(files, { recursive: true });
}

export async function nothing_is_lost_on_a_reload_or_a_crash_and_drafts_are_kept_side_by_side() {
  // A browser of its own, because a crash may end it.
  const own = await ownBrowser();
  try {
    const { address } = await startFarm();
    const page = await (await own.newContext()).newPage();
    await page.goto(`${address}/#/studio`);
    await ready(page, csg);
    await cursorAfter(page, '"name": "csg');
    await page.keyboard.type('-kept');
    await page.reload();
    await page.waitForFunction(() => document.querySelector('room-studio')?.studio?.editor.text.includes('csg-kept'));
    await setText(page, csg);
    await cursorAfter(page, '"name": "csg');
    await page.keyboard.type('-crash');
    await page.waitForTimeout(30);
    const second = await page.context().newPage();
    await page.goto('chrome://crash').catch(() => {});
    await second.goto(`${address}/#/studio`);
    await second.waitForFunction(() => document.querySelector('room-studio')?.studio?.editor.text.includes('csg-crash'));
    await second.locator('.draft').click();
    await second.waitForSelector('.menu [role="menuitemcheckbox"]');
    const names = await second.locator('.menu [role="menuitemcheckbox"]').allTextContents();
    assert.ok(['csg-crash', 'csg-kept'].every((part) => names.some((name) => name.startsWith(`${part} `))), `${names}`);
    await second.keyboard.press('Escape');
  } finally {
    await own.close();
  }
}

export async function two_tabs_with_the_same_draft_do_not_overwrite_each_other() {
  const first = await studio();
  await first.waitForTimeout(500);
  const second = await first.context().newPage();
  await second.goto(`${(await startFarm()).address}/#/studio`);
  await second.waitForFunction(() => document.querySelector('room-studio')?.studio?.editor.text.includes('csg'));
  await cursorAfter(first, '"name": "csg');
  await first.keyboard.type('-first');
  await first.waitForTimeout(600);
  await cursorAfter(second, '"name": "csg');
  await second.keyboard.type('-second');
  await second.waitForTimeout(600);
  const drafts = await second.evaluate(async () => (await document.querySelector('room-studio').studio.drafts.list()).map((draft) => draft.name));
  assert.ok(drafts.some((name) => name.includes('-first')) && drafts.some((name) => name.includes('-second')), `${drafts}`);
}

export async function a_browser_without_room_says_so_and_warns_before_the_page_is_left() {
  const page = await studio({
    init: () => {
      const fail = () => {
        throw new DOMException('no room', 'QuotaExceededError');
      };
      Object.defineProperty(IDBObjectStore.prototype, 'put', { value: fail });
      Storage.prototype.setItem = fail;
    },
  });
  await cursorAfter(page, '"name": "csg');
  await page.keyboard.type('x');
  await page.waitForSelector('.kept.problem');
  assert.equal(await page.locator('.kept').textContent(), 'Not kept');
  page.removeAllListeners('dialog');
  const asked = new Promise((resolve) => page.on('dialog', (dialog) => (resolve(dialog.type()), void dialog.dismiss())));
  await page.evaluate(() => location.reload());
  assert.equal(await asked, 'beforeunload');
  // An empty draft may be left.
  await page.evaluate(() => (document.querySelector('room-studio').studio.drafts.current.text = ''));
}

export async function files_are_opened_and_saved_broken_binary_and_too_large_ones_are_told() {
  const page = await studio();
  const open = async (name, content) => {
    const path = join(folder(), name);
    writeFileSync(path, content);
    const [chooser] = await Promise.all([page.waitForEvent('filechooser'), page.keyboard.press('Control+o')]);
    await chooser.setFiles(path);
  };
  await page.locator('.cm-content').focus();
  await open('broken.json', '{"name": "broken", "scene": {');
  await page.waitForFunction(() => document.querySelector('room-studio').studio.editor.text.includes('broken'));
  await page.waitForSelector('.fault-count.has-errors');
  await page.locator('.cm-content').focus();
  await open('picture.json', Buffer.from([0x89, 0x50, 0xff, 0, 1, 2]));
  await page.waitForSelector('.toast.error');
  assert.match(await page.locator('.toast.error').last().textContent(), /not a text in UTF-8/);
  await open('huge.json', Buffer.alloc((32 << 20) + 1, 32));
  await page.waitForFunction(() => /up to 32 MiB/.test(document.getElementById('toasts').textContent));
  await setText(page, csg.replace('"csg"', '"a/b: <c>"'));
  const [download] = await Promise.all([page.waitForEvent('download'), page.keyboard.press('Control+s')]);
  assert.equal(download.suggestedFilename(), 'a-b- -c.json');
  assert.equal(readFileSync(await download.path(), 'utf8'), await textOf(page));
}

export async function a_file_of_32_mib_is_opened_edited_and_checked() {
  const page = await studio();
  const object = '{ "shape": { "translate": { "by": [1.25, 0, 0], "child": { "sphere": { "radius": 0.5 } } } } },\n';
  const head = csg.slice(0, csg.indexOf('"objects": [') + '"objects": ['.length);
  const count = Math.floor(((32 << 20) - csg.length - 10) / object.length);
  writeFileSync(join(folder(), 'large.json'), head + object.repeat(count) + csg.slice(head.length));
  const begin = Date.now();
  const [chooser] = await Promise.all([page.waitForEvent('filechooser'), page.keyboard.press('Control+o')]);
  await chooser.setFiles(join(folder(), 'large.json'));
  await page.waitForFunction(() => document.querySelector('room-studio').studio.editor.doc.length > 30e6, null, { timeout: 60_000 });
  console.log(`opened in ${Date.now() - begin} ms`);
  await page.evaluate(() => document.querySelector('room-studio').studio.editor.show(3, { focus: true }));
  const times = [];
  for (let key = 0; key < 5; key += 1) {
    const start = Date.now();
    await page.keyboard.press('Space');
    await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(resolve)));
    times.push(Date.now() - start);
  }
  console.log(`keystrokes in a file of 32 MiB: ${times} ms`);
  assert.ok(times.sort((a, b) => a - b)[2] < 1500, `${times}`);
}

export async function edits_go_on_while_the_farm_does_not_answer_and_the_picture_resumes() {
  const page = await studio({ expected: [/ERR_/] });
  await settled(page);
  await page.context().setOffline(true);
  await cursorAfter(page, '"fov": 58');
  await page.keyboard.press('Backspace');
  await page.keyboard.type('0');
  assert.match(await textOf(page), /"fov": 50\.1/);
  await page.waitForFunction(() => document.querySelector('.badge').textContent === 'Not live');
  const version = await versionOf(page);
  await page.context().setOffline(false);
  await page.waitForFunction((old) => Number(document.querySelector('.stage').dataset.version) > old, version, { timeout: 20_000 });
  await settled(page);
  await page.waitForSelector('.fault-count.valid', { timeout: 20_000 });
}

async function accessible(theme) {
  const page = await studio({ text: csg.replace('"name"', '"frames": { "count": 8 }, "name"'), theme });
  await settled(page);
  await page.getByRole('button', { name: 'Examples' }).first().click();
  await page.waitForSelector('.kind-item');
  await page.getByRole('button', { name: 'Price', exact: true }).first().click();
  await page.waitForSelector('.price-panel .facts');
  await checkAccessibility(page, `the studio with all of its panels, ${theme}`);
  await page.getByRole('button', { name: 'Close the price' }).click();
  await page.evaluate(() => {
    const { editor } = document.querySelector('room-studio').studio;
    editor.show(editor.text.indexOf('"camera": {') + 11, { focus: true });
  });
  await page.keyboard.type(' "x');
  await page.waitForSelector('.fault-count.has-errors');
  await page.setViewportSize({ width: 390, height: 844 });
  await checkAccessibility(page, `the studio with an error on a phone, ${theme}`);
}

export const nothing_serious_is_found_by_axe_in_the_light = () => accessible('light');
export const nothing_serious_is_found_by_axe_in_the_dark = () => accessible('dark');

export async function the_studio_is_left_and_entered_again_without_a_trace() {
  const page = await studio();
  await cursorAfter(page, '"name": "csg');
  await page.keyboard.type('-left');
  await page.evaluate(() => (location.hash = '#/help'));
  await page.waitForSelector('room-help');
  assert.equal(await page.locator('.cm-editor').count(), 0);
  await page.evaluate(() => (location.hash = '#/studio'));
  await page.waitForFunction(() => document.querySelector('room-studio')?.studio?.editor.text.includes('csg-left'));
}
