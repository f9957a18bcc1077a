/** The outfits that a model brings: its variants of materials (KHR_materials_variants). */

import type { Material, Mesh, Object3D } from "three";
import type { GLTF } from "three/examples/jsm/loaders/GLTFLoader.js";

const NAME = "KHR_materials_variants";

/** Names, and what each mesh that changes wears in each outfit, in the order of the names. */
export interface Outfits {
  readonly names: readonly string[];
  /** The one that the file shows; -1: none of them. */
  readonly first: number;
  readonly worn: ReadonlyMap<Object3D, readonly Material[]>;
}

export const NO_OUTFITS: Outfits = { names: [], first: -1, worn: new Map() };

interface Mapping {
  readonly material: number;
  readonly variants: readonly number[];
}

/** Reads them; call it while the file's pictures can be read. */
export async function readOutfits({ scene, parser }: GLTF): Promise<Outfits> {
  const names: string[] = (parser.json.extensions?.[NAME]?.variants ?? []).map(({ name = "" }, number: number) => name || `Outfit ${number + 1}`);
  const worn = new Map<Object3D, Material[]>();
  const meshes: Mesh[] = [];
  let shown = names.map((_, outfit) => outfit);
  scene.traverse((node) => (node as Mesh).isMesh && meshes.push(node as Mesh));
  for (const mesh of names.length ? meshes : []) {
    const { meshes: at, primitives = 0 } = parser.associations.get(mesh) ?? {};
    const mappings: readonly Mapping[] = parser.json.meshes?.[at ?? -1]?.primitives[primitives].extensions?.[NAME]?.mappings ?? [];
    if (!mappings.length) continue;
    const own = mesh.material as Material;
    const materials = names.map(() => own);
    for (const { material, variants } of mappings) {
      mesh.material = (await parser.getDependency("material", material)) as Material;
      parser.assignFinalMaterial(mesh);
      for (const variant of variants) materials[variant] = mesh.material;
    }
    mesh.material = own;
    shown = shown.filter((outfit) => materials[outfit] === own);
    worn.set(mesh, materials);
  }
  return { names, first: shown[0] ?? -1, worn };
}
