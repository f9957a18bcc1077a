import { defineConfig } from "vitest/config";

export default defineConfig({
  resolve: { conditions: ["echoavatar-source"] }, // the client unbuilt
  ssr: { resolve: { conditions: ["echoavatar-source"] } },
  test: { include: ["packages/*/test/**/*.test.ts", "app/test/**/*.test.ts", "studio/test/**/*.test.ts"] },
});
