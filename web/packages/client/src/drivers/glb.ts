/** A glTF character: bones with VRM or Mixamo names, morph targets with names of a face. */

import { type Mesh, type Object3D, Quaternion } from "three";
import type { AvatarDriver } from "../driver.js";
import type { Pose } from "../pose.js";
import type { ReadyMessage } from "../protocol.generated.js";
import { BoneMap } from "./bones.js";
import { mixamoName } from "./mixamo.js";
import { MorphMap } from "./morphs.js";
import { NO_OUTFITS, type Outfits } from "./outfits.js";

const STILL = new Quaternion();

/** Our characters have a bone `NAMEHalfway` beside each shoulder and elbow, which turns by half of what `NAME` does. */
export class GlbDriver implements AvatarDriver {
  private bones: BoneMap | null = null;
  private morphs: MorphMap | null = null;
  private halfway: { node: Object3D; bone: Object3D }[] = [];

  constructor(readonly object: Object3D, readonly outfits: Outfits = NO_OUTFITS) {}

  /** The bone that carries the root's translation; null before `bind`. */
  get hips(): Object3D | null {
    return this.bones?.hips?.node ?? null;
  }

  /** The face curves that nothing shows. */
  get silent(): readonly string[] {
    return this.morphs?.silent ?? [];
  }

  bind({ rig, face }: Pick<ReadyMessage, "rig" | "face">): void {
    this.bones?.reset();
    const nodes = new Map<string, Object3D>();
    this.object.traverse((node) => nodes.set(node.name.replace(/^mixamorig\d*:?/, ""), node));
    this.bones = new BoneMap(this.object, rig, (name) => nodes.get(name) ?? nodes.get(mixamoName(name)));
    if (!this.bones.size) throw new Error("This model has no bones named as in VRM or Mixamo.");
    this.halfway = [...nodes].flatMap(([name, node]) => {
      const bone = name.endsWith("Halfway") && nodes.get(name.slice(0, -"Halfway".length));
      return bone ? [{ node, bone }] : [];
    });
    this.morphs = new MorphMap(this.object, face);
  }

  apply(pose: Pose): void {
    this.bones?.apply(pose.rotations, pose.root);
    for (const { node, bone } of this.halfway) node.quaternion.slerpQuaternions(STILL, bone.quaternion, 0.5);
    this.morphs?.apply(pose.face);
  }

  update(): void {}

  dispose(): void {
    this.object.traverse((node) => {
      const mesh = node as Partial<Mesh>;
      mesh.geometry?.dispose();
      for (const material of [mesh.material ?? []].flat()) material.dispose();
    });
    this.object.removeFromParent();
  }
}
