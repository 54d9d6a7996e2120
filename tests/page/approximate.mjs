// Compares the approximate pictures that Chromium draws by WebGPU, on SwiftShader, with the exact ones: each scene of scenes/
// through web/studio/gpu.js from a running server. Fails if in one of them fewer than 99 % of the pixels are within 2/255.
//
//   tests/page/node_packages
//   node tests/page/approximate.mjs target/release/sdfarm [SCENE …]
//
// KEEP=FOLDER stores both pictures of each scene. SDFARM_BROWSER is the browser's path, Debian's Chromium by default.

import { execFileSync, spawn } from 'node:child_process';
import { mkdirSync, mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';

const ROOT = resolve(import.meta.dirname, '../..');
const require = createRequire(join(ROOT, '.tools/page/'));
const { chromium } = require('playwright-core');
const { PNG } = require('pngjs');

const WIDTH = 120;
/** Maximum difference of a channel, of 255. */
const NEAR = 2;
/** Part of the pixels that must be within it. */
const PART = 0.99;
/** Scenes that SwiftShader cannot draw, each with the reason. */
const SKIPPED = { carousel: 'its program has every ease and scatter: SwiftShader compiles it for minutes, then drops the device' };
const FLAGS = [
  '--no-sandbox', '--enable-unsafe-webgpu', '--use-webgpu-adapter=swiftshader', '--enable-features=Vulkan',
  '--disable-gpu-watchdog',
];

const [sdfarm, ...wanted] = process.argv.slice(2);
if (!sdfarm) throw new Error('name the binary: node tests/page/approximate.mjs target/release/sdfarm [SCENE …]');
const folder = mkdtempSync(join(tmpdir(), 'approximate-'));
if (process.env.KEEP) mkdirSync(process.env.KEEP, { recursive: true });

/** Starts a farm without workers; resolves to its address. */
function startFarm() {
  const args = ['serve', '--listen', '127.0.0.1:0', '--data', join(folder, 'data'), '--workers', '0'];
  const child = spawn(sdfarm, args, { stdio: ['ignore', 'pipe', 'pipe'] });
  return new Promise((done, failed) => {
    let log = '';
    const read = (text) => {
      log += text;
      const found = /http:\/\/127\.0\.0\.1:\d+/.exec(log);
      if (found) done({ child, address: found[0] });
    };
    child.stdout.on('data', read);
    child.stderr.on('data', read);
    child.on('exit', () => failed(new Error(`the server ended: ${log}`)));
  });
}

/** Serves gpu.js to the browser, from an address that is a secure context. */
function servePage() {
  const server = createServer((request, response) => {
    const isScript = request.url === '/gpu.js';
    response.setHeader('Content-Type', isScript ? 'text/javascript' : 'text/html');
    response.end(isScript ? readFileSync(join(ROOT, 'web/studio/gpu.js')) : '<!doctype html><title>approximate</title>');
  });
  return new Promise((done) => server.listen(0, '127.0.0.1', () => done(server)));
}

/** Draws a program in the page; resolves to its pixels and times. */
async function draw(page, shader) {
  return page.evaluate(async (shader) => {
    const { createRenderer } = await import('/gpu.js');
    globalThis.renderer ??= await createRenderer({ onLost: (reason) => console.error('lost:', reason) });
    if (!globalThis.renderer || globalThis.renderer.isLost) throw new Error('there is no WebGPU');
    const { renderer } = globalThis;
    const start = performance.now();
    await renderer.setProgram(shader.wgsl);
    renderer.setSize(shader.width, shader.height);
    renderer.setNumbers(shader.uniforms, shader.table);
    const compiled = performance.now();
    // The first dispatch compiles on some devices.
    if (!await renderer.draw({ samples: shader.samples })) throw new Error('the drawing was replaced, or the GPU lost');
    const drawn = performance.now();
    if (!await renderer.draw({ samples: shader.samples })) throw new Error('the drawing was replaced, or the GPU lost');
    const again = performance.now();
    const { data } = await renderer.readPixels();
    return { data: Array.from(data), compile: compiled - start, first: drawn - compiled, next: again - drawn };
  }, shader);
}

/** The exact picture of the same size and samples. */
function exact(job, name) {
  const [file, png] = [join(folder, `${name}.json`), join(folder, `${name}.png`)];
  writeFileSync(file, JSON.stringify(job));
  execFileSync(sdfarm, ['render', file, '-o', png], { stdio: ['ignore', 'ignore', 'pipe'] });
  return PNG.sync.read(readFileSync(png));
}

/** Differences of the pixels, each the largest of its channels. */
function differences(data, png) {
  const all = [];
  for (let pixel = 0; pixel < png.width * png.height; pixel += 1) {
    let most = 0;
    for (let channel = 0; channel < 4; channel += 1) {
      const at = 4 * pixel + channel;
      most = Math.max(most, Math.abs(data[at] - png.data[at]));
    }
    all.push(most);
  }
  return all;
}

function keep(name, data, png) {
  if (!process.env.KEEP) return;
  const both = new PNG({ width: 2 * png.width, height: png.height });
  const own = new PNG({ width: png.width, height: png.height });
  own.data = Buffer.from(data);
  PNG.bitblt(own, both, 0, 0, png.width, png.height, 0, 0);
  PNG.bitblt(png, both, 0, 0, png.width, png.height, png.width, 0);
  writeFileSync(join(process.env.KEEP, `${name}.png`), PNG.sync.write(both));
}

const farm = await startFarm();
const server = await servePage();
const executablePath = process.env.SDFARM_BROWSER ?? '/usr/bin/chromium';
let failed = 0;
let passed = 0;
let browser = null;
try {
  browser = await chromium.launch({ executablePath, args: FLAGS });
  let page = null;
  const newPage = async () => {
    await page?.close();
    page = await browser.newPage();
    page.on('console', (message) => console.error(message.text()));
    await page.goto(`http://127.0.0.1:${server.address().port}/`);
  };
  await newPage();
  console.log('scene                 within 2/255   worst   KiB   server ms   compile ms   first ms   next ms');
  const names = readdirSync(join(ROOT, 'scenes')).filter((file) => file.endsWith('.json')).map((file) => file.slice(0, -5));
  for (const name of names.filter((name) => wanted.length === 0 || wanted.includes(name))) {
    if (SKIPPED[name] && wanted.length === 0) {
      console.log(`skipped: ${name}: ${SKIPPED[name]}`);
      continue;
    }
    const job = JSON.parse(readFileSync(join(ROOT, 'scenes', `${name}.json`), 'utf8'));
    for (const key of ['region', 'layers', 'light_groups', 'precision', 'reweight_fireflies']) delete job.image[key];
    const height = Math.max(1, Math.round(job.image.height * WIDTH / job.image.width));
    job.image = { ...job.image, width: WIDTH, height, samples: 1, denoise: false, format: 'png', bits: 8 };
    job.frames = undefined;
    try {
      const begun = performance.now();
      const headers = { 'Content-Type': 'application/json' };
      const response = await fetch(`${farm.address}/v1/shader`, { method: 'POST', headers, body: JSON.stringify(job) });
      const shader = await response.json();
      if (!response.ok) throw new Error(JSON.stringify(shader));
      if (shader.reason) throw new Error(shader.reason);
      const served = performance.now() - begun;
      const drawn = await draw(page, shader);
      const png = exact(job, name);
      const all = differences(drawn.data, png);
      const part = all.filter((difference) => difference <= NEAR).length / all.length;
      keep(name, drawn.data, png);
      const numbers = [served, drawn.compile, drawn.first, drawn.next].map((ms) => ms.toFixed(0).padStart(9)).join('  ');
      const kib = (shader.wgsl.length / 1024).toFixed(0).padStart(5);
      const verdict = part >= PART ? '' : '   MISSES';
      console.log(`${name.padEnd(20)}  ${(100 * part).toFixed(2).padStart(10)} %  ${String(Math.max(...all)).padStart(6)} ${kib} ${numbers}${verdict}`);
      if (part < PART) failed += 1;
      else passed += 1;
    } catch (error) {
      console.log(`${name.padEnd(20)}  FAILED: ${error.message.split('\n')[0]}`);
      failed += 1;
      await newPage();
    }
  }
} finally {
  await browser?.close();
  server.close();
  farm.child.kill();
  rmSync(folder, { recursive: true, force: true });
}
if (failed > 0) console.error(`${failed} scenes miss: fewer than ${100 * PART} % of their pixels are within ${NEAR}/255 of the exact picture`);
console.log(`test result: ${failed === 0 && passed > 0 ? 'ok' : 'FAILED'}. ${passed} passed; ${failed} failed`);
process.exit(failed === 0 && passed > 0 ? 0 : 1);
