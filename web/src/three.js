// What the pages use of three.js, in one file: the live page and the studio's import it, exported pages contain it.
// The bundler leaves out what is not listed here; tests/web/test_three.py finds a name that is missing.
export {
  AmbientLight, AnimationMixer, Box3, BufferAttribute, BufferGeometry, CircleGeometry, Color, ColorManagement,
  CompressedArrayTexture, CompressedCubeTexture, CompressedTexture, CustomToneMapping, Data3DTexture, DataTexture,
  DirectionalLight, DynamicDrawUsage, EquirectangularReflectionMapping, FileLoader, FloatType, GridHelper, Group,
  HalfFloatType, HemisphereLight, InterleavedBuffer, InterleavedBufferAttribute, LinearFilter,
  LinearMipmapLinearFilter, LinearMipmapNearestFilter, LinearSRGBColorSpace, LinearTransfer, Loader, LoaderUtils,
  LoadingManager, LoopOnce, Matrix3, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, MeshPhysicalMaterial,
  MeshStandardMaterial, NearestFilter, NearestMipmapNearestFilter, NoColorSpace, NormalBlending, PCFShadowMap,
  PMREMGenerator, PerspectiveCamera, PlaneGeometry, Quaternion, R11_EAC_Format, RED_GREEN_RGTC2_Format,
  RED_RGTC1_Format, RG11_EAC_Format, RGBAFormat, RGBA_ASTC_4x4_Format, RGBA_ASTC_6x6_Format, RGBA_BPTC_Format,
  RGBA_ETC2_EAC_Format, RGBA_PVRTC_2BPPV1_Format, RGBA_PVRTC_4BPPV1_Format, RGBA_S3TC_DXT1_Format,
  RGBA_S3TC_DXT5_Format, RGBFormat, RGB_BPTC_UNSIGNED_Format, RGB_ETC1_Format, RGB_ETC2_Format,
  RGB_PVRTC_4BPPV1_Format, RGB_S3TC_DXT1_Format, RGFormat, RedFormat, RingGeometry, SIGNED_R11_EAC_Format,
  SIGNED_RED_GREEN_RGTC2_Format, SIGNED_RED_RGTC1_Format, SIGNED_RG11_EAC_Format, SRGBColorSpace, SRGBTransfer,
  Scene, ShaderChunk, ShaderMaterial, ShadowMaterial, Spherical, Texture, UnsignedByteType, UnsignedInt101111Type,
  UnsignedInt5999Type, UnsignedShortType, Vector3, Vector4, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
export { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
export { VRMLoaderPlugin, VRMUtils } from "@pixiv/three-vrm";
import * as three from "./three.js";

globalThis.echoavatarThree = three; // scripts inside a page cannot import each other
