/** What an ordinary camera has shown so far, pasted together where it looked: a panorama in the axes of the world. */

import { apply, direction, inverse, times, type Matrix, type Vector } from "../math/rotation";
import type { Lens } from "../wire/messages";

const [COLUMNS, ROWS] = [512, 256];
const SMALL = 320; // columns of a picture that is pasted, at most
const DARK = "#14171d";

export class Mosaic {
  readonly canvas = document.createElement("canvas");
  private readonly small = document.createElement("canvas");
  private readonly directions: Vector[] = [];

  constructor() {
    [this.canvas.width, this.canvas.height] = [COLUMNS, ROWS];
    for (let row = 0; row < ROWS; row++)
      for (let column = 0; column < COLUMNS; column++)
        this.directions.push(direction((0.5 - (column + 0.5) / COLUMNS) * 2 * Math.PI, (0.5 - (row + 0.5) / ROWS) * Math.PI));
    this.clear();
  }

  clear(): void {
    const sheet = this.canvas.getContext("2d")!;
    sheet.fillStyle = DARK;
    sheet.fillRect(0, 0, COLUMNS, ROWS);
  }

  /** A newer picture covers older ones. */
  paste(image: CanvasImageSource & { width: number; height: number }, lens: Lens, world_R_body: Matrix): void {
    const width = Math.min(SMALL, image.width);
    const height = Math.max(1, Math.round((width * image.height) / image.width));
    [this.small.width, this.small.height] = [width, height];
    const from = this.small.getContext("2d", { willReadFrequently: true })!;
    from.drawImage(image, 0, 0, width, height);
    const pixels = new Uint32Array(from.getImageData(0, 0, width, height).data.buffer);
    const sheet = this.canvas.getContext("2d", { willReadFrequently: true })!;
    const whole = sheet.getImageData(0, 0, COLUMNS, ROWS);
    const cells = new Uint32Array(whole.data.buffer);
    const view_R_world = inverse(times(world_R_body, lens.body_R_view));
    const [wide, high] = lens.plane;
    this.directions.forEach((d, at) => {
      const [x, y, z] = apply(view_R_world, d);
      if (x <= 0 || Math.abs(y) >= x * wide || Math.abs(z) >= x * high) return;
      const column = Math.floor((0.5 - y / (2 * x * wide)) * width);
      cells[at] = pixels[Math.floor((0.5 - z / (2 * x * high)) * height) * width + column];
    });
    sheet.putImageData(whole, 0, 0);
  }
}
