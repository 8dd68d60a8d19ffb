/** Making elements. */

import { words } from "../words";

type Child = Node | string | null | undefined | false;
type Props = Record<string, unknown>;

/** An element with attributes; names that begin with "on" are listeners, `class` is the class. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K, props: Props = {}, ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  set(element, props);
  append(element, children);
  return element;
}

export function svg(tag: string, props: Props = {}, ...children: Child[]): SVGElement {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  set(element, props);
  append(element, children);
  return element;
}

function set(element: Element, props: Props): void {
  for (const [name, value] of Object.entries(props)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value as EventListener);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, String(value));
  }
}

function append(element: Element, children: Child[]): void {
  for (const child of children) if (child !== null && child !== undefined && child !== false) element.append(child);
}

/** Sets the text only if it differs, so that screen readers are not told again. */
export function say(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** A set of choices of which one holds. */
export function segmented(
  label: string, choices: readonly (readonly [value: string, text: string])[], chosen: string, pick: (value: string) => void,
): HTMLFieldSetElement {
  const name = `choice-${label.replace(/\W+/g, "-")}`;
  return h(
    "fieldset", { class: "segmented" }, h("legend", {}, label),
    h("span", { class: "segments" }, ...choices.map(([value, text]) =>
      h("label", {},
        h("input", { type: "radio", name, value, checked: value === chosen, onchange: () => pick(value) }),
        h("span", {}, text)))),
  );
}

/** A labelled field. */
export function field(label: string, control: HTMLElement, kind = ""): HTMLLabelElement {
  return h("label", { class: `field ${kind}` }, h("span", {}, label), control);
}

export function icon(path: string): SVGElement {
  return svg("svg", { viewBox: "0 0 20 20", class: "icon", "aria-hidden": "true" }, svg("path", { d: path }));
}

export const ICONS = {
  play: "M6 4l10 6-10 6z",
  pause: "M5 4h3.5v12H5zM11.5 4H15v12h-3.5z",
  previous: "M13 4v12l-7-6zM4.5 4h1.8v12H4.5z",
  next: "M7 4v12l7-6zM13.7 4h1.8v12h-1.8z",
  plus: "M9 4h2v5h5v2h-5v5H9v-5H4V9h5z",
  minus: "M4 9h12v2H4z",
  ahead: "M10 3l6 13-6-3.5L4 16z",
  target: "M9 1h2v3.100a6 6 0 0 1 4.900 4.900H19v2h-3.100a6 6 0 0 1-4.900 4.900V19H9v-3.100A6 6 0 0 1 4.100 11H1V9h3.100A6 6 0 0 1 9 4.100zM10 6a4 4 0 1 0 0 8 4 4 0 0 0 0-8zm0 2.500a1.500 1.500 0 1 1 0 3 1.500 1.500 0 0 1 0-3z",
  hold: "M6 8V6a4 4 0 0 1 8 0v2h1.500v9h-11V8zm2 0h4V6a2 2 0 0 0-4 0z",
  full: "M3 3h5v2H5v3H3zM12 3h5v5h-2V5h-3zM3 12h2v3h3v2H3zM15 12h2v5h-5v-2h3z",
} as const;

/** A round button with a picture on it. */
export function tool(label: string, path: string, act: () => void): HTMLButtonElement {
  return h("button", { type: "button", class: "tool", "aria-label": label, title: label, onclick: act }, icon(path));
}

/** A form that asks how wide an ordinary camera sees; `why`: a sentence before it; `told` gets degrees. */
export function fieldQuestion(told: (degrees: number) => void, why: string): HTMLFormElement {
  const { ask, hint, least, most, submit, usual } = words.picture.field;
  const width = h("input", { type: "number", id: "hfov", min: least, max: most, step: "any", value: usual, required: true });
  return h("form", { class: "question", onsubmit: (event: Event) => {
    event.preventDefault();
    told(Number(width.value));
  } }, h("p", {}, why), h("label", { for: "hfov" }, ask), h("p", { class: "hint" }, hint), width,
    h("button", { type: "submit", class: "primary" }, submit));
}
