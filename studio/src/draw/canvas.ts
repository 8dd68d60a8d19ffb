/** Canvases as sharp as the screen, and the colours of the theme. */

export interface Sheet {
  context: CanvasRenderingContext2D;
  width: number; // CSS pixels
  height: number;
  rem: number;
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
  return { context, width, height, rem: remSize() };
}

let rem = 0;
let colours: Record<string, string> = {};

/** The theme or the size of the window has changed. */
export function forgetStyle(): void {
  rem = 0;
  colours = {};
}

export function remSize(): number {
  return (rem ||= parseFloat(getComputedStyle(document.documentElement).fontSize) || 16);
}

/** A colour of the theme, by the name of its variable in style.css. */
export function themed(name: string): string {
  return (colours[name] ??= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim() || "#888");
}

export function font(sheet: Sheet, size: number, weight = 400): string {
  return `${weight} ${(size * sheet.rem) / 16}px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif`;
}
