/** The page of `eagor studio`, and of an exported episode. */

import "./style.css";
import { forgetStyle } from "./draw/canvas";
import { Stage } from "./draw/stage";
import { degrees } from "./math/rotation";
import { Session } from "./session";
import { Store } from "./store";
import { h, ICONS, say, tool } from "./ui/dom";
import { layers } from "./ui/layers";
import { TABS, type Page, type Tab, type View } from "./ui/page";
import { Panels } from "./ui/panels";
import { Player } from "./ui/player";
import { handle } from "./ui/pointer";
import { Problems } from "./ui/problems";
import { shell as makeShell } from "./ui/shell";
import { theme } from "./ui/theme";
import { run } from "./views/run";
import { watch } from "./views/watch";
import { Refused, serverState } from "./wire/api";
import type { Episode, ServerState } from "./wire/messages";
import { words } from "./words";

document.title = words.title;
document.documentElement.lang = words.language;
const store = new Store();
const root = document.getElementById("studio")!;
const shell = makeShell(root);
theme(shell.theme, () => {
  forgetStyle();
  store.emit("style");
});
const problems = new Problems(shell.problems);
const stage = new Stage(store, [shell.insideView, shell.insideMarks], [shell.flatView, shell.flatMarks]);
// A stored episode begins with a look at the answer, and the view stays with it while the camera turns and walks, until
// a person looks elsewhere.
const player = new Player(store, shell, () => {
  stage.hold = true;
  stage.lookAt(store.direction ?? [1, 0, 0]);
  stage.follows = true;
});
const panels = new Panels(store, shell, stage);
let state: ServerState | null = null;
let view: View | null = null;
let drafted = false; // the box holds words that a person has typed and not asked yet: they stay, whatever is answered

const session = new Session(store, {
  connection(how, seconds) {
    if (how === "open") problems.clear("connection");
    else if (how === "lost")
      problems.tell("connection", { problem: words.connection.lost(seconds), change: words.connection.lostChange },
        { label: words.connection.retry, act: () => session.retry() });
  },
  problem(told) {
    if (told.asks && view?.question) return view.question(told.problem);
    problems.tell("session", told);
    if (told.fatal) empty(h("strong", {}, told.problem), h("p", {}, told.change));
  },
  status: (told) => badge(told),
  scene() {
    if (store.waiting === null) {
      problems.clear("session");
      if (store.scene && !drafted && document.activeElement !== shell.query) shell.query.value = store.scene.query;
      stage.follows = store.scene?.drive === "tour";
    }
    shell.targets.replaceChildren(...(store.scene?.targets ?? []).map((value) => h("option", { value })));
    view?.scene?.();
  },
});

const page: Page = { store, shell, stage, session, player, problems, state: () => state!, empty, badge };
const live = watch(page);
const views: Record<Tab, View> = { walk: live, run: run(page), picture: live, live };

function empty(...content: (Node | string)[]): void {
  const { empty: words, look, tools, stick, stage: all } = shell;
  const at = document.activeElement;
  const shown = content.length > 0;
  // What the words cover cannot be reached; whoever was in what goes is at the panorama as a whole.
  const lost = words.contains(at) || (shown && [look, tools, stick].some((one) => one.contains(at)));
  words.hidden = !shown;
  look.inert = tools.inert = stick.inert = shown;
  words.replaceChildren(h("div", {}, ...content));
  if (lost) all.focus({ preventScroll: true });
}

function badge(text: string): void {
  shell.badge.hidden = text === "";
  say(shell.badge, text);
}

store.on("scene", () => {
  const lens = store.scene?.lens; // an ordinary camera's picture is shown whole: there is nowhere to look around to
  shell.stage.classList.toggle("ordinary", Boolean(lens));
  if (lens) shell.stage.style.setProperty("--aspect", String(lens.plane[0] / lens.plane[1]));
  say(shell.flatHint, lens ? words.panorama.flatHintOrdinary : words.panorama.flatHint);
  say(shell.keys, lens ? words.panorama.keysOrdinary : words.panorama.keys);
});
store.on("panorama", () => { if (store.panorama) empty(); });
store.on("step", () => {
  if (!store.step) return;
  badge(store.lookingFor !== null ? words.ask.waiting(store.lookingFor) : store.step.goal?.words || store.scene?.words || "");
  if (store.step.faults?.length) problems.tell("faults", { problem: store.step.faults.join("; "), change: "" });
  else problems.clear("faults");
});

const hold = tool(words.panorama.hold, ICONS.hold, () => { stage.hold = !store.hold; });
store.on("look", () => hold.setAttribute("aria-pressed", String(store.hold)));
shell.tools.append(
  hold,
  tool(words.panorama.answer, ICONS.target, () => { if (store.direction) stage.lookAt(store.direction); }),
  tool(words.panorama.ahead, ICONS.ahead, () => stage.lookAt([1, 0, 0])),
  tool(words.panorama.zoomIn, ICONS.plus, () => stage.zoom(1 / 1.25)),
  tool(words.panorama.zoomOut, ICONS.minus, () => stage.zoom(1.25)),
  tool(words.panorama.full, ICONS.full, () => {
    if (document.fullscreenElement) void document.exitFullscreen();
    else void shell.stage.requestFullscreen?.();
  }),
);
handle(stage, shell.look, (key, down, at) => view?.steer?.(key, down, at) ?? false);
shell.flatMarks.addEventListener("click", (event) => {
  if (!stage.lens) stage.lookAt(stage.under("flat", [event.offsetX, event.offsetY]));
});
shell.series.canvas.addEventListener("click", (event) => { if (player.active) player.go(panels.momentAt(event.offsetX)); });
layers(store, shell);
shell.ask.addEventListener("submit", (event) => {
  event.preventDefault();
  const query = shell.query.value.trim();
  if (!/[\p{L}\p{N}]/u.test(query)) {
    shell.query.setCustomValidity(words.ask.empty);
    shell.query.reportValidity();
    return;
  }
  drafted = false;
  view?.ask?.(query);
});
shell.query.addEventListener("input", () => {
  drafted = shell.query.value !== "";
  shell.query.setCustomValidity("");
});
window.addEventListener("resize", () => {
  forgetStyle();
  store.emit("style");
});
new ResizeObserver(() => store.emit("style")).observe(shell.look);

function wanted(): Tab {
  const name = location.hash.slice(1) as Tab;
  return TABS.includes(name) ? name : state!.opens;
}

function warnOfWebGL(): void {
  if (stage.broken) problems.tell("webgl", { problem: words.problems.webgl, change: words.problems.webglChange });
}

function enter(name: Tab): void {
  view?.leave();
  problems.clearAll();
  warnOfWebGL();
  store.begin(null);
  stage.hold = false;
  stage.lookAt([1, 0, 0]);
  badge("");
  for (const link of shell.tabs.querySelectorAll("a")) {
    if (link.hash === `#${name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  root.dataset.view = name;
  shell.ask.hidden = name === "run";
  view = views[name];
  view.enter(name);
}

async function connect(): Promise<void> {
  for (let wait = 500; ; wait = Math.min(2 * wait, 8000)) {
    try {
      state = await serverState();
      problems.clear("connection");
      break;
    } catch (problem) {
      if (!(problem instanceof Refused)) throw problem;
      problems.tell("connection", problem);
      await new Promise((resolve) => setTimeout(resolve, wait));
    }
  }
  enter(wanted());
  window.addEventListener("hashchange", () => enter(wanted()));
}

/** The page of one episode, without a server: it opens with its end, which is the answer; playing begins anew. */
function replay(text: string): void {
  root.dataset.view = "export";
  warnOfWebGL();
  shell.ask.hidden = true;
  try {
    const episode = JSON.parse(text) as Episode;
    document.title = `${episode.scene.query} – ${words.title}`;
    shell.controls.append(h("p", { class: "source" }, h("strong", {}, `“${episode.scene.query}”`), ` ${episode.scene.title}`));
    player.load(episode, episode.steps.length - 1);
  } catch {
    problems.tell("episode", { problem: words.problems.episode, change: words.problems.episodeChange });
  }
}

for (const name of TABS)
  shell.tabs.append(h("a", { href: `#${name}`, title: words.tabs[`${name}Hint`] }, words.tabs[name]));
const stored = document.getElementById("episode")?.textContent?.trim();
if (stored) {
  shell.tabs.replaceChildren();
  replay(stored);
} else void connect();

/** For tests, and for people who look into the page: what is shown, in numbers. */
declare global {
  interface Window {
    eagorStudio: unknown;
  }
}
window.eagorStudio = {
  store,
  stage,
  get summary() {
    const { look } = store;
    return {
      yaw_deg: degrees(look.yaw), pitch_deg: degrees(look.pitch), field_deg: degrees(look.field), border: store.belief?.border ?? null,
      world_R_camera: store.pose, number: store.step?.number ?? null, drawn: stage.pace.drawn, rests: stage.pace.rests,
    };
  },
};
