/** The page's harmonics against those of the library: `vectors.py` writes the vectors. */

import { describe, expect, it } from "vitest";
import { densityAt, termsOf, type Density } from "../src/math/density";
import { evaluate, sizeOf, synthesise, whole } from "../src/math/harmonics";
import { heatOf } from "../src/math/heat";
import { between, type Vector } from "../src/math/rotation";
import vectors from "./vectors.json";

interface Case {
  degree: number;
  basis: number[][] | null;
  coefficients: number[];
  values: number[];
  grid: number[][];
  log_density: number[];
  mode: Vector;
  level: number;
}

const { directions, cases } = vectors as unknown as { directions: Vector[]; cases: Case[] };

function worst(found: ArrayLike<number>, wanted: number[]): number {
  expect(found.length).toBe(wanted.length);
  return wanted.reduce((most, value, i) => Math.max(most, Math.abs(value - found[i])), 0);
}

describe.each(cases)("degree $degree", (known) => {
  const total = Math.log(densityAt(raw(known), directions[0])) - known.log_density[0];

  it("has the library's basis", () => {
    known.basis?.forEach((row, i) => expect(worst(evaluate(known.degree, directions[i]), row)).toBeLessThan(1e-6));
  });

  it("sums a field at directions and on a grid as the library does", () => {
    directions.forEach((d, i) => {
      const harmonics = evaluate(known.degree, d);
      const value = known.coefficients.reduce((sum, c, k) => sum + c * harmonics[k], 0);
      expect(Math.abs(value - known.values[i])).toBeLessThan(1e-5);
    });
    const found = synthesise(known.degree, known.coefficients, whole(8));
    expect(worst(found, known.grid.flat())).toBeLessThan(2e-5);
  });

  it("gives the library's density, mode and region", () => {
    const density: Density = normalised(known, total);
    directions.forEach((d, i) => {
      expect(Math.abs(Math.log(densityAt(density, d)) - known.log_density[i])).toBeLessThan(1e-4);
    });
    const heat = heatOf(density, 128);
    expect((between(heat.peak, known.mode) * 180) / Math.PI).toBeLessThan(0.5); // of a flat top, either may be right
    expect(densityAt(density, heat.peak)).toBeGreaterThan(densityAt(density, known.mode) * (1 - 1e-5));
    expect(Math.abs(heat.mass - 0.9)).toBeLessThan(0.02);
    for (const line of heat.border)
      for (const d of line) expect(Math.abs(Math.log(densityAt(density, d) / known.level))).toBeLessThan(0.15);
  });
});

it("refuses coefficients that do not fit", () => {
  expect(() => termsOf([{ weight: 1, degree: 2 }], new Float32Array(10))).toThrow("wanted 9");
});

function raw(known: Case): Density {
  const coefficients = Float32Array.from(known.coefficients);
  expect(coefficients.length).toBe(sizeOf(known.degree));
  return { terms: [{ weight: 1, degree: known.degree, coefficients }], level: known.level };
}

/** Coefficients as on the wire: exp of the field integrates to 1. */
function normalised(known: Case, total: number): Density {
  const density = raw(known);
  density.terms[0].coefficients[0] -= total * Math.sqrt(4 * Math.PI);
  return density;
}
