import { describe, expect, it, vi } from "vitest";
import { type Api, Refused, Unreachable } from "../src/api.js";
import type { Problem } from "../src/api.generated.js";
import { retry, Pause, wait } from "../src/retry.js";
import type { Draft } from "../src/rate/draft.js";
import { send } from "../src/rate/sending.js";

vi.stubGlobal("sessionStorage", { removeItem: vi.fn() });

const refused = (code: Problem["code"], retry_after = 0) => new Refused({ code, message: "", retry_after });
const saved = { is_repeated: false, progress: { done: 1, of: 2, is_finished: false } };
const draft = {
  task: "a/b",
  key: "k".repeat(32),
  sent: { type: "skip", reason: "cannot_play", seconds: 1, plays: [0, 0] },
} as unknown as Draft;

/** A fake API that returns these answers in turn and records the requests. */
function api(...answers: unknown[]) {
  const asked: unknown[][] = [];
  const post = (...words: unknown[]) => {
    asked.push(words);
    const next = answers.shift();
    return next instanceof Error ? Promise.reject(next) : Promise.resolve(next);
  };
  return { asked, api: { post } as unknown as Api };
}

const hasty = () => Object.assign(new Pause(), { sleep: () => Promise.resolve() });

describe("sending", () => {
  it("sends the same bytes under the same key until it is saved", async () => {
    const { api: line, asked } = api(new Unreachable(""), refused("internal"), new Unreachable(""), saved);
    const waits: number[] = [];
    const outcome = await send(line, draft, { pause: hasty(), onWait: (seconds) => waits.push(seconds) });
    expect(outcome).toEqual({ kind: "saved", saved });
    expect(asked).toHaveLength(4);
    expect(new Set(asked.map((words) => JSON.stringify(words))).size).toBe(1);
    expect(asked[0]![0]).toBe("/api/rater/tasks/a%2Fb/answer");
    expect(asked[0]![2]).toEqual({ "idempotency-key": draft.key });
    expect(waits).toEqual([1, 0, 2, 0, 4, 0]);
  });

  it.each(["already_judged", "key_reused", "not_found"] as const)("goes on after %s", async (code) => {
    expect(await send(api(refused(code)).api, draft)).toEqual({ kind: "elsewhere" });
  });

  it.each(["bad_csrf", "not_signed_in", "needs_consent"] as const)("asks who it is after %s", async (code) => {
    expect(await send(api(refused(code)).api, draft)).toEqual({ kind: "session" });
  });

  it("says when it will not be saved", async () => {
    expect(await send(api(refused("bad_request")).api, draft)).toMatchObject({ kind: "refused" });
  });
});

describe("retry", () => {
  it("waits as long as it is told, and longer each time where it is not", () => {
    expect(wait(refused("too_many_requests", 7), 0)).toBe(7);
    expect([0, 1, 2, 3, 4, 50].map((attempt) => wait(new Unreachable(""), attempt))).toEqual([1, 2, 4, 8, 15, 15]);
    expect(wait(refused("not_found"), 0)).toBeNull();
    expect(wait(new RangeError(), 0)).toBeNull();
  });

  it("can be hurried", async () => {
    const pause = new Pause();
    let tries = 0;
    const result = retry(() => (tries++ ? Promise.resolve("there") : Promise.reject(new Unreachable(""))), {
      pause,
      onWait: (seconds) => seconds && setTimeout(() => pause.hurry()),
    });
    const began = Date.now();
    expect(await result).toBe("there");
    expect(Date.now() - began).toBeLessThan(900); // the first wait is a second
  });
});
