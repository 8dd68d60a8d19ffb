/** Looking around: the place that a person grabs stays under the pointer. */

import { expect, it } from "vitest";
import { flat, lookThatHolds, perspective } from "../src/math/projection";
import { apply, between, degrees, direction, inverse, pose, wrapped } from "../src/math/rotation";

it("projects and unprojects, from inside and flat", () => {
  for (const projection of [perspective(800, 500, 1.2), flat(800, 400)])
    for (const at of [[100, 80], [400, 200], [700, 390]] as const) {
      const back = projection.project(projection.unproject(at))!;
      expect(Math.hypot(back[0] - at[0], back[1] - at[1])).toBeLessThan(1e-6);
    }
  expect(perspective(800, 500, 1.2).project([-1, 0, 0])).toBeNull();
});

it("has left on the left, and up above", () => {
  const view = perspective(800, 500, 1.2);
  const [x, y] = view.project(direction(0.2, 0.1))!;
  expect(x).toBeLessThan(400);
  expect(y).toBeLessThan(250);
  const [u, v] = flat(800, 400).project(direction(0.2, 0.1))!;
  expect(u).toBeLessThan(400);
  expect(v).toBeLessThan(200);
});

it("turns a view left and up", () => {
  expect(degrees(between(apply(pose(0.5, 0.3), [1, 0, 0]), direction(0.5, 0.3)))).toBeLessThan(1e-6);
  const turned = pose(0.5, 0.3, 0.2);
  expect(degrees(between(apply(inverse(turned), apply(turned, [0, 1, 0])), [0, 1, 0]))).toBeLessThan(1e-6);
  expect(wrapped(3 * Math.PI)).toBeCloseTo(-Math.PI);
});

it("holds what was grabbed under the pointer", () => {
  const view = perspective(800, 500, 1.2);
  const start = { yaw: 1.1, pitch: -0.2 };
  const grabbed = apply(pose(start.yaw, start.pitch), view.unproject([500, 260]));
  for (const at of [[300, 200], [620, 400], [500, 100]] as const) {
    const look = lookThatHolds(grabbed, view.unproject(at), 1.5);
    const seen = view.project(apply(inverse(pose(look.yaw, look.pitch)), grabbed))!;
    expect(Math.hypot(seen[0] - at[0], seen[1] - at[1])).toBeLessThan(1e-6);
  }
});
