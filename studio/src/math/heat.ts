/**
 * What is drawn of a belief: density on the whole sphere, finer where the belief is narrow, and the region's border.
 */

import { contours, onto } from "./contour";
import { climb, densityOn, highest, massAbove, type Density } from "./density";
import { patch, whole, type Lattice } from "./harmonics";
import { azimuthOf, elevationOf, type Vector } from "./rotation";

/** A part of the sphere in azimuth (left edge first) and elevation (top first). */
export interface Window {
  left: number;
  right: number;
  top: number;
  bottom: number;
}

export interface Layer {
  lattice: Lattice;
  values: Float32Array;
}

export interface Heat {
  coarse: Layer;
  fine: (Layer & { window: Window }) | null;
  highest: number; // the greatest density on the lattices
  peak: Vector; // where it is, refined
  border: Vector[][];
  mass: number; // within the border, on the finest lattice
}

const NEAR = 0.02; // of the border's level: cells above this are within the fine window
const MOST = 0.35; // of the sphere's cells: with a larger window nothing is gained
const EXACT = 8; // times the rows: so many points of the border at most are moved onto the exact line
const wholes = new Map<number, Lattice>();

function wholeOf(rows: number): Lattice {
  const known = wholes.get(rows);
  if (known) return known;
  const made = whole(rows);
  wholes.set(rows, made);
  return made;
}

/** Heat of a belief. `rows` of the whole sphere: 64 is quick, 128 is fine. */
export function heatOf(density: Density, rows: number): Heat {
  const lattice = wholeOf(rows);
  const coarse = { lattice, values: densityOn(density, lattice) };
  const top = highest(coarse.values, lattice);
  const window = windowOf(coarse, density.level, top);
  const fine = window ? fineOf(density, window, rows) : null;
  const best = fine ?? coarse;
  const step = Math.PI / rows;
  const peak = climb(density, highest(best.values, best.lattice), fine ? step / 4 : step);
  const raw = density.undrawn ? [] : contours(best.values, best.lattice, density.level, fine === null);
  const points = raw.reduce((sum, line) => sum + line.length, 0);
  const border = points > EXACT * rows ? raw : raw.map((line) => line.map((d) => onto(density, density.level, d, step)));
  return {
    coarse,
    fine,
    highest: best.values.reduce((most, value) => Math.max(most, value), 0),
    peak,
    border,
    mass: regionMass(coarse, fine, density.level),
  };
}

/** The smallest window with all cells near the region; null if it is large, meets the seam or is near a pole. */
function windowOf({ lattice, values }: Layer, level: number, top: Vector): Window | null {
  const [rows, columns] = [lattice.elevations.length, lattice.azimuths.length];
  const cell = Math.PI / rows;
  // Columns are counted from the seam opposite to the peak, so that a belief behind the camera has a window too.
  const centre = Math.round((azimuthOf(top) - lattice.azimuths[0]) / -cell);
  let [first, last, high, low] = [columns, -1, rows, -1];
  for (let i = 0; i < rows; i++)
    for (let j = 0; j < columns; j++)
      if (values[i * columns + j] > NEAR * level) {
        const column = (((j - centre + columns / 2) % columns) + columns) % columns;
        first = Math.min(first, column);
        last = Math.max(last, column);
        high = Math.min(high, i);
        low = Math.max(low, i);
      }
  // A peak between the cells' centres may show in no cell.
  const row = Math.round((lattice.elevations[0] - elevationOf(top)) / cell);
  [first, last] = [Math.min(first, columns / 2), Math.max(last, columns / 2)];
  [high, low] = [Math.max(0, Math.min(high, row) - 1), Math.min(rows - 1, Math.max(low, row) + 1)];
  [first, last] = [first - 1, last + 1];
  if ((last - first + 1) * (low - high + 1) > MOST * rows * columns || last - first + 1 >= columns) return null;
  const left = lattice.azimuths[0] + cell / 2 - (first + centre - columns / 2) * cell;
  return {
    left,
    right: left - (last - first + 1) * cell,
    top: Math.PI / 2 - high * cell,
    bottom: Math.PI / 2 - (low + 1) * cell,
  };
}

function fineOf(density: Density, window: Window, rows: number): Layer & { window: Window } {
  const cell = Math.PI / rows / 4;
  const columns = Math.min(2 * rows, Math.round((window.left - window.right) / cell));
  const high = Math.min(2 * rows, Math.round((window.top - window.bottom) / cell));
  const lattice = patch(high, columns, window.left, window.right, window.top, window.bottom);
  return { lattice, values: densityOn(density, lattice), window };
}

function regionMass(coarse: Layer, fine: (Layer & { window: Window }) | null, level: number): number {
  // All but a thousandth of the belief is in the window, if there is one: see NEAR.
  return fine ? massAbove(fine.values, fine.lattice, level) : massAbove(coarse.values, coarse.lattice, level);
}
