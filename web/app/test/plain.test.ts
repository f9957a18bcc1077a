import { BufferGeometry, Float32BufferAttribute, Group, Mesh } from "three";
import { expect, test } from "vitest";
import { FaceMorphs } from "../src/plain.js";

test("a face's targets move its vertices and normals, and give them back", () => {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute([0, 0, 0, 1, 1, 1], 3));
  geometry.setAttribute("normal", new Float32BufferAttribute([0, 0, 1, 0, 1, 0], 3));
  geometry.morphAttributes.position = [[0, 0, 0, 2, 0, 0], [0, 4, 0, 0, 0, 0]].map((by) => new Float32BufferAttribute(by, 3));
  geometry.morphAttributes.normal = [[0, 0, 0, 0, 0, -1], [0, 0, 0, 0, 0, 0]].map((by) => new Float32BufferAttribute(by, 3));
  geometry.morphTargetsRelative = true;
  const mesh = new Mesh(geometry);
  const face = new FaceMorphs(new Group().add(mesh));
  expect(geometry.morphAttributes).toEqual({});
  mesh.morphTargetInfluences!.splice(0, 2, 0.5, 0.25);
  face.update();
  const { position, normal } = geometry.attributes;
  expect([...position!.array]).toEqual([0, 1, 0, 2, 1, 1]);
  expect([...normal!.array]).toEqual([0, 0, 1, 0, 1, -0.5]);
  mesh.morphTargetInfluences!.fill(0);
  face.update();
  expect([...position!.array]).toEqual([0, 0, 0, 1, 1, 1]);
});
