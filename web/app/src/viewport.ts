/** Light, floor, camera and renderer. Low quality is faster: no antialiasing, no environment. */

import {
  DirectionalLight, HemisphereLight, Mesh, NeutralToneMapping, PCFShadowMap, PMREMGenerator, PerspectiveCamera,
  PlaneGeometry, Scene, ShadowMaterial, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { RoomEnvironment } from "three/examples/jsm/environments/RoomEnvironment.js";
import { Backdrop, Echoes } from "./backdrop.js";
import { ResolutionControl } from "./resolution.js";

/** Heights are fractions of the avatar's height. */
const VIEWS = [
  { height: 0.5, distance: 4.7, side: 0.16 },
  { height: 0.76, distance: 2.3, side: 0.2 },
  { height: 0.9, distance: 1.25, side: 0.12 },
];

export class Viewport {
  readonly renderer: WebGLRenderer;
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(28, 1, 0.05, 60);
  readonly echoes = new Echoes();
  private readonly backdrop = new Backdrop();
  private readonly resolution = new ResolutionControl();
  private readonly controls: OrbitControls;
  private readonly key = new DirectionalLight(0xfff1e0, 2.6);
  private readonly floor = new Mesh(new PlaneGeometry(30, 30), new ShadowMaterial({ opacity: 0.3 }));
  private readonly centre = new Vector3();
  private view = 0;
  private tall = 1.65;

  constructor(readonly canvas: HTMLCanvasElement, readonly low: boolean) {
    this.renderer = new WebGLRenderer({ canvas, antialias: !low, powerPreference: "high-performance" });
    this.renderer.toneMapping = NeutralToneMapping;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { enableDamping: true, minDistance: 0.5, maxDistance: 9, maxPolarAngle: 1.62, enablePan: false });
    this.light();
    this.floor.rotation.x = -Math.PI / 2;
    this.floor.receiveShadow = true;
    this.scene.add(this.backdrop.mesh, this.floor, this.echoes.mesh);
    canvas.addEventListener("dblclick", () => this.frame());
    window.addEventListener("resize", () => this.resize());
    this.resize();
    this.frame();
  }

  setTheme(dark: boolean): void {
    this.backdrop.setTheme(dark);
    this.echoes.setTheme(dark);
    this.floor.material.opacity = dark ? 0.5 : 0.26;
    this.scene.environmentIntensity = dark ? 0.36 : 0.5;
    this.key.intensity = dark ? 2.3 : 2.6;
  }

  /** Returns to the chosen view; `index` chooses another. */
  frame(index = this.view): void {
    this.view = index % VIEWS.length;
    const { height, distance: wide, side } = VIEWS[this.view]!;
    const narrow = Math.min(1, this.camera.aspect / 0.72);
    const distance = (wide * (this.tall / 1.65)) / narrow ** 0.75;
    this.controls.target.set(this.centre.x, height * this.tall, this.centre.z);
    const forward = Math.sqrt(1 - side * side);
    this.camera.position.set(
      this.centre.x + side * distance, height * this.tall + 0.07 * distance, this.centre.z + forward * distance,
    );
    this.controls.update();
  }

  nextView(): void {
    this.frame(this.view + 1);
  }

  /** Scales the views to the avatar's height in metres. */
  setHeight(metres: number): void {
    this.tall = Math.min(4, Math.max(0.3, metres));
    this.frame();
  }

  /** Moves camera and light with the avatar; `ease` 1 jumps. */
  follow(x: number, z: number, ease: number): void {
    const [dx, dz] = [(x - this.centre.x) * ease, (z - this.centre.z) * ease];
    this.centre.x += dx;
    this.centre.z += dz;
    for (const vector of [this.controls.target, this.camera.position]) {
      vector.x += dx;
      vector.z += dz;
    }
    this.key.position.set(1.5 + this.centre.x, 4.2, 2.6 + this.centre.z);
    this.key.target.position.set(this.centre.x, 0.7, this.centre.z);
  }

  /** Draws a frame; `seconds` since the previous one. */
  render(seconds: number): void {
    if (this.resolution.picture(seconds)) this.resize();
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
  }

  resize(): void {
    const [width, height] = [window.innerWidth, window.innerHeight];
    this.renderer.setPixelRatio((this.low ? 1 : Math.min(window.devicePixelRatio, 2)) * this.resolution.scale);
    this.renderer.setSize(width, height, false);
    this.backdrop.resize(width, height);
    this.camera.aspect = width / height;
    this.camera.setViewOffset(width, height, 0, height * (width < 900 ? 0.1 : 0.045), width, height);
    this.camera.updateProjectionMatrix();
  }

  private light(): void {
    const { key, low } = this;
    key.position.set(1.5, 4.2, 2.6);
    key.castShadow = true;
    key.shadow.mapSize.setScalar(low ? 512 : 2048);
    Object.assign(key.shadow.camera, { left: -1.6, right: 1.6, top: 1.7, bottom: -1.7, near: 0.5, far: 9 });
    Object.assign(key.shadow, { bias: -0.0004, normalBias: 0.012, radius: low ? 2 : 9 });
    const rim = new DirectionalLight(0xcfe4ff, 1.7);
    rim.position.set(-2.2, 2.6, -2.4);
    this.scene.add(key, key.target, rim, new HemisphereLight(0xf4f8ff, 0xb9aa98, low ? 1.7 : 0.55));
    if (low) return;
    const generator = new PMREMGenerator(this.renderer);
    this.scene.environment = generator.fromScene(new RoomEnvironment(), 0.04).texture;
    this.scene.environmentIntensity = 0.5;
    generator.dispose();
  }
}
