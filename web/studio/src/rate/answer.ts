/** Checks whether a draft is complete, and what is missing. */

import type { Answer, StudyFace } from "../api.generated.js";
import type { Draft } from "./draft.js";

const LONGEST = 86_400; // seconds; the studio's limit
const MOST = 10_000; // plays; the studio's limit

/** Indices of clips that were not yet watched to the end as often as the study requires. */
export function unwatched(draft: Draft, study: StudyFace): number[] {
  return draft.watched.flatMap((times, slot) => (times < study.min_plays ? [slot] : []));
}

/** Whether all questions are answered, or best and worst are chosen. */
export function isChosen(draft: Draft, study: StudyFace): boolean {
  if (study.kind === "pairwise") return study.questions.every((question) => draft.ratings[question] !== undefined);
  return draft.best !== null && draft.worst !== null && draft.best !== draft.worst;
}

export function isReady(draft: Draft, study: StudyFace): boolean {
  return isChosen(draft, study) && !unwatched(draft, study).length;
}

/** Marks a clip as best or worst, or removes the mark; a clip cannot be both. */
export function mark(draft: Draft, which: "best" | "worst", slot: number): void {
  const other = which === "best" ? "worst" : "best";
  draft[which] = draft[which] === slot ? null : slot;
  if (draft[other] === slot) draft[other] = null;
}

/** The message for the studio. `seconds` counts from the task's first display frame. */
export function answerOf(draft: Draft, study: StudyFace, seconds: number): Answer {
  if (!isReady(draft, study)) throw new RangeError("this draft is no answer yet");
  const rest = extras(draft, seconds);
  if (study.kind === "pairwise") {
    const ratings = Object.fromEntries(study.questions.map((question) => [question, draft.ratings[question]!]));
    return { type: "pairwise", ratings, ...rest };
  }
  return { type: "preference", best: draft.best!, worst: draft.worst!, ...rest };
}

export function skipOf(draft: Draft, reason: "no_difference" | "cannot_play", seconds: number): Answer {
  return { type: "skip", reason, ...extras(draft, seconds) };
}

function extras(draft: Draft, seconds: number): { seconds: number; plays: number[] } {
  const rounded = Math.round(Math.min(Math.max(seconds, 0), LONGEST) * 100) / 100;
  return { seconds: rounded, plays: draft.plays.map((count) => Math.min(count, MOST)) };
}
