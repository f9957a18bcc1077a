/** Writes the licences of the bundled packages beside the built page. */

import { readFileSync, readdirSync } from "node:fs";
import type { Plugin } from "vite";

const BUNDLED = [
  "three", "@pixiv/three-vrm", "@pixiv/three-vrm-core", "@pixiv/three-vrm-materials-hdr-emissive-multiplier",
  "@pixiv/three-vrm-materials-mtoon", "@pixiv/three-vrm-materials-v0compat", "@pixiv/three-vrm-node-constraint",
  "@pixiv/three-vrm-springbone", "@msgpack/msgpack", "fix-webm-duration",
];

/** `more` is said first; `fileName` is relative to the built page. */
export function licences(modules: URL, more = "", fileName = "licences.txt"): Plugin {
  return {
    name: "licences",
    generateBundle() {
      const parts = BUNDLED.map((name) => {
        const folder = new URL(`${name}/`, modules);
        const { version, license } = JSON.parse(readFileSync(new URL("package.json", folder), "utf8"));
        const file = readdirSync(folder).find((entry) => /^licen[cs]e/i.test(entry));
        const text = file ? readFileSync(new URL(file, folder), "utf8").trim() : "";
        return `${name} ${version} (${license})\n\n${text}\n`;
      });
      const head = `The page is EchoAvatar's own (Apache-2.0). It contains:\n\n${more}`;
      this.emitFile({ type: "asset", fileName, source: head + parts.join(`\n${"-".repeat(80)}\n\n`) });
    },
  };
}
