/** Adds a take as an animation to a character's glTF binary. */

import type { Take } from "./take.js";

/* eslint-disable-next-line @typescript-eslint/no-explicit-any */
type Json = any;
const FLOAT = 5126;
const SIZES = { SCALAR: 1, VEC3: 3, VEC4: 4 } as const;

/** A glTF document that accessors and animations can be added to. */
export class Gltf {
  private readonly parts: Uint8Array[] = [];
  private length = 0;

  constructor(readonly json: Json, binary: Uint8Array = new Uint8Array()) {
    json.bufferViews ??= [];
    json.accessors ??= [];
    if (binary.length) this.append(binary);
  }

  static parse(data: ArrayBuffer): Gltf {
    const view = new DataView(data);
    if (view.getUint32(0, true) !== 0x46546c67) throw new Error("This is no GLB file.");
    const size = view.getUint32(12, true);
    const json = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 20, size)));
    const bytes = data.byteLength > 28 + size ? new Uint8Array(data, 28 + size, view.getUint32(20 + size, true)) : undefined;
    return new Gltf(json, bytes);
  }

  /** Appends numbers; returns the accessor's index. */
  add(values: Float32Array, type: keyof typeof SIZES, bounds = false): number {
    const { json } = this;
    const view = { buffer: 0, byteOffset: this.append(new Uint8Array(values.buffer, values.byteOffset, values.byteLength)), byteLength: values.byteLength };
    const accessor: Json = { bufferView: json.bufferViews.push(view) - 1, componentType: FLOAT, count: values.length / SIZES[type], type };
    if (bounds) Object.assign(accessor, { min: [Math.min(...values)], max: [Math.max(...values)] });
    return json.accessors.push(accessor) - 1;
  }

  /** The bytes of the file. */
  pack(): Uint8Array<ArrayBuffer> {
    this.json.buffers = [{ byteLength: this.length }];
    const plain = new TextEncoder().encode(JSON.stringify(this.json));
    const text = new Uint8Array(Math.ceil(plain.length / 4) * 4).fill(32);
    text.set(plain);
    const out = new Uint8Array(28 + text.length + this.length);
    const view = new DataView(out.buffer);
    [0x46546c67, 2, out.length, text.length, 0x4e4f534a].forEach((value, i) => view.setUint32(i * 4, value, true));
    out.set(text, 20);
    view.setUint32(20 + text.length, this.length, true);
    view.setUint32(24 + text.length, 0x004e4942, true);
    let at = 28 + text.length;
    for (const part of this.parts) {
      out.set(part, at);
      at += part.length;
    }
    return out;
  }

  private append(bytes: Uint8Array): number {
    const at = this.length;
    const padded = new Uint8Array(Math.ceil(bytes.length / 4) * 4);
    padded.set(bytes);
    this.parts.push(padded);
    this.length += padded.length;
    return at;
  }
}

interface Tracks {
  samplers: Json[];
  channels: Json[];
}

/** Adds the rotations of all joints that `nodeOf` maps to a node, and the translation of the hips. */
export function bodyTracks(gltf: Gltf, take: Take, input: number, nodeOf: (name: string) => number): Tracks {
  const tracks: Tracks = { samplers: [], channels: [] };
  take.rig.names.forEach((name, joint) => {
    if (nodeOf(name) >= 0) track(tracks, input, gltf.add(take.joint(joint), "VEC4"), nodeOf(name), "rotation");
  });
  track(tracks, input, gltf.add(take.root(), "VEC3"), nodeOf("hips"), "translation");
  return tracks;
}

export function track(tracks: Tracks, input: number, output: number, node: number, path: string): void {
  tracks.channels.push({ sampler: tracks.samplers.push({ input, output, interpolation: "LINEAR" }) - 1, target: { node, path } });
}

/** Adds the take to the character of `file`, whose nodes must have the rig's names and no rest rotations. */
export function toGlb(take: Take, file: ArrayBuffer): Uint8Array<ArrayBuffer> {
  const gltf = Gltf.parse(file);
  const { json } = gltf;
  const nodeOf = (name: string) => json.nodes.findIndex((node: Json) => node.name === name);
  const input = gltf.add(take.times(), "SCALAR", true);
  const tracks = bodyTracks(gltf, take, input, nodeOf);
  json.nodes.forEach((node: Json, index: number) => {
    const names: string[] | undefined = json.meshes?.[node.mesh]?.extras?.targetNames;
    if (!names?.length) return;
    const curves = names.map((name) => take.face.indexOf(name));
    const weights = take.frames.flatMap(({ face }) => curves.map((curve) => face[curve] ?? 0));
    track(tracks, input, gltf.add(Float32Array.from(weights), "SCALAR"), index, "weights");
  });
  json.animations = [{ name: "take", ...tracks }];
  return gltf.pack();
}
