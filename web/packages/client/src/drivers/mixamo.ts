/** Maps VRM humanoid bone names to those of Mixamo rigs, without the rig's prefix. */

const BODY: Record<string, string> = {
  hips: "Hips", spine: "Spine", chest: "Spine1", upperChest: "Spine2", neck: "Neck", head: "Head",
};
const LIMBS: Record<string, string> = {
  Shoulder: "Shoulder", UpperArm: "Arm", LowerArm: "ForeArm", Hand: "Hand",
  UpperLeg: "UpLeg", LowerLeg: "Leg", Foot: "Foot", Toes: "ToeBase",
};
const FINGERS: Record<string, string> = {
  Thumb: "Thumb", Index: "Index", Middle: "Middle", Ring: "Ring", Little: "Pinky",
};
const SEGMENTS: Record<string, number> = { Metacarpal: 1, Proximal: 1, Intermediate: 2, Distal: 3 };

/** `leftIndexProximal` becomes `LeftHandIndex1`; empty for bones that Mixamo rigs lack. */
export function mixamoName(name: string): string {
  if (BODY[name]) return BODY[name];
  const side = name.startsWith("left") ? "Left" : name.startsWith("right") ? "Right" : "";
  const rest = name.slice(side.length);
  if (!side) return "";
  if (LIMBS[rest]) return side + LIMBS[rest];
  const [, finger, segment] = /^(Thumb|Index|Middle|Ring|Little)(\w+)$/.exec(rest) ?? [];
  if (!finger || !segment || !SEGMENTS[segment]) return "";
  const number = SEGMENTS[segment] + (finger === "Thumb" && segment !== "Metacarpal" ? 1 : 0);
  return `${side}Hand${FINGERS[finger]}${finger === "Thumb" && segment === "Distal" ? 3 : number}`;
}
