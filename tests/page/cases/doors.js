// Access: keys and what they may do, hostile names, other origins, and a read-only page.

import assert from 'node:assert/strict';
import { createServer } from 'node:http';
import { checkAccessibility, inRoom, open } from '../browser.js';
import { environment, Farm, freePort, program, smallJob, until } from '../farm.js';

const HOSTILE = '<img src=x onerror="document.title=\'owned\'"><script>document.title="owned"</script>';

let locked;
/** A farm with keys. */
async function startLocked() {
  if (locked) return locked;
  const farm = new Farm();
  const [admin, anna, reader, host] = [farm.newKey('admin', 'admin'), farm.newKey('anna', 'submit'), farm.newKey('reader', 'read'), farm.newKey('host', 'worker')];
  farm.key = admin;
  farm.port = await freePort();
  farm.flags = ['--workers', '0'];
  await farm.serve();
  await farm.submit(smallJob('of anna'), anna);
  await farm.submit(smallJob('of admin'), admin);
  locked = { farm, admin, anna, reader, host };
  return locked;
}

let farm;
const start = async () => (farm ??= await Farm.start());
export const after = () => {
  locked?.farm.stop();
  farm?.stop();
};

const signIn = async (page, key, isKept = false) => {
  await page.getByRole('dialog', { name: 'This farm needs a key' }).waitFor();
  await page.getByLabel('Key', { exact: true }).fill(key);
  if (isKept) await page.getByLabel(/Keep it/).check();
  await page.keyboard.press('Enter');
};
const jobLink = (page, name) => page.locator('.job-row:visible').getByRole('link', { name, exact: true });
const storage = (page) => page.evaluate(() => JSON.stringify({ ...localStorage, ...sessionStorage }) + document.cookie);

export async function a_key_is_asked_for_and_lives_in_memory_unless_kept() {
  const { farm: closed, admin } = await startLocked();
  const page = await open(closed, '#/jobs', { expected: [/401/] });
  await page.getByRole('dialog', { name: 'This farm needs a key' }).waitFor();
  assert.equal(await page.evaluate(() => document.activeElement?.id), 'key', 'the field has the focus');
  assert.equal(await page.locator('.job-row').count(), 0, 'nothing is seen without a key');
  await checkAccessibility(page, 'the sign-in');
  await signIn(page, `sdf_${'x'.repeat(43)}`);
  await until('the refusal', async () => (await page.getByRole('alert').textContent()).length > 10);
  await signIn(page, 'not a key');
  await page.getByText('A key is sdf_').waitFor();
  await signIn(page, admin);
  await jobLink(page, 'of anna').waitFor();
  assert.ok(!(await storage(page)).includes('sdf_'), 'the key is in no storage');
  assert.deepEqual(await page.context().cookies(), [], 'there is no cookie');
  await page.reload();
  await signIn(page, admin, true);
  await jobLink(page, 'of anna').waitFor();
  await page.reload();
  await jobLink(page, 'of anna').waitFor();
  assert.ok(await page.evaluate(() => sessionStorage.getItem('sdfarm.key')?.startsWith('sdf_')));
  assert.ok(!(await page.evaluate(() => JSON.stringify(localStorage))).includes('sdf_'), 'never where other tabs see it');
  await page.getByRole('button', { name: /^Key of admin/ }).click();
  await page.getByRole('menuitem', { name: 'Forget the key' }).click();
  await page.getByRole('dialog', { name: 'This farm needs a key' }).waitFor();
  assert.ok(!(await storage(page)).includes('sdf_'));
}

export async function a_submitters_key_shows_its_jobs_alone() {
  const { farm: closed, anna } = await startLocked();
  const page = await open(closed, '#/jobs', { expected: [/401/] });
  await signIn(page, anna);
  await jobLink(page, 'of anna').waitFor();
  assert.equal(await jobLink(page, 'of admin').count(), 0);
  await page.goto(`${closed.address}/#/farm`);
  await page.getByRole('heading', { name: 'Your key does not show the farm' }).waitFor();
  assert.equal(await page.getByRole('heading', { name: 'Keys' }).count(), 0);
  await page.goto(`${closed.address}/#/jobs`);
  await page.getByRole('button', { name: 'Actions for of anna' }).click();
  await page.getByRole('menuitem', { name: 'Pause' }).click();
  await until('the pause', async () => (await closed.get('/v1/jobs')).jobs.find((job) => job.name === 'of anna').paused);
  await page.keyboard.press('u');
}

export async function a_readers_key_sees_all_and_changes_nothing() {
  const { farm: closed, reader } = await startLocked();
  const page = await open(closed, '#/jobs', { expected: [/401/] });
  await signIn(page, reader);
  await jobLink(page, 'of admin').waitFor();
  assert.equal(await page.getByRole('button', { name: 'Submit a file' }).isVisible(), false);
  await page.getByRole('button', { name: 'Actions for of admin' }).click();
  assert.deepEqual(await page.getByRole('menuitem').allTextContents(), ['Open', 'Edit a copy']);
  await page.keyboard.press('Escape');
  await page.locator('.job-list').focus();
  await page.keyboard.press('Home');
  for (const key of ['p', 'c', 'Delete']) await page.keyboard.press(key);
  await page.getByText('applies to none of the chosen jobs').first().waitFor();
  assert.equal(await page.getByRole('dialog').count(), 0);
  await page.goto(`${closed.address}/#/farm`);
  await page.getByRole('heading', { level: 2, name: 'Workers' }).waitFor();
  for (const name of ['Pause the farm', 'One more worker on this machine', 'New key']) assert.equal(await page.getByRole('button', { name }).isVisible(), false, name);
  assert.equal(await page.getByRole('heading', { name: 'Audit log' }).count(), 0);
}

export async function a_workers_key_is_told_that_it_shows_nothing() {
  const { farm: closed, host } = await startLocked();
  const page = await open(closed, '#/jobs', { expected: [/401|403/] });
  await signIn(page, host);
  await page.getByRole('heading', { name: 'The jobs could not be read' }).waitFor();
  await page.getByText(/scope/).first().waitFor();
}

export async function keys_are_made_shown_once_and_revoked() {
  const { farm: closed, admin } = await startLocked();
  const page = await open(closed, '#/farm', { expected: [/401/], permissions: ['clipboard-read', 'clipboard-write'] });
  // The list of keys comes late: the dialog must not take the farm for one without keys.
  await page.route('**/v1/keys', async (route) => {
    if (route.request().method() === 'GET') await new Promise((done) => setTimeout(done, 1000));
    await route.continue();
  });
  await signIn(page, admin);
  await page.getByRole('button', { name: 'New key' }).click();
  await page.getByLabel('Name of its owner').fill('bert');
  await page.getByRole('checkbox', { name: /^read/ }).check();
  await page.getByLabel('Expires').selectOption('In 30 days');
  await checkAccessibility(page, 'a new key');
  await page.getByRole('button', { name: 'Create the key' }).click();
  const field = page.getByLabel('The key', { exact: true });
  await field.waitFor();
  const secret = await field.inputValue();
  assert.match(secret, /^sdf_.{43}$/);
  await page.getByRole('button', { name: 'Copy' }).click();
  await until('the copy', async () => (await page.evaluate(() => navigator.clipboard.readText())) === secret);
  assert.equal((await closed.send('GET', '/v1/jobs', undefined, secret)).jobs.length, 2);
  await page.getByRole('button', { name: 'I have kept it' }).click();
  const row = page.locator('tr', { hasText: 'bert' }).first();
  assert.match(await row.textContent(), /submit, read.*live/);
  assert.ok(!(await page.content()).includes(secret), 'it is shown only once');
  await row.getByRole('button', { name: 'Revoke' }).click();
  await page.getByRole('dialog', { name: 'Revoke the key of bert?' }).getByRole('button', { name: 'Revoke it' }).click();
  await until('the revocation', async () => (await fetch(`${closed.address}/v1/jobs`, { headers: { authorization: `Bearer ${secret}` } })).status === 401);
}

export async function a_revoked_key_is_asked_for_again() {
  const { farm: closed, admin } = await startLocked();
  const issued = await closed.send('POST', '/v1/keys', { name: 'short', scopes: ['read'] }, admin);
  const page = await open(closed, '#/jobs', { expected: [/401/, /ERR_INCOMPLETE_CHUNKED_ENCODING|ERR_NETWORK|ERR_CONNECTION/] });
  await signIn(page, issued.secret);
  await jobLink(page, 'of admin').waitFor();
  await closed.send('DELETE', `/v1/keys/${issued.key.id}`, undefined, admin);
  await page.getByRole('dialog', { name: 'This farm needs a key' }).waitFor();
  await signIn(page, admin);
  await jobLink(page, 'of admin').waitFor();
}

export async function the_first_key_closes_the_farm_and_keeps_the_page_open() {
  const fresh = await Farm.start(['--workers', '0']);
  try {
    const page = await open(fresh, '#/farm', { expected: [/401/] });
    await page.getByRole('button', { name: 'New key' }).click();
    await page.getByText('It is the first key of this farm').waitFor();
    await page.getByLabel('Name of its owner').fill('root');
    await page.getByRole('button', { name: 'Create the key' }).click();
    fresh.key = await page.getByLabel('The key', { exact: true }).inputValue();
    await page.getByRole('button', { name: 'I have kept it' }).click();
    await until('the closed door', async () => (await fetch(`${fresh.address}/v1/jobs`)).status === 401);
    await page.goto(`${fresh.address}/#/jobs`);
    await page.getByRole('heading', { name: 'No jobs yet' }).waitFor();
    await page.getByRole('button', { name: /^Key of root/ }).waitFor();
  } finally {
    fresh.stop();
  }
}

export async function hostile_names_are_text_in_every_room() {
  await start();
  const job = await farm.render({ ...smallJob(HOSTILE), scene: { ...smallJob().scene, materials: { [HOSTILE]: { diffuse: { kd: '#d9472b' } } }, objects: [{ material: HOSTILE, shape: { sphere: { radius: 1 } } }] } });
  const wrong = JSON.stringify({ ...smallJob(HOSTILE), [HOSTILE]: 1 });
  const page = await open(farm, '#/jobs', { expected: [/422/, /404.*%3Cimg/] });
  await jobLink(page, HOSTILE).waitFor();
  await page.locator('.job-row:visible').getByRole('button', { name: `Actions for ${HOSTILE}` }).click();
  await page.getByRole('menuitem', { name: 'Delete…' }).click();
  await page.getByRole('dialog', { name: `Delete ${HOSTILE}?` }).getByRole('button', { name: 'Cancel', exact: true }).click();
  await page.locator('input[type=file]').setInputFiles({ name: `${HOSTILE.slice(0, 30)}.json`, mimeType: 'application/json', buffer: Buffer.from(wrong) });
  await page.getByRole('dialog').waitFor();
  await page.keyboard.press('Escape');
  await jobLink(page, HOSTILE).click();
  await inRoom(page, HOSTILE);
  await page.locator('.code-line').first().waitFor();
  assert.equal(await page.title(), `${HOSTILE} – sdfarm`);
  // A worker's name is free text, and so is what it says of an error.
  const { spawn } = await import('node:child_process');
  const worker = spawn(program, ['worker', '--server', farm.address, '--name', HOSTILE, '--device', 'cpu', '--threads', '1'], { env: environment, stdio: 'ignore' });
  try {
    await until('the worker', async () => (await farm.get('/v1/workers')).workers.some((each) => each.name.includes('<img')), 60_000);
    await page.goto(`${farm.address}/#/farm`);
    await page.locator('.workers tbody tr', { hasText: '<img' }).waitFor();
    await page.getByRole('button', { name: 'Actions for <img' }).click();
    await page.getByRole('menuitem', { name: 'Quarantine' }).click();
    await page.getByRole('dialog').getByRole('button', { name: 'Cancel' }).click();
  } finally {
    worker.kill('SIGKILL');
  }
  await page.goto(`${farm.address}/#/help?kind=${encodeURIComponent(HOSTILE)}`);
  await inRoom(page, 'Help');
  await page.goto(`${farm.address}/#/jobs/${encodeURIComponent(HOSTILE)}`).catch(() => {});
  await page.getByRole('heading', { name: 'No such job' }).waitFor();
  const injected = await page.evaluate(() => document.querySelectorAll('img[src="x"], main script').length);
  assert.equal(injected, 0);
  assert.notEqual(await page.title(), 'owned');
  assert.equal((await farm.get(`/v1/jobs/${job.id}`)).name, HOSTILE);
}

export async function another_origin_neither_reads_nor_changes_anything() {
  await start();
  const { id } = await farm.submit(smallJob('private'));
  const jobs = async () => (await farm.get('/v1/jobs')).jobs.length;
  const before = await jobs();
  const port = await freePort();
  const attacker = createServer((request, response) => {
    response.setHeader('content-type', 'text/html');
    response.end('<!doctype html><title>attacker</title><body></body>');
  });
  await new Promise((resolve) => attacker.listen(port, '127.0.0.1', resolve));
  try {
    const page = await open({ address: `http://127.0.0.1:${port}` }, '', { expected: [/CORS|Failed to load|frame|ERR_BLOCKED|Refused/i] });
    const target = farm.address;
    const results = await page.evaluate(
      async ({ target, id, job }) => {
        const attempt = async (work) => {
          try {
            return await work();
          } catch (error) {
            return `refused: ${error.name}`;
          }
        };
        const read = (path, options) => attempt(async () => (await fetch(target + path, options)).text());
        const frame = (path) =>
          new Promise((resolve) => {
            const element = document.createElement('iframe');
            element.onload = () => {
              try {
                resolve(String(element.contentDocument?.title ?? 'hidden'));
              } catch {
                resolve('hidden');
              }
            };
            element.src = target + path;
            document.body.append(element);
            setTimeout(() => resolve('hidden'), 2000);
          });
        const opened = window.open(`${target}/`);
        await new Promise((resolve) => setTimeout(resolve, 800));
        let handle = 'closed';
        try {
          handle = opened === null || opened.closed ? 'closed' : String(opened.document.title);
        } catch {
          handle = 'hidden';
        }
        return {
          reads: [await read('/v1/jobs'), await read('/v1/caller'), await read('/v1/events'), await read('/ui/main.js')],
          writes: [
            await read('/v1/jobs', { method: 'POST', mode: 'no-cors', body: job }),
            await read(`/v1/jobs/${id}/cancel`, { method: 'POST', mode: 'no-cors' }),
            await read('/v1/farm/pause', { method: 'POST', mode: 'no-cors' }),
            await read(`/v1/jobs/${id}`, { method: 'DELETE' }),
            await read('/v1/preview', { method: 'POST', mode: 'no-cors', body: job }),
          ],
          frame: await frame('/'),
          handle,
        };
      },
      { target, id, job: JSON.stringify(smallJob('forged')) },
    );
    for (const text of results.reads) assert.match(text, /^refused: /, JSON.stringify(results));
    for (const text of results.writes) assert.ok(text === '' || text.startsWith('refused: '), JSON.stringify(results));
    assert.equal(results.frame, 'hidden');
    assert.ok(['closed', 'hidden'].includes(results.handle), results.handle);
    for (const each of page.context().pages().slice(1)) await each.close();
    page.faults.splice(0, page.faults.length, ...page.faults.filter((fault) => !fault.startsWith('a request to another host')));
  } finally {
    attacker.close();
  }
  assert.equal(await jobs(), before, 'no job was added or deleted');
  assert.ok(!['cancelled'].includes((await farm.get(`/v1/jobs/${id}`)).state));
  assert.equal((await farm.get('/v1/farm')).paused, false);
}

export async function a_read_only_page_shows_no_action_and_the_server_refuses_them() {
  const closed = await Farm.start(['--workers', '0', '--read-only-page']);
  try {
    await closed.submit(smallJob('to look at'));
    const page = await open(closed, '#/jobs', { expected: [/403/] });
    await jobLink(page, 'to look at').waitFor();
    assert.equal(await page.getByRole('button', { name: 'Submit a file' }).isVisible(), false);
    await page.getByRole('button', { name: 'Actions for to look at' }).click();
    assert.deepEqual(await page.getByRole('menuitem').allTextContents(), ['Open', 'Edit a copy']);
    await page.keyboard.press('Escape');
    const status = await page.evaluate(async () => (await fetch('/v1/farm/pause', { method: 'POST' })).status);
    assert.equal(status, 403);
    await page.goto(`${closed.address}/#/farm`);
    await page.getByText('This page is read-only').waitFor();
    assert.equal(await page.getByRole('button', { name: 'Pause the farm' }).isVisible(), false);
  } finally {
    closed.stop();
  }
}
