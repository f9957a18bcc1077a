/** The avatar in the viewport: the built-in character, or a dropped one. */

import type { AvatarDriver, protocol } from "@echoavatar/client";
import { loadAvatar } from "@echoavatar/client/three";
import { Box3, type Mesh, type Object3D, Vector3 } from "three";
import type { Viewport } from "./viewport.js";

const ENDS = [/(left.?hand|_l_hand|hand_l)$/i, /(right.?hand|_r_hand|hand_r)$/i, /(^|[^a-z])head$/i]; // stay in the picture

type Driver = AvatarDriver & { readonly object: Object3D; readonly hips: Object3D | null };

export class AvatarSlot {
  driver: Driver | null = null;
  /** Whether it is the built-in character, which motion can be exported into; and its file. */
  isOurs = false;
  file = new ArrayBuffer(0);
  private ready: protocol.ReadyMessage | null = null;
  private readonly here = new Vector3();
  private placed = false;
  private ends: readonly Object3D[] = [];
  private readonly places = ENDS.map(() => new Vector3());

  constructor(private readonly viewport: Viewport) {}

  /** Replaces the avatar; the old one stays if the new one cannot be read. */
  async load(data: ArrayBuffer, isOurs = false): Promise<void> {
    const next: Driver = await loadAvatar(data);
    if (this.ready) next.bind(this.ready);
    next.object.traverse((node) => {
      const mesh = node as Mesh;
      if (!mesh.isMesh) return;
      Object.assign(mesh, { castShadow: true, receiveShadow: !this.viewport.low, frustumCulled: false });
      for (const material of [mesh.material].flat()) {
        if (material.alphaTest > 0) material.alphaToCoverage = !this.viewport.low; // soft edges of hair
      }
    });
    const size = new Box3().setFromObject(next.object);
    this.driver?.dispose();
    this.driver = next;
    [this.isOurs, this.file] = [isOurs, data];
    this.placed = false;
    this.ends = ENDS.flatMap((name) => {
      let found: Object3D | null = null;
      next.object.traverse((node) => (found ??= name.test(node.name) ? node : null));
      return found ?? [];
    });
    this.viewport.scene.add(next.object);
    this.viewport.setHeight(size.max.y);
  }

  bind(ready: protocol.ReadyMessage): void {
    this.ready = ready;
    this.driver?.bind(ready);
  }

  /** Keeps the camera on the avatar, its hands in the picture. */
  follow(seconds: number): void {
    if (!this.driver?.hips) return;
    this.driver.hips.getWorldPosition(this.here);
    this.viewport.follow(this.here.x, this.here.z, this.placed ? 1 - Math.exp(-1.5 * seconds) : 1);
    this.placed = true;
    this.viewport.attend(this.ends.map((node, k) => node.getWorldPosition(this.places[k]!)), seconds);
  }
}
