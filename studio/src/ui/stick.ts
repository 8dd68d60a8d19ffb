/** Steering by hand: an on-screen stick with a button for each way, and the arrow keys. */

import { words } from "../words";
import { h } from "./dom";

const SPEED = 0.8; // metres per second
const TURN = 1.0; // radians per second
const EVERY = 100; // milliseconds between two messages while steering

const WAYS: Record<string, readonly [forward: number, turn: number]> = {
  ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1],
};

export class Stick {
  readonly element: HTMLElement;
  private readonly knob = h("i", { class: "knob", "aria-hidden": "true" });
  private readonly held = new Set<string>();
  private drag: readonly [number, number] = [0, 0];
  private timer = 0;

  /** `send` takes metres per second forward and radians per second to the left. */
  constructor(private readonly send: (forward: number, turn: number) => void) {
    const { forward, back, left, right, stick, stickHint } = words.walk;
    const way = (key: string, name: string, kind: string) => {
      const button = h("button", { type: "button", class: `way ${kind}`, "aria-label": name, title: name });
      const hold = (on: boolean) => (event: Event) => {
        if (event instanceof KeyboardEvent && event.key !== " " && event.key !== "Enter") return;
        if (event instanceof KeyboardEvent) event.preventDefault();
        this.key(key, on);
      };
      for (const name of ["pointerdown", "keydown"]) button.addEventListener(name, hold(true));
      for (const name of ["pointerup", "pointercancel", "pointerleave", "keyup", "blur"]) button.addEventListener(name, hold(false));
      return button;
    };
    this.element = h("div", { class: "stick", role: "group", "aria-label": stick, title: stickHint },
      way("ArrowUp", forward, "up"), way("ArrowLeft", left, "left"), way("ArrowRight", right, "right"), way("ArrowDown", back, "down"), this.knob);
    this.knob.addEventListener("pointerdown", (event) => this.knob.setPointerCapture(event.pointerId));
    this.knob.addEventListener("pointermove", (event) => {
      if (!this.knob.hasPointerCapture(event.pointerId)) return;
      const box = this.element.getBoundingClientRect();
      let [x, y] = [(event.clientX - box.left) / box.width - 0.5, (event.clientY - box.top) / box.height - 0.5];
      const length = Math.max(1, Math.hypot(x, y) / 0.32);
      [x, y] = [x / length / 0.32, y / length / 0.32];
      this.drag = [-y, -x];
      this.knob.style.translate = `${x * 32}cqi ${y * 32}cqi`;
      this.update();
    });
    for (const name of ["lostpointercapture", "pointercancel"] as const)
      this.knob.addEventListener(name, () => {
        this.drag = [0, 0];
        this.knob.style.translate = "";
        this.update();
      });
    window.addEventListener("blur", () => this.stop());
  }

  /** A key goes down or up; returns whether it steers. */
  key(key: string, down: boolean): boolean {
    if (!(key in WAYS)) return false;
    if (down) this.held.add(key);
    else this.held.delete(key);
    this.update();
    return true;
  }

  stop(): void {
    this.held.clear();
    this.drag = [0, 0];
    this.update();
  }

  private update(): void {
    const moves = this.held.size > 0 || this.drag[0] !== 0 || this.drag[1] !== 0;
    if (moves && !this.timer) {
      this.timer = window.setInterval(() => this.tell(), EVERY);
      this.tell();
    } else if (!moves && this.timer) {
      clearInterval(this.timer);
      this.timer = 0;
      this.tell();
    }
  }

  private tell(): void {
    let [forward, turn] = this.drag;
    for (const key of this.held) [forward, turn] = [forward + WAYS[key][0], turn + WAYS[key][1]];
    const cut = (x: number) => Math.max(-1, Math.min(1, x));
    this.send(SPEED * cut(forward), TURN * cut(turn));
  }
}
