// The room Farm: workers, pool, queue, history, alerts, disk, pausing and the audit log; and the room Help.

import assert from 'node:assert/strict';
import { PHONE, checkAccessibility, checkWidth, inRoom, open } from '../browser.js';
import { Farm, smallJob, until } from '../farm.js';

let farm;
const start = async () => (farm ??= await Farm.start());
let idle;
/** A farm without workers. */
const startIdle = async () => (idle ??= await Farm.start(['--workers', '0']));
export const after = () => {
  farm?.stop();
  idle?.stop();
};

/** Deletes all jobs of the farm without workers. */
const emptyIdle = async () => {
  await startIdle();
  for (const { id } of (await idle.get('/v1/jobs')).jobs) await idle.send('DELETE', `/v1/jobs/${id}`);
};

const pool = async () => (await farm.get('/v1/pool')).workers;

export async function the_pool_grows_and_shrinks_by_mouse_and_keyboard() {
  await start();
  const page = await open(farm, '#/farm');
  await inRoom(page, 'Farm');
  await page.locator('.workers tbody tr').first().waitFor();
  await page.getByRole('button', { name: 'One more worker on this machine' }).click();
  await until('two workers', async () => (await pool()) === 2);
  await until('two rows', async () => (await page.locator('.workers tbody tr').count()) === 2);
  await until('one worker', async () => {
    if ((await pool()) === 2) await page.keyboard.press('-');
    return (await pool()) === 1;
  });
  await page.getByRole('button', { name: 'One worker fewer' }).click();
  const dialog = page.getByRole('dialog', { name: 'Stop the last worker of this machine?' });
  await dialog.getByRole('button', { name: 'Cancel' }).click();
  assert.equal(await pool(), 1);
}

export async function a_worker_is_quarantined_released_and_drained() {
  await start();
  const page = await open(farm, '#/farm');
  const first = page.locator('.workers tbody tr').first();
  await until('a ready worker', async () => /ready/.test(await first.textContent()));
  const id = await first.getAttribute('data-worker');
  const choose = async (label, confirmation) => {
    await page.locator(`[data-worker="${id}"]`).getByRole('button', { name: /^Actions for/ }).click();
    await page.getByRole('menuitem', { name: label }).click();
    if (confirmation) await page.getByRole('button', { name: confirmation }).click();
  };
  const worker = async () => (await farm.get('/v1/workers')).workers.find((each) => each.id === id);
  await choose('Quarantine', 'Quarantine it');
  await until('the quarantine', async () => (await worker()).quarantined === true);
  await page.locator(`[data-worker="${id}"]`).getByText('quarantined').waitFor();
  const { id: job } = await farm.submit(smallJob('waits for a release'));
  await choose('Release');
  await until('the release', async () => (await worker()).quarantined === false);
  await until('the job', async () => (await farm.get(`/v1/jobs/${job}`)).state === 'succeeded');
  await choose('Drain', 'Drain it');
  await until('its end', async () => (await worker()) === undefined);
  await until('another in its place', async () => (await farm.get('/v1/workers')).workers.some((each) => each.id !== id && each.state === 'ready'));
}

export async function the_queue_is_reordered_by_buttons_dragging_and_seen_by_submitter() {
  await emptyIdle();
  for (const name of ['first', 'second', 'third']) await idle.submit(smallJob(name));
  const page = await open(idle, '#/farm');
  const list = page.locator('.queue-list li[data-job]');
  const order = (wanted) => until(`the order ${wanted}`, async () => JSON.stringify(await page.locator('.queue-name').allTextContents()) === JSON.stringify(wanted));
  await order(['first', 'second', 'third']);
  await page.getByRole('button', { name: 'To the front: third' }).click();
  await order(['third', 'first', 'second']);
  await page.getByRole('button', { name: 'Down: third' }).focus();
  await page.keyboard.press('Enter');
  await order(['first', 'third', 'second']);
  await list.nth(2).dragTo(list.nth(0), { targetPosition: { x: 60, y: 4 } });
  await order(['second', 'first', 'third']);
  assert.deepEqual((await idle.get('/v1/jobs')).jobs.sort((a, b) => a.queue_position - b.queue_position).map((job) => job.name), ['second', 'first', 'third']);
  await page.getByRole('button', { name: 'By submitter' }).click();
  await until('the submitter', async () => /local.*0.*3/s.test(await page.locator('.queue tbody').textContent()));
  await checkAccessibility(page, 'the queue by submitter');
  await emptyIdle();
  await page.getByText('Nothing waits').waitFor();
}

export async function the_farm_is_paused_and_resumed() {
  await startIdle();
  const page = await open(idle, '#/farm');
  await inRoom(page, 'Farm');
  await page.getByRole('button', { name: 'Pause the farm' }).click();
  await page.getByRole('dialog').getByRole('button', { name: 'Pause the farm' }).click();
  await until('the pause', async () => (await idle.get('/v1/farm')).paused);
  await page.getByRole('button', { name: 'Resume the farm' }).waitFor();
  await page.getByRole('region', { name: 'Alerts' }).getByText(/paused/i).first().waitFor();
  await page.keyboard.press('p');
  await until('the end of the pause', async () => !(await idle.get('/v1/farm')).paused);
}

export async function alerts_say_what_is_wrong_and_the_cure() {
  await emptyIdle();
  const page = await open(idle, '#/farm');
  const region = page.getByRole('region', { name: 'Alerts' });
  await region.getByText('All is well').waitFor();
  await idle.submit(smallJob('without a worker'));
  const alerts = await until('the alert of a job without a worker', async () => {
    const now = (await idle.get('/v1/alerts')).alerts;
    return now.some(({ code }) => code === 'no_worker') && now;
  });
  for (const { message, cure } of alerts) {
    await until(`the alert ${message}`, async () => {
      const text = (await region.textContent()).toLowerCase();
      return text.includes(message.toLowerCase()) && text.includes(cure.replaceAll('`', '').toLowerCase());
    });
  }
  await checkAccessibility(page, 'an alert');
  await emptyIdle();
  await region.getByText('All is well').waitFor();
}

export async function history_is_read_by_pointer_keyboard_and_as_a_table() {
  await start();
  await farm.render(smallJob('for the history'));
  const page = await open(farm, '#/farm');
  await inRoom(page, 'Farm');
  const { points } = await until('some history', async () => {
    const history = await farm.get('/v1/history?seconds=900&points=120');
    return history.points.length > 1 && history;
  });
  await page.getByRole('button', { name: '15 min' }).click();
  const chart = page.getByRole('slider', { name: 'Utilization over time' });
  await chart.waitFor();
  assert.match(await page.locator('.chart-now').nth(1).textContent(), /^\d+ %$/);
  await chart.focus();
  await page.keyboard.press('Home');
  const first = await chart.getAttribute('aria-valuetext');
  await page.keyboard.press('End');
  assert.notEqual(await chart.getAttribute('aria-valuetext'), first);
  assert.match(first, /^\d\d:\d\d: \d+ %$/);
  await chart.hover({ position: { x: 20, y: 40 } });
  assert.match(await page.locator('.chart-head').nth(0).textContent(), /Throughput\d\d:\d\d/, 'all charts follow the pointer');
  await page.locator('.chart-table summary').click();
  await page.locator('.chart-table tbody tr').first().waitFor();
  assert.ok((await page.locator('.chart-table tbody tr').count()) >= Math.min(2, points.length));
  await checkAccessibility(page, 'the history as a table');
}

export async function disk_and_audit_log_are_shown() {
  await startIdle();
  await idle.submit(smallJob('in the log'));
  const page = await open(idle, '#/farm');
  await page.getByRole('heading', { name: 'Disk' }).waitFor();
  await until('its numbers', async () => /Pictures.*Tiles.*Free.*\d+(\.\d)? [kMGT]?B of \d+/s.test(await page.locator('.disk').textContent()));
  await page.getByRole('heading', { name: 'Audit log' }).waitFor();
  await until('an entry', async () => /POST \/v1\/jobs.*201/s.test(await page.locator('.audit tbody').textContent()));
}

export async function a_phone_shows_the_farm() {
  await start();
  const page = await open(farm, '#/farm', { size: PHONE, theme: 'dark' });
  await page.locator('.workers tbody tr').first().waitFor();
  await checkWidth(page, 'the farm');
  await page.getByRole('button', { name: 'One more worker on this machine' }).tap();
  await until('two workers', async () => (await pool()) === 2);
  await page.getByRole('button', { name: 'One worker fewer' }).tap();
  await until('one worker', async () => (await pool()) === 1);
  await page.getByRole('button', { name: 'Pause the farm' }).tap();
  await page.getByRole('dialog').getByRole('button', { name: 'Pause the farm' }).tap();
  await page.getByRole('button', { name: 'Resume the farm' }).tap();
  await until('the end of the pause', async () => !(await farm.get('/v1/farm')).paused);
}

export async function workers_and_keys_are_changed_by_the_keyboard_alone() {
  await startIdle();
  const busy = await Farm.start();
  try {
    const page = await open(busy, '#/farm', { expected: [/401/] });
    const row = page.locator('.workers tbody tr').first();
    await until('a ready worker', async () => /ready/.test(await row.textContent()));
    const worker = async () => (await busy.get('/v1/workers')).workers[0];
    const press = async (...keys) => {
      for (const key of keys) await page.keyboard.press(key);
    };
    await row.getByRole('button', { name: /^Actions for/ }).focus();
    await press('Enter', 'ArrowDown', 'Enter');
    // The safe answer has the focus; the next one quarantines.
    await page.getByRole('dialog', { name: /^Quarantine/ }).waitFor();
    await press('Tab', 'Enter');
    await until('the quarantine', async () => (await worker()).quarantined);
    await row.getByText('quarantined').waitFor();
    await row.getByRole('button', { name: /^Actions for/ }).focus();
    await press('Space', 'End', 'Enter');
    await until('the release', async () => !(await worker()).quarantined);
    await page.getByRole('button', { name: 'New key' }).focus();
    await press('Enter');
    await page.getByLabel('Name of its owner').waitFor();
    await page.keyboard.type('by-keys');
    await press('Enter');
    const secret = page.getByLabel('The key', { exact: true });
    await secret.waitFor();
    busy.key = await secret.inputValue();
    assert.deepEqual((await busy.get('/v1/keys')).keys.map((key) => key.name), ['by-keys']);
    await page.getByRole('button', { name: 'I have kept it' }).focus();
    await press('Enter');
    await page.locator('tr', { hasText: 'by-keys' }).first().waitFor();
  } finally {
    busy.stop();
  }
}

export async function the_language_is_searched_and_shown_with_pictures() {
  await start();
  const page = await open(farm, '#/help');
  await inRoom(page, 'Help');
  const kinds = page.locator('.kind');
  await kinds.first().waitFor();
  const all = await kinds.count();
  await page.keyboard.press('/');
  await page.keyboard.type('sphere');
  await until('fewer', async () => (await kinds.count()) > 0 && (await kinds.count()) < all);
  const first = kinds.first();
  assert.match(await first.locator('summary').textContent(), /sphere/);
  await first.locator('summary').click();
  await first.getByText('radius').first().waitFor();
  const { kinds: table } = await farm.get('/v1/schema/nodes');
  const pictured = table.filter((kind) => kind.picture !== null);
  if (pictured.length > 0) {
    await until('a picture', () => page.evaluate(() => [...document.querySelectorAll('.kind img')].some((image) => image.complete && image.naturalWidth > 0)));
  }
  await checkAccessibility(page, 'a kind');
  await page.getByRole('searchbox').fill('no such word');
  await page.getByText('Nothing has these words.').waitFor();
  await page.getByRole('searchbox').fill('');
  await page.getByRole('navigation', { name: 'Contents' }).getByRole('link', { name: 'Shortcuts' }).click();
  assert.equal(await page.evaluate(() => document.activeElement?.id), 'help-shortcuts');
}

export async function the_first_job_of_the_help_is_rendered_by_a_click() {
  await start();
  const page = await open(farm, '#/help', { expected: [/429|503/] });
  await page.getByRole('button', { name: 'Render it' }).click();
  await inRoom(page, 'first');
}
