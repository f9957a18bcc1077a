/** Writes VRM Animation 1.0: body and face for any VRM avatar. */

import { VRM_EXPRESSIONS, toVrm } from "../expressions.js";
import { Gltf, bodyTracks, track } from "./glb.js";
import type { Take } from "./take.js";

const PRESETS = 8; // vowels and blinks; gaze is exported as `lookAt`

/** The format stores an expression's weight as the X translation of a node. */
export function toVrma(take: Take): Uint8Array<ArrayBuffer> {
  const { rig, face } = take;
  const nodes: object[] = rig.names.map((name, joint) => {
    const children = rig.parents.flatMap((parent, child) => (parent === joint ? [child] : []));
    return { name, translation: rig.rest[joint], ...(children.length ? { children } : {}) };
  });
  const gltf = new Gltf({ asset: { version: "2.0", generator: "EchoAvatar" }, extensionsUsed: ["VRMC_vrm_animation"], nodes });
  const input = gltf.add(take.times(), "SCALAR", true);
  const tracks = bodyTracks(gltf, take, input, (name) => rig.names.indexOf(name));
  const express = (name: string, weights: number[]) => {
    const node = nodes.push({ name }) - 1;
    track(tracks, input, gltf.add(Float32Array.from(weights.flatMap((weight) => [weight, 0, 0])), "VEC3"), node, "translation");
    return { node };
  };
  const vrm = take.frames.map((frame) => toVrm((name) => frame.face[face.indexOf(name)] ?? 0));
  const preset = face.length
    ? VRM_EXPRESSIONS.slice(0, PRESETS).map((name, k) => [name, express(name, vrm.map((weights) => weights[k]!))])
    : [];
  const custom = face.map((name, k) => [name, express(name, take.frames.map((frame) => frame.face[k]!))]);
  Object.assign(gltf.json, {
    scene: 0,
    scenes: [{ nodes: [rig.parents.indexOf(-1), ...nodes.keys()].filter((n, i) => i === 0 || n >= rig.names.length) }],
    animations: [{ name: "take", ...tracks }],
    extensions: {
      VRMC_vrm_animation: {
        specVersion: "1.0",
        humanoid: { humanBones: Object.fromEntries(rig.names.map((name, node) => [name, { node }])) },
        expressions: { preset: Object.fromEntries(preset), custom: Object.fromEntries(custom) },
      },
    },
  });
  return gltf.pack();
}
