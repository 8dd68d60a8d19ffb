/** Marks over a panorama: the region's border, the answer, candidates, truth, other methods, directions. */

import type { Point, Projection } from "../math/projection";
import { apply, azimuthOf, degrees, direction, dot, elevationOf, RADIANS, unit, type Matrix, type Vector } from "../math/rotation";
import { words } from "../words";
import { arrow, disc, paint, polyline, write, type Style } from "./canvas";
import { ANSWER, BORDER, DARK, rivalMark, TRUTH } from "./palette";

const SAME = 0.9998; // cosine of a degree: the candidate that is the answer
const LABEL = { size: 12, weight: 600, colour: "#ffffff", outline: "rgba(8, 10, 16, 0.65)" };

export interface Marks {
  border: Vector[][]; // axes of the world
  view_R_world: Matrix;
  view_R_body: Matrix;
  answer: Vector | null; // body frame, and so the others
  sure: number | null; // told beside the answer, or the arrow to it
  pointed: boolean; // whether the answer is sure enough for an arrow
  modes: { direction: Vector; weight: number }[];
  truth: Vector | null;
  rivals: { direction: Vector; index: number }[];
  grid: boolean;
  gaze: { field: number; aspect: number; view_R_gaze: Matrix } | null; // what the other view shows
}

export function drawMarks(context: CanvasRenderingContext2D, to: Projection, marks: Marks, u: number): void {
  const { answer, sure } = marks;
  if (marks.grid) drawGrid(context, to, marks.view_R_body, u);
  if (marks.gaze) drawGaze(context, to, marks.gaze, u);
  for (const line of marks.border) {
    const found = pieces(to, line.map((d) => apply(marks.view_R_world, d)));
    for (const style of twice(BORDER, 1.8 * u, 2.3 * u)) for (const piece of found) smooth(context, piece, style);
  }
  const place = (d: Vector) => places(to, apply(marks.view_R_body, d), 40 * u);
  for (const { direction: d, index } of marks.rivals) for (const at of place(d)) rivalMark(context, index, at, 6.5 * u);
  for (const { direction: d, weight } of marks.modes)
    for (const at of place(d)) {
      for (const style of twice("#ffffff", 1.8 * u)) disc(context, at, 13 * u, style);
      if (sure === null || !answer || dot(d, answer) < SAME)
        write(context, words.percent(weight), [at[0] + 17 * u, at[1] + 14 * u], u, LABEL);
    }
  if (marks.truth)
    for (const at of place(marks.truth)) {
      for (const style of twice(TRUTH, 2.4 * u)) disc(context, at, 19 * u, style);
      ticks(context, at, 19 * u, 25 * u, 0.25, TRUTH, 2.4 * u);
    }
  if (!answer) return;
  if (marks.pointed) {
    const where = words.candidates.row(degrees(azimuthOf(answer)), degrees(elevationOf(answer)));
    pointer(context, to, apply(marks.view_R_body, answer), sure === null ? "" : `${where}, ${words.answer.isSure(sure)}`, u);
  }
  for (const at of place(answer)) {
    disc(context, at, 6.5 * u, { fill: ANSWER, stroke: DARK, width: 1.6 * u });
    if (sure !== null) {
      // To the right of it and below; where that would leave the picture, to the left or above.
      const [right, below] = [at[0] + 80 * u < to.width, at[1] + 24 * u < to.height];
      const corner: Point = [at[0] + (right ? 17 : -17) * u, at[1] + (below ? 14 : -14) * u];
      write(context, words.answer.isSure(sure), corner, u, { ...LABEL, align: right ? "left" : "right" });
    }
    ticks(context, at, 9.5 * u, 14 * u, 0, ANSWER, 2.2 * u);
  }
}

/** What is to be seen on any picture: a dark line, and a narrower one of its colour on it. */
function twice(stroke: string, width: number, more = 2.2): Style[] {
  return [{ stroke: DARK, width: width + more }, { stroke, width }];
}

function ticks(
  context: CanvasRenderingContext2D, [x, y]: Point, from: number, past: number, turn: number, colour: string, width: number,
): void {
  for (let k = 0; k < 4; k++) {
    const [c, s] = [Math.cos((turn + k / 2) * Math.PI), Math.sin((turn + k / 2) * Math.PI)];
    for (const style of twice(colour, width, 2)) polyline(context, [[x + from * c, y + from * s], [x + past * c, y + past * s]], style);
  }
}

/** An arrow at the border of a view from inside, towards an answer that lies outside of it. */
function pointer(context: CanvasRenderingContext2D, to: Projection, d: Vector, said: string, u: number): void {
  const at = to.project(d);
  const margin = 30 * u;
  if (to.seam !== null || (at && at[0] > 0 && at[0] < to.width && at[1] > 0 && at[1] < to.height)) return;
  const length = Math.hypot(d[1], d[2]) || 1;
  const [x, y] = [-d[1] / length, -d[2] / length];
  const reach = Math.min(
    (to.width / 2 - margin) / Math.max(1e-6, Math.abs(x)), (to.height / 2 - margin) / Math.max(1e-6, Math.abs(y)));
  const tip = (away: number): Point => [to.width / 2 + away * x, to.height / 2 + away * y];
  arrow(context, tip(reach), Math.atan2(y, x), 13 * u, { fill: ANSWER, stroke: DARK, width: 2 * u });
  if (!said) return;
  const [ax, ay] = tip(reach - 30 * u);
  context.font = `600 ${14 * u}px system-ui, sans-serif`;
  const wide = context.measureText(said).width;
  const left = Math.max(8 * u, Math.min(to.width - wide - 8 * u, ax - (0.5 + 0.5 * x) * wide));
  write(context, said, [left, ay], u, { ...LABEL, size: 14 });
}

/** Where a direction is drawn: twice if it lies on the seam of a flat panorama. */
function places(to: Projection, d: Vector, margin: number): Point[] {
  const at = to.project(d);
  if (!at || at[0] < -margin || at[0] > to.width + margin || at[1] < -margin || at[1] > to.height + margin) return [];
  if (to.seam !== null && at[0] < margin) return [at, [at[0] + to.seam, at[1]]];
  if (to.seam !== null && at[0] > to.seam - margin) return [at, [at[0] - to.seam, at[1]]];
  return [at];
}

/** Parts of a line that can be drawn without a jump, in pixels. */
function pieces(to: Projection, line: Vector[]): Point[][] {
  const found: Point[][] = [[]];
  for (const d of line) {
    const [at, last] = [to.project(d), found.at(-1)!.at(-1)];
    if (!at) {
      found.push([]);
      continue;
    }
    if (to.seam !== null && last && Math.abs(at[0] - last[0]) > to.seam / 2) {
      const over = at[0] < last[0] ? to.seam : -to.seam; // the line leaves at one edge and comes in at the other
      found.at(-1)!.push([at[0] + over, at[1]]);
      found.push([[last[0] - over, last[1]]]);
    }
    found.at(-1)!.push(at);
  }
  return found.filter((piece) => piece.length > 1);
}

/** A smooth line through the middles between the points. */
function smooth(context: CanvasRenderingContext2D, piece: Point[], style: Style): void {
  paint(context, style, () => {
    context.moveTo(...piece[0]);
    for (let i = 1; i + 1 < piece.length; i++) {
      const [a, b] = [piece[i], piece[i + 1]];
      context.quadraticCurveTo(...a, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2);
    }
    context.lineTo(...piece.at(-1)!);
  });
}

function drawGrid(context: CanvasRenderingContext2D, to: Projection, view_R_body: Matrix, u: number): void {
  const line = (from: number, past: number, at: (angle: number) => Vector, strong: boolean) => {
    const points = Array.from({ length: (past - from) / 5 + 1 }, (_, k) => apply(view_R_body, at((from + 5 * k) * RADIANS)));
    for (const piece of pieces(to, points)) smooth(context, piece, { stroke: `rgba(255, 255, 255, ${strong ? 0.34 : 0.15})` });
  };
  for (let azimuth = -180; azimuth < 180; azimuth += 45)
    line(-75, 75, (elevation) => direction(azimuth * RADIANS, elevation), azimuth % 90 === 0);
  for (const elevation of [-45, 0, 45]) line(-180, 180, (azimuth) => direction(azimuth, elevation * RADIANS), elevation === 0);
  const { ahead, left, right, behind } = words.panorama.axes;
  for (const [azimuth, name] of [[0, ahead], [90, left], [-90, right], [180, behind]] as const)
    for (const [x, y] of places(to, apply(view_R_body, direction(azimuth * RADIANS, 0)), 0))
      write(context, name, [x + 5 * u, y - 9 * u], u, { ...LABEL, weight: 500, colour: "rgba(255, 255, 255, 0.85)" });
}

/** The outline of what the other view shows. */
function drawGaze(context: CanvasRenderingContext2D, to: Projection, gaze: NonNullable<Marks["gaze"]>, u: number): void {
  const high = Math.tan(gaze.field / 2);
  const wide = high * gaze.aspect;
  const corners = [[-wide, high], [wide, high], [wide, -high], [-wide, -high], [-wide, high]];
  const outline = Array.from({ length: 97 }, (_, k) => {
    const [side, t] = [Math.min(3, Math.floor(k / 24)), k / 24 - Math.min(3, Math.floor(k / 24))];
    const [a, b] = [corners[side], corners[side + 1]];
    return apply(gaze.view_R_gaze, unit([1, -(a[0] + t * (b[0] - a[0])), a[1] + t * (b[1] - a[1])]));
  });
  for (const piece of pieces(to, outline))
    smooth(context, piece, { stroke: "rgba(255, 255, 255, 0.75)", width: 1.3 * u, dash: [5 * u, 4 * u] });
}
