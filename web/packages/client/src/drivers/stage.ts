/** An avatar in an element of a page: a canvas, a camera that follows, the film's light. Your own scene does not need it. */

import { Box3, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import type { ReadyMessage } from "../protocol.generated.js";
import { RESTING } from "../rest.js";
import type { GlbDriver } from "./glb.js";
import { StageLight, type StageName } from "./light.js";
import { loadAvatar } from "./load.js";
import { type PlainBody, dress } from "./plain.js";
import { ResolutionControl } from "./resolution.js";
import { isSoftware } from "./software.js";
import type { VrmDriver } from "./vrm.js";

/** Heights are fractions of the avatar's height; at its distance a view fills the part of the window that is free. */
export const VIEWS = [
  { id: "full", label: "Whole body", height: 0.5, distance: 3.95, side: 0.16 },
  { id: "bust", label: "Upper body", height: 0.76, distance: 2.05, side: 0.2 },
  { id: "face", label: "Face", height: 0.9, distance: 1.1, side: 0.12 },
] as const;
export type ViewName = (typeof VIEWS)[number]["id"];

const FOLLOWED_PER_S = 1.5; // the share of the way to the avatar that the camera goes in a short time, over that time
const OUR_HEIGHT = 1.65; // metres, for which the distances of views are

export interface StageOptions {
  readonly view?: ViewName;
  readonly light?: StageName;
}

/** A canvas that fills an element, transparent around the avatar. */
export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(28, 1, 0.05, 60);
  /** Whether WebGL runs on the processor, where surfaces are plain. */
  readonly low = isSoftware();
  /** The avatar on the stage; null before `wear`. */
  avatar: GlbDriver | VrmDriver | null = null;
  private readonly renderer = new WebGLRenderer({ antialias: true, alpha: true });
  private readonly lights: StageLight;
  private readonly resolution = new ResolutionControl(this.low);
  private readonly follow = follower(this.camera);
  private readonly hips = new Vector3();
  private readonly centre = new Vector3();
  private body: PlainBody | null = null;
  private bound: Pick<ReadyMessage, "rig" | "face"> = RESTING;
  private shown: ViewName;
  private tall = OUR_HEIGHT;
  private size = { width: 0, height: 0 };
  private last = performance.now();
  private wished = "";

  constructor(private readonly element: HTMLElement, { view = "full", light = "studio" }: StageOptions = {}) {
    this.shown = view;
    this.lights = new StageLight(this.scene, this.renderer, this.low);
    this.lights.set(light);
    element.append(this.renderer.domElement);
    this.renderer.domElement.style.display = "block";
  }

  get view(): ViewName {
    return this.shown;
  }

  set view(view: ViewName) {
    this.shown = view;
    this.aim();
  }

  set light(light: StageName) {
    this.lights.set(light);
  }

  /** Whether no cheaper avatar can be shown. */
  isCheapest = true;

  /** Puts the avatar of a .vrm or .glb on the stage; the old one stays until then, and if the file cannot be read. */
  async wear(avatarUrl: string): Promise<void> {
    this.wished = avatarUrl;
    const answer = await fetch(avatarUrl);
    if (!answer.ok) throw new Error(`${avatarUrl} answered ${answer.status}${await reasonOf(answer)}`);
    const next = await loadAvatar(await answer.arrayBuffer());
    if (this.wished !== avatarUrl) return next.dispose();
    next.bind(this.bound);
    this.body = dress(next.object, this.lights, this.low, "vrm" in next);
    this.tall = Math.min(4, Math.max(0.3, new Box3().setFromObject(next.object).max.y));
    this.avatar?.dispose();
    this.avatar = next;
    this.scene.add(next.object);
    this.lights.stand(next.object);
    this.aim();
  }

  /** Tells the avatar, and those that follow it, the rig and the face of a session. */
  bind(ready: Pick<ReadyMessage, "rig" | "face">): void {
    this.bound = ready;
    this.avatar?.bind(ready);
  }

  /** Draws one picture. The camera goes along with the avatar, which walks while it dances. */
  readonly draw = (): void => {
    const now = performance.now();
    const seconds = (now - this.last) / 1000;
    this.last = now;
    this.body?.update();
    if (this.avatar?.hips) this.centre.copy(this.follow(this.avatar.hips.getWorldPosition(this.hips), now / 1000));
    this.lights.follow(this.centre.x, this.centre.z);
    this.lights.update();
    this.fit(this.resolution.picture(seconds, this.isCheapest));
    this.renderer.render(this.scene, this.camera);
  };

  /** Removes the canvas and frees what it took of the graphics card. */
  close(): void {
    this.wished = "";
    this.avatar?.dispose();
    this.avatar = null;
    this.renderer.domElement.remove();
    this.renderer.dispose();
    this.renderer.forceContextLoss(); // a page may have sixteen contexts
  }

  private fit(isOther: boolean): void {
    const [width, height] = [this.element.clientWidth || 640, this.element.clientHeight || 480];
    const isResized = width !== this.size.width || height !== this.size.height;
    if (!isOther && !isResized) return;
    this.size = { width, height };
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * this.resolution.scale);
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (isResized) this.aim();
  }

  private aim(): void {
    const { height, distance: wide, side } = VIEWS.find(({ id }) => id === this.shown) ?? VIEWS[0];
    const narrow = Math.min(1, this.camera.aspect / 0.72);
    const distance = (wide * (this.tall / OUR_HEIGHT)) / narrow ** 0.75;
    const { x, z } = this.centre;
    this.camera.position.set(x + side * distance, height * this.tall + 0.07 * distance, z + Math.sqrt(1 - side * side) * distance);
    this.camera.lookAt(x, height * this.tall, z);
  }
}

/** Puts a canvas of the element's size into it and the avatar of a .vrm or .glb on it, seen from the front. */
export async function openStage(element: HTMLElement, avatarUrl: string, options: StageOptions = {}): Promise<Stage & { avatar: GlbDriver | VrmDriver }> {
  const stage = new Stage(element, options);
  await stage.wear(avatarUrl);
  return stage as Stage & { avatar: GlbDriver | VrmDriver };
}

/** What a server says in plain words beside a status, as ours does. */
async function reasonOf(answer: Response): Promise<string> {
  const isPlain = answer.headers.get("content-type")?.startsWith("text/plain");
  return isPlain ? `: ${(await answer.text()).trim().slice(0, 200)}` : "";
}

/** Moves a camera along the floor with a place, and returns what it is over; who moves the camera besides is not undone. */
export function follower(camera: PerspectiveCamera): (place: Vector3, now: number) => Vector3 {
  const [centre, step] = [new Vector3(), new Vector3()];
  let before: number | null = null;
  return (place, now) => {
    const share = before === null ? 1 : 1 - Math.exp(-FOLLOWED_PER_S * (now - before));
    before = now;
    step.subVectors(place, centre).setY(0).multiplyScalar(share);
    camera.position.add(step);
    return centre.add(step);
  };
}
