import { describe, expect, it } from "vitest";
import { domainOf, scale } from "../src/owner/plots.js";
import { beginChoices, newSystem, settingsOf } from "../src/owner/fields.js";
import { meanText, signed } from "../src/owner/table.js";
import { toYaml } from "../src/owner/yaml.js";

describe("study.yaml", () => {
  it("is block YAML with every string quoted", () => {
    const text = toYaml({
      title: 'a: "b" # \n',
      on: "yes",
      list: ["x", "y"],
      parts: [{ a: 1, b: { c: 0.5 } }, { a: 2 }],
      none: [],
    });
    expect(text).toBe(
      'title: "a: \\"b\\" # \\n"\non: "yes"\nlist: ["x", "y"]\nparts:\n  - a: 1\n    b:\n      c: 0.5\n  - a: 2\nnone: []\n',
    );
  });

  it("has the fields of its kind only", () => {
    const choices = beginChoices();
    choices.title = "T";
    choices.systems = [
      { ...newSystem("default"), name: "A" },
      { ...newSystem(""), name: "B", clips: "b", group: "G" },
    ];
    const pairwise = settingsOf(choices);
    expect(pairwise["systems"]).toEqual([
      { name: "A", model: "default", seed: 0 },
      { name: "B", clips: "b", group: "G" },
    ]);
    expect(pairwise["checks"]).toEqual({ identical: 1, corrupted: 1 });
    expect(Object.keys(pairwise)).not.toContain("keep");
    expect(Object.keys(pairwise)).not.toContain("consent");
    choices.kind = "preference";
    const preference = settingsOf(choices);
    expect(preference["keep"]).toEqual({ votes: 1, agreement: 0.6, margin: 0.3 });
    expect(preference["checks"]).toEqual({ corrupted: 1 });
    for (const name of ["systems", "seconds", "questions", "presentation"])
      expect(Object.keys(preference)).not.toContain(name);
  });
});

describe("numbers", () => {
  it("have a true minus and no negative nothing", () => {
    expect([signed(-0.5), signed(0.25), signed(-0.001)]).toEqual(["−0.50", "+0.25", "0.00"]);
    expect(meanText({ mean: -0.5, half: 0.1, half_raters: null, count: 9 })).toBe("−0.50 ± 0.10");
    expect(meanText({ mean: 1, half: null, half_raters: null, count: 1 })).toBe("+1.00");
    expect(meanText(undefined)).toBe("");
  });

  it("lie on the plot where they should, and never outside", () => {
    const x = scale([-2, 2]);
    expect(x(0) - x(-2)).toBeCloseTo(x(2) - x(0));
    expect(x(9)).toBe(x(2));
    expect(domainOf([{ label: "", series: 0, value: 0.2, low: -0.7, high: 1.1 }])).toEqual([-1.5, 1.5]);
    expect(domainOf([])).toEqual([-0.5, 0.5]);
  });
});
