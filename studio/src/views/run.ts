/** Runs that were made before: choose a run, then an episode. */

import { field, h } from "../ui/dom";
import type { Page, View } from "../ui/page";
import { episode as fetchEpisode, Refused, run as fetchRun, runs as fetchRuns } from "../wire/api";
import type { Run, RunEntry } from "../wire/messages";
import { words } from "../words";

export function run(page: Page): View {
  const { store, shell, player, problems } = page;
  const chooser = h("select", { onchange: () => void choose(chooser.value) });
  const refresh = h("button", { type: "button", onclick: () => void list() }, words.run.refresh);
  let chosen = "";
  let newest = new AbortController(); // of what is asked for: an answer to an older question, or of a view that was left, comes too late

  /** Ask the server, and do something with its answer, unless something else is wanted by then. */
  async function ask<T>(waiting: string, question: (signal: AbortSignal) => Promise<T>, then: (answer: T) => void): Promise<void> {
    newest.abort();
    const { signal } = (newest = new AbortController());
    problems.clear("run");
    page.empty(waiting);
    try {
      const answer = await question(signal);
      if (!signal.aborted) then(answer);
    } catch (problem) {
      if (signal.aborted) return;
      if (!(problem instanceof Refused)) throw problem;
      problems.tell("run", problem);
      page.empty(h("strong", {}, problem.problem), h("p", {}, problem.change));
    }
  }

  const list = () => ask(words.run.reading, fetchRuns, ({ folder, runs }) => {
    shell.choice.hidden = true;
    if (!runs.length) return page.empty(h("strong", {}, words.run.none), h("p", {}, words.run.noneChange(folder)));
    chooser.replaceChildren(...runs.map((entry) => h("option", { value: entry.name }, titleOf(entry))));
    chooser.value = (runs.find(({ name }) => name === chosen) ?? runs.find(({ problem }) => !problem) ?? runs[0]).name;
    void choose(chooser.value);
  });

  function choose(name: string): Promise<void> {
    chosen = name;
    player.unload(); // what is shown is of another run
    store.begin(null);
    shell.choice.hidden = true;
    return ask(words.run.reading, () => fetchRun(name), (told) => fill(name, told));
  }

  function fill(name: string, told: Run): void {
    const { episode, query, error, found, unknown, success, failure } = words.run;
    const rows = told.episodes.map((one) => h("tr", { "data-key": one.key },
      h("th", { scope: "row" }, told.problem ? one.title
        : h("button", { type: "button", onclick: () => void load(name, one.key) }, one.title)),
      h("td", {}, one.query),
      h("td", { class: "number" }, one.error_deg === null ? unknown : words.answer.degrees(one.error_deg)),
      h("td", { class: one.success === false ? "missed" : "" }, one.success === null ? unknown : one.success ? success : failure)));
    shell.choice.hidden = !rows.length;
    shell.choice.replaceChildren(h("section", { class: "card episodes", "aria-labelledby": "episodes-title" },
      h("h2", { id: "episodes-title" }, words.run.episodes), h("p", { class: "hint" }, words.run.episodesHint),
      h("div", { class: "scroll" },
        h("table", {}, h("thead", {}, h("tr", {}, ...[episode, query, error, found].map((head) => h("th", { scope: "col" }, head)))),
          h("tbody", {}, ...rows)))));
    if (told.problem) page.empty(h("strong", {}, told.problem[0].toUpperCase() + told.problem.slice(1)));
    else void load(name, told.episodes[0].key);
  }

  function load(name: string, key: string): Promise<void> {
    for (const row of shell.choice.querySelectorAll<HTMLElement>("tr[data-key]")) {
      const is = row.dataset.key === key;
      row.classList.toggle("shown", is);
      row.querySelector("button")!.setAttribute("aria-current", String(is));
    }
    return ask(words.run.loading, (signal) => fetchEpisode(name, key, signal), (told) => {
      page.empty();
      player.load(told);
    });
  }

  return {
    enter() {
      shell.controls.replaceChildren(field(words.run.runs, chooser, "wide"), refresh);
      void list();
    },
    leave() {
      newest.abort();
      player.unload();
      shell.choice.hidden = true;
      shell.choice.replaceChildren();
    },
  };
}

function titleOf({ name, kind, task, episodes, done, problem }: RunEntry): string {
  const parts = new Set([words.run.kind[kind] ?? kind, task, words.run.count(done, episodes), problem].filter(Boolean));
  return `${name} – ${[...parts].join(", ")}`;
}
