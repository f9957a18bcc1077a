/**
 * One renderer and one character for many views: each view is a part of one transparent canvas, drawn when it changes.
 *
 * Browsers allow few WebGL canvases, so eight candidates share one. All views also share one camera, so that every
 * candidate is seen from the same angle.
 */

import type { AvatarDriver, Pose } from "@echoavatar/client";
import { StageLight, isSoftware, loadAvatar } from "@echoavatar/client/three";
import {
  Box3,
  Color,
  GridHelper,
  type Material,
  type Mesh,
  type Object3D,
  PerspectiveCamera,
  Scene as World,
  Vector3,
  WebGLRenderer,
} from "three";
import type { Scene } from "../api.generated.js";
import { SharedCamera } from "./camera.js";

/** The element, pose and camera target of one view. */
export interface Shown {
  readonly element: HTMLElement;
  readonly pose: Pose;
  /** x and z of the camera's target. */
  readonly centre: readonly [number, number];
}

export class Views {
  readonly camera: SharedCamera;
  private readonly world = new World();
  private readonly light: StageLight;
  private readonly lens = new PerspectiveCamera(28, 1, 0.05, 60);
  private size = "";
  private driver: (AvatarDriver & { object: Object3D }) | null = null;

  private constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly renderer: WebGLRenderer,
    readonly low: boolean,
  ) {
    this.light = new StageLight(this.world, renderer, low);
    renderer.setClearColor(new Color(0), 0);
    this.camera = new SharedCamera();
    this.furnish();
  }

  /**
   * `quality` is low or high; otherwise it depends on the machine. Throws if the browser has no WebGL or the character
   * cannot be read.
   */
  static async open(scene: Scene, character: ArrayBuffer, quality: string | null): Promise<Views> {
    const canvas = document.createElement("canvas");
    canvas.className = "views";
    canvas.setAttribute("aria-hidden", "true");
    const isWeak = quality === "low" || (quality !== "high" && isSoftware());
    const renderer = new WebGLRenderer({ canvas, alpha: true, antialias: !isWeak, preserveDrawingBuffer: true });
    const views = new Views(canvas, renderer, isWeak);
    await views.wear(scene, character);
    return views;
  }

  /** Fits the canvas to its host element; all views must be drawn again. */
  resize(): void {
    const host = this.canvas.parentElement;
    if (!host) return;
    const [width, height] = [host.clientWidth, host.clientHeight];
    const size = `${width} ${height} ${window.devicePixelRatio}`;
    if (size === this.size) return;
    this.size = size;
    this.renderer.setPixelRatio(this.low ? 0.75 : Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
  }

  /** Draws one view; `seconds` since it was last drawn. */
  draw({ element, pose, centre: [x, z] }: Shown, seconds: number): void {
    const area = this.area(element);
    if (!area || !this.driver) return;
    this.driver.apply(pose);
    this.driver.update(seconds);
    this.light.follow(x, z);
    this.light.update();
    this.camera.aim(this.lens, area.width / area.height, x, z);
    this.renderer.setScissorTest(true);
    this.renderer.setViewport(area.left, area.bottom, area.width, area.height);
    this.renderer.setScissor(area.left, area.bottom, area.width, area.height);
    this.renderer.render(this.world, this.lens);
  }

  /** Clears the whole canvas to transparent. */
  clear(): void {
    this.renderer.setScissorTest(false);
    this.renderer.clear();
  }

  /** A view's rectangle on the canvas, from the lower left corner; null if it is not visible. */
  private area(element: HTMLElement): { left: number; bottom: number; width: number; height: number } | null {
    const [here, all] = [element.getBoundingClientRect(), this.canvas.getBoundingClientRect()];
    if (here.width < 2 || here.height < 2) return null;
    return { left: here.left - all.left, bottom: all.bottom - here.bottom, width: here.width, height: here.height };
  }

  private async wear(scene: Scene, character: ArrayBuffer): Promise<void> {
    const driver = await loadAvatar(character);
    driver.bind(scene);
    driver.object.traverse((node) => {
      if ((node as Mesh).isMesh)
        Object.assign(node, { castShadow: true, receiveShadow: !this.low, frustumCulled: false });
    });
    const size = new Box3().setFromObject(driver.object).getSize(new Vector3());
    this.camera.setHeight(size.y);
    this.world.add(driver.object);
    this.light.stand(driver.object);
    this.driver = driver;
  }

  private furnish(): void {
    const lines = new GridHelper(20, 20, 0x5b7280, 0x7b909c); // one metre per cell, to judge travel and sliding feet
    Object.assign(lines.material as Material, { transparent: true, opacity: 0.28, depthWrite: false });
    this.world.add(lines);
  }
}
