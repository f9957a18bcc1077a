/**
 * Motion on the session's clock: ordered frames, interpolated at any sample.
 *
 * Frame k of a message belongs to sample `at + k * hop`. Rotations are interpolated by slerp, across messages too. Where
 * frames are missing the last pose is held, and `at` of the result is the sample of the held frame.
 */

import type { MotionMessage } from "./protocol.generated.js";
import { type Pose, copyPose, makePose } from "./pose.js";
import { slerp } from "./quaternion.js";

/** The result of `sample`. */
export interface Found {
  /** The sample that the pose belongs to: the requested one, or that of the held frame. */
  readonly at: number;
  /** True when there is no motion for the requested sample and the last frame is held. */
  readonly held: boolean;
  /** The state that the server sent with the frame. */
  readonly state: MotionMessage["state"];
}

interface Frame {
  readonly at: number;
  readonly epoch: number;
  readonly pose: Pose;
  readonly state: MotionMessage["state"];
}

const KEEP_SECONDS = 1; // kept behind the playhead, because the output latency shifts the shown pose back
const BRIDGE_FRAMES = 12; // gaps up to this long are interpolated when both ends are known

export class MotionTimeline {
  private frames: Frame[] = [];

  constructor(
    private readonly joints: number,
    private readonly curves: number,
    private readonly hop: number,
    private readonly sampleRate: number,
  ) {}

  /** The first sample after the last frame; 0 when empty. */
  get end(): number {
    const last = this.frames.at(-1);
    return last ? last.at + this.hop : 0;
  }

  /** Adds the frames of a message. Existing frames are kept, unless an interruption made them stale. */
  insert(motion: MotionMessage): void {
    const { epoch, state } = motion;
    const poses = unpackPoses(motion, this.joints, this.curves);
    for (const [k, pose] of poses.entries()) this.put({ at: motion.at + k * this.hop, epoch, pose, state });
  }

  /** Drops all frames from `at` on. */
  flush(at: number): void {
    this.frames = this.frames.filter((frame) => frame.at < at);
  }

  /** Drops frames too far behind the playhead to be shown again; the newest frame always stays. */
  prune(playhead: number): void {
    const limit = playhead - KEEP_SECONDS * this.sampleRate;
    let old = 0;
    while (old < this.frames.length - 1 && this.frames[old + 1]!.at < limit) old++;
    if (old) this.frames.splice(0, old);
  }

  /** The poses of the frames in [from, to). */
  *between(from: number, to: number): Generator<Pose> {
    for (const frame of this.frames) if (frame.at >= from && frame.at < to) yield frame.pose;
  }

  /** Fills `out` with the pose at sample `at`; null while there are no frames. */
  sample(at: number, out: Pose): Found | null {
    const next = this.after(at);
    const before = this.frames[next - 1];
    const after = this.frames[next];
    if (!before && !after) return null;
    if (before && after && after.at - before.at <= BRIDGE_FRAMES * this.hop) {
      mix(before.pose, after.pose, (at - before.at) / (after.at - before.at), out);
      return { at, held: false, state: before.state };
    }
    const frame = before ?? after!;
    copyPose(frame.pose, out);
    return { at: frame.at, held: at !== frame.at, state: frame.state };
  }

  /** Index of the first frame after `at`. */
  private after(at: number): number {
    let low = 0;
    let high = this.frames.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.frames[middle]!.at <= at) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  private put(frame: Frame): void {
    const place = this.after(frame.at);
    const there = this.frames[place - 1];
    if (there?.at !== frame.at) this.frames.splice(place, 0, frame);
    else if (there.epoch < frame.epoch) this.frames[place - 1] = frame;
  }
}

/** Decodes the frames of a motion message; throws when its byte lengths do not match its number of frames. */
export function unpackPoses(motion: MotionMessage, joints: number, curves: number): Pose[] {
  const { frames } = motion;
  const sizes = [frames * joints * 8, frames * 12, frames * curves];
  const found = [motion.rotations.byteLength, motion.root.byteLength, motion.face.byteLength];
  if (found[0] !== sizes[0] || found[1] !== sizes[1] || (found[2] !== 0 && found[2] !== sizes[2])) {
    throw new RangeError(`motion of ${frames} frames with ${found.join(", ")} bytes; expected ${sizes.join(", ")}`);
  }
  const rotations = viewOf(motion.rotations);
  const root = viewOf(motion.root);
  return Array.from({ length: frames }, (_, k) => {
    const pose = makePose(joints, curves);
    for (let i = 0; i < joints * 4; i++) pose.rotations[i] = rotations.getInt16((k * joints * 4 + i) * 2, true) / 32767;
    normalize(pose.rotations);
    for (let i = 0; i < 3; i++) pose.root[i] = root.getFloat32((k * 3 + i) * 4, true);
    if (found[2]) for (let i = 0; i < curves; i++) pose.face[i] = motion.face[k * curves + i]! / 255;
    return pose;
  });
}

function viewOf(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}

function normalize(rotations: Float32Array): void {
  for (let i = 0; i < rotations.length; i += 4) {
    const length = Math.hypot(rotations[i]!, rotations[i + 1]!, rotations[i + 2]!, rotations[i + 3]!) || 1;
    for (let k = 0; k < 4; k++) rotations[i + k]! /= length;
  }
}

function mix(a: Pose, b: Pose, t: number, out: Pose): void {
  for (let i = 0; i < out.rotations.length; i += 4) slerp(a.rotations, i, b.rotations, i, t, out.rotations, i);
  for (let i = 0; i < 3; i++) out.root[i] = a.root[i]! + (b.root[i]! - a.root[i]!) * t;
  for (let i = 0; i < out.face.length; i++) out.face[i] = a.face[i]! + (b.face[i]! - a.face[i]!) * t;
}
