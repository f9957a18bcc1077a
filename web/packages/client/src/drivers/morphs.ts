/** Drives morph targets with ARKit names, whatever their case and prefix. */

import type { Mesh, Object3D } from "three";

interface Target {
  readonly influences: number[];
  readonly morph: number;
  readonly curve: number;
}

export class MorphMap {
  private readonly targets: Target[] = [];
  /** The face curves that the model has morph targets for. */
  readonly found = new Set<string>();

  constructor(model: Object3D, names: readonly string[]) {
    const curves = new Map(names.map((name, curve) => [plain(name), curve]));
    model.traverse((node) => {
      const { morphTargetDictionary: dictionary, morphTargetInfluences: influences } = node as Mesh;
      if (!dictionary || !influences) return;
      for (const [name, morph] of Object.entries(dictionary)) {
        const curve = curves.get(plain(name));
        if (curve === undefined) continue;
        this.targets.push({ influences, morph, curve });
        this.found.add(names[curve]!);
      }
    });
  }

  apply(face: Float32Array): void {
    for (const { influences, morph, curve } of this.targets) influences[morph] = face[curve] ?? 0;
  }
}

/** Normalises a name: `blendShape1.eyeBlink_L` and `EyeBlinkLeft` both become `eyeblinkleft`. */
export function plain(name: string): string {
  return name
    .replace(/^.*[.:]/, "")
    .replace(/_L$/, "Left")
    .replace(/_R$/, "Right")
    .replace(/[_\s]/g, "")
    .toLowerCase();
}
