/** Plays a session: sends sound to the device and returns the pose of the sample that is heard. */

import { pcmToFloat } from "./codec.js";
import { Inertia } from "./inertia.js";
import { SyncMeter } from "./metrics.js";
import { OpusPlayer } from "./opus.js";
import { type Pose, makePose } from "./pose.js";
import type { FlushMessage, MotionMessage, PackedSoundMessage, ReadyMessage, SoundMessage } from "./protocol.generated.js";
import { MotionTimeline } from "./timeline.js";
import { AudioTransport, type Transport, type TransportSettings, WallTransport } from "./transport.js";

export const JITTER_SECONDS = 0.1;
const SLOWEST_PICTURE = 120; // ms; upper bound of the predicted delay until a display frame is on screen
const JUMP_FRAMES = 5; // motion that skips more frames than this between two display frames is blended

export interface Picture {
  readonly pose: Pose;
  readonly state: MotionMessage["state"];
  /** The sample that the pose belongs to. */
  readonly at: number;
  readonly held: boolean;
}

export class Player {
  readonly sync: SyncMeter;
  readonly pose: Pose;
  private readonly timeline: MotionTimeline;
  private readonly inertia: Inertia;
  private readonly hop: number;
  private readonly opus: OpusPlayer;
  private transport: Transport;
  private sounds: { at: number; pcm: Float32Array }[] = [];
  private epoch: number;
  private stopped: number | null = null; // where playback was interrupted, until the server answers
  private passed: number; // frames before this sample were passed to `onFrame`
  private shown: { at: number; held: boolean } | null = null;
  private lastPicture = 0;
  private interval = 16;

  constructor(private readonly ready: ReadyMessage, private readonly onTick: () => void) {
    const { rig, face, sample_rate: rate } = ready;
    this.hop = rate / ready.frame_rate;
    this.timeline = new MotionTimeline(rig.names.length, face.length, this.hop, rate);
    this.inertia = new Inertia(rig.names.length, face.length);
    this.pose = makePose(rig.names.length, face.length);
    this.sync = new SyncMeter(rate);
    this.epoch = ready.epoch;
    this.opus = new OpusPlayer(rate, (at, pcm) => this.play(at, pcm));
    this.transport = new WallTransport(this.settings);
    this.transport.jump(ready.at);
    this.passed = ready.at;
  }

  /** Called once with each frame of the session after it was played, also while the page is hidden. */
  onFrame: ((pose: Pose) => void) | null = null;

  /** Switches from the wall clock to the audio device; returns the node to connect. */
  async attach(context: AudioContext, worklet: string): Promise<AudioNode> {
    const audio = await AudioTransport.create(context, worklet, this.settings);
    audio.jump(Math.round(this.heard));
    for (const sound of this.sounds) audio.push(sound.at, sound.pcm);
    this.transport.close();
    this.transport = audio;
    return audio.node;
  }

  takeMotion(motion: MotionMessage): void {
    if (this.stopped === null && motion.epoch >= this.epoch) this.timeline.insert(motion);
  }

  takeSound(sound: SoundMessage): void {
    if (this.stopped !== null || sound.epoch < this.epoch) return;
    this.play(sound.at, pcmToFloat(sound.pcm));
  }

  takePacked(sound: PackedSoundMessage): void {
    if (this.stopped === null && sound.epoch >= this.epoch) this.opus.take(sound);
  }

  private play(at: number, pcm: Float32Array): void {
    this.sounds.push({ at, pcm });
    this.transport.push(at, pcm);
  }

  takeFlush(flush: FlushMessage): void {
    this.epoch = flush.epoch;
    this.stopped = null;
    this.cut(flush.at);
  }

  /** Stops at once, before the server answers; returns the first sample that was not heard. */
  interrupt(): number {
    const at = Math.round(this.heard);
    this.stopped = at;
    this.cut(at);
    return at;
  }

  /** Continues after a reconnect; returns the interruption that the server may not have received. */
  resume(ready: ReadyMessage): number | null {
    this.epoch = ready.epoch;
    this.opus.stop(); // the last chunk is sent again
    return this.stopped;
  }

  get played(): { at: number; epoch: number; underruns: number } {
    return { at: Math.round(this.heard), epoch: this.epoch, underruns: this.transport.underruns };
  }

  /** The sample that is heard now. */
  get heard(): number {
    return this.transport.heardAt(performance.now()) ?? this.ready.at;
  }

  heardAt(milliseconds: number): number | null {
    return this.transport.heardAt(milliseconds);
  }

  get playing(): boolean {
    return this.transport.playingAt(performance.now());
  }

  /** First sample that was not received: a resumed session is sent again from here. */
  get received(): number {
    const last = this.sounds.at(-1);
    return Math.min(this.timeline.end || this.ready.at, last ? last.at + last.pcm.length : this.ready.at);
  }

  /** Seconds of motion buffered ahead of the playhead. */
  get ahead(): number {
    return Math.max(0, this.timeline.end - this.heard) / this.ready.sample_rate;
  }

  /** The picture for a display frame that begins at `now` (`performance.now()`); null before any motion arrived. */
  picture(now: number): Picture | null {
    this.measure(now);
    const heard = this.transport.heardAt(now + this.interval) ?? this.ready.at;
    const found = this.timeline.sample(Math.min(heard, this.stopped ?? heard), this.pose);
    if (!found) return null;
    this.inertia.apply(this.pose, (now - this.lastPicture) / 1000, this.jumped(found));
    this.lastPicture = now;
    this.shown = found;
    return { pose: this.pose, ...found };
  }

  close(): void {
    this.opus.stop();
    this.transport.close();
  }

  private get settings(): TransportSettings {
    const { sample_rate: rate, chunk_samples: chunk } = this.ready;
    return { rate, jitter: rate * JITTER_SECONDS, chunk, onTick: () => this.tick() };
  }

  private cut(at: number): void {
    this.opus.stop();
    this.timeline.flush(at);
    this.transport.flush(at);
    this.sounds = this.sounds
      .filter((sound) => sound.at < at)
      .map((sound) => ({ at: sound.at, pcm: sound.pcm.subarray(0, at - sound.at) }));
  }

  /** The previous picture reached the screen about when this display frame begins; its sync is measured then. */
  private measure(now: number): void {
    const gap = now - this.lastPicture;
    if (this.lastPicture && gap > 0) this.interval += (Math.min(gap, SLOWEST_PICTURE) - this.interval) * 0.1;
    const heard = this.transport.heardAt(now);
    if (this.shown && heard !== null && gap < 1000 && this.transport.playingAt(now)) {
      this.sync.add(this.shown.at, heard, this.shown.held);
    }
  }

  private jumped(found: { at: number; held: boolean }): boolean {
    if (!this.shown) return false;
    const moved = found.at - this.shown.at;
    if (moved < -1 || moved > JUMP_FRAMES * this.hop) return true;
    return this.shown.held && moved > 1.5 * this.hop;
  }

  /** Drops what was played; called five times a second. */
  private tick(): void {
    const { heard } = this;
    if (this.onFrame) for (const pose of this.timeline.between(this.passed, heard)) this.onFrame(pose);
    this.passed = heard;
    this.timeline.prune(heard);
    while (this.sounds.length && this.sounds[0]!.at + this.sounds[0]!.pcm.length < heard - this.ready.sample_rate) {
      this.sounds.shift();
    }
    this.onTick();
  }
}
