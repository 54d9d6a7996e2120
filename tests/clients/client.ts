// Submits a job through types that openapi-typescript made of the served document, and fetches its picture.
import { readFileSync } from "node:fs";
import createClient from "openapi-fetch";
import type { components, paths } from "./farm.js";

const [server, key, file] = process.argv.slice(2) as [string, string, string];
const width = 70;
const height = 50;

const farm = createClient<paths>({ baseUrl: server, headers: { Authorization: `Bearer ${key}` } });
const job: components["schemas"]["Job"] = JSON.parse(readFileSync(file, "utf8"));
job.image = { ...job.image, width, height, samples: 1, format: "png" };
// A node is written by its name, and the types know its keys.
const ball: components["schemas"]["NodeSphere"] = { sphere: { radius: 0.1 } };
job.scene.objects.push({ shape: { translate: { by: [0, 3, 0], child: ball } } });

const submitted = await farm.POST("/v1/jobs", { body: job });
if (submitted.error) throw new Error(submitted.error.detail);
if (!("id" in submitted.data)) throw new Error("the answer is no job");
let view: components["schemas"]["JobView"] = submitted.data;
while (view.state === "queued" || view.state === "running") {
  const { data, error } = await farm.GET("/v1/jobs/{id}", {
    params: { path: { id: view.id }, header: { Prefer: "wait=30" } },
  });
  if (error) throw new Error(error.detail);
  view = data;
}
if (view.state !== "succeeded") throw new Error(`the job ${view.state}: ${view.errors.join("; ")}`);

const image = await farm.GET("/v1/jobs/{id}/image", { params: { path: { id: view.id } }, parseAs: "arrayBuffer" });
if (image.error) throw new Error(image.error.detail);
const bytes = new DataView(image.data as ArrayBuffer);
if (bytes.getUint32(0) !== 0x89504e47) throw new Error("the picture is no PNG");
const size = [bytes.getUint32(16), bytes.getUint32(20)];
if (size[0] !== width || size[1] !== height) throw new Error(`the picture is ${size[0]} by ${size[1]}`);
console.log(`openapi-typescript: ${view.name}, ${image.response.headers.get("content-type")}, ${size.join(" by ")} pixels`);
