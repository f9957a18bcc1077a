/** Retries: which errors may be retried, and how long to wait. */

import { Refused, Unreachable } from "./api.js";

const WAITS = [1, 2, 4, 8, 15]; // seconds; the last one repeats

/** Seconds to wait after `error` in attempt `attempt` (from 0); null if a retry would not help. */
export function wait(error: unknown, attempt: number): number | null {
  const usual = WAITS[Math.min(attempt, WAITS.length - 1)]!;
  if (error instanceof Unreachable) return usual;
  if (!(error instanceof Refused)) return null;
  if (error.code === "too_many_requests") return Math.max(error.problem.retry_after, 0.5);
  return error.code === "internal" || error.code === "busy" ? usual : null;
}

/** A wait that `hurry` ends early; it also ends when the browser is online again. */
export class Pause {
  private wake: (() => void) | null = null;

  constructor() {
    globalThis.addEventListener?.("online", () => this.hurry());
  }

  hurry(): void {
    this.wake?.();
  }

  sleep(seconds: number): Promise<void> {
    return new Promise((resolve) => {
      const timer = setTimeout(resolve, seconds * 1000);
      this.wake = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }
}

export interface RetryOptions {
  /** Called before each wait, and with 0 when the next attempt starts. */
  readonly onWait?: (seconds: number, error: unknown) => void;
  readonly pause?: Pause;
}

/** Repeats `work` until it succeeds or a retry would not help. */
export async function retry<Result>(
  work: () => Promise<Result>,
  { onWait, pause = new Pause() }: RetryOptions = {},
): Promise<Result> {
  for (let attempt = 0; ; attempt++) {
    try {
      return await work();
    } catch (error) {
      const seconds = wait(error, attempt);
      if (seconds === null) throw error;
      onWait?.(seconds, error);
      await pause.sleep(seconds);
      onWait?.(0, error);
    }
  }
}
