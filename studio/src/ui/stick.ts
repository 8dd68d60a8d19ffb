/** Steering by hand: an on-screen stick with a button for each way, and the arrow keys. */

import { words } from "../words";
import { h } from "./dom";

const SPEED = 0.8; // metres per second
const TURN = 1.0; // radians per second
const EVERY = 50; // milliseconds between two messages while steering
const LONGEST = 500; // milliseconds that one message tells at most: a page that was held up makes no leap

const WAYS: Record<string, readonly [forward: number, turn: number]> = {
  ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1],
};

export class Stick {
  readonly element: HTMLElement;
  private readonly knob = h("i", { class: "knob", "aria-hidden": "true" });
  private readonly held = new Set<string>();
  private drag: readonly [number, number] = [0, 0];
  private timer = 0;
  private since = 0; // on `performance.now`: what was steered before has been told

  /** `send` takes metres per second forward, radians per second to the left, and for how many seconds both were held. */
  constructor(private readonly send: (forward: number, turn: number, seconds: number) => void) {
    const { forward, back, left, right, stick, stickHint } = words.walk;
    const way = (key: string, name: string, kind: string) => {
      const button = h("button", { type: "button", class: `way ${kind}`, "aria-label": name, title: name });
      const hold = (on: boolean) => (event: Event) => {
        if (event instanceof KeyboardEvent && event.key !== " " && event.key !== "Enter") return;
        if (event instanceof KeyboardEvent) event.preventDefault();
        this.key(key, on, event.timeStamp);
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
      this.tell(event.timeStamp);
      this.drag = [-y, -x];
      this.knob.style.translate = `${x * 32}cqi ${y * 32}cqi`;
      this.update(event.timeStamp);
    });
    for (const name of ["lostpointercapture", "pointercancel"] as const)
      this.knob.addEventListener(name, (event) => {
        this.tell(event.timeStamp);
        this.drag = [0, 0];
        this.knob.style.translate = "";
        this.update(event.timeStamp);
      });
    window.addEventListener("blur", () => this.stop());
  }

  /** A key goes down or up, `at` milliseconds as events have it; returns whether it steers. */
  key(key: string, down: boolean, at: number): boolean {
    if (!(key in WAYS)) return false;
    this.tell(at);
    if (down) this.held.add(key);
    else this.held.delete(key);
    this.update(at);
    return true;
  }

  stop(): void {
    const now = performance.now();
    this.tell(now);
    this.held.clear();
    this.drag = [0, 0];
    this.update(now);
  }

  private update(at: number): void {
    const moves = this.held.size > 0 || this.drag[0] !== 0 || this.drag[1] !== 0;
    if (moves && !this.timer) {
      this.since = at;
      this.timer = window.setInterval(() => this.tell(performance.now()), EVERY);
    } else if (!moves && this.timer) {
      clearInterval(this.timer);
      this.timer = 0;
    }
  }

  /** Tell what was steered until `at`: however late the page or the server is, the way is as long as the press. */
  private tell(at: number): void {
    if (!this.timer) return;
    const seconds = Math.min(at - this.since, LONGEST) / 1000;
    this.since = Math.max(this.since, at);
    let [forward, turn] = this.drag;
    for (const key of this.held) [forward, turn] = [forward + WAYS[key][0], turn + WAYS[key][1]];
    const cut = (x: number) => Math.max(-1, Math.min(1, x));
    if (seconds > 0) this.send(SPEED * cut(forward), TURN * cut(turn), seconds);
  }
}
