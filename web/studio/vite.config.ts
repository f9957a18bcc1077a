import { readFileSync } from "node:fs";
import { type Plugin, defaultClientConditions, defineConfig } from "vite";
import { licences } from "../app/licences.js";
import { decoders, three } from "../three.mjs";
import { stamp } from "./stamp.js";

// Two pages, built into the Python package, so that installing it needs no Node. File names contain a hash, so that a
// browser never mixes scripts of two versions.
const page = (name: string) => new URL(name, import.meta.url).pathname;

/** Copies the English texts beside the pages, as a template for translations. */
const words = (english: URL): Plugin => ({
  name: "words",
  generateBundle() {
    this.emitFile({ type: "asset", fileName: "words/en.json", source: readFileSync(english) });
  },
});

export default defineConfig({
  base: "./",
  resolve: { conditions: ["echoavatar-source", ...defaultClientConditions] }, // the client unbuilt
  plugins: [
    three(),
    decoders(false),
    licences(new URL("../node_modules/", import.meta.url), "", "assets/licences.txt"),
    stamp(new URL("../", import.meta.url)),
    words(new URL("src/words/en.json", import.meta.url)),
  ],
  build: {
    outDir: "../../studio/src/echoavatar_studio/static",
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 1500,
    modulePreload: { polyfill: false },
    rollupOptions: {
      input: { index: page("index.html"), rate: page("rate.html") },
      output: {
        entryFileNames: "assets/[name]-[hash].js",
        chunkFileNames: "assets/[name]-[hash].js",
        assetFileNames: "assets/[name]-[hash][extname]",
      },
    },
  },
  server: { proxy: Object.fromEntries(["/api", "/avatar.glb", "/words"].map((path) => [path, "http://127.0.0.1:8800"])) },
});
