// What the pages use of three.js, in one file: the live page and the studio's import it, exported pages contain it.
// The bundler leaves out what is not listed here; tests/web/test_three.py finds a name that is missing.
export {
  AmbientLight, AnimationMixer, Box3, BufferAttribute, BufferGeometry, CircleGeometry, Color, ColorManagement,
  CustomToneMapping, DataTexture, DirectionalLight, DynamicDrawUsage, EquirectangularReflectionMapping, FileLoader,
  FloatType, GridHelper, Group, HemisphereLight, InterleavedBuffer, InterleavedBufferAttribute,
  LinearMipmapNearestFilter, LinearSRGBColorSpace, Loader, LoaderUtils, LoadingManager, LoopOnce, Matrix3, Matrix4,
  Mesh, MeshBasicMaterial, MeshLambertMaterial, MeshPhysicalMaterial, MeshStandardMaterial, NearestFilter,
  NoColorSpace, NormalBlending, PCFShadowMap, PMREMGenerator, PerspectiveCamera, PlaneGeometry, Quaternion,
  RedFormat, RingGeometry, SRGBColorSpace, Scene, ShaderChunk, ShaderMaterial, ShadowMaterial, Spherical, Texture,
  Vector3, Vector4, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
export { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
export { VRMLoaderPlugin, VRMUtils } from "@pixiv/three-vrm";
import * as three from "./three.js";

globalThis.echoavatarThree = three; // scripts inside a page cannot import each other
