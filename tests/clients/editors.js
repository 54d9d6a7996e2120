// Tests the job schema in the JSON language server of VS Code, Helix and others: completion, hover and diagnostics.
// Arguments: the folder with the installed packages, and a file with the schema.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";
import test from "node:test";
import { jobs } from "./jobs.js";

const [packages, file] = process.argv.slice(2);
const { ClientCapabilities, TextDocument, getLanguageService } = createRequire(resolve(packages, "package.json"))(
  "vscode-json-languageservice",
);
const schema = JSON.parse(readFileSync(file, "utf8"));
const kinds = (family) =>
  schema.$defs[family].oneOf
    .map(({ $ref }) => schema.$defs[$ref.split("/").pop()].properties)
    .filter(Boolean)
    .map((properties) => Object.keys(properties)[0]);

// Editors fetch the schema that a job names.
const service = getLanguageService({
  clientCapabilities: ClientCapabilities.LATEST,
  workspaceContext: { resolveRelativePath: (path, base) => new URL(path, base).href },
  schemaRequestService: async (address) =>
    /\/(sdfarm\.schema\.json|v1\/schema\/job)$/.test(address) ? JSON.stringify(schema) : Promise.reject(address),
});
// The server resolves references in place.
const resolved = structuredClone(schema);
service.configure({ validate: true, schemas: [{ uri: "sdfarm:///job", fileMatch: ["*.json"], schema: resolved }] });

// In each text, | is the cursor.
function open(text) {
  const at = text.indexOf("|");
  const document = TextDocument.create("file:///jobs/job.json", "json", 0, text.replace("|", ""));
  return { document, json: service.parseJSONDocument(document), position: document.positionAt(at) };
}

async function complete(text) {
  const { document, json, position } = open(text);
  const items = (await service.doComplete(document, position, json)).items;
  return new Map(items.map((item) => [item.label, item]));
}

async function hover(text) {
  const { document, json, position } = open(text);
  const shown = await service.doHover(document, position, json);
  // The server escapes punctuation, because descriptions are plain text.
  return shown.contents[0].replace(/\\\n/g, "\n").replace(/\\(.)/g, "$1").replaceAll("&nbsp;", " ");
}

async function faults(text) {
  const { document, json } = open(text);
  const settings = { comments: "ignore", trailingCommas: "ignore", schemaValidation: "error" };
  return (await service.doValidation(document, json, settings)).map(({ message }) => message);
}

const about = (item) => item?.documentation?.value ?? item?.documentation ?? "";
const camera = `"camera": { "position": [0, 1, 4], "look_at": [0, 0, 0] }`;
const image = `"image": { "width": 320, "height": 180 }`;
const ball = `{ "sphere": { "radius": 1 } }`;
const inScene = (inside) => `{ "scene": { ${camera}, ${inside} }, ${image} }`;
const inObject = (inside) => inScene(`"objects": [{ ${inside} }]`);

// The text that an editor inserts, with the values that it suggests.
function inserted({ insertText }) {
  return insertText
    .replace(/\$\{\d+:([^}]*)\}/g, "$1")
    .replace(/(?<!\\)\$\d+/g, "")
    .replace(/\\([$}\\])/g, "$1");
}

test("a job has its keys, each with a description", async () => {
  const items = await complete("{|}");
  assert.deepEqual([...items.keys()].sort(), Object.keys(schema.properties).sort());
  for (const [key, item] of items) assert.notEqual(about(item), "", key);
  assert.match(about(items.get("image")), /size and file format/);
});

test("an empty file completes to a job", async () => {
  const [item] = (await complete("|")).values();
  assert.deepEqual(await faults(inserted(item)), []);
});

test("every node completes with its description and with the keys that it needs", async () => {
  const items = await complete(inObject(`"shape": { | }`));
  assert.deepEqual([...items.keys()].sort(), kinds("Node").sort());
  for (const [name, item] of items) {
    assert.notEqual(about(item), "", name);
    const text = inObject(`"shape": { ${inserted(item)} }`);
    // A shape's name stands for one of the scene's shapes, which no schema knows.
    assert.deepEqual(await faults(text), [], `${name}: ${text}`);
  }
  assert.equal(inserted(items.get("sphere")).replace(/\s/g, ""), `"sphere":{"radius":1}`);
});

for (const [family, text] of [
  ["Material", inObject(`"shape": ${ball}, "material": { | }`)],
  ["Light", inScene(`"lights": [{ | }]`)],
  ["Background", inScene(`"background": { | }`)],
  ["Profile", inObject(`"shape": { "extrude": { "height": 1, "profile": { | } } }`)],
  ["Texture", inObject(`"shape": ${ball}, "material": { "diffuse": { "kd": { | } } }`)],
  ["Projection", `{ "scene": { "camera": { "projection": { | } } } }`],
]) {
  test(`every kind of ${family} completes with its description`, async () => {
    const items = await complete(text);
    for (const name of kinds(family)) {
      assert.notEqual(about(items.get(name)), "", name);
      assert.match(inserted(items.get(name)), /^"\w+": \S/, name);
    }
  });
}

test("a key has its own description, and not that of its type", async () => {
  const items = await complete(inObject(`"shape": { "sphere": { | } }`));
  assert.deepEqual([...items.keys()], ["radius"]);
  assert.equal(about(items.get("radius")), "Radius.");
  assert.equal(inserted(items.get("radius")), `"radius": 1`);
  assert.equal(await hover(inObject(`"shape": { "sphere": { "rad|ius": 1 } }`)), "Length\n\nRadius.");
  assert.equal(await hover(inObject(`"shape": { "sphere": { "rad|ius": { "expr": "1 + t" } } }`)), "Formula\n\nRadius.");
  assert.equal(await hover(`{ "image": { "wi|dth": 320 } }`), "Width, in pixels.");
});

test("a number completes to its example, a formula or a track", async () => {
  const values = await complete(inObject(`"shape": { "sphere": { "radius": | } }`));
  const written = [...values.values()].map((item) => JSON.parse(inserted(item)));
  assert.ok(written.includes(1), JSON.stringify(written));
  assert.ok(written.some((value) => typeof value.expr === "string"), JSON.stringify(written));
  assert.ok(written.some((value) => Array.isArray(value.keys)), JSON.stringify(written));
  const keys = await complete(inObject(`"shape": { "sphere": { "radius": { | } } }`));
  assert.deepEqual([...keys.keys()].sort(), ["ease", "expr", "keys", "loop"]);
});

test("defaults are shown", async () => {
  const items = await complete(`{ "image": { | } }`);
  assert.equal(inserted(items.get("samples")), `"samples": 4`);
  assert.equal(inserted(items.get("format")), `"format": "png"`);
  const [shown] = [...(await complete(`{ "image": { "samples": | } }`)).values()].filter(({ label }) => label === "4");
  assert.equal(shown.detail ?? shown.labelDetails.description, "Default value");
});

test("words complete, each with its own description", async () => {
  for (const [text, word, description] of [
    [`{ "image": { "format": | } }`, `"exr"`, /OpenEXR/],
    [`{ "image": { "layers": [ | ] } }`, `"depth"`, /distance along the ray/],
    [inObject(`"shape": { "sphere": { "radius": { "keys": [[0, 1]], "ease": | } } }`), `"ease_in"`, /CSS/],
    [inObject(`"shape": { "sphere": { "radius": { "keys": [[0, 1]], "loop": | } } }`), `"ping_pong"`, /back/],
    [inScene(`"background": |`), `"transparent"`, /alpha/],
  ]) {
    assert.match(about((await complete(text)).get(word)), description, text);
  }
  assert.match(await hover(`{ "image": { "format": "e|xr" } }`), /OpenEXR/);
});

test("a color completes to a string, a temperature, a track and textures", async () => {
  const values = await complete(inObject(`"shape": ${ball}, "material": { "diffuse": { "kd": | } }`));
  const written = [...values.values()].map((item) => JSON.parse(inserted(item)));
  assert.ok(written.some((value) => /^#[0-9a-f]{6}$/.test(value)));
  for (const key of ["kelvin", "keys", "checker"]) assert.ok(written.some((value) => key in Object(value)), key);
});

test("hovering over the name of a node shows its one description", async () => {
  const items = await complete(inObject(`"shape": { | }`));
  for (const [name, item] of items) {
    const text = inserted(item).replace(`"${name}"`, `"|${name}"`);
    const [title, ...rest] = (await hover(inObject(`"shape": { ${text} }`))).split("\n\n");
    const one = (paragraphs) => paragraphs.replace(/\s+/g, " ").trim();
    assert.equal(one(rest.join(" ")), one(about(item)), name);
    assert.match(title, /^[A-Z]\w*$/, name);
  }
  assert.match(await hover(inObject(`"sh|ape": ${ball}`)), /^Node\n\nThe shape\.$/);
});

test("comments and trailing commas are no faults", async () => {
  const text = inObject(`/* A ball. */ "shape": { "sphere": { "radius": 1, }, }, // The end.\n`);
  assert.deepEqual(await faults(text), []);
});

test("a job may name its schema, by a file or by the address of a farm", async () => {
  for (const address of ["sdfarm.schema.json", "http://127.0.0.1:8080/v1/schema/job"]) {
    const named = (text) => text.replace("{", `{ "$schema": "${address}",`);
    assert.deepEqual(await faults(named(inObject(`"shape": ${ball}`))), []);
    assert.match((await faults(named(inObject(`"shape": ${ball}, "shade": 1`)))).join(), /Property shade is not allowed/);
    assert.ok((await complete(named(inObject(`"shape": { | }`)))).has("sphere"), address);
  }
});

test("a wrong key, word or value is named", async () => {
  for (const [text, message] of [
    [inObject(`"shape": { "sphere": { "radios": 1 } }`), /Property radios is not allowed/],
    [inObject(`"shape": { "sphere": { } }`), /Missing property "radius"/],
    [inObject(`"shape": { "sfere": { "radius": 1 } }`), /Property sfere is not allowed/],
    [inObject(`"shape": ${ball}, "material": { "difuse": {} }`), /Property difuse is not allowed/],
    [inObject(`"shape": { "union": { "of": [{ "box": { "size": [1, 1, 1], "rond": 1 } }] } }`), /Property rond is not/],
    [inObject(`"shape": { "sphere": { "radius": -1 } }`), /below the minimum/],
    [inObject(`"shape": { "sphere": { "radius": "1" } }`), /Incorrect type/],
    [inObject(`"shape": ${ball}`).replace(`"width": 320`, `"width": 320, "format": "jpg"`), /Valid values: "png", "exr"/],
    [inObject(`"shape": ${ball}`).replace(`"image"`, `"imge"`), /Property imge is not allowed/],
  ]) {
    const found = await faults(text);
    assert.ok(found.some((fault) => message.test(fault)), `${text}: ${found}`);
  }
});

test("jobs that are shipped have no faults", async () => {
  for (const { name, text } of jobs()) assert.deepEqual(await faults(text.replaceAll("|", " ")), [], name);
});
