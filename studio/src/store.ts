/** What the page shows, and who wants to know of changes. */

import type { Density } from "./math/density";
import { synthesise, whole } from "./math/harmonics";
import { heatOf, type Heat } from "./math/heat";
import { apply, inverse, type Matrix } from "./math/rotation";
import { densityOf, floats } from "./wire/decode";
import type { Answer, Blobs, Mode, PanoramaHead, Scene, Step, Thing } from "./wire/messages";
import type { Vector } from "./math/rotation";

export type Topic = "scene" | "step" | "panorama" | "look" | "layers" | "style";
export const LAYERS = ["heat", "border", "estimate", "modes", "truth", "evidence", "grid"] as const;
export type LayerName = (typeof LAYERS)[number];

export interface Moment {
  stamp: number;
  error: number | null;
  presence: number | null;
  entropy: number | null;
  position: number[] | null;
  status: string;
}

export interface Field {
  frame: "world" | "body";
  columns: number;
  rows: number;
  values: Float32Array;
}

const LONGEST = 4000; // moments of a live session; then every second one is dropped
const PATIENCE = 1500; // milliseconds until a pose that the server does not take up is given up
const [QUICKEST, FINEST] = [64, 128]; // rows that a belief is evaluated on
const SETTLED = 300; // milliseconds without a new belief until the last one is evaluated finely
const QUICK = 22; // milliseconds for the heat of one belief while it changes often

export class Store {
  scene: Scene | null = null;
  step: Step | null = null;
  method: string | null = null; // of a stored episode: whose belief is shown; null for the main one
  density: Density | null = null;
  waiting: string | null = null; // the query that is asked and not answered yet: until then no answer is shown
  beliefFrame: "world" | "body" = "body";
  beliefMode: Vector | null = null; // where the server finds the maximum
  beliefPose: Matrix | null = null; // world_R_camera of the step that the belief came with
  panorama: { image: TexImageSource; head: PanoramaHead } | null = null;
  things: Thing[] = []; // that were seen without being asked for; they outlast a question
  history: Moment[] = [];
  now = 0; // index in history
  layers = new Set<LayerName>(["heat", "border", "estimate", "modes", "truth"]);
  rivals = new Set<string>();
  look = { yaw: 0, pitch: 0, field: 1.25 };
  hold = false;
  stats = { received: 0, evaluated: 0, drawn: 0, ages: [] as number[], evaluation: 0, firstPicture: 0 };
  private knownHeat: Heat | null = null;
  private observed: Field | null = null;
  private rows = QUICKEST; // the first belief is evaluated by code that is not compiled yet
  private settling = 0;
  private asked: Matrix | null = null;
  private askedUntil = 0;
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
    this.step = this.density = this.knownHeat = this.observed = this.beliefPose = null;
    this.asked = null;
    this.history = [];
    this.now = 0;
    if (!scene) {
      this.panorama = null;
      this.things = [];
    }
    this.emit("scene");
    this.emit("panorama");
    this.emit("step");
  }

  /** A question is asked; null: it is answered, or refused, and the one before is shown again. */
  wait(query: string | null): void {
    if (this.waiting === query) return;
    this.waiting = query;
    this.emit("step");
  }

  get heat(): Heat | null {
    return this.waiting === null ? this.knownHeat : null;
  }

  get evidence(): Field | null {
    return this.waiting === null ? this.observed : null;
  }

  /** The step, if it answers what is asked. */
  private get told(): Step | null {
    return this.waiting === null ? this.step : null;
  }

  /** The answer that is shown: of the chosen method, or the main one. */
  get answer(): Answer | null {
    const other = this.method === null ? null : this.told?.methods?.[this.method];
    return other ? (other.estimate ?? null) : (this.told?.estimate ?? null);
  }

  /** What is looked for at the moment, without a look yet; null: there is an answer, or nothing is asked. */
  get lookingFor(): string | null {
    if (this.waiting !== null) return this.waiting;
    return this.scene?.question && this.step?.look?.age == null && !this.direction ? this.scene.query : null;
  }

  /** The camera's pose: that of the step, or one that a person has asked for and the server does not know yet. */
  get pose(): Matrix | null {
    return this.asked ?? this.step?.world_R_camera ?? null;
  }

  /** A direction that the step tells, in the camera's frame as it is now. */
  private asNow(d: Vector | null | undefined): Vector | null {
    if (this.waiting !== null) return null;
    if (!d || !this.asked || !this.step) return d ?? null;
    return apply(inverse(this.asked), apply(this.step.world_R_camera, d));
  }

  /** The direction that is shown: some methods have one without an estimate. */
  get direction(): Vector | null {
    const other = this.method === null ? null : this.step?.methods?.[this.method];
    return this.asNow(other ? (other.estimate?.direction ?? other.direction) : this.step?.estimate?.direction);
  }

  get truth(): Vector | null {
    return this.asNow(this.step?.truth?.direction);
  }

  get error(): number | null {
    const other = this.method === null ? null : this.told?.methods?.[this.method];
    return (other ? other.error_deg : this.told?.error_deg) ?? null;
  }

  get modes(): Mode[] {
    const other = this.method === null ? null : this.told?.methods?.[this.method];
    const modes = (other ? other.modes : this.told?.modes) ?? [];
    return modes.map(({ direction, weight }) => ({ direction: this.asNow(direction)!, weight }));
  }

  /** Directions of the other methods that a person wants to see. `index` chooses their mark. */
  get others(): { name: string; direction: Vector; index: number }[] {
    const names = this.scene?.methods.map(({ name }) => name) ?? [];
    return names.flatMap((name, index) => {
      if (!this.rivals.has(name) || name === this.method) return [];
      const told = this.step?.methods?.[name];
      const direction = this.asNow(told?.estimate?.direction ?? told?.direction ?? this.step?.rivals?.[name]?.direction);
      return direction ? [{ name, direction, index }] : [];
    });
  }

  /** A person turns the camera: shown at once, and until the server's steps agree. */
  turnTo(pose: Matrix): void {
    this.asked = pose;
    this.askedUntil = performance.now() + PATIENCE;
    this.emit("step");
  }

  /** A step has come. Its belief and evidence stay until others come. */
  show(step: Step, blobs: Blobs = {}, index: number | null = null): void {
    this.step = step;
    if (this.asked && (near(this.asked, step.world_R_camera) || performance.now() > this.askedUntil)) this.asked = null;
    this.stats.received++;
    this.things = step.things ?? this.things;
    const other = this.method === null ? null : step.methods?.[this.method];
    const head = other ? (other.belief ?? null) : step.belief;
    if (head !== undefined) this.believe(densityOf(head, other ? undefined : blobs.belief), head?.frame ?? "body", head?.mode ?? null);
    if (blobs.evidence || step.evidence?.coefficients) this.observe(step, blobs.evidence);
    if (step.evidence === null) this.observed = null;
    if (index === null) {
      this.history.push(momentOf(step, step.error_deg, step.estimate));
      if (this.history.length > LONGEST) this.history = this.history.filter((_, i) => i % 2 === 0);
      this.now = this.history.length - 1;
    } else this.now = index;
    this.emit("step");
  }

  private believe(density: Density | null, frame: "world" | "body", mode: Vector | null): void {
    this.density = density;
    this.beliefFrame = frame;
    this.beliefMode = mode;
    this.beliefPose = this.step?.world_R_camera ?? null;
    const begun = performance.now();
    this.knownHeat = density ? heatOf(density, this.rows) : null;
    if (!density) return;
    this.stats.evaluated++;
    const took = performance.now() - begun;
    this.stats.evaluation = this.stats.evaluation ? 0.8 * this.stats.evaluation + 0.2 * took : took;
    const used = this.rows;
    this.rows = this.stats.evaluation > QUICK ? QUICKEST : this.stats.evaluation < QUICK / 5 ? FINEST : used;
    clearTimeout(this.settling);
    if (used < FINEST)
      this.settling = window.setTimeout(() => {
        if (this.density !== density) return;
        this.knownHeat = heatOf(density, FINEST);
        this.emit("layers");
      }, SETTLED);
  }

  private observe(step: Step, blob: ArrayBuffer | undefined): void {
    const head = step.evidence;
    if (!head) return;
    const stored = head.coefficients;
    const values = blob ? new Float32Array(blob) : typeof stored === "string" ? floats(stored) : stored;
    if (!values) return;
    const lattice = (EVIDENCE ??= whole(64));
    this.observed = {
      frame: head.frame ?? "body", columns: 128, rows: 64, values: synthesise(head.degree, values, lattice),
    };
  }

  /** The pose that turns directions of the belief's frame into the world's; null if it is in the world's already. */
  get world_R_belief(): Matrix | null {
    return this.beliefFrame === "world" ? null : this.beliefPose;
  }

  toggle(layer: LayerName, on: boolean): void {
    if (on) this.layers.add(layer);
    else this.layers.delete(layer);
    this.emit("layers");
  }

  get showsEvidence(): boolean {
    return this.layers.has("evidence") && this.evidence !== null;
  }
}

function near(a: Matrix, b: Matrix): boolean {
  return a.every((x, i) => Math.abs(x - b[i]) < 0.003);
}

let EVIDENCE: ReturnType<typeof whole> | null = null;

export function momentOf(step: Step, error: number | null | undefined, estimate: Answer | null | undefined): Moment {
  return {
    stamp: step.stamp,
    error: error ?? null,
    presence: estimate?.presence ?? null,
    entropy: estimate?.entropy ?? null,
    position: step.position,
    status: estimate?.status ?? "",
  };
}
