/** Marks over a panorama: the region's border, the answer, candidates, truth, other methods, directions. */

import type { Projection } from "../math/projection";
import { apply, azimuthOf, degrees, direction, dot, elevationOf, RADIANS, type Matrix, type Vector } from "../math/rotation";
import { words } from "../words";
import { ANSWER, BORDER, DARK, RIVALS, TRUTH, type Shape } from "./palette";

const SAME = 0.9998; // cosine of a degree: the candidate that is the answer

export interface Marks {
  border: Vector[][]; // frame of the belief
  view_R_belief: Matrix;
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

export function drawMarks(context: CanvasRenderingContext2D, to: Projection, marks: Marks, rem: number): void {
  context.lineJoin = context.lineCap = "round";
  const u = rem / 16;
  if (marks.grid) drawGrid(context, to, marks.view_R_body, u);
  if (marks.gaze) drawGaze(context, to, marks.gaze, u);
  for (const line of marks.border)
    strokeTwice(context, to, line.map((d) => apply(marks.view_R_belief, d)), BORDER, 1.8 * u);
  const place = (d: Vector) => places(to, apply(marks.view_R_body, d), 40 * u);
  for (const { direction, index } of marks.rivals)
    for (const [x, y] of place(direction)) {
      const { shape, colour } = RIVALS[index % RIVALS.length];
      shaped(context, shape, x, y, 6.5 * u, colour, u);
    }
  for (const { direction, weight } of marks.modes)
    for (const [x, y] of place(direction)) {
      ring(context, x, y, 13 * u, "#ffffff", 1.8 * u);
      if (marks.sure === null || !marks.answer || dot(direction, marks.answer) < SAME)
        label(context, words.percent(weight), x + 17 * u, y + 14 * u, u);
    }
  if (marks.truth)
    for (const [x, y] of place(marks.truth)) {
      ring(context, x, y, 19 * u, TRUTH, 2.4 * u);
      for (const turn of [0.25, 0.75, 1.25, 1.75]) tick(context, x, y, 19 * u, 25 * u, turn * Math.PI, TRUTH, 2.4 * u);
    }
  if (marks.answer && marks.pointed) {
    const where = words.candidates.row(degrees(azimuthOf(marks.answer)), degrees(elevationOf(marks.answer)));
    const said = marks.sure === null ? null : `${where}, ${words.answer.isSure(marks.sure)}`;
    pointer(context, to, apply(marks.view_R_body, marks.answer), said, u);
  }
  if (marks.answer)
    for (const [x, y] of place(marks.answer)) {
      spot(context, x, y, 6.5 * u, ANSWER, u);
      if (marks.sure !== null) beside(context, to, words.answer.isSure(marks.sure), x, y, u);
      for (const turn of [0, 0.5, 1, 1.5]) tick(context, x, y, 9.5 * u, 14 * u, turn * Math.PI, ANSWER, 2.2 * u);
    }
}

/** An arrow at the border of a view from inside, towards an answer that lies outside of it. */
function pointer(context: CanvasRenderingContext2D, to: Projection, d: Vector, said: string | null, u: number): void {
  const at = to.project(d);
  const margin = 30 * u;
  if (to.seam !== null || (at && at[0] > 0 && at[0] < to.width && at[1] > 0 && at[1] < to.height)) return;
  const length = Math.hypot(d[1], d[2]) || 1;
  const [x, y] = [-d[1] / length, -d[2] / length];
  const reach = Math.min(
    (to.width / 2 - margin) / Math.max(1e-6, Math.abs(x)), (to.height / 2 - margin) / Math.max(1e-6, Math.abs(y)));
  context.save();
  context.translate(to.width / 2 + reach * x, to.height / 2 + reach * y);
  context.rotate(Math.atan2(y, x));
  context.beginPath();
  context.moveTo(13 * u, 0);
  context.lineTo(-8 * u, 10 * u);
  context.lineTo(-3 * u, 0);
  context.lineTo(-8 * u, -10 * u);
  context.closePath();
  context.fillStyle = ANSWER;
  context.fill();
  context.strokeStyle = DARK;
  context.lineWidth = 2 * u;
  context.stroke();
  context.restore();
  if (said === null) return;
  context.font = `600 ${14 * u}px system-ui, sans-serif`;
  const wide = context.measureText(said).width;
  const [ax, ay] = [to.width / 2 + (reach - 30 * u) * x, to.height / 2 + (reach - 30 * u) * y];
  const left = Math.max(8 * u, Math.min(to.width - wide - 8 * u, ax - (0.5 + 0.5 * x) * wide));
  label(context, said, left, ay, u);
}

/** Words to the right of a place and below it; where they would leave the picture, to the left or above. */
function beside(context: CanvasRenderingContext2D, to: Projection, text: string, x: number, y: number, u: number): void {
  context.font = `600 ${Math.round(12 * u)}px system-ui, sans-serif`;
  const wide = context.measureText(text).width;
  const left = x + 17 * u + wide < to.width ? x + 17 * u : x - 17 * u - wide;
  label(context, text, left, y + 24 * u < to.height ? y + 14 * u : y - 14 * u, u);
}

/** Where a direction is drawn: twice if it lies on the seam of a flat panorama. */
function places(to: Projection, d: Vector, margin: number): (readonly [number, number])[] {
  const at = to.project(d);
  if (!at || at[0] < -margin || at[0] > to.width + margin || at[1] < -margin || at[1] > to.height + margin) return [];
  if (to.seam === null) return [at];
  if (at[0] < margin) return [at, [at[0] + to.seam, at[1]]];
  if (at[0] > to.seam - margin) return [at, [at[0] - to.seam, at[1]]];
  return [at];
}

/** Parts of a line that can be drawn without a jump, in pixels. */
export function pieces(to: Projection, line: Vector[]): [number, number][][] {
  const found: [number, number][][] = [];
  let piece: [number, number][] = [];
  const end = () => {
    if (piece.length > 1) found.push(piece);
    piece = [];
  };
  for (const d of line) {
    const at = to.project(d);
    if (!at) {
      end();
      continue;
    }
    const last = piece.at(-1);
    if (to.seam !== null && last && Math.abs(at[0] - last[0]) > to.seam / 2) {
      const over = at[0] < last[0] ? to.seam : -to.seam; // the line leaves at one edge and comes in at the other
      piece.push([at[0] + over, at[1]]);
      const before: [number, number] = [last[0] - over, last[1]];
      end();
      piece = [before];
    }
    piece.push([at[0], at[1]]);
  }
  end();
  return found;
}

/** A smooth line through the middles between the points. */
function trace(context: CanvasRenderingContext2D, piece: [number, number][]): void {
  context.beginPath();
  context.moveTo(...piece[0]);
  for (let i = 1; i + 1 < piece.length; i++) {
    const [a, b] = [piece[i], piece[i + 1]];
    context.quadraticCurveTo(a[0], a[1], (a[0] + b[0]) / 2, (a[1] + b[1]) / 2);
  }
  context.lineTo(...piece.at(-1)!);
}

function strokeTwice(context: CanvasRenderingContext2D, to: Projection, line: Vector[], colour: string, width: number): void {
  const found = pieces(to, line);
  for (const [style, wide] of [[DARK, width * 2.3], [colour, width]] as const) {
    context.strokeStyle = style;
    context.lineWidth = wide;
    for (const piece of found) {
      trace(context, piece);
      context.stroke();
    }
  }
}

function drawGrid(context: CanvasRenderingContext2D, to: Projection, view_R_body: Matrix, u: number): void {
  context.strokeStyle = "rgba(255, 255, 255, 0.16)";
  context.lineWidth = 1;
  const line = (points: Vector[], strong: boolean) => {
    context.strokeStyle = strong ? "rgba(255, 255, 255, 0.34)" : "rgba(255, 255, 255, 0.15)";
    for (const piece of pieces(to, points.map((d) => apply(view_R_body, d)))) {
      trace(context, piece);
      context.stroke();
    }
  };
  const range = (from: number, past: number, step: number) => {
    const out = [];
    for (let x = from; x <= past; x += step) out.push(x * RADIANS);
    return out;
  };
  for (let azimuth = -180; azimuth < 180; azimuth += 45)
    line(range(-75, 75, 5).map((e) => direction(azimuth * RADIANS, e)), azimuth % 90 === 0);
  for (const elevation of [-45, 0, 45])
    line(range(-180, 180, 5).map((a) => direction(a, elevation * RADIANS)), elevation === 0);
  const { ahead, left, right, behind } = words.panorama.axes;
  for (const [azimuth, name] of [[0, ahead], [90, left], [-90, right], [180, behind]] as const)
    for (const [x, y] of places(to, apply(view_R_body, direction(azimuth * RADIANS, 0)), 0))
      label(context, name, x + 5 * u, y - 9 * u, u, "rgba(255, 255, 255, 0.85)", false);
}

/** The outline of what the other view shows. */
function drawGaze(context: CanvasRenderingContext2D, to: Projection, gaze: NonNullable<Marks["gaze"]>, u: number): void {
  const high = Math.tan(gaze.field / 2);
  const wide = high * gaze.aspect;
  const outline: Vector[] = [];
  const count = 24;
  const corners: [number, number][] = [[-wide, high], [wide, high], [wide, -high], [-wide, -high], [-wide, high]];
  for (let side = 0; side < 4; side++)
    for (let i = 0; i < count; i++) {
      const [a, b] = [corners[side], corners[side + 1]];
      const t = i / count;
      const ray: Vector = [1, -(a[0] + t * (b[0] - a[0])), a[1] + t * (b[1] - a[1])];
      const length = Math.sqrt(dot(ray, ray));
      outline.push(apply(gaze.view_R_gaze, [ray[0] / length, ray[1] / length, ray[2] / length]));
    }
  outline.push(outline[0]);
  context.setLineDash([5 * u, 4 * u]);
  context.strokeStyle = "rgba(255, 255, 255, 0.75)";
  context.lineWidth = 1.3 * u;
  for (const piece of pieces(to, outline)) {
    trace(context, piece);
    context.stroke();
  }
  context.setLineDash([]);
}

function ring(context: CanvasRenderingContext2D, x: number, y: number, radius: number, colour: string, width: number): void {
  for (const [style, wide] of [[DARK, width + 2.2], [colour, width]] as const) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.stroke();
  }
}

function tick(
  context: CanvasRenderingContext2D, x: number, y: number, from: number, past: number, turn: number, colour: string, width: number,
): void {
  const [c, s] = [Math.cos(turn), Math.sin(turn)];
  for (const [style, wide] of [[DARK, width + 2], [colour, width]] as const) {
    context.beginPath();
    context.moveTo(x + from * c, y + from * s);
    context.lineTo(x + past * c, y + past * s);
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.stroke();
  }
}

function spot(context: CanvasRenderingContext2D, x: number, y: number, radius: number, colour: string, u: number): void {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = colour;
  context.fill();
  context.strokeStyle = DARK;
  context.lineWidth = 1.6 * u;
  context.stroke();
}

/** The mark of another method. */
export function shaped(
  context: CanvasRenderingContext2D, shape: Shape, x: number, y: number, r: number, colour: string, u: number,
): void {
  const outlines: Record<Shape, [number, number][]> = {
    square: [[-1, -1], [1, -1], [1, 1], [-1, 1]],
    diamond: [[0, -1.3], [1.2, 0], [0, 1.3], [-1.2, 0]],
    up: [[0, -1.3], [1.2, 0.9], [-1.2, 0.9]],
    down: [[0, 1.3], [1.2, -0.9], [-1.2, -0.9]],
    left: [[-1.3, 0], [0.9, -1.2], [0.9, 1.2]],
    right: [[1.3, 0], [-0.9, -1.2], [-0.9, 1.2]],
    plus: [[-0.45, -1.2], [0.45, -1.2], [0.45, -0.45], [1.2, -0.45], [1.2, 0.45], [0.45, 0.45], [0.45, 1.2],
      [-0.45, 1.2], [-0.45, 0.45], [-1.2, 0.45], [-1.2, -0.45], [-0.45, -0.45]],
    cross: [[-0.6, -1.2], [0, -0.6], [0.6, -1.2], [1.2, -0.6], [0.6, 0], [1.2, 0.6], [0.6, 1.2], [0, 0.6],
      [-0.6, 1.2], [-1.2, 0.6], [-0.6, 0], [-1.2, -0.6]],
    star: [[0, -1.4], [0.35, -0.49], [1.33, -0.43], [0.57, 0.19], [0.82, 1.13],
      [0, 0.6], [-0.82, 1.13], [-0.57, 0.19], [-1.33, -0.43], [-0.35, -0.49]],
  };
  context.beginPath();
  outlines[shape].forEach(([a, b], i) => (i ? context.lineTo(x + r * a, y + r * b) : context.moveTo(x + r * a, y + r * b)));
  context.closePath();
  context.fillStyle = colour;
  context.fill();
  context.strokeStyle = DARK;
  context.lineWidth = 1.5 * u;
  context.stroke();
}

function label(
  context: CanvasRenderingContext2D, text: string, x: number, y: number, u: number, colour = "#ffffff", strong = true,
): void {
  context.font = `${strong ? 600 : 500} ${Math.round(12 * u)}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  context.lineWidth = 3.2 * u;
  context.strokeStyle = "rgba(8, 10, 16, 0.65)";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}
