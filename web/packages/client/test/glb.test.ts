import { Bone, Quaternion, Vector3 } from "three";
import { expect, it } from "vitest";
import { GlbDriver } from "../src/drivers/glb.js";
import { makePose } from "../src/pose.js";

it("a halfway bone turns by half of what its bone does", () => {
  const [hips, arm, halfway] = ["hips", "leftUpperArm", "leftUpperArmHalfway"].map((name) => {
    const bone = new Bone();
    bone.name = name;
    return bone;
  }) as [Bone, Bone, Bone];
  hips.add(arm, halfway);
  const driver = new GlbDriver(hips);
  const rig = { names: ["hips", "leftUpperArm"], parents: [-1, 0], rest: [[0, 1, 0], [0.2, 1.4, 0]] };
  driver.bind({ rig, face: [] } as unknown as Parameters<GlbDriver["bind"]>[0]);
  const pose = makePose(2, 0);
  const up = new Vector3(0, 0, 1);
  new Quaternion().setFromAxisAngle(up, -1.2).toArray(pose.rotations, 4);
  driver.apply(pose);
  expect(halfway.quaternion.angleTo(new Quaternion().setFromAxisAngle(up, -0.6))).toBeLessThan(1e-6);
});
