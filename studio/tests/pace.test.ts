/** The resolution falls only as far as it must. */

import { expect, it } from "vitest";
import { Scale } from "../src/draw/pace";

/** The scales of drawings while all moves, on a machine where one takes `fixed` + `all` * scale² milliseconds. */
function settled(fixed: number, all: number, drawings = 200): number[] {
  const scale = new Scale();
  const used: number[] = [];
  for (let now = 0; used.length < drawings; now += fixed + all * scale.current ** 2) {
    used.push(scale.current);
    scale.learn(fixed + all * scale.current ** 2, scale.current, now);
  }
  return used.slice(20);
}

const most = (used: number[]) => [...used].sort((a, b) => a - b)[Math.floor(used.length / 2)];

it("stays at all pixels where there is time for them, whatever a drawing costs for itself", () => {
  expect(new Set(settled(2, 3))).toEqual(new Set([1]));
  expect(new Set(settled(35, 15))).toEqual(new Set([1]));
});

it("falls to the finest scale that is quick enough, and seldom tries a finer one", () => {
  const used = settled(5, 200);
  expect(most(used)).toBe(0.5); // 55 ms; 0.7 would take 103
  expect(used.filter((one) => one > 0.5).length).toBeLessThan(used.length / 10);
  expect(most(settled(5, 4000))).toBe(0.25);
});

it("comes back when the machine is free again", () => {
  const scale = new Scale();
  for (let k = 0; k < 40; k++) scale.learn(300, scale.current, 60 * k);
  expect(scale.current).toBe(0.25);
  for (let k = 0; k < 400; k++) scale.learn(8, scale.current, 10_000 + 60 * k);
  expect(scale.current).toBe(1);
});
