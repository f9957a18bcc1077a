/** A clip in memory: its interpolated pose at any second, and the camera's target. */

import { MotionTimeline, type Pose, decodeMessage, makePose, unpackPoses } from "@echoavatar/client";
import type { Scene } from "../api.generated.js";

const CLOCK = 24_000; // samples per second of the protocol's clock
const SMOOTHING = 1; // seconds on each side over which the camera's target is averaged

export class Clip {
  readonly seconds: number;
  private readonly timeline: MotionTimeline;
  private readonly path: Float32Array; // x and z of the camera's target, per frame

  /** Throws if the bytes are not motion of this rig. */
  constructor(
    bytes: ArrayBuffer,
    private readonly scene: Scene,
  ) {
    const motion = decodeMessage(bytes);
    if (motion?.type !== "motion") throw new RangeError("this is no motion");
    const { rig, face, frame_rate: rate } = scene;
    this.timeline = new MotionTimeline(rig.names.length, face.length, CLOCK / rate, CLOCK);
    this.timeline.insert({ ...motion, at: 0 });
    this.seconds = motion.frames / rate;
    this.path = movingAverage(
      unpackPoses({ ...motion, face: new Uint8Array() }, rig.names.length, face.length),
      Math.round(SMOOTHING * rate),
    );
  }

  /** An empty pose of the right size, to pass to `pose`. */
  blank(): Pose {
    return makePose(this.scene.rig.names.length, this.scene.face.length);
  }

  /** Fills `out` with the pose at a second; the first and last frames are held outside the clip. */
  pose(second: number, out: Pose): void {
    this.timeline.sample(Math.max(0, second) * CLOCK, out);
  }

  /** Smoothed position of the body: x and z in metres. */
  centre(second: number): [number, number] {
    const last = this.path.length / 2 - 1;
    const at = Math.min(Math.max(second * this.scene.frame_rate, 0), last);
    const [k, part] = [Math.floor(at), at % 1];
    const next = Math.min(k + 1, last);
    const mix = (axis: number) => this.path[2 * k + axis]! * (1 - part) + this.path[2 * next + axis]! * part;
    return [mix(0), mix(1)];
  }
}

/** The root's x and z, each averaged over `reach` frames on both sides. */
export function movingAverage(poses: readonly Pick<Pose, "root">[], reach: number): Float32Array {
  const out = new Float32Array(poses.length * 2);
  for (const [axis, from] of [
    [0, 0],
    [1, 2],
  ] as const) {
    const sums = [0];
    for (const { root } of poses) sums.push(sums.at(-1)! + root[from]!);
    for (let k = 0; k < poses.length; k++) {
      const [low, high] = [Math.max(0, k - reach), Math.min(poses.length, k + reach + 1)];
      out[2 * k + axis] = (sums[high]! - sums[low]!) / (high - low);
    }
  }
  return out;
}
