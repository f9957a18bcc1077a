/** Stage, camera and renderer. Low quality is faster: no environment, no cast shadow. Edges are smooth in both. */

import { ResolutionControl, StageLight, type StageName, VIEWS } from "@echoavatar/client/three";
import { PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { Backdrop, Echoes } from "./backdrop.js";
import { type Covered, covered } from "./panels.js";

const GLIDE = 2.2; // per second, how fast the camera reaches a view
const SETTLED_S = 1.2; // a state must last so long before the camera follows it
const MARGIN = 0.9; // of the free part's half height and width, in which hands and head stay
const REACH = 0.14; // metres of fingers beyond a wrist, for a body of 1.65 m
const FULL = 0;
const UPPER = 1;
const CLOSE = 2;
const CHECK_S = 0.25; // between looks at what panels cover
const MOVED = 3; // per second, how fast the picture moves out from behind a panel
const HOME_S = 1.1; // per second, how fast the rings come to who stands
const STANDS = { speed: 0.05, seconds: 3.5 }; // metres per second, below which one stands, and for how long: a dancer who goes home comes back to them
const FILLED = 0.86; // of the free height, by a whole body
const PORTRAIT = 96; // pixels of a thumbnail

export class Viewport {
  readonly renderer: WebGLRenderer;
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(28, 1, 0.05, 60);
  readonly echoes = new Echoes();
  private readonly backdrop = new Backdrop();
  private readonly resolution: ResolutionControl;
  private readonly controls: OrbitControls;
  readonly light: StageLight;
  private readonly centre = new Vector3();
  private readonly goal = { position: new Vector3(), target: new Vector3() };
  private readonly arm = new Vector3();
  private readonly sight = { forward: new Vector3(), right: new Vector3(), up: new Vector3() };
  private view = FULL;
  private isGliding = false;
  private isChosen = false; // by the visitor
  private suited = { view: FULL, seconds: 0 };
  private widened = 1; // how much further away the camera is so that hands stay in the picture
  private fixed: { width: number; height: number } | null = null;
  private panels: Covered = { top: 0, right: 0, bottom: 0, left: 0 };
  private free: Covered = this.panels; // follows `panels`
  private looked = Infinity;
  private stood = 0; // seconds
  private isPoster = false; // whether the backdrop is a still picture behind the canvas
  /** Whether no cheaper avatar can be shown. */
  isCheapest = true;
  private tall = 1.65;

  /** `isClear`: no backdrop, but an alpha channel, for a program that shows this page over something else. */
  constructor(readonly canvas: HTMLCanvasElement, readonly low: boolean, private readonly isClear = false) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: low || isClear, powerPreference: "high-performance" });
    this.resolution = new ResolutionControl(low);
    this.light = new StageLight(this.scene, this.renderer, low);
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { enableDamping: true, minDistance: 0.5, maxDistance: 24, maxPolarAngle: 1.62, enablePan: false });
    this.scene.add(this.backdrop.mesh, this.echoes.mesh);
    this.backdrop.mesh.visible = !isClear;
    this.controls.addEventListener("start", () => ([this.isGliding, this.isChosen] = [false, true]));
    canvas.addEventListener("dblclick", () => this.frame());
    window.addEventListener("resize", () => {
      this.resize();
      if (!this.isChosen) this.frame(this.view, true);
    });
    this.resize();
    this.frame();
  }

  setStage(stage: StageName): void {
    this.light.set(stage);
    this.backdrop.set(stage);
    this.echoes.setTheme(stage === "dusk");
    if (this.isPoster) this.hang(true);
  }

  /** Whether it is time for a picture, so many seconds after the last; a recording gets all. */
  isDue(seconds: number): boolean {
    return this.fixed !== null || this.resolution.isDue(seconds);
  }

  /** Draws the backdrop once, as a picture behind the canvas, or again with each picture. */
  private hang(isPoster: boolean): void {
    const { renderer, scene, backdrop: { mesh }, canvas } = this;
    this.isPoster = isPoster;
    mesh.visible = !this.isClear;
    canvas.style.backgroundImage = "";
    if (!isPoster || this.isClear || !this.low) return; // without an alpha channel nothing behind the canvas is seen
    const others = scene.children.filter((node) => node !== mesh && node.visible);
    for (const node of others) node.visible = false;
    renderer.render(scene, this.camera);
    canvas.style.backgroundImage = `url(${canvas.toDataURL("image/webp", 0.95)})`;
    for (const node of others) node.visible = true;
    mesh.visible = false;
  }

  /** Returns to the chosen view; `index` chooses another. */
  frame(index = this.view, glides = false): void {
    this.view = index % VIEWS.length;
    const { height, distance: wide, side } = VIEWS[this.view]!;
    const { high, aspect } = this.room();
    const narrow = Math.min(1, aspect / 0.72);
    const distance = (wide * (this.tall / 1.65)) / (high * narrow ** 0.75);
    const forward = Math.sqrt(1 - side * side);
    const { position, target } = this.goal;
    target.set(this.centre.x, height * this.tall, this.centre.z);
    position.set(this.centre.x + side * distance, height * this.tall + 0.07 * distance, this.centre.z + forward * distance);
    this.isGliding = glides;
    if (glides) return;
    this.widened = 1;
    this.controls.target.copy(target);
    this.camera.position.copy(position);
    this.controls.update();
  }

  /** The view that the visitor chose; null: the camera follows what the avatar does. */
  get chosen(): number | null {
    return this.isChosen ? this.view : null;
  }

  choose(view: number | null): void {
    this.isChosen = view !== null;
    this.frame(view ?? FULL, true);
  }

  nextView(): void {
    this.choose((this.view + 1) % VIEWS.length);
  }

  /** Shows the upper body of who speaks and the whole body of who dances, until the visitor chooses a view. */
  suit(state: string, seconds: number): void {
    const view = state === "dancing" ? FULL : state === "speaking" ? UPPER : this.view;
    this.suited = view === this.suited.view ? { view, seconds: this.suited.seconds + seconds } : { view, seconds: 0 };
    if (!this.isChosen && view !== this.view && this.suited.seconds > SETTLED_S) this.frame(view, true);
  }

  /** Moves the camera back while one of these points (hands, head) would leave the picture. */
  attend(points: readonly Vector3[], seconds: number): void {
    if (this.view === CLOSE || !points.length) return;
    const { forward, right, up } = this.sight;
    const { target } = this.controls;
    this.camera.matrixWorld.extractBasis(right, up, forward); // the camera looks along -Z
    const distance = this.camera.position.distanceTo(target) / this.widened;
    const { high: free, aspect } = this.room();
    const half = Math.tan((this.camera.fov * Math.PI) / 360) * MARGIN * free;
    const reach = (REACH * this.tall) / 1.65;
    let needed = distance;
    for (const point of points) {
      this.arm.copy(point).sub(target);
      const high = Math.abs(this.arm.dot(up)) + reach;
      const wide = (Math.abs(this.arm.dot(right)) + reach) / aspect;
      needed = Math.max(needed, Math.max(high, wide) / half + this.arm.dot(forward));
    }
    const wanted = Math.min(2.2, needed / distance);
    const speed = wanted > this.widened ? 6 : 0.7; // quickly away, slowly back
    const next = this.widened + (wanted - this.widened) * (1 - Math.exp(-speed * seconds));
    this.camera.position.sub(target).multiplyScalar(next / this.widened).add(target);
    this.widened = next;
  }

  /** Draws pictures of this size whatever the window's, for a recording; `null` ends it. */
  fix(size: { width: number; height: number } | null): void {
    this.fixed = size;
    this.canvas.classList.toggle("fixed", size !== null);
    this.resize();
    this.frame(this.view, true);
  }

  /** Scales the views to the avatar's height in metres. */
  setHeight(metres: number): void {
    this.tall = Math.min(4, Math.max(0.3, metres));
    this.frame();
  }

  /** Brings the rings to where the avatar has come to stand. */
  settle(seconds: number): void {
    const { position } = this.echoes.mesh;
    if (this.stood < STANDS.seconds) return;
    const share = 1 - Math.exp(-HOME_S * seconds);
    position.x += (this.centre.x - position.x) * share;
    position.z += (this.centre.z - position.z) * share;
  }

  /** A small picture of a face, whose middle is at `head`, or of the whole body, as a data address. */
  portrait(head: Vector3 | null): string {
    const camera = new PerspectiveCamera(24, 1, 0.05, 60);
    const size = this.tall / 1.65;
    const middle = head?.clone() ?? new Vector3(this.centre.x, 0.44 * this.tall, this.centre.z);
    middle.y += 0.06 * size;
    camera.position.set(middle.x + 0.12 * size, middle.y, middle.z + (head ? 1.05 : 4.2) * size);
    camera.lookAt(middle);
    this.renderer.render(this.scene, camera);
    const small = Object.assign(document.createElement("canvas"), { width: PORTRAIT, height: PORTRAIT });
    small.getContext("2d")!.drawImage(this.canvas, 0, 0, PORTRAIT, PORTRAIT);
    return small.toDataURL("image/webp", 0.85);
  }

  /** Moves camera and light with the avatar; `ease` 1 jumps. */
  follow(x: number, z: number, ease: number, seconds: number): void {
    const [dx, dz] = [(x - this.centre.x) * ease, (z - this.centre.z) * ease];
    this.stood = Math.hypot(dx, dz) < STANDS.speed * seconds ? this.stood + seconds : 0;
    this.centre.x += dx;
    this.centre.z += dz;
    for (const vector of [this.controls.target, this.camera.position, this.goal.target, this.goal.position]) {
      vector.x += dx;
      vector.z += dz;
    }
    this.light.follow(this.centre.x, this.centre.z);
  }

  /** Draws a frame; `seconds` since the previous one. */
  render(seconds: number): void {
    if (!this.fixed && this.resolution.picture(seconds, this.isCheapest)) this.resize();
    const isPoster = this.resolution.isPoster && !this.fixed;
    if (isPoster !== this.isPoster) this.hang(isPoster);
    this.makeRoom(seconds);
    this.glide(seconds);
    this.controls.update();
    this.light.update();
    this.renderer.render(this.scene, this.camera);
  }

  resize(): void {
    const { width, height } = this.shape;
    const density = Math.min(window.devicePixelRatio, 2) * this.resolution.scale;
    this.renderer.setPixelRatio(this.fixed ? 1 : density);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.looked = Infinity;
    this.makeRoom(Infinity);
  }

  /** Lays a shadow over the place where a body is about to stand. */
  shadow(node: HTMLElement | SVGElement): void {
    const { top, right, bottom, left } = covered(); // nothing else looks before the body is there
    const [x, y, high] = [(left + innerWidth - right) / 2, (top + innerHeight - bottom) / 2, innerHeight - top - bottom];
    Object.assign(node.style, { left: `${x}px`, top: `${y}px`, height: `${FILLED * high}px` });
  }

  /** The share of the picture's height that no panel covers, and the shape of what is free. */
  private room(): { high: number; aspect: number } {
    const { width, height } = this.shape;
    const { top, right, bottom, left } = this.panels;
    const high = 1 - (top + bottom) / height;
    return { high, aspect: (width - left - right) / (high * height) };
  }

  private get shape(): { width: number; height: number } {
    return this.fixed ?? { width: window.innerWidth, height: window.innerHeight };
  }

  /** Moves the picture's middle to the middle of what no panel covers. */
  private makeRoom(seconds: number): void {
    this.looked += seconds;
    if (this.looked > CHECK_S) {
      const before = this.panels;
      this.panels = this.fixed ? { top: 0, right: 0, bottom: 0, left: 0 } : covered();
      this.looked = 0;
      const sides = ["top", "right", "bottom", "left"] as const;
      const hasMoved = sides.some((side) => Math.abs(before[side] - this.panels[side]) > 1);
      if (hasMoved && !this.isChosen && seconds !== Infinity) this.frame(this.view, true);
    }
    const { free, panels } = this;
    const share = 1 - Math.exp(-MOVED * seconds);
    const eased = (side: keyof Covered) => free[side] + (panels[side] - free[side]) * share;
    this.free = { top: eased("top"), right: eased("right"), bottom: eased("bottom"), left: eased("left") };
    const { width, height } = this.shape;
    const { top, right, bottom, left } = this.free;
    this.camera.setViewOffset(width, height, (right - left) / 2, (bottom - top) / 2, width, height);
  }

  private glide(seconds: number): void {
    if (!this.isGliding) return;
    const { position, target } = this.goal;
    const { camera, controls } = this;
    camera.position.sub(controls.target).divideScalar(this.widened).add(controls.target);
    const share = 1 - Math.exp(-GLIDE * seconds);
    camera.position.lerp(position, share);
    controls.target.lerp(target, share);
    this.isGliding = camera.position.distanceTo(position) > 0.01;
    camera.position.sub(controls.target).multiplyScalar(this.widened).add(controls.target);
  }
}
