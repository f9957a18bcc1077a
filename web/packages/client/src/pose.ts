/** One pose of an avatar: filled by the timeline, applied by drivers. */

export interface Pose {
  /** Parent-relative rotations of the rig's joints, xyzw, four numbers per joint. */
  readonly rotations: Float32Array;
  /** The hips' position in metres: Y up, the avatar facing +Z. */
  readonly root: Float32Array;
  /** Face curves, 0 to 1, in the order of `ready.face`. */
  readonly face: Float32Array;
}

/** The rest pose: no rotation, hips at the origin, all face curves zero. */
export function makePose(joints: number, curves: number): Pose {
  const rotations = new Float32Array(joints * 4);
  for (let i = 3; i < rotations.length; i += 4) rotations[i] = 1;
  return { rotations, root: new Float32Array(3), face: new Float32Array(curves) };
}

export function copyPose(from: Pose, to: Pose): void {
  to.rotations.set(from.rotations);
  to.root.set(from.root);
  to.face.set(from.face);
}
