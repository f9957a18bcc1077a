import {
  Bone, BufferGeometry, Float32BufferAttribute, Group, Mesh, Skeleton, SkinnedMesh, Uint16BufferAttribute, Vector3,
} from "three";
import { expect, test } from "vitest";
import { PlainBody } from "../src/drivers/plain.js";

function shape(places: number[], normals: number[]): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(places, 3));
  return geometry.setAttribute("normal", new Float32BufferAttribute(normals, 3));
}

test("a face's targets move its vertices and normals, and give them back", () => {
  const geometry = shape([0, 0, 0, 1, 1, 1], [0, 0, 1, 0, 1, 0]);
  geometry.morphAttributes.position = [[0, 0, 0, 2, 0, 0], [0, 4, 0, 0, 0, 0]].map((by) => new Float32BufferAttribute(by, 3));
  geometry.morphAttributes.normal = [[0, 0, 0, 0, 0, -1], [0, 0, 0, 0, 0, 0]].map((by) => new Float32BufferAttribute(by, 3));
  geometry.morphTargetsRelative = true;
  const mesh = new Mesh(geometry);
  const body = new PlainBody(new Group().add(mesh));
  expect(geometry.morphAttributes).toEqual({});
  mesh.morphTargetInfluences!.splice(0, 2, 0.5, 0.25);
  body.update();
  const { position, normal } = geometry.attributes;
  expect([...position!.array]).toEqual([0, 1, 0, 2, 1, 1]);
  expect([...normal!.array]).toEqual([0, 0, 1, 0, 1, -0.5]);
  mesh.morphTargetInfluences!.fill(0);
  body.update();
  expect([...position!.array]).toEqual([0, 0, 0, 1, 1, 1]);
});

/** Two bones, and three vertices with shares of them and one morph target, under a model that is moved and turned. */
function limb() {
  const geometry = shape([0.2, 0, 0, 0.1, 1, 0, 0, 1.8, 0.3], [1, 0, 0, 0, 1, 0, 0, 0, 1]);
  geometry.setAttribute("skinIndex", new Uint16BufferAttribute([0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0], 4));
  geometry.setAttribute("skinWeight", new Float32BufferAttribute([1, 0, 0, 0, 0.4, 0.6, 0, 0, 1, 0, 0, 0], 4));
  geometry.morphAttributes.position = [new Float32BufferAttribute([0, 0, 0, 0, 0, 0, 0.5, 0, 0], 3)];
  geometry.morphTargetsRelative = true;
  const [lower, upper] = [new Bone(), new Bone()];
  upper.position.y = 1;
  const mesh = new SkinnedMesh(geometry);
  const model = new Group().add(mesh, lower.add(upper));
  model.updateMatrixWorld();
  mesh.bind(new Skeleton([lower, upper]));
  const pose = () => {
    model.position.set(0.3, 0, -0.2);
    model.rotation.y = 0.7;
    upper.rotation.z = 1.1;
    lower.position.x = 0.25;
    model.updateMatrixWorld();
  };
  return { model, mesh, pose };
}

test("a skin's vertices are where three's own skinning puts them, in the world", () => {
  const [expected, moved] = [limb(), limb()];
  expected.mesh.morphTargetInfluences![0] = 0.5;
  const influences = moved.mesh.morphTargetInfluences!;
  const body = new PlainBody(moved.model);
  expect(moved.mesh.parent).toBe(null);
  const drawn = moved.model.children.find((node) => (node as Mesh).isMesh) as Mesh;
  expect(drawn.morphTargetInfluences).toBe(influences);
  influences[0] = 0.5;
  for (const { pose } of [expected, moved]) pose();
  body.update();
  for (let vertex = 0; vertex < 3; vertex++) {
    const wanted = expected.mesh.getVertexPosition(vertex, new Vector3()).applyMatrix4(expected.mesh.matrixWorld);
    const seen = drawn.getVertexPosition(vertex, new Vector3()).applyMatrix4(drawn.matrixWorld);
    expect(seen.distanceTo(wanted)).toBeLessThan(1e-6);
  }
  const normal = new Vector3().fromBufferAttribute(drawn.geometry.attributes["normal"]!, 0);
  expect(normal.distanceTo(new Vector3(Math.cos(0.7), 0, -Math.sin(0.7)))).toBeLessThan(1e-6);
});
