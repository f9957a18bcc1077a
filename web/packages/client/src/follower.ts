/**
 * Motion beside sound that somebody else plays: a WebRTC stack, another player. Messages come from a transport of theirs;
 * the pose follows the time at which the sound of each message is due.
 */

import type { AvatarDriver } from "./driver.js";
import { Inertia } from "./inertia.js";
import type { Picture } from "./player.js";
import { type Pose, makePose } from "./pose.js";
import type { MotionMessage, ReadyMessage, ServerMessage } from "./protocol.generated.js";
import { MotionTimeline } from "./timeline.js";

const FAR_MS = 250; // a due time this far from the expected one is a new beginning, not jitter
const SHARE = 0.05; // of a smaller difference, by which the expectation follows

export interface FollowerOptions {
  /** Milliseconds that sound takes from its due time to the ear: the jitter buffer and the device. */
  readonly delay?: number;
}

export class Follower {
  private stream: { ready: ReadyMessage; timeline: MotionTimeline; inertia: Inertia; pose: Pose } | null = null;
  private origin: number | null = null; // when sample 0 is due, on the clock of performance.now()
  private epoch = 0;
  private isJump = false;
  private last = 0;
  private readonly delay: number;
  /** Called with the rig and the names of the face's curves, once they are known and again after a change. */
  onReady: ((ready: ReadyMessage) => void) | null = null;

  constructor({ delay = 100 }: FollowerOptions = {}) {
    this.delay = delay;
  }

  /** Takes a message; `due` is when the first frame of motion is due, on the clock of performance.now(). */
  take(message: ServerMessage, due = performance.now()): void {
    if (message.type === "ready") this.begin(message);
    else if (message.type === "motion") this.move(message, due);
    else if (message.type === "flush") {
      this.epoch = message.epoch;
      this.stream?.timeline.flush(message.at);
      this.isJump = true;
    }
  }

  /** The picture for a display frame, null before there is motion. */
  picture(now: number): Picture | null {
    if (!this.stream || this.origin === null) return null;
    const { ready, timeline, inertia, pose } = this.stream;
    const at = ((now - this.delay - this.origin) / 1000) * ready.sample_rate;
    const found = timeline.sample(at, pose);
    if (!found) return null;
    inertia.apply(pose, Math.min(1, (now - this.last) / 1000), this.isJump);
    this.isJump = false;
    this.last = now;
    timeline.prune(at);
    return { pose, state: found.state, at: found.at, held: found.held };
  }

  /** Moves an avatar with every display frame; returns a function that stops it. */
  drive(avatar: AvatarDriver, draw: () => void = () => undefined): () => void {
    let before = performance.now();
    let handle = 0;
    this.onReady = (ready) => avatar.bind(ready);
    if (this.stream) avatar.bind(this.stream.ready);
    const frame = (now: number): void => {
      const picture = this.picture(now);
      if (picture) avatar.apply(picture.pose);
      avatar.update((now - before) / 1000);
      before = now;
      draw();
      handle = requestAnimationFrame(frame);
    };
    handle = requestAnimationFrame(frame);
    return () => cancelAnimationFrame(handle);
  }

  private begin(ready: ReadyMessage): void {
    const known = this.stream?.ready;
    if (known && known.session === ready.session && known.rig.names.length === ready.rig.names.length) return;
    const [joints, curves] = [ready.rig.names.length, ready.face.length];
    const hop = ready.sample_rate / ready.frame_rate;
    this.stream = {
      ready,
      timeline: new MotionTimeline(joints, curves, hop, ready.sample_rate),
      inertia: new Inertia(joints, curves),
      pose: makePose(joints, curves),
    };
    this.origin = null;
    this.epoch = ready.epoch;
    this.onReady?.(ready);
  }

  private move(motion: MotionMessage, due: number): void {
    if (!this.stream || motion.epoch < this.epoch) return;
    const origin = due - (motion.at / this.stream.ready.sample_rate) * 1000;
    const off = this.origin === null ? Infinity : origin - this.origin;
    if (Math.abs(off) > FAR_MS) {
      this.origin = origin;
      this.isJump = true;
    } else this.origin! += SHARE * off;
    this.stream.timeline.insert(motion);
  }
}
