/** The ground plan: walls, things, the path so far, and where the answer lies. */

import type { Point } from "../math/projection";
import type { Plan } from "../wire/messages";
import { words } from "../words";
import { arrow, disc, paint, polyline, sheetOf, themed, write } from "./canvas";

export interface Ground {
  plan: Plan | null;
  others: { path: number[][]; colour: string }[]; // the ways of other methods
  path: number[][]; // positions in the world, metres
  heading: number; // of the camera in the world, radians
  gaze: { azimuth: number; wide: number }; // in the world
  answer: { azimuth: number; range: Interval | null } | null; // in the world
  goal: number[] | null;
}

export interface Interval {
  near: number;
  middle: number;
  far: number;
}

/** The 90 % interval of a distance and its median; null where even the order of magnitude is open. */
export function interval(distance: number | null | undefined, spread: number | null | undefined): Interval | null {
  if (distance == null || spread == null) return null;
  const half = 1.645 * spread; // standard deviations on either side that hold 90 % of a normal distribution
  if (2 * half > Math.log(10)) return null;
  const middle = distance * Math.exp((-spread * spread) / 2);
  return { near: middle * Math.exp(-half), middle, far: middle * Math.exp(half) };
}

export function drawPlan(canvas: HTMLCanvasElement, ground: Ground): void {
  const sheet = sheetOf(canvas);
  if (!sheet) return;
  const { context, width, height, u } = sheet;
  const [low, high] = bounds(ground);
  const [margin, foot] = [14 * u, 12 * u]; // the foot is for the length of a metre
  const scale = Math.min((width - 2 * margin) / (high[0] - low[0]), (height - foot - 2 * margin) / (high[1] - low[1]));
  const at = (p: number[]): Point => [
    width / 2 + (p[0] - (low[0] + high[0]) / 2) * scale, (height - foot) / 2 - (p[1] - (low[1] + high[1]) / 2) * scale,
  ];
  for (const polygon of ground.plan?.floor ?? []) polyline(context, polygon.map(at), { fill: themed("floor") });
  for (const { low: a, high: b, target } of ground.plan?.things ?? []) {
    const box = [a, [b[0], a[1]], b, [a[0], b[1]], a].map(at);
    polyline(context, box, target ? { fill: themed("target"), stroke: themed("truth"), width: 2 * u } : { fill: themed("thing") });
  }
  for (const line of ground.plan?.walls ?? []) polyline(context, line.map(at), { stroke: themed("wall"), width: 1.4 * u });
  for (const { path, colour } of ground.others)
    polyline(context, path.map(at), { stroke: colour, width: 1.8 * u, dash: [4 * u, 3 * u] });
  const position = ground.path.at(-1);
  if (position) {
    const here = at(position);
    const { azimuth, wide } = ground.gaze;
    paint(context, { fill: themed("wedge") }, () => {
      context.moveTo(...here);
      context.arc(...here, 34 * u, -azimuth - wide / 2, -azimuth + wide / 2);
    });
    polyline(context, ground.path.map(at), { stroke: themed("path"), width: 2.4 * u });
    if (ground.answer) {
      const { azimuth: toward, range } = ground.answer;
      const along = (metres: number) => at([position[0] + metres * Math.cos(toward), position[1] + metres * Math.sin(toward)]);
      const stroke = themed("answer");
      const end = along(range?.far ?? Math.max(width, height) / scale);
      polyline(context, [here, end], { stroke, width: 1.6 * u, dash: [3 * u, 4 * u] });
      if (range) {
        polyline(context, [along(range.near), end], { stroke, width: 6 * u, alpha: 0.45 });
        disc(context, along(range.middle), 4.5 * u, { fill: stroke });
      }
    }
    if (ground.goal) {
      const [x, y] = at(ground.goal);
      for (const sign of [-5 * u, 5 * u])
        polyline(context, [[x - 5 * u, y - sign], [x + 5 * u, y + sign]], { stroke: themed("ink"), width: 2 * u });
    }
    arrow(context, here, -ground.heading, 10 * u, { fill: themed("ink"), stroke: themed("panel"), width: 1.5 * u });
  }
  const level = height - 8 * u;
  polyline(context, [[margin, level], [margin + scale, level]], { stroke: themed("quiet"), width: 2 * u });
  write(context, words.plan.metre, [margin + scale + 5 * u, level], u, { size: 11, colour: themed("quiet") });
}

function bounds({ plan, path }: Ground): [number[], number[]] {
  const points = [...path, ...(plan ? [...plan.walls.flat(), ...plan.floor.flat(), ...plan.things.flatMap(({ low, high }) => [low, high])] : [])];
  if (!points.length) return [[-2, -2], [2, 2]];
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [x0, x1] = [Math.min(...xs), Math.max(...xs)];
  const [y0, y1] = [Math.min(...ys), Math.max(...ys)];
  const room = Math.max(0, 4 - Math.max(x1 - x0, y1 - y0)) / 2; // at least 4 m, so that a short path looks short
  return [[x0 - room, y0 - room], [x1 + room, y1 + room]];
}
