// Two steps of echoavatar_character.levels that have no Python library: simplify triangles, and compress a GLB.
import { readFileSync, writeFileSync } from "node:fs";
import { Logger, NodeIO } from "@gltf-transform/core";
import { EXTMeshoptCompression, EXTTextureWebP, KHRMaterialsVariants, KHRMeshQuantization, KHRTextureTransform } from "@gltf-transform/extensions";
import { meshopt, textureCompress } from "@gltf-transform/functions";
import { MeshoptDecoder, MeshoptEncoder, MeshoptSimplifier } from "meshoptimizer";
import sharp from "sharp";

/** Reads counts, positions, attributes, attribute weights and indices; writes the indices that are left. */
async function simplify(source, goal) {
  await MeshoptSimplifier.ready;
  const { buffer } = new Uint8Array(readFileSync(source));
  const [vertices, attributes, count, target] = new Int32Array(buffer, 0, 4);
  let at = 16;
  const floats = (n) => new Float32Array(buffer, (at += n * 4) - n * 4, n);
  const [positions, values, weights] = [floats(vertices * 3), floats(vertices * attributes), floats(attributes)];
  const indices = new Uint32Array(buffer, at, count);
  const [left] = MeshoptSimplifier.simplifyWithAttributes(
    indices, positions, 3, values, attributes, [...weights], null, target, 1,
  );
  writeFileSync(goal, new Uint8Array(left.buffer, left.byteOffset, left.byteLength));
}

/** Writes a GLB with meshopt compression and WebP pictures, the largest `size` texels wide, those of clothes `cloth`. */
async function compress(source, goal, size, quality, cloth) {
  await Promise.all([MeshoptEncoder.ready, MeshoptDecoder.ready]);
  const io = new NodeIO()
    .registerExtensions([EXTMeshoptCompression, EXTTextureWebP, KHRMaterialsVariants, KHRMeshQuantization, KHRTextureTransform])
    .registerDependencies({ "meshopt.encoder": MeshoptEncoder, "meshopt.decoder": MeshoptDecoder });
  const document = (await io.read(source)).setLogger(new Logger(Logger.Verbosity.ERROR));
  for (const accessor of document.getRoot().listAccessors()) accessor.setSparse(false);
  const pictures = (pattern, widest) => textureCompress({
    encoder: sharp, targetFormat: "webp", quality: Number(quality), effort: 90, pattern, resize: [Number(widest), Number(widest)],
  });
  await document.transform(
    pictures(/^outfit/, cloth),
    pictures(/^(?!outfit)/, size),
    meshopt({ // one volume for all meshes, or face and body part at the neck by a step of their grids
      encoder: MeshoptEncoder, level: "medium", quantizationVolume: "scene", quantizePosition: 15, quantizeNormal: 8,
      quantizeTexcoord: 13, quantizeColor: 8,
    }),
  );
  await io.write(goal, document);
}

/** Prints the number of errors that Khronos' validator finds in each file, and fails if there is one. */
async function validate(...files) {
  if (!files.length) throw new Error("no file to validate; name one or more: node levels.mjs validate FILE...");
  const { validateBytes } = (await import("gltf-validator")).default;
  for (const file of files) {
    const { issues } = await validateBytes(new Uint8Array(readFileSync(file)));
    console.log(`${file}: ${issues.numErrors} errors, ${issues.numWarnings} warnings`);
    for (const { severity, code, message } of issues.messages) if (severity < 2) console.log(severity, code, message);
    if (issues.numErrors) process.exitCode = 1;
  }
}

const [step, ...rest] = process.argv.slice(2);
await { simplify, compress, validate }[step](...rest);
