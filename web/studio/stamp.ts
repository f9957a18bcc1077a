/** Writes beside the built pages what they were built from, so that a test sees when somebody forgot to build. */

import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import type { Plugin } from "vite";

const SOURCES = ["studio/src", "packages/client/src"];
const FILES = ["studio/index.html", "studio/rate.html", "studio/vite.config.ts", "package-lock.json"];

/** SHA-256 over names and contents, in the order of names; `web` is the folder of all of them. */
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
