/** The sound of a task and the clock of all motion: the second heard now, according to the audio device. */

import { outputFrame } from "@echoavatar/client";

const LEAD = 0.06; // seconds from `play` to the first sample
const DECODE_RATE = 48_000;

/** Decodes a sound file offline, because an audio output can only be opened by a click. */
export function decode(bytes: ArrayBuffer): Promise<AudioBuffer> {
  return new OfflineAudioContext(1, 1, DECODE_RATE).decodeAudioData(bytes);
}

export class Sound {
  private context: AudioContext | null = null;
  private volume: GainNode | null = null;
  private source: AudioBufferSourceNode | null = null;
  private started = 0; // context time at which `offset` is output
  private offset = 0;
  private silent = false;
  private request = 0; // number of the newest `play` call; older calls that still wait for the device give up

  get muted(): boolean {
    return this.silent;
  }

  set muted(muted: boolean) {
    this.silent = muted;
    if (this.volume && this.context) this.volume.gain.setTargetAtTime(muted ? 0 : 1, this.context.currentTime, 0.02);
  }

  /** Plays from second `offset`, looped after `seconds` without a gap if asked. Call it from a click or a key. */
  async play(buffer: AudioBuffer, offset: number, seconds: number, isLooped: boolean): Promise<void> {
    this.stop();
    const request = ++this.request;
    const context = (this.context ??= new AudioContext({ latencyHint: "interactive" }));
    if (context.state !== "running") await context.resume();
    if (request !== this.request) return;
    this.volume ??= connect(context, this.silent);
    const source = context.createBufferSource();
    source.buffer = buffer;
    source.loop = isLooped;
    source.loopEnd = Math.min(seconds, buffer.duration);
    source.connect(this.volume);
    [this.source, this.started, this.offset] = [source, context.currentTime + LEAD, offset];
    source.start(this.started, offset);
  }

  /** Stops and returns the current second. */
  stop(): number {
    const at = this.position(performance.now()) ?? 0;
    this.request++;
    this.source?.stop();
    this.source?.disconnect();
    this.source = null;
    return at;
  }

  /**
   * Seconds heard since second 0 of the sound at a time of `performance.now()`, including all rounds of a loop; null
   * while nothing plays.
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
