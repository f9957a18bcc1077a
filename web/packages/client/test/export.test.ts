import { readFileSync } from "node:fs";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { expect, it } from "vitest";
import { angles, toBvh } from "../src/export/bvh.js";
import { Gltf, toGlb } from "../src/export/glb.js";
import { Take } from "../src/export/take.js";
import { toVrma } from "../src/export/vrma.js";
import { toVrm } from "../src/expressions.js";
import { makePose } from "../src/pose.js";

const rig = { names: ["hips", "spine", "head"], parents: [-1, 0, 1], rest: [[0, 1, 0], [0, 0.2, 0], [0, 0.3, 0]] };
const face = ["jawOpen", "eyeBlinkLeft"];

function take(): Take {
  const made = new Take({ rig, face, frame_rate: 30 });
  for (let t = 0; t < 4; t++) {
    const pose = makePose(3, 2);
    pose.root.set([0.1 * t, 1, 0]);
    pose.rotations.set([0, Math.sin(0.1 * t), 0, Math.cos(0.1 * t)], 4);
    if (t === 2) pose.rotations.set([0, -Math.sin(0.2), 0, -Math.cos(0.2)], 4); // the same rotation with the opposite sign
    pose.face[0] = t / 4;
    made.add(pose);
  }
  return made;
}

it("writes BVH with one row a frame, turns that go on", () => {
  const lines = toBvh(take()).trim().split("\n");
  expect(lines[0]).toBe("HIERARCHY");
  expect(lines).toContain("Frames: 4");
  const rows = lines.slice(-4).map((line) => line.split(" ").map(Number));
  expect(rows[0]).toHaveLength(3 + 9);
  expect(rows.map((row) => row[0])).toEqual([0, 10, 20, 30]);
  rows.forEach((row, t) => expect(row[7]).toBeCloseTo((0.2 * t * 180) / Math.PI, 2));
});

it("turns quaternions into Z, Y, X", () => {
  const [z, y, x] = [0.3, -0.5, 0.9];
  const half = (angle: number) => [Math.sin(angle / 2), Math.cos(angle / 2)] as const;
  const [[sx, cx], [sy, cy], [sz, cz]] = [half(x), half(y), half(z)];
  const q = new Float32Array([
    sx * cy * cz - cx * sy * sz, cx * sy * cz + sx * cy * sz, cx * cy * sz - sx * sy * cz, cx * cy * cz + sx * sy * sz,
  ]);
  angles(q)[0]!.forEach((angle, k) => expect((angle * Math.PI) / 180).toBeCloseTo([z, y, x][k]!, 5));
});

it("puts a take into a character's GLB so that three.js plays it", async () => {
  const character = new Gltf({
    asset: { version: "2.0" },
    nodes: [{ name: "hips", children: [1] }, { name: "spine", children: [2] }, { name: "head" }],
    scenes: [{ nodes: [0] }],
  });
  const bytes = toGlb(take(), character.pack().buffer);
  const gltf = await new GLTFLoader().parseAsync(bytes.buffer, "");
  const [clip] = gltf.animations;
  expect(clip!.duration).toBeCloseTo(0.1, 5);
  expect(clip!.tracks.map((track) => track.name).sort()).toEqual([
    "head.quaternion", "hips.position", "hips.quaternion", "spine.quaternion",
  ]);
});

it("writes VRMA: all bones, expressions as translations, only the hips travel", () => {
  const { json } = Gltf.parse(toVrma(take()).buffer);
  const { humanoid, expressions, specVersion } = json.extensions.VRMC_vrm_animation;
  expect(specVersion).toBe("1.0");
  expect(Object.keys(humanoid.humanBones)).toEqual(rig.names);
  expect(Object.keys(expressions.custom)).toEqual(face);
  expect(Object.keys(expressions.preset)).toContain("aa");
  const moved = json.animations[0].channels.filter((c: { target: { path: string } }) => c.target.path === "translation");
  expect(moved.filter((c: { target: { node: number } }) => c.target.node < 3).map((c: { target: { node: number } }) => c.target.node)).toEqual([0]);
  expect(json.scenes[0].nodes).toEqual([0, ...Array.from({ length: json.nodes.length - 3 }, (_, i) => i + 3)]);
});

it("maps ARKit to VRM expressions as Python does", () => {
  const told = JSON.parse(readFileSync(new URL("../../../../tests/web/expressions.json", import.meta.url), "utf8"));
  told.curves.forEach((curves: number[], t: number) => {
    const weights = toVrm((name) => curves[told.names.indexOf(name)]!);
    weights.forEach((weight, k) => expect(weight).toBeCloseTo(told.vrm[t][k], 4));
  });
});
