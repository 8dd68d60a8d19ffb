/** A belief as the wire carries it: a mixture of exp(harmonics), each of which integrates to 1 over the sphere. */

import { evaluate, sizeOf, synthesise, type Lattice } from "./harmonics";
import { azimuthOf, direction, elevationOf, unit, type Vector } from "./rotation";

export interface Term {
  weight: number;
  degree: number;
  coefficients: Float32Array;
}

export interface Density {
  terms: Term[];
  level: number; // density at the border of the region
  undrawn?: string; // why that border is not drawn
}

const NOTHING = -30; // nats: exp() of less is not worth computing

/** The terms of a blob: the coefficients of all terms, one after another. Throws if it is too short. */
export function termsOf(described: { weight: number; degree: number }[], blob: Float32Array): Term[] {
  let at = 0;
  const terms = described.map(({ weight, degree }) => {
    const coefficients = blob.subarray(at, (at += sizeOf(degree)));
    return { weight, degree, coefficients };
  });
  if (at !== blob.length) throw new Error(`a belief of ${blob.length} coefficients; wanted ${at}`);
  return terms;
}

/** Density per steradian at a unit vector. */
export function densityAt(density: Density, d: Vector): number {
  let total = 0;
  for (const { weight, degree, coefficients } of density.terms) {
    const harmonics = evaluate(degree, d);
    let f = 0;
    for (let i = 0; i < harmonics.length; i++) f += harmonics[i] * coefficients[i];
    total += weight * Math.exp(f);
  }
  return total;
}

/** Density per steradian on a lattice, row by row. */
export function densityOn(density: Density, lattice: Lattice): Float32Array {
  const cells = lattice.elevations.length * lattice.azimuths.length;
  const total = new Float32Array(cells);
  const field = new Float32Array(cells);
  for (const { weight, degree, coefficients } of density.terms) {
    synthesise(degree, coefficients, lattice, field);
    for (let i = 0; i < cells; i++) if (field[i] > NOTHING) total[i] += weight * Math.exp(field[i]);
  }
  return total;
}

/** Solid angles of the rows' cells. */
export function rowWeights(lattice: Lattice): Float64Array {
  const { elevations, azimuths } = lattice;
  const high = Math.abs(elevations[0] - elevations[1]);
  const wide = Math.abs(azimuths[0] - azimuths[1]);
  return elevations.map((elevation) => 2 * Math.sin(high / 2) * Math.cos(elevation) * wide);
}

/** The probability of all cells whose density is at least `level`. */
export function massAbove(values: Float32Array, lattice: Lattice, level: number): number {
  const weights = rowWeights(lattice);
  const columns = lattice.azimuths.length;
  let [above, all] = [0, 0];
  for (let i = 0; i < values.length; i++) {
    const mass = values[i] * weights[Math.floor(i / columns)];
    all += mass;
    if (values[i] >= level) above += mass;
  }
  return above / all;
}

/** The direction of the highest value on a lattice. */
export function highest(values: Float32Array, lattice: Lattice): Vector {
  let best = 0;
  for (let i = 1; i < values.length; i++) if (values[i] > values[best]) best = i;
  const columns = lattice.azimuths.length;
  return direction(lattice.azimuths[best % columns], lattice.elevations[Math.floor(best / columns)]);
}

/** The peak that a climb from `start` reaches: a search with steps of `step` radians, halved when none leads up. */
export function climb(density: Density, start: Vector, step: number): Vector {
  let here = start;
  let value = densityAt(density, here);
  for (let round = 0; round < 60 && step > 1e-5; round++) {
    const [azimuth, elevation] = [azimuthOf(here), elevationOf(here)];
    const left: Vector = [-Math.sin(azimuth), Math.cos(azimuth), 0];
    const up: Vector = [
      -Math.sin(elevation) * Math.cos(azimuth), -Math.sin(elevation) * Math.sin(azimuth), Math.cos(elevation),
    ];
    let moved = false;
    for (const [along, sign] of [[left, 1], [left, -1], [up, 1], [up, -1]] as const) {
      const there = unit([
        here[0] + sign * step * along[0], here[1] + sign * step * along[1], here[2] + sign * step * along[2],
      ]);
      const found = densityAt(density, there);
      if (found > value) {
        [here, value, moved] = [there, found, true];
        break;
      }
    }
    if (!moved) step /= 2;
  }
  return here;
}
