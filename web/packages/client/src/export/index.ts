export { toBvh } from "./bvh.js";
export { toGlb } from "./glb.js";
export { Take } from "./take.js";
export { toVrma } from "./vrma.js";
