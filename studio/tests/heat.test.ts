/** The region's border and the fine window, on beliefs whose answer is known in closed form. */

import { describe, expect, it } from "vitest";
import { contours } from "../src/math/contour";
import type { Density } from "../src/math/density";
import { whole } from "../src/math/harmonics";
import { heatOf } from "../src/math/heat";
import { between, degrees, direction, dot, type Vector } from "../src/math/rotation";

/** exp(kappa (d . mean)) normalised: a von Mises-Fisher density, with the border of its 90 % region. */
function fisher(mean: Vector, kappa: number): { density: Density; angle: number } {
  const scale = kappa * Math.sqrt((4 * Math.PI) / 3);
  const total = Math.log(2 * Math.PI) + kappa + Math.log((1 - Math.exp(-2 * kappa)) / kappa);
  const coefficients = Float32Array.of(
    -total * Math.sqrt(4 * Math.PI), scale * mean[1], scale * mean[2], scale * mean[0],
  );
  // P(cos > t) = (e^k - e^kt) / (e^k - e^-k) = 0.9
  const cosine = 1 + Math.log(1 - 0.9 * (1 - Math.exp(-2 * kappa))) / kappa;
  const level = Math.exp(kappa * cosine - total);
  return { density: { terms: [{ weight: 1, degree: 1, coefficients }], level }, angle: degrees(Math.acos(cosine)) };
}

const places: [string, Vector][] = [
  ["ahead", direction(0.2, 0.1)],
  ["on the seam", direction(Math.PI - 0.003, -0.3)],
  ["near a pole", direction(1, 1.5)],
];

describe.each(places)("a belief %s", (_, mean) => {
  it.each([4, 60, 2000])("with concentration %d has its border and its peak where they are", (kappa) => {
    const { density, angle } = fisher(mean, kappa);
    const heat = heatOf(density, 128);
    expect(degrees(between(heat.peak, mean))).toBeLessThan(0.1);
    expect(heat.border.length).toBeGreaterThan(0);
    for (const line of heat.border)
      for (const d of line) expect(Math.abs(degrees(between(d, mean)) - angle)).toBeLessThan(0.03 * angle + 0.02);
    expect(Math.abs(heat.mass - 0.9)).toBeLessThan(0.02);
  });
});

it("closes the lines around a region, also over the seam", () => {
  const lattice = whole(32);
  const mean = direction(Math.PI, 0);
  const values = new Float32Array(32 * 64);
  for (let i = 0; i < 32; i++)
    for (let j = 0; j < 64; j++)
      values[i * 64 + j] = Math.exp(10 * dot(direction(lattice.azimuths[j], lattice.elevations[i]), mean));
  const lines = contours(values, lattice, Math.exp(8), true);
  expect(lines.length).toBe(1);
  expect(degrees(between(lines[0][0], lines[0].at(-1)!))).toBeLessThan(1e-6);
  expect(contours(values, lattice, 0, true)).toEqual([]);
});

it("finds both of two separate regions", () => {
  const [one, two] = [fisher(direction(1, 0), 400), fisher(direction(-2, 0.4), 400)];
  const terms = [one, two].map(({ density }) => ({ ...density.terms[0], weight: 0.5 }));
  const heat = heatOf({ terms, level: one.density.level / 2 }, 128);
  expect(heat.border.length).toBe(2);
});

it("draws no border that the server says is not to be drawn", () => {
  const { density } = fisher(direction(1, 0), 400);
  expect(heatOf({ ...density, undrawn: "over half of the sphere" }, 64).border).toEqual([]);
});
