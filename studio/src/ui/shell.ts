/** The page's frame: what is always there, and the places that views fill. */

import { words } from "../words";
import { h, svg } from "./dom";

export type Shell = ReturnType<typeof shell>;

const logo = () =>
  svg("svg", { viewBox: "0 0 32 32", class: "logo", "aria-hidden": "true" },
    svg("circle", { cx: 16, cy: 16, r: 13.5, class: "logo-ring" }),
    svg("ellipse", { cx: 16, cy: 16, rx: 13.5, ry: 5, class: "logo-line" }),
    svg("circle", { cx: 21.5, cy: 12, r: 4.4, class: "logo-glow" }),
    svg("circle", { cx: 21.5, cy: 12, r: 1.9, class: "logo-dot" }));

function card(name: string, title: string, ...children: (Node | null)[]): HTMLElement {
  return h("section", { class: `card ${name}`, "aria-labelledby": `${name}-title` }, h("h2", { id: `${name}-title` }, title), ...children);
}

/** A plot: the picture, and the same in words for those who cannot see it. */
function plot(name: string, title: string, hint: string): { card: HTMLElement; canvas: HTMLCanvasElement; text: HTMLElement } {
  const canvas = h("canvas", { class: `plot-${name}`, role: "img", "aria-label": title, "aria-describedby": `${name}-text` });
  const text = h("p", { class: "in-words", id: `${name}-text` });
  return { card: card(name, title, canvas, h("p", { class: "hint" }, hint), text), canvas, text };
}

export function shell(root: HTMLElement) {
  const tabs = h("nav", { class: "tabs", "aria-label": words.tabs.label });
  const theme = h("button", { type: "button", class: "theme" });
  const problems = h("div", { class: "problems" });
  const news = h("p", { class: "in-words", "aria-live": "polite" });

  const query = h("input", {
    id: "query", type: "text", name: "query", autocomplete: "off", enterkeyhint: "search", maxlength: 200, placeholder: words.ask.placeholder,
    list: "targets",
  });
  const targets = h("datalist", { id: "targets" });
  const ask = h("form", { class: "ask" },
    h("label", { for: "query" }, words.ask.label), query, targets, h("button", { type: "submit", class: "primary" }, words.ask.submit));
  const controls = h("div", { class: "controls" });

  const insideView = h("canvas", { class: "scene", "aria-hidden": "true" });
  const insideMarks = h("canvas", { class: "marks", "aria-hidden": "true" });
  const empty = h("div", { class: "empty", hidden: true });
  const badge = h("div", { class: "badge", hidden: true });
  const tools = h("div", { class: "tools" });
  const stick = h("div", { class: "stick-place" });
  const keys = h("p", { class: "in-words", id: "stage-keys" }, words.panorama.keys);
  const looking = h("p", { class: "in-words", id: "stage-looking" });
  const told = h("p", { class: "in-words", id: "stage-told" });
  const look = h("div", {
    class: "look", tabindex: 0, role: "application", "aria-label": words.panorama.label,
    "aria-roledescription": words.panorama.role, "aria-describedby": "stage-keys stage-looking stage-told",
  }, insideView, insideMarks);
  const stage = h("section", { class: "stage", id: "stage", tabindex: -1, "aria-label": words.panorama.label }, look, badge, tools, stick, empty, keys, looking, told);

  const legend = h("div", { class: "legend", role: "group", "aria-label": words.layers.label });
  const player = h("div", { class: "player", hidden: true });

  const flatView = h("canvas", { class: "scene", "aria-hidden": "true" });
  const flatMarks = h("canvas", { class: "marks", role: "img", "aria-label": words.panorama.flat, "aria-describedby": "stage-told" });
  const flatHint = h("p", { class: "hint" }, words.panorama.flatHint);
  const flat = card("flat", words.panorama.flat, h("div", { class: "flat-frame" }, flatView, flatMarks), flatHint);

  const series = plot("series", words.series.label, "");
  series.card.querySelector(".hint")!.remove();
  const polar = plot("polar", words.polar.label, words.polar.hint);
  const plan = plot("plan", words.plan.label, words.plan.hint);

  const status = h("p", { class: "status" });
  const sentence = h("p", { class: "sentence" });
  const means = h("p", { class: "means" });
  const facts = h("dl", { class: "facts" });
  const answer = card("answer", words.answer.label, status, sentence, means, facts);
  const choice = h("div", { class: "choice", hidden: true });
  const list = h("ol", { class: "modes" });
  const candidates = card("candidates", words.candidates.label, h("p", { class: "hint" }, words.candidates.hint), list);
  root.append(
    h("a", { class: "skip", href: "#stage", onclick: (event: Event) => {
      event.preventDefault();
      (look.inert ? (empty.querySelector<HTMLElement>("button, input") ?? stage) : look).focus();
    } }, words.skip),
    h("header", { class: "top" },
      h("h1", { class: "brand" }, logo(), h("span", {}, words.brand, " ", h("em", {}, words.brandSub))), tabs, theme),
    h("main", { class: "desk" },
      problems,
      h("div", { class: "bar" }, ask, controls),
      choice,
      h("div", { class: "left" }, stage, player, legend, h("div", { class: "below" }, flat, series.card)),
      h("aside", { class: "side", "aria-label": words.answer.label }, answer, candidates, polar.card, plan.card)),
    news,
  );
  return {
    tabs, theme, problems, news, ask, query, targets, controls, stage, look, insideView, insideMarks, empty, badge, tools, stick, keys,
    looking, told, legend, player, flatView, flatMarks, flatHint, series, polar, plan, status, sentence, means, facts, choice, candidates,
    list,
  };
}
