// Draws the pictures of docs/page.md. It is run only if it is asked for: see README.md.

import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import assert from 'node:assert/strict';
import { DESKTOP, PHONE, inRoom, open } from '../browser.js';
import { Farm, until } from '../farm.js';
import { cursorAfter, settled, stopFarm, studio } from '../studio.js';

const FOLDER = process.env.SDFARM_PAGE_PICTURES ?? 'target/page';
const LARGEST = 25 * 1024;
/** The pictures of README.md, which are larger. */
const OF_README = { names: ['jobs', 'studio-light'], largest: 200 * 1024 };
/** A wide page is drawn smaller. */
const SCALE = 2 / 3;
const SETTLED_MS = 2500;
const SHARP_MS = 20_000;
/** Minutes of work in the picture of the farm. */
const MINUTES = 3;
/** The pictures of a page that is as dense as a screen of a laptop. */
const WIDE = { width: 1440, height: 900 };

const shipped = (name, change = {}) => {
  const job = JSON.parse(readFileSync(`scenes/${name}.json`, 'utf8'));
  return { ...job, ...change, image: { ...job.image, ...change.image } };
};

/** Saves a picture: WebP of at most 25 KiB, or JPEG for README.md. */
async function picture(page, name) {
  mkdirSync(FOLDER, { recursive: true });
  await page.waitForTimeout(SETTLED_MS);
  const { width, height } = page.viewportSize();
  const isOfReadme = OF_README.names.includes(name);
  const [format, largest] = isOfReadme ? ['jpeg', OF_README.largest] : ['webp', LARGEST];
  const clip = { x: 0, y: 0, width, height, scale: isOfReadme || width < 1000 ? 1 : SCALE };
  const session = await page.context().newCDPSession(page);
  for (const quality of [88, 78, 66, 54, 42, 30]) {
    const { data } = await session.send('Page.captureScreenshot', { format, quality, clip });
    const bytes = Buffer.from(data, 'base64');
    if (bytes.length > largest) continue;
    writeFileSync(`${FOLDER}/${name}.${isOfReadme ? 'jpg' : 'webp'}`, bytes);
    return;
  }
  assert.fail(`${name} is too large`);
}

export async function the_rooms() {
  const farm = await Farm.start(['--workers', '2']);
  try {
    const small = { image: { width: 640, height: 400, samples: 4 } };
    for (const name of ['csg', 'dice', 'emblem', 'gyroid', 'menger', 'chess', 'city', 'lantern', 'metals', 'mandelbulb']) await farm.submit(shipped(name, small));
    const film = await farm.submit(shipped('turntable', { image: { samples: 2 } }));
    await until('the jobs', async () => (await farm.get('/v1/jobs?state=queued')).jobs.length === 0 && (await farm.get('/v1/jobs?state=running')).jobs.length === 0, 240_000);
    // The server keeps what it has drawn, so that the lists below have their pictures although it is busy.
    for (const job of (await farm.get('/v1/jobs')).jobs) await fetch(`${farm.address}/v1/jobs/${job.id}/frames/0/thumbnail?width=160`);
    const fjord = await farm.submit(shipped('fjord', { image: { samples: 24 } }));
    await farm.submit(shipped('octopus', { image: { width: 1920, height: 1080, samples: 32 } }));
    const waiting = await farm.submit(shipped('temple'));
    const paused = await farm.submit(shipped('still-life'));
    await farm.send('PATCH', `/v1/jobs/${waiting.id}`, { priority: 5 });
    await farm.send('POST', `/v1/jobs/${paused.id}/pause`);
    await until('some tiles', async () => (await farm.get(`/v1/jobs/${fjord.id}`)).progress > 0.25, 120_000);
    for (const [theme, size] of [['light', WIDE], ['dark', PHONE]]) {
      const suffix = size === PHONE ? '-phone' : '';
      const expected = [/429|503/];
      const jobs = await open(farm, '#/jobs', { theme, size, expected });
      // All that are seen and have begun, but for the paused and the queued one.
      const pictured = async () => [await jobs.locator('.job-body .job-row:visible').count(), await jobs.locator('.job-body .job-row:visible .picture img').count()];
      await until('small pictures', async () => pictured().then(([rows, images]) => rows > 5 && images >= rows - 2), 90_000);
      await picture(jobs, `jobs${suffix}`);
      await jobs.context().close();
    }
    const growing = await open(farm, `#/jobs/${fjord.id}`, { theme: 'dark', size: WIDE, expected: [/429|503/] });
    await inRoom(growing, 'fjord');
    await until('its picture', () => growing.evaluate(() => document.querySelector('canvas.viewer-picture').width > 1), 60_000);
    await until('more tiles', async () => (await farm.get(`/v1/jobs/${fjord.id}`)).progress > 0.6, 240_000);
    await picture(growing, 'job');
    await growing.context().close();
    // The history is of whole minutes.
    const films = [];
    await until('some minutes of history', async () => {
      const busy = (await farm.get('/v1/jobs?state=running')).jobs.length + (await farm.get('/v1/jobs?state=queued')).jobs.filter((job) => !job.paused).length;
      if (busy < 3) films.push(await farm.submit(shipped(['lantern', 'turntable', 'temple'][films.length % 3], { image: { width: 320 + films.length, height: 200, samples: 16 } })));
      const { points } = await farm.get('/v1/history?seconds=900&points=15');
      return points.filter((point) => point.rays > 0).length >= MINUTES;
    }, 600_000);
    for (const [theme, size] of [['light', WIDE], ['dark', PHONE]]) {
      const room = await open(farm, '#/farm', { theme, size, expected: [/429|503/] });
      await room.locator('.workers tbody tr').first().waitFor();
      await room.getByRole('button', { name: '15 min' }).click();
      await picture(room, `farm${size === PHONE ? '-phone' : ''}`);
      await room.context().close();
    }
    await until('quiet', async () => (await farm.get('/v1/jobs?state=running')).jobs.length === 0, 400_000);
    for (const size of [WIDE, PHONE]) {
      const strip = await open(farm, `#/jobs/${film.id}?frame=6`, { size, expected: [/429|503/] });
      await inRoom(strip, 'turntable');
      await until('its strip', async () => (await strip.locator('.film-cell img').count()) === (await strip.locator('.film-cell').count()), 60_000);
      await picture(strip, size === PHONE ? 'frames-phone' : 'frames');
      await strip.context().close();
    }
    const help = await open(farm, '#/help', { size: DESKTOP });
    await help.locator('.kind').first().waitFor();
    await help.getByRole('navigation', { name: 'Contents' }).getByRole('link', { name: 'The job language' }).click();
    await help.mouse.move(0, 0);
    await picture(help, 'help');
  } finally {
    farm.stop();
  }
}

export async function the_studio() {
  const text = readFileSync('scenes/turntable.json', 'utf8');
  try {
    const page = await studio({ text, theme: 'light', size: WIDE });
    await cursorAfter(page, '"roughness": 0.3');
    await settled(page);
    // A busy machine stops at fewer samples.
    await page.locator('.picture-bar').getByText(/8 samples/).waitFor({ timeout: SHARP_MS }).catch(() => {});
    await picture(page, 'studio-light');
    await page.context().close();
  } finally {
    stopFarm();
  }
}
