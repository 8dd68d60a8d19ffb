/** What the server and a stored episode say. The server's side is `eagor.studio`. Radians unless a name ends in _deg. */

import type { Matrix, Vector } from "../math/rotation";

export type View = "walk" | "run" | "picture" | "live";
export const VIEWS: readonly View[] = ["walk", "run", "picture", "live"];

export type Drive = "tour" | "policy" | "person";

export interface Plan {
  walls: number[][][]; // polylines, metres, world
  floor: number[][][]; // polygons
  things: { name: string; low: number[]; high: number[]; target: boolean }[];
}

export interface Method {
  name: string;
  words: string;
}

export interface Calibration {
  words: string;
  numbers: Record<string, number | string>;
}

/** How an ordinary camera sees: tangents of its half fields, and where it looks. */
export interface Lens {
  plane: [number, number];
  body_R_view: Matrix;
}

export interface Scene {
  lens?: Lens; // the pictures are an ordinary camera's, not panoramas
  question?: number; // that is answered from here on
  view: View;
  title: string;
  query: string;
  targets: string[]; // names of things that can be asked for
  drive?: Drive;
  seed?: number;
  plan: Plan | null;
  degree: number;
  degrees?: number[];
  calibration: Calibration | null;
  methods: Method[];
  region: number;
  paths?: Record<string, number[][]>; // where each method walked, metres
  method?: string; // whose belief a stored episode holds
  perception?: string;
  words?: string; // what is missing in this scene
}

export interface Answer {
  direction: Vector | null;
  azimuth: number | null;
  elevation: number | null;
  credible_angle: number | null;
  presence: number | null;
  entropy: number | null;
  distance: number | null;
  distance_spread: number | null;
  sure?: number | null; // probability that it is here, and where the answer says
  moving: number | null;
  status: string;
  words: string;
  looked_for?: string; // where that is another word than was asked
}

/** One of the things that the detector has seen without being asked for them. */
export interface Thing {
  query: string;
  direction: Vector | null; // in the world
  sure: number; // probability that it is here, and there
  seen: number; // in so many looks,
  of: number; // of so many
}

export interface Mode {
  direction: Vector;
  weight: number;
}

export interface BeliefHead {
  frame: "world" | "body";
  terms: { weight: number; degree: number }[];
  level: number;
  undrawn?: string; // why the border of the region is not drawn; empty if it is
  mass?: number;
  mode?: Vector;
  stamp?: number;
  coefficients?: string | Float32Array; // base64 of float32, in an episode
}

export interface EvidenceHead {
  degree: number;
  frame?: "world" | "body";
  coefficients?: string | Float32Array;
}

export interface PanoramaHead {
  stamp: number;
  world_R_camera: Matrix;
  url?: string;
}

/** What one method makes of a step. */
export interface MethodStep {
  estimate?: Answer | null;
  belief?: BeliefHead | null;
  modes?: Mode[];
  error_deg?: number | null;
  direction?: Vector | null;
}

export interface Step {
  question?: number; // that is answered
  stamp: number;
  number?: number;
  sent?: number; // seconds since 1970 when the server made it
  world_R_camera: Matrix;
  position: number[] | null;
  look: { age: number | null; fresh?: boolean } | null;
  panorama?: PanoramaHead | null;
  estimate: Answer | null;
  modes: Mode[];
  belief?: BeliefHead | null;
  evidence?: EvidenceHead | null;
  rivals?: Record<string, { direction: Vector | null; error_deg: number | null }>;
  truth?: { direction: Vector | null } | null;
  error_deg: number | null;
  faults?: string[]; // of a live source
  things?: Thing[]; // what else is here, the surest first; absent: as before
  drive?: Drive;
  goal?: { position: number[] | null; words?: string; metres?: number | null; reached?: boolean } | null;
  frame?: { n: number; of: number } | null;
  methods?: Record<string, MethodStep>;
}

export interface Episode {
  scene: Scene;
  methods: string[];
  steps: Step[];
}

export interface Problem {
  problem: string;
  change: string;
  fatal?: boolean;
  question?: number; // that is refused
  asks?: "hfov"; // what the server has to be told to go on
}

export interface ServerState {
  version: string;
  ready?: boolean; // false while the server warms up
  default?: { seed: number; tour: number; perception: string }; // tour: the apartment of the first walk
  views: { name: View; usable: boolean; problem: string }[];
  perceptions: { name: string; words: string; ready: boolean; problem?: string | null; views?: string[] }[];
  houses: { first: number; last: number; offered: number[] };
  limits: { upload_bytes: number; pixels: number };
  source: string | null;
}

export interface RunEntry {
  name: string;
  kind: "bench" | "live" | "robot";
  task: string | null;
  episodes: number | null;
  done: number | null;
  problem: string | null;
}

export interface RunEpisode {
  key: string;
  title: string;
  query: string;
  error_deg: number | null;
  success: boolean | null;
  methods: Record<string, { error_deg: number | null }>;
}

export interface Run {
  kind: string;
  methods: string[];
  episodes: RunEpisode[];
  problem: string; // why none of them can be shown; empty if they can
}

export interface Picture {
  id: string;
  kind: "photo" | "video";
  height: number;
  width: number;
  frames: number;
  warnings?: string[];
  ordinary?: boolean; // of an ordinary camera, not a panorama
  hfov_deg?: number | null; // its field of view, if the file tells it
}

/** Where the words of a binary message end, its parts begin. */
export type Blobs = Record<string, ArrayBuffer>;
export type Message =
  | ({ type: "scene" } & Scene)
  | ({ type: "step" } & Step)
  | ({ type: "problem" } & Problem)
  | { type: "status"; words: string };
