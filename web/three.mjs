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

/** Vite's plugin: three's decoders for glTF, Draco's and Basis', or none. */
export const decoders = (hasDecoders) => ({
  name: "decoders",
  apply: "build",
  enforce: "pre",
  transform: (code, id) => {
    if (id.endsWith("/basis_transcoder.js")) return code.replace(/if \(typeof exports[^]*$/, "export default BASIS;");
    if (!id.endsWith("/DRACOLoader.js")) return null;
    if (!hasDecoders) return "export {};";
    return code.replace(/const (WASM_BIN_URL|WASM_JS_URL|JS_URL) = .*/g, 'const $1 = "";');
  },
});

/** Vite's plugin for scripts whose server answers `three.js` in a `folder`. The query changes with the file, for caches. */
export const three = (folder = "./") => {
  const name = `three.js?v=${createHash("sha256").update(readFileSync(FILE)).digest("hex").slice(0, 8)}`;
  const paths = Object.fromEntries(MODULES.map((module) => [module, `${folder}${name}`]));
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
