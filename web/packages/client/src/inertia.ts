/**
 * Blends across jumps: where the stream jumps (a late chunk, a new segment), the difference between the pose on screen
 * and the new motion becomes an offset that fades out smoothly. Continuous motion is unchanged.
 */

import { type Pose, copyPose, makePose } from "./pose.js";
import { difference, turn } from "./quaternion.js";

export class Inertia {
  private readonly shown: Pose;
  private readonly turns: Float32Array;
  private readonly shift = new Float32Array(3);
  private readonly face: Float32Array;
  private elapsed = Infinity;
  private started = false;

  /** `seconds`: duration of the fade. */
  constructor(joints: number, curves: number, private readonly seconds = 0.2) {
    this.shown = makePose(joints, curves);
    this.turns = new Float32Array(joints * 3);
    this.face = new Float32Array(curves);
  }

  /** Turns `pose` in place into the pose to show; `jump` means that it does not continue the previous one. */
  apply(pose: Pose, seconds: number, jump: boolean): void {
    if (!this.started) jump = false;
    if (jump) this.capture(pose);
    this.elapsed += seconds; // a display slower than the fade sees every jump fully faded
    const left = fade(this.elapsed / this.seconds);
    if (left > 0) this.offset(pose, left);
    copyPose(pose, this.shown);
    this.started = true;
  }

  private capture(pose: Pose): void {
    const { rotations, root, face } = this.shown;
    for (let i = 0; i * 4 < rotations.length; i++) {
      difference(rotations, i * 4, pose.rotations, i * 4, this.turns, i * 3);
    }
    for (let i = 0; i < 3; i++) this.shift[i] = root[i]! - pose.root[i]!;
    for (let i = 0; i < face.length; i++) this.face[i] = face[i]! - pose.face[i]!;
    this.elapsed = 0;
  }

  private offset(pose: Pose, left: number): void {
    for (let i = 0; i * 4 < pose.rotations.length; i++) turn(pose.rotations, i * 4, this.turns, i * 3, left);
    for (let i = 0; i < 3; i++) pose.root[i]! += this.shift[i]! * left;
    for (let i = 0; i < this.face.length; i++) pose.face[i]! += this.face[i]! * left;
  }
}

/** 1 at 0, 0 at 1, flat at both ends. */
function fade(t: number): number {
  if (t >= 1) return 0;
  return 1 - t * t * t * (10 + t * (6 * t - 15));
}
