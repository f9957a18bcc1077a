/**
 * One renderer and one character for many views: each view is a part of one transparent canvas, drawn when it changes.
 *
 * Browsers allow few WebGL canvases, so eight candidates share one. All views also share one camera, so that every
 * candidate is seen from the same angle.
 */

import type { AvatarDriver, Pose } from "@echoavatar/client";
import { loadAvatar } from "@echoavatar/client/three";
import {
  Box3,
  Color,
  DirectionalLight,
  GridHelper,
  Group,
  HemisphereLight,
  type Material,
  Mesh,
  NeutralToneMapping,
  type Object3D,
  PCFShadowMap,
  PMREMGenerator,
  PerspectiveCamera,
  PlaneGeometry,
  Scene as World,
  ShadowMaterial,
  Vector3,
  WebGLRenderer,
} from "three";
import { RoomEnvironment } from "three/examples/jsm/environments/RoomEnvironment.js";
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
  private readonly around = new Group(); // light and floor shadow, which move with the body
  private readonly lens = new PerspectiveCamera(28, 1, 0.05, 60);
  private size = "";
  private driver: (AvatarDriver & { object: Object3D }) | null = null;

  private constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly renderer: WebGLRenderer,
    readonly low: boolean,
  ) {
    renderer.toneMapping = NeutralToneMapping;
    renderer.shadowMap.enabled = !low; // frame rate matters more than shadows
    renderer.shadowMap.type = PCFShadowMap;
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
    this.around.position.set(x, 0, z);
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
    this.driver = driver;
  }

  private furnish(): void {
    const floor = new Mesh(new PlaneGeometry(12, 12), new ShadowMaterial({ opacity: 0.26 }));
    floor.rotation.x = -Math.PI / 2;
    floor.receiveShadow = true;
    const lines = new GridHelper(20, 20, 0x5b7280, 0x7b909c); // one metre per cell, to judge travel and sliding feet
    Object.assign(lines.material as Material, { transparent: true, opacity: 0.28, depthWrite: false });
    const key = new DirectionalLight(0xfff1e0, 2.6);
    key.position.set(1.5, 4.2, 2.6);
    key.target.position.set(0, 0.7, 0);
    key.castShadow = true;
    key.shadow.mapSize.setScalar(this.low ? 512 : 1024);
    Object.assign(key.shadow.camera, { left: -1.6, right: 1.6, top: 1.7, bottom: -1.7, near: 0.5, far: 9 });
    Object.assign(key.shadow, { bias: -0.0004, normalBias: 0.012, radius: this.low ? 2 : 6 });
    const rim = new DirectionalLight(0xcfe4ff, 1.7);
    rim.position.set(-2.2, 2.6, -2.4);
    this.around.add(floor, key, key.target, rim, rim.target);
    this.world.add(this.around, lines, new HemisphereLight(0xf4f8ff, 0xb9aa98, this.low ? 1.7 : 0.55));
    if (this.low) return;
    const generator = new PMREMGenerator(this.renderer);
    this.world.environment = generator.fromScene(new RoomEnvironment(), 0.04).texture;
    this.world.environmentIntensity = 0.5;
    generator.dispose();
  }
}

/** Whether WebGL runs on the processor, which is slow. */
function isSoftware(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  const told = context?.getExtension("WEBGL_debug_renderer_info");
  const name = String(context?.getParameter(told?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER) ?? "");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}
