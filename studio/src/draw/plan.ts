/** The ground plan: walls, things, the path so far, and where the answer lies. */

import type { Plan } from "../wire/messages";
import { words } from "../words";
import { font, sheetOf, themed } from "./canvas";

export interface Ground {
  plan: Plan | null;
  others: { path: number[][]; colour: string }[]; // the ways of other methods
  path: number[][]; // positions in the world, metres
  heading: number; // of the camera in the world, radians
  gaze: { azimuth: number; wide: number }; // in the world
  answer: { azimuth: number; near: number | null; far: number | null; middle: number | null } | null; // in the world
  goal: number[] | null;
}

/** The 90 % interval of a distance and its median; nulls where even the order of magnitude is open. */
export function interval(distance: number | null, spread: number | null): { near: number; middle: number; far: number } | null {
  if (distance === null || spread === null) return null;
  const half = 1.645 * spread; // standard deviations on either side that hold 90 % of a normal distribution
  if (2 * half > Math.log(10)) return null;
  const middle = distance * Math.exp((-spread * spread) / 2);
  return { near: middle * Math.exp(-half), middle, far: middle * Math.exp(half) };
}

export function drawPlan(canvas: HTMLCanvasElement, ground: Ground): void {
  const sheet = sheetOf(canvas);
  if (!sheet) return;
  const { context, width, height, rem } = sheet;
  const u = rem / 16;
  const [low, high] = bounds(ground);
  const margin = 14 * u;
  const foot = 12 * u; // for the length of a metre
  const scale = Math.min((width - 2 * margin) / (high[0] - low[0]), (height - foot - 2 * margin) / (high[1] - low[1]));
  const at = (p: number[]): [number, number] => [
    width / 2 + (p[0] - (low[0] + high[0]) / 2) * scale, (height - foot) / 2 - (p[1] - (low[1] + high[1]) / 2) * scale,
  ];
  const outline = (line: number[][]) => {
    context.beginPath();
    line.forEach((p, i) => (i ? context.lineTo(...at(p)) : context.moveTo(...at(p))));
  };
  context.lineJoin = "round";
  if (ground.plan) {
    for (const polygon of ground.plan.floor) {
      outline(polygon);
      context.fillStyle = themed("floor");
      context.fill();
    }
    for (const { low: a, high: b, target } of ground.plan.things) {
      outline([a, [b[0], a[1]], b, [a[0], b[1]], a]);
      context.fillStyle = themed(target ? "target" : "thing");
      context.fill();
      if (target) {
        context.strokeStyle = themed("truth");
        context.lineWidth = 2 * u;
        context.stroke();
      }
    }
    context.strokeStyle = themed("wall");
    context.lineWidth = 1.4 * u;
    context.beginPath();
    for (const line of ground.plan.walls) line.forEach((p, i) => (i ? context.lineTo(...at(p)) : context.moveTo(...at(p))));
    context.stroke();
  }
  for (const { path, colour } of ground.others) {
    if (path.length < 2) continue;
    outline(path);
    context.strokeStyle = colour;
    context.lineWidth = 1.8 * u;
    context.setLineDash([4 * u, 3 * u]);
    context.stroke();
    context.setLineDash([]);
  }
  const here = ground.path.at(-1);
  if (here) {
    const [x, y] = at(here);
    wedge(context, x, y, ground.gaze.azimuth, ground.gaze.wide, 34 * u, themed("wedge"));
    if (ground.path.length > 1) {
      outline(ground.path);
      context.strokeStyle = themed("path");
      context.lineWidth = 2.4 * u;
      context.stroke();
    }
    if (ground.answer) drawAnswer(context, here, ground.answer, at, scale, u, Math.max(width, height));
    if (ground.goal) {
      const [gx, gy] = at(ground.goal);
      context.strokeStyle = themed("ink");
      context.lineWidth = 2 * u;
      for (const sign of [-1, 1]) {
        context.beginPath();
        context.moveTo(gx - 5 * u, gy - sign * 5 * u);
        context.lineTo(gx + 5 * u, gy + sign * 5 * u);
        context.stroke();
      }
    }
    context.save();
    context.translate(x, y);
    context.rotate(-ground.heading);
    context.beginPath();
    context.moveTo(10 * u, 0);
    context.lineTo(-6 * u, 6.5 * u);
    context.lineTo(-3 * u, 0);
    context.lineTo(-6 * u, -6.5 * u);
    context.closePath();
    context.fillStyle = themed("ink");
    context.fill();
    context.strokeStyle = themed("panel");
    context.lineWidth = 1.5 * u;
    context.stroke();
    context.restore();
  }
  // How long a metre is.
  context.strokeStyle = context.fillStyle = themed("quiet");
  context.lineWidth = 2 * u;
  context.beginPath();
  context.moveTo(margin, height - 8 * u);
  context.lineTo(margin + scale, height - 8 * u);
  context.stroke();
  context.font = font(sheet, 11);
  context.textBaseline = "middle";
  context.fillText(words.plan.metre, margin + scale + 5 * u, height - 8 * u);
}

function drawAnswer(
  context: CanvasRenderingContext2D, here: number[], answer: NonNullable<Ground["answer"]>,
  at: (p: number[]) => [number, number], scale: number, u: number, most: number,
): void {
  const [c, s] = [Math.cos(answer.azimuth), Math.sin(answer.azimuth)];
  const along = (metres: number): [number, number] => at([here[0] + metres * c, here[1] + metres * s]);
  context.strokeStyle = themed("answer");
  context.setLineDash([3 * u, 4 * u]);
  context.lineWidth = 1.6 * u;
  context.beginPath();
  context.moveTo(...at(here));
  context.lineTo(...along(answer.far ?? most / scale));
  context.stroke();
  context.setLineDash([]);
  if (answer.near === null || answer.far === null || answer.middle === null) return;
  context.lineWidth = 6 * u;
  context.globalAlpha = 0.45;
  context.beginPath();
  context.moveTo(...along(answer.near));
  context.lineTo(...along(answer.far));
  context.stroke();
  context.globalAlpha = 1;
  context.beginPath();
  context.arc(...along(answer.middle), 4.5 * u, 0, 2 * Math.PI);
  context.fillStyle = themed("answer");
  context.fill();
}

function wedge(
  context: CanvasRenderingContext2D, x: number, y: number, azimuth: number, wide: number, radius: number, colour: string,
): void {
  context.beginPath();
  context.moveTo(x, y);
  context.arc(x, y, radius, -azimuth - wide / 2, -azimuth + wide / 2);
  context.closePath();
  context.fillStyle = colour;
  context.fill();
}

function bounds(ground: Ground): [number[], number[]] {
  const points = ground.plan
    ? [...ground.plan.walls.flat(), ...ground.plan.floor.flat(), ...ground.plan.things.flatMap(({ low, high }) => [low, high])]
    : ground.path;
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of [...points, ...ground.path]) {
    [x0, y0] = [Math.min(x0, x), Math.min(y0, y)];
    [x1, y1] = [Math.max(x1, x), Math.max(y1, y)];
  }
  if (!(x1 >= x0)) return [[-2, -2], [2, 2]];
  const room = Math.max(0, 4 - Math.max(x1 - x0, y1 - y0)) / 2; // at least 4 m, so that a short path looks short
  return [[x0 - room, y0 - room], [x1 + room, y1 + room]];
}
