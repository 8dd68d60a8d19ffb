/** What is drawn: each switch shows the mark that it stands for. */

import { RIVALS } from "../draw/palette";
import { LAYERS, type LayerName, type Store } from "../store";
import { words } from "../words";
import { h, svg } from "./dom";
import type { Shell } from "./shell";

const OUTLINES: Record<string, string> = {
  square: "M4 4h8v8H4z", diamond: "M8 2.5L13 8l-5 5.5L3 8z", up: "M8 3l5 9H3z", down: "M8 13l5-9H3z",
  left: "M3 8l9-5v10z", right: "M13 8L4 3v10z",
  star: "M8 1.7l1.6 4.3 4.7.3-3.6 2.9 1.2 4.4L8 11.1l-3.9 2.5 1.2-4.4-3.6-2.9 4.7-.3z",
  plus: "M6.3 3h3.4v3.3H13v3.4H9.7V13H6.3V9.7H3V6.3h3.3z", cross: "M5.2 3L8 5.8 10.8 3 13 5.2 10.2 8l2.8 2.8-2.2 2.2L8 10.2 5.2 13 3 10.8 5.8 8 3 5.2z",
};

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

export interface LayerActions {
  degree(L: number): void;
  methods(names: string[]): void;
  fixed(): boolean; // the degree is what it is: a stored episode, or a source that others watch, too
}

export function layers(store: Store, shell: Shell, actions: LayerActions): void {
  const text = (name: LayerName) => (name === "border" ? words.layers.border(store.scene?.region ?? 0.9, store.waiting === null ? store.density?.undrawn : "") : words.layers[name as "heat"]);
  const chips = LAYERS.map((name) =>
    chip(text(name), glyph(name), store.layers.has(name), (on) => store.toggle(name, on)));
  const degree = h("select", { onchange: () => actions.degree(Number(degree.value)) });
  const degreeField = h("label", { class: "field small", title: words.layers.degreeHint }, h("span", {}, words.layers.degree), degree);
  const rivals = h("details", { class: "rivals" }, h("summary", {}, words.layers.rivals), h("div", { class: "chips" }));
  shell.legend.append(...chips, rivals, degreeField);

  const border = chips[LAYERS.indexOf("border")].querySelector("span")!;
  const renew = () => {
    const { scene } = store;
    const choices = [...new Set([...(scene?.degrees ?? [3, 7, 15, 23, 31]), scene?.degree ?? 15])].sort((a, b) => a - b);
    degree.replaceChildren(...choices.map((L) => h("option", { value: L, selected: L === (scene?.degree ?? 15) }, String(L))));
    degree.disabled = !scene || actions.fixed();
    const methods = scene?.methods ?? [];
    rivals.hidden = methods.length === 0;
    rivals.querySelector(".chips")!.replaceChildren(...methods.map(({ name, words: told }, index) => {
      const { shape, colour } = RIVALS[index % RIVALS.length];
      const mark = svg("svg", { viewBox: "0 0 16 16", class: "glyph", "aria-hidden": "true" }, svg("path", { d: OUTLINES[shape], fill: colour, class: "g-rival" }));
      return chip([name, told && told !== name ? h("small", {}, told) : ""], mark, store.rivals.has(name), (on) => {
        if (on) store.rivals.add(name);
        else store.rivals.delete(name);
        actions.methods([...store.rivals]);
        store.emit("layers");
      });
    }));
  };
  store.on("scene", renew);
  store.on("step", () => { if (border.textContent !== text("border")) border.textContent = text("border"); });
  renew();
}
