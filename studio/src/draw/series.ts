/** Quantities over time, one strip below the other, with a line at the step that is shown. */

import type { Point } from "../math/projection";
import { disc, polyline, sheetOf, themed, unit, write } from "./canvas";

export interface Strip {
  name: string;
  values: (number | null)[];
  low: number;
  high: number;
  colour: string; // name of a colour of the theme
  format(value: number): string;
}

export interface Series {
  stamps: number[];
  strips: Strip[];
  now: number; // index
}

/** The horizontal part of a canvas of this width that the time takes. */
export function span(width: number): [number, number] {
  return [78 * unit(), width - 54 * unit()];
}

export function drawSeries(canvas: HTMLCanvasElement, { stamps, strips, now }: Series): void {
  const sheet = sheetOf(canvas);
  if (!sheet || !strips.length) return;
  const { context, width, height, u } = sheet;
  const [left, right] = span(width);
  const [first, last] = [stamps[0] ?? 0, stamps.at(-1) ?? 1];
  const x = (stamp: number) => left + ((stamp - first) / Math.max(last - first, 1e-6)) * (right - left);
  const bottom = height - 18 * u;
  const high = bottom / strips.length - 10 * u;
  const shown = Math.min(now, stamps.length - 1);
  strips.forEach((strip, k) => {
    const top = (k * bottom) / strips.length + 5 * u;
    const middle = top + high / 2;
    const y = (value: number) => {
      const share = (value - strip.low) / Math.max(strip.high - strip.low, 1e-9);
      return top + high * (1 - Math.max(0, Math.min(1, share)));
    };
    context.fillStyle = themed("well");
    context.fillRect(left, top, right - left, high);
    write(context, strip.name, [left - 9 * u, middle], u, { size: 12, colour: themed("quiet"), align: "right" });
    for (const points of runs(strip.values.map((value, i): Point | null => (value === null ? null : [x(stamps[i]), y(value)])))) {
      if (stamps.length === 1) points.push([right, points[0][1]]); // one look at one picture: it stays as it is
      const [colour, end] = [themed(strip.colour), points.at(-1)!];
      polyline(context, [[points[0][0], top + high], ...points, [end[0], top + high]], { fill: colour, alpha: 0.18 });
      polyline(context, points, { stroke: colour, width: 2 * u });
      if (points.length === 1) disc(context, end, 2.5 * u, { fill: colour });
    }
    const value = strip.values[shown];
    const text = value === null || value === undefined ? "–" : strip.format(value);
    write(context, text, [right + 8 * u, middle], u, { size: 13, weight: 600, colour: themed("ink") });
  });
  const quiet = { size: 11, colour: themed("quiet") };
  write(context, "0 s", [left, height - 7 * u], u, quiet);
  write(context, `${(last - first).toFixed(last - first < 10 ? 1 : 0)} s`, [right, height - 7 * u], u, { ...quiet, align: "right" });
  if (stamps.length) polyline(context, [[x(stamps[shown]), 0], [x(stamps[shown]), bottom]], { stroke: themed("ink"), width: 1.4 * u });
}

/** The stretches without a gap. */
function runs(points: (Point | null)[]): Point[][] {
  const found: Point[][] = [[]];
  for (const point of points)
    if (point) found.at(-1)!.push(point);
    else found.push([]);
  return found.filter((run) => run.length > 0);
}
