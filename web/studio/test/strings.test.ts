import { readFileSync, readdirSync } from "node:fs";
import { describe, expect, it, vi } from "vitest";
import { STATUS } from "../src/api.generated.js";
import { speak, t, word } from "../src/strings.js";

const source = new URL("../src/", import.meta.url);

describe("strings", () => {
  it("fill in values and leave what is not given", () => {
    expect(t("task_progress", { number: 3, of: 9 })).toBe("3 of 9");
    expect(t("play_clip")).toContain("{name}");
    expect(word("state", "unheard_of")).toBe("unheard_of");
  });

  it("have a word for every problem of the studio", () => {
    for (const code of Object.keys(STATUS)) expect(word("problem", code), code).not.toBe(code);
  });

  it("are English where a language is not known", () => {
    vi.stubGlobal("document", { documentElement: { lang: "" } });
    speak("tlh-KL");
    expect(t("saved")).toBe("Saved");
    expect(document.documentElement.lang).toBe("en");
  });

  it("hold every word that the pages say: no other file has English sentences in quotes", () => {
    for (const name of readdirSync(source, { recursive: true, encoding: "utf8" })) {
      if (!name.endsWith(".ts") || /strings|generated|icons/.test(name)) continue;
      const text = readFileSync(new URL(name, source), "utf8").replace(
        /\/\*\*[\s\S]*?\*\/|\/\/.*|new (RangeError|Unreachable|Error)\([^)]*\)|super\([^)]*\)/g,
        "",
      );
      expect(text.match(/"[A-Z][a-z]+ [a-z]+ [^"]*"/g) ?? [], name).toEqual([]);
    }
  });
});
