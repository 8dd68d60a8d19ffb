/** Runs that were made before: choose a run, then an episode. */

import { field, h } from "../ui/dom";
import type { Page, ViewHandler } from "../ui/view";
import { address, episode as fetchEpisode, Refused, run as fetchRun, runs as fetchRuns } from "../wire/api";
import type { Run, RunEntry } from "../wire/messages";
import { words } from "../words";

export function run(page: Page): ViewHandler {
  const { store, shell, player, problems } = page;
  const chooser = h("select", { onchange: () => void choose(chooser.value) });
  const refresh = h("button", { type: "button", onclick: () => void list() }, words.run.refresh);
  let loading = new AbortController();
  let chosen = "";
  let asked = 0; // counts what was asked for: an answer to an older question, or of a view that was left, comes too late

  function failed(problem: unknown): void {
    if (problem instanceof DOMException && problem.name === "AbortError") return;
    if (!(problem instanceof Refused)) throw problem;
    problems.tell("run", problem);
    page.empty(h("strong", {}, problem.problem), h("p", {}, problem.change));
  }

  async function list(): Promise<void> {
    const mine = ++asked;
    problems.clear("run");
    try {
      const { folder, runs } = await fetchRuns();
      if (mine !== asked) return;
      if (!runs.length) {
        shell.choice.hidden = true;
        page.empty(h("strong", {}, words.run.none), h("p", {}, words.run.noneChange(folder)));
        return;
      }
      chooser.replaceChildren(...runs.map((entry) => h("option", { value: entry.name }, titleOf(entry))));
      const first = runs.find(({ name }) => name === chosen) ?? runs.find(({ problem }) => !problem) ?? runs[0];
      chooser.value = first.name;
      await choose(first.name);
    } catch (problem) {
      if (mine === asked) failed(problem);
    }
  }

  async function choose(name: string): Promise<void> {
    const mine = ++asked;
    chosen = name;
    loading.abort();
    player.unload(); // what is shown is of another run
    store.begin(null);
    page.empty(words.run.reading);
    problems.clear("run");
    try {
      const told = await fetchRun(name);
      if (mine === asked) fill(name, told);
    } catch (problem) {
      if (mine !== asked) return;
      shell.choice.hidden = true;
      failed(problem);
    }
  }

  function fill(name: string, told: Run): void {
    const rows = told.episodes.map((one) => {
      const title = one.title || one.key;
      const button = () => h("button", { type: "button", onclick: () => void load(name, one.key) }, title);
      const row = h("tr", { "data-key": one.key },
        h("th", { scope: "row" }, told.problem ? title : button()), h("td", {}, one.query),
        h("td", { class: "number" }, one.error_deg === null ? words.run.unknown : words.answer.degrees(one.error_deg)),
        h("td", { class: one.success === false ? "missed" : "" },
          one.success === null ? words.run.unknown : one.success ? words.run.success : words.run.failure));
      return row;
    });
    const { episode, query, error, found } = words.run;
    shell.choice.hidden = !told.episodes.length;
    shell.choice.replaceChildren(h("section", { class: "card episodes", "aria-labelledby": "episodes-title" },
      h("h2", { id: "episodes-title" }, words.run.episodes), h("p", { class: "hint" }, words.run.episodesHint),
      h("div", { class: "scroll" },
        h("table", {}, h("thead", {}, h("tr", {}, ...[episode, query, error, found].map((head) => h("th", { scope: "col" }, head)))),
          h("tbody", {}, ...rows)))));
    if (told.problem) page.empty(h("strong", {}, told.problem[0].toUpperCase() + told.problem.slice(1)));
    else void load(name, told.episodes[0].key);
  }

  async function load(name: string, key: string): Promise<void> {
    loading.abort();
    loading = new AbortController();
    const { signal } = loading;
    problems.clear("run");
    for (const row of shell.choice.querySelectorAll<HTMLElement>("tr[data-key]")) {
      const is = row.dataset.key === key;
      row.classList.toggle("shown", is);
      row.querySelector("button")!.setAttribute("aria-current", String(is));
    }
    page.empty(words.run.loading(null));
    try {
      const told = await fetchEpisode(name, key, (progress) => { if (!signal.aborted) page.empty(words.run.loading(progress)); }, signal);
      for (const step of told.steps) if (step.panorama?.url && !step.panorama.url.startsWith("data:")) step.panorama.url = address(step.panorama.url);
      if (signal.aborted) return; // another was chosen, or the view left, while the answer was read
      page.empty();
      player.load(told);
    } catch (problem) {
      failed(problem);
    }
  }

  return {
    enter() {
      shell.controls.replaceChildren(field(words.run.runs, chooser, "wide"), refresh);
      page.empty(words.panorama.waiting);
      void list();
    },
    leave() {
      asked++;
      loading.abort();
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
