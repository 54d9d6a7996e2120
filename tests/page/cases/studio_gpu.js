// The studio's approximate pictures where the GPU, or the server, does not take part: programs that are too long, that do not
// end, and that are refused. The server's exact previews take their place, and the page says why.

import assert from 'node:assert/strict';
import { csg, placeOf, ready, settled, stopFarm, studio, versionOf } from '../studio.js';

export const after = stopFarm;

/** A program that turns as often as its first number says, for each pixel. */
const TURNS = `
struct Dispatch { x: u32, y: u32, width: u32, height: u32, picture_width: u32, first_sample: u32, end_sample: u32, reserved: u32 }
@group(0) @binding(0) var<uniform> dispatch: Dispatch;
@group(0) @binding(1) var<storage, read> numbers: array<u32>;
@group(0) @binding(4) var<storage, read_write> picture: array<u32>;
@compute @workgroup_size(8, 8)
fn render(@builtin(global_invocation_id) place: vec3<u32>) {
  if (place.x >= dispatch.width || place.y >= dispatch.height) { return; }
  var word = place.x;
  for (var turn = 0u; turn < numbers[0]; turn += 1u) { word = word * 1664525u + 1013904223u; }
  picture[(dispatch.y + place.y) * dispatch.picture_width + dispatch.x + place.x] = word | 0xff000000u;
}`;

/** Opens the studio with another answer of the server for programs. */
async function withShader(answer, options = {}) {
  const page = await studio({ text: null, ...options });
  const widths = [];
  await page.route('**/v1/shader*', async (route) => {
    const { searchParams } = new URL(route.request().url());
    const width = Number(searchParams.get('width'));
    widths.push(width);
    const { status = 200, json } = answer({ known: searchParams.get('program'), width });
    const shader = { program: 'one', wgsl: null, uniforms: [1], table: [], samples: 1, width, height: Math.ceil((width * 9) / 16), exact: false, reason: null };
    await route.fulfill(status === 200 ? { json: { ...shader, ...json } } : { status, contentType: 'application/problem+json', body: JSON.stringify(json) });
  });
  await page.reload();
  await ready(page, csg);
  await settled(page);
  return { page, widths };
}

/** A drag of a number shows exact pictures on the way. */
async function dragsExactly(page) {
  const at = await placeOf(page, '"fov": ', -1);
  const version = await versionOf(page);
  await page.mouse.move(at.x, at.y);
  await page.mouse.down();
  for (let step = 1; (await versionOf(page)) < version + 2; step += 1) {
    assert.ok(step < 200, 'no exact picture is shown during the drag');
    await page.mouse.move(at.x + 20 + (step % 40), at.y);
    await page.waitForTimeout(50);
  }
  assert.equal(await page.locator('.badge').textContent(), 'Exact');
  await page.mouse.up();
  await settled(page);
}

/** Waits for the reason why the GPU is not used. */
const said = (page, pattern) => page.waitForFunction((each) => new RegExp(each).test(document.querySelector('.gpu').title), pattern.source);

export async function a_picture_that_takes_a_gpu_too_long_is_left_to_the_server_until_the_scene_is_another() {
  let program = { program: 'slow', turns: 5_000_000 };
  const { page, widths } = await withShader(({ known }) => ({ json: { program: program.program, wgsl: known === program.program ? null : `${TURNS}// ${program.program}`, uniforms: [program.turns] } }), { gpu: true });
  await said(page, /takes too long to draw/);
  await page.locator('.toast').filter({ hasText: 'takes too long to draw' }).waitFor();
  assert.equal(widths[0], 64, 'the first picture of a program is small');
  const asked = widths.length;
  await dragsExactly(page);
  assert.ok(widths.length <= asked + 4, `${widths.length - asked} programs are requested for a drag of a scene that is refused`);
  program = { program: 'fast', turns: 1 };
  await page.evaluate((text) => document.querySelector('room-studio').studio.openText(text), csg);
  await settled(page);
  await page.waitForFunction(() => document.querySelector('room-studio').studio.approximate.isWarm);
  assert.equal(await page.locator('.gpu').textContent(), '');
}

export async function a_program_that_does_not_compile_in_time_is_left_to_the_server() {
  const init = () => {
    GPUDevice.prototype.createComputePipelineAsync = () => new Promise(() => {});
  };
  const { page } = await withShader(({ known }) => ({ json: { wgsl: known === 'one' ? null : TURNS } }), { gpu: true, init });
  await said(page, /takes too long to compile/);
  await dragsExactly(page);
}

export async function a_program_that_is_too_long_is_not_compiled() {
  const init = () => {
    globalThis.compiled = 0;
    GPUDevice.prototype.createShaderModule = () => (globalThis.compiled += 1);
  };
  const long = `// ${'x'.repeat(3 << 20)}`;
  const { page } = await withShader(({ known }) => ({ json: { wgsl: known === 'one' ? null : long } }), { gpu: true, init });
  await said(page, /program of this scene is too long/);
  await dragsExactly(page);
  assert.equal(await page.evaluate(() => globalThis.compiled), 0);
}

export async function a_scene_whose_program_the_server_refuses_is_shown_by_exact_previews_with_the_reason() {
  const refusal = { status: 413, json: { title: 'Program too large', detail: 'the program of the scene takes 40 MB, and a browser is sent at most 2 MB', code: 'large_program' } };
  const { page } = await withShader(() => refusal, { gpu: true, expected: [/413/] });
  await said(page, /takes 40 MB/);
  await dragsExactly(page);
  assert.equal(await page.locator('.gpu').textContent(), 'exact previews only');
}

export async function pictures_of_a_slow_gpu_begin_small_and_stay_small() {
  const page = await studio({ text: null });
  await page.route('**/ui/studio/gpu.js', (route) =>
    route.fulfill({
      contentType: 'text/javascript',
      body: `export const createRenderer = async () => ({ setProgram: async () => {}, setSize() {}, setNumbers() {}, draw: () => new Promise((resolve) => setTimeout(resolve, 200, true)), destroy() {} });`,
    }),
  );
  const widths = [];
  await page.route('**/v1/shader*', (route) => {
    const { searchParams } = new URL(route.request().url());
    widths.push(Number(searchParams.get('width')));
    return route.fulfill({ json: { program: 'one', wgsl: searchParams.get('program') === 'one' ? null : TURNS, uniforms: [], table: [], samples: 1, width: 64, height: 36, exact: false, reason: null } });
  });
  await page.reload();
  await ready(page, csg);
  await settled(page);
  await page.waitForTimeout(2000);
  assert.equal(widths[0], 64);
  assert.ok(Math.max(...widths) <= 160, `${widths}`);
}
