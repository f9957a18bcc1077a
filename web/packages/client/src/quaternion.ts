/** Quaternions xyzw in flat arrays: the operations that interpolation and blending need. */

/** out[o..] = slerp(a[i..], b[j..], t) along the shorter arc. */
export function slerp(
  a: Float32Array, i: number, b: Float32Array, j: number, t: number, out: Float32Array, o: number,
): void {
  const [ax, ay, az, aw] = [a[i]!, a[i + 1]!, a[i + 2]!, a[i + 3]!];
  let [bx, by, bz, bw] = [b[j]!, b[j + 1]!, b[j + 2]!, b[j + 3]!];
  let cosine = ax * bx + ay * by + az * bz + aw * bw;
  if (cosine < 0) {
    [bx, by, bz, bw, cosine] = [-bx, -by, -bz, -bw, -cosine];
  }
  let [from, to] = [1 - t, t];
  if (cosine < 0.9995) {
    const angle = Math.acos(cosine);
    const sine = Math.sin(angle);
    [from, to] = [Math.sin(from * angle) / sine, Math.sin(to * angle) / sine];
  }
  const [x, y, z, w] = [from * ax + to * bx, from * ay + to * by, from * az + to * bz, from * aw + to * bw];
  const scale = 1 / (Math.hypot(x, y, z, w) || 1);
  out[o] = x * scale;
  out[o + 1] = y * scale;
  out[o + 2] = z * scale;
  out[o + 3] = w * scale;
}

/** The rotation vector v (rad) with exp(v) * b = a, along the shorter arc. */
export function difference(a: Float32Array, i: number, b: Float32Array, j: number, out: Float32Array, o: number): void {
  const [ax, ay, az, aw] = [a[i]!, a[i + 1]!, a[i + 2]!, a[i + 3]!];
  const [bx, by, bz, bw] = [-b[j]!, -b[j + 1]!, -b[j + 2]!, b[j + 3]!];
  let x = aw * bx + ax * bw + ay * bz - az * by;
  let y = aw * by - ax * bz + ay * bw + az * bx;
  let z = aw * bz + ax * by - ay * bx + az * bw;
  let w = aw * bw - ax * bx - ay * by - az * bz;
  if (w < 0) [x, y, z, w] = [-x, -y, -z, -w];
  const sine = Math.hypot(x, y, z);
  const scale = sine < 1e-6 ? 2 : (2 * Math.atan2(sine, w)) / sine;
  out[o] = x * scale;
  out[o + 1] = y * scale;
  out[o + 2] = z * scale;
}

/** q[i..] = exp(scale * v[j..]) * q[i..]. */
export function turn(q: Float32Array, i: number, v: Float32Array, j: number, scale: number): void {
  const [vx, vy, vz] = [v[j]! * scale, v[j + 1]! * scale, v[j + 2]! * scale];
  const angle = Math.hypot(vx, vy, vz);
  if (angle < 1e-7) return;
  const sine = Math.sin(angle / 2) / angle;
  const [ax, ay, az, aw] = [vx * sine, vy * sine, vz * sine, Math.cos(angle / 2)];
  const [bx, by, bz, bw] = [q[i]!, q[i + 1]!, q[i + 2]!, q[i + 3]!];
  q[i] = aw * bx + ax * bw + ay * bz - az * by;
  q[i + 1] = aw * by - ax * bz + ay * bw + az * bx;
  q[i + 2] = aw * bz + ax * by - ay * bx + az * bw;
  q[i + 3] = aw * bw - ax * bx - ay * by - az * bz;
}
