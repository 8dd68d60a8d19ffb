/** The one question about an ordinary camera whose pictures do not tell it: how wide it sees. */

import { words } from "../words";
import { h } from "./dom";

/** A form that asks for the field of view; `why`: a sentence before it; `told` gets degrees. The box is its first input. */
export function fieldQuestion(told: (degrees: number) => void, why = ""): HTMLFormElement {
  const { ask, hint, least, most, submit, usual } = words.picture.field;
  const width = h("input", { type: "number", id: "hfov", min: least, max: most, step: "any", value: usual, required: true });
  return h("form", { class: "question", onsubmit: (event: Event) => {
    event.preventDefault();
    told(Number(width.value));
  } }, why ? h("p", {}, why) : "", h("label", { for: "hfov" }, ask), h("p", { class: "hint" }, hint), width,
    h("button", { type: "submit", class: "primary" }, submit));
}
