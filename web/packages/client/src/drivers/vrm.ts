/** A VRM 0.x or 1.0 avatar, loaded by three-vrm: its normalised bones take our rotations unchanged. */

import { type VRM, type VRMHumanBoneName, VRMUtils } from "@pixiv/three-vrm";
import type { Object3D } from "three";
import type { AvatarDriver } from "../driver.js";
import type { Pose } from "../pose.js";
import type { ReadyMessage } from "../protocol.generated.js";
import { VRM_EXPRESSIONS, toVrm } from "../expressions.js";
import { MorphMap, plain } from "./morphs.js";

const PERFECT_SYNC = 30; // an avatar with this many ARKit expressions or morphs needs no vowel expressions
const EYE_DEGREES = 34; // rotation of an eye at a look curve of 1 (0.6 rad)

export class VrmDriver implements AvatarDriver {
  private joints: { node: Object3D; joint: number }[] = [];
  private face: string[] = [];
  private expressions: { name: string; curve: number }[] = [];
  private morphs: MorphMap | null = null;
  private readonly sign: 1 | -1; // VRM 0.x faces -Z
  private hipScale = 1;
  /** The bone that carries the root's translation; null before `bind`. */
  hips: Object3D | null = null;

  constructor(readonly vrm: VRM) {
    this.sign = vrm.meta.metaVersion === "0" ? -1 : 1;
    VRMUtils.rotateVRM0(vrm);
  }

  get object() {
    return this.vrm.scene;
  }

  bind({ rig, face }: Pick<ReadyMessage, "rig" | "face">): void {
    const { humanoid } = this.vrm;
    this.face = face;
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
  }

  dispose(): void {
    this.vrm.scene.removeFromParent();
    VRMUtils.deepDispose(this.vrm.scene);
  }

  private bindFace(face: readonly string[]): void {
    const curves = new Map(face.map((name, curve) => [plain(name), curve]));
    const known = this.vrm.expressionManager?.expressions ?? [];
    this.expressions = known.flatMap(({ expressionName: name }) => {
      const curve = curves.get(plain(name));
      return curve === undefined ? [] : [{ name, curve }];
    });
    const morphs = new MorphMap(this.vrm.scene, face);
    this.morphs = this.expressions.length < PERFECT_SYNC && morphs.found.size >= PERFECT_SYNC ? morphs : null;
    if (this.vrm.lookAt) this.vrm.lookAt.autoUpdate = false;
  }

  private applyFace(face: Float32Array): void {
    const get = (name: string) => face[this.face.indexOf(name)] ?? 0;
    const manager = this.vrm.expressionManager;
    const weights = toVrm(get);
    this.look(weights);
    if (this.morphs) this.morphs.apply(face);
    else if (this.expressions.length >= PERFECT_SYNC) {
      for (const { name, curve } of this.expressions) manager?.setValue(name, face[curve] ?? 0);
    } else {
      VRM_EXPRESSIONS.slice(0, 8).forEach((name, i) => manager?.setValue(name, weights[i]!));
    }
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
