import { encode } from "@msgpack/msgpack";
import { PerspectiveCamera, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import type { Scene } from "../src/api.generated.js";
import { SharedCamera } from "../src/playback/camera.js";
import { Clip, movingAverage } from "../src/playback/clip.js";
import { Rounds } from "../src/playback/rounds.js";

const scene: Scene = {
  rig: { names: ["hips"], parents: [-1], rest: [[0, 1, 0]] },
  face: ["jawOpen"],
  frame_rate: 30,
  avatar: "/a",
};

/** A body that moves along x at 3 m/s; 31 frames. */
function walking(): ArrayBuffer {
  const frames = 31;
  const rotations = new Int16Array(frames * 4).map((_, i) => (i % 4 === 3 ? 32767 : 0));
  const root = new Float32Array(frames * 3).map((_, i) => (i % 3 === 0 ? i / 30 : 1));
  const motion = {
    type: "motion",
    epoch: 0,
    at: 77,
    state: "acting",
    frames,
    rotations: bytes(rotations),
    root: bytes(root),
    face: new Uint8Array(frames).fill(51),
  };
  return encode(motion).slice().buffer;
}

const bytes = (array: Int16Array | Float32Array) => new Uint8Array(array.buffer);

describe("a clip", () => {
  it("is interpolated between frames and held at its ends", () => {
    const clip = new Clip(walking(), scene);
    const pose = clip.blank();
    const at = (second: number) => {
      clip.pose(second, pose);
      return pose.root[0];
    };
    expect(clip.seconds).toBeCloseTo(31 / 30);
    expect(at(0)).toBeCloseTo(0);
    expect(at(0.5)).toBeCloseTo(1.5);
    expect(at(0.5 + 1 / 60)).toBeCloseTo(1.55);
    expect(at(99)).toBeCloseTo(3);
    expect(at(-1)).toBeCloseTo(0);
    expect(pose.face[0]).toBeCloseTo(0.2);
  });

  it("is followed by a smooth camera", () => {
    const clip = new Clip(walking(), scene);
    expect(clip.centre(0.5)[0]).toBeCloseTo(1.5);
    expect(clip.centre(0)[0]).toBeCloseTo(1.5); // the mean of the first second
    expect(clip.centre(99)).toHaveLength(2);
  });

  it("is refused where it is no motion of the rig", () => {
    expect(() => new Clip(encode({ type: "pong" }).slice().buffer, scene)).toThrow(RangeError);
    expect(() => new Clip(new Uint8Array([193]).buffer, scene)).toThrow();
    expect(() => new Clip(walking(), { ...scene, rig: { ...scene.rig, names: ["hips", "spine"] } })).toThrow(
      RangeError,
    );
  });

  it("is averaged over so many frames to each side", () => {
    const poses = [0, 3, 6, 9].map((x) => ({ root: Float32Array.of(x, 0, -x) }));
    expect([...movingAverage(poses, 1)]).toEqual([1.5, -1.5, 3, -3, 6, -6, 7.5, -7.5]);
  });
});

describe("rounds", () => {
  const begin = (slots: number[], isLooped: boolean) => {
    const counts = { plays: [0, 0, 0], watched: [0, 0, 0] };
    return { counts, rounds: new Rounds(slots, 4, isLooped, counts) };
  };

  it("count a beginning at once and an end when it is heard", () => {
    const { counts, rounds } = begin([1], false);
    expect(counts.plays).toEqual([0, 1, 0]);
    expect(rounds.at(3.9)).toEqual({ second: 3.9, isOver: false, hasChanged: false });
    expect(counts.watched).toEqual([0, 0, 0]);
    expect(rounds.at(4.2)).toEqual({ second: 4, isOver: true, hasChanged: true });
    expect(counts).toEqual({ plays: [0, 1, 0], watched: [0, 1, 0] });
  });

  it("count every round of a loop, also those between two pictures", () => {
    const { counts, rounds } = begin([0, 2], true);
    expect(rounds.at(4.5)).toEqual({ second: 0.5, isOver: false, hasChanged: true });
    rounds.at(12.5);
    expect(counts).toEqual({ plays: [4, 0, 4], watched: [3, 0, 3] });
  });

  it("do not count a round twice after a pause", () => {
    const { counts, rounds } = begin([0], true);
    rounds.at(5);
    rounds.rewind(); // paused at second 1, goes on there
    rounds.at(1.2);
    rounds.at(4.1);
    expect(counts).toEqual({ plays: [3, 0, 0], watched: [2, 0, 0] });
  });
});

describe("the camera", () => {
  /** Vertical position of a point of the body in a view: -1 at the lower edge, 1 at the upper edge. */
  const height = (camera: SharedCamera, y: number) => {
    const lens = new PerspectiveCamera(28);
    camera.aim(lens, 0.8, 0, 0);
    lens.updateMatrixWorld();
    return new Vector3(0, y, 0).project(lens).y;
  };

  it.each([1.2, 1.65, 2])("shows the whole body of %s m, and its face from close by", (tall) => {
    const camera = new SharedCamera();
    camera.setHeight(tall);
    expect(height(camera, 0)).toBeGreaterThan(-1);
    expect(height(camera, tall)).toBeLessThan(1);
    for (let k = 0; k < 11; k++) camera.step(0, 1);
    expect(Math.abs(height(camera, 0.92 * tall))).toBeLessThan(0.25);
    expect(height(camera, 0.5 * tall)).toBeLessThan(-1);
    for (let k = 0; k < 11; k++) camera.step(0, -1);
    expect(height(camera, 0)).toBeGreaterThan(-1);
  });
});
