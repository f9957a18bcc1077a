/** Surfaces and faces for WebGL that runs on the processor, where pixels and vertex shaders are what costs. */

import type { StageLight } from "@echoavatar/client/three";
import { TONE_GLSL } from "@echoavatar/client/three";
import {
  BufferAttribute, type BufferGeometry, Color, LinearMipmapNearestFilter, type Material, Matrix3, type Mesh,
  MeshLambertMaterial, type MeshStandardMaterial, NoColorSpace, type Object3D, ShaderMaterial,
} from "three";

const VERTEX = `
  #include <common>
  #include <skinning_pars_vertex>
  uniform vec3 keyAt; uniform vec3 key; uniform vec3 rimAt; uniform vec3 rim; uniform vec3 sky; uniform vec3 ground;
  uniform vec3 tint; uniform mat3 place;
  varying vec3 lit; varying vec2 at;
  void main() {
    vec3 objectNormal = normal;
    vec3 transformed = position;
    #include <skinbase_vertex>
    #include <skinnormal_vertex>
    #include <skinning_vertex>
    vec3 n = normalize(mat3(modelMatrix) * objectNormal);
    lit = mix(ground, sky, 0.5 * n.y + 0.5) + max(dot(n, keyAt), 0.0) * key + max(dot(n, rimAt), 0.0) * rim;
    lit *= tint;
    #ifdef USE_COLOR
      lit *= color.rgb;
    #endif
    #ifdef MAPPED
      at = (place * vec3(uv, 1.0)).xy;
    #endif
    gl_Position = projectionMatrix * modelViewMatrix * vec4(transformed, 1.0);
  }`;

// Fits of the sRGB curves that need no power function.
const FRAGMENT = `
  uniform sampler2D map; uniform float cut;
  varying vec3 lit; varying vec2 at;
  ${TONE_GLSL}
  void main() {
    vec3 x = lit;
    #ifdef MAPPED
      vec4 texel = texture2D(map, at);
      if (texel.a < cut) discard;
      x *= texel.rgb * (texel.rgb * (texel.rgb * 0.305306011 + 0.682171111) + 0.012522878);
    #endif
    x = filmTone(x);
    vec3 root = sqrt(x);
    vec3 fourth = sqrt(root);
    gl_FragColor = vec4(0.662002687 * root + 0.684122060 * fourth - 0.323583601 * sqrt(fourth) - 0.0225411470 * x, 1.0);
  }`;

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
    defines: map ? { MAPPED: "" } : {},
    uniforms: {
      ...light.uniforms,
      tint: { value: new Color().copy(color) },
      place: { value: map?.matrix ?? new Matrix3() },
      map: { value: map },
      cut: { value: alphaTest },
    },
  });
}

/** One morph target's vertices that move, and how far: position and normal. */
interface Target {
  readonly at: Uint32Array;
  readonly by: Float32Array;
}

interface Face {
  readonly influences: readonly number[];
  readonly applied: Float32Array;
  readonly targets: readonly Target[];
  readonly rest: readonly [position: Float32Array, normal: Float32Array];
  readonly position: BufferAttribute;
  readonly normal: BufferAttribute;
}

/** Applies morph targets before vertices are sent: only the targets in use, only the vertices that they move. */
export class FaceMorphs {
  private readonly faces: Face[] = [];

  /** Takes the targets away from the model's meshes; their influences stay where drivers write them. */
  constructor(model: Object3D) {
    model.traverse((node) => {
      const { geometry, morphTargetInfluences } = node as Mesh;
      if (geometry?.morphAttributes.position && geometry.morphTargetsRelative && morphTargetInfluences)
        this.faces.push(take(geometry, morphTargetInfluences));
    });
  }

  /** Call once per picture, after influences were set. */
  update(): void {
    for (const { influences, applied, targets, rest, position, normal } of this.faces) {
      if (applied.every((value, k) => value === influences[k])) continue;
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
}

type Attribute = BufferGeometry["attributes"][string];

function take(geometry: BufferGeometry, influences: readonly number[]): Face {
  const { position: places = [], normal: normals = [] } = geometry.morphAttributes;
  const rest = [floats(geometry.attributes["position"]!), floats(geometry.attributes["normal"]!)] as const;
  const [position, normal] = rest.map((values) => new BufferAttribute(values.slice(), 3)) as [BufferAttribute, BufferAttribute];
  geometry.setAttribute("position", position).setAttribute("normal", normal);
  const targets = places.map((place, k) => target(floats(place), normals[k] && floats(normals[k])));
  geometry.morphAttributes = {};
  return { influences, applied: new Float32Array(influences.length), targets, rest, position, normal };
}

function target(places: Float32Array, normals?: Float32Array): Target {
  const at: number[] = [];
  const by: number[] = [];
  for (let vertex = 0; 3 * vertex < places.length; vertex++) {
    const [place, normal] = [places, normals].map((of) => of?.subarray(3 * vertex, 3 * vertex + 3) ?? [0, 0, 0]);
    if (![...place!, ...normal!].some(Boolean)) continue;
    at.push(vertex);
    by.push(...place!, ...normal!);
  }
  return { at: Uint32Array.from(at), by: Float32Array.from(by) };
}

/** The attribute's three components, whatever they are stored as. */
function floats(attribute: Attribute): Float32Array {
  const out = new Float32Array(3 * attribute.count);
  for (let k = 0; k < attribute.count; k++) out.set([attribute.getX(k), attribute.getY(k), attribute.getZ(k)], 3 * k);
  return out;
}
