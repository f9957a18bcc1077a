// Bundles three.js for all pages, and the viewer that exported pages contain.
import { build } from "esbuild";
import { readFileSync } from "node:fs";
import { FILE, MODULES } from "./three.mjs";

const licence = (name) => `${name}:\n\n${readFileSync(`node_modules/${name}/LICENSE`, "utf8").trim()}\n`;
const options = { bundle: true, minify: true, target: "es2020", legalComments: "none" };

await build({
  ...options,
  entryPoints: ["src/three.js"],
  format: "esm",
  banner: { js: `/*!\n${licence("three")}\n${licence("@pixiv/three-vrm")}*/` },
  outfile: FILE,
});
await build({
  ...options,
  entryPoints: ["src/viewer.js"],
  format: "iife",
  alias: Object.fromEntries(MODULES.map((name) => [name, "./src/three_in_page.cjs"])),
  banner: { js: "/*! EchoAvatar viewer (Apache-2.0) */" },
  outfile: "../src/echoavatar/assets/viewer.js",
});
