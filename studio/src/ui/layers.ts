/** What is drawn: each switch shows the mark that it stands for. */

import { RIVALS } from "../draw/palette";
import { LAYERS, type LayerName, type Store } from "../store";
import { words } from "../words";
import { h, say, svg } from "./dom";
import type { Shell } from "./shell";

function glyph(name: LayerName): SVGElement {
  const parts: Record<LayerName, [string, Record<string, string | number>][]> = {
    heat: [["circle", { cx: 8, cy: 8, r: 6.5, class: "g-heat" }]],
    border: [["path", { d: "M2.5 8.5c0-4 3-6 6-5.5s5 3 5 6-2.500 5-5.500 4.500-5.500-2-5.500-5z", class: "g-border" }]],
    estimate: [["circle", { cx: 8, cy: 8, r: 3.2, class: "g-answer" }], ["path", { d: "M8 .5v3M8 12.500v3M.5 8h3M12.500 8h3", class: "g-answer-line" }]],
    modes: [["circle", { cx: 8, cy: 8, r: 5.5, class: "g-mode" }]],
    truth: [["circle", { cx: 8, cy: 8, r: 4.8, class: "g-truth" }], ["path", { d: "M2 2l2.600 2.600M14 2l-2.600 2.600M2 14l2.600-2.600M14 14l-2.600-2.600", class: "g-truth" }]],
    evidence: [["path", { d: "M8 1.500a6.500 6.500 0 0 1 0 13z", class: "g-for" }], ["path", { d: "M8 1.500a6.500 6.500 0 0 0 0 13z", class: "g-against" }]],
    grid: [["path", { d: "M1 8h14M8 1v14M3 3.500c3 2 7 2 10 0M3 12.500c3-2 7-2 10 0", class: "g-grid" }]],
  };
  return svg("svg", { viewBox: "0 0 16 16", class: "glyph", "aria-hidden": "true" }, ...parts[name].map(([tag, props]) => svg(tag, props)));
}

function chip(text: string | (string | Node)[], mark: SVGElement, on: boolean, flip: (on: boolean) => void): HTMLButtonElement {
  const button = h("button", { type: "button", class: "chip", "aria-pressed": String(on) }, mark, h("span", {}, ...[text].flat()));
  button.addEventListener("click", () => {
    const now = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(now));
    flip(now);
  });
  return button;
}

export function layers(store: Store, shell: Shell): void {
  const text = (name: LayerName) =>
    name === "border" ? store.belief?.undrawn || words.layers.border(store.scene?.region ?? 0.9) : words.layers[name];
  const chips = LAYERS.map((name) =>
    chip(text(name), glyph(name), store.layers.has(name), (on) => store.toggle(name, on)));
  const rivals = h("details", { class: "rivals" }, h("summary", {}, words.layers.rivals), h("div", { class: "chips" }));
  shell.legend.append(...chips, rivals);

  const border = chips[LAYERS.indexOf("border")].querySelector("span")!;
  const renew = () => {
    const methods = store.scene?.methods ?? [];
    rivals.hidden = methods.length < 2;
    rivals.querySelector(".chips")!.replaceChildren(...methods.map(({ name, words: told }, index) => {
      const { path, colour } = RIVALS[index % RIVALS.length];
      const mark = svg("svg", { viewBox: "0 0 16 16", class: "glyph", "aria-hidden": "true" }, svg("path", { d: path, fill: colour, class: "g-rival" }));
      return chip([name, told && told !== name ? h("small", {}, told) : ""], mark, store.rivals.has(name), (on) => {
        if (on) store.rivals.add(name);
        else store.rivals.delete(name);
        store.emit("layers");
      });
    }));
  };
  store.on("scene", renew);
  for (const topic of ["step", "layers"] as const) store.on(topic, () => say(border, text("border")));
  renew();
}
