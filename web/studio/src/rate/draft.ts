/**
 * What a rater has chosen for a task before it is saved, kept in this tab: a reload loses nothing.
 *
 * The idempotency key is made with the draft and stays with it until the server has answered, so an answer that is sent
 * again is the same answer. `sent` is the answer as it went out: after that the draft changes no more.
 */

import type { Answer, RaterTask } from "../api.generated.js";

const PREFIX = "judgement ";

export interface Draft {
  readonly task: string;
  key: string;
  /** Seconds spent before this page was loaded. */
  spent: number;
  plays: number[];
  watched: number[];
  ratings: Record<string, number>;
  best: number | null;
  worst: number | null;
  sent: Answer | null;
}

/** The draft of a task: the one kept, or a new one. */
export function openDraft(task: RaterTask, store: Storage = sessionStorage): Draft {
  const kept = read(store, PREFIX + task.id);
  if (kept && kept.plays.length === task.clips.length) return kept;
  const none = () => task.clips.map(() => 0);
  return {
    task: task.id,
    key: newKey(),
    spent: 0,
    plays: none(),
    watched: none(),
    ratings: {},
    best: null,
    worst: null,
    sent: null,
  };
}

export function keepDraft(draft: Draft, store: Storage = sessionStorage): void {
  try {
    store.setItem(PREFIX + draft.task, JSON.stringify(draft));
  } catch {
    // full or forbidden: a reload would lose the draft, nothing more
  }
}

export function dropDraft(task: string, store: Storage = sessionStorage): void {
  store.removeItem(PREFIX + task);
}

/** Answers that went out and were not yet said to be saved. */
export function unsaved(store: Storage = sessionStorage): Draft[] {
  const keys = Array.from({ length: store.length }, (_, i) => store.key(i)!).filter((key) => key.startsWith(PREFIX));
  return keys.map((key) => read(store, key)).filter((draft): draft is Draft => draft !== null && draft.sent !== null);
}

/** 32 random hexadecimal digits. */
export function newKey(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

function read(store: Storage, key: string): Draft | null {
  try {
    const draft = JSON.parse(store.getItem(key) ?? "null") as Draft | null;
    return draft && typeof draft.key === "string" && Array.isArray(draft.plays) ? draft : null;
  } catch {
    return null;
  }
}
