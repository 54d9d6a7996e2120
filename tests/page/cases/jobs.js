// The room Jobs: a live list, filter, sort, columns, selection, and every action by mouse and by keyboard.

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { PHONE, checkAccessibility, inRoom, open } from '../browser.js';
import { Farm, smallJob, until } from '../farm.js';

let farm;
/** A farm without workers: its jobs stay as they are. */
const start = async () => (farm ??= await Farm.start(['--workers', '0']));
export const after = () => farm?.stop();

/** Deletes all jobs. */
async function empty() {
  await start();
  for (const { id } of (await farm.get('/v1/jobs?limit=1000')).jobs) await farm.send('DELETE', `/v1/jobs/${id}`);
}

const rows = (page) => page.locator('.job-body [role=row]:visible');
const row = (page, name) => page.locator('.job-body [role=row]:visible').filter({ has: page.getByRole('link', { name, exact: true }) });
const names = (page) => page.evaluate(() => [...document.querySelectorAll('.job-body [role=row]:not([hidden])')].sort((a, b) => Number(a.getAttribute('aria-rowindex')) - Number(b.getAttribute('aria-rowindex'))).map((each) => each.querySelector('.name a').textContent));
const state = (page, name, wanted) => until(`${name} ${wanted}`, async () => (await row(page, name).locator('.state').textContent()) === wanted);
const job = async (name) => (await farm.get('/v1/jobs?limit=1000')).jobs.find((each) => each.name === name);

export async function an_empty_farm_teaches_and_renders_a_shipped_scene() {
  await empty();
  const page = await open(farm);
  await page.getByRole('heading', { name: 'No jobs yet' }).waitFor();
  const scene = page.locator('.scene-button', { hasText: 'csg' }).first();
  await scene.waitFor();
  await checkAccessibility(page, 'no jobs');
  await scene.click();
  await page.waitForURL(/#\/jobs\/[0-9a-f-]{36}/);
  await inRoom(page, 'csg');
  assert.equal((await farm.get('/v1/jobs')).jobs.length, 1);
}

export async function changes_of_others_are_seen_at_once() {
  await empty();
  const page = await open(farm);
  await page.getByRole('heading', { name: 'No jobs yet' }).waitFor();
  const { id } = await farm.submit(smallJob('from elsewhere'));
  await row(page, 'from elsewhere').waitFor({ timeout: 3000 });
  await state(page, 'from elsewhere', 'queued');
  await farm.send('POST', `/v1/jobs/${id}/pause`);
  await state(page, 'from elsewhere', 'paused');
  await farm.send('PATCH', `/v1/jobs/${id}`, { priority: 7 });
  await until('the priority', async () => (await row(page, 'from elsewhere').locator('.cell.priority').textContent()) === '7');
  await farm.send('POST', `/v1/jobs/${id}/cancel`);
  await state(page, 'from elsewhere', 'cancelled');
  await farm.send('DELETE', `/v1/jobs/${id}`);
  await page.getByRole('heading', { name: 'No jobs yet' }).waitFor();
}

export async function the_mouse_does_every_action_to_one_job() {
  await empty();
  const { id } = await farm.submit(smallJob('alpha'));
  await farm.submit(smallJob('beta'));
  const page = await open(farm);
  const choose = async (label) => {
    await row(page, 'alpha').getByRole('button', { name: 'Actions for alpha' }).click();
    await page.getByRole('menuitem', { name: label }).click();
  };
  await row(page, 'alpha').waitFor();
  await choose('Pause');
  await state(page, 'alpha', 'paused');
  await choose('Resume');
  await state(page, 'alpha', 'queued');
  await choose('Priority…');
  await page.getByLabel('Priority, from').fill('-3');
  await page.getByRole('button', { name: 'Set' }).click();
  await until('the priority', async () => (await farm.get(`/v1/jobs/${id}`)).priority === -3);
  await choose('To the front');
  await until('the first place', async () => (await job('alpha')).queue_position === 1);
  await choose('Move…');
  await page.getByLabel('Side').selectOption('after');
  await page.getByRole('dialog').getByRole('button', { name: 'Move', exact: true }).click();
  await until('the second place', async () => (await job('alpha')).queue_position === 2);
  await choose('Cancel…');
  const dialog = page.getByRole('dialog', { name: 'Cancel alpha?' });
  assert.match(await dialog.textContent(), /alpha.*0 %.*Nothing of it has been rendered/s);
  await dialog.getByRole('button', { name: 'Cancel the job' }).click();
  await state(page, 'alpha', 'cancelled');
  await choose('Delete…');
  const deletion = page.getByRole('dialog', { name: 'Delete alpha?' });
  assert.match(await deletion.textContent(), /No picture is lost.*cannot be undone/s);
  await deletion.getByRole('button', { name: 'Cancel', exact: true }).click();
  await deletion.waitFor({ state: 'detached' });
  assert.ok(await job('alpha'), 'a change of mind deletes nothing');
  await choose('Delete…');
  await page.getByRole('button', { name: 'Delete the job' }).click();
  await row(page, 'alpha').waitFor({ state: 'detached' }).catch(() => {});
  await until('the deletion', async () => (await job('alpha')) === undefined);
  assert.deepEqual(await names(page), ['beta']);
}

export async function the_keyboard_does_every_action_to_many_jobs() {
  await empty();
  for (const name of ['one', 'two', 'three', 'four']) await farm.submit(smallJob(name));
  const page = await open(farm);
  await row(page, 'one').waitFor();
  assert.deepEqual(await names(page), ['four', 'three', 'two', 'one']);
  await page.keyboard.press('ArrowDown');
  await page.keyboard.press('ArrowUp');
  await page.keyboard.press(' ');
  await page.keyboard.press('Shift+ArrowDown');
  await page.keyboard.press('Shift+ArrowDown');
  await page.getByText('3 selected').waitFor();
  await checkAccessibility(page, 'a selection');
  await page.keyboard.press('p');
  for (const name of ['four', 'three', 'two']) await state(page, name, 'paused');
  await state(page, 'one', 'queued');
  await page.keyboard.press('u');
  for (const name of ['four', 'three', 'two']) await state(page, name, 'queued');
  await page.keyboard.press('y');
  await page.keyboard.press('Control+a');
  await page.keyboard.type('4');
  await page.keyboard.press('Enter');
  await until('the priorities', async () => (await farm.get('/v1/jobs')).jobs.filter((each) => each.priority === 4).length === 3);
  await page.getByRole('dialog').waitFor({ state: 'detached' });
  let moves = 0;
  page.on('response', (response) => (moves += response.url().endsWith('/move')));
  await page.keyboard.press('f');
  await until('the moves', () => moves === 3);
  await until('the places', async () => {
    const places = (await farm.get('/v1/jobs')).jobs.map((each) => [each.queue_position, each.name]);
    return places.find(([, name]) => name === 'one')?.[0] === 4 && places.every(([place]) => place >= 1 && place <= 4);
  });
  await page.keyboard.press('c');
  const dialog = page.getByRole('dialog', { name: 'Cancel 3 jobs?' });
  await dialog.waitFor();
  assert.equal(await page.evaluate(() => document.activeElement?.textContent), 'Cancel', 'the safe answer has the focus');
  await page.keyboard.press('Escape');
  await dialog.waitFor({ state: 'detached' });
  assert.equal((await job('four')).state, 'queued');
  await page.keyboard.press('c');
  await page.keyboard.press('Tab');
  await page.keyboard.press('Enter');
  for (const name of ['four', 'three', 'two']) await state(page, name, 'cancelled');
  await page.keyboard.press('Delete');
  await page.getByRole('dialog', { name: 'Delete 3 jobs?' }).waitFor();
  await page.keyboard.press('Tab');
  await page.keyboard.press('Enter');
  await until('the deletion', async () => (await farm.get('/v1/jobs')).jobs.length === 1);
  await until('one row', async () => (await rows(page).count()) === 1);
  // The focus is in the list again, and Enter opens the job.
  await page.locator('.job-list').focus();
  await page.keyboard.press('Home');
  await page.keyboard.press('Enter');
  await inRoom(page, 'one');
}

export async function retry_renders_the_dead_tiles_of_a_failed_job() {
  await empty();
  // A scene that no worker can render in time fails; here a job is failed by a limit of time of its tiles.
  const failing = await Farm.start(['--workers', '1', '--max-tile-seconds', '1']);
  try {
    const heavy = JSON.parse(readFileSync('scenes/lantern.json', 'utf8'));
    heavy.name = 'heavy';
    heavy.image = { width: 64, height: 64, samples: 4096 };
    const { id } = await failing.submit(heavy);
    await until('the failure', async () => (await failing.get(`/v1/jobs/${id}`)).state === 'failed', 60_000);
    const page = await open(failing);
    await row(page, 'heavy').waitFor();
    await state(page, 'heavy', 'failed');
    await page.keyboard.press('ArrowDown');
    await page.keyboard.press('r');
    await until('the retry', async () => (await failing.get(`/v1/jobs/${id}`)).state !== 'failed');
    await page.goto(`${failing.address}/#/jobs/${id}`);
    await inRoom(page, 'heavy');
    await until('the errors', async () => (await page.locator('.messages li').count()) > 0, 60_000);
  } finally {
    failing.stop();
  }
}

export async function the_list_is_filtered_sorted_and_its_columns_chosen() {
  await empty();
  for (const [name, priority] of [['apple', 1], ['banana', 3], ['cherry', 2]]) {
    const { id } = await farm.submit(smallJob(name));
    await farm.send('PATCH', `/v1/jobs/${id}`, { priority });
    if (name === 'cherry') await farm.send('POST', `/v1/jobs/${id}/cancel`);
  }
  const page = await open(farm);
  await row(page, 'apple').waitFor();
  const sorted = async (title, wanted) => {
    await page.getByRole('columnheader').getByRole('button', { name: title }).click();
    await until(`the order by ${title}`, async () => JSON.stringify(await names(page)) === JSON.stringify(wanted));
  };
  await sorted('Priority', ['banana', 'cherry', 'apple']);
  await sorted('Priority', ['apple', 'cherry', 'banana']);
  await sorted('Job', ['apple', 'banana', 'cherry']);
  assert.equal(await page.locator('[aria-sort=ascending]').textContent(), 'Job');
  await page.getByRole('button', { name: 'Columns' }).click();
  await page.getByRole('menuitemcheckbox', { name: 'Submitter', exact: true }).click();
  assert.equal(await page.locator('.job-row .submitter').first().isVisible(), false);
  await page.reload();
  await row(page, 'apple').waitFor();
  assert.deepEqual(await names(page), ['apple', 'banana', 'cherry'], 'the order is kept');
  assert.equal(await page.locator('.job-row .submitter').first().isVisible(), false, 'the columns are kept');
  await page.keyboard.press('/');
  await page.keyboard.type('an');
  await until('the filter', async () => JSON.stringify(await names(page)) === '["banana"]');
  await page.keyboard.type(' nothing');
  await page.getByRole('heading', { name: 'No job fits the filter' }).waitFor();
  await page.getByRole('button', { name: 'Clear the filter' }).click();
  await row(page, 'cherry').waitFor();
  await page.getByRole('group', { name: 'State' }).getByRole('button', { name: /^Cancelled/ }).click();
  await until('the state', async () => JSON.stringify(await names(page)) === '["cherry"]');
  assert.equal(new URL(page.url()).hash, '#/jobs?state=cancelled');
  await page.getByRole('group', { name: 'State' }).getByRole('button', { name: /^Failed/ }).click();
  await page.getByRole('heading', { name: 'No job is failed' }).waitFor();
}

export async function job_files_are_submitted_and_errors_shown_at_their_lines() {
  await empty();
  const page = await open(farm, '#/jobs', { expected: [/422/, /400/] });
  await page.getByRole('heading', { name: 'No jobs yet' }).waitFor();
  const files = page.locator('input[type=file]');
  const text = JSON.stringify(smallJob('from a file'), null, 2);
  await files.setInputFiles({ name: 'good.json', mimeType: 'application/json', buffer: Buffer.from(text) });
  await row(page, 'from a file').waitFor();
  const wrong = text.replace('"samples": 1', '"samples": 0').replace('"radius"', '"radios"');
  await files.setInputFiles({ name: 'wrong.json', mimeType: 'application/json', buffer: Buffer.from(wrong) });
  const dialog = page.getByRole('dialog', { name: /^wrong\.json has \d errors$/ });
  await dialog.waitFor();
  const marked = await dialog.locator('.code-line.wrong').allTextContents();
  assert.ok(marked.some((line) => line.includes('"samples": 0')) && marked.some((line) => line.includes('"radios"')), marked.join('\n'));
  assert.match(await dialog.textContent(), /radius/, 'the fix is named');
  await checkAccessibility(page, 'errors of a file');
  await page.keyboard.press('Escape');
  // The same by dropping.
  const transfer = await page.evaluateHandle((content) => {
    const data = new DataTransfer();
    data.items.add(new File([content], 'dropped.json', { type: 'application/json' }));
    return data;
  }, text.replace('from a file', 'dropped'));
  await page.dispatchEvent('room-jobs', 'dragenter', { dataTransfer: transfer });
  await page.getByText('Drop job files to submit them').waitFor();
  await page.dispatchEvent('room-jobs', 'drop', { dataTransfer: transfer });
  await row(page, 'dropped').waitFor();
}

export async function a_phone_selects_and_acts_by_touch() {
  await empty();
  await farm.submit(smallJob('first'));
  await farm.submit(smallJob('second'));
  const page = await open(farm, '#/jobs', { size: PHONE, theme: 'dark' });
  await row(page, 'first').waitFor();
  await row(page, 'first').locator('label').tap();
  await page.getByRole('toolbar', { name: 'Actions for the selected jobs' }).getByRole('button', { name: 'Pause' }).tap();
  await state(page, 'first', 'paused');
  await row(page, 'second').locator('.state').tap();
  await inRoom(page, 'second');
}

export async function a_selection_by_the_mouse_extends_with_shift() {
  await empty();
  for (let number = 1; number <= 6; number += 1) await farm.submit(smallJob(`job ${number}`));
  const page = await open(farm);
  await row(page, 'job 1').waitFor();
  const box = (name) => row(page, name).locator('.cell.box label');
  await box('job 5').click();
  await box('job 2').click({ modifiers: ['Shift'] });
  await page.getByText('4 selected').waitFor();
  await row(page, 'job 3').locator('.state').click({ modifiers: ['Control'] });
  await page.getByText('3 selected').waitFor();
  await until('one fewer', async () => (await row(page, 'job 3').getAttribute('aria-selected')) === 'false');
  await page.getByLabel('Select all jobs that are shown').click();
  await page.getByText('6 selected').waitFor();
  await page.keyboard.press('Escape');
  await page.getByText('6 selected').waitFor({ state: 'hidden' });
}
