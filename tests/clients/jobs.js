// The job files of the repository.
import { readFileSync, readdirSync } from "node:fs";

const root = new URL("../../", import.meta.url);

export function jobs() {
  const found = ["scenes/", "scenes/paper/", "docs/scenes/"].flatMap((folder) =>
    readdirSync(new URL(folder, root))
      .filter((name) => name.endsWith(".json"))
      .map((name) => ({ name: folder + name, text: readFileSync(new URL(folder + name, root), "utf8") })),
  );
  if (found.length < 40) throw new Error(`only ${found.length} jobs are there`);
  return found;
}
