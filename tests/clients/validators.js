// Tests the job schema in a validator, Ajv in strict mode: it accepts the schema, its examples and all shipped jobs, and
// refuses wrong jobs. Arguments: the folder with the installed packages, and a file with the schema.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";
import test from "node:test";
import { jobs } from "./jobs.js";

const [packages, file] = process.argv.slice(2);
const require = createRequire(resolve(packages, "package.json"));
const { default: Ajv } = require("ajv/dist/2020.js");
const { parse } = require("jsonc-parser");
const schema = JSON.parse(readFileSync(file, "utf8"));

const logged = [];
const log = (...words) => logged.push(words.join(" "));
const ajv = new Ajv({ strict: true, logger: { log, warn: log, error: log } });
ajv.addSchema(schema, "job");
const isJob = ajv.getSchema("job");

test("the schema is strict", () => {
  assert.equal(ajv.validateSchema(schema), true);
  assert.deepEqual(logged, []);
});

test("jobs that are shipped are valid", () => {
  for (const { name, text } of jobs()) assert.ok(isJob(parse(text)), `${name}: ${ajv.errorsText(isJob.errors)}`);
});

test("every default and every example is valid where it stands", () => {
  let count = 0;
  const check = (part, pointer) => {
    if (Array.isArray(part)) return part.forEach((inside, index) => check(inside, `${pointer}/${index}`));
    if (part === null || typeof part !== "object") return;
    // A key of a job may have the name of a keyword.
    const isSchema = !pointer.endsWith("/properties") && !pointer.endsWith("/$defs");
    const values = isSchema ? [...(part.examples ?? []), ...("default" in part ? [part.default] : [])] : [];
    if (values.length > 0) {
      const isValid = ajv.compile({ $ref: `job#${pointer}` });
      for (const value of values) {
        assert.ok(isValid(value), `${pointer}: ${JSON.stringify(value)}: ${ajv.errorsText(isValid.errors)}`);
        count += 1;
      }
    }
    for (const [key, inside] of Object.entries(part)) {
      if (isSchema && ["default", "examples", "required", "enum", "const"].includes(key)) continue;
      check(inside, `${pointer}/${key}`);
    }
  };
  check(schema, "");
  assert.ok(count > 400, `only ${count} values`);
});

test("wrong jobs are refused", () => {
  const job = () => structuredClone(schema.examples[0]);
  assert.ok(isJob(job()));
  const shape = (node) => (job) => (job.scene.objects[0].shape = node);
  const changes = {
    "a key that is not there": (job) => (job.imge = job.image),
    "no scene": (job) => delete job.scene,
    "no objects": (job) => (job.scene.objects = []),
    "null for a default": (job) => (job.frames = null),
    "null for what may be absent": (job) => (job.scene.fog = null),
    "an unknown format": (job) => (job.image.format = "jpg"),
    "a width of nothing": (job) => (job.image.width = 0),
    "half a pixel": (job) => (job.image.height = 0.5),
    "a layer twice": (job) => (job.image.layers = ["depth", "depth"]),
    "an unknown node": shape({ sfere: { radius: 1 } }),
    "two nodes": shape({ sphere: { radius: 1 }, torus: { radius: 1, tube: 0.2 } }),
    "no node": shape({}),
    "a missing key of a node": shape({ sphere: {} }),
    "an unknown key of a node": shape({ sphere: { radius: 1, round: 0.1 } }),
    "a negative size": shape({ sphere: { radius: -1 } }),
    "a number as text": shape({ sphere: { radius: "1" } }),
    "an empty formula": shape({ sphere: { radius: { expr: "" } } }),
    "a keyframe without a value": shape({ sphere: { radius: { keys: [[0]] } } }),
    "a keyframe of four": shape({ sphere: { radius: { keys: [[0, 1, "linear", 2]] } } }),
    "an unknown easing": shape({ sphere: { radius: { keys: [[0, 1, "quick"]] } } }),
    "a wrong node inside": shape({ union: { of: [{ box: { size: [1, 1] } }] } }),
    "a color of two": (job) => (job.scene.background = { color: [1, 1] }),
    "a color that is none": (job) => (job.scene.background = { color: "#12345" }),
    "an unknown material": (job) => (job.scene.materials = { red: { difuse: {} } }),
    "an unknown light": (job) => (job.scene.lights = [{ lamp: {} }]),
  };
  for (const [name, change] of Object.entries(changes)) {
    const wrong = job();
    change(wrong);
    assert.equal(isJob(wrong), false, name);
  }
});
