/** The belief by azimuth, seen from above: ahead is at the top, left on the left. */

import type { Heat } from "../math/heat";
import { azimuthOf, type Matrix, type Vector } from "../math/rotation";
import { words } from "../words";
import { font, sheetOf, themed } from "./canvas";
import { shaped } from "./marks";
import { RIVALS } from "./palette";

export const BINS = 64; // a power of two, as the columns are: a uniform belief then is a circle
const FAINT = 1e-6; // of the highest density: what is less is left out

export interface Polar {
  share: Float32Array | null; // of the belief, by bins of azimuth from 0 to 360 degrees left
  answer: Vector | null;
  modes: { direction: Vector; weight: number }[];
  truth: Vector | null;
  rivals: { direction: Vector; index: number }[];
  gaze: { azimuth: number; wide: number };
  worldX: number | null; // azimuth of the world's x axis
}

/** The belief in bins of the camera's azimuth. */
export function byAzimuth(heat: Heat, body_R_belief: Matrix): Float32Array {
  const { lattice, values } = heat.fine ?? heat.coarse;
  const columns = lattice.azimuths.length;
  const [cosines, sines] = [lattice.azimuths.map(Math.cos), lattice.azimuths.map(Math.sin)];
  const m = body_R_belief;
  const share = new Float32Array(BINS);
  let all = 0;
  for (let i = 0; i < lattice.elevations.length; i++) {
    const [level, z] = [Math.cos(lattice.elevations[i]), Math.sin(lattice.elevations[i])];
    for (let j = 0; j < columns; j++) {
      const mass = values[i * columns + j] * level;
      if (mass < FAINT * heat.highest) continue;
      const x = level * (m[0] * cosines[j] + m[1] * sines[j]) + m[2] * z;
      const y = level * (m[3] * cosines[j] + m[4] * sines[j]) + m[5] * z;
      const place = (Math.atan2(y, x) / (2 * Math.PI) + 1) * BINS; // shared out between the two bins around it
      const first = Math.floor(place);
      share[first % BINS] += (1 - place + first) * mass;
      share[(first + 1) % BINS] += (place - first) * mass;
      all += mass;
    }
  }
  return share.map((mass) => mass / all);
}

/** How much of the belief lies within `bins` bins of one. */
export function around(share: Float32Array, centre: number, bins: number): number {
  let total = 0;
  for (let k = -bins; k <= bins; k++) total += share[(centre + k + BINS) % BINS];
  return total;
}

export function drawPolar(canvas: HTMLCanvasElement, polar: Polar): void {
  const sheet = sheetOf(canvas);
  if (!sheet) return;
  const { context, width, height, rem } = sheet;
  const u = rem / 16;
  const [cx, cy] = [width / 2, height / 2];
  const outer = Math.min(width, height) / 2 - 24 * u;
  const inner = outer * 0.3;
  const at = (azimuth: number, radius: number): [number, number] => [
    cx - radius * Math.sin(azimuth), cy - radius * Math.cos(azimuth),
  ];
  // What is looked at.
  context.beginPath();
  context.moveTo(cx, cy);
  for (let k = 0; k <= 24; k++) context.lineTo(...at(polar.gaze.azimuth + polar.gaze.wide * (k / 24 - 0.5), outer));
  context.closePath();
  context.fillStyle = themed("wedge");
  context.fill();
  context.lineWidth = 1;
  for (const radius of [inner, outer]) {
    context.beginPath();
    context.arc(cx, cy, radius, 0, 2 * Math.PI);
    context.strokeStyle = themed("rule");
    context.stroke();
  }
  for (let k = 0; k < 24; k++) {
    context.beginPath();
    context.moveTo(...at((k * Math.PI) / 12, outer));
    context.lineTo(...at((k * Math.PI) / 12, outer - (k % 6 ? 4 : 9) * u));
    context.stroke();
  }
  if (polar.share) {
    const most = polar.share.reduce((a, b) => Math.max(a, b), 1e-9);
    context.beginPath();
    const edge = Array.from(polar.share, (share, k) =>
      at((k / BINS) * 2 * Math.PI, inner + (outer - inner) * 0.94 * Math.sqrt(share / most)));
    const middle = (k: number): [number, number] => {
      const [a, b] = [edge[k % BINS], edge[(k + 1) % BINS]];
      return [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    };
    context.moveTo(...middle(0));
    for (let k = 1; k <= BINS; k++) context.quadraticCurveTo(...edge[k % BINS], ...middle(k));
    context.closePath();
    context.arc(cx, cy, inner, 0, 2 * Math.PI, true);
    const glow = context.createRadialGradient(cx, cy, inner, cx, cy, outer);
    glow.addColorStop(0, themed("heat-low"));
    glow.addColorStop(1, themed("heat-high"));
    context.fillStyle = glow;
    context.globalAlpha = 0.2 + 0.8 * (1 - 1 / (BINS * most)); // a belief that is nearly uniform hardly glows
    context.fill("evenodd");
    context.globalAlpha = 1;
  }
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillStyle = themed("quiet");
  context.font = font(sheet, 12);
  const { ahead, left, right, behind } = words.panorama.axes;
  context.fillText(ahead, cx, cy - outer - 12 * u);
  context.fillText(behind, cx, cy + outer + 13 * u);
  context.textAlign = "right";
  context.fillText(left, cx - outer - 6 * u, cy);
  context.textAlign = "left";
  context.fillText(right, cx + outer + 6 * u, cy);
  context.textAlign = "center";
  if (polar.worldX !== null) {
    context.font = font(sheet, 11, 600);
    context.fillText("x", ...at(polar.worldX, inner - 9 * u));
    context.beginPath();
    context.moveTo(...at(polar.worldX, inner - 2 * u));
    context.lineTo(...at(polar.worldX, inner + 3 * u));
    context.strokeStyle = themed("quiet");
    context.lineWidth = 1.5 * u;
    context.stroke();
  }
  // The camera.
  context.beginPath();
  context.moveTo(...at(0, 8 * u));
  context.lineTo(...at(2.5, 8 * u));
  context.lineTo(...at(-2.5, 8 * u));
  context.closePath();
  context.fillStyle = themed("ink");
  context.fill();
  for (const { direction: d, index } of polar.rivals) {
    const { shape, colour } = RIVALS[index % RIVALS.length];
    shaped(context, shape, ...at(azimuthOf(d), outer), 4.6 * u, colour, u);
  }
  for (const { direction: d, weight } of polar.modes) {
    context.beginPath();
    context.arc(...at(azimuthOf(d), outer), (3 + 5 * Math.sqrt(weight)) * u, 0, 2 * Math.PI);
    context.strokeStyle = themed("ink");
    context.lineWidth = 1.5 * u;
    context.stroke();
  }
  if (polar.truth) {
    context.beginPath();
    context.arc(...at(azimuthOf(polar.truth), outer), 9 * u, 0, 2 * Math.PI);
    context.strokeStyle = themed("truth");
    context.lineWidth = 2.4 * u;
    context.stroke();
  }
  if (polar.answer) {
    const azimuth = azimuthOf(polar.answer);
    context.beginPath();
    context.moveTo(...at(azimuth, inner * 0.5));
    context.lineTo(...at(azimuth, outer));
    context.strokeStyle = themed("answer");
    context.lineWidth = 2.4 * u;
    context.stroke();
    context.beginPath();
    context.arc(...at(azimuth, outer), 5 * u, 0, 2 * Math.PI);
    context.fillStyle = themed("answer");
    context.fill();
    context.stroke();
  }
}
