/** Colours of what is drawn over panoramas. Panoramas look alike in the dark and the light scheme, and so do these. */

import type { Point } from "../math/projection";

export const ANSWER = "#3fe0f5";
export const TRUTH = "#54f07f";
export const BORDER = "#ffffff";
export const DARK = "rgba(8, 10, 16, 0.75)";

/** Colours and shapes of other methods, in a square of 16: told apart without colour too. */
export const RIVALS = [
  { colour: "#ffb84d", path: "M4 4h8v8H4z" },
  { colour: "#ff7ab6", path: "M8 2.5L13 8l-5 5.5L3 8z" },
  { colour: "#c3adff", path: "M8 3l5 9H3z" },
  { colour: "#ff8a65", path: "M8 13l5-9H3z" },
  { colour: "#b4de7a", path: "M6.3 3h3.4v3.3H13v3.4H9.7V13H6.3V9.7H3V6.3h3.3z" },
  { colour: "#b0bec5", path: "M5.2 3L8 5.8 10.8 3 13 5.2 10.2 8l2.8 2.8-2.2 2.2L8 10.2 5.2 13 3 10.8 5.8 8 3 5.2z" },
  { colour: "#f4e06d", path: "M3 8l9-5v10z" },
  { colour: "#9fb4ff", path: "M13 8L4 3v10z" },
  { colour: "#e0c3a0", path: "M8 1.7l1.6 4.3 4.7.3-3.6 2.9 1.2 4.4L8 11.1l-3.9 2.5 1.2-4.4-3.6-2.9 4.7-.3z" },
] as const;

/** The mark of another method, by its number; `r`: half of its size. */
export function rivalMark(context: CanvasRenderingContext2D, index: number, [x, y]: Point, r: number): void {
  const { colour, path } = RIVALS[index % RIVALS.length];
  context.save();
  context.translate(x, y);
  context.scale(r / 5, r / 5);
  context.translate(-8, -8);
  const outline = new Path2D(path);
  context.fillStyle = colour;
  context.fill(outline);
  context.strokeStyle = DARK;
  context.lineWidth = 1.2;
  context.stroke(outline);
  context.restore();
}

type Stops = readonly (readonly [number, number, number, number, number])[];

const HEAT: Stops = [
  // share of the highest density (its root), red, green, blue, opacity
  [0, 70, 24, 110, 0],
  [0.12, 96, 26, 122, 0.12],
  [0.3, 156, 40, 110, 0.42],
  [0.5, 214, 72, 70, 0.66],
  [0.7, 248, 130, 40, 0.8],
  [0.88, 252, 190, 60, 0.86],
  [1, 255, 240, 180, 0.9],
];

const LOOK: Stops = [
  // evidence: against in blue, for in amber, nothing said in the middle
  [0, 60, 130, 255, 0.7],
  [0.42, 90, 140, 230, 0.1],
  [0.5, 128, 128, 128, 0],
  [0.58, 240, 180, 80, 0.1],
  [1, 255, 205, 90, 0.85],
];

/** 256 colours (RGBA, opacity not multiplied in): of a belief, or of what one look says. */
export function colours(which: "heat" | "look"): Uint8Array {
  const stops = which === "heat" ? HEAT : LOOK;
  const out = new Uint8Array(256 * 4);
  for (let i = 0; i < 256; i++) {
    const share = i / 255;
    const after = Math.max(1, stops.findIndex((stop) => stop[0] >= share));
    const [a, b] = [stops[after - 1], stops[after]];
    const t = (share - a[0]) / (b[0] - a[0]);
    for (let k = 0; k < 4; k++) out[4 * i + k] = Math.round((k === 3 ? 255 : 1) * (a[k + 1] + t * (b[k + 1] - a[k + 1])));
  }
  return out;
}
