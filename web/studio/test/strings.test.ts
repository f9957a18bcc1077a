import { readFileSync, readdirSync } from "node:fs";
import { describe, expect, it, vi } from "vitest";
import { STATUS } from "../src/api.generated.js";
import { type Words, speak, t, word } from "../src/strings.js";

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

  it("are of the study's language, of the language without its country, or English", async () => {
    vi.stubGlobal("document", { documentElement: { lang: "" } });
    const files: Record<string, Words> = {
      de: { saved: "Gespeichert", play_clip: "{name} abspielen", play: "" },
      "pt-BR": { saved: "Salvo" },
    };
    const fetch = async (code: string) => files[code] ?? null;
    const said = async (language: string) => {
      await speak(language, fetch);
      return [document.documentElement.lang, t("saved"), t("play_clip", { name: "A" }), t("play")];
    };
    expect(await said("de-AT")).toEqual(["de", "Gespeichert", "A abspielen", "Play"]);
    expect(await said("pt-BR")).toEqual(["pt-BR", "Salvo", "Play A", "Play"]);
    expect(await said("tlh-KL")).toEqual(["en", "Saved", "Play A", "Play"]);
    expect(await said("en-GB")).toEqual(["en", "Saved", "Play A", "Play"]);
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
