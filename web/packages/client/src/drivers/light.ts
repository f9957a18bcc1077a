/** The light of the film for pages: key light with shadow, light from behind, sky and ground, and the film's tone curve. */

import {
  CircleGeometry, Color, CustomToneMapping, DataTexture, DirectionalLight, EquirectangularReflectionMapping, FloatType,
  Group, HemisphereLight, type Material, Mesh, MeshPhysicalMaterial, MeshStandardMaterial, type Object3D, PCFShadowMap,
  PMREMGenerator, type Scene, ShaderChunk, ShaderMaterial, ShadowMaterial, Texture, Vector3, Vector4, type WebGLRenderer,
} from "three";
import { STAGES, type Stage, TONE, type Triple } from "./stages.generated.js";

export { STAGES, type Stage } from "./stages.generated.js";
export type StageName = keyof typeof STAGES;

const REACH_M = 1.35; // half the side of the square that holds the body and its shadow, seen from the key light
const FADE_M = 2.6; // from the body, where its shadow on the floor is gone
const SOFTBOXES = [{ spread: 0.2, strength: 2.2 }, { spread: 0.16, strength: 2 }] as const; // of key light and rim
const FEET = /(left|right).?(foot|toes|toebase)$/i;

/** Light that follows a body; add it to a scene once. Low quality has no shadow map and no environment. */
export class StageLight {
  readonly object = new Group();
  private readonly key = new DirectionalLight();
  private readonly rim = new DirectionalLight();
  private readonly around = new HemisphereLight();
  private readonly floor = new Mesh(new CircleGeometry(FADE_M, 48), new ShadowMaterial());
  private readonly contact = new ContactShadow();
  private readonly environments = new Map<Stage, Texture>();
  /** The same light for a shader of one's own: directions in the world, colours that a white matte surface reflects. */
  readonly uniforms = Object.fromEntries(
    ["keyAt", "key", "rimAt", "rim", "sky", "ground"].map((name) => [name, { value: new Vector3() }]),
  ) as Record<"keyAt" | "key" | "rimAt" | "rim" | "sky" | "ground", { value: Vector3 }>;

  constructor(private readonly scene: Scene, private readonly renderer: WebGLRenderer, private readonly low: boolean) {
    useFilmTone(renderer);
    renderer.shadowMap.enabled = !low;
    renderer.shadowMap.type = PCFShadowMap;
    const { key, rim, floor, contact } = this;
    key.castShadow = !low;
    key.shadow.mapSize.setScalar(1024);
    Object.assign(key.shadow.camera, { left: -REACH_M, right: REACH_M, top: REACH_M, bottom: -REACH_M, near: 0.5, far: 9 });
    Object.assign(key.shadow, { bias: -0.0004, normalBias: 0.012, radius: 3 }); // a much wider one is seen as grain
    floor.rotation.x = -Math.PI / 2;
    floor.receiveShadow = true;
    floor.visible = !low;
    this.object.add(key, key.target, rim, rim.target, floor, contact.mesh);
    if (low) this.object.add(this.around);
    scene.add(this.object);
    this.set("studio");
  }

  set(name: StageName): void {
    const stage: Stage = STAGES[name];
    const { key, rim, around, low } = this;
    for (const [light, colour, direction] of [[key, stage.key, stage.direction], [rim, stage.rim, stage.behind]] as const) {
      light.color.setRGB(...colour);
      light.intensity = Math.PI; // a surface reflects light / pi
      light.position.set(...direction).multiplyScalar(4.5).y += 0.7;
      light.target.position.set(0, 0.7, 0);
    }
    const { uniforms } = this;
    uniforms.keyAt.value.set(...stage.direction);
    uniforms.rimAt.value.set(...stage.behind);
    for (const name of ["key", "rim", "sky", "ground"] as const) uniforms[name].value.set(...stage[name]);
    around.color.setRGB(...stage.sky);
    around.groundColor.setRGB(...stage.ground);
    around.intensity = Math.PI;
    this.floor.material.opacity = stage.shadow[0];
    this.contact.strength = stage.shadow[1];
    if (!low) this.scene.environment = this.environment(stage);
  }

  /** Moves light and shadow to where a body is. */
  follow(x: number, z: number): void {
    this.object.position.set(x, 0, z);
  }

  /** The body whose feet darken the floor; null is none. */
  stand(body: Object3D | null): void {
    this.contact.stand(body);
  }

  /** Call before each picture, after the body was posed. */
  update(): void {
    this.contact.update();
  }

  private environment(stage: Stage): Texture {
    const known = this.environments.get(stage);
    if (known) return known;
    const generator = new PMREMGenerator(this.renderer);
    const painted = paintEnvironment(stage);
    const { texture } = generator.fromEquirectangular(painted);
    painted.dispose();
    generator.dispose();
    this.environments.set(stage, texture);
    return texture;
  }
}

const [A, B, C, D, E] = TONE.map((value) => value.toFixed(3));
/** The film's tone curve: `vec3 filmTone(vec3)`, from linear light to linear light within 0 and 1. */
export const TONE_GLSL = `vec3 filmTone( vec3 x ) { return clamp( x * ( ${A} * x + ${B} ) / ( x * ( ${C} * x + ${D} ) + ${E} ), 0.0, 1.0 ); }`;

/** The film's tone curve in place of three's custom one. */
export function useFilmTone(renderer: WebGLRenderer): void {
  const own = TONE_GLSL.replace("filmTone", "CustomToneMapping");
  ShaderChunk.tonemapping_pars_fragment = ShaderChunk.tonemapping_pars_fragment.replace(
    "vec3 CustomToneMapping( vec3 color ) { return color; }", own);
  renderer.toneMapping = CustomToneMapping;
}

/**
 * The surface of hair cards (those with an alpha cut) as the film has it: with soft edges, and without reflections, which
 * at grazing angles take the light from behind for the colour of hair. Others are returned as they are.
 */
export function filmHair(material: Material): Material {
  const { isMeshStandardMaterial, alphaTest } = material as MeshStandardMaterial;
  if (!isMeshStandardMaterial || !alphaTest) return material;
  const hair = new MeshPhysicalMaterial();
  const { defines } = hair;
  MeshStandardMaterial.prototype.copy.call(hair, material as MeshStandardMaterial);
  return Object.assign(hair, { defines, specularIntensity: 0, alphaToCoverage: true });
}

/**
 * The stage as seen from its middle, in linear light: sky over ground, so that diffuse surfaces get what a hemisphere
 * light gives them, and two softboxes for reflections.
 */
export function paintEnvironment(stage: Stage, height = 64): DataTexture {
  const width = 2 * height;
  const pixels = new Float32Array(4 * width * height);
  const boxes = [{ at: stage.direction, colour: stage.key }, { at: stage.behind, colour: stage.rim }];
  for (let row = 0; row < height; row++) {
    const up = Math.sin(((row + 0.5) / height - 0.5) * Math.PI); // the lowest row comes first
    const across = Math.sqrt(1 - up * up);
    for (let column = 0; column < width; column++) {
      const turn = ((column + 0.5) / width - 0.5) * 2 * Math.PI;
      const ray: Triple = [across * Math.cos(turn), up, across * Math.sin(turn)];
      const at = 4 * (row * width + column);
      for (let channel = 0; channel < 3; channel++) {
        const [sky, ground] = [stage.sky[channel]!, stage.ground[channel]!];
        let light = (sky + ground) / 2 + 0.75 * (sky - ground) * up; // 1.5: a cosine lobe sees two thirds of a slope
        boxes.forEach(({ at: [x, y, z], colour }, k) => {
          const { spread, strength } = SOFTBOXES[k]!;
          const angle = Math.acos(Math.min(1, ray[0] * x + ray[1] * y + ray[2] * z));
          light += strength * colour[channel]! * smooth(spread * 1.4, spread * 0.7, angle);
        });
        pixels[at + channel] = light;
      }
      pixels[at + 3] = 1;
    }
  }
  const texture = new DataTexture(pixels, width, height);
  Object.assign(texture, { type: FloatType, mapping: EquirectangularReflectionMapping, needsUpdate: true });
  return texture;
}

function smooth(from: number, to: number, value: number): number {
  const t = Math.min(1, Math.max(0, (value - from) / (to - from)));
  return t * t * (3 - 2 * t);
}

/** A soft shadow where feet are near the floor: ambient occlusion between the two, at the price of one small plane. */
class ContactShadow {
  readonly mesh: Mesh<CircleGeometry, ShaderMaterial>;
  private feet: readonly Object3D[] = [];
  private readonly spots = [0, 1, 2, 3].map(() => new Vector4(0, 0, 0, 0)); // x, z, strength
  private readonly place = new Vector3();

  constructor() {
    const material = new ShaderMaterial({
      transparent: true,
      depthWrite: false,
      uniforms: { spots: { value: this.spots }, strength: { value: 0.45 }, tint: { value: new Color(0) } },
      vertexShader: "varying vec2 at; void main() { vec4 w = modelMatrix * vec4(position, 1.0); at = w.xz; gl_Position = projectionMatrix * viewMatrix * w; }",
      fragmentShader: `
        uniform vec4 spots[4]; uniform float strength; uniform vec3 tint; varying vec2 at;
        void main() {
          float clear = 1.0;
          for (int k = 0; k < 4; k++) {
            vec2 d = at - spots[k].xy;
            clear *= 1.0 - spots[k].z * exp(-dot(d, d) / 0.0115);
          }
          gl_FragColor = vec4(tint, (1.0 - clear) * strength);
        }`,
    });
    this.mesh = new Mesh(new CircleGeometry(0.85, 32), material);
    this.mesh.rotation.x = -Math.PI / 2;
    this.mesh.position.y = 0.001;
    this.mesh.visible = false;
  }

  set strength(value: number) {
    this.mesh.material.uniforms["strength"]!.value = value;
  }

  stand(body: Object3D | null): void {
    const feet: Object3D[] = [];
    body?.traverse((node) => FEET.test(node.name) && feet.push(node));
    this.feet = feet.slice(0, this.spots.length);
    this.mesh.visible = feet.length > 0;
  }

  update(): void {
    this.spots.forEach((spot, k) => {
      const foot = this.feet[k];
      if (!foot) return spot.setZ(0);
      const { x, y, z } = foot.getWorldPosition(this.place);
      const near = Math.max(0, 1 - Math.max(0, y - 0.06) / 0.35); // a foot's joint stands some centimetres high
      return spot.set(x, z, 0.85 * near * near, 0);
    });
  }
}
