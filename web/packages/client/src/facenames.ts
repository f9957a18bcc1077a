/** What the names of other characters' morph targets say, and how our curves drive these; mirrors `motion/face_names.py`. */

import { toVrm } from "./expressions.js";
import { APPLE_NAMES, ARKIT_NAMES, ENDINGS, MIXED, NEAREST, PARTS, PHRASES, SPELT, SPOKEN, SUMS, VOWELS } from "./facenames.generated.js";

const LETTERS = 100; // of a name that are read
const TOKEN = /[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+|[^\x00-\x7f]+/g;
const SIDES: Record<string, string> = { left: "Left", right: "Right" };
const PRESETS = [...VOWELS, ...Object.keys(SUMS)];
const KNOWN = new Set(Object.values(SPELT).flatMap((word) => word.split(" ")));
const divided = new Map<string, string | null>();

/** A curve without its side or a preset, its side ("" for none), which part of it, and whether the words are ARKit's. */
export type Reading = readonly [shape: string, side: string, part: readonly string[], isOurs: boolean];
type Shares = Record<string, number>;

function divide(word: string): string | null {
  if (Object.hasOwn(SPELT, word)) return SPELT[word]!;
  const known = divided.get(word);
  if (known !== undefined) return known;
  let found: string | null = null;
  for (let end = word.length - 1; end > 1 && found === null; end--) {
    const first = Object.hasOwn(SPELT, word.slice(0, end)) ? SPELT[word.slice(0, end)]! : null;
    const rest = first && divide(word.slice(end));
    if (rest) found = `${first} ${rest}`;
  }
  divided.set(word, found);
  return found;
}

function wordsOf(name: string): string[] {
  const found: string[] = [];
  for (const token of name.match(TOKEN) ?? []) {
    const word = token.toLowerCase();
    if (!/^[0-9]+$/.test(word)) found.push(...(divide(word) ?? word).split(" "));
    else if (found.at(-1) === "au") found[found.length - 1] = `au${Number(word)}`;
  }
  return found;
}

/** What the name of a morph target or an expression says; null where it is none of a face that we know. */
export function readName(name: string): Reading | null {
  const whole = [...name].slice(0, LETTERS).join("").normalize("NFKC");
  for (const piece of new Set([whole.split(/[.:|/]/).at(-1)!, whole])) {
    const words = wordsOf(piece);
    while (ENDINGS.includes(words.at(-1) ?? "")) words.pop();
    for (const [start, word] of words.entries()) {
      const found = phrase(words.slice(start), start === 0);
      if (found) return found;
      if (word.length > 1 && KNOWN.has(word) && !word.startsWith("au")) break;
    }
  }
  return null;
}

function phrase(words: string[], isWhole: boolean): Reading | null {
  if (words[0]!.length === 1 && words.length > 1) return null;
  const sides = words.flatMap((word) => SIDES[word] ?? []);
  const look = words.indexOf("look");
  const direction = look < 0 ? "" : (SIDES[words[look + 1] ?? ""] ?? "");
  if (direction) sides.splice(sides.indexOf(direction), 1);
  const bag = [...new Set(words)].filter((word) => !(word in SIDES)).sort();
  if (new Set(sides).size > 1 || (bag.join("").length <= 2 && !isWhole)) return null;
  const side = sides[0] ?? "";
  if (direction && bag.every((word) => word === "eye" || word === "look")) {
    const shape = side ? `eyeLook${side === direction ? "Out" : "In"}` : `look${direction}`;
    return [shape, side, [], bag.length === 2];
  }
  const isPart = (word: string) => PARTS.includes(word);
  for (const kept of [bag, bag.filter((word) => word !== "viseme"), bag.filter((word) => !isPart(word))]) {
    const known = PHRASES[kept.join(" ")];
    if (!known || (kept.length === 1 && bag.some(isPart))) continue;
    const [shape, isOurs] = known;
    if ((shape === "jaw" || shape === "mouth") && !side) return null;
    return [shape, side, bag.filter((word) => isPart(word) && !kept.includes(word)), isOurs];
  }
  return null;
}

/** The targets that move, by what their names say: of several for one shape, those that say it best. */
function chosen(names: readonly string[]): [Reading, number][] {
  const found = new Map<string, [Reading, number]>();
  names.forEach((name, target) => {
    const reading = readName(name);
    const key = String(reading);
    if (reading && !found.has(key)) found.set(key, [reading, target]);
  });
  const readings = [...found.values()].map(([reading]) => reading);
  const shapes = new Set(readings.map(([shape]) => shape));
  const ours = new Set(readings.flatMap(([shape, , , isOurs]) => (isOurs ? shape : [])));
  const whole = new Set(readings.filter(([, , part]) => !part.length).map(([shape, side, , isOurs]) => `${shape} ${side} ${isOurs}`));
  const has = (...wanted: string[]) => wanted.some((shape) => shapes.has(shape));
  const voices = VOWELS.filter((vowel) => shapes.has(vowel)).length;
  const isVoiced = !(has("jawOpen") && has("mouthFunnel", "mouthPucker")) && voices > Number(has("jawOpen"));
  const isMoving = ([shape, side, part, isOurs]: Reading): boolean => {
    if ((ours.has(shape) && !isOurs) || (part.length && whole.has(`${shape} ${side} ${isOurs}`))) return false;
    const of = new Set(readings.flatMap(([other, its]) => (other === shape ? its : [])));
    if (of.has("") && of.size > 1 && (side === "") === (of.has("Left") && of.has("Right"))) return false;
    if (VOWELS.includes(shape) || ["PP", "FF", "TH", "CH"].includes(shape)) return isVoiced && !(shape === "TH" && has("tongueOut"));
    if (shape in SUMS || shape === "browUp") return !has(...Object.keys(SUMS[shape] ?? MIXED[shape]!));
    return !(isVoiced && SPOKEN.includes(shape));
  };
  return [...found.values()].filter(([reading]) => isMoving(reading));
}

/** The curves of a shape or a preset, with their shares; a shape without a side takes the mean of both. */
function expanded(shape: string, side = ""): Shares {
  const parts = MIXED[shape] ?? SUMS[shape];
  if (parts) {
    const all = Object.entries(parts).flatMap(([part, share]) =>
      Object.entries(expanded(part, side)).map(([row, value]) => [row, share * value] as const),
    );
    return Object.fromEntries(all);
  }
  if (ARKIT_NAMES.includes(shape)) return { [shape]: 1 };
  return side ? { [shape + side]: 1 } : { [`${shape}Left`]: 0.5, [`${shape}Right`]: 0.5 };
}

/** A face of the targets or expressions of these names. */
export class ForeignFace {
  private readonly shares: [target: number, shares: [row: string, share: number][]][];
  private readonly presets: string[];
  /** The curves that move nothing. */
  readonly silent: readonly string[];

  constructor(names: readonly string[]) {
    const kept = chosen(names);
    const rows = new Map<number, Shares>();
    for (const [[shape, side], target] of kept) {
      rows.set(target, { ...rows.get(target), ...(PRESETS.includes(shape) ? { [shape]: 1 } : expanded(shape, side)) });
    }
    const vowels = new Map(kept.flatMap(([[shape], target]) => (VOWELS.includes(shape) ? [[shape, target] as const] : [])));
    for (const [vowel, others] of Object.entries(NEAREST)) {
      const near = vowels.has(vowel) ? undefined : others.split(" ").find((other) => vowels.has(other));
      if (near) rows.get(vowels.get(near)!)![vowel] = 1;
    }
    this.shares = [...rows].map(([target, shares]) => [target, Object.entries(shares)]);
    const moving = new Set([...rows.values()].flatMap((shares) => Object.keys(shares)));
    this.presets = PRESETS.filter((preset) => moving.has(preset));
    for (const preset of this.presets) {
      for (const curve of VOWELS.includes(preset) ? SPOKEN : Object.keys(expanded(preset))) moving.add(curve);
    }
    this.silent = ARKIT_NAMES.filter((curve) => !moving.has(curve));
  }

  /** Whether any target moves. */
  get isMoving(): boolean {
    return this.shares.length > 0;
  }

  /** Passes each moving target and its weight, 0 to 1; all presets together are at most 1. */
  apply(get: (name: string) => number, set: (target: number, weight: number) => void): void {
    const spoken = this.presets.length ? toVrm(get) : [];
    const sum = (shares: Iterable<[string, number]>, of: (row: string) => number) =>
      Math.min(1, Math.max(0, [...shares].reduce((total, [row, share]) => total + share * of(row), 0)));
    const presets = new Map(
      this.presets.map((preset) => {
        const vowel = VOWELS.indexOf(preset);
        return [preset, vowel < 0 ? sum(Object.entries(expanded(preset)), get) : spoken[vowel]!];
      }),
    );
    const total = Math.max(1, [...presets.values()].reduce((all, weight) => all + weight, 0));
    for (const [target, shares] of this.shares) {
      set(target, sum(shares, (row) => (presets.has(row) ? presets.get(row)! / total : get(row))));
    }
  }
}

/* eslint-disable-next-line @typescript-eslint/no-explicit-any */
type Json = any;

/** The name of each morph target of a glTF mesh, from wherever exporters write it; 52 without any name are ARKit's. */
export function targetNames(document: Json, mesh: Json): string[] {
  const part = mesh.primitives[0];
  const targets: Json[] = part.targets ?? [];
  for (const { extras } of [mesh, part]) {
    if (targets.length && extras?.targetNames?.length === targets.length) return extras.targetNames.map(String);
  }
  const places: Json[] = targets.map((target) => document.accessors?.[target.POSITION] ?? {});
  const names = targets.map((target, k) => String((target.extra ?? target.extras ?? places[k]).name ?? ""));
  if (names.some(Boolean) || targets.length < APPLE_NAMES.length - 1 || targets.length > APPLE_NAMES.length) return names;
  const alphabet = [...APPLE_NAMES].sort();
  const reach = (order: readonly string[]) => {
    const { min = [0], max = [0] } = places[order.indexOf("jawOpen")];
    return Math.max(...[...min, ...max].map(Math.abs));
  };
  const order = reach(alphabet) > reach(APPLE_NAMES) ? alphabet : APPLE_NAMES;
  return order.filter((name) => targets.length === order.length || name !== "tongueOut");
}
