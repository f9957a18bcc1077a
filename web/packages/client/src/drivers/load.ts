/** Reads a .vrm or .glb file and returns a driver for it. */

import { VRMLoaderPlugin, type VRM, VRMUtils } from "@pixiv/three-vrm";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { GlbDriver } from "./glb.js";
import { VrmDriver } from "./vrm.js";

/** Throws an error with a message for the user when the bytes are not a VRM or GLB model. */
export async function loadAvatar(data: ArrayBuffer): Promise<GlbDriver | VrmDriver> {
  const loader = new GLTFLoader();
  loader.register((parser) => new VRMLoaderPlugin(parser));
  const gltf = await loader.parseAsync(data, "");
  const vrm = gltf.userData["vrm"] as VRM | undefined;
  if (!vrm) return new GlbDriver(gltf.scene);
  VRMUtils.removeUnnecessaryVertices(gltf.scene);
  VRMUtils.combineSkeletons(gltf.scene);
  return new VrmDriver(vrm);
}
