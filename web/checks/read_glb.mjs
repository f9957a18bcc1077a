// Reads a GLB with the Khronos validator and three.js: `node checks/read_glb.mjs FILE BONE...`; prints JSON.
// World positions of the named nodes are those that three.js computes while it plays the first animation.

import { readFileSync } from "node:fs";
import validator from "gltf-validator";
import { AnimationMixer, Vector3 } from "three";
import { MeshoptDecoder } from "three/examples/jsm/libs/meshopt_decoder.module.js";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";

globalThis.self ??= globalThis;

const [file, ...names] = process.argv.slice(2);
const data = readFileSync(file);
const report = await validator.validateBytes(new Uint8Array(data), { maxIssues: 20 });
const gltf = await new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength), "");
const clip = gltf.animations[0];
const told = { issues: report.issues, tracks: clip?.tracks.length ?? 0, duration: clip?.duration ?? 0, places: {}, weights: {} };
if (clip) {
  const mixer = new AnimationMixer(gltf.scene);
  mixer.clipAction(clip).play();
  const byIndex = (name) => gltf.parser.json.nodes.findIndex((node) => node.name === name);
  const nodes = await Promise.all(names.map((name) => gltf.parser.getDependency("node", byIndex(name))));
  for (const name of names) told.places[name] = [];
  for (let frame = 0; frame <= Math.round(clip.duration * 30); frame++) {
    mixer.setTime(Math.min(frame / 30, clip.duration - 1e-5));
    gltf.scene.updateMatrixWorld(true);
    names.forEach((name, k) => told.places[name].push(nodes[k].getWorldPosition(new Vector3()).toArray()));
    gltf.scene.traverse((mesh) => {
      if (mesh.morphTargetInfluences?.length) (told.weights[mesh.name] ??= []).push([...mesh.morphTargetInfluences]);
    });
  }
}
process.stdout.write(JSON.stringify(told));
