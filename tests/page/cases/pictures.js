// Draws the pictures of docs/page.md. It is run only if it is asked for: see README.md.

import { mkdirSync, readFileSync, statSync } from 'node:fs';
import assert from 'node:assert/strict';
import { DESKTOP, PHONE, inRoom, open } from '../browser.js';
import { Farm, until } from '../farm.js';
import { cursorAfter, settled, stopFarm, studio } from '../studio.js';

const FOLDER = process.env.SDFARM_PAGE_PICTURES ?? 'target/page';
const LARGEST = 200 * 1024;
const SETTLED_MS = 2500;
/** The pictures of a page that is as dense as a screen of a laptop. */
const WIDE = { width: 1440, height: 900 };

const shipped = (name, change = {}) => {
  const job = JSON.parse(readFileSync(`scenes/${name}.json`, 'utf8'));
  return { ...job, ...change, image: { ...job.image, ...change.image } };
};

/** Saves a picture of at most 200 KiB. */
async function picture(page, name) {
  mkdirSync(FOLDER, { recursive: true });
  await page.waitForTimeout(SETTLED_MS);
  for (const quality of [88, 78, 66, 54]) {
    const path = `${FOLDER}/${name}.jpg`;
    await page.screenshot({ path, type: 'jpeg', quality });
    if (statSync(path).size <= LARGEST) return;
  }
  assert.fail(`${name} is too large`);
}

export async function the_rooms() {
  const farm = await Farm.start(['--workers', '2']);
  try {
    const empty = await open(farm);
    await empty.locator('.scene-button').first().waitFor();
    await picture(empty, 'first');
    await empty.context().close();
    const small = { image: { width: 640, height: 400, samples: 4 } };
    for (const name of ['csg', 'dice', 'emblem', 'gyroid', 'menger', 'octopus', 'lantern', 'metals', 'primitives', 'mandelbulb']) await farm.submit(shipped(name, small));
    const film = await farm.submit(shipped('turntable', { image: { samples: 2 } }));
    await until('the jobs', async () => (await farm.get('/v1/jobs?state=queued')).jobs.length === 0 && (await farm.get('/v1/jobs?state=running')).jobs.length === 0, 240_000);
    // The server keeps what it has drawn, so that the lists below have their pictures although it is busy.
    for (const job of (await farm.get('/v1/jobs')).jobs) await fetch(`${farm.address}/v1/jobs/${job.id}/frames/0/thumbnail?width=160`);
    const fjord = await farm.submit(shipped('fjord', { name: 'fjord, evening', image: { samples: 24 } }));
    await farm.submit(shipped('octopus', { name: 'octopus, large', image: { width: 1920, height: 1080, samples: 32 } }));
    const waiting = await farm.submit(shipped('temple', { name: 'temple, take 3' }));
    const paused = await farm.submit(shipped('city', { name: 'city at night' }));
    await farm.send('PATCH', `/v1/jobs/${waiting.id}`, { priority: 5 });
    await farm.send('POST', `/v1/jobs/${paused.id}/pause`);
    await until('some tiles', async () => (await farm.get(`/v1/jobs/${fjord.id}`)).progress > 0.25, 120_000);
    for (const [theme, size] of [['light', WIDE], ['dark', PHONE]]) {
      const suffix = size === PHONE ? '-phone' : '';
      const expected = [/429|503/];
      const jobs = await open(farm, '#/jobs', { theme, size, expected });
      await until('small pictures', async () => (await jobs.locator('.job-row .picture img').count()) > 5, 60_000);
      await picture(jobs, `jobs${suffix}`);
      await jobs.context().close();
      const room = await open(farm, '#/farm', { theme, size, expected });
      await room.locator('.workers tbody tr').first().waitFor();
      await picture(room, `farm${suffix}`);
      await room.context().close();
    }
    const growing = await open(farm, `#/jobs/${fjord.id}`, { theme: 'dark', size: WIDE, expected: [/429|503/] });
    await inRoom(growing, 'fjord, evening');
    await until('its picture', () => growing.evaluate(() => document.querySelector('canvas.viewer-picture').width > 1), 60_000);
    await picture(growing, 'job');
    await growing.context().close();
    await until('quiet', async () => (await farm.get('/v1/jobs?state=running')).jobs.length === 0, 400_000);
    for (const size of [WIDE, PHONE]) {
      const strip = await open(farm, `#/jobs/${film.id}?frame=6`, { size, expected: [/429|503/] });
      await inRoom(strip, 'turntable');
      await until('its strip', async () => (await strip.locator('.film-cell img').count()) > 2, 60_000);
      await picture(strip, size === PHONE ? 'frames-phone' : 'frames');
      await strip.context().close();
    }
    const help = await open(farm, '#/help', { size: DESKTOP });
    await help.locator('.kind').first().waitFor();
    await help.getByRole('navigation', { name: 'Contents' }).getByRole('link', { name: 'The job language' }).click();
    await picture(help, 'help');
  } finally {
    farm.stop();
  }
}

export async function the_studio() {
  const text = readFileSync('scenes/turntable.json', 'utf8');
  try {
    for (const [name, theme, size] of [['light', 'light', WIDE], ['dark', 'dark', WIDE], ['phone', 'dark', PHONE]]) {
      const page = await studio({ text, theme, size });
      await cursorAfter(page, '"roughness": 0.3');
      if (name === 'dark') {
        await page.getByRole('button', { name: 'Examples' }).first().click();
        await page.locator('.scene-item').first().waitFor();
        await page.getByRole('searchbox').fill('a');
        await page.getByRole('searchbox').fill('');
        await page.getByRole('button', { name: 'Price', exact: true }).first().click();
        await page.waitForSelector('.price-panel .facts');
      }
      await settled(page);
      await picture(page, `studio-${name}`);
      await page.context().close();
    }
  } finally {
    stopFarm();
  }
}
