import { expect, it } from "vitest";
import { makePose } from "../src/pose.js";
import type { MotionMessage } from "../src/protocol.generated.js";
import { MotionTimeline } from "../src/timeline.js";

const HOP = 800;

/** One joint rotating about Y by `degrees` per frame from `first`; root x and the face also encode the frame. */
function motion(at: number, frames: number, first: number, degrees = 3, state: MotionMessage["state"] = "idle"): MotionMessage {
  const rotations = new Int16Array(frames * 4);
  const root = new Float32Array(frames * 3);
  const face = new Uint8Array(frames);
  for (let k = 0; k < frames; k++) {
    const half = (((first + k) * degrees) / 2) * (Math.PI / 180);
    rotations.set([0, Math.round(Math.sin(half) * 32767), 0, Math.round(Math.cos(half) * 32767)], k * 4);
    root[k * 3] = first + k;
    face[k] = first + k;
  }
  const raw = (array: ArrayBufferView) => new Uint8Array(array.buffer);
  return { type: "motion", at, epoch: 0, frames, rotations: raw(rotations), root: raw(root), face, state };
}

const make = () => new MotionTimeline(1, 1, HOP, 24000);
const angle = (pose: { rotations: Float32Array }) => (2 * Math.atan2(pose.rotations[1]!, pose.rotations[3]!) * 180) / Math.PI;

it("interpolates between frames, and across messages", () => {
  const timeline = make();
  timeline.insert(motion(0, 8, 0));
  timeline.insert(motion(6400, 8, 8));
  const pose = makePose(1, 1);
  for (const frame of [0, 0.25, 3.5, 7, 7.3, 7.99, 8, 12.5]) {
    const found = timeline.sample(frame * HOP, pose)!;
    expect(found).toMatchObject({ at: frame * HOP, held: false });
    expect(angle(pose)).toBeCloseTo(frame * 3, 1);
    expect(pose.root[0]).toBeCloseTo(frame, 4);
    expect(pose.face[0]).toBeCloseTo(frame / 255, 5);
  }
});

it("takes messages in any order, and twice", () => {
  const timeline = make();
  timeline.insert(motion(6400, 8, 8));
  timeline.insert(motion(0, 8, 0));
  timeline.insert(motion(0, 8, 100));
  const pose = makePose(1, 1);
  timeline.sample(7.5 * HOP, pose);
  expect(angle(pose)).toBeCloseTo(22.5, 1);
  expect(timeline.end).toBe(12800);
});

it("holds the last frame where nothing follows, and says so", () => {
  const timeline = make();
  const pose = makePose(1, 1);
  expect(timeline.sample(0, pose)).toBeNull();
  timeline.insert(motion(0, 8, 0));
  expect(timeline.sample(9000, pose)).toEqual({ at: 5600, held: true, state: "idle" });
  expect(angle(pose)).toBeCloseTo(21, 1);
});

it("bridges a lost message when both its ends are there", () => {
  const timeline = make();
  timeline.insert(motion(0, 8, 0));
  timeline.insert(motion(12800, 8, 16));
  const pose = makePose(1, 1);
  expect(timeline.sample(11 * HOP, pose)).toMatchObject({ held: false });
  expect(angle(pose)).toBeCloseTo(33, 1);
});

it("forgets what is flushed, also in the middle of a frame", () => {
  const timeline = make();
  timeline.insert(motion(0, 8, 0));
  timeline.flush(3 * HOP + 1);
  expect(timeline.end).toBe(4 * HOP);
  timeline.insert(motion(3 * HOP + 400, 8, 50));
  const pose = makePose(1, 1);
  timeline.sample(3 * HOP + 400, pose);
  expect(pose.root[0]).toBe(50);
});

it("keeps one second behind the playhead, and always the newest frame", () => {
  const timeline = make();
  for (let k = 0; k < 10; k++) timeline.insert(motion(k * 6400, 8, k * 8));
  timeline.prune(48000);
  const pose = makePose(1, 1);
  timeline.sample(24000, pose);
  expect(pose.root[0]).toBeCloseTo(30, 3);
  timeline.prune(1e9);
  expect(timeline.sample(1e9, pose)).toMatchObject({ held: true });
});

it("refuses bytes that do not fit the number of frames", () => {
  expect(() => make().insert({ ...motion(0, 8, 0), frames: 7 })).toThrow(RangeError);
});

it("prefers what came after an interruption", () => {
  const timeline = make();
  timeline.insert(motion(0, 8, 0));
  timeline.insert({ ...motion(0, 8, 100), epoch: 1 });
  const pose = makePose(1, 1);
  timeline.sample(0, pose);
  expect(pose.root[0]).toBe(100);
});
