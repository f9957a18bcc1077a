// The viewport: light, floor, camera and renderer. `low` trades quality for speed (no antialiasing, no environment).
import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { RoomEnvironment } from "three/examples/jsm/environments/RoomEnvironment.js";

const VIEWS = [
  { height: 0.88, distance: 4.5 },
  { height: 1.32, distance: 2.0 },
  { height: 1.57, distance: 0.95 },
];

export function makeViewport(canvas, low) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: !low, alpha: true, powerPreference: "high-performance" });
  renderer.toneMapping = THREE.NeutralToneMapping;
  renderer.toneMappingExposure = 1.0;
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = THREE.PCFShadowMap;
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(28, 1, 0.05, 40);
  const controls = new OrbitControls(camera, canvas);
  Object.assign(controls, { enableDamping: true, minDistance: 0.4, maxDistance: 9, maxPolarAngle: 1.62, enablePan: false });

  const key = new THREE.DirectionalLight(0xfff1e0, low ? 2.4 : 2.6);
  key.position.set(1.6, 3.4, 2.6);
  key.castShadow = true;
  key.shadow.mapSize.setScalar(low ? 512 : 2048);
  Object.assign(key.shadow.camera, { left: -1.5, right: 1.5, top: 1.6, bottom: -1.6, near: 0.5, far: 8 });
  Object.assign(key.shadow, { bias: -0.0004, normalBias: 0.012, radius: low ? 2 : 5 });
  const rim = new THREE.DirectionalLight(0xcfe4ff, 1.6);
  rim.position.set(-2.2, 2.6, -2.4);
  scene.add(key, key.target, rim, rim.target, new THREE.HemisphereLight(0xf4f8ff, 0xb9aa98, low ? 1.7 : 0.55));
  if (!low) {
    const pmrem = new THREE.PMREMGenerator(renderer);
    scene.environment = pmrem.fromScene(new RoomEnvironment(), 0.04).texture;
    scene.environmentIntensity = 0.5;
    pmrem.dispose();
  }
  const floor = new THREE.Mesh(new THREE.PlaneGeometry(30, 30), new THREE.ShadowMaterial({ opacity: 0.3 }));
  floor.rotation.x = -Math.PI / 2;
  floor.receiveShadow = true;
  const ring = makeRing();
  scene.add(floor, ring);

  let view = 0;
  let version = 0; // incremented when camera, size or theme change
  controls.addEventListener("change", () => version++);
  const centre = new THREE.Vector3();
  const viewport = {
    renderer,
    scene,
    camera,
    version() {
      controls.update(); // damping moves the camera on after a drag
      return version;
    },
    setTheme(dark) {
      version++;
      floor.material.opacity = dark ? 0.5 : 0.28;
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
      key.position.set(1.6 + centre.x, 3.4, 2.6 + centre.z);
      key.target.position.set(centre.x, 0.7, centre.z);
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
