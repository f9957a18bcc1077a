/** Reads a .vrm or .glb file and returns a driver for it. */

import { VRMLoaderPlugin, type VRM, VRMUtils } from "@pixiv/three-vrm";
import { MeshoptDecoder } from "three/examples/jsm/libs/meshopt_decoder.module.js";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { GlbDriver } from "./glb.js";
import { VrmDriver } from "./vrm.js";

/** Throws an error with a message for the user when the bytes are not a VRM or GLB model. */
export async function loadAvatar(data: ArrayBuffer): Promise<GlbDriver | VrmDriver> {
  checkContainer(data);
  const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
  loader.register((parser) => new VRMLoaderPlugin(parser));
  const gltf = await loader.parseAsync(data, "").catch((error: Error) => {
    throw new Error(`the file is damaged inside (${error.message}). Export it again.`);
  });
  gltf.scene.traverse((node) => (node.frustumCulled = false)); // three takes a body to be where its rest pose is
  const vrm = gltf.userData["vrm"] as VRM | undefined;
  if (!vrm) return new GlbDriver(gltf.scene);
  VRMUtils.removeUnnecessaryVertices(gltf.scene);
  VRMUtils.combineSkeletons(gltf.scene);
  return new VrmDriver(vrm);
}

/** Throws an error in plain words for what is often dropped by mistake. */
function checkContainer(data: ArrayBuffer): void {
  const head = new DataView(data, 0, Math.min(12, data.byteLength));
  const first = head.byteLength ? head.getUint8(0) : 0;
  if (first === 0x7b) throw new Error("it is a .gltf with separate parts. Export one .glb file instead.");
  if (head.byteLength < 12 || head.getUint32(0, true) !== 0x46546c67) throw new Error("it is not a .vrm or .glb file, whatever its name says.");
  const length = head.getUint32(8, true);
  if (length > data.byteLength) throw new Error(`it is cut off after ${data.byteLength} of ${length} bytes. Copy or download it again.`);
}
