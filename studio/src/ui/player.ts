/** A stored episode: play it, step through it. */

import { momentOf, type Store } from "../store";
import type { Episode, Step } from "../wire/messages";
import { words } from "../words";
import { h, icon, ICONS, say, tool } from "./dom";
import type { Shell } from "./shell";

const SLOWEST = 1200; // milliseconds that a step is shown at most
const KEPT = 120; // decoded pictures

export class Player {
  private episode: Episode | null = null;
  private index = 0;
  private timer = 0;
  private playing = false;
  private images = new Map<string, Promise<HTMLImageElement>>();
  private readonly slider = h("input", { type: "range", min: 0, value: 0, step: 1, "aria-label": words.player.step });
  private readonly count = h("output", { class: "count" });
  private readonly playButton = h("button", { type: "button", class: "primary round", "aria-label": words.player.play }, icon(ICONS.play));

  constructor(private readonly store: Store, private readonly shell: Shell, private readonly loaded: () => void) {
    shell.player.setAttribute("role", "group");
    shell.player.setAttribute("aria-label", words.player.label);
    shell.player.append(
      this.playButton, tool(words.player.previous, ICONS.previous, () => this.go(this.index - 1)),
      tool(words.player.next, ICONS.next, () => this.go(this.index + 1)), this.slider, this.count);
    this.playButton.addEventListener("click", () => (this.playing ? this.stop() : this.play()));
    this.slider.addEventListener("input", () => this.go(Number(this.slider.value)));
  }

  get active(): boolean {
    return this.episode !== null;
  }

  load(episode: Episode, from = 0): void {
    const { steps, scene } = episode;
    this.episode = episode;
    this.images.clear();
    this.store.begin(scene);
    this.slider.max = String(Math.max(0, steps.length - 1));
    this.shell.player.hidden = false;
    this.store.history = steps.map(momentOf);
    this.go(from, false);
    this.loaded();
  }

  unload(): void {
    this.stop();
    this.episode = null;
    this.shell.player.hidden = true;
    this.images.clear();
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
    // Steps hold only what has changed: the belief in force may be that of an earlier one.
    const belief = this.newest(this.index, "belief") ?? null;
    this.store.show({ ...step, belief: belief?.url ? belief : null }, this.index);
    void this.picture(belief?.url, (image) => this.store.believe(belief!, image));
    const head = this.newest(this.index, "panorama");
    if (head && this.store.panorama?.head !== head) void this.picture(head.url, (image) => this.store.picture(image, head));
    for (const ahead of [1, 2]) void this.image(this.newest(Math.min(this.index + ahead, steps.length - 1), "panorama")?.url);
  }

  /** What the last step up to this one tells of something. */
  private newest<K extends "belief" | "panorama">(index: number, name: K): Step[K] {
    return this.episode!.steps.slice(0, index + 1).findLast((step) => step[name] !== undefined)?.[name];
  }

  /** Show a picture once it is there, unless another step is shown by then; one that cannot be read leaves the last. */
  private async picture(url: string | undefined, show: (image: HTMLImageElement) => void): Promise<void> {
    const { episode, index } = this;
    const image = await this.image(url);
    if (image && this.index === index && this.episode === episode) show(image);
  }

  private async image(url: string | undefined): Promise<HTMLImageElement | null> {
    if (!url) return null;
    if (!this.images.has(url)) {
      const image = new Image();
      image.src = url;
      this.images.set(url, image.decode().then(() => image));
      if (this.images.size > KEPT) this.images.delete(this.images.keys().next().value!);
    }
    return this.images.get(url)!.catch(() => null);
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
