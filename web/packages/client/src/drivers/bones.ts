/** Applies parent-relative rotations of our rig to any humanoid that stands in a T-pose facing +Z. */

import { type Object3D, Quaternion, Vector3 } from "three";
import type { Rig } from "../protocol.generated.js";

interface Bone {
  readonly node: Object3D;
  readonly joint: number;
  readonly rest: Quaternion; // local, in the T-pose
  readonly parent: Quaternion; // the parent's rotation in the model's space, in the T-pose
  readonly inverse: Quaternion;
}

export interface Hips {
  readonly node: Object3D;
  readonly scale: number; // their height by ours: bodies of other sizes take other strides
  readonly inverse: Quaternion;
}

/**
 * In the T-pose both skeletons stand alike, so a rotation of ours, told in the model's space, is carried into the
 * bone's own: local = parent^-1 q parent rest. Where all rest rotations are the identity this is q itself.
 */
export class BoneMap {
  private readonly bones: Bone[] = [];
  /** Where the body is. */
  hips: Hips | null = null;
  private readonly turn = new Quaternion();

  /** `find` gives the node of a VRM humanoid bone name; bones that the model lacks are left out. */
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
      if (name === "hips") this.hips = { node, scale: hipScale(model, node, rig.rest[joint]?.[1] ?? 1), inverse };
    });
  }

  /** How many joints of the rig the model has. */
  get size(): number {
    return this.bones.length;
  }

  apply(rotations: Float32Array, root: Float32Array): void {
    for (const { node, joint, rest, parent, inverse } of this.bones) {
      this.turn.fromArray(rotations, joint * 4);
      node.quaternion.copy(inverse).multiply(this.turn).multiply(parent).multiply(rest);
    }
    this.hips?.node.position.fromArray(root).multiplyScalar(this.hips.scale).applyQuaternion(this.hips.inverse);
  }
}

/** What our root position is multiplied by to become the node's, in the units of its parent. */
function hipScale(model: Object3D, node: Object3D, height: number): number {
  const theirs = model.worldToLocal(node.getWorldPosition(new Vector3())).y;
  const unit = node.parent
    ? node.parent.getWorldScale(new Vector3()).y / model.getWorldScale(new Vector3()).y
    : 1;
  return theirs / height / unit;
}
