// The client as a server serves it at /client/, for pages without a build step: a script for each door of the package,
// `echo-avatar.js`, and the server's own copy of three.js.
import { defaultClientConditions, defineConfig } from "vite";
import { decoders, three } from "./three.mjs";

const door = (path: string) => new URL(`packages/client/src/${path}.ts`, import.meta.url).pathname;

export default defineConfig({
  base: "./",
  resolve: { conditions: ["echoavatar-source", ...defaultClientConditions] },
  plugins: [three("../assets/"), decoders(false)],
  build: {
    outDir: "../src/echoavatar/server/static/client",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: false,
    rollupOptions: {
      input: {
        "echo-avatar": new URL("src/echo_avatar.js", import.meta.url).pathname,
        index: door("index"), three: door("drivers/index"), export: door("export/index"), livekit: door("livekit"), rtvi: door("rtvi"),
      },
      preserveEntrySignatures: "strict",
      output: { entryFileNames: "[name].js", chunkFileNames: "[name]-[hash].js", codeSplitting: { groups: [{ name: "client", test: /./ }] } },
    },
  },
});
