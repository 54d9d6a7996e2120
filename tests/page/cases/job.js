// The room Job: a picture that grows, its pixels, frames, comparison, verification, errors, file, links and actions.

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { PHONE, checkAccessibility, checkWidth, inRoom, open } from '../browser.js';
import { Farm, smallJob, until } from '../farm.js';

let farm;
const start = async () => (farm ??= await Farm.start());
export const after = () => farm?.stop();

let film;
/** A finished job of five frames, each of another color. */
const finished = async () => {
  await start();
  return (film ??= await farm.render(smallJob('film', { frames: { count: 5, fps: 10 }, image: { width: 96, height: 60, samples: 2 }, scene: { camera: { position: [0, 1, { keys: [[0, 4], [0.4, 7]] }], look_at: [0, 0, 0] } } })));
};

/** Number of different colors in the picture that is shown. */
const colors = (page) =>
  page.evaluate(() => {
    const canvas = document.querySelector('canvas.viewer-picture');
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    const seen = new Set();
    for (let at = 0; at < data.length; at += 4) seen.add((data[at] << 16) | (data[at + 1] << 8) | data[at + 2]);
    return seen.size;
  });
const shown = (page) => until('the picture', async () => (await colors(page)) > 8);
/** Waits until a layer is shown as the server draws it, with these stops of exposure. */
const showsLayer = (page, job, layer, stops = 0) =>
  until(`the layer ${layer}`, () =>
    page.evaluate(async (path) => {
      const shown = document.querySelector('canvas.viewer-picture');
      const bitmap = await createImageBitmap(await (await fetch(`${path}&width=${shown.width}`)).blob());
      const canvas = document.createElement('canvas');
      [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
      canvas.getContext('2d').drawImage(bitmap, 0, 0);
      return shown.toDataURL() === canvas.toDataURL();
    }, `/v1/jobs/${job.id}/frames/0/layers/${layer}?exposure=${stops}`));
const transform = (page) => page.evaluate(() => document.querySelector('.viewer-stage').style.transform);

export async function a_picture_grows_while_it_is_rendered() {
  await start();
  const scene = JSON.parse(readFileSync('scenes/lantern.json', 'utf8'));
  const { id } = await farm.submit({ ...scene, name: 'growing', image: { width: 640, height: 400, samples: 60 } });
  const page = await open(farm, `#/jobs/${id}`, { expected: [/429|503/] });
  await inRoom(page, 'growing');
  await shown(page);
  await until('a rectangle that is rendered', async () => (await page.locator('.mark.leased').count()) > 0 || (await farm.get(`/v1/jobs/${id}`)).state === 'succeeded');
  const before = Number(await page.getByRole('progressbar', { name: 'Progress' }).getAttribute('aria-valuenow'));
  assert.ok(before < 100, 'it is seen before it is finished');
  await until('the end', async () => (await page.locator('.job-title .state').textContent()) === 'succeeded', 90_000);
  await until('the whole picture', () => page.evaluate(() => document.querySelector('canvas.viewer-picture').width === 640));
  await until('no rectangle', async () => (await page.locator('.mark.leased').count()) === 0);
  assert.match(await page.locator('.job-status').textContent(), /100 % · \d+ of \d+ tiles · took /);
}

export async function the_picture_is_zoomed_moved_and_read_to_the_pixel() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await shown(page);
  const surface = page.locator('.viewer-surface');
  const fitted = await transform(page);
  await surface.focus();
  await page.keyboard.press('+');
  assert.notEqual(await transform(page), fitted);
  await page.keyboard.press('ArrowRight');
  await page.keyboard.press('0');
  assert.equal(await transform(page), fitted, '0 fits');
  await page.keyboard.press('1');
  assert.match(await page.locator('.viewer-zoom').textContent(), /100 %/);
  await page.getByRole('button', { name: 'Zoom in' }).click();
  assert.match(await page.locator('.viewer-zoom').textContent(), /150 %/);
  await page.getByRole('button', { name: /fit the picture/ }).click();
  const box = await surface.boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.wheel(0, -400);
  assert.notEqual(await transform(page), fitted, 'the wheel zooms');
  const zoomed = await transform(page);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 + 40, box.y + box.height / 2 + 10);
  await page.mouse.up();
  assert.notEqual(await transform(page), zoomed, 'a drag moves it');
  await page.keyboard.press('0');
  // The value of a pixel, from the stored file.
  await page.mouse.move(box.x + box.width / 2 + 1, box.y + box.height / 2 + 1);
  const values = page.locator('.viewer-values');
  await until('the stored values', async () => /48, 30.*R [\d.e-]+ +G/.test(await values.textContent()));
  const stored = await farm.get(`/v1/jobs/${job.id}/frames/0/pixel?x=48&y=30`);
  assert.ok(Object.keys(stored.values).length >= 3, JSON.stringify(stored));
  await surface.focus();
  await page.keyboard.press('Shift+ArrowRight');
  await until('the next pixel', async () => /^49, 30/.test(await values.textContent()));
}

export async function exposure_and_layers_change_what_is_seen() {
  await start();
  const job = await farm.render({ ...smallJob('layers'), image: { width: 64, height: 40, samples: 1, format: 'exr', layers: ['depth', 'normal'] } });
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'layers');
  await shown(page);
  // Until the layers are known, a thumbnail is shown.
  await showsLayer(page, job, 'color');
  await page.getByLabel('Layer').selectOption('normal');
  await showsLayer(page, job, 'normal');
  await page.getByLabel('Layer').selectOption('color');
  await showsLayer(page, job, 'color');
  await page.getByLabel('Exposure in stops').fill('2');
  await showsLayer(page, job, 'color', 2);
  await page.getByTitle('No exposure').click();
  await showsLayer(page, job, 'color');
}

export async function a_light_group_is_a_layer_that_an_exposure_brightens() {
  await start();
  const lights = [{ directional: { direction: [1, 2, 1], group: 'key' } }, { directional: { direction: [-1, 2, 1], color: [0, 0, 1] } }];
  const job = await farm.render(smallJob('groups', { scene: { integrator: { path: {} }, lights }, image: { format: 'exr', light_groups: ['key'] } }));
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'groups');
  await shown(page);
  const layers = page.getByLabel('Layer');
  await until('the layers', async () => (await layers.locator('option').allTextContents()).join(' ') === 'color light.key light.rest');
  await showsLayer(page, job, 'color');
  for (const layer of ['light.key', 'light.rest', 'light.key']) {
    await layers.selectOption(layer);
    await showsLayer(page, job, layer);
  }
  await page.getByLabel('Exposure in stops').fill('2');
  await showsLayer(page, job, 'light.key', 2);
}

export async function exposure_of_a_png_multiplies_its_light() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await shown(page);
  const surface = page.locator('.viewer-surface');
  const dark = await surface.screenshot();
  await page.getByLabel('Exposure in stops').fill('3');
  assert.equal(await page.evaluate(() => document.querySelector('#exposure feFuncR').getAttribute('slope')), '8');
  assert.notDeepEqual(await surface.screenshot(), dark);
}

export async function frames_are_stepped_scrubbed_and_played() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await shown(page);
  const number = page.locator('.film-controls .mono');
  const at = (wanted) => until(`frame ${wanted}`, async () => (await number.textContent()) === `${wanted} / 4`);
  await at(0);
  await page.keyboard.press('.');
  await at(1);
  assert.equal(new URL(page.url()).hash, `#/jobs/${job.id}?frame=1`);
  await page.keyboard.press(',');
  await at(0);
  await page.getByRole('slider', { name: 'Frame', exact: true }).fill('3');
  await at(3);
  await page.getByRole('option', { name: 'Frame 2, stored' }).click();
  await at(2);
  await page.locator('.film').focus();
  await page.keyboard.press('End');
  await at(4);
  await page.keyboard.press('Home');
  await page.keyboard.press('l');
  assert.equal(await page.getByRole('button', { name: 'Loop' }).getAttribute('aria-pressed'), 'false');
  await page.getByRole('button', { name: 'Play' }).click();
  await at(4);
  await page.getByRole('button', { name: 'Play' }).waitFor();
  await page.getByRole('button', { name: 'Loop' }).click();
  await page.keyboard.press('k');
  await at(1);
  await page.keyboard.press('k');
  await page.reload();
  await inRoom(page, 'film');
  await until('the frame of the address', async () => /^[1-4] \/ 4$/.test(await number.textContent()));
}

export async function two_jobs_are_compared_by_a_wipe() {
  const job = await finished();
  const other = await farm.render({ ...smallJob('other'), scene: { ...smallJob().scene, materials: { clay: { diffuse: { kd: '#2b47d9' } } } } });
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await shown(page);
  await page.keyboard.press('w');
  const dialog = page.getByRole('dialog', { name: 'Compare with' });
  await dialog.getByRole('button', { name: 'other' }).click();
  const divider = page.getByRole('slider', { name: /shows this job/ });
  await divider.waitFor();
  assert.match(page.url(), new RegExp(`with=${other.id}`));
  const clip = () => page.evaluate(() => document.querySelector('.viewer-other').style.clipPath);
  const half = await clip();
  await divider.focus();
  await page.keyboard.press('ArrowRight');
  assert.notEqual(await clip(), half);
  await checkAccessibility(page, 'a comparison');
  await page.reload();
  await divider.waitFor();
  await page.getByRole('button', { name: 'Right: other' }).click();
  await divider.waitFor({ state: 'hidden' });
}

export async function a_job_says_what_it_is_based_on_and_what_it_kept() {
  await start();
  const scene = smallJob('recorded', { image: { width: 192, height: 120 } });
  scene.scene.objects.push({ material: 'clay', shape: { translate: { by: [2.2, 0, 0], child: { sphere: { radius: 0.3 } } } } });
  const submit = async (job, query) => {
    const { id } = await farm.send('POST', `/v1/jobs?${query}`, job);
    return until('the end', async () => {
      const now = await farm.get(`/v1/jobs/${id}`);
      return now.state === 'succeeded' && now;
    });
  };
  const first = await submit(scene, 'record=true');
  const edited = structuredClone({ ...scene, name: 'edited' });
  edited.scene.objects[1].shape.translate.child.sphere.radius = 0.2;
  const second = await submit(edited, `based_on=${first.id}`);
  assert.equal(second.based_on, first.id);
  const page = await open(farm, `#/jobs/${second.id}`);
  await inRoom(page, 'edited');
  const facts = page.locator('.job-side .facts');
  await until('what was kept', async () => (await facts.textContent()).includes(`Kept tiles${second.tiles_kept} of ${second.tiles.total}, of the job before`));
  await facts.getByRole('link', { name: 'the job before' }).click();
  await inRoom(page, 'recorded');
  await page.getByRole('button', { name: 'Right: edited' }).waitFor();
}

export async function pixels_that_are_not_what_the_job_says_are_framed_in_red() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await shown(page);
  // The server checks the hash of what it has stored, so that only its answer can be forged here.
  await page.route('**/verify?*', async (route) => {
    const answer = await (await route.fetch()).json();
    await route.fulfill({ json: { ...answer, same: false, differs: [{ x: 10, y: 20, width: 1, height: 1 }], findings: ['the pixel 10, 20 is brighter'] } });
  });
  await page.getByRole('button', { name: 'Verify' }).click();
  const dialog = page.getByRole('dialog', { name: 'The picture is not what its job says' });
  await dialog.waitFor();
  assert.match(await dialog.textContent(), /1 tile of the 2 .*framed in red.*the pixel 10, 20/s);
  await page.keyboard.press('Escape');
  await page.locator('.mark.differs').waitFor();
}

export async function a_picture_is_verified() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await page.getByRole('button', { name: 'Verify' }).click();
  const dialog = page.getByRole('dialog', { name: 'The picture is what its job says' });
  await dialog.waitFor();
  assert.match(await dialog.textContent(), /every byte is the same.*Release/s);
  await checkAccessibility(page, 'a verification');
}

export async function the_time_line_has_the_tiles_as_a_table_too() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await page.locator('.time-line canvas').waitFor();
  await until('the summary', async () => /\d+ tiles? by 1 worker in /.test(await page.locator('.tile-line p').textContent()));
  await page.locator('.tile-line summary').click();
  const first = page.locator('.tile-line tbody tr').first();
  await first.waitFor();
  assert.match(await first.textContent(), /cpu.*×.*done/s);
  await page.getByLabel('Frames of the time line').selectOption('all');
  await until('all frames', async () => /^5 tiles/.test(await page.locator('.tile-line p').textContent()));
  await checkAccessibility(page, 'the table of tiles');
}

export async function the_file_is_shown_and_downloaded_as_submitted() {
  await start();
  const text = `${JSON.stringify(smallJob('with a file'), null, 2).replace('"image"', '// a comment\n  "image"')}\n`;
  const response = await fetch(`${farm.address}/v1/jobs`, { method: 'POST', headers: { 'content-type': 'application/json' }, body: text });
  // Job files of the server may have no comments.
  const source = response.ok ? text : JSON.stringify(smallJob('with a file'), null, 2);
  const { id } = response.ok ? await response.json() : await farm.submit(source);
  await until('the end', async () => (await farm.get(`/v1/jobs/${id}`)).state === 'succeeded');
  const page = await open(farm, `#/jobs/${id}`);
  await inRoom(page, 'with a file');
  const lines = page.locator('.code-view .code-line');
  await lines.first().waitFor();
  assert.equal(await page.evaluate(() => document.querySelector('.code-inner').offsetHeight / 20), source.trimEnd().split('\n').length);
  assert.equal(await lines.nth(1).locator('code').textContent(), source.split('\n')[1]);
  const [file] = await Promise.all([page.waitForEvent('download'), page.locator('#job-file').getByRole('button', { name: 'Download' }).click()]);
  assert.equal(file.suggestedFilename(), 'with a file.json');
  assert.equal(readFileSync(await file.path(), 'utf8'), source);
  const [picture] = await Promise.all([page.waitForEvent('download'), page.keyboard.press('d')]);
  const stored = Buffer.from(await (await fetch(`${farm.address}/v1/jobs/${id}/image`)).arrayBuffer());
  assert.ok(readFileSync(await picture.path()).equals(stored), 'the picture is saved as it is stored');
}

export async function a_link_is_shared_that_needs_no_key() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await page.getByRole('button', { name: 'More' }).click();
  await page.getByRole('menuitem', { name: 'Share a link…' }).click();
  await page.getByRole('button', { name: 'Create the link' }).click();
  const field = page.getByLabel('Link', { exact: true });
  await field.waitFor();
  const link = await fetch(await field.inputValue());
  assert.equal(link.headers.get('content-type'), 'image/png');
}

export async function a_jobs_actions_work_by_mouse_and_keyboard() {
  const idle = await Farm.start(['--workers', '0']);
  try {
    const { id } = await idle.submit(smallJob('waiting'));
    // A preview may be on its way when the job is deleted.
    const page = await open(idle, `#/jobs/${id}`, { expected: [/429|503/, /404.*\/preview/] });
    await inRoom(page, 'waiting');
    const state = (wanted) => until(wanted, async () => (await page.locator('.job-title .state').textContent()) === wanted);
    await page.getByRole('button', { name: 'Pause' }).click();
    await state('paused');
    await page.keyboard.press('u');
    await state('queued');
    await page.keyboard.press('y');
    await page.getByLabel('Priority, from').fill('9');
    await page.keyboard.press('Enter');
    await until('the priority', async () => (await idle.get(`/v1/jobs/${id}`)).priority === 9);
    await page.getByRole('dialog').waitFor({ state: 'detached' });
    await page.getByRole('button', { name: 'Cancel' }).click();
    await page.getByRole('button', { name: 'Cancel the job' }).click();
    await state('cancelled');
    const copy = page.getByRole('link', { name: 'Edit a copy' });
    assert.equal(await copy.getAttribute('href'), `#/studio?job=${id}`);
    await page.keyboard.press('Delete');
    await page.getByRole('button', { name: 'Delete the job' }).click();
    await inRoom(page, 'Jobs');
    assert.equal((await idle.get('/v1/jobs')).jobs.length, 0);
  } finally {
    idle.stop();
  }
}

export async function a_job_that_does_not_exist_is_said_so() {
  await start();
  const page = await open(farm, '#/jobs/01a21230-92be-74e7-b891-2980ceb20af1', { expected: [/404/] });
  await page.getByRole('heading', { name: 'No such job' }).waitFor();
  await page.getByRole('link', { name: 'All jobs' }).last().click();
  await inRoom(page, 'Jobs');
}

export async function another_room_is_entered_while_frames_are_shown() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`);
  await inRoom(page, 'film');
  await shown(page);
  // The frame changes before the page hears of its new address.
  await page.evaluate(() => {
    location.hash = '#/farm';
    document.querySelector('[aria-label^="Next frame"]').click();
  });
  await inRoom(page, 'Farm');
}

export async function a_deleted_job_is_left() {
  await start();
  const { id } = await farm.render(smallJob('to be deleted'));
  const page = await open(farm, `#/jobs/${id}`, { expected: [/404/] });
  await inRoom(page, 'to be deleted');
  await farm.send('DELETE', `/v1/jobs/${id}`);
  await inRoom(page, 'Jobs');
  await page.getByText('to be deleted has been deleted').waitFor();
}

export async function a_phone_shows_all_of_a_job() {
  const job = await finished();
  const page = await open(farm, `#/jobs/${job.id}`, { size: PHONE, theme: 'dark' });
  await inRoom(page, 'film');
  await shown(page);
  await checkWidth(page, 'a job');
  await page.getByRole('button', { name: 'Play' }).tap();
  await until('another frame', async () => !/^0 /.test(await page.locator('.film-controls .mono').textContent()));
}
