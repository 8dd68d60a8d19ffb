/** A walk through a simulated apartment, steered by the policy or by a person. */

import { field, h, segmented } from "../ui/dom";
import { Stick } from "../ui/stick";
import type { Page, ViewHandler } from "../ui/view";
import { words } from "../words";

export function walk(page: Page): ViewHandler {
  const { session, shell, store } = page;
  let drive = "";
  let paused = false;
  const seed = h("input", { type: "number", step: 1, list: "houses", class: "short", onchange: () => open() });
  const offered = h("datalist", { id: "houses" });
  const perception = h("select", { onchange: () => {
    if (!session.ask(session.asked.query, perception.value)) open(session.asked.query);
  } });
  const stick = new Stick((forward, turn, seconds) => session.send({ type: "drive", by: "person", forward, turn, seconds }));
  const ways = [["tour", words.walk.tour], ["policy", words.walk.policy], ["person", words.walk.person]] as const;
  const steering = segmented(words.walk.drive, ways, drive, (by) => {
    drive = by;
    stick.stop();
    if (by === "tour") {
      seed.value = String(page.state()?.default?.tour ?? seed.value);
      return open();
    }
    session.send({ type: "drive", by });
    if (paused) hold(false); // who takes over wants to go
    mark();
    page.stage.follows = false;
    // After a click the arrow keys steer at once; who chose by keys stays where the keys choose.
    if (by === "person" && byHand) shell.look.focus({ preventScroll: true });
  });
  let byHand = false;
  steering.addEventListener("pointerdown", () => (byHand = true));
  steering.addEventListener("keydown", () => (byHand = false));
  const pause = h("button", { type: "button", onclick: () => hold(!paused) }, words.walk.pause);

  function hold(on: boolean): void {
    paused = on;
    session.send({ type: "pause", on });
    pause.textContent = on ? words.walk.go : words.walk.pause;
  }

  const again = h("button", { type: "button", onclick: () => {
    paused = false;
    pause.textContent = words.walk.pause;
    session.send({ type: "restart" });
  } }, words.walk.start);

  function mark(): void {
    for (const one of steering.querySelectorAll("input")) one.checked = one.value === drive;
    shell.stick.replaceChildren(...(drive === "person" ? [stick.element] : []));
    shell.keys.textContent = drive === "person" ? words.panorama.keysDrive : words.panorama.keys;
  }

  function open(query?: string): void {
    const state = page.state();
    const where = Number(seed.value || state?.default?.seed);
    // There is one first walk: elsewhere the policy walks.
    if (!drive || drive === "tour") drive = where === state?.default?.tour ? "tour" : "policy";
    mark();
    const request = { view: "walk", drive, seed: where, query: query ?? "", perception: perception.value };
    paused = false;
    pause.textContent = words.walk.pause;
    session.open(request);
  }

  return {
    enter() {
      const state = page.state();
      const usable = (state?.perceptions ?? []).filter(({ views }) => !views || views.includes("walk"));
      const chosen = perception.value || state?.default?.perception;
      perception.replaceChildren(...usable.map(({ name, words: told, ready, problem }) =>
        h("option", { value: name, disabled: !ready, title: problem ?? told, selected: name === chosen }, name)));
      if (state?.houses) {
        [seed.min, seed.max] = [String(state.houses.first), String(state.houses.last)];
        offered.replaceChildren(...state.houses.offered.map((value) => h("option", { value })));
      }
      if (seed.value === "" && state?.default) seed.value = String(state.default.seed);
      shell.controls.replaceChildren(
        field(words.walk.house, seed), offered, field(words.walk.perception, perception), steering, h("span", { class: "buttons" }, pause, again));
      page.empty(words.panorama.waiting);
      open();
    },
    leave() {
      stick.stop();
      shell.stick.replaceChildren();
      session.close();
    },
    ask(query) {
      if (!session.ask(query)) open(query);
    },
    scene() {
      if (store.waiting !== null || !store.scene) return;
      seed.value = String(store.scene.seed);
      perception.value = store.scene.perception ?? "";
      drive = store.scene.drive ?? drive;
      mark();
    },
    steer: (key, down, at) => drive === "person" && stick.key(key, down, at),
  };
}
