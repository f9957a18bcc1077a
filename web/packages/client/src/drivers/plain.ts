/** Surfaces and bodies for WebGL that runs on the processor, where pixels and vertex shaders are what costs. */

import {
  BufferAttribute, type BufferGeometry, Color, DataTexture, DynamicDrawUsage, LinearMipmapNearestFilter, type Material,
  Matrix3, Matrix4, Mesh, MeshLambertMaterial, type MeshStandardMaterial, NoColorSpace, type Object3D, ShaderMaterial,
  type SkinnedMesh,
} from "three";
import { type StageLight, TONE_GLSL, filmHair } from "./light.js";

const VERTEX = `
  uniform vec3 keyAt; uniform vec3 key; uniform vec3 rimAt; uniform vec3 rim; uniform vec3 sky; uniform vec3 ground;
  uniform vec3 tint; uniform mat3 place;
  varying vec3 lit; varying vec2 at;
  void main() {
    vec3 n = normalize(mat3(modelMatrix) * normal);
    lit = mix(ground, sky, 0.5 * n.y + 0.5) + max(dot(n, keyAt), 0.0) * key + max(dot(n, rimAt), 0.0) * rim;
    lit *= tint;
    #ifdef USE_COLOR
      lit *= color.rgb;
    #endif
    at = (place * vec3(uv, 1.0)).xy;
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  }`;

// Fits of the sRGB curves that need no power function.
const FRAGMENT = `
  uniform sampler2D map; uniform float cut;
  varying vec3 lit; varying vec2 at;
  ${TONE_GLSL}
  void main() {
    vec4 texel = texture2D(map, at);
    if (texel.a < cut) discard;
    vec3 x = filmTone(lit * texel.rgb * (texel.rgb * (texel.rgb * 0.305306011 + 0.682171111) + 0.012522878));
    vec3 root = sqrt(x);
    vec3 fourth = sqrt(root);
    gl_FragColor = vec4(0.662002687 * root + 0.684122060 * fourth - 0.323583601 * sqrt(fourth) - 0.0225411470 * x, 1.0);
  }`;

/**
 * Gives a body the surfaces of the stage. On the processor (`low`) they are plain, and the body that is returned must be
 * told of each pose; a VRM keeps its own.
 */
export function dress(object: Object3D, light: StageLight, low: boolean, isVrm: boolean): PlainBody | null {
  const isPlain = low && !isVrm;
  const surface = surfaceOf(light, isPlain);
  const body = isPlain ? new PlainBody(object) : null;
  object.traverse((node) => {
    const mesh = node as Mesh;
    if (!mesh.isMesh) return;
    Object.assign(mesh, { castShadow: true, receiveShadow: !low, frustumCulled: false });
    mesh.material = Array.isArray(mesh.material) ? mesh.material.map(surface) : surface(mesh.material);
  });
  body?.update();
  return body;
}

/** What becomes of a file's surface on the stage. */
export function surfaceOf(light: StageLight, isPlain: boolean): (material: Material) => Material {
  return (material) => (isPlain ? plain(material, light) : filmHair(material));
}

/** In place of no texture, so that there is one shader: compiling another costs more than reading it. */
const WHITE = new DataTexture(new Uint8Array([255, 255, 255, 255]));
WHITE.needsUpdate = true;

/** The same surface with matte light at its vertices; one that needs more than that is matte at each pixel. */
export function plain(material: Material, light: StageLight): Material {
  const { isMeshStandardMaterial, map, color, emissive, emissiveMap } = material as MeshStandardMaterial;
  if (!isMeshStandardMaterial) return material;
  const { name, side, alphaTest, transparent, opacity, vertexColors } = material;
  if (transparent || map?.channel || emissiveMap || emissive.getHex())
    return new MeshLambertMaterial({ name, side, alphaTest, transparent, opacity, vertexColors, map, color, emissive, emissiveMap });
  if (map) {
    map.updateMatrix();
    Object.assign(map, { colorSpace: NoColorSpace, minFilter: LinearMipmapNearestFilter });
  }
  return new ShaderMaterial({
    name, side, vertexColors,
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: {
      ...light.uniforms,
      tint: { value: new Color().copy(color) },
      place: { value: map?.matrix ?? new Matrix3() },
      map: { value: map ?? WHITE },
      cut: { value: alphaTest },
    },
  });
}

/** Moves vertices before they are sent: by the morph targets in use, then by the bones. */
export class PlainBody {
  private readonly faces: Face[] = [];
  private readonly skins: Skin[] = [];

  /** Takes targets and skins away from the model's meshes; influences and bones stay where drivers write them. */
  constructor(private readonly model: Object3D) {
    const meshes: Mesh[] = [];
    model.traverse((node) => (node as Mesh).isMesh && meshes.push(node as Mesh));
    for (const mesh of meshes) {
      const { geometry, morphTargetInfluences } = mesh;
      const face = geometry.morphAttributes.position && geometry.morphTargetsRelative && morphTargetInfluences
        ? new Face(geometry, morphTargetInfluences) : null;
      if (face) this.faces.push(face);
      if ((mesh as SkinnedMesh).isSkinnedMesh) this.skins.push(new Skin(mesh as SkinnedMesh, face));
    }
  }

  /** Call once per picture, after influences and bones were set. */
  update(): void {
    for (const face of this.faces) face.update();
    this.model.updateMatrixWorld();
    for (const skin of this.skins) skin.update();
  }
}

/** One morph target's vertices that move, and how far: position and normal. */
interface Target {
  readonly at: Uint32Array;
  readonly by: Float32Array;
}

/** A mesh's vertices, moved by its morph targets: only the targets in use, only the vertices that they move. */
class Face {
  readonly position: BufferAttribute;
  readonly normal: BufferAttribute;
  private readonly rest: readonly [position: Float32Array, normal: Float32Array];
  private readonly applied: Float32Array;
  private readonly targets: readonly Target[];

  constructor(geometry: BufferGeometry, private readonly influences: readonly number[]) {
    const { position: places = [], normal: normals = [] } = geometry.morphAttributes;
    this.rest = [floats(geometry, "position"), floats(geometry, "normal")];
    [this.position, this.normal] = replace(geometry, this.rest[0].slice(), this.rest[1].slice());
    this.applied = new Float32Array(influences.length);
    this.targets = places.map((place, k) => target(components(place), normals[k] ? components(normals[k]) : null));
    geometry.morphAttributes = {};
  }

  update(): void {
    const { influences, applied, targets, rest, position, normal } = this;
    if (applied.every((value, k) => value === influences[k])) return;
    applied.set(influences);
    const [places, normals] = [position.array as Float32Array, normal.array as Float32Array];
    places.set(rest[0]);
    normals.set(rest[1]);
    targets.forEach(({ at, by }, k) => {
      const share = applied[k]!;
      if (!share) return;
      for (let i = 0, from = 0; i < at.length; i++, from += 6) {
        const to = 3 * at[i]!;
        for (let axis = 0; axis < 3; axis++) {
          places[to + axis]! += share * by[from + axis]!;
          normals[to + axis]! += share * by[from + 3 + axis]!;
        }
      }
    });
    position.needsUpdate = normal.needsUpdate = true;
  }
}

/** A skinned mesh, replaced by one whose vertices are in the world. In software GL a skin's shader costs several times more. */
class Skin {
  private readonly rest: readonly [position: Float32Array, normal: Float32Array];
  private readonly position: BufferAttribute;
  private readonly normal: BufferAttribute;
  private readonly bones: Uint16Array; // 4 a vertex
  private readonly shares: Float32Array;
  private readonly turns: Float32Array; // of each bone: 3 rows of 4

  /** Vertices that `face` moves are read where it writes them. */
  constructor(private readonly mesh: SkinnedMesh, face: Face | null) {
    const { geometry, skeleton } = mesh;
    this.bones = Uint16Array.from(components(geometry.getAttribute("skinIndex"), 4));
    this.shares = components(geometry.getAttribute("skinWeight"), 4);
    this.rest = face
      ? [face.position.array as Float32Array, face.normal.array as Float32Array]
      : [floats(geometry, "position"), floats(geometry, "normal")];
    [this.position, this.normal] = replace(geometry, this.rest[0].slice(), this.rest[1].slice());
    this.turns = new Float32Array(12 * skeleton.bones.length);
    for (const name of ["skinIndex", "skinWeight"]) geometry.deleteAttribute(name);
    const drawn = new Mesh(geometry, mesh.material);
    const { name, morphTargetDictionary, morphTargetInfluences } = mesh;
    Object.assign(drawn, { name, morphTargetDictionary, morphTargetInfluences });
    drawn.matrixWorldAutoUpdate = false; // stays the identity
    mesh.parent?.add(drawn);
    mesh.removeFromParent();
  }

  update(): void {
    const { rest: [places, normals], bones, shares, turns, position, normal } = this;
    this.turn();
    const [to, up] = [position.array as Float32Array, normal.array as Float32Array];
    for (let at = 0, four = 0; at < to.length; at += 3, four += 4) {
      const x = places[at]!, y = places[at + 1]!, z = places[at + 2]!;
      const u = normals[at]!, v = normals[at + 1]!, w = normals[at + 2]!;
      for (let row = 0; row < 3; row++) {
        let a = 0, b = 0, c = 0, d = 0;
        for (let k = four; k < four + 4; k++) {
          const share = shares[k]!;
          if (!share) continue;
          const from = 12 * bones[k]! + 4 * row;
          a += share * turns[from]!;
          b += share * turns[from + 1]!;
          c += share * turns[from + 2]!;
          d += share * turns[from + 3]!;
        }
        to[at + row] = a * x + b * y + c * z + d;
        up[at + row] = a * u + b * v + c * w;
      }
    }
    position.needsUpdate = normal.needsUpdate = true;
  }

  /** Where each bone takes a vertex from, to the world. */
  private turn(): void {
    const { mesh: { skeleton, bindMatrix }, turns } = this;
    skeleton.bones.forEach((bone, k) => {
      const { elements } = MATRIX.multiplyMatrices(bone.matrixWorld, skeleton.boneInverses[k]!).multiply(bindMatrix);
      for (let row = 0; row < 3; row++)
        for (let column = 0; column < 4; column++) turns[12 * k + 4 * row + column] = elements[4 * column + row]!;
    });
  }
}

const MATRIX = new Matrix4();

function replace(geometry: BufferGeometry, places: Float32Array, normals: Float32Array): [BufferAttribute, BufferAttribute] {
  const made = [places, normals].map((values) => new BufferAttribute(values, 3).setUsage(DynamicDrawUsage));
  const [position, normal] = made as [BufferAttribute, BufferAttribute];
  geometry.setAttribute("position", position).setAttribute("normal", normal);
  geometry.boundingBox = geometry.boundingSphere = null; // the file's own, of vertices in other units
  return [position, normal];
}

function target(places: Float32Array, normals: Float32Array | null): Target {
  const at: number[] = [];
  const by: number[] = [];
  for (let k = 0; k < places.length; k += 3) {
    const [x, y, z] = [places[k]!, places[k + 1]!, places[k + 2]!];
    const [u, v, w] = normals ? [normals[k]!, normals[k + 1]!, normals[k + 2]!] : [0, 0, 0];
    if (!(x || y || z || u || v || w)) continue;
    at.push(k / 3);
    by.push(x, y, z, u, v, w);
  }
  return { at: Uint32Array.from(at), by: Float32Array.from(by) };
}

type Attribute = BufferGeometry["attributes"][string];

/** An attribute's three components; one that is missing is made (normals) or empty. */
function floats(geometry: BufferGeometry, name: "position" | "normal"): Float32Array {
  if (!geometry.hasAttribute(name)) geometry.computeVertexNormals();
  return components(geometry.getAttribute(name));
}

/** The attribute's components, whatever they are stored as. */
function components(attribute: Attribute, size = 3): Float32Array {
  const out = new Float32Array(size * attribute.count);
  for (let k = 0, to = 0; k < attribute.count; k++) for (let part = 0; part < size; part++) out[to++] = attribute.getComponent(k, part);
  return out;
}
