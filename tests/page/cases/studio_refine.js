// Exact pictures of scenes that take the server long: they become sharper at rest, up to the size on the screen.

import assert from 'node:assert/strict';
import { createRequire } from 'node:module';
import { resolve } from 'node:path';
import { csg, ready, stopFarm, studio } from '../studio.js';

const { PNG } = createRequire(resolve('.tools/page/package.json'))('pngjs');

export const after = stopFarm;

/** A picture of one color. */
const png = PNG.sync.write(new PNG({ width: 1280, height: 720, fill: true }));

/**
 * Opens the studio with a server whose previews are `rendered` wide for a request; null is too slow. Resolves when no more are
 * requested, to what was requested and the width that is shown.
 */
async function refined(rendered) {
  const page = await studio({ text: null, expected: [/503/], init: () => Object.defineProperty(Navigator.prototype, 'gpu', { get: () => undefined }) });
  const requests = [];
  await page.route('**/v1/preview*', (route) => {
    const { searchParams } = new URL(route.request().url());
    const [width, samples, limit] = ['width', 'samples', 'limit_ms'].map((name) => Number(searchParams.get(name)));
    requests.push({ width, samples, limit });
    const most = rendered({ width, samples, limit });
    return most === null
      ? route.fulfill({ status: 503, headers: { 'retry-after': '5' }, contentType: 'application/problem+json', body: JSON.stringify({ title: 'The preview failed', code: 'no_preview' }) })
      : route.fulfill({ body: png, contentType: 'image/png', headers: { 'preview-width': String(Math.min(width, most)), 'preview-samples': String(samples) } });
  });
  await page.reload();
  await ready(page, null);
  await page.waitForFunction(() => document.querySelector('room-studio').studio.picture.pixels > 100);
  await page.evaluate((text) => document.querySelector('room-studio').studio.openText(text), csg);
  requests.length = 0;
  await page.waitForTimeout(1500);
  await page.waitForFunction(() => !document.querySelector('room-studio').studio.previewer.isBusy);
  const [shown, badge, pixels] = await page.evaluate(() => [Number(document.querySelector('.stage').dataset.width), document.querySelector('.badge').textContent, document.querySelector('room-studio').studio.picture.pixels]);
  return { requests, shown, badge, most: Math.min(1280, JSON.parse(csg).image.width, Math.ceil(pixels)) };
}

export async function a_scene_that_takes_long_to_prepare_is_shown_by_a_larger_limit() {
  const { requests, shown, badge, most } = await refined(({ width, limit }) => (limit < 2000 ? null : width));
  assert.equal(badge, 'Exact');
  assert.equal(shown, most, JSON.stringify(requests));
}

export async function a_picture_that_is_made_smaller_is_asked_for_again_from_its_size_on() {
  let last = 21;
  const { requests, shown, most } = await refined(({ width }) => {
    if (width > 4.6 * last) return 21;
    last = width;
    return width;
  });
  assert.equal(shown, most, JSON.stringify(requests));
}

export async function a_scene_that_is_never_sharp_is_not_asked_for_again_and_again() {
  const { requests, shown } = await refined(({ samples }) => (samples === 1 ? 90 : 20));
  assert.equal(shown, 90);
  assert.ok(requests.length <= 5, JSON.stringify(requests));
}
