/**
 * A rater's unsaved choices for a task, kept in this tab so that a reload loses nothing.
 *
 * The idempotency key is created with the draft and kept until the server has answered, so that sending an answer again
 * stores it once. `sent` is the answer as it was sent; after that the draft does not change.
 */

import type { Answer, RaterTask } from "../api.generated.js";

const PREFIX = "judgement ";

export interface Draft {
  readonly task: string;
  key: string;
  /** Seconds spent before this page load. */
  spent: number;
  plays: number[];
  watched: number[];
  ratings: Record<string, number>;
  best: number | null;
  worst: number | null;
  sent: Answer | null;
}

/** The draft of a task: the stored one, or a new one. */
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
    // storage is full or disabled: only a reload would lose the draft
  }
}

export function dropDraft(task: string, store: Storage = sessionStorage): void {
  store.removeItem(PREFIX + task);
}

/** Answers that were sent but not yet confirmed. */
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
