// Runs the cases: each gets a line with its seconds, and a failure leaves pictures of its pages.

import { readdirSync } from 'node:fs';
import { close, closePages, launch, leavePictures } from './browser.js';

const wanted = process.argv.slice(3);
const files = readdirSync(new URL('cases/', import.meta.url)).filter((name) => name.endsWith('.js')).sort();
const start = Date.now();
let failed = 0;
let passed = 0;

await launch();
for (const file of files) {
  const group = file.replace('.js', '');
  const cases = await import(`./cases/${file}`);
  // Pictures are drawn only if they are asked for.
  if (group === 'pictures' && !wanted.some((word) => word === group || word in cases)) continue;
  const chosen = Object.entries(cases).filter(([name, run]) => typeof run === 'function' && name !== 'after' && (wanted.length === 0 || wanted.some((word) => group === word || name.includes(word))));
  for (const [name, run] of chosen) {
    const begin = Date.now();
    let error = null;
    let pictures = [];
    try {
      await run();
    } catch (failure) {
      error = failure;
      pictures = await leavePictures(`${group}-${name}`);
    }
    await closePages().catch((faults) => (error ??= faults));
    const seconds = ((Date.now() - begin) / 1000).toFixed(1).padStart(6);
    console.log(`${error ? 'FAILED' : 'ok    '} ${seconds} s  ${group}: ${name.replace(/([A-Z])/g, ' $1').toLowerCase().replaceAll('_', ' ')}`);
    if (error) {
      console.log(`${error.stack ?? error}\n${pictures.join('\n')}`);
      failed += 1;
    } else {
      passed += 1;
    }
  }
  await cases.after?.();
}
await close();
console.log(`test result: ${failed === 0 ? 'ok' : 'FAILED'}. ${passed} passed; ${failed} failed; finished in ${((Date.now() - start) / 1000).toFixed(1)}s`);
process.exit(failed === 0 && passed > 0 ? 0 : 1);
