// Opens VRM files as other programs do, and fails where one finds fault: `node vrm.mjs FILE...` prints a line of JSON each.
// Khronos' validator, gltf-transform's `inspect`, and three-vrm, which must find bones, expressions, gaze and springs.

import { readFileSync } from "node:fs";
import { Logger, NodeIO } from "@gltf-transform/core";
import { inspect } from "@gltf-transform/functions";
import { VRMLoaderPlugin } from "@pixiv/three-vrm";
import validator from "gltf-validator";
import { Object3D, Quaternion, Texture, Vector3 } from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";

globalThis.self ??= globalThis;

/** three.js wants a browser to decode pictures; here each is an empty one. */
class WithoutPictures {
  name = "without_pictures";
  loadTexture = async () => new Texture();
}

async function opened(data) {
  const loader = new GLTFLoader().register(() => new WithoutPictures()).register((parser) => new VRMLoaderPlugin(parser));
  const gltf = await loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength), "");
  return gltf.userData.vrm;
}

/** Plays a moment of the file: a smile, a look to the left, a bent elbow, and the hair after a quick turn of the head. */
function tried(vrm) {
  let weights = [];
  vrm.scene.traverse((mesh) => (mesh.morphTargetInfluences?.length ? (weights = mesh.morphTargetInfluences) : null));
  vrm.expressionManager.setValue("happy", 1);
  const target = new Object3D();
  target.position.set(2, 1.6, 2);
  vrm.lookAt.target = target;
  const strands = [...(vrm.springBoneManager?.joints ?? [])].map((joint) => joint.child).filter(Boolean);
  const places = () => strands.map((strand) => strand.getWorldPosition(new Vector3()));
  vrm.springBoneManager?.reset();
  vrm.update(1 / 60);
  const settled = (seconds) => {
    for (let i = 0; i < seconds * 60; i++) vrm.update(1 / 60);
    vrm.scene.updateMatrixWorld(true);
    return places();
  };
  const apart = (a, b) => Math.max(0, ...a.map((place, i) => place.distanceTo(b[i])));
  const start = places();
  const sag = apart(start, settled(2));
  vrm.humanoid.getNormalizedBoneNode("hips").position.x += 0.1;
  vrm.humanoid.getNormalizedBoneNode("head").rotation.y = 0.6;
  const during = settled(0.1);
  const after = settled(2);
  vrm.humanoid.getNormalizedBoneNode("leftLowerArm").rotation.y = -1.6;
  vrm.update(1 / 60);
  const halfway = vrm.scene.getObjectByName("leftLowerArmHalfway")?.quaternion.angleTo(new Quaternion()) ?? 0;
  return { halfway, moved: weights.filter((weight) => weight > 0.05).length, sag, swing: apart(during, after) };
}

const [...files] = process.argv.slice(2);
if (!files.length) throw new Error("no file to open; name one or more: node vrm.mjs FILE...");
for (const file of files) {
  const data = readFileSync(file);
  const { issues } = await validator.validateBytes(new Uint8Array(data), { maxIssues: 20 });
  const document = (await new NodeIO().setLogger(new Logger(Logger.Verbosity.SILENT)).readBinary(new Uint8Array(data)));
  const report = inspect(document);
  const vrm = await opened(data);
  const told = {
    file,
    errors: issues.numErrors,
    warnings: issues.numWarnings,
    messages: issues.messages.filter(({ severity }) => severity < 2),
    inspect: {
      triangles: report.meshes.properties.reduce((sum, mesh) => sum + mesh.glPrimitives, 0),
      textures: report.textures.properties.length,
      materials: report.materials.properties.length,
    },
    vrm: vrm.meta.metaVersion,
    name: vrm.meta.name,
    licence: vrm.meta.licenseUrl,
    bones: Object.keys(vrm.humanoid.humanBones).length,
    presets: Object.keys(vrm.expressionManager.presetExpressionMap).length,
    custom: Object.keys(vrm.expressionManager.customExpressionMap).length,
    looks: vrm.lookAt?.applier?.constructor.name ?? "",
    annotations: vrm.firstPerson.meshAnnotations.length,
    springs: vrm.springBoneManager?.joints.size ?? 0,
    ...tried(vrm),
  };
  console.log(JSON.stringify(told));
  if (told.errors || told.bones !== 52 || told.custom !== 52) process.exitCode = 1;
}
