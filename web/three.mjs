// The one copy of three.js that the Python package ships (src/three.js), and how the built pages import it.
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";

export const FILE = new URL("../src/echoavatar/assets/shared/three.js", import.meta.url).pathname;
export const MODULES = [
  "three",
  "three/examples/jsm/controls/OrbitControls.js",
  "three/examples/jsm/loaders/GLTFLoader.js",
  "@pixiv/three-vrm",
];

/** Vite's plugin: of three's decoders Draco's for glTF, or none. Basis' evaluates code, which no page of ours allows. */
export const decoders = (hasDraco) => ({
  name: "decoders",
  apply: "build",
  enforce: "pre",
  transform: (code, id) => {
    if (!/\/(DRACO|KTX2)Loader\.js$/.test(id)) return null;
    if (!hasDraco || id.endsWith("/KTX2Loader.js")) return "export {};";
    return code.replace(/const (WASM_BIN_URL|WASM_JS_URL|JS_URL) = .*/g, 'const $1 = "";');
  },
});

/** Vite's plugin for a page whose server answers `assets/three.js`. The query changes with the file, for caches. */
export const three = () => {
  const name = `three.js?v=${createHash("sha256").update(readFileSync(FILE)).digest("hex").slice(0, 8)}`;
  const paths = Object.fromEntries(MODULES.map((module) => [module, `./${name}`]));
  return {
    name: "three",
    apply: "build",
    config: () => ({ build: { rollupOptions: { external: MODULES, output: { paths } } } }),
    transformIndexHtml: (_html, { chunk }) =>
      chunk?.imports.includes(`./${name}`)
        ? [{ tag: "link", attrs: { rel: "modulepreload", crossorigin: true, href: `./assets/${name}` }, injectTo: "head" }]
        : [],
  };
};
