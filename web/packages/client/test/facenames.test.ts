import { readFileSync } from "node:fs";
import { expect, it } from "vitest";
import { APPLE_NAMES, ARKIT_NAMES } from "../src/facenames.generated.js";
import { ForeignFace, readName, targetNames } from "../src/facenames.js";

const told = JSON.parse(readFileSync(new URL("../../../../tests/web/face_names.json", import.meta.url), "utf8")) as {
  curves: number[][];
  read: Record<string, unknown>;
  faces: Record<string, { names: string[]; weights: number[][]; silent: string[] }>;
};

it("a name says what it says to Python", () => {
  for (const [name, reading] of Object.entries(told.read)) expect([name, readName(name)]).toEqual([name, reading]);
});

it.each(Object.keys(told.faces))("a face of %s moves as Python moves it", (kind) => {
  const { names, weights, silent } = told.faces[kind]!;
  const face = new ForeignFace(names);
  expect(face.silent).toEqual(silent);
  told.curves.forEach((curves, row) => {
    const found = names.map(() => 0);
    face.apply((name) => curves[ARKIT_NAMES.indexOf(name)] ?? 0, (target, weight) => (found[target] = weight));
    found.forEach((weight, k) => expect(weight, names[k]).toBeCloseTo(weights[row]![k]!, 3));
  });
});

it("52 targets without names are in Apple's order, or the alphabet's where its jaw moves farther", () => {
  const targets = APPLE_NAMES.map((_, POSITION) => ({ POSITION }));
  const far = (at: number) => APPLE_NAMES.map((_, k) => ({ min: [0, k === at ? -0.03 : -0.01, 0], max: [0, 0, 0] }));
  const mesh = { primitives: [{ targets }] };
  expect(targetNames({ accessors: far(17) }, mesh)).toEqual(APPLE_NAMES);
  expect(targetNames({ accessors: far(24) }, mesh)[24]).toBe("jawOpen");
  expect(targetNames({}, { primitives: [{ targets: targets.slice(1) }] }).at(-1)).toBe("noseSneerRight");
  expect(targetNames({}, { primitives: [{ targets: [{ extras: { name: "A" } }, {}] }] })).toEqual(["A", ""]);
});
