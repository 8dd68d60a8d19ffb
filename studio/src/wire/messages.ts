/** What the server and a stored episode say. The server's side is `eagor.studio`. Radians unless a name ends in _deg. */

import type { Matrix, Vector } from "../math/rotation";

export type Drive = "tour" | "policy" | "person";

export interface Plan {
  walls: number[][][]; // closed lines, metres, world
  floor: number[][][];
  things: { name: string; low: number[]; high: number[]; target: boolean }[];
}

export interface Method {
  name: string;
  words: string;
}

/** How an ordinary camera sees: tangents of its half fields, and where it looks. */
export interface Lens {
  plane: [number, number];
  body_R_view: Matrix;
}

export interface Scene {
  lens?: Lens | null; // the pictures are an ordinary camera's, not panoramas
  question?: number; // that is answered from here on
  title: string;
  query: string;
  targets: string[]; // names of things that can be asked for
  drive?: Drive; // of a walk
  seed?: number;
  pauses?: boolean; // whether it can stand still
  plan: Plan | null;
  methods: Method[];
  region: number;
  paths?: Record<string, number[][]>; // where each method walked, metres
  method?: string; // whose belief a stored episode holds
  perception?: string;
  words?: string; // what is missing in this scene
}

/** An answer as it is written everywhere (`Estimate.as_dict`), with what the page adds. */
export interface Answer {
  direction: Vector | null;
  azimuth_deg: number | null;
  elevation_deg: number | null;
  credible_angle_deg?: number | null;
  presence?: number | null;
  distance_m?: number | null;
  distance_spread?: number | null;
  status?: string;
  looked_for?: string; // where that is another word than was asked
  modes?: { azimuth_deg: number; elevation_deg: number; weight: number }[];
  entropy?: number | null;
  sure?: number | null; // probability that it is here, and where the answer says
  moving?: number | null;
}

/** A belief in the axes of the world; its heat is a picture: a blob, or at an address. */
export interface BeliefHead {
  border: [number, number][][]; // azimuth and elevation, degrees
  undrawn: string; // why the border of the region is not drawn; empty if it is
  url?: string;
}

export interface PanoramaHead {
  stamp: number;
  world_R_camera: Matrix;
  url?: string;
}

export interface Step {
  question?: number; // that is answered
  stamp: number;
  number?: number;
  sent?: number; // seconds since 1970 when the server made it
  world_R_camera: Matrix;
  position: number[] | null;
  look: { age: number | null; fresh?: boolean } | null;
  panorama?: PanoramaHead;
  estimate: Answer | null;
  around?: number[]; // the belief by azimuth, in the camera's frame, from ahead to the left
  belief?: BeliefHead | null; // absent: as before
  truth?: Vector | null;
  error_deg: number | null;
  faults?: string[];
  goal?: { position: number[]; words: string } | null;
  methods?: Record<string, { estimate: Answer; error_deg: number | null }>;
}

export interface Episode {
  scene: Scene;
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
  ready: boolean; // false while the server warms up
  opens: "walk" | "live";
  perceptions: { name: string; words: string; problem: string; for: string[] }[];
  houses: { last: number; offered: number[] }; // the first has the tour
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
}

export interface Run {
  episodes: RunEpisode[];
  problem: string; // why none of them can be shown; empty if they can
}

export interface Upload {
  id: string;
  kind: "photo" | "video";
}

export type Message =
  | ({ type: "scene" } & Scene)
  | ({ type: "step" } & Step)
  | ({ type: "problem" } & Problem)
  | { type: "status"; words: string };

/** Pictures that come with a message, by name. */
export type Blobs = Record<string, ArrayBuffer>;
