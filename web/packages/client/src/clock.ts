/** Maps time to the sample that is heard, from the audio thread's marks and the device's reported latency. */

import type { PlayoutMark } from "./playout.js";

const KEEP = 64;

/** Maps output frames to samples of the session's clock. */
export class PlaybackClock {
  private marks: PlayoutMark[] = [];

  mark(mark: PlayoutMark): void {
    this.marks.push(mark);
    if (this.marks.length > KEEP) this.marks.shift();
  }

  get underruns(): number {
    return this.marks.at(-1)?.underruns ?? 0;
  }

  /** Whether the playhead advances at output frame `frame`. */
  playingAt(frame: number): boolean {
    return this.find(frame)?.playing ?? false;
  }

  /** The sample that leaves the device at output frame `frame`; null before the first one. */
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
 * The output frame that leaves the loudspeaker at `milliseconds` of `performance.now()`. `getOutputTimestamp` accounts
 * for the device's buffers. Where it is missing or still zero, the context's own latency estimate is used. The result
 * never exceeds what has been rendered, so on an overloaded machine the clock waits for the sound.
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
