/** The camera that all views share: moved by dragging in any view, by buttons and by keys. */

import { PerspectiveCamera, Spherical, Vector3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const DISTANCE = 4.7; // metres, for a body of 1.65 m
const TURN = Math.PI / 12;
const CLOSER = 0.85;
const HEIGHT = 0.52; // height of the target as a fraction of the body, from afar
const HEAD = 0.9; // the same in a close-up, so that the face is visible
const CLOSE = 1; // metres, for a body of 1.65 m

export class SharedCamera {
  private readonly master = new PerspectiveCamera(28, 1, 0.05, 60);
  private readonly target = new Vector3();
  private controls: OrbitControls[] = [];
  private tall = 1.65;
  /** Called when the camera moved. */
  onMove: (() => void) | null = null;

  constructor() {
    this.reset();
  }

  /** Lets dragging in these elements move the camera. */
  attach(elements: readonly HTMLElement[]): void {
    for (const old of this.controls) old.dispose();
    this.controls = elements.map((element) => {
      const controls = new OrbitControls(this.master, element);
      Object.assign(controls, {
        enableDamping: false,
        minDistance: 0.6,
        maxDistance: 9,
        maxPolarAngle: 1.62,
        enablePan: false,
      });
      controls.target = this.target;
      controls.addEventListener("change", () => this.moved());
      element.style.touchAction = "pan-y"; // vertical swipes scroll the page
      return controls;
    });
  }

  setHeight(metres: number): void {
    this.tall = Math.min(4, Math.max(0.3, metres));
    this.reset();
  }

  /** Returns to the initial view. */
  reset(): void {
    const distance = DISTANCE * (this.tall / 1.65);
    this.target.set(0, HEIGHT * this.tall, 0);
    this.master.position.set(0.16 * distance, HEIGHT * this.tall + 0.07 * distance, 0.985 * distance);
    this.moved();
  }

  /** Rotates right and moves closer by steps; both may be negative. */
  step(right: number, closer: number): void {
    const place = new Spherical().setFromVector3(this.master.position.clone().sub(this.target));
    place.theta += right * TURN;
    place.radius = Math.min(9, Math.max(0.6, place.radius * CLOSER ** closer));
    this.master.position.setFromSpherical(place).add(this.target);
    this.moved();
  }

  /** Sets `lens` for a view of the given aspect around (x, z); narrow views are farther away. */
  aim(lens: PerspectiveCamera, aspect: number, x: number, z: number): void {
    const back = Math.min(1, aspect / 0.62) ** -0.75;
    lens.position.copy(this.master.position).sub(this.target).multiplyScalar(back).add(this.target);
    lens.lookAt(this.target);
    lens.position.x += x;
    lens.position.z += z;
    lens.aspect = aspect;
    lens.updateProjectionMatrix();
  }

  /** The target is higher the closer the camera is: the hips for a whole body, the face in a close-up. */
  private moved(): void {
    const scale = this.tall / 1.65;
    const distance = this.master.position.distanceTo(this.target);
    const share = Math.min(1, Math.max(0, (DISTANCE * scale - distance) / ((DISTANCE - CLOSE) * scale)));
    const rise = (HEIGHT + (HEAD - HEIGHT) * share) * this.tall - this.target.y;
    this.target.y += rise;
    this.master.position.y += rise;
    this.master.lookAt(this.target);
    this.onMove?.();
  }
}
