/** What the page shows, and who wants to know of changes. */

import { direction, RADIANS, type Matrix, type Vector } from "./math/rotation";
import type { Answer, BeliefHead, PanoramaHead, Scene, Step } from "./wire/messages";

export type Topic = "scene" | "step" | "panorama" | "look" | "layers" | "style";
export const LAYERS = ["heat", "border", "estimate", "modes", "truth", "evidence", "grid"] as const;
export type LayerName = (typeof LAYERS)[number];

export interface Moment {
  stamp: number;
  error: number | null;
  presence: number | null;
  entropy: number | null;
  position: number[] | null;
}

/** The belief that is drawn, in the axes of the world. */
export interface Belief {
  image: TexImageSource;
  border: Vector[][];
  undrawn: string;
}

const LONGEST = 4000; // moments of a live source; then every second one is dropped

export class Store {
  scene: Scene | null = null;
  step: Step | null = null;
  waiting: string | null = null; // the query that is asked and not answered yet: until then no answer is shown
  panorama: { image: TexImageSource; head: PanoramaHead } | null = null;
  history: Moment[] = [];
  now = 0; // index in history
  layers = new Set<LayerName>(["heat", "border", "estimate", "modes", "truth"]);
  rivals = new Set<string>();
  look = { yaw: 0, pitch: 0, field: 1.25 };
  hold = false;
  drawn = false; // whether a picture has been
  private known: Belief | null = null;
  private observed: TexImageSource | null = null;
  private readonly listeners = new Map<Topic, Set<() => void>>();

  on(topic: Topic, listener: () => void): void {
    if (!this.listeners.has(topic)) this.listeners.set(topic, new Set());
    this.listeners.get(topic)!.add(listener);
  }

  emit(topic: Topic): void {
    for (const listener of this.listeners.get(topic) ?? []) listener();
  }

  begin(scene: Scene | null): void {
    this.scene = scene;
    this.step = this.known = this.observed = null;
    this.history = [];
    this.now = 0;
    if (!scene) this.panorama = null;
    for (const topic of ["scene", "panorama", "step"] as const) this.emit(topic);
  }

  /** A question is asked; null: it is answered, or refused, and the one before is shown again. */
  wait(query: string | null): void {
    if (this.waiting === query) return;
    this.waiting = query;
    this.emit("step");
  }

  get belief(): Belief | null {
    return this.waiting === null ? this.known : null;
  }

  get evidence(): TexImageSource | null {
    return this.waiting === null ? this.observed : null;
  }

  get showsEvidence(): boolean {
    return this.layers.has("evidence") && this.evidence !== null;
  }

  /** The step, if it answers what is asked. */
  private get told(): Step | null {
    return this.waiting === null ? this.step : null;
  }

  get answer(): Answer | null {
    return this.told?.estimate ?? null;
  }

  /** What is looked for at the moment, without a look yet; null: there is an answer, or nothing is asked. */
  get lookingFor(): string | null {
    if (this.waiting !== null) return this.waiting;
    return this.scene?.question !== undefined && this.step?.look?.age == null && !this.direction && this.step?.sent
      ? this.scene.query : null;
  }

  /** The camera's pose. */
  get pose(): Matrix | null {
    return this.step?.world_R_camera ?? null;
  }

  get direction(): Vector | null {
    return this.answer?.direction ?? null;
  }

  get truth(): Vector | null {
    return this.told?.truth ?? null;
  }

  get error(): number | null {
    return this.told?.error_deg ?? null;
  }

  get modes(): { direction: Vector; weight: number }[] {
    return (this.answer?.modes ?? []).map(({ azimuth_deg, elevation_deg, weight }) =>
      ({ direction: direction(azimuth_deg * RADIANS, elevation_deg * RADIANS), weight }));
  }

  /** Directions of the other methods that a person wants to see. `index` chooses their mark. */
  get others(): { name: string; direction: Vector; index: number }[] {
    return (this.scene?.methods ?? []).flatMap(({ name }, index) => {
      const found = this.rivals.has(name) ? this.told?.methods?.[name]?.estimate.direction : null;
      return found ? [{ name, direction: found, index }] : [];
    });
  }

  /** A step has come; `index`: that of a stored episode. Its belief stays until another one comes. */
  show(step: Step, index: number | null = null): void {
    this.step = step;
    if (step.belief === null) this.known = null;
    if (index === null) {
      this.history.push(momentOf(step));
      if (this.history.length > LONGEST) this.history = this.history.filter((_, i) => i % 2 === 0);
      this.now = this.history.length - 1;
    } else this.now = index;
    this.emit("step");
  }

  picture(image: TexImageSource, head: PanoramaHead): void {
    const before = this.panorama?.image;
    this.panorama = { image, head };
    this.emit("panorama");
    if (before instanceof ImageBitmap && before !== image) before.close();
  }

  believe({ border, undrawn }: BeliefHead, image: TexImageSource): void {
    const lines = border.map((line) => line.map(([a, e]) => direction(a * RADIANS, e * RADIANS)));
    this.known = { image, border: lines, undrawn };
    this.emit("layers");
  }

  observe(image: TexImageSource): void {
    this.observed = image;
    this.emit("layers");
  }

  toggle(layer: LayerName, on: boolean): void {
    if (on) this.layers.add(layer);
    else this.layers.delete(layer);
    this.emit("layers");
  }
}

export function momentOf({ stamp, error_deg, estimate, position }: Step): Moment {
  return { stamp, error: error_deg, presence: estimate?.presence ?? null, entropy: estimate?.entropy ?? null, position };
}
