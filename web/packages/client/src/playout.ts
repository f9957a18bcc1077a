/**
 * The sound queue behind the audio clock: plays samples in the order of the session's clock, waits when they run out.
 *
 * Runs inside the AudioWorklet, or on a wall clock while the page may not make sound yet. Starts with a jitter buffer:
 * when a whole chunk and the buffer are there, or the buffer's time has passed since the first sound came. Never
 * skips sound; starts and stops without clicks.
 */

/** From output frame `frame` on, sample `at` is played (and those after it), or nothing is. */
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
const GHOST = 0.96; // what remains, sample by sample, of the level at which sound was cut

export class Playout {
  private blocks: Block[] = [];
  private playing = false;
  private waited = 0;
  private level = 0; // gain while starting
  private ghost = 0; // what is left of a cut wave
  private last = 0;
  underruns = 0;
  /** Sample played next. */
  head = 0;

  constructor(private readonly jitter: number, private readonly chunk: number) {}

  /** First sample that is not there yet. */
  get end(): number {
    const last = this.blocks.at(-1);
    return last ? last.at + last.pcm.length : this.head;
  }

  /** Adds sound; what is there already is cut off its front, a hole before it is silence. */
  push(at: number, pcm: Float32Array): void {
    if (!this.blocks.length && !this.playing && at > this.head) this.head = at;
    const known = this.end;
    if (at + pcm.length <= known) return;
    if (at < known) [at, pcm] = [known, pcm.subarray(known - at)];
    this.blocks.push({ at, pcm });
  }

  /** Forgets all from `at` on; what was being heard stops. */
  flush(at: number): void {
    this.blocks = this.blocks
      .filter((block) => block.at < at)
      .map((block) => ({ at: block.at, pcm: block.pcm.subarray(0, Math.max(0, at - block.at)) }));
    if (at <= this.head) this.jump(at);
  }

  /** Starts over at `at`, empty: a new session. */
  jump(at: number): void {
    if (!Number.isInteger(at)) throw new RangeError(`the clock counts whole samples, not ${at}`);
    this.blocks = [];
    this.head = at;
    this.stop();
  }

  /** Fills `out` and says what changed on the way; `frame` is the output frame of its first sample. */
  process(out: Float32Array, frame: number): PlayoutMark[] {
    const marks: PlayoutMark[] = [];
    const mark = (offset: number) =>
      marks.push({ frame: frame + offset, at: this.head, playing: this.playing, underruns: this.underruns });
    for (let i = 0; i < out.length; ) {
      if (!this.playing && this.ready(out.length - i)) {
        this.playing = true;
        mark(i);
      }
      if (!this.playing) {
        while (i < out.length) out[i++] = this.fadeGhost();
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
    if (this.playing) this.ghost = this.last;
    this.playing = false;
    this.waited = this.level = this.last = 0;
  }

  /** Plays into `out` from `i` until it is full or nothing is left; returns how far it came. */
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
      out[i++] = this.last + this.fadeGhost();
      this.head++;
    }
    return i;
  }

  private fadeGhost(): number {
    if (this.ghost !== 0) this.ghost = Math.abs(this.ghost) < 1e-4 ? 0 : this.ghost * GHOST;
    return this.ghost;
  }
}
