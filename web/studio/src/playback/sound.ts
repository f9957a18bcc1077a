/** The sound of a task, and the clock of all motion: the second that is heard now, by what the device says. */

import { outputFrame } from "@echoavatar/client";

const LEAD = 0.06; // seconds from the wish to the first sample
const DECODE_RATE = 48_000;

/** Reads a sound file before there is a loudspeaker to play it: that one is opened by a click. */
export function decode(bytes: ArrayBuffer): Promise<AudioBuffer> {
  return new OfflineAudioContext(1, 1, DECODE_RATE).decodeAudioData(bytes);
}

export class Sound {
  private context: AudioContext | null = null;
  private volume: GainNode | null = null;
  private source: AudioBufferSourceNode | null = null;
  private started = 0; // context seconds at which `offset` leaves the context
  private offset = 0;
  private silent = false;
  private wish = 0; // the newest call of `play`: an older one that still waits for the device gives way

  get muted(): boolean {
    return this.silent;
  }

  set muted(muted: boolean) {
    this.silent = muted;
    if (this.volume && this.context) this.volume.gain.setTargetAtTime(muted ? 0 : 1, this.context.currentTime, 0.02);
  }

  /** Plays from second `offset`; looped, it goes round after `seconds` without a gap. Call it from a click or a key. */
  async play(buffer: AudioBuffer, offset: number, seconds: number, isLooped: boolean): Promise<void> {
    this.stop();
    const wish = ++this.wish;
    const context = (this.context ??= new AudioContext({ latencyHint: "interactive" }));
    if (context.state !== "running") await context.resume();
    if (wish !== this.wish) return;
    this.volume ??= connect(context, this.silent);
    const source = context.createBufferSource();
    source.buffer = buffer;
    source.loop = isLooped;
    source.loopEnd = Math.min(seconds, buffer.duration);
    source.connect(this.volume);
    [this.source, this.started, this.offset] = [source, context.currentTime + LEAD, offset];
    source.start(this.started, offset);
  }

  /** Stops, and tells the second at which it was. */
  stop(): number {
    const at = this.position(performance.now()) ?? 0;
    this.wish++;
    this.source?.stop();
    this.source?.disconnect();
    this.source = null;
    return at;
  }

  /**
   * Seconds heard since second 0 of the sound at a time of `performance.now()`, all rounds of a loop counted;
   * null while nothing plays.
   */
  position(milliseconds: number): number | null {
    if (!this.source || !this.context) return null;
    const heard = outputFrame(this.context, milliseconds) / this.context.sampleRate;
    return this.offset + Math.max(0, heard - this.started);
  }
}

function connect(context: AudioContext, isSilent: boolean): GainNode {
  const volume = context.createGain();
  volume.gain.value = isSilent ? 0 : 1;
  volume.connect(context.destination);
  return volume;
}
