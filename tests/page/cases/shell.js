// The shell: rooms by address, titles, focus, shortcuts, themes, and how fast and small the first page is.

import assert from 'node:assert/strict';
import { DESKTOP, PHONE, checkAccessibility, checkTime, checkWidth, inRoom, open } from '../browser.js';
import { Farm, smallJob, until } from '../farm.js';

const ROOMS = [['jobs', 'Jobs'], ['farm', 'Farm'], ['help', 'Help']];
const FIRST_PAINT_MS = 100;
const PAINTS = 8;
const FIRST_LOAD_BYTES = 200 * 1024;

let farm;
const start = async () => (farm ??= await Farm.start());
export const after = () => farm?.stop();

export async function every_room_has_an_address_a_title_and_the_focus_on_its_heading() {
  await start();
  const page = await open(farm);
  await inRoom(page, 'Jobs');
  assert.equal(await page.title(), 'Jobs – sdfarm');
  for (const [name, title] of [...ROOMS.slice(1), ROOMS[0]]) {
    await page.getByRole('navigation', { name: 'Rooms' }).getByRole('link', { name: title }).click();
    await inRoom(page, title);
    assert.equal(new URL(page.url()).hash, `#/${name}`);
    assert.equal(await page.title(), `${title} – sdfarm`);
    assert.equal(await page.evaluate(() => document.activeElement?.tagName), 'H1', `the heading of ${title} has the focus`);
    assert.equal(await page.locator('[aria-current=page]').textContent(), title);
  }
  await page.goBack();
  await inRoom(page, 'Help');
  await page.goto(`${farm.address}/#/nowhere`);
  await inRoom(page, 'Jobs');
}

export async function keys_lead_to_rooms_and_list_the_shortcuts() {
  await start();
  const page = await open(farm);
  await inRoom(page, 'Jobs');
  for (const [letter, title] of [['f', 'Farm'], ['h', 'Help'], ['j', 'Jobs']]) {
    await page.keyboard.press('g');
    await page.keyboard.press(letter);
    await inRoom(page, title);
  }
  await page.keyboard.press('?');
  const dialog = page.getByRole('dialog', { name: 'Keyboard shortcuts' });
  await dialog.waitFor();
  assert.match(await dialog.textContent(), /Go to the studio.*Filter.*Priority/s);
  await checkAccessibility(page, 'the shortcuts');
  // Keys do nothing behind a dialog.
  await page.keyboard.press('g');
  await page.keyboard.press('f');
  await page.keyboard.press('Escape');
  await dialog.waitFor({ state: 'detached' });
  await inRoom(page, 'Jobs');
  // Letters that are typed are no shortcuts.
  await page.keyboard.press('/');
  await page.keyboard.type('gf?');
  assert.equal(await page.getByRole('searchbox').inputValue(), 'gf?');
  await inRoom(page, 'Jobs');
}

export async function the_first_key_leads_past_the_bar() {
  await start();
  const page = await open(farm);
  await inRoom(page, 'Jobs');
  await page.keyboard.press('Tab');
  assert.equal(await page.evaluate(() => document.activeElement?.textContent), 'Skip to the content');
}

export async function the_theme_follows_the_system_until_it_is_chosen() {
  await start();
  const page = await open(farm, '#/jobs', { theme: 'dark' });
  await inRoom(page, 'Jobs');
  const ground = () => page.evaluate(() => getComputedStyle(document.documentElement).backgroundColor);
  assert.equal(await ground(), 'rgb(18, 19, 21)');
  await page.getByRole('button', { name: /^Theme/ }).click();
  assert.equal(await ground(), 'rgb(246, 246, 244)');
  await page.reload();
  await inRoom(page, 'Jobs');
  assert.equal(await ground(), 'rgb(246, 246, 244)', 'the choice is kept');
  await page.keyboard.press('t');
  assert.equal(await ground(), 'rgb(18, 19, 21)');
  await page.keyboard.press('t');
  await page.emulateMedia({ colorScheme: 'light' });
  assert.equal(await ground(), 'rgb(246, 246, 244)', 'the system’s again');
}

export async function every_room_is_accessible_and_fits_light_and_dark_wide_and_narrow() {
  await start();
  await farm.render(smallJob('a small job', { frames: { count: 3 } }));
  const job = (await farm.get('/v1/jobs?limit=1')).jobs[0];
  for (const size of [DESKTOP, PHONE]) {
    for (const theme of ['light', 'dark']) {
      const page = await open(farm, '#/jobs', { size, theme });
      for (const [hash, title] of [...ROOMS, [`jobs/${job.id}`, job.name]]) {
        await page.goto(`${farm.address}/#/${hash}`);
        await inRoom(page, title);
        // Parts that are loaded after the heading.
        await page.locator(':is(.job-row, .workers tbody tr, .kind, .code-line, .empty-line):visible').first().waitFor();
        // The language is checked as a whole once, and in part in the other themes and widths.
        if (hash === 'help' && (theme === 'dark' || size === PHONE)) await page.getByRole('searchbox').fill('sphere');
        const what = `${title}, ${theme}, ${size.width} pixels`;
        await checkWidth(page, what);
        await checkAccessibility(page, what);
      }
      await page.context().close();
    }
  }
}

export async function the_first_paint_is_fast_and_the_first_load_small() {
  await start();
  const page = await open(farm, '#/jobs');
  await inRoom(page, 'Jobs');
  const session = await page.context().newCDPSession(page);
  const times = [];
  let bytes = 0;
  for (let round = 0; round < PAINTS; round += 1) {
    await session.send('Network.clearBrowserCache');
    await page.reload();
    await inRoom(page, 'Jobs');
    times.push(await until('a paint', () => page.evaluate(() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime)));
    bytes = await page.evaluate(() => [...performance.getEntriesByType('resource'), ...performance.getEntriesByType('navigation')].filter((entry) => new URL(entry.name).pathname === '/' || entry.name.includes('/ui/')).reduce((sum, entry) => sum + entry.transferSize, 0));
  }
  // Other programs only make it slower.
  const best = Math.min(...times);
  console.log(`        first paint after ${times.map((time) => time.toFixed(0)).join(', ')} ms; ${(bytes / 1024).toFixed(1)} KiB for the page`);
  checkTime(best <= FIRST_PAINT_MS, `the first paint takes ${best} ms`);
  assert.ok(bytes > 10_000 && bytes <= FIRST_LOAD_BYTES, `the first load is ${bytes} bytes`);
}

export async function all_rooms_but_the_studio_fit_the_budget_together() {
  await start();
  const job = (await farm.get('/v1/jobs?limit=1')).jobs[0] ?? (await farm.render(smallJob()));
  const page = await open(farm, '#/jobs');
  for (const [hash, title] of [...ROOMS, [`jobs/${job.id}`, job.name]]) {
    await page.goto(`${farm.address}/#/${hash}`);
    await inRoom(page, title);
  }
  const bytes = await page.evaluate(() => performance.getEntriesByType('resource').filter((entry) => entry.name.includes('/ui/')).reduce((sum, entry) => sum + entry.transferSize, 0));
  console.log(`        ${(bytes / 1024).toFixed(1)} KiB for four rooms`);
  assert.ok(bytes <= FIRST_LOAD_BYTES, `${bytes} bytes`);
  const loaded = await page.evaluate(() => performance.getEntriesByType('resource').map((entry) => entry.name).filter((name) => name.includes('codemirror')));
  assert.deepEqual(loaded, [], 'the editor is loaded only in the studio');
}
