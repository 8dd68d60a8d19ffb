/** Problems on the page, in words, with what to do. */

import type { Problem } from "../wire/messages";
import { words } from "../words";
import { h } from "./dom";

export class Problems {
  private readonly shown = new Map<string, HTMLElement>();

  constructor(private readonly place: HTMLElement) {}

  /** Shows a problem; a later one under the same `key` takes its place. */
  tell(key: string, { problem, change }: Problem, action?: { label: string; act: () => void }): void {
    const told = h("div", { class: "problem", role: "alert" },
      h("p", {}, h("strong", {}, problem), " ", change),
      action ? h("button", { type: "button", onclick: action.act }, action.label) : null,
      h("button", { type: "button", onclick: () => this.clear(key) }, words.connection.dismiss));
    this.shown.get(key)?.remove();
    this.shown.set(key, told);
    this.place.append(told);
  }

  clear(key: string): void {
    this.shown.get(key)?.remove();
    this.shown.delete(key);
  }

  clearAll(): void {
    for (const key of [...this.shown.keys()]) this.clear(key);
  }
}
