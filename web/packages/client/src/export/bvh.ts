/** Writes BVH: centimetres, rotation channels Z Y X, like the Python writer. */

import type { Rig } from "../protocol.generated.js";
import type { Take } from "./take.js";

const UNITS = 100;
const TIP = 0.03; // metres: length of a bone without children

export function toBvh(take: Take): string {
  const order: number[] = [];
  const lines = ["HIERARCHY", ...joint(take.rig, take.rig.parents.indexOf(-1), 0, order), "MOTION"];
  lines.push(`Frames: ${take.frames.length}`, `Frame Time: ${(1 / take.rate).toFixed(9)}`);
  const tracks = order.map((index) => angles(take.joint(index)));
  take.frames.forEach(({ root }, t) => {
    const row = [...root].map((x) => x * UNITS);
    for (const track of tracks) row.push(...track[t]!);
    lines.push(row.map((x) => x.toFixed(5)).join(" "));
  });
  return `${lines.join("\n")}\n`;
}

/** The hierarchy lines of a joint and its descendants; appends their indices to `order`. */
function joint(rig: Rig, index: number, depth: number, order: number[]): string[] {
  order.push(index);
  const indent = "\t".repeat(depth);
  const isRoot = rig.parents[index] === -1;
  const offset = (isRoot ? [0, 0, 0] : rig.rest[index]!).map((x) => (x * UNITS).toFixed(5)).join(" ");
  const channels = isRoot ? "6 Xposition Yposition Zposition" : "3";
  const children = rig.parents.flatMap((parent, child) => (parent === index ? [child] : []));
  const below = children.flatMap((child) => joint(rig, child, depth + 1, order));
  const tip = [`${indent}\tEnd Site`, `${indent}\t{`, `${indent}\t\tOFFSET 0 ${(TIP * UNITS).toFixed(5)} 0`, `${indent}\t}`];
  return [
    `${indent}${isRoot ? "ROOT" : "JOINT"} ${rig.names[index]}`,
    `${indent}{`,
    `${indent}\tOFFSET ${offset}`,
    `${indent}\tCHANNELS ${channels} Zrotation Yrotation Xrotation`,
    ...(below.length ? below : tip),
    `${indent}}`,
  ];
}

/** Euler angles in degrees about Z, Y, X per frame, q = Rz Ry Rx, unwrapped so that they do not jump at 180. */
export function angles(track: Float32Array): [number, number, number][] {
  const out: [number, number, number][] = [];
  for (let t = 0; t * 4 < track.length; t++) {
    const [x, y, z, w] = track.subarray(t * 4, t * 4 + 4) as unknown as [number, number, number, number];
    const sine = Math.max(-1, Math.min(1, 2 * (w * y - x * z)));
    const found = [
      Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
      Math.asin(sine),
      Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
    ].map((angle, k) => near((angle * 180) / Math.PI, out[t - 1]?.[k]));
    out.push(found as [number, number, number]);
  }
  return out;
}

function near(angle: number, last: number | undefined): number {
  return last === undefined ? angle : angle - 360 * Math.round((angle - last) / 360);
}
