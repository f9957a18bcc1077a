export { BoneMap } from "./bones.js";
export { VRM_EXPRESSIONS, toVrm } from "../expressions.js";
export { GlbDriver } from "./glb.js";
export { STAGES, type StageName, StageLight, TONE_GLSL, filmHair, useFilmTone } from "./light.js";
export { loadAvatar } from "./load.js";
export { mixamoName } from "./mixamo.js";
export { MorphMap } from "./morphs.js";
export { type Stage, openStage } from "./stage.js";
export { VrmDriver } from "./vrm.js";
