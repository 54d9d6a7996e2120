// A server that dies under the page and comes back, and a farm with ten thousand jobs.

import assert from 'node:assert/strict';
import { checkAccessibility, checkTime, inRoom, open } from '../browser.js';
import { Farm, smallJob, until } from '../farm.js';

const JOBS = 10_000;
const AT_ONCE = 24;
const FRAMES = 180;
/** Time of a frame at 60 a second. */
const FRAME_MS = 1000 / 60;

/** Errors of requests to a server that is not there. */
const GONE = [/ERR_CONNECTION|ERR_INCOMPLETE_CHUNKED_ENCODING|ERR_EMPTY_RESPONSE|ERR_NETWORK|ERR_SOCKET|502|Failed to load resource/];

export async function a_killed_server_is_told_and_found_again() {
  const farm = await Farm.start(['--workers', '0']);
  try {
    const { id } = await farm.submit(smallJob('before the kill'));
    const page = await open(farm, '#/jobs', { expected: GONE });
    const row = (name) => page.locator('.job-row:visible').getByRole('link', { name, exact: true });
    await row('before the kill').waitFor();
    await page.getByRole('img', { name: /^Live/ }).waitFor();
    farm.kill();
    const notice = page.locator('.notice');
    await notice.waitFor();
    await until('the age', async () => /What you see is [\d.]+ s old/.test(await notice.textContent()));
    await checkAccessibility(page, 'a farm that does not answer');
    await page.locator('.job-list').focus();
    await page.keyboard.press('Home');
    await page.keyboard.press('p');
    await page.getByText('the farm does not answer').first().waitFor();
    await row('before the kill').waitFor();
    await farm.serve();
    await farm.submit(smallJob('after the kill'));
    await page.getByRole('button', { name: 'Try now' }).click({ timeout: 2000 }).catch(() => {});
    await notice.waitFor({ state: 'hidden' });
    await row('after the kill').waitFor();
    await page.goto(`${farm.address}/#/jobs/${id}`);
    await inRoom(page, 'before the kill');
    farm.kill();
    await notice.waitFor();
    await farm.serve();
    await farm.send('POST', `/v1/jobs/${id}/pause`);
    await notice.waitFor({ state: 'hidden' });
    await until('the change', async () => (await page.locator('.job-title .state').textContent()) === 'paused');
  } finally {
    farm.stop();
  }
}

export async function a_page_that_is_opened_before_the_server_answers_waits_for_it() {
  const farm = await Farm.start(['--workers', '0']);
  try {
    const page = await open(farm, '#/jobs', { expected: GONE });
    await inRoom(page, 'Jobs');
    await page.context().route('**/v1/caller', (route) => route.abort());
    await page.reload();
    await page.getByRole('heading', { name: 'The farm could not be loaded' }).waitFor();
    await page.context().unroute('**/v1/caller');
    await inRoom(page, 'Jobs');
  } finally {
    farm.stop();
  }
}

export async function ten_thousand_jobs_scroll_at_sixty_frames_a_second() {
  const farm = await Farm.start(['--workers', '0']);
  try {
    const begin = Date.now();
    const body = JSON.stringify(smallJob('job-00000'));
    let next = 0;
    await Promise.all(
      Array.from({ length: AT_ONCE }, async () => {
        while (next < JOBS) {
          const number = next;
          next += 1;
          await farm.submit(body.replace('00000', String(number).padStart(5, '0')));
        }
      }),
    );
    console.log(`        ${JOBS} jobs submitted in ${((Date.now() - begin) / 1000).toFixed(1)} s`);
    const page = await open(farm);
    await inRoom(page, 'Jobs');
    const foot = page.locator('.job-foot');
    await page.locator('.job-row:visible').first().waitFor();
    await page.locator('.job-list').focus();
    await until('all jobs', async () => {
      await page.keyboard.press('End');
      return /^10,000 jobs$/.test(await foot.textContent());
    }, 60_000);
    const session = await page.context().newCDPSession(page);
    await session.send('Performance.enable');
    const work = async () => Object.fromEntries((await session.send('Performance.getMetrics')).metrics.map(({ name, value }) => [name, value]));
    const before = await work();
    const times = await page.evaluate(
      (frames) =>
        new Promise((resolve) => {
          const list = document.querySelector('.job-list');
          list.scrollTop = 0;
          const times = [];
          let last = 0;
          const step = (now) => {
            if (last > 0) times.push(now - last);
            last = now;
            list.scrollTop += 700;
            if (times.length < frames) requestAnimationFrame(step);
            else resolve(times);
          };
          requestAnimationFrame(step);
        }),
      FRAMES,
    );
    const after = await work();
    const perFrame = ((after.TaskDuration - before.TaskDuration) / FRAMES) * 1000;
    const script = ((after.ScriptDuration - before.ScriptDuration) / FRAMES) * 1000;
    const sorted = [...times].sort((a, b) => a - b);
    const at = (part) => sorted[Math.floor(part * (sorted.length - 1))].toFixed(1);
    console.log(`        frames: median ${at(0.5)} ms, 95 % ${at(0.95)} ms, worst ${at(1)} ms; work of a frame ${perFrame.toFixed(1)} ms, of it scripts ${script.toFixed(1)} ms`);
    checkTime(perFrame < FRAME_MS, `a frame takes ${perFrame} ms of the page's thread`);
    checkTime(Number(at(0.5)) < FRAME_MS * 1.5, `the median frame takes ${at(0.5)} ms`);
    const elements = await page.locator('.job-body [role=row]').count();
    assert.ok(elements < 60, `${elements} rows are in the page`);
    // The visible rows belong to their places.
    const jobs = [];
    for (let cursor = ''; cursor !== null; ) {
      const answer = await farm.get(`/v1/jobs?limit=1000${cursor && `&cursor=${cursor}`}`);
      jobs.push(...answer.jobs);
      cursor = answer.next_cursor;
    }
    jobs.sort((a, b) => (a.id < b.id ? 1 : -1));
    const seen = (index, job) => until(`the job in row ${index}`, async () => (await page.locator(`[aria-rowindex="${index}"]:visible .name a`).textContent()) === job.name);
    await page.keyboard.press('Home');
    await seen(2, jobs[0]);
    await page.keyboard.press('End');
    await seen(JOBS + 1, jobs[JOBS - 1]);
    await page.keyboard.press('/');
    // Words are looked for one by one, and five digits may be in some id of ten thousand.
    await page.keyboard.type('job-04321');
    await until('one job', async () => (await page.locator('.job-body [role=row]:visible').count()) === 1);
  } finally {
    farm.stop();
  }
}
