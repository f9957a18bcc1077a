import { PerspectiveCamera, Vector3 } from "three";
import { expect, it } from "vitest";
import { follower } from "../src/drivers/stage.js";

it("the camera goes along with who walks, at its own height and distance", () => {
  const camera = new PerspectiveCamera(30);
  camera.position.set(0, 1.2, 4);
  const follow = follower(camera);
  follow(new Vector3(0.5, 0.9, 0), 0);
  expect(camera.position.toArray()).toEqual([0.5, 1.2, 4]);
  const walked = new Vector3(3.5, 0.7, -1);
  follow(walked, 1 / 60);
  expect(camera.position.x).toBeGreaterThan(0.5);
  expect(camera.position.x).toBeLessThan(0.7); // no jump
  for (let frame = 2; frame < 400; frame++) follow(walked, frame / 60);
  expect(camera.position.x).toBeCloseTo(3.5, 2);
  expect(camera.position.y).toBe(1.2);
  expect(camera.position.z).toBeCloseTo(3, 2);
});

it("keeps how the camera was moved by others", () => {
  const camera = new PerspectiveCamera(30);
  const follow = follower(camera);
  follow(new Vector3(), 0);
  camera.position.set(2, 1.6, 1);
  follow(new Vector3(), 1);
  expect(camera.position.toArray()).toEqual([2, 1.6, 1]);
});
