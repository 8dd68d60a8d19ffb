/** The belief by azimuth, seen from above: ahead is at the top, left on the left. */

import type { Point } from "../math/projection";
import { azimuthOf, type Vector } from "../math/rotation";
import { words } from "../words";
import { disc, paint, polyline, sheetOf, themed, write } from "./canvas";
import { rivalMark } from "./palette";

export const BINS = 64; // of azimuth, as the server has them

export interface Polar {
  share: number[] | null; // of the belief, by bins of azimuth from ahead to the left
  answer: Vector | null;
  modes: { direction: Vector; weight: number }[];
  truth: Vector | null;
  rivals: { direction: Vector; index: number }[];
  gaze: { azimuth: number; wide: number };
  worldX: number | null; // azimuth of the world's x axis
}

/** How much of the belief lies within `bins` bins of one. */
export function around(share: number[], centre: number, bins: number): number {
  let total = 0;
  for (let k = -bins; k <= bins; k++) total += share[(centre + k + BINS) % BINS];
  return total;
}

export function drawPolar(canvas: HTMLCanvasElement, polar: Polar): void {
  const sheet = sheetOf(canvas);
  if (!sheet) return;
  const { context, width, height, u } = sheet;
  const middle: Point = [width / 2, height / 2];
  const outer = Math.min(width, height) / 2 - 24 * u;
  const inner = outer * 0.3;
  const at = (azimuth: number, radius: number): Point => [
    middle[0] - radius * Math.sin(azimuth), middle[1] - radius * Math.cos(azimuth),
  ];
  const { gaze } = polar;
  const rim = Array.from({ length: 25 }, (_, k) => at(gaze.azimuth + gaze.wide * (k / 24 - 0.5), outer));
  polyline(context, [middle, ...rim], { fill: themed("wedge") });
  for (const radius of [inner, outer]) disc(context, middle, radius, { stroke: themed("rule") });
  for (let k = 0; k < 24; k++) {
    const turn = (k * Math.PI) / 12;
    polyline(context, [at(turn, outer), at(turn, outer - (k % 6 ? 4 : 9) * u)], { stroke: themed("rule") });
  }
  if (polar.share) drawShare(polar.share);
  const { ahead, left, right, behind } = words.panorama.axes;
  const [x, y] = middle;
  const named = { size: 12, colour: themed("quiet") };
  write(context, ahead, [x, y - outer - 12 * u], u, { ...named, align: "center" });
  write(context, behind, [x, y + outer + 13 * u], u, { ...named, align: "center" });
  write(context, left, [x - outer - 6 * u, y], u, { ...named, align: "right" });
  write(context, right, [x + outer + 6 * u, y], u, named);
  if (polar.worldX !== null) {
    write(context, "x", at(polar.worldX, inner - 9 * u), u, { size: 11, weight: 600, colour: themed("quiet"), align: "center" });
    polyline(context, [at(polar.worldX, inner - 2 * u), at(polar.worldX, inner + 3 * u)], { stroke: themed("quiet"), width: 1.5 * u });
  }
  polyline(context, [at(0, 8 * u), at(2.5, 8 * u), at(-2.5, 8 * u)], { fill: themed("ink") }); // the camera
  for (const { direction, index } of polar.rivals) rivalMark(context, index, at(azimuthOf(direction), outer), 4.6 * u);
  for (const { direction, weight } of polar.modes)
    disc(context, at(azimuthOf(direction), outer), (3 + 5 * Math.sqrt(weight)) * u, { stroke: themed("ink"), width: 1.5 * u });
  if (polar.truth) disc(context, at(azimuthOf(polar.truth), outer), 9 * u, { stroke: themed("truth"), width: 2.4 * u });
  if (polar.answer) {
    const [azimuth, colour] = [azimuthOf(polar.answer), themed("answer")];
    polyline(context, [at(azimuth, inner * 0.5), at(azimuth, outer)], { stroke: colour, width: 2.4 * u });
    disc(context, at(azimuth, outer), 5 * u, { fill: colour, stroke: colour, width: 2.4 * u });
  }

  function drawShare(share: number[]): void {
    const most = Math.max(...share, 1e-9);
    const edge = share.map((one, k) => at((k / BINS) * 2 * Math.PI, inner + (outer - inner) * 0.94 * Math.sqrt(one / most)));
    const between = (k: number): Point => {
      const [a, b] = [edge[k % BINS], edge[(k + 1) % BINS]];
      return [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    };
    const fill = context.createRadialGradient(...middle, inner, ...middle, outer);
    fill.addColorStop(0, themed("heat-low"));
    fill.addColorStop(1, themed("heat-high"));
    const alpha = 0.2 + 0.8 * (1 - 1 / (BINS * most)); // a belief that is nearly uniform hardly glows
    paint(context, { fill, alpha }, () => {
      context.moveTo(...between(0));
      for (let k = 1; k <= BINS; k++) context.quadraticCurveTo(...edge[k % BINS], ...between(k));
      context.closePath();
      context.arc(...middle, inner, 0, 2 * Math.PI, true);
    }, "evenodd");
  }
}
