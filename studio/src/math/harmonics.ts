/**
 * Real spherical harmonics: orthonormal, no Condon-Shortley phase, index l*l + l + m, m < 0 the sine.
 *
 * The same basis as `eagor.RealHarmonics`; tests compare the two. A field on a grid of elevations and azimuths is
 * evaluated in two steps: first the latitude part for each order, then the Fourier sum along each row.
 */

import type { Vector } from "./rotation";

interface Recursion {
  start: Float64Array; // Q_mm, with the sqrt 2 of the real basis
  a: Float64Array[]; // a_lm and b_lm of Q_lm = a_lm (z Q_l-1,m - b_lm Q_l-2,m)
  b: Float64Array[];
}

const recursions = new Map<number, Recursion>();

function recursion(degree: number): Recursion {
  const known = recursions.get(degree);
  if (known) return known;
  const start = new Float64Array(degree + 1);
  start[0] = 1 / Math.sqrt(4 * Math.PI);
  for (let m = 1; m <= degree; m++)
    start[m] = start[m - 1] * Math.sqrt((2 * m + 1) / (2 * m)) * (m === 1 ? Math.SQRT2 : 1);
  const a: Float64Array[] = [];
  const b: Float64Array[] = [];
  for (let l = 0; l <= degree; l++) {
    a.push(new Float64Array(l + 1));
    b.push(new Float64Array(l + 1));
    for (let m = 0; m < l; m++) {
      a[l][m] = Math.sqrt((4 * l * l - 1) / (l * l - m * m));
      if (m < l - 1) b[l][m] = Math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1));
    }
  }
  const made = { start, a, b };
  recursions.set(degree, made);
  return made;
}

export function sizeOf(degree: number): number {
  return (degree + 1) ** 2;
}

/** Reduced Legendre functions Q_lm(z) without cos(elevation)^m: `out[l * (degree + 1) + m]`. */
function reduced(degree: number, z: number, out: Float64Array): void {
  const { start, a, b } = recursion(degree);
  const wide = degree + 1;
  for (let l = 0; l <= degree; l++) {
    for (let m = 0; m < l; m++) {
      const below = z * out[(l - 1) * wide + m] - (m < l - 1 ? b[l][m] * out[(l - 2) * wide + m] : 0);
      out[l * wide + m] = a[l][m] * below;
    }
    out[l * wide + l] = start[l];
  }
}

/** All (degree + 1)^2 harmonics at one direction. */
export function evaluate(degree: number, d: Vector): Float64Array {
  const wide = degree + 1;
  const table = new Float64Array(wide * wide);
  reduced(degree, d[2], table);
  const out = new Float64Array(sizeOf(degree));
  let [cosine, sine] = [1, 0];
  for (let m = 0; m <= degree; m++) {
    for (let l = m; l <= degree; l++) {
      out[l * l + l + m] = table[l * wide + m] * cosine;
      if (m > 0) out[l * l + l - m] = table[l * wide + m] * sine;
    }
    [cosine, sine] = [cosine * d[0] - sine * d[1], sine * d[0] + cosine * d[1]];
  }
  return out;
}

/** Rows at these elevations, columns at these azimuths; the layout of a panorama if they fall from left and top. */
export interface Lattice {
  elevations: Float64Array;
  azimuths: Float64Array;
}

/** A lattice of the cells' centres of a panorama of `rows` rows, in the layout of docs/conventions.md. */
export function whole(rows: number): Lattice {
  return patch(rows, 2 * rows, Math.PI, -Math.PI, Math.PI / 2, -Math.PI / 2);
}

/** A lattice of cells' centres between two azimuths (left first) and two elevations (top first). */
export function patch(
  rows: number, columns: number, left: number, right: number, top: number, bottom: number,
): Lattice {
  return {
    elevations: Float64Array.from({ length: rows }, (_, i) => top + ((bottom - top) * (i + 0.5)) / rows),
    azimuths: Float64Array.from({ length: columns }, (_, j) => left + ((right - left) * (j + 0.5)) / columns),
  };
}

interface Tables {
  latitude: Float32Array; // [row][coefficient], with cos(elevation)^|m|
  cosines: Float32Array; // [order][column]
  sines: Float32Array;
}

// Tables are kept for the lattices in use: those of the whole sphere for ever, those of patches for a while.
const kept = new WeakMap<Lattice, Map<number, Tables>>();

function tables(degree: number, lattice: Lattice): Tables {
  let byDegree = kept.get(lattice);
  if (!byDegree) kept.set(lattice, (byDegree = new Map()));
  const known = byDegree.get(degree);
  if (known) return known;
  const [rows, columns, size, wide] = [
    lattice.elevations.length, lattice.azimuths.length, sizeOf(degree), degree + 1,
  ];
  const latitude = new Float32Array(rows * size);
  const table = new Float64Array(wide * wide);
  for (let i = 0; i < rows; i++) {
    reduced(degree, Math.sin(lattice.elevations[i]), table);
    const level = Math.cos(lattice.elevations[i]);
    for (let l = 0; l <= degree; l++)
      for (let m = 0; m <= l; m++) {
        const value = table[l * wide + m] * level ** m;
        latitude[i * size + l * l + l + m] = value;
        latitude[i * size + l * l + l - m] = value;
      }
  }
  const cosines = new Float32Array(wide * columns);
  const sines = new Float32Array(wide * columns);
  for (let m = 0; m <= degree; m++)
    for (let j = 0; j < columns; j++) {
      cosines[m * columns + j] = Math.cos(m * lattice.azimuths[j]);
      sines[m * columns + j] = Math.sin(m * lattice.azimuths[j]);
    }
  const made = { latitude, cosines, sines };
  byDegree.set(degree, made);
  return made;
}

/** The field of `coefficients` on a lattice: `out[row * columns + column]`. */
export function synthesise(
  degree: number, coefficients: ArrayLike<number>, lattice: Lattice, out?: Float32Array,
): Float32Array {
  const { latitude, cosines, sines } = tables(degree, lattice);
  const [rows, columns, size] = [lattice.elevations.length, lattice.azimuths.length, sizeOf(degree)];
  const field = out ?? new Float32Array(rows * columns);
  for (let i = 0; i < rows; i++) {
    const base = i * size;
    const row = field.subarray(i * columns, (i + 1) * columns);
    for (let m = 0; m <= degree; m++) {
      let [even, odd] = [0, 0];
      for (let l = m; l <= degree; l++) {
        const centre = l * l + l;
        const value = latitude[base + centre + m];
        even += coefficients[centre + m] * value;
        if (m > 0) odd += coefficients[centre - m] * value;
      }
      if (m === 0) row.fill(even);
      else {
        const start = m * columns;
        for (let j = 0; j < columns; j++) row[j] += even * cosines[start + j] + odd * sines[start + j];
      }
    }
  }
  return field;
}
