// Reads a .vrma with @pixiv/three-vrm-animation: `node checks/read_vrma.mjs FILE [AVATAR.vrm]`; prints JSON.
// With an avatar, it plays the animation and prints the world positions of some bones, as three.js computes them.

import { readFileSync } from "node:fs";
import { VRMAnimationLoaderPlugin, createVRMAnimationClip, VRMLookAtQuaternionProxy } from "@pixiv/three-vrm-animation";
import { VRMLoaderPlugin } from "@pixiv/three-vrm";
import { AnimationMixer, Vector3 } from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";

globalThis.self ??= globalThis;

const [file, avatar] = process.argv.slice(2);
const load = (path, plugin) => {
  const loader = new GLTFLoader();
  loader.register((parser) => new plugin(parser));
  const data = readFileSync(path);
  return loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength), "");
};

const animation = (await load(file, VRMAnimationLoaderPlugin)).userData.vrmAnimations[0];
const told = {
  duration: animation.duration,
  restHipsHeight: animation.restHipsPosition.y,
  rotations: Object.fromEntries([...animation.humanoidTracks.rotation].map(([bone, track]) => [bone, track.times.length])),
  translations: [...animation.humanoidTracks.translation.keys()],
  hips: [...animation.humanoidTracks.translation.get("hips").values.slice(0, 3)],
  preset: Object.fromEntries([...animation.expressionTracks.preset].map(([name, track]) => [name, [...track.values]])),
  custom: Object.fromEntries([...animation.expressionTracks.custom].map(([name, track]) => [name, [...track.values]])),
  looks: animation.lookAtTrack?.times.length ?? 0,
};
if (avatar) {
  const { vrm } = (await load(avatar, VRMLoaderPlugin)).userData;
  if (vrm.lookAt) vrm.scene.add(Object.assign(new VRMLookAtQuaternionProxy(vrm.lookAt), { name: "lookAtQuaternionProxy" }));
  const mixer = new AnimationMixer(vrm.scene);
  mixer.clipAction(createVRMAnimationClip(animation, vrm)).play();
  told.places = {};
  const bones = ["hips", "head", "leftHand", "rightHand", "leftFoot", "rightFoot", "leftToes", "rightToes"];
  const frames = Math.round(animation.duration * 30) + 1;
  for (const bone of bones) told.places[bone] = [];
  for (let frame = 0; frame < frames; frame++) {
    mixer.setTime(Math.min(frame / 30, animation.duration - 1e-5));
    vrm.humanoid.update();
    vrm.scene.updateMatrixWorld(true);
    for (const bone of bones)
      told.places[bone].push(vrm.humanoid.getRawBoneNode(bone).getWorldPosition(new Vector3()).toArray());
  }
}
process.stdout.write(JSON.stringify(told));
