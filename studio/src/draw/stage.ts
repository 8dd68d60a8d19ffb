/** The panorama twice, from inside and flat, with the belief and the marks: who looks where, and when to draw. */

import { flat, lookThatHolds, perspective, type Point, type Projection } from "../math/projection";
import {
  apply, azimuthOf, between, direction as directionOf, elevationOf, IDENTITY, inverse, pose, times, wrapped, type Matrix, type Vector,
} from "../math/rotation";
import type { Store } from "../store";
import type { Lens } from "../wire/messages";
import { sheetOf } from "./canvas";
import { Mosaic } from "./mosaic";
import { drawMarks, type Marks } from "./marks";
import { Pace } from "./pace";
import { Sphere, type Camera } from "./sphere";

const FIELDS: readonly [number, number] = [0.35, 2.1];
const STEEPEST = 1.5;
const QUICK = 0.25; // of the way to the answer per step
const CALM = 0.02; // radians
const UNSEEN = 0.01; // radians or metres: so small a movement is drawn finely
const POLL = 16; // milliseconds from one look at whether a drawing is finished to the next

interface Pair {
  sphere: Sphere | null;
  canvas: HTMLCanvasElement;
  overlay: HTMLCanvasElement;
}

export class Stage {
  readonly inside: Pair;
  readonly flat: Pair;
  readonly pace: Pace;
  readonly broken: boolean;
  follows = false; // the view stays with the answer, until a person looks elsewhere
  private mosaic: Mosaic | null = null; // of an ordinary camera
  private mosaicOf = "";
  private mosaicUntil = 0; // stamp of the newest picture in it
  private drawnFrom: number[] = []; // where the camera was, and where one looked, when they moved last
  private textures: object | null = null; // what glows on the spheres
  private begun = 0;

  constructor(
    private readonly store: Store,
    inside: [HTMLCanvasElement, HTMLCanvasElement],
    flatly: [HTMLCanvasElement, HTMLCanvasElement],
  ) {
    const pair = ([canvas, overlay]: [HTMLCanvasElement, HTMLCanvasElement]): Pair => {
      let sphere: Sphere | null = null;
      try {
        sphere = new Sphere(canvas);
      } catch {
        // Without WebGL 2 the marks, the plots and the words are left.
      }
      return { canvas, overlay, sphere };
    };
    [this.inside, this.flat] = [pair(inside), pair(flatly)];
    this.broken = !this.inside.sphere || !this.flat.sphere;
    this.pace = new Pace((scale) => this.draw(scale), () => this.finished());
    for (const { canvas } of [this.inside, this.flat])
      canvas.addEventListener("webglcontextrestored", () => {
        this.textures = null; // all that was uploaded is gone
        store.emit("panorama");
      });
    store.on("step", () => this.follow());
    for (const topic of ["scene", "step", "look", "layers", "style"] as const) store.on(topic, () => this.request());
    store.on("panorama", () => {
      const image = store.panorama?.image ?? null;
      this.inside.sphere?.panorama(image);
      this.flat.sphere?.panorama(image && this.pasted(image));
      this.request();
    });
  }

  /** The lens of an ordinary camera, whose pictures are shown as they are; null for panoramas. */
  get lens(): Lens | null {
    return this.store.scene?.lens ?? null;
  }

  /** What the map shows: a panorama, or what an ordinary camera has shown so far. */
  private pasted(image: TexImageSource): TexImageSource {
    const { lens } = this;
    const { panorama, scene } = this.store;
    if (!lens || !panorama || !(image instanceof ImageBitmap || image instanceof HTMLImageElement)) return image;
    this.mosaic ??= new Mosaic();
    const of = JSON.stringify([scene?.title, lens]);
    const { stamp } = panorama.head;
    if (of !== this.mosaicOf || stamp < this.mosaicUntil) this.mosaic.clear(); // a recording may be played again
    [this.mosaicOf, this.mosaicUntil] = [of, stamp];
    this.mosaic.paste(image, lens, panorama.head.world_R_camera);
    return this.mosaic.canvas;
  }

  /** Something is to be drawn: finely at once, unless the camera or the look moves. */
  private request(): void {
    const { look, step } = this.store;
    const from = [look.yaw, look.pitch, look.field, ...this.world_R_body, ...(step?.position ?? [])];
    const moves = from.some((value, i) => !(Math.abs(value - this.drawnFrom[i]) < UNSEEN));
    if (moves) this.drawnFrom = from;
    this.pace.request(moves);
  }

  // --- frames ---

  get world_R_body(): Matrix {
    return this.store.pose ?? this.store.panorama?.head.world_R_camera ?? IDENTITY;
  }

  get body_R_view(): Matrix {
    if (this.lens) return this.lens.body_R_view;
    const { yaw, pitch } = this.store.look;
    const base = pose(yaw, pitch);
    return this.store.hold ? times(inverse(this.world_R_body), base) : base;
  }

  /** Whence it is drawn: an ordinary camera's picture stays in its frame, and what is believed is where it shows it. */
  private seenFrom(which: "inside" | "flat"): Matrix {
    const shown = this.lens && which === "inside" ? this.store.panorama?.head.world_R_camera : null;
    return shown ?? this.world_R_body;
  }

  /** Azimuth in the body frame and the horizontal angle of what the view from inside shows. */
  get gaze(): { azimuth: number; wide: number } {
    const { canvas } = this.inside;
    const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight);
    const ahead = apply(this.body_R_view, [1, 0, 0]);
    return { azimuth: azimuthOf(ahead), wide: 2 * Math.atan(Math.tan(this.field / 2) * aspect) };
  }

  /** The vertical angle of what the view from inside shows, radians. */
  private get field(): number {
    return this.lens ? 2 * Math.atan(this.lens.plane[1]) : this.store.look.field;
  }

  projection(which: "inside" | "flat"): Projection {
    const { overlay } = this[which];
    const [width, height] = [overlay.clientWidth || 1, overlay.clientHeight || 1];
    return which === "flat" ? flat(width, height) : perspective(width, height, this.field);
  }

  /** The direction in the body frame under a pixel of the view. */
  under(which: "inside" | "flat", at: Point): Vector {
    const ray = this.projection(which).unproject(at);
    return which === "flat" ? ray : apply(this.body_R_view, ray);
  }

  // --- looking around ---

  turn(yaw: number, pitch: number): void {
    this.follows = false;
    const { look } = this.store;
    look.yaw += yaw;
    look.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, look.pitch + pitch));
    this.store.emit("look");
  }

  zoom(factor: number): void {
    const { look } = this.store;
    look.field = Math.max(FIELDS[0], Math.min(FIELDS[1], look.field * factor));
    this.store.emit("look");
  }

  /** Looks at a direction of the body frame, from now on by hand. */
  lookAt(d: Vector): void {
    this.follows = false;
    this.aim(d);
  }

  /** Turns the view a part of the way to the answer, so that it is calm. */
  private follow(): void {
    const { direction } = this.store;
    if (!this.follows || !direction) return;
    const ahead = apply(this.body_R_view, [1, 0, 0]);
    if (between(ahead, direction) < CALM) return;
    const [a, e] = [azimuthOf(ahead), elevationOf(ahead)];
    const yaw = a + QUICK * wrapped(azimuthOf(direction) - a);
    this.aim(directionOf(yaw, e + QUICK * (elevationOf(direction) - e)));
  }

  private aim(d: Vector): void {
    const aim = this.store.hold ? apply(this.world_R_body, d) : d;
    const { look } = this.store;
    [look.yaw, look.pitch] = [azimuthOf(aim), Math.max(-STEEPEST, Math.min(STEEPEST, elevationOf(aim)))];
    this.store.emit("look");
  }

  /** What lies under the pointer in the frame that the look is told in, and how to keep it there. */
  grab(at: Point): Vector {
    return apply(pose(this.store.look.yaw, this.store.look.pitch), this.projection("inside").unproject(at));
  }

  drag(grabbed: Vector, at: Point): void {
    this.follows = false;
    const found = lookThatHolds(grabbed, this.projection("inside").unproject(at), STEEPEST);
    Object.assign(this.store.look, found);
    this.store.emit("look");
  }

  /** Whether the view stays with the world while the camera turns; the view itself does not jump. */
  set hold(on: boolean) {
    if (on === this.store.hold) return;
    const ahead = apply(this.body_R_view, [1, 0, 0]);
    this.store.hold = on;
    this.lookAt(ahead);
  }

  // --- drawing ---

  private draw(scale: number): void {
    this.heat();
    this.begun = performance.now();
    for (const which of ["inside", "flat"] as const) {
      const { sphere, canvas, overlay } = this[which];
      if (!overlay.clientWidth) continue;
      const ratio = Math.min(2, window.devicePixelRatio || 1) * scale;
      const [columns, rows] = [Math.max(1, Math.round(overlay.clientWidth * ratio)), Math.max(1, Math.round(overlay.clientHeight * ratio))];
      if (canvas.width !== columns || canvas.height !== rows) [canvas.width, canvas.height] = [columns, rows];
      sphere?.draw(this.camera(which));
      const sheet = sheetOf(overlay);
      if (sheet) drawMarks(sheet.context, this.projection(which), this.marks(which), sheet.u);
    }
  }

  /** Milliseconds that the last drawing took; null while it is under way. */
  private finished(): number | null {
    for (const { sphere } of [this.inside, this.flat]) if (sphere?.finished() === null) return null;
    const took = Math.max(0.5, performance.now() - this.begun - POLL);
    this.store.drawn ||= this.store.panorama !== null;
    return took;
  }

  /** Uploads what is to glow if it is another than before. */
  private heat(): void {
    const { store } = this;
    const which = store.showsEvidence ? "look" : "heat";
    const image = store.showsEvidence ? store.evidence : (store.belief?.image ?? null);
    if (image === this.textures) return;
    this.textures = image;
    for (const { sphere } of [this.inside, this.flat]) sphere?.heat(image, which);
  }

  private camera(which: "inside" | "flat"): Camera {
    const { store } = this;
    const body_R_view = which === "flat" ? IDENTITY : this.body_R_view;
    const world_R_view = times(this.seenFrom(which), body_R_view);
    const body = store.panorama?.head.world_R_camera ?? this.world_R_body;
    const { lens } = this;
    const seen = !lens ? body : which === "flat" ? IDENTITY : times(body, lens.body_R_view);
    const { overlay } = this[which];
    const high = Math.tan(this.field / 2);
    return {
      plane: which === "flat" ? null : [(high * overlay.clientWidth) / overlay.clientHeight, high],
      panorama_R_view: times(inverse(seen), world_R_view),
      world_R_view,
      lens: which === "flat" ? null : (lens?.plane ?? null),
      glows: store.showsEvidence || (store.belief !== null && store.layers.has("heat")),
    };
  }

  private marks(which: "inside" | "flat"): Marks {
    const { store } = this;
    const view_R_world = inverse(times(this.seenFrom(which), which === "flat" ? IDENTITY : this.body_R_view));
    const view_R_body = times(view_R_world, this.world_R_body);
    const { inside } = this;
    return {
      border: store.layers.has("border") && store.belief ? store.belief.border : [],
      view_R_world,
      view_R_body,
      answer: store.layers.has("estimate") ? store.direction : null,
      sure: this.lens && which === "inside" ? (store.answer?.sure ?? null) : null,
      pointed: (store.answer?.credible_angle_deg ?? 0) <= 90,
      modes: store.layers.has("modes") ? store.modes : [],
      truth: store.layers.has("truth") ? store.truth : null,
      rivals: store.others,
      grid: store.layers.has("grid"),
      gaze: which === "flat"
        ? {
            field: this.field,
            aspect: inside.overlay.clientWidth / Math.max(1, inside.overlay.clientHeight),
            view_R_gaze: this.body_R_view,
          }
        : null,
    };
  }
}
