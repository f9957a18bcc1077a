/** A person at rest: what an avatar shows while it has no motion, as before a server answers or while all its places are taken. */

import type { Picture } from "./player.js";
import { type Pose, copyPose, makePose } from "./pose.js";
import type { ReadyMessage } from "./protocol.generated.js";
import { slerp, turn } from "./quaternion.js";

type Turn = readonly [x: number, y: number, z: number]; // rotation vector, rad

/** The left side and the middle; the right side is its mirror image. */
const TURNS: Readonly<Record<string, Turn>> = {
  neck: [0.03, 0, 0], head: [0.03, 0, 0],
  leftShoulder: [0, 0.06, 0.01], leftUpperArm: [0.5, -0.22, -1.22], leftLowerArm: [-0.2, -0.75, -0.15], leftHand: [-0.25, 0.04, -0.1],
  leftThumbMetacarpal: [0.22, 0.04, -0.07], leftThumbProximal: [0.06, 0.15, -0.06], leftThumbDistal: [0.09, 0.21, -0.08],
  leftIndexProximal: [0, 0, -0.3], leftIndexIntermediate: [0, 0, -0.36], leftIndexDistal: [0, 0, -0.24],
  leftMiddleProximal: [0, 0, -0.34], leftMiddleIntermediate: [0, 0, -0.4], leftMiddleDistal: [0, 0, -0.27],
  leftRingProximal: [0, 0, -0.4], leftRingIntermediate: [0, 0, -0.47], leftRingDistal: [0, 0, -0.32],
  leftLittleProximal: [0, 0, -0.43], leftLittleIntermediate: [0, 0, -0.5], leftLittleDistal: [0, 0, -0.34],
  leftUpperLeg: [-0.06, -0.08, 0], leftLowerLeg: [0.26, 0, 0], leftFoot: [-0.2, 0.1, 0],
};
const BREATH: Readonly<Record<string, Turn>> = { chest: [-0.011, 0, 0], upperChest: [-0.009, 0, 0], neck: [0.014, 0, 0], leftShoulder: [0, 0, 0.012] };
const BREATH_S = 4.2;
const SWAY: Readonly<Record<string, Turn>> = { spine: [0, 0.012, 0.008], head: [0.008, 0.03, 0] };
const SWAY_S = 11;
const BLINK_S = { every: 3.7, long: 0.16 };
const REST_S = 0.8; // from rest into motion
const HELD_S = 1.5; // a picture that stands still for so long, as after a broken line, gives way to rest
const LOWERED = 0.986; // of the hips' height: the knees give

/** The least rig that can rest, for a driver that is bound before a session says its own. */
export const RESTING: Pick<ReadyMessage, "rig" | "face"> = (() => {
  const sides = Object.keys(TURNS).flatMap((name) => (name.startsWith("left") ? [name, mirrored(name)] : [name]));
  const names = ["hips", "spine", "chest", "upperChest", ...sides];
  return {
    rig: { names, parents: names.map((_, joint) => Math.min(0, joint - 1)), rest: names.map((_, joint) => [0, joint ? 0 : 1, 0]) },
    face: ["eyeBlinkLeft", "eyeBlinkRight"],
  };
})();

export class Rest {
  private readonly names: readonly string[];
  private readonly rotations: Float32Array;
  private readonly turn = new Float32Array(3);
  private readonly height: number;
  private readonly lids: readonly number[];

  /** For the rig and the face of a session. */
  constructor({ rig, face }: Pick<ReadyMessage, "rig" | "face">) {
    this.names = rig.names;
    this.rotations = new Float32Array(4 * rig.names.length);
    this.height = (rig.rest[rig.names.indexOf("hips")]?.[1] ?? 1) * LOWERED;
    this.lids = ["eyeBlinkLeft", "eyeBlinkRight"].map((name) => face.indexOf(name)).filter((curve) => curve >= 0);
  }

  /** Brings a pose to rest by a share, 0 to 1; `seconds` is any clock, for breath and blinks. */
  apply(pose: Pose, seconds: number, share: number): void {
    const breath = Math.sin((2 * Math.PI * seconds) / BREATH_S);
    const sway = Math.sin((2 * Math.PI * seconds) / SWAY_S);
    this.names.forEach((name, joint) => {
      const at = 4 * joint;
      this.rotations.set([0, 0, 0, 1], at);
      for (const [table, scale] of [[TURNS, 1], [BREATH, breath], [SWAY, sway]] as const) this.add(table, name, at, scale);
      slerp(pose.rotations, at, this.rotations, at, share, pose.rotations, at);
    });
    const height = this.height + 0.0015 * breath;
    pose.root[1]! += (height - pose.root[1]!) * share;
    const open = Math.abs(((seconds % BLINK_S.every) - BLINK_S.long) / BLINK_S.long);
    for (let curve = 0; curve < pose.face.length; curve++) {
      const rest = this.lids.includes(curve) ? Math.max(0, 1 - open) : 0;
      pose.face[curve]! += (rest - pose.face[curve]!) * share;
    }
  }

  private add(table: Readonly<Record<string, Turn>>, name: string, at: number, scale: number): void {
    const own = table[name];
    const other = own ?? table[mirrored(name)];
    if (!other) return;
    const side = own ? 1 : -1;
    this.turn.set([other[0], side * other[1], side * other[2]]);
    turn(this.rotations, at, this.turn, 0, scale);
  }
}

/** What an avatar shows: the motion of a session, and a person at rest while there is none. They pass into each other. */
export class Posture {
  pose: Pose = makePose(RESTING.rig.names.length, RESTING.face.length);
  private rest = new Rest(RESTING);
  private share = 1; // of rest
  private at = NaN; // sample of the last picture
  private held = 0; // seconds for which it has been the same

  /** For the rig and the face of a session. */
  bind(ready: Pick<ReadyMessage, "rig" | "face">): void {
    this.rest = new Rest(ready);
    const { rotations, face } = this.pose;
    const isSame = rotations.length === 4 * ready.rig.names.length && face.length === ready.face.length;
    if (!isSame) [this.pose, this.share] = [makePose(ready.rig.names.length, ready.face.length), 1];
  }

  /** The pose of a picture, or of rest while there is none or no motion comes; `seconds` since the previous one. */
  show(picture: Picture | null, seconds: number): Pose {
    this.held = picture?.at === this.at ? this.held + seconds : 0;
    this.at = picture?.at ?? NaN;
    const moves = picture !== null && this.held < HELD_S;
    this.share = Math.min(1, Math.max(0, this.share + (moves ? -seconds : seconds) / REST_S));
    if (moves) copyPose(picture.pose, this.pose);
    if (this.share > 0) this.rest.apply(this.pose, performance.now() / 1000, smooth(this.share));
    return this.pose;
  }
}

function smooth(share: number): number {
  return share * share * (3 - 2 * share);
}

function mirrored(name: string): string {
  return name.startsWith("left") ? `right${name.slice(4)}` : name.startsWith("right") ? `left${name.slice(5)}` : name;
}
