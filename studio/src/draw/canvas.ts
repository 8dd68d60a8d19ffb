/** Canvases as sharp as the screen, the colours of the theme, and strokes. */

import type { Point } from "../math/projection";

export interface Sheet {
  context: CanvasRenderingContext2D;
  width: number; // CSS pixels
  height: number;
  u: number; // a pixel of the design, for the size of the text
}

/** The canvas cleared, with as many pixels as the screen has for it; null while it is hidden. */
export function sheetOf(canvas: HTMLCanvasElement): Sheet | null {
  const { clientWidth: width, clientHeight: height } = canvas;
  if (!width || !height) return null;
  const ratio = Math.min(3, window.devicePixelRatio || 1);
  const [columns, rows] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== columns) canvas.width = columns;
  if (canvas.height !== rows) canvas.height = rows;
  const context = canvas.getContext("2d")!;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.lineJoin = context.lineCap = "round";
  return { context, width, height, u: unit() };
}

let known = 0;
let colours: Record<string, string> = {};

/** The theme or the size of the window has changed. */
export function forgetStyle(): void {
  known = 0;
  colours = {};
}

/** CSS pixels that a pixel of the design has. */
export function unit(): number {
  return (known ||= (parseFloat(getComputedStyle(document.documentElement).fontSize) || 16) / 16);
}

/** A colour of the theme, by the name of its variable in style.css. */
export function themed(name: string): string {
  return (colours[name] ??= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim() || "#888");
}

export interface Style {
  fill?: string | CanvasGradient;
  stroke?: string;
  width?: number;
  dash?: number[];
  alpha?: number;
}

/** Fills and strokes the path that `trace` draws. */
export function paint(context: CanvasRenderingContext2D, style: Style, trace: () => void, rule?: CanvasFillRule): void {
  const { fill, stroke, width = 1, dash = [], alpha = 1 } = style;
  context.globalAlpha = alpha;
  context.beginPath();
  trace();
  if (fill) {
    context.fillStyle = fill;
    context.fill(rule);
  }
  if (stroke) {
    context.strokeStyle = stroke;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.stroke();
    context.setLineDash([]);
  }
  context.globalAlpha = 1;
}

export function polyline(context: CanvasRenderingContext2D, points: readonly Point[], style: Style): void {
  paint(context, style, () => points.forEach((p, i) => (i ? context.lineTo(...p) : context.moveTo(...p))));
}

export function disc(context: CanvasRenderingContext2D, [x, y]: Point, radius: number, style: Style): void {
  paint(context, style, () => context.arc(x, y, radius, 0, 2 * Math.PI));
}

/** An arrow head at a point, `turn` radians clockwise from the right. */
export function arrow(context: CanvasRenderingContext2D, [x, y]: Point, turn: number, size: number, style: Style): void {
  const [c, s] = [Math.cos(turn) * size, Math.sin(turn) * size];
  const corners = [[1, 0], [-0.6, 0.7], [-0.25, 0], [-0.6, -0.7], [1, 0]];
  polyline(context, corners.map(([a, b]): Point => [x + a * c - b * s, y + a * s + b * c]), style);
}

export interface Type {
  size: number;
  colour: string;
  weight?: number;
  align?: CanvasTextAlign;
  outline?: string;
}

export function write(context: CanvasRenderingContext2D, text: string, [x, y]: Point, u: number, type: Type): void {
  const { size, colour, weight = 400, align = "left", outline } = type;
  context.font = `${weight} ${size * u}px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif`;
  context.textAlign = align;
  context.textBaseline = "middle";
  if (outline) {
    context.lineWidth = 3.2 * u;
    context.strokeStyle = outline;
    context.strokeText(text, x, y);
  }
  context.fillStyle = colour;
  context.fillText(text, x, y);
}
