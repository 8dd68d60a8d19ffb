/** Quantities over time, one strip below the other, with a line at the step that is shown. */

import { font, sheetOf, themed, type Sheet } from "./canvas";

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

/** The horizontal part of the canvas that the time takes, as shares of its width. */
export function span(sheet: { width: number; rem: number }): [number, number] {
  return [(78 * sheet.rem) / 16, sheet.width - (54 * sheet.rem) / 16];
}

export function drawSeries(canvas: HTMLCanvasElement, series: Series): void {
  const sheet = sheetOf(canvas);
  if (!sheet || !series.strips.length) return;
  const u = sheet.rem / 16;
  const [left, right] = span(sheet);
  const [first, last] = [series.stamps[0] ?? 0, series.stamps.at(-1) ?? 1];
  const x = (stamp: number) => left + ((stamp - first) / Math.max(last - first, 1e-6)) * (right - left);
  const foot = 18 * u;
  const high = (sheet.height - foot) / series.strips.length;
  series.strips.forEach((strip, k) => drawStrip(sheet, strip, series, x, k * high + 5 * u, high - 10 * u, u));
  const { context } = sheet;
  context.font = font(sheet, 11);
  context.fillStyle = themed("quiet");
  context.textBaseline = "bottom";
  context.textAlign = "left";
  context.fillText("0 s", left, sheet.height);
  context.textAlign = "right";
  context.fillText(`${(last - first).toFixed(last - first < 10 ? 1 : 0)} s`, right, sheet.height);
  if (series.stamps.length) {
    const at = x(series.stamps[Math.min(series.now, series.stamps.length - 1)]);
    context.beginPath();
    context.moveTo(at, 0);
    context.lineTo(at, sheet.height - foot);
    context.strokeStyle = themed("ink");
    context.lineWidth = 1.4 * u;
    context.stroke();
  }
}

function drawStrip(
  { context, width, rem }: Sheet, strip: Strip, series: Series, x: (stamp: number) => number, top: number, high: number, u: number,
): void {
  const [left, right] = span({ width, rem });
  const y = (value: number) => top + high * (1 - (value - strip.low) / Math.max(strip.high - strip.low, 1e-9));
  context.fillStyle = themed("well");
  context.fillRect(left, top, right - left, high);
  const sheet = { context, width, height: 0, rem };
  context.font = font(sheet, 12);
  context.fillStyle = themed("quiet");
  context.textAlign = "right";
  context.textBaseline = "middle";
  context.fillText(strip.name, left - 9 * u, top + high / 2);
  context.save();
  context.beginPath();
  context.rect(left, top - 2, right - left + 2, high + 4);
  context.clip();
  const colour = themed(strip.colour);
  const runs: [number, number][][] = [];
  let run: [number, number][] = [];
  strip.values.forEach((value, i) => {
    if (value === null) {
      if (run.length) runs.push(run);
      run = [];
    } else run.push([x(series.stamps[i]), y(Math.max(strip.low, Math.min(strip.high, value)))]);
  });
  if (run.length) runs.push(run);
  for (const points of runs) {
    context.beginPath();
    context.moveTo(points[0][0], top + high);
    for (const [a, b] of points) context.lineTo(a, b);
    context.lineTo(points.at(-1)![0], top + high);
    context.closePath();
    context.globalAlpha = 0.18;
    context.fillStyle = colour;
    context.fill();
    context.globalAlpha = 1;
    context.beginPath();
    points.forEach(([a, b], i) => (i ? context.lineTo(a, b) : context.moveTo(a, b)));
    context.strokeStyle = colour;
    context.lineWidth = 2 * u;
    context.lineJoin = "round";
    context.stroke();
    if (points.length === 1) {
      context.beginPath();
      context.arc(points[0][0], points[0][1], 2.5 * u, 0, 2 * Math.PI);
      context.fill();
    }
  }
  context.restore();
  const value = strip.values[Math.min(series.now, strip.values.length - 1)];
  context.textAlign = "left";
  context.font = font(sheet, 13, 600);
  context.fillStyle = themed("ink");
  context.fillText(value === null || value === undefined ? "–" : strip.format(value), right + 8 * u, top + high / 2);
}
