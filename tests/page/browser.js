// The browser of the tests: pages that record what must not happen, and checks of accessibility.

import { mkdirSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join, resolve } from 'node:path';
import assert from 'node:assert/strict';

const require = createRequire(resolve('.tools/page/package.json'));
const { chromium } = require('playwright-core');
const { default: AxeBuilder } = require('@axe-core/playwright');

/** Time in which what is awaited must happen. */
const TIMEOUT_MS = 12_000;
const FAILURES = resolve('target/page');
export const DESKTOP = { width: 1440, height: 900 };
export const PHONE = { width: 390, height: 844 };

const ARGUMENTS = ['--no-sandbox', '--disable-dev-shm-usage', '--enable-unsafe-webgpu', '--use-webgpu-adapter=swiftshader'];
/** A canvas that WebGPU draws on needs a compositor by Vulkan, which is slow on a CPU: only cases that look at such a canvas use it. */
const GPU_ARGUMENTS = ['--use-vulkan=swiftshader', '--use-angle=swiftshader', '--enable-features=Vulkan', '--disable-gpu-watchdog'];

/** The browser's own warning if its GPU does not answer on a busy machine: the page then shows the server's pictures. */
const WITHOUT_GPU = /Failed to create WebGPU Context Provider/;

let browser;
let gpuBrowser;

const start = (more = []) => chromium.launch({ executablePath: process.env.SDFARM_BROWSER, args: [...ARGUMENTS, ...more] });

/** Starts the browser. */
export async function launch() {
  browser = await start();
}

/** Ends the browsers. */
export async function close() {
  await browser?.close();
  await gpuBrowser?.close();
}

/** Opens a page of a farm. `expected` are patterns of console errors that the case provokes; `gpu` shows what WebGPU draws. */
export async function open(farm, hash = '#/jobs', { size = DESKTOP, theme = 'light', expected = [], motion = 'no-preference', init, permissions = [], gpu = false } = {}) {
  if (gpu) gpuBrowser ??= await start(GPU_ARGUMENTS);
  const context = await (gpu ? gpuBrowser : browser).newContext({ viewport: size, colorScheme: theme, reducedMotion: motion, hasTouch: size === PHONE, permissions, acceptDownloads: true });
  if (init) await context.addInitScript(init);
  context.setDefaultTimeout(TIMEOUT_MS);
  const page = await context.newPage();
  const faults = [];
  page.on('console', (message) => {
    if (message.type() !== 'error' && message.type() !== 'warning') return;
    const text = `${message.text()} (${message.location().url})`;
    if (![WITHOUT_GPU, ...expected].some((pattern) => pattern.test(text))) faults.push(`console ${message.type()}: ${text}`);
  });
  page.on('pageerror', (error) => faults.push(`error: ${error.stack ?? error}`));
  page.on('dialog', (dialog) => (faults.push(`a dialog of the browser: ${dialog.message()}`), void dialog.dismiss()));
  // With a listener from the start, because one that is added with a key press may be too late for it.
  page.on('filechooser', () => {});
  page.on('request', (request) => {
    const url = new URL(request.url());
    if (!['blob:', 'data:'].includes(url.protocol) && url.origin !== farm.address) faults.push(`a request to another host: ${request.url()}`);
  });
  await page.exposeFunction('reportViolation', (text) => faults.push(`policy: ${text}`));
  await page.addInitScript(() => {
    document.addEventListener('securitypolicyviolation', (event) => window.reportViolation(`${event.violatedDirective} ${event.blockedURI} ${event.sourceFile}:${event.lineNumber}`));
  });
  page.faults = faults;
  await page.goto(`${farm.address}/${hash}`);
  pages.add(page);
  return page;
}

/** Pages that the case has open. */
const pages = new Set();

/** Closes the case's pages; says what must not have happened. */
export async function closePages() {
  const faults = [...pages].flatMap((page) => page.faults);
  for (const page of pages) await page.context().close();
  pages.clear();
  assert.deepEqual([...new Set(faults)], [], 'the pages must be without faults');
}

/** Leaves pictures of the open pages. */
export async function leavePictures(name) {
  mkdirSync(FAILURES, { recursive: true });
  const paths = [];
  for (const [index, page] of [...pages].entries()) {
    const path = join(FAILURES, `${name}-${index}.png`);
    await page.screenshot({ path }).catch(() => {});
    paths.push(path);
    paths.push(...page.faults);
  }
  return paths;
}

/** Waits for a room by its heading. */
export const inRoom = (page, heading) => page.getByRole('heading', { level: 1, name: heading, exact: true }).waitFor();

/** Nothing serious or critical by axe. */
export async function checkAccessibility(page, what) {
  const { violations } = await new AxeBuilder({ page }).withTags(['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice']).analyze();
  const grave = violations.filter((violation) => ['serious', 'critical'].includes(violation.impact));
  const text = grave.map((violation) => `${violation.id}: ${violation.help}\n${violation.nodes.slice(0, 4).map((node) => `    ${node.html.slice(0, 200)}\n    ${node.failureSummary?.replaceAll('\n', ' ')}`).join('\n')}`);
  assert.equal(grave.length, 0, `${what}:\n${text.join('\n')}`);
}

/** Nothing is wider than the screen. */
export async function checkWidth(page, what) {
  const { scroll, client, wide } = await page.evaluate(() => {
    const { scrollWidth: scroll, clientWidth: client } = document.documentElement;
    const beyond = [...document.querySelectorAll('main *, header *')].filter((element) => element.getBoundingClientRect().right > client + 1 && !element.closest('.scroll-x, .job-list, .film, .code-view, .chips, .help-contents'));
    return { scroll, client, wide: beyond.slice(0, 4).map((element) => `${element.tagName}.${element.getAttribute('class')}`) };
  });
  assert.ok(scroll <= client, `${what}: the page is ${scroll} pixels wide, and the screen ${client}: ${wide.join(', ')}`);
}

/**
 * Checks a time, if `SDFARM_CHECK_TIMES` is set: that needs an idle machine.
 * @param {boolean} isMet
 * @param {string} message
 */
export function checkTime(isMet, message) {
  if (process.env.SDFARM_CHECK_TIMES) assert.ok(isMet, message);
  else if (!isMet) console.log(`        not checked without SDFARM_CHECK_TIMES: ${message}`);
}
