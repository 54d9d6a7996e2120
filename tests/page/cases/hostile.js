// Hostile job files, names that are made to deceive, and a key that another origin wants to use.

import assert from 'node:assert/strict';
import { mkdtempSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { join } from 'node:path';
import { checkWidth, inRoom, open, PHONE } from '../browser.js';
import { Farm, freePort, smallJob, until } from '../farm.js';
import { stopFarm, studio } from '../studio.js';

let farm;
const start = async () => (farm ??= await Farm.start(['--workers', '0']));
export const after = () => {
  farm?.stop();
  stopFarm();
};

const valid = JSON.stringify(smallJob('valid'));
/** Files that no job can be made of, and what is said of each. */
const FILES = [
  ['empty', Buffer.alloc(0), /1 error|empty/],
  ['a picture', Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0, 0, 0, 13]), /error|UTF-8/],
  ['not utf-8', Buffer.concat([Buffer.from(valid.slice(0, 10)), Buffer.from([0xff, 0xfe, 0xc0]), Buffer.from(valid.slice(10))]), /error|UTF-8/],
  ['deep lists', Buffer.from('['.repeat(200_000)), /error/],
  ['deep objects', Buffer.from('{"scene":'.repeat(50_000)), /error/],
  ['a prototype', Buffer.from(valid.replace('{', '{"__proto__":{"polluted":1},"constructor":{"prototype":{"polluted":1}},')), /error/],
  ['an infinite radius', Buffer.from(valid.replace('"radius":1', '"radius":1e999')), /error/],
  ['endless loops', Buffer.from(valid.replace('"samples":1', '"samples":1e18')), /error/],
  ['a very long line', Buffer.from(`{"x":"${'y'.repeat(5_000_000)}"}`), /error/],
  ['markup', Buffer.from(valid.replace('"radius"', '"<img src=x onerror=globalThis.polluted=1>"')), /error/],
  ['control letters', Buffer.from(valid.replace('valid', 'a\u0000b')), /error/],
  ['a file of 33 MiB', Buffer.alloc(33 << 20, 32), /32 MiB/],
];

export async function hostile_job_files_are_refused_and_the_page_goes_on() {
  await start();
  const folder = mkdtempSync(join(farm.folder, 'files-'));
  const page = await open(farm, '#/jobs', { expected: [/422|400|413/] });
  await page.getByRole('heading', { name: 'No jobs yet' }).waitFor();
  const answer = page.locator('dialog[open], .toast.error').last();
  for (const [name, buffer, said] of FILES) {
    const path = join(folder, `${name}.json`);
    writeFileSync(path, buffer);
    await page.locator('input[type=file]').setInputFiles(path);
    await answer.waitFor();
    assert.match(await answer.textContent(), said, name);
    assert.ok((await answer.textContent()).length < 4000, `${name}: what is said can be read`);
    if (await page.locator('dialog[open]').count()) await page.keyboard.press('Escape');
    else await answer.getByRole('button', { name: 'Close the message' }).click();
    await answer.waitFor({ state: 'detached' });
  }
  assert.equal(await page.evaluate(() => ({}).polluted ?? globalThis.polluted), undefined);
  assert.equal((await farm.get('/v1/jobs')).jobs.length, 0, 'nothing was submitted');
  await page.locator('input[type=file]').setInputFiles({ name: 'good.json', mimeType: 'application/json', buffer: Buffer.from(valid) });
  await page.locator('.job-row:visible').getByRole('link', { name: 'valid', exact: true }).waitFor();
}

export async function hostile_texts_in_the_studio_are_marked_and_a_valid_one_is_drawn_again() {
  const page = await studio({ expected: [/413/] });
  // Texts of an editor are read already; large ones are checked when typing pauses.
  for (const [name, buffer] of FILES.filter(([name, { length }]) => name !== 'not utf-8' && length > 0 && length < 1_000_000)) {
    await page.evaluate((text) => document.querySelector('room-studio').studio.openText(text), buffer.toString('utf8'));
    await page.locator('.has-errors').waitFor();
    assert.notEqual(await page.locator('.badge').textContent(), 'Exact', name);
  }
  await page.evaluate((text) => document.querySelector('room-studio').studio.openText(text), valid);
  await page.locator('.fault-count.valid').waitFor();
  await until('its picture', async () => (await page.locator('.badge').textContent()) === 'Exact');
  assert.equal(await page.evaluate(() => ({}).polluted ?? globalThis.polluted), undefined);
}

export async function names_that_are_long_or_change_the_direction_of_text_stay_in_their_place() {
  await start();
  for (const { id } of (await farm.get('/v1/jobs')).jobs) await farm.send('DELETE', `/v1/jobs/${id}`);
  const names = [`\u202egnp.${'x'.repeat(20)}\u202d`, 'w'.repeat(200), 'Z\u0351\u036b\u0343'.repeat(40), '\u{1f468}\u200d\u{1f469}\u200d\u{1f467}'.repeat(20), "'; DROP TABLE jobs; --", '${7*7}{{7*7}}'];
  const taken = [];
  for (const name of names) {
    // A file that the server does not accept is refused with a reason.
    const job = await farm.submit(smallJob(name)).catch((error) => assert.match(String(error), /422/) ?? null);
    if (job) taken.push([job.id, name]);
  }
  assert.ok(taken.length >= 3, `${taken}`);
  for (const size of [undefined, PHONE]) {
    const page = await open(farm, '#/jobs', size ? { size } : {});
    await until('all jobs', async () => (await page.locator('.job-row:visible .name a').count()) === taken.length);
    const heights = await page.evaluate(() => [...document.querySelectorAll('.job-body .job-row:not([hidden])')].map((row) => row.getBoundingClientRect().height));
    assert.equal(new Set(heights).size, 1, `rows are of one height: ${heights}`);
    await checkWidth(page, 'hostile names');
    // The id beside a name is not turned around with it.
    for (const [id, name] of taken) {
      const row = page.locator(`#job-${id}`);
      assert.equal(await row.locator('.name a').textContent(), name);
      assert.equal(await row.locator('.name .mono').textContent(), id.slice(-8));
      assert.ok(await row.locator('.name a').evaluate((link) => getComputedStyle(link.parentElement).unicodeBidi.includes('isolate') || getComputedStyle(link).unicodeBidi.includes('isolate')), `${name} is isolated`);
    }
    for (const [id, name] of taken.slice(0, 3)) {
      await page.goto(`${farm.address}/#/jobs/${id}`);
      await inRoom(page, name);
      await checkWidth(page, `the job ${name.slice(0, 20)}`);
    }
    await page.goto(`${farm.address}/#/farm`);
    await page.locator('.queue-list li').first().waitFor();
    await checkWidth(page, 'the queue with hostile names');
  }
}

export async function a_key_is_of_no_use_to_another_origin() {
  const closed = new Farm();
  closed.key = closed.newKey('admin', 'admin');
  closed.port = await freePort();
  closed.flags = ['--workers', '0'];
  await closed.serve();
  const { id } = await closed.submit(smallJob('precious'));
  const attacker = createServer((request, response) => {
    response.setHeader('content-type', 'text/html');
    response.end('<!doctype html><title>attacker</title><body><form method="post" enctype="text/plain"><input name="a" value="b"></form></body>');
  });
  const port = await freePort();
  await new Promise((resolve) => attacker.listen(port, '127.0.0.1', resolve));
  try {
    const page = await open(closed, '#/jobs', { expected: [/401/] });
    await page.getByLabel('Key', { exact: true }).fill(closed.key);
    await page.getByLabel(/Keep it/).check();
    await page.keyboard.press('Enter');
    await page.locator('.job-row:visible').getByRole('link', { name: 'precious' }).waitFor();
    // The same browser, whose session storage has the key, visits a page of the attacker.
    const other = await page.context().newPage();
    await other.goto(`http://127.0.0.1:${port}/`);
    const results = await other.evaluate(
      async ({ target, id, key }) => {
        const attempt = async (path, options) => {
          try {
            const response = await fetch(target + path, options);
            return `${response.type} ${response.status} ${await response.text()}`;
          } catch (error) {
            return `refused: ${error.name}`;
          }
        };
        const opened = window.open(`${target}/#/jobs`);
        await new Promise((resolve) => setTimeout(resolve, 800));
        let storage;
        try {
          storage = opened.sessionStorage.getItem('sdfarm.key');
        } catch {
          storage = 'hidden';
        }
        opened?.postMessage({ type: 'key', key: 'give it' }, '*');
        return {
          storage,
          own: sessionStorage.getItem('sdfarm.key'),
          attempts: [
            await attempt('/v1/jobs', { credentials: 'include' }),
            await attempt(`/v1/jobs/${id}/cancel`, { method: 'POST', credentials: 'include', mode: 'no-cors' }),
            // A key that has been stolen cannot be used from a page either: the browser asks first, and is refused.
            await attempt('/v1/jobs', { headers: { authorization: `Bearer ${key}` } }),
            await attempt(`/v1/jobs/${id}`, { method: 'DELETE', headers: { authorization: `Bearer ${key}` } }),
          ],
        };
      },
      { target: closed.address, id, key: closed.key },
    );
    assert.ok(results.storage === 'hidden' || results.storage === null, `${results.storage}`);
    assert.equal(results.own, null);
    for (const text of results.attempts) assert.ok(text.startsWith('refused: ') || text.startsWith('opaque 0 '), JSON.stringify(results));
    // A form needs no permission of the other origin, and has no key.
    const [answer] = await Promise.all([
      other.waitForResponse((response) => response.url().endsWith('/cancel')),
      other.evaluate((action) => {
        document.querySelector('form').action = action;
        document.querySelector('form').submit();
      }, `${closed.address}/v1/jobs/${id}/cancel`),
    ]);
    assert.ok([401, 403].includes(answer.status()), `${answer.status()}`);
    // Outside of a browser, the server itself refuses a change that names another origin, although the key is right.
    const forged = await fetch(`${closed.address}/v1/jobs/${id}/cancel`, { method: 'POST', headers: { authorization: `Bearer ${closed.key}`, origin: `http://127.0.0.1:${port}` } });
    assert.equal(forged.status, 403);
    assert.equal((await forged.json()).code, 'foreign_origin');
    // The tab of the owner goes on.
    assert.equal((await closed.get(`/v1/jobs/${id}`)).state, 'queued');
    await page.locator('.job-list').focus();
    await page.keyboard.press('Home');
    await page.keyboard.press('p');
    await until('the pause by the owner', async () => (await closed.get(`/v1/jobs/${id}`)).paused);
  } finally {
    attacker.close();
    closed.stop();
  }
}
