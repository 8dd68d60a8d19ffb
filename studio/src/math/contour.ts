/** Lines on the sphere where a density has a given value: marching squares, then each point moved onto the line. */

import { densityAt, type Density } from "./density";
import type { Lattice } from "./harmonics";
import { direction, unit, type Vector } from "./rotation";

/**
 * The lines where `values` on `lattice` cross `level`, as directions; closed lines repeat their first point.
 *
 * `around`: the last column is followed by the first one. Values are compared as logarithms, which are smoother.
 */
export function contours(values: Float32Array, lattice: Lattice, level: number, around: boolean): Vector[][] {
  const { elevations, azimuths } = lattice;
  const [rows, columns] = [elevations.length, azimuths.length];
  if (!(level > 0)) return [];
  const wide = around ? columns : columns - 1;
  const height = (i: number, j: number) => Math.log(Math.max(values[i * columns + (j % columns)], 1e-30) / level);
  // A point of a line lies on an edge of the lattice: along a row (even numbers) or down a column (odd numbers).
  const along = (i: number, j: number) => 2 * (i * columns + (j % columns));
  const down = (i: number, j: number) => 2 * (i * columns + (j % columns)) + 1;
  const places = new Map<number, Vector>();
  const links = new Map<number, number[]>();
  const step = azimuths.length > 1 ? azimuths[1] - azimuths[0] : 0;

  function place(edge: number): number {
    if (!places.has(edge)) {
      const cell = edge >> 1;
      const [i, j] = [Math.floor(cell / columns), cell % columns];
      const vertical = edge % 2;
      const from = height(i, j);
      const to = vertical ? height(i + 1, j) : height(i, j + 1);
      const share = from / (from - to);
      const azimuth = azimuths[j] + (vertical ? 0 : share * step);
      const elevation = elevations[i] + (vertical ? share * (elevations[i + 1] - elevations[i]) : 0);
      places.set(edge, direction(azimuth, elevation));
    }
    return edge;
  }

  function link(a: number, b: number): void {
    for (const [from, to] of [[place(a), place(b)], [b, a]]) {
      const known = links.get(from);
      if (known) known.push(to);
      else links.set(from, [to]);
    }
  }

  const within = new Uint8Array(values.length);
  for (let k = 0; k < values.length; k++) within[k] = values[k] > level ? 1 : 0;
  for (let i = 0; i + 1 < rows; i++)
    for (let j = 0; j < wide; j++) {
      const [here, beside] = [i * columns + j, i * columns + ((j + 1) % columns)];
      const count = within[here] + within[beside] + within[here + columns] + within[beside + columns];
      if (count === 0 || count === 4) continue; // most cells
      const corners = [height(i, j), height(i, j + 1), height(i + 1, j + 1), height(i + 1, j)];
      const inside = corners.map((value) => value > 0);
      const edges = [along(i, j), down(i, j + 1), along(i + 1, j), down(i, j)];
      const crossed = edges.filter((_, k) => inside[k] !== inside[(k + 1) % 4]);
      if (crossed.length === 2) link(crossed[0], crossed[1]);
      else if (crossed.length === 4) {
        // Two lines pass this cell; its middle tells which corners belong together.
        const middle = corners.reduce((sum, value) => sum + value, 0) > 0;
        if (middle === inside[0]) {
          link(edges[0], edges[1]);
          link(edges[2], edges[3]);
        } else {
          link(edges[3], edges[0]);
          link(edges[1], edges[2]);
        }
      }
    }

  const lines: Vector[][] = [];
  const take = (from: number): number | undefined => {
    const next = links.get(from)?.pop();
    if (next === undefined) return undefined;
    const back = links.get(next)!;
    back.splice(back.indexOf(from), 1);
    return next;
  };
  const follow = (start: number) => {
    const line = [start];
    for (let next = take(start); next !== undefined; next = take(next)) line.push(next);
    if (line.length > 2) lines.push(line.map((edge) => places.get(edge)!));
  };
  for (const [edge, neighbours] of links) if (neighbours.length === 1) follow(edge); // lines that end at a border
  for (const edge of links.keys()) while (links.get(edge)!.length) follow(edge);
  return lines;
}

/** The point moved onto the line where the exact density is `level`, along the density's slope, by at most `most`. */
export function onto(density: Density, level: number, start: Vector, most: number): Vector {
  let here = start;
  const small = 1e-3;
  for (let round = 0; round < 2; round++) {
    const value = Math.log(Math.max(densityAt(density, here), 1e-30) / level);
    if (Math.abs(value) < 1e-3) break;
    const slope = [0, 1, 2].map((axis) => {
      const moved = unit([0, 1, 2].map((k) => here[k] + (k === axis ? small : 0)) as unknown as Vector);
      return (Math.log(Math.max(densityAt(density, moved), 1e-30) / level) - value) / small;
    });
    const steep = slope.reduce((sum, s) => sum + s * s, 0);
    if (steep < 1e-6) break;
    const length = Math.min(most, Math.abs(value) / Math.sqrt(steep)) * -Math.sign(value);
    here = unit([0, 1, 2].map((k) => here[k] + (length * slope[k]) / Math.sqrt(steep)) as unknown as Vector);
  }
  return here;
}
