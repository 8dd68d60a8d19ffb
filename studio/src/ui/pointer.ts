/** Dragging, pinching, turning the wheel and pressing keys over the panorama. */

import type { Stage } from "../draw/stage";
import { RADIANS, type Vector } from "../math/rotation";
import type { Point } from "../math/projection";

/** Keys that steer, and when (an event's `timeStamp`): returns whether this one does. */
type Steer = (key: string, down: boolean, at: number) => boolean;

const STEP = 5 * RADIANS;
const KEYS: Record<string, readonly [number, number]> = {
  ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
};

export function handle(stage: Stage, element: HTMLElement, steer: Steer): void {
  const fingers = new Map<number, Point>();
  let grabbed: Vector | null = null;

  const at = (event: PointerEvent | WheelEvent): Point => {
    const box = element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  };

  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || (event.target as Element).closest("button, a, input, label, .stick")) return;
    element.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, at(event));
    grabbed = fingers.size === 1 ? stage.grab(at(event)) : null;
    element.classList.add("dragging");
  });
  element.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const before = fingers.size === 2 ? spread() : 0;
    const here = at(event);
    fingers.set(event.pointerId, here);
    if (fingers.size === 2) stage.zoom(before / Math.max(1, spread()));
    else if (grabbed) stage.drag(grabbed, here);
  });
  const release = (event: PointerEvent) => {
    fingers.delete(event.pointerId);
    grabbed = fingers.size === 1 ? stage.grab([...fingers.values()][0]) : null;
    if (!fingers.size) element.classList.remove("dragging");
  };
  element.addEventListener("pointerup", release);
  element.addEventListener("pointercancel", release);

  element.addEventListener("wheel", (event) => {
    // On a page that scrolls, the wheel scrolls until a person has turned to the panorama.
    const scrolls = document.documentElement.scrollHeight > window.innerHeight + 4;
    if (scrolls && !event.ctrlKey && !element.contains(document.activeElement)) return;
    event.preventDefault();
    stage.zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) / 400));
  }, { passive: false });

  const held = new Set<string>(); // keys that steer: a button's press is not let go with them
  element.addEventListener("keydown", (event) => {
    if (event.altKey || event.metaKey || event.ctrlKey || event.target !== element) return;
    const way = KEYS[event.key];
    if (way) {
      if (!event.shiftKey && steer(event.key, true, event.timeStamp)) held.add(event.key);
      else stage.turn(way[0] * STEP, way[1] * STEP);
    } else if (event.key === "+" || event.key === "=") stage.zoom(1 / 1.15);
    else if (event.key === "-" || event.key === "_") stage.zoom(1.15);
    else if (event.key === "Home") stage.lookAt([1, 0, 0]);
    else return;
    event.preventDefault();
  });
  const letGo = (key: string, at: number) => {
    if (held.delete(key)) steer(key, false, at);
  };
  element.addEventListener("keyup", (event) => letGo(event.key, event.timeStamp));
  element.addEventListener("blur", (event) => {
    for (const key of held) letGo(key, event.timeStamp);
  });
}
