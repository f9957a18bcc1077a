/** A VRM 0.x or 1.0 avatar, loaded by three-vrm: its normalised bones take our rotations unchanged. */

import { type VRM, type VRMHumanBoneName, VRMUtils } from "@pixiv/three-vrm";
import type { Object3D } from "three";
import type { AvatarDriver } from "../driver.js";
import type { Pose } from "../pose.js";
import type { ReadyMessage } from "../protocol.generated.js";
import { toVrm } from "../expressions.js";
import { ForeignFace } from "../facenames.js";
import { MorphMap } from "./morphs.js";
import { NO_OUTFITS, type Outfits } from "./outfits.js";

const EYE_DEGREES = 34; // rotation of an eye at a look curve of 1 (0.6 rad)

export class VrmDriver implements AvatarDriver {
  private joints: { node: Object3D; joint: number }[] = [];
  private curves: ReadonlyMap<string, number> = new Map();
  private expressions: string[] = [];
  private expressed = new ForeignFace([]);
  private morphs: MorphMap | null = null;
  private shown: Float32Array | null = null; // the face of the last pose
  private readonly sign: 1 | -1; // VRM 0.x faces -Z
  private hipScale = 1;
  /** The bone that carries the root's translation; null before `bind`. */
  hips: Object3D | null = null;

  constructor(readonly vrm: VRM, readonly outfits: Outfits = NO_OUTFITS) {
    this.sign = vrm.meta.metaVersion === "0" ? -1 : 1;
    VRMUtils.rotateVRM0(vrm);
  }

  get object() {
    return this.vrm.scene;
  }

  bind({ rig, face }: Pick<ReadyMessage, "rig" | "face">): void {
    const { humanoid } = this.vrm;
    this.joints = rig.names.flatMap((name, joint) => {
      const node = humanoid.getNormalizedBoneNode(name as VRMHumanBoneName);
      return node ? [{ node, joint }] : [];
    });
    this.hips = humanoid.getNormalizedBoneNode("hips");
    const theirs = humanoid.normalizedRestPose.hips?.position?.[1] ?? 1;
    this.hipScale = theirs / (rig.rest[rig.names.indexOf("hips")]?.[1] || theirs);
    this.bindFace(face);
  }

  apply(pose: Pose): void {
    const { rotations: q, root } = pose;
    const { sign } = this;
    for (const { node, joint } of this.joints) {
      const i = joint * 4;
      node.quaternion.set(q[i]! * sign, q[i + 1]!, q[i + 2]! * sign, q[i + 3]!);
    }
    const scale = this.hipScale;
    this.hips?.position.set(root[0]! * scale * sign, root[1]! * scale, root[2]! * scale * sign);
    this.applyFace(pose.face);
  }

  update(seconds: number): void {
    this.vrm.update(Math.min(seconds, 0.1));
    if (this.shown) this.morphs?.apply(this.shown); // the update has put them at rest
  }

  /** The face curves that nothing shows. */
  get silent(): readonly string[] {
    const looks = this.vrm.lookAt ? "eyeLook" : "-";
    return (this.morphs ?? this.expressed).silent.filter((name) => !name.startsWith(looks));
  }

  dispose(): void {
    this.vrm.scene.removeFromParent();
    VRMUtils.deepDispose(this.vrm.scene);
  }

  /** The face is shown by the avatar's expressions, or by its morph targets where their names show more of it. */
  private bindFace(face: readonly string[]): void {
    const { lookAt, expressionManager } = this.vrm;
    const known = (expressionManager?.expressions ?? []).filter(({ binds }) => binds.length);
    this.curves = new Map(face.map((name, curve) => [name, curve]));
    this.expressions = known.map(({ expressionName }) => expressionName).filter((name) => !lookAt || !/^look/.test(name));
    this.expressed = new ForeignFace(this.expressions);
    const morphs = new MorphMap(this.vrm.scene, face);
    this.morphs = morphs.silent.length < this.expressed.silent.length ? morphs : null;
    if (lookAt) lookAt.autoUpdate = false;
  }

  private applyFace(face: Float32Array): void {
    const get = (name: string) => face[this.curves.get(name) ?? -1] ?? 0;
    this.shown = face;
    this.look(toVrm(get));
    if (this.morphs) return;
    this.expressed.apply(get, (index, weight) => this.vrm.expressionManager?.setValue(this.expressions[index]!, weight));
  }

  /** Moves the eyes by bones or by expressions, whichever the avatar has. */
  private look(weights: readonly number[]): void {
    const [up, down, left, right] = weights.slice(8) as [number, number, number, number];
    const { lookAt } = this.vrm;
    if (!lookAt) return;
    lookAt.yaw = (left - right) * EYE_DEGREES;
    lookAt.pitch = (down - up) * EYE_DEGREES;
  }
}
