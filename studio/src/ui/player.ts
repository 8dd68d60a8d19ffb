/** A stored episode: play it, step through it, choose whose belief is shown. */

import { momentOf, type Store } from "../store";
import type { Episode, Step } from "../wire/messages";
import { words } from "../words";
import { field, h, icon, ICONS, say } from "./dom";
import type { Shell } from "./shell";

const SLOWEST = 1200; // milliseconds that a step is shown at most
const KEPT = 60; // decoded panoramas, 2 MB each

export class Player {
  private episode: Episode | null = null;
  private index = 0;
  private timer = 0;
  private playing = false;
  private images = new Map<string, Promise<HTMLImageElement>>();
  private readonly slider = h("input", { type: "range", min: 0, value: 0, step: 1, "aria-label": words.player.step });
  private readonly count = h("output", { class: "count" });
  private readonly playButton = h("button", { type: "button", class: "primary round", "aria-label": words.player.play }, icon(ICONS.play));
  private readonly method = h("select", {});
  private readonly methodField = field(words.run.method, this.method, "small");

  constructor(private readonly store: Store, private readonly shell: Shell, private readonly loaded: () => void) {
    const button = (label: string, path: string, act: () => void) =>
      h("button", { type: "button", class: "tool", "aria-label": label, title: label, onclick: act }, icon(path));
    shell.player.setAttribute("role", "group");
    shell.player.setAttribute("aria-label", words.player.label);
    shell.player.append(
      this.playButton, button(words.player.previous, ICONS.previous, () => this.go(this.index - 1)),
      button(words.player.next, ICONS.next, () => this.go(this.index + 1)), this.slider, this.count, this.methodField,
    );
    this.playButton.addEventListener("click", () => (this.playing ? this.stop() : this.play()));
    this.slider.addEventListener("input", () => this.go(Number(this.slider.value)));
    this.method.addEventListener("change", () => this.choose(this.method.value === this.episode?.scene.method ? null : this.method.value));
  }

  get active(): boolean {
    return this.episode !== null;
  }

  load(episode: Episode, from = 0): void {
    this.episode = episode;
    this.images.clear();
    const names = [...new Set([...(episode.methods ?? []), ...Object.keys(episode.steps[0]?.methods ?? {})])];
    const known = new Map(episode.scene.methods.map((method) => [method.name, method]));
    const scene = { ...episode.scene, methods: names.map((name) => known.get(name) ?? { name, words: name }) };
    this.store.method = null;
    this.store.begin(scene);
    const main = episode.scene.method;
    const shown = names.filter((name) => name === main || episode.steps.some((step) => step.methods?.[name]?.belief));
    this.method.replaceChildren(
      ...shown.map((name) => h("option", { value: name }, known.get(name)?.words || name)));
    this.methodField.hidden = shown.length < 2;
    this.slider.max = String(Math.max(0, episode.steps.length - 1));
    this.shell.player.hidden = false;
    this.remember();
    this.go(from, false);
    this.loaded();
  }

  unload(): void {
    this.stop();
    this.episode = null;
    this.store.method = null;
    this.shell.player.hidden = true;
    this.images.clear();
  }

  private choose(name: string | null): void {
    this.store.method = name;
    this.remember();
    this.go(this.index, false);
  }

  private remember(): void {
    const { method } = this.store;
    this.store.history = this.episode!.steps.map((step) => {
      const other = method === null ? null : step.methods?.[method];
      return other ? momentOf(step, other.error_deg, other.estimate) : momentOf(step, step.error_deg, step.estimate);
    });
  }

  go(index: number, byHand = true): void {
    if (!this.episode) return;
    if (byHand) this.stop();
    const { steps } = this.episode;
    this.index = Math.max(0, Math.min(steps.length - 1, index));
    const step = steps[this.index];
    if (!step) return;
    this.slider.value = String(this.index);
    const said = words.player.at(this.index + 1, steps.length, step.stamp - steps[0].stamp);
    this.slider.setAttribute("aria-valuetext", said);
    say(this.count, `${this.index + 1} / ${steps.length}`);
    this.store.show(this.whole(this.index), {}, this.index);
    void this.picture(this.index);
  }

  /** A step with the belief and the evidence that are in force: steps hold only what has changed. */
  private whole(index: number): Step {
    const { steps } = this.episode!;
    const step = { ...steps[index] };
    const told = steps.slice(0, index + 1);
    step.belief = told.findLast(({ belief }) => belief !== undefined)?.belief ?? null;
    step.evidence = told.findLast(({ evidence }) => evidence !== undefined)?.evidence ?? null;
    return step;
  }

  private async picture(index: number): Promise<void> {
    const { steps } = this.episode!;
    const told = (at: number) => {
      for (let i = at; i >= 0; i--) if (steps[i]?.panorama?.url) return steps[i].panorama!;
      return null;
    };
    const head = told(index);
    if (!head) return;
    if (this.store.panorama?.head === head) return;
    try {
      const image = await this.image(head.url!);
      if (this.index !== index || !this.episode) return;
      this.store.panorama = { image, head };
      this.store.emit("panorama");
    } catch {
      // A picture that cannot be read leaves the last one; the belief is drawn in its own place all the same.
    }
    for (const ahead of [1, 2]) {
      const next = told(Math.min(index + ahead, steps.length - 1));
      if (next) this.image(next.url!).catch(() => {});
    }
  }

  private image(url: string): Promise<HTMLImageElement> {
    const known = this.images.get(url);
    if (known) return known;
    const image = new Image();
    image.src = url;
    const made = image.decode().then(() => image);
    this.images.set(url, made);
    if (this.images.size > KEPT) this.images.delete(this.images.keys().next().value!);
    return made;
  }

  play(): void {
    if (!this.episode) return;
    if (this.index >= this.episode.steps.length - 1) this.go(0);
    this.playing = true;
    this.mark();
    this.wait();
  }

  stop(): void {
    clearTimeout(this.timer);
    this.playing = false;
    this.mark();
  }

  private mark(): void {
    this.playButton.replaceChildren(icon(this.playing ? ICONS.pause : ICONS.play));
    this.playButton.setAttribute("aria-label", this.playing ? words.player.pause : words.player.play);
  }

  private wait(): void {
    const steps = this.episode?.steps ?? [];
    if (this.index >= steps.length - 1) return this.stop();
    const pause = 1000 * (steps[this.index + 1].stamp - steps[this.index].stamp);
    this.timer = window.setTimeout(() => {
      this.go(this.index + 1, false);
      this.wait();
    }, Math.max(60, Math.min(SLOWEST, pause)));
  }
}
