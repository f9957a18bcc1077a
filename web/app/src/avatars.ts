/** The avatar in the viewport: the built-in character, or a dropped one. */

import { type AvatarDriver, type Picture, Posture, RESTING, type protocol } from "@echoavatar/client";
import { type Outfits, type PlainBody, dress, loadAvatar, surfaceOf } from "@echoavatar/client/three";
import { Box3, type BufferGeometry, type Material, type Mesh, type Object3D, Vector3 } from "three";
import type { Viewport } from "./viewport.js";

const ENDS = [/(left.?hand|_l_hand|hand_l)$/i, /(right.?hand|_r_hand|hand_r)$/i, /(^|[^a-z])head$/i]; // stay in the picture

type Driver = AvatarDriver & { readonly object: Object3D; readonly hips: Object3D | null; readonly silent: readonly string[]; readonly outfits: Outfits };

export class AvatarSlot {
  driver: Driver | null = null;
  /** Where the built-in character is shown: its address, without the level of detail. */
  ours: string | null = null;
  /** The outfit that is worn, of `driver.outfits`; -1: none of them. */
  outfit = -1;
  private wardrobe: { readonly mesh: Mesh; readonly materials: readonly (Material | Material[])[] }[] = []; // by outfit, the file's own last
  private shown = ""; // what was asked for last
  private ready: Pick<protocol.ReadyMessage, "rig" | "face"> = RESTING; // what the driver is bound to
  private readonly posture = new Posture();
  private readonly here = new Vector3();
  private placed = false;
  private body: PlainBody | null = null;
  private ends: readonly Object3D[] = [];
  private readonly places = ENDS.map(() => new Vector3());

  constructor(private readonly viewport: Viewport) {}

  /** Replaces the avatar; the old one stays if the new one cannot be read. */
  async load(data: ArrayBuffer, files: ReadonlyMap<string, Blob>): Promise<void> {
    this.shown = "";
    this.put(await loadAvatar(data, { files, basis: async (manager) => (await import("./basis.js")).openBasis(manager) }));
    this.ours = null;
  }

  /** Shows the built-in character of this address at a level of detail, unless something else is wished meanwhile. */
  async show(address: string, level: number): Promise<void> {
    const wished = (this.shown = `${address}${address.includes("?") ? "&" : "?"}level=${level}`);
    const answer = await fetch(wished);
    if (!answer.ok) throw new Error(`the server answered ${answer.status}`);
    const next = await loadAvatar(await answer.arrayBuffer());
    if (wished !== this.shown) return next.dispose();
    this.put(next, this.ours === address);
    this.ours = address;
  }

  /** The character as a file that every program reads, for motion to be exported into. */
  async file(): Promise<ArrayBuffer> {
    const answer = await fetch(this.ours ?? "");
    if (!answer.ok) throw new Error(`the server answered ${answer.status}`);
    return answer.arrayBuffer();
  }

  private put(next: Driver, isSame = false): void {
    next.bind(this.ready);
    const { low, light } = this.viewport;
    const isVrm = "vrm" in next;
    this.body = dress(next.object, light, low, isVrm);
    this.hang(next, surfaceOf(light, low && !isVrm));
    this.wear(isSame ? this.outfit : next.outfits.first);
    const size = new Box3().setFromObject(next.object);
    this.driver?.dispose();
    this.driver = next;
    this.placed &&= isSame;
    this.ends = ENDS.flatMap((name) => {
      let found: Object3D | null = null;
      next.object.traverse((node) => (found ??= name.test(node.name) ? node : null));
      return found ?? [];
    });
    this.viewport.scene.add(next.object);
    this.viewport.light.stand(next.object);
    if (!isSame) this.viewport.setHeight(size.max.y);
  }

  /** Finds what each mesh wears in each outfit; `PlainBody` has replaced meshes, but not their geometry. */
  private hang({ object, outfits }: Driver, surface: (material: Material) => Material): void {
    for (const { materials } of this.wardrobe) for (const material of materials.flat()) material.dispose();
    const meshes = new Map<BufferGeometry, Mesh>();
    object.traverse((node) => (node as Mesh).isMesh && meshes.set((node as Mesh).geometry, node as Mesh));
    this.wardrobe = [...outfits.worn].flatMap(([node, materials]) => {
      const mesh = meshes.get((node as Mesh).geometry);
      return mesh ? { mesh, materials: [...materials.map(surface), mesh.material] } : [];
    });
  }

  /** Puts an outfit on. */
  wear(outfit: number): void {
    this.outfit = outfit;
    for (const { mesh, materials } of this.wardrobe) mesh.material = materials.at(outfit) ?? mesh.material;
  }

  /** The middle of the head, if the avatar has one. */
  get head(): Vector3 | null {
    const head = this.ends.find((node) => ENDS[2]!.test(node.name));
    return head?.getWorldPosition(new Vector3()) ?? null;
  }

  bind(ready: protocol.ReadyMessage): void {
    this.ready = ready;
    this.posture.bind(ready);
    this.driver?.bind(ready);
  }

  /** Shows a picture, or a person at rest while there is none; `seconds` since the previous one. */
  present(picture: Picture | null, seconds: number): void {
    this.driver?.apply(this.posture.show(picture, seconds));
    this.driver?.update(seconds);
    this.body?.update();
  }

  /** Keeps the camera on the avatar, its hands in the picture. */
  follow(seconds: number): void {
    if (!this.driver?.hips) return;
    this.driver.hips.getWorldPosition(this.here);
    this.viewport.follow(this.here.x, this.here.z, this.placed ? 1 - Math.exp(-1.5 * seconds) : 1, seconds);
    this.placed = true;
    this.viewport.attend(this.ends.map((node, k) => node.getWorldPosition(this.places[k]!)), seconds);
  }
}
