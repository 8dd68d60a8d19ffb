/**
 * Directions and rotations, as in docs/conventions.md: x forward, y left, z up; azimuth positive left, elevation up.
 *
 * A matrix is nine numbers, row by row. Radians.
 */

export type Vector = readonly [number, number, number];
export type Matrix = readonly number[];

export const IDENTITY: Matrix = [1, 0, 0, 0, 1, 0, 0, 0, 1];

export const RADIANS = Math.PI / 180;

export function degrees(radians: number): number {
  return radians / RADIANS;
}

export function direction(azimuth: number, elevation: number): Vector {
  const level = Math.cos(elevation);
  return [level * Math.cos(azimuth), level * Math.sin(azimuth), Math.sin(elevation)];
}

export function azimuthOf(d: Vector): number {
  return Math.atan2(d[1], d[0]);
}

export function elevationOf(d: Vector): number {
  return Math.asin(Math.max(-1, Math.min(1, d[2])));
}

export function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function unit(d: Vector): Vector {
  const length = Math.hypot(d[0], d[1], d[2]) || 1;
  return [d[0] / length, d[1] / length, d[2] / length];
}

/** The angle between two directions. */
export function between(a: Vector, b: Vector): number {
  return Math.acos(Math.max(-1, Math.min(1, dot(a, b))));
}

export function apply(m: Matrix, d: Vector): Vector {
  return [
    m[0] * d[0] + m[1] * d[1] + m[2] * d[2],
    m[3] * d[0] + m[4] * d[1] + m[5] * d[2],
    m[6] * d[0] + m[7] * d[1] + m[8] * d[2],
  ];
}

export function times(a: Matrix, b: Matrix): Matrix {
  const out = new Array<number>(9);
  for (let i = 0; i < 3; i++)
    for (let j = 0; j < 3; j++) out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
  return out;
}

/** The inverse of a rotation. */
export function inverse(m: Matrix): Matrix {
  return [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
}

/** The pose of a view that is turned left by `yaw`, then up by `pitch`, then by `roll`: base_R_view. */
export function pose(yaw: number, pitch: number, roll = 0): Matrix {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  const turned: Matrix = [cy * cp, -sy, -cy * sp, sy * cp, cy, -sy * sp, sp, 0, cp];
  if (roll === 0) return turned;
  const [cr, sr] = [Math.cos(roll), Math.sin(roll)];
  return times(turned, [1, 0, 0, 0, cr, -sr, 0, sr, cr]);
}

/** An angle brought into [-pi, pi). */
export function wrapped(angle: number): number {
  return angle - 2 * Math.PI * Math.floor((angle + Math.PI) / (2 * Math.PI));
}
