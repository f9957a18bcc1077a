/** The least that shows an avatar: a canvas, a camera, light. Your own scene does not need it. */

import { AmbientLight, DirectionalLight, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import type { GlbDriver } from "./glb.js";
import { loadAvatar } from "./load.js";
import type { VrmDriver } from "./vrm.js";

const FOLLOWED_PER_S = 1.5; // the share of the way to the avatar that the camera goes in a short time, over that time

export interface Stage {
  readonly avatar: GlbDriver | VrmDriver;
  readonly scene: Scene;
  readonly camera: PerspectiveCamera;
  /** Draws one picture. The camera goes along with the avatar, which walks while it dances. */
  draw(): void;
}

/** Puts a canvas of the element's size into it and the avatar of a .vrm or .glb on it, seen from the front. */
export async function openStage(element: HTMLElement, avatarUrl: string): Promise<Stage> {
  const answer = await fetch(avatarUrl);
  if (!answer.ok) throw new Error(`${avatarUrl} answered ${answer.status}`);
  const avatar = await loadAvatar(await answer.arrayBuffer());
  const [scene, camera] = [new Scene(), new PerspectiveCamera(30)];
  const sun = new DirectionalLight(0xffffff, 2);
  sun.position.set(1, 3, 2);
  scene.add(avatar.object, sun, new AmbientLight(0xffffff, 1));
  camera.position.set(0, 1.2, 4);
  camera.lookAt(0, 0.95, 0);
  const renderer = new WebGLRenderer({ antialias: true, alpha: true });
  element.append(renderer.domElement);
  const [follow, hips] = [follower(camera), new Vector3()];
  const draw = (): void => {
    if (avatar.hips) follow(avatar.hips.getWorldPosition(hips), performance.now() / 1000);
    const [width, height] = [element.clientWidth || 640, element.clientHeight || 480];
    if (renderer.domElement.clientWidth !== width || renderer.domElement.clientHeight !== height) {
      renderer.setSize(width, height);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
    }
    renderer.render(scene, camera);
  };
  return { avatar, scene, camera, draw };
}

/** Moves a camera along the floor with a place; who moves the camera besides is not undone. */
export function follower(camera: PerspectiveCamera): (place: Vector3, now: number) => void {
  const [centre, step] = [new Vector3(), new Vector3()];
  let before: number | null = null;
  return (place, now) => {
    const share = before === null ? 1 : 1 - Math.exp(-FOLLOWED_PER_S * (now - before));
    before = now;
    step.subVectors(place, centre).setY(0).multiplyScalar(share);
    centre.add(step);
    camera.position.add(step);
  };
}
