/** A take: the frames that were played, each once, at the session's frame rate. */

import type { Pose } from "../pose.js";
import type { ReadyMessage, Rig } from "../protocol.generated.js";

export class Take {
  readonly rig: Rig;
  readonly face: readonly string[];
  readonly rate: number;
  readonly frames: Pose[] = [];

  constructor(ready: Pick<ReadyMessage, "rig" | "face" | "frame_rate">) {
    this.rig = ready.rig;
    this.face = ready.face;
    this.rate = ready.frame_rate;
  }

  add(pose: Pose): void {
    this.frames.push(pose);
  }

  get seconds(): number {
    return this.frames.length / this.rate;
  }

  /** Rotations of one joint, xyzw, with signs chosen so that neighbouring frames are close. */
  joint(index: number): Float32Array {
    const track = new Float32Array(this.frames.length * 4);
    this.frames.forEach(({ rotations }, t) => {
      const q = rotations.subarray(index * 4, index * 4 + 4);
      const dot = t ? q.reduce((sum, x, k) => sum + x * track[(t - 1) * 4 + k]!, 0) : 1;
      for (let k = 0; k < 4; k++) track[t * 4 + k] = dot < 0 ? -q[k]! : q[k]!;
    });
    return track;
  }

  root(): Float32Array {
    return Float32Array.from(this.frames.flatMap((frame) => [...frame.root]));
  }

  times(): Float32Array {
    return Float32Array.from(this.frames, (_, t) => t / this.rate);
  }
}
