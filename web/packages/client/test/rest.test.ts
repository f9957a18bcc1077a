import { expect, test } from "vitest";
import { makePose } from "../src/pose.js";
import { Posture, RESTING, Rest } from "../src/rest.js";

const { names } = RESTING.rig;
const at = (seconds: number, share = 1) => {
  const pose = makePose(names.length, RESTING.face.length);
  new Rest(RESTING).apply(pose, seconds, share);
  return pose;
};
const joint = (pose: { rotations: Float32Array }, name: string) => [...pose.rotations.subarray(4 * names.indexOf(name), 4 * names.indexOf(name) + 4)];

test("at rest the sides mirror each other and every turn has unit length", () => {
  const pose = at(0);
  for (const name of names.filter((one) => one.startsWith("left"))) {
    const [x, y, z, w] = joint(pose, name) as [number, number, number, number];
    expect(Math.hypot(x, y, z, w)).toBeCloseTo(1, 5);
    const other = joint(pose, `right${name.slice(4)}`);
    [x, -y, -z, w].forEach((value, axis) => expect(other[axis]).toBeCloseTo(value, 5));
  }
  expect(pose.root[1]).toBeGreaterThan(0.9);
});

test("breath goes on, lids close and open, and no share changes nothing", () => {
  const chest = [0, 1, 2, 3].map((seconds) => joint(at(seconds), "chest")[0]!);
  expect(Math.max(...chest) - Math.min(...chest)).toBeGreaterThan(0.005);
  const lids = Array.from({ length: 80 }, (_, k) => at(k / 20).face[0]!);
  expect(Math.max(...lids)).toBeGreaterThan(0.6);
  expect(Math.min(...lids)).toBe(0);
  expect(at(1, 0)).toEqual(makePose(names.length, RESTING.face.length));
});

test("a picture that stands still for long gives way to rest, and motion takes over again", () => {
  const posture = new Posture();
  const moving = { pose: makePose(names.length, RESTING.face.length), state: "speaking" as const, at: 0, held: false };
  moving.pose.root[1] = 2; // metres; nothing at rest is so high
  const height = (step: number, seconds: number) => {
    for (let k = 0; k < 10 * seconds; k++) posture.show({ ...moving, at: (moving.at += step) }, 0.1);
    return posture.pose.root[1]!;
  };
  expect(height(2400, 1)).toBe(2);
  expect(height(0, 1)).toBe(2);
  expect(height(0, 2)).toBeLessThan(1.1);
  expect(height(2400, 1)).toBe(2);
});
