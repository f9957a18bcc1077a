// Bundles src/viewer.js into one script for the package, with the licence of three.js at the top.
import { build } from "esbuild";
import { readFileSync } from "node:fs";

const licence = readFileSync("node_modules/three/LICENSE", "utf8").trim();
await build({
  entryPoints: ["src/viewer.js"],
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2020",
  legalComments: "none",
  banner: { js: `/*!\nEchoAvatar viewer (Apache-2.0), with three.js:\n\n${licence}\n*/` },
  outfile: "../src/echoavatar/assets/viewer.js",
});
