/** The fields of study.yaml in the form: type, bounds and initial value of each. */

import { QUESTIONS } from "../api.generated.js";
import type { Key } from "../strings.js";
import type { Value } from "./yaml.js";

export type Kind = "pairwise" | "preference";

export interface NumberField {
  readonly name: string;
  readonly label: Key;
  readonly begin: number;
  readonly min: number;
  readonly max: number;
  readonly step?: number;
  /** The kind of study that has the field; both if absent. */
  readonly kind?: Kind;
}

/** In the order of the form; a dot separates nested keys of study.yaml. */
export const PEOPLE: readonly NumberField[] = [
  { name: "raters", label: "field_raters", begin: 20, min: 1, max: 2000 },
  { name: "tasks_per_rater", label: "field_tasks_per_rater", begin: 20, min: 1, max: 500 },
  { name: "training", label: "field_training", begin: 1, min: 0, max: 10 },
  { name: "checks.identical", label: "field_identical", begin: 1, min: 0, max: 10, kind: "pairwise" },
  { name: "checks.corrupted", label: "field_corrupted", begin: 1, min: 0, max: 10 },
  { name: "min_plays", label: "field_min_plays", begin: 1, min: 0, max: 10 },
  { name: "seed", label: "field_seed", begin: 0, min: 0, max: 2 ** 31 },
];
export const CANDIDATES: readonly NumberField[] = [
  { name: "candidates", label: "field_candidates", begin: 8, min: 2, max: 15, kind: "preference" },
  { name: "past", label: "field_past", begin: 3, min: 0, max: 40, kind: "preference" },
  { name: "length", label: "field_length", begin: 20, min: 1, max: 80, kind: "preference" },
  { name: "prompts_per_sound", label: "field_prompts_per_sound", begin: 1, min: 1, max: 50, kind: "preference" },
];
export const KEEPING: readonly NumberField[] = [
  { name: "keep.votes", label: "field_votes", begin: 1, min: 1, max: 2000, kind: "preference" },
  { name: "keep.agreement", label: "field_agreement", begin: 0.6, min: 0, max: 1, step: 0.05, kind: "preference" },
  { name: "keep.margin", label: "field_margin", begin: 0.3, min: 0, max: 1, step: 0.05, kind: "preference" },
];
export const CLIP_SECONDS: NumberField = {
  name: "seconds",
  label: "field_seconds",
  begin: 10,
  min: 1,
  max: 60,
  step: 0.5,
  kind: "pairwise",
};

export interface System {
  name: string;
  source: "model" | "clips";
  model: string;
  clips: string;
  seed: number;
  group: string;
}

export interface SoundChoice {
  path: string;
  category: string;
  start: number;
}

/** The form's values. */
export interface Choices {
  kind: Kind;
  title: string;
  language: string;
  /** If empty, the studio chooses; the same holds for `consent`. */
  intro: string;
  consent: string;
  model: string;
  presentation: "sequential" | "side_by_side";
  questions: string[];
  systems: System[];
  sounds: SoundChoice[];
  numbers: Record<string, number>;
}

export function beginChoices(): Choices {
  const numbers = Object.fromEntries(
    [...PEOPLE, ...CANDIDATES, ...KEEPING, CLIP_SECONDS].map((field) => [field.name, field.begin]),
  );
  return {
    kind: "pairwise",
    title: "",
    language: "en",
    intro: "",
    consent: "",
    model: "default",
    presentation: "sequential",
    questions: [...QUESTIONS],
    systems: [newSystem("default"), newSystem("")],
    sounds: [newSound()],
    numbers,
  };
}

export function newSystem(model: string): System {
  return { name: "", source: model ? "model" : "clips", model: model || "default", clips: "", seed: 0, group: "" };
}

export function newSound(): SoundChoice {
  return { path: "", category: "gesture", start: 0 };
}

/** The settings in the structure of study.yaml. */
export function settingsOf(choices: Choices): { readonly [name: string]: Value } {
  const { kind } = choices;
  const out: Record<string, Value> = { kind, title: choices.title, language: choices.language };
  if (choices.intro.trim()) out["intro"] = choices.intro;
  if (choices.consent.trim()) out["consent"] = choices.consent;
  if (kind === "preference") out["model"] = choices.model;
  else
    out["systems"] = choices.systems.map(({ name, source, model, clips, seed, group }) => ({
      name,
      ...(source === "model" ? { model, seed } : { clips }),
      ...(group && { group }),
    }));
  out["sounds"] = choices.sounds.map(({ path, category, start }) => ({ path, category, start }));
  if (kind === "pairwise") Object.assign(out, { presentation: choices.presentation, questions: choices.questions });
  for (const field of [CLIP_SECONDS, ...CANDIDATES, ...PEOPLE, ...KEEPING]) {
    if (field.kind && field.kind !== kind) continue;
    const [first, second] = field.name.split(".") as [string, string?];
    if (second)
      out[first] = { ...(out[first] as Record<string, Value> | undefined), [second]: choices.numbers[field.name]! };
    else out[first] = choices.numbers[field.name]!;
  }
  return out;
}
