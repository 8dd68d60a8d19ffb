/** How directions come onto a canvas: seen from inside the sphere, or flat. Pixels from the top left corner. */

import { azimuthOf, direction, elevationOf, unit, type Vector } from "./rotation";

export type Point = readonly [number, number];

export interface Projection {
  width: number;
  height: number;
  /** Where a direction of the view's frame lies, or null if it is behind the eye. It may lie outside of the canvas. */
  project(d: Vector): Point | null;
  unproject(at: Point): Vector;
  /** The columns after which a line continues at the other edge; null if there is no seam. */
  seam: number | null;
}

/** A perspective view along x; `field` is the vertical angle in radians. */
export function perspective(width: number, height: number, field: number): Projection {
  const focal = height / 2 / Math.tan(field / 2);
  return {
    width,
    height,
    seam: null,
    project(d) {
      if (d[0] < 0.02) return null;
      return [width / 2 - (focal * d[1]) / d[0], height / 2 - (focal * d[2]) / d[0]];
    },
    unproject([x, y]) {
      return unit([focal, width / 2 - x, height / 2 - y]);
    },
  };
}

/** The whole sphere as a panorama. */
export function flat(width: number, height: number): Projection {
  return {
    width,
    height,
    seam: width,
    project(d) {
      return [(0.5 - azimuthOf(d) / (2 * Math.PI)) * width, (0.5 - elevationOf(d) / Math.PI) * height];
    },
    unproject([x, y]) {
      return direction((0.5 - x / width) * 2 * Math.PI, (0.5 - y / height) * Math.PI);
    },
  };
}

/**
 * The yaw and pitch with which `grabbed` (frame of the base) lies at `at`, or as near as an upright view allows.
 *
 * base_R_view = Rz(yaw) Ry(-pitch): the ray `r` of the pixel has to end at the elevation of `grabbed`.
 */
export function lookThatHolds(grabbed: Vector, ray: Vector, most: number): { yaw: number; pitch: number } {
  // z of the turned ray: r_x sin(pitch) + r_z cos(pitch) = |(r_x, r_z)| sin(pitch + atan2(r_z, r_x)).
  const length = Math.hypot(ray[0], ray[2]);
  const share = Math.max(-1, Math.min(1, grabbed[2] / length));
  const pitch = Math.max(-most, Math.min(most, Math.asin(share) - Math.atan2(ray[2], ray[0])));
  const forward = ray[0] * Math.cos(pitch) - ray[2] * Math.sin(pitch);
  return { yaw: azimuthOf(grabbed) - Math.atan2(ray[1], forward), pitch };
}
