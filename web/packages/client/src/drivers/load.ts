/** Reads a .vrm, .glb or .gltf file and returns a driver for it. */

import { VRMLoaderPlugin, type VRM, VRMUtils } from "@pixiv/three-vrm";
import { type Loader, LoadingManager, type Texture } from "three";
import { MeshoptDecoder } from "three/examples/jsm/libs/meshopt_decoder.module.js";
import { type GLTF, GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import type { KTX2Loader } from "three/examples/jsm/loaders/KTX2Loader.js";
import { targetNames } from "../facenames.js";
import { GlbDriver } from "./glb.js";
import { readOutfits } from "./outfits.js";
import { VrmDriver } from "./vrm.js";

export interface LoadOptions {
  /** The files beside a .gltf, by their names. */
  readonly files?: ReadonlyMap<string, Blob>;
  /** What reads KTX2 textures, asked for when a file has some: three's KTX2Loader, whose transcoder evaluates code, or another. */
  readonly basis?: (manager: LoadingManager) => Promise<BasisLoader>;
}

/** What of three's KTX2Loader is used; `fault` is the first error of a picture, which three passes to no one. */
export type BasisLoader = Loader<Texture> & { dispose(): void; readonly fault?: Error | null };

/** Throws an error with a message for the user when the bytes are not a VRM or glTF model. */
export async function loadAvatar(data: ArrayBuffer, options: LoadOptions = {}): Promise<GlbDriver | VrmDriver> {
  const document = checkedDocument(data);
  const used: string[] = document.extensionsUsed ?? [];
  const files = partsOf(document, options.files ?? new Map());
  const manager = new LoadingManager();
  manager.setURLModifier((url) => files.get(url) ?? url);
  const loader = new GLTFLoader(manager).setMeshoptDecoder(MeshoptDecoder);
  loader.register((parser) => new VRMLoaderPlugin(parser));
  let lost = 0; // pictures; three leaves them out and goes on
  manager.onError = () => lost++;
  const [draco, basis] = await Promise.all([useDraco(loader, used), useBasis(loader, used, manager, options)]);
  const read = loader.parseAsync(data, "").catch((error: Error) => {
    throw new Error(`the file is damaged inside (${error.message}). Export it again.`);
  });
  const [gltf, outfits] = await read.then(async (gltf) => [gltf, await readOutfits(gltf)] as const).finally(() => {
    draco?.dispose();
    basis?.dispose();
    for (const address of files.values()) URL.revokeObjectURL(address);
  });
  if (basis?.fault) throw basis.fault;
  if (lost) throw new Error(`${lost} of its pictures cannot be read. Export them as PNG or JPEG.`);
  gltf.scene.traverse((node) => (node.frustumCulled = false)); // three takes a body to be where its rest pose is
  nameTargets(gltf);
  const vrm = gltf.userData["vrm"] as VRM | undefined;
  if (!vrm) return new GlbDriver(gltf.scene, outfits);
  VRMUtils.removeUnnecessaryVertices(gltf.scene);
  VRMUtils.combineSkeletons(gltf.scene);
  return new VrmDriver(vrm, outfits);
}

async function useDraco(loader: GLTFLoader, used: string[]) {
  if (!used.includes("KHR_draco_mesh_compression")) return null;
  const { DRACOLoader, DRACO_GLTF_CONFIG } = await import("three/examples/jsm/loaders/DRACOLoader.js");
  const draco = new DRACOLoader().setDecoderPath(DRACO_GLTF_CONFIG);
  loader.setDRACOLoader(draco);
  return draco;
}

async function useBasis(loader: GLTFLoader, used: string[], manager: LoadingManager, { basis }: LoadOptions) {
  if (!used.includes("KHR_texture_basisu")) return null;
  if (!basis) throw new Error("its textures are KTX2 (KHR_texture_basisu), which this page cannot read. Export them as PNG or JPEG.");
  const found = await basis(manager);
  loader.setKTX2Loader(found as KTX2Loader);
  return found;
}

/** Lets every mesh know the names of its morph targets, which exporters write in several places. */
function nameTargets({ scene, parser }: GLTF): void {
  scene.traverse((node) => {
    const mesh = parser.json.meshes?.[parser.associations.get(node)?.meshes ?? -1];
    if (mesh?.primitives[0].targets) node.userData["targetNames"] = targetNames(parser.json, mesh);
  });
}

/* eslint-disable-next-line @typescript-eslint/no-explicit-any */
type Json = any;

/** Addresses of the files that a document refers to. */
function partsOf({ buffers = [], images = [] }: Json, files: ReadonlyMap<string, Blob>): Map<string, string> {
  const wanted: string[] = [...buffers, ...images].flatMap(({ uri }) => (uri && !/^data:/.test(uri) ? uri : []));
  const found = wanted.map((uri) => [uri, files.get(decodeURIComponent(uri.split("/").at(-1)!))] as const);
  const missing = found.find(([, file]) => !file);
  if (missing) throw new Error(`it refers to “${missing[0]}”, which is not there. Drop all its files together, or export one .glb file.`);
  return new Map(found.map(([uri, file]) => [uri, URL.createObjectURL(file!)]));
}

/** The JSON of a file; throws an error in plain words for what is often dropped by mistake. */
function checkedDocument(data: ArrayBuffer): Json {
  const view = new DataView(data);
  const text = (start: number, length: number): Json => {
    try {
      return JSON.parse(new TextDecoder().decode(new Uint8Array(data, start, length)));
    } catch (error) {
      throw new Error(`the file is damaged inside (${(error as Error).message}). Export it again.`);
    }
  };
  if (data.byteLength && view.getUint8(0) === 0x7b) return text(0, data.byteLength);
  if (data.byteLength < 20 || view.getUint32(0, true) !== 0x46546c67) throw new Error("it is not a .vrm, .glb or .gltf file, whatever its name says.");
  const length = view.getUint32(8, true);
  if (length > data.byteLength) throw new Error(`it is cut off after ${data.byteLength} of ${length} bytes. Copy or download it again.`);
  return text(20, view.getUint32(12, true));
}
