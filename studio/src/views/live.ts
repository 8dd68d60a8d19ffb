/** A live source that the server was started with. */

import { h } from "../ui/dom";
import { fieldQuestion } from "../ui/field";
import type { Page, ViewHandler } from "../ui/view";
import { words } from "../words";

export function live(page: Page): ViewHandler {
  const { session, shell } = page;
  return {
    enter() {
      const state = page.state();
      const told = state?.views.find(({ name }) => name === "live");
      shell.controls.replaceChildren();
      if (!state?.source || told?.usable === false) {
        page.empty(h("strong", {}, words.live.none), h("p", {}, told?.problem || words.live.noneChange));
        return;
      }
      shell.controls.replaceChildren(h("p", { class: "source" }, `${words.live.source}: ${state.source}`));
      page.empty(words.panorama.waiting);
      session.open({ view: "live" }); // others may watch it, too: what is asked there is shown
    },
    leave: () => session.close(),
    ask(query) {
      if (!session.ask(query)) session.open({ view: "live", query });
    },
    question(why) {
      const form = fieldQuestion((hfov) => {
        page.empty(words.panorama.waiting);
        session.open({ view: "live", hfov });
      }, why);
      page.empty(form);
      form.querySelector("input")!.focus();
    },
  };
}
