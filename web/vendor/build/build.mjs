// Bundles CodeMirror and the language of job files into ../codemirror.js, the same bytes on every machine, and collects the
// licenses of what is in it. With --check it compares both with those in the repository instead.
import { readFileSync, writeFileSync, existsSync, readdirSync } from 'node:fs';
import { createRequire } from 'node:module';
import { dirname, join, relative } from 'node:path';
import { fileURLToPath, pathToFileURL } from 'node:url';
import { gzipSync } from 'node:zlib';

const here = dirname(fileURLToPath(import.meta.url));
/** Folder of the installed packages, in which `npm ci` was run. */
const packages = process.env.SDFARM_VENDOR_PACKAGES ?? here;
const load = (/** @type {string} */ name) => import(pathToFileURL(createRequire(join(packages, 'package.json')).resolve(name)).href);
const esbuild = await load('esbuild');
const { buildParserFile } = await load('@lezer/generator');

/** Gives the bundle the parser made of job.grammar. */
const grammar = {
  name: 'grammar',
  /** @param {import('esbuild').PluginBuild} build */
  setup(build) {
    build.onResolve({ filter: /^job-parser$/ }, () => ({ path: 'job-parser', namespace: 'grammar' }));
    build.onLoad({ filter: /.*/, namespace: 'grammar' }, () => ({
      contents: buildParserFile(readFileSync(join(here, 'job.grammar'), 'utf8'), { fileName: 'job.grammar' }).parser,
      resolveDir: packages,
    }));
  },
};

/**
 * Makes style-mod adopt style sheets in a document, too, as it does in shadow roots: the page's policy permits no <style>.
 */
const adoption = {
  name: 'adoption',
  /** @param {import('esbuild').PluginBuild} build */
  setup(build) {
    build.onLoad({ filter: /style-mod[/\\]src[/\\]style-mod\.js$/ }, ({ path }) => {
      const parts = readFileSync(path, 'utf8').split('if (!root.head && root.adoptedStyleSheets && ');
      if (parts.length !== 2) throw new Error('style-mod has changed: see whether it still writes <style> elements');
      return { contents: parts.join('if (root.adoptedStyleSheets && ') };
    });
  },
};

const result = await esbuild.build({
  entryPoints: [join(here, 'entry.js')],
  bundle: true,
  minify: true,
  format: 'esm',
  target: 'es2022',
  charset: 'utf8',
  legalComments: 'none',
  nodePaths: [join(packages, 'node_modules')],
  banner: { js: '// CodeMirror 6, bundled by web/vendor/build; licenses in codemirror.licenses.txt.' },
  plugins: [grammar, adoption],
  metafile: true,
  write: false,
});

/** Names of the packages of which code is in the bundle. */
const bundled = [
  ...new Set(
    Object.keys(result.metafile.inputs)
      .map((path) => /node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(path)?.[1])
      .filter((name) => name !== undefined),
  ),
].sort();
const licenses = bundled.map((name) => {
  const folder = join(packages, 'node_modules', name);
  const { version, license } = JSON.parse(readFileSync(join(folder, 'package.json'), 'utf8'));
  const file = readdirSync(folder).find((entry) => /^licen[cs]e/i.test(entry));
  if (file === undefined) throw new Error(`${name} has no license file`);
  return `${name} ${version} (${license})\n\n${readFileSync(join(folder, file), 'utf8').trim()}\n`;
});
const outputs = /** @type {[string, string][]} */ ([
  ['codemirror.js', result.outputFiles[0].text],
  ['codemirror.licenses.txt', licenses.join(`\n${'-'.repeat(80)}\n\n`)],
]);

let differs = false;
for (const [name, text] of outputs) {
  const path = join(here, '..', name);
  if (process.argv.includes('--check')) {
    if (!existsSync(path) || readFileSync(path, 'utf8') !== text) {
      console.error(`${relative(process.cwd(), path)} is not what web/vendor/build makes: run web/vendor/build/build, and commit it`);
      differs = true;
    }
  } else {
    writeFileSync(path, text);
  }
  console.log(`${name}: ${text.length} characters, ${gzipSync(text, { level: 9 }).length} bytes compressed`);
}
process.exitCode = differs ? 1 : 0;
