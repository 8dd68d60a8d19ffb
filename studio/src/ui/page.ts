/** What a view needs of the page, and what the page needs of a view. */

import type { Stage } from "../draw/stage";
import type { Session } from "../session";
import type { Store } from "../store";
import type { ServerState } from "../wire/messages";
import type { Player } from "./player";
import type { Problems } from "./problems";
import type { Shell } from "./shell";

export const TABS = ["walk", "run", "picture", "live"] as const;
export type Tab = (typeof TABS)[number];

export interface Page {
  store: Store;
  shell: Shell;
  stage: Stage;
  session: Session;
  player: Player;
  problems: Problems;
  state(): ServerState;
  /** A few words in the corner of the panorama. */
  badge(text: string): void;
  /** Words over the panorama while there is nothing to see; none take them away. */
  empty(...content: (Node | string)[]): void;
}

export interface View {
  enter(tab: Tab): void;
  leave(): void;
  /** A person asks for something. */
  ask?(query: string): void;
  /** The scene of the session has come. */
  scene?(): void;
  /** The server wants to know how wide the camera sees, and says why. */
  question?(why: string): void;
  steer?(key: string, down: boolean, at: number): boolean;
}
