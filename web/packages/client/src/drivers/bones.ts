/** Applies parent-relative rotations of our rig to any humanoid with a T-pose facing +Z. */

import { type Object3D, Quaternion, Vector3 } from "three";
import type { Rig } from "../protocol.generated.js";

interface Bone {
  readonly node: Object3D;
  readonly joint: number;
  readonly rest: Quaternion; // local rotation in the T-pose
  readonly parent: Quaternion; // the parent's model-space rotation in the T-pose
  readonly inverse: Quaternion;
}

export interface Hips {
  readonly node: Object3D;
  readonly scale: number; // model height / rig height: strides scale with body size
  readonly inverse: Quaternion;
  readonly place: Vector3; // in the T-pose
}

/**
 * Both skeletons have the same T-pose, so a rotation of our rig is taken as a rotation in model space and converted to
 * the bone's local space: local = parent^-1 q parent rest. If all rest rotations are the identity, this is q itself.
 */
export class BoneMap {
  private readonly bones: Bone[] = [];
  /** The body's position. */
  hips: Hips | null = null;
  private readonly turn = new Quaternion();

  /** `find` returns the node of a VRM humanoid bone; bones that the model lacks are skipped. */
  constructor(model: Object3D, rig: Rig, find: (name: string) => Object3D | null | undefined) {
    model.updateWorldMatrix(true, true);
    const frame = model.getWorldQuaternion(new Quaternion()).invert();
    rig.names.forEach((name, joint) => {
      const node = find(name);
      if (!node) return;
      const world = node.parent?.getWorldQuaternion(new Quaternion()) ?? new Quaternion();
      const parent = frame.clone().multiply(world);
      const inverse = parent.clone().invert();
      this.bones.push({ node, joint, rest: node.quaternion.clone(), parent, inverse });
      if (name === "hips") this.hips = { node, scale: hipScale(model, node, rig.rest[joint]?.[1] ?? 1), inverse, place: node.position.clone() };
    });
  }

  /** Number of the rig's joints that the model has. */
  get size(): number {
    return this.bones.length;
  }

  /** Brings the model back to its T-pose. */
  reset(): void {
    for (const { node, rest } of this.bones) node.quaternion.copy(rest);
    if (this.hips) this.hips.node.position.copy(this.hips.place);
  }

  apply(rotations: Float32Array, root: Float32Array): void {
    for (const { node, joint, rest, parent, inverse } of this.bones) {
      this.turn.fromArray(rotations, joint * 4);
      node.quaternion.copy(inverse).multiply(this.turn).multiply(parent).multiply(rest);
    }
    this.hips?.node.position.fromArray(root).multiplyScalar(this.hips.scale).applyQuaternion(this.hips.inverse);
  }
}

/** Factor from our root position to the node's position, in the units of its parent. */
function hipScale(model: Object3D, node: Object3D, height: number): number {
  const theirs = model.worldToLocal(node.getWorldPosition(new Vector3())).y;
  const unit = node.parent
    ? node.parent.getWorldScale(new Vector3()).y / model.getWorldScale(new Vector3()).y
    : 1;
  return theirs / height / unit;
}
