/** Steering by hand: what is told is as long as the press, however late the page has its turn. */

import { describe, expect, it, vi } from "vitest";

function made(told: [number, number, number][]) {
  const element = () => ({ addEventListener() {}, append() {}, setAttribute() {}, style: {}, className: "" });
  vi.stubGlobal("document", { createElement: element, createTextNode: element });
  vi.stubGlobal("window", { addEventListener() {}, setInterval: () => 1 });
  vi.stubGlobal("clearInterval", () => {});
  return import("../src/ui/stick").then(({ Stick }) => new Stick((...one) => told.push(one)));
}

describe("the stick", () => {
  it("tells a press whose two events are handled together by the times of the events", async () => {
    const told: [number, number, number][] = [];
    const stick = await made(told);
    stick.key("ArrowLeft", true, 1000);
    stick.key("ArrowLeft", false, 1400);
    expect(told).toEqual([[0, 1, 0.4]]);
  });

  it("tells each speed for as long as it was held", async () => {
    const told: [number, number, number][] = [];
    const stick = await made(told);
    stick.key("ArrowUp", true, 1000);
    stick.key("ArrowRight", true, 1100);
    stick.key("ArrowUp", false, 1300);
    stick.key("ArrowRight", false, 1350);
    stick.key("x", true, 1400);
    expect(told.map(([forward, turn, seconds]) => [forward, turn, Math.round(1000 * seconds)])).toEqual([
      [0.8, 0, 100], [0.8, -1, 200], [0, -1, 50],
    ]);
  });

  it("makes no leap after the page was held up", async () => {
    const told: [number, number, number][] = [];
    const stick = await made(told);
    stick.key("ArrowDown", true, 0);
    stick.key("ArrowDown", false, 60_000);
    expect(told).toEqual([[-0.8, 0, 0.5]]);
  });
});
