/** Sound outputs: the audio device, whose clock is the master, or a silent wall clock before the first click. */

import { PlaybackClock, outputFrame } from "./clock.js";
import { Playout, type PlayoutMark } from "./playout.js";
import type { PlaybackCommand } from "./worklets/playback.js";

export interface Transport {
  push(at: number, pcm: Float32Array): void;
  flush(at: number): void;
  jump(at: number): void;
  /** The sample heard at a time of `performance.now()`; null before the first one. */
  heardAt(milliseconds: number): number | null;
  playingAt(milliseconds: number): boolean;
  readonly underruns: number;
  close(): void;
}

export interface TransportSettings {
  readonly rate: number;
  readonly jitter: number;
  readonly chunk: number;
  /** Called about five times a second, also while the page is hidden. */
  readonly onTick: () => void;
}

const WALL_TICK = 50;

/** Consumes sound in real time without playing it, so that the avatar moves before the first click. */
export class WallTransport implements Transport {
  private readonly clock = new PlaybackClock();
  private readonly queue: Playout;
  private readonly started = performance.now();
  private readonly timer: ReturnType<typeof setInterval>;
  private played = 0;
  private ticks = 0;

  constructor(private readonly settings: TransportSettings) {
    this.queue = new Playout(settings.jitter, settings.chunk);
    this.timer = setInterval(() => this.advance(), WALL_TICK);
  }

  push(at: number, pcm: Float32Array): void {
    this.queue.push(at, pcm);
  }

  flush(at: number): void {
    this.advance();
    this.queue.flush(at);
    this.stopped();
  }

  jump(at: number): void {
    this.queue.jump(at);
    this.stopped();
  }

  heardAt(milliseconds: number): number | null {
    return this.clock.at(this.frame(milliseconds));
  }

  playingAt(milliseconds: number): boolean {
    return this.clock.playingAt(this.frame(milliseconds));
  }

  get underruns(): number {
    return this.clock.underruns;
  }

  close(): void {
    clearInterval(this.timer);
  }

  private frame(milliseconds: number): number {
    return ((milliseconds - this.started) / 1000) * this.settings.rate;
  }

  private advance(): void {
    const due = Math.floor(this.frame(performance.now())) - this.played;
    for (const mark of this.queue.process(new Float32Array(due), this.played)) this.clock.mark(mark);
    this.played += due;
    if (++this.ticks % Math.round(200 / WALL_TICK) === 0) this.settings.onTick();
  }

  private stopped(): void {
    this.clock.mark({ frame: this.played, at: this.queue.head, playing: false, underruns: this.queue.underruns });
  }
}

/** Plays through an AudioWorklet. */
export class AudioTransport implements Transport {
  private readonly clock = new PlaybackClock();

  private constructor(
    private readonly context: AudioContext,
    readonly node: AudioWorkletNode,
    onTick: () => void,
  ) {
    node.port.onmessage = ({ data }: MessageEvent<{ type: "mark"; mark: PlayoutMark } | { type: "tick" }>) => {
      if (data.type === "mark") this.clock.mark(data.mark);
      else onTick();
    };
  }

  static async create(context: AudioContext, worklet: string, settings: TransportSettings): Promise<AudioTransport> {
    await context.audioWorklet.addModule(worklet);
    const { jitter, chunk } = settings;
    const node = new AudioWorkletNode(context, "echoavatar-playback", {
      numberOfInputs: 0, outputChannelCount: [1], processorOptions: { jitter, chunk },
    });
    return new AudioTransport(context, node, settings.onTick);
  }

  push(at: number, pcm: Float32Array): void {
    this.command({ type: "push", at, pcm });
  }

  flush(at: number): void {
    this.command({ type: "flush", at });
  }

  jump(at: number): void {
    this.command({ type: "jump", at });
  }

  heardAt(milliseconds: number): number | null {
    return this.clock.at(outputFrame(this.context, milliseconds));
  }

  playingAt(milliseconds: number): boolean {
    return this.clock.playingAt(outputFrame(this.context, milliseconds));
  }

  get underruns(): number {
    return this.clock.underruns;
  }

  close(): void {
    this.node.disconnect();
    this.node.port.onmessage = null;
  }

  private command(command: PlaybackCommand): void {
    this.node.port.postMessage(command);
  }
}
