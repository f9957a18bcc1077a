/** The backdrop: a soft wall and floor behind the avatar, and rings on the floor that follow the sound's level. */

import { STAGES, type StageName } from "@echoavatar/client/three";
import {
  Color, DataTexture, FloatType, Mesh, NearestFilter, NormalBlending, PlaneGeometry, RedFormat, ShaderMaterial, Vector3,
} from "three";

const RINGS = { light: "#2b6f78", dark: "#7fd6d4" };
const HISTORY = 128; // past levels that the rings show
const REACH = 3.2; // metres
const SPEED = 1.7; // metres per second

/** A full-screen gradient like the film's, drawn first; part of the canvas, so recordings contain it. */
export class Backdrop {
  readonly mesh: Mesh<PlaneGeometry, ShaderMaterial>;

  constructor() {
    const colour = () => ({ value: new Vector3() });
    const material = new ShaderMaterial({
      depthTest: false,
      depthWrite: false,
      uniforms: { wall: colour(), horizon: colour(), ground: colour() },
      vertexShader: `
        uniform vec3 wall; uniform vec3 horizon; uniform vec3 ground; varying vec3 colour;
        void main() {
          float y = 0.5 - 0.5 * position.y;
          colour = mix(mix(wall, horizon, smoothstep(0.0, 0.62, y)), ground, smoothstep(0.62, 1.0, y));
          colour *= 1.0 - (wall == ground ? 0.0 : 0.1) * position.x * position.x;
          gl_Position = vec4(position.xy, 1.0, 1.0);
        }`,
      fragmentShader: `
        varying vec3 colour;
        float noise(vec2 p) { return fract(52.9829189 * fract(dot(p, vec2(0.06711056, 0.00583715)))); }
        void main() { // the noise is under a step of the display: without, a slow gradient shows bands
          gl_FragColor = vec4(colour + (noise(gl_FragCoord.xy) - 0.5) / 255.0, 1.0);
        }`,
    });
    this.mesh = new Mesh(new PlaneGeometry(2, 2, 8, 16), material); // colours at vertices cost little
    this.mesh.renderOrder = -10;
    this.mesh.frustumCulled = false;
    this.set("studio");
  }

  set(name: StageName): void {
    const { top, horizon, bottom } = STAGES[name];
    const { uniforms } = this.mesh.material;
    uniforms["wall"]!.value.set(...top);
    uniforms["horizon"]!.value.set(...horizon);
    uniforms["ground"]!.value.set(...bottom);
  }
}

/** Floor rings: the current level starts at the feet and moves outwards. */
export class Echoes {
  readonly mesh: Mesh<PlaneGeometry, ShaderMaterial>;
  private readonly levels = new Float32Array(HISTORY);
  private readonly texture: DataTexture;
  private travelled = 0;

  constructor() {
    this.texture = new DataTexture(this.levels, HISTORY, 1, RedFormat, FloatType);
    this.texture.minFilter = this.texture.magFilter = NearestFilter;
    const material = new ShaderMaterial({
      transparent: true,
      depthWrite: false,
      blending: NormalBlending,
      uniforms: { levels: { value: this.texture }, colour: { value: new Color() }, part: { value: 0 }, strength: { value: 1 } },
      vertexShader: "varying vec2 at; void main() { at = position.xy; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
      fragmentShader: `
        uniform sampler2D levels; uniform vec3 colour; uniform float part; uniform float strength; varying vec2 at;
        float level(float i) { return texture2D(levels, vec2((i + 0.5) / ${HISTORY}.0, 0.5)).r; }
        void main() {
          float r = length(at);
          float place = r / ${REACH.toFixed(1)} * ${HISTORY - 2}.0 - part;
          float i = floor(max(place, 0.0));
          float heard = mix(level(i), level(i + 1.0), max(place, 0.0) - i);
          float fade = smoothstep(${REACH.toFixed(1)}, 0.5, r) * smoothstep(0.26, 0.46, r);
          float line = 1.0 - smoothstep(0.0, fwidth(r) * 1.5, abs(r - 0.75));
          gl_FragColor = vec4(colour, clamp(heard * fade * 0.5 * strength + line * 0.22, 0.0, 0.6));
        }`,
    });
    this.mesh = new Mesh(new PlaneGeometry(2 * REACH, 2 * REACH), material);
    this.mesh.rotation.x = -Math.PI / 2;
    this.mesh.position.y = 0.002;
    this.setTheme(false);
  }

  setTheme(dark: boolean): void {
    const { uniforms } = this.mesh.material;
    uniforms["colour"]!.value.set(dark ? RINGS.dark : RINGS.light).convertLinearToSRGB();
    uniforms["strength"]!.value = dark ? 1 : 0.7;
  }

  /** `level` is the loudness heard now, 0 to 1. */
  advance(level: number, seconds: number): void {
    const step = REACH / (HISTORY - 2);
    this.travelled += (Math.min(seconds, 0.2) * SPEED) / step;
    const whole = Math.floor(this.travelled);
    this.travelled -= whole;
    if (whole) {
      this.levels.copyWithin(whole, 0);
      this.levels.fill(level, 0, whole);
      this.texture.needsUpdate = true;
    }
    this.mesh.material.uniforms["part"]!.value = this.travelled;
  }
}
