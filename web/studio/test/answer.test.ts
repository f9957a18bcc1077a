import { describe, expect, it } from "vitest";
import type { RaterTask, StudyFace } from "../src/api.generated.js";
import { answerOf, isReady, mark, skipOf, unwatched } from "../src/rate/answer.js";
import { dropDraft, keepDraft, newKey, openDraft, unsaved } from "../src/rate/draft.js";

const study = (changes: Partial<StudyFace> = {}): StudyFace => ({
  title: "",
  kind: "pairwise",
  language: "en",
  intro: "",
  consent: "",
  presentation: "side_by_side",
  questions: ["human_likeness", "beat_matching"],
  min_plays: 1,
  ...changes,
});
const task = (clips: number, id = "t1"): RaterTask => ({
  id,
  stage: "rating",
  number: 1,
  seconds: 4,
  audio: "/a",
  clips: Array.from({ length: clips }, (_, k) => `/c${k}`),
  first: 0,
});

class Memory implements Storage {
  private readonly kept = new Map<string, string>();
  get length() {
    return this.kept.size;
  }
  clear() {
    this.kept.clear();
  }
  getItem(key: string) {
    return this.kept.get(key) ?? null;
  }
  key(index: number) {
    return [...this.kept.keys()][index] ?? null;
  }
  removeItem(key: string) {
    this.kept.delete(key);
  }
  setItem(key: string, value: string) {
    this.kept.set(key, value);
  }
}

describe("a draft", () => {
  it("is an answer when all was watched and every question answered", () => {
    const draft = openDraft(task(2), new Memory());
    draft.ratings = { human_likeness: -2, beat_matching: 0 };
    expect(isReady(draft, study())).toBe(false);
    expect(unwatched(draft, study())).toEqual([0, 1]);
    draft.watched = [1, 1];
    draft.plays = [2, 20_000];
    expect(answerOf(draft, study(), 12.3456)).toEqual({
      type: "pairwise",
      ratings: { human_likeness: -2, beat_matching: 0 },
      seconds: 12.35,
      plays: [2, 10_000],
    });
  });

  it("is none while a question is open, however often it was watched", () => {
    const draft = openDraft(task(2), new Memory());
    Object.assign(draft, { watched: [9, 9], ratings: { human_likeness: 0 } });
    expect(isReady(draft, study())).toBe(false);
    expect(() => answerOf(draft, study(), 1)).toThrow(RangeError);
  });

  it("needs nothing watched where the study says so", () => {
    expect(unwatched(openDraft(task(8), new Memory()), study({ min_plays: 0 }))).toEqual([]);
  });

  it("has one best and one worst, never the same clip", () => {
    const draft = openDraft(task(8), new Memory());
    mark(draft, "best", 3);
    mark(draft, "worst", 3);
    expect([draft.best, draft.worst]).toEqual([null, 3]);
    mark(draft, "best", 0);
    mark(draft, "worst", 3); // a second mark removes it
    expect([draft.best, draft.worst]).toEqual([0, null]);
  });

  it("can be skipped, and tells why", () => {
    expect(skipOf(openDraft(task(2), new Memory()), "cannot_play", -1)).toEqual({
      type: "skip",
      reason: "cannot_play",
      seconds: 0,
      plays: [0, 0],
    });
  });

  it("survives a reload with its key", () => {
    const store = new Memory();
    const draft = openDraft(task(2), store);
    draft.ratings = { human_likeness: 1 };
    keepDraft(draft, store);
    expect(openDraft(task(2), store)).toEqual(draft);
    expect(openDraft(task(2, "t2"), store).key).not.toBe(draft.key);
  });

  it("is found again only when it was sent and not yet receipted", () => {
    const store = new Memory();
    const draft = openDraft(task(2), store);
    keepDraft(draft, store);
    expect(unsaved(store)).toEqual([]);
    draft.sent = skipOf(draft, "cannot_play", 1);
    keepDraft(draft, store);
    store.setItem("judgement broken", "{");
    expect(unsaved(store).map(({ key }) => key)).toEqual([draft.key]);
    dropDraft("t1", store);
    expect(unsaved(store)).toEqual([]);
  });

  it("has a key that the studio takes", () => {
    expect(newKey()).toMatch(/^[A-Za-z0-9_-]{8,64}$/);
    expect(newKey()).not.toBe(newKey());
  });
});
