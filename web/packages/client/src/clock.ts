/** Which sample is heard when: marks from the audio thread, and what the device says about its latency. */

import type { PlayoutMark } from "./playout.js";

const KEEP = 64;

/** Turns output frames into samples of the session's clock. */
export class PlaybackClock {
  private marks: PlayoutMark[] = [];

  mark(mark: PlayoutMark): void {
    this.marks.push(mark);
    if (this.marks.length > KEEP) this.marks.shift();
  }

  get underruns(): number {
    return this.marks.at(-1)?.underruns ?? 0;
  }

  /** Whether sound, or its silence, moves on at output frame `frame`. */
  playingAt(frame: number): boolean {
    return this.find(frame)?.playing ?? false;
  }

  /** The sample that leaves the device at output frame `frame`; null before any did. */
  at(frame: number): number | null {
    const mark = this.find(frame);
    if (!mark) return this.marks[0]?.at ?? null;
    return mark.playing ? mark.at + Math.max(0, frame - mark.frame) : mark.at;
  }

  private find(frame: number): PlayoutMark | undefined {
    return this.marks.findLast((mark) => mark.frame <= frame);
  }
}

/**
 * The output frame that leaves the loudspeaker at `milliseconds` of `performance.now()`. `getOutputTimestamp` knows
 * the device's buffers; where it is missing or still at zero, the context's own estimate of its latency has to do.
 * Nothing is heard before it was rendered: on a machine too busy for its sound, the clock waits with the sound.
 */
export function outputFrame(context: AudioContext, milliseconds: number): number {
  const now = performance.now();
  const stamp = context.getOutputTimestamp?.();
  let seconds = context.currentTime - (context.outputLatency || context.baseLatency || 0);
  if (stamp?.contextTime && stamp.performanceTime && context.state === "running") {
    const told = stamp.contextTime + (now - stamp.performanceTime) / 1000;
    if (Math.abs(told - seconds) < 0.5) seconds = Math.min(told, context.currentTime);
  }
  return Math.max(0, (seconds + (milliseconds - now) / 1000) * context.sampleRate);
}
