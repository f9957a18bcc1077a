/**
 * The sound queue behind the audio clock: plays samples in the order of the session's clock and waits on underruns.
 *
 * It runs in the AudioWorklet, or on the wall clock while the page is not allowed to make sound. Playback starts when a
 * chunk and the jitter buffer are filled, or when the jitter buffer's time has passed since the first sound. Sound is
 * never skipped; starts and stops are free of clicks.
 */

/** From output frame `frame` on, playback runs from sample `at`, or is stopped there. */
export interface PlayoutMark {
  readonly frame: number;
  readonly at: number;
  readonly playing: boolean;
  readonly underruns: number;
}

interface Block {
  readonly at: number;
  readonly pcm: Float32Array;
}

const RAMP = 48; // samples from silence to full: 2 ms
const TAIL_DECAY = 0.96; // per sample; the last value decays to zero where sound is cut, which avoids a click

export class Playout {
  private blocks: Block[] = [];
  private playing = false;
  private waited = 0;
  private level = 0; // gain of the fade-in
  private tail = 0; // current value of the decaying tail
  private last = 0;
  private expected = 0; // output frame of the next call, unless some are left out
  underruns = 0;
  /** The next sample to play. */
  head = 0;

  constructor(private readonly jitter: number, private readonly chunk: number) {}

  /** First sample that is not buffered yet. */
  get end(): number {
    const last = this.blocks.at(-1);
    return last ? last.at + last.pcm.length : this.head;
  }

  /** Adds sound. Samples that are already buffered are dropped; a gap before it plays as silence. */
  push(at: number, pcm: Float32Array): void {
    if (!this.blocks.length && !this.playing && at > this.head) this.head = at;
    const known = this.end;
    if (at + pcm.length <= known) return;
    if (at < known) [at, pcm] = [known, pcm.subarray(known - at)];
    this.blocks.push({ at, pcm });
  }

  /** Drops everything from `at` on; playback stops if it is already past `at`. */
  flush(at: number): void {
    this.blocks = this.blocks
      .filter((block) => block.at < at)
      .map((block) => ({ at: block.at, pcm: block.pcm.subarray(0, Math.max(0, at - block.at)) }));
    if (at <= this.head) this.jump(at);
  }

  /** Empties the queue and continues at `at`, for a new session. */
  jump(at: number): void {
    if (!Number.isInteger(at)) throw new RangeError(`the clock counts whole samples, not ${at}`);
    this.blocks = [];
    this.head = at;
    this.stop();
  }

  /** Fills `out` and returns the changes of state; `frame` is the output frame of its first sample. */
  process(out: Float32Array, frame: number): PlayoutMark[] {
    const marks: PlayoutMark[] = [];
    const mark = (offset: number) =>
      marks.push({ frame: frame + offset, at: this.head, playing: this.playing, underruns: this.underruns });
    if (this.playing && frame !== this.expected) mark(0); // a busy browser skipped the worklet, so this sound comes later
    this.expected = frame + out.length;
    for (let i = 0; i < out.length; ) {
      if (!this.playing && this.ready(out.length - i)) {
        this.playing = true;
        mark(i);
      }
      if (!this.playing) {
        while (i < out.length) out[i++] = this.nextTail();
        break;
      }
      i = this.copy(out, i);
      if (i < out.length) {
        this.underruns++;
        this.stop();
        mark(i);
      }
    }
    return marks;
  }

  private ready(samples: number): boolean {
    const buffered = this.end - this.head;
    if (buffered <= 0) return false;
    this.waited += samples;
    return buffered >= this.chunk + this.jitter || this.waited >= this.jitter;
  }

  private stop(): void {
    if (this.playing) this.tail = this.last;
    this.playing = false;
    this.waited = this.level = this.last = 0;
  }

  /** Copies sound into `out` from `i` until it is full or the queue is empty; returns the index reached. */
  private copy(out: Float32Array, i: number): number {
    while (i < out.length) {
      const block = this.blocks[0];
      if (!block) return i;
      const offset = this.head - block.at;
      if (offset >= block.pcm.length) {
        this.blocks.shift();
        continue;
      }
      this.level = Math.min(1, this.level + 1 / RAMP);
      this.last = offset < 0 ? 0 : block.pcm[offset]! * this.level;
      out[i++] = this.last + this.nextTail();
      this.head++;
    }
    return i;
  }

  private nextTail(): number {
    if (this.tail !== 0) this.tail = Math.abs(this.tail) < 1e-4 ? 0 : this.tail * TAIL_DECAY;
    return this.tail;
  }
}
