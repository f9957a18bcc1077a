import { defaultClientConditions, defineConfig } from "vite";
import { decoders, three } from "../three.mjs";
import { licences } from "./licences.js";

const DECODERS = "the Draco decoder of Google and the Basis Universal transcoder of Binomial (both Apache-2.0), as three.js ships them;\n\n";

// The page is built into the Python package, so that installing it needs no Node.
export default defineConfig({
  base: "./",
  resolve: { conditions: ["echoavatar-source", ...defaultClientConditions] }, // the client unbuilt
  plugins: [three(), decoders(true), licences(new URL("../node_modules/", import.meta.url), DECODERS)],
  build: {
    outDir: "../../src/echoavatar/server/static",
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 1500,
    rollupOptions: {
      output: {
        entryFileNames: "assets/[name]-[hash].js",
        chunkFileNames: "assets/[name]-[hash].js",
        assetFileNames: "assets/[name]-[hash][extname]",
      },
    },
  },
  worker: { format: "es", plugins: () => [decoders(true)], rollupOptions: { output: { entryFileNames: "assets/[name]-[hash].js" } } },
  server: { proxy: { "/v1": { target: "http://127.0.0.1:8790", ws: true }, "/avatar.glb": "http://127.0.0.1:8790", "/sounds": "http://127.0.0.1:8790" } },
});
