/** Trying again: what may be tried again, and how long to wait before it. */

import { Refused, Unreachable } from "./api.js";

const WAITS = [1, 2, 4, 8, 15]; // seconds; the last for ever

/** Seconds to wait before trying again after `error` the `attempt`-th time (from 0); null where that would not help. */
export function wait(error: unknown, attempt: number): number | null {
  const usual = WAITS[Math.min(attempt, WAITS.length - 1)]!;
  if (error instanceof Unreachable) return usual;
  if (!(error instanceof Refused)) return null;
  if (error.code === "too_many_requests") return Math.max(error.problem.retry_after, 0.5);
  return error.code === "internal" || error.code === "busy" ? usual : null;
}

/** A pause that can be cut short by `hurry`, and is when the connection comes back. */
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

export interface Insisting {
  /** Told before each pause, and with 0 when it goes on. */
  readonly onWait?: (seconds: number, error: unknown) => void;
  readonly pause?: Pause;
}

/** Does it until it succeeds or trying again would not help. */
export async function insist<Result>(
  work: () => Promise<Result>,
  { onWait, pause = new Pause() }: Insisting = {},
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
