/** Drives the morph targets of a model by what their names say. */

import type { Mesh, Object3D } from "three";
import { ForeignFace } from "../facenames.js";
import { ARKIT_NAMES } from "../facenames.generated.js";

export class MorphMap {
  private readonly faces: { face: ForeignFace; influences: number[] }[] = [];
  private readonly curves: ReadonlyMap<string, number>;
  /** The face curves that move nothing. */
  readonly silent: readonly string[];

  constructor(model: Object3D, curves: readonly string[]) {
    this.curves = new Map(curves.map((name, curve) => [name, curve]));
    model.traverse((node) => {
      const { morphTargetDictionary: dictionary, morphTargetInfluences: influences, userData } = node as Mesh;
      if (!dictionary || !influences) return;
      const names = influences.map(() => "");
      for (const [name, morph] of Object.entries(dictionary)) names[morph] = name;
      const face = new ForeignFace((userData["targetNames"] as string[] | undefined) ?? names);
      if (face.isMoving) this.faces.push({ face, influences });
    });
    this.silent = ARKIT_NAMES.filter((name) => this.faces.every(({ face }) => face.silent.includes(name)));
  }

  apply(face: Float32Array): void {
    const get = (name: string) => face[this.curves.get(name) ?? -1] ?? 0;
    for (const { face: theirs, influences } of this.faces) theirs.apply(get, (morph, weight) => (influences[morph] = weight));
  }
}
