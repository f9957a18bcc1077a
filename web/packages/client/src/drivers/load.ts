/** Reads a .vrm or .glb file into the driver that fits it. */

import { VRMLoaderPlugin, type VRM, VRMUtils } from "@pixiv/three-vrm";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { GlbDriver } from "./glb.js";
import { VrmDriver } from "./vrm.js";

/** Raises an error with a reason to show when the bytes are no such model. */
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
