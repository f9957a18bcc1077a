/** Writes a digest of the sources beside the built pages, so that a test can tell when the build is out of date. */

import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import type { Plugin } from "vite";

const SOURCES = ["studio/src", "packages/client/src"];
const FILES = ["studio/index.html", "studio/rate.html", "studio/vite.config.ts", "three.mjs", "package-lock.json"];

/** SHA-256 over file names and contents, sorted by name; `web` is the folder that contains them. */
export function digest(web: URL): string {
  const names = SOURCES.flatMap((folder) =>
    readdirSync(new URL(`${folder}/`, web), { recursive: true, withFileTypes: true })
      .filter((entry) => entry.isFile())
      .map(
        (entry) => `${folder}/${`${entry.parentPath}/${entry.name}`.split(`/${folder}/`).at(-1)!.replace(/^\/+/, "")}`,
      ),
  );
  const hash = createHash("sha256");
  for (const name of [...names, ...FILES].sort()) hash.update(`${name}\0`).update(readFileSync(new URL(name, web)));
  return hash.digest("hex");
}

export function stamp(web: URL): Plugin {
  return {
    name: "stamp",
    generateBundle() {
      this.emitFile({ type: "asset", fileName: "built_from.txt", source: `${digest(web)}\n` });
    },
  };
}
