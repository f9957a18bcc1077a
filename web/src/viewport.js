// The viewport: light, floor, camera and renderer. `low` trades quality for speed (no antialiasing, no environment).
import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { StageLight } from "../packages/client/src/drivers/light.ts";

const VIEWS = [
  { height: 0.88, distance: 4.5 },
  { height: 1.32, distance: 2.0 },
  { height: 1.57, distance: 0.95 },
];

export function makeViewport(canvas, low) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: !low, alpha: true, powerPreference: "high-performance" });
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(28, 1, 0.05, 40);
  const controls = new OrbitControls(camera, canvas);
  Object.assign(controls, { enableDamping: true, minDistance: 0.4, maxDistance: 9, maxPolarAngle: 1.62, enablePan: false });

  const light = new StageLight(scene, renderer, low);
  const ring = makeRing();
  scene.add(ring);

  let view = 0;
  let version = 0; // incremented when camera, size or theme change
  controls.addEventListener("change", () => version++);
  const centre = new THREE.Vector3();
  const viewport = {
    renderer,
    scene,
    light,
    camera,
    version() {
      controls.update(); // damping moves the camera on after a drag
      return version;
    },
    setTheme(dark) {
      version++;
      light.set(dark ? "dusk" : "studio");
      ring.material.color.set(dark ? 0x9fb6c2 : 0x51626f);
    },
    frame(index = view) {
      view = index % VIEWS.length;
      const narrow = Math.min(1, camera.aspect / 0.62);
      const { height, distance: wide } = VIEWS[view];
      const distance = wide / narrow ** 0.7;
      controls.target.set(centre.x, height, centre.z);
      camera.position.set(centre.x + 0.36 * distance, height + 0.1 * distance, centre.z + 0.92 * distance);
      controls.update();
    },
    nextView() {
      viewport.frame(view + 1);
    },
    follow(x, z, ease) {
      const dx = (x - centre.x) * ease;
      const dz = (z - centre.z) * ease;
      centre.x += dx;
      centre.z += dz;
      for (const vector of [controls.target, camera.position]) {
        vector.x += dx;
        vector.z += dz;
      }
      light.follow(centre.x, centre.z);
    },
    resize() {
      version++;
      const width = window.innerWidth;
      const height = window.innerHeight;
      renderer.setPixelRatio(low ? 1 : Math.min(window.devicePixelRatio, 2));
      renderer.setSize(width, height, false);
      camera.aspect = width / height;
      camera.setViewOffset(width, height, 0, height * 0.055, width, height);
      camera.updateProjectionMatrix();
    },
    render() {
      light.update();
      renderer.render(scene, camera);
    },
  };
  return viewport;
}

function makeRing() {
  const material = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.16, depthWrite: false });
  const ring = new THREE.Mesh(new THREE.RingGeometry(0.744, 0.75, 96), material);
  ring.rotation.x = -Math.PI / 2;
  ring.position.y = 0.001;
  return ring;
}
