/** Colours of what is drawn over panoramas. Panoramas look alike in the dark and the light scheme, and so do these. */

export const ANSWER = "#3fe0f5";
export const TRUTH = "#54f07f";
export const BORDER = "#ffffff";
export const DARK = "rgba(8, 10, 16, 0.75)";

/** Shapes and colours of other methods, as in the library's pictures: told apart without colour too. */
export const RIVALS = [
  { shape: "square", colour: "#ffb84d" },
  { shape: "diamond", colour: "#ff7ab6" },
  { shape: "up", colour: "#c3adff" },
  { shape: "down", colour: "#ff8a65" },
  { shape: "plus", colour: "#b4de7a" },
  { shape: "cross", colour: "#b0bec5" },
  { shape: "left", colour: "#f4e06d" },
  { shape: "right", colour: "#9fb4ff" },
  { shape: "star", colour: "#e0c3a0" },
] as const;

export type Shape = (typeof RIVALS)[number]["shape"];

const HEAT: readonly [number, number, number, number, number][] = [
  // share of the highest density (its root), red, green, blue, opacity
  [0, 70, 24, 110, 0],
  [0.12, 96, 26, 122, 0.12],
  [0.3, 156, 40, 110, 0.42],
  [0.5, 214, 72, 70, 0.66],
  [0.7, 248, 130, 40, 0.8],
  [0.88, 252, 190, 60, 0.86],
  [1, 255, 240, 180, 0.9],
];

/** 256 colours (RGBA, opacity not multiplied in) from no belief to the highest. */
export function heatColours(): Uint8Array {
  return ramp(HEAT);
}

const LOOK: typeof HEAT = [
  // evidence: against in blue, for in amber, nothing said in the middle
  [0, 60, 130, 255, 0.7],
  [0.42, 90, 140, 230, 0.1],
  [0.5, 128, 128, 128, 0],
  [0.58, 240, 180, 80, 0.1],
  [1, 255, 205, 90, 0.85],
];

export function lookColours(): Uint8Array {
  return ramp(LOOK);
}

function ramp(stops: typeof HEAT): Uint8Array {
  const out = new Uint8Array(256 * 4);
  for (let i = 0; i < 256; i++) {
    const share = i / 255;
    const after = Math.max(1, stops.findIndex((stop) => stop[0] >= share));
    const [a, b] = [stops[after - 1], stops[after]];
    const t = (share - a[0]) / (b[0] - a[0]);
    for (let k = 0; k < 4; k++) {
      const value = a[k + 1] + t * (b[k + 1] - a[k + 1]);
      out[4 * i + k] = Math.round(k === 3 ? 255 * value : value);
    }
  }
  return out;
}
