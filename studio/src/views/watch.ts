/** What is watched as it comes: a walk, a picture or a video of one's own, a camera. One view whose source changes. */

import { IDENTITY } from "../math/rotation";
import { field, fieldQuestion, h, segmented } from "../ui/dom";
import type { Page, Tab, View } from "../ui/page";
import { Stick } from "../ui/stick";
import { Refused, upload } from "../wire/api";
import type { Upload } from "../wire/messages";
import { words } from "../words";

export function watch(page: Page): View {
  const { session, shell, store } = page;
  let tab: Tab = "walk";
  let drive = "";
  let paused = false;
  let known: Upload | null = null; // the file that was dropped
  let hfov: number | undefined; // degrees: what a person has said of an ordinary camera
  let taken = 0; // counts the files that were taken, and leaves: what is uploaded for an older one changes nothing

  const seed = h("input", { type: "number", min: 0, step: 1, list: "houses", class: "short", onchange: () => open() });
  const offered = h("datalist", { id: "houses" });
  const perception = h("select", { onchange: () => {
    if (store.scene && !session.ask(session.asked.query, perception.value)) open(session.asked.query);
  } });
  const stick = new Stick((forward, turn, seconds) => session.send({ type: "drive", by: "person", forward, turn, seconds }));
  const ways = [["tour", words.walk.tour], ["policy", words.walk.policy], ["person", words.walk.person]] as const;
  const steering = segmented(words.walk.drive, ways, drive, (by) => {
    stick.stop();
    if (by === "tour") {
      seed.value = String(page.state().houses.offered[0]);
      return open("", "tour");
    }
    drive = by;
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
  const again = h("button", { type: "button", onclick: () => {
    wait(false);
    session.send({ type: "restart" });
  } }, words.walk.start);
  const buttons = h("span", { class: "buttons", hidden: true }, pause, again);
  const file = h("input", { type: "file", accept: "image/*,video/*", hidden: true, id: "file", onchange: () => take(file.files?.[0]) });
  const other = h("button", { type: "button", onclick: () => file.click() }, words.picture.other);

  function hold(on: boolean): void {
    wait(on);
    session.send({ type: "pause", on });
  }

  function wait(on: boolean): void {
    paused = on;
    pause.textContent = on ? words.walk.go : words.walk.pause;
  }

  function mark(): void {
    const mine = tab === "walk" && drive === "person";
    for (const one of steering.querySelectorAll("input")) one.checked = one.value === drive;
    shell.stick.replaceChildren(...(mine ? [stick.element] : []));
    if (mine) shell.keys.textContent = words.panorama.keysDrive;
    else if (!store.scene?.lens) shell.keys.textContent = words.panorama.keys;
  }

  /** Watch the source of this tab; `by`: begin the walk anew. */
  function open(query = "", by = ""): void {
    if (tab === "picture" && (!known || !query)) return invite();
    wait(false);
    if (!store.panorama) page.empty(words.panorama.waiting);
    page.badge("");
    const source = tab === "walk" ? `apartment:${Number(seed.value)}` : tab === "picture" ? `upload:${known!.id}` : "live";
    session.open({
      source, query, perception: tab === "live" && !query ? "" : perception.value, ...(by ? { drive: by } : {}),
      ...(hfov && tab !== "walk" ? { hfov } : {}),
    });
  }

  /** Words over the stage while there is no picture, or none that is asked for anything. */
  function invite(): void {
    if (known) {
      page.empty(h("strong", {}, words.picture.ready));
      shell.query.focus();
      return;
    }
    const { limits } = page.state();
    page.empty(
      h("strong", {}, words.picture.drop), h("p", {}, words.picture.dropMore),
      h("button", { type: "button", class: "primary", onclick: () => file.click() }, words.picture.choose),
      h("p", { class: "hint" }, words.picture.limits(limits.upload_bytes / 1e6, limits.pixels / 1e6)));
  }

  async function take(chosen: File | undefined): Promise<void> {
    if (!chosen) return;
    const mine = ++taken;
    page.problems.clear("picture");
    try {
      const most = page.state().limits.upload_bytes;
      if (chosen.size > most) throw new Refused(words.picture.tooLarge(chosen.size / 1e6, most / 1e6), words.picture.tooLargeChange);
      page.empty(words.picture.uploading);
      const told = await upload(chosen);
      if (mine !== taken) return;
      [known, hfov, other.hidden] = [told, undefined, false];
      session.close();
      store.begin(null);
      const query = shell.query.value.trim();
      if (known.kind === "photo" && !query) await showAtOnce(chosen, () => mine === taken && !session.active);
      if (!store.panorama || query) open(query);
    } catch (problem) {
      if (!(problem instanceof Refused)) throw problem;
      if (mine !== taken) return;
      page.problems.tell("picture", problem);
      if (store.panorama) page.empty();
      else invite();
    } finally {
      file.value = "";
    }
  }

  /** A panorama is shown before anything is asked: nothing of the server is needed for it. */
  async function showAtOnce(chosen: File, wanted: () => boolean): Promise<void> {
    const image = await createImageBitmap(chosen, { resizeWidth: 2048, resizeQuality: "medium" }).catch(() => null);
    if (!image || !wanted() || Math.abs(image.width / image.height - 2) > 0.02) return;
    store.picture(image, { stamp: 0, world_R_camera: IDENTITY });
    page.badge(words.picture.ready);
    shell.query.focus();
  }

  const drop = (event: DragEvent) => {
    event.preventDefault();
    shell.stage.classList.toggle("over", event.type === "dragover");
    if (event.type === "drop") void take(event.dataTransfer?.files[0]);
  };
  const DRAGS = ["dragover", "dragleave", "drop"] as const;

  return {
    enter(now) {
      tab = now;
      const state = page.state();
      const kind = tab === "walk" ? "simulated" : "pictures";
      const usable = state.perceptions.filter((one) => one.for.includes(kind));
      perception.replaceChildren(...usable.map(({ name, words: told, problem }) =>
        h("option", { value: name, disabled: problem !== "", title: problem || told }, name)));
      seed.max = String(state.houses.last);
      seed.value ||= String(state.houses.offered[0]);
      offered.replaceChildren(...state.houses.offered.map((value) => h("option", { value })));
      other.hidden = known === null;
      const chooser = field(words.walk.perception, perception);
      shell.controls.replaceChildren(...{
        walk: [field(words.walk.house, seed), offered, chooser, steering],
        picture: [file, chooser, other],
        live: state.source ? [h("p", { class: "source" }, `${words.live.source}: ${state.source}`), chooser] : [],
      }[tab as "walk"], buttons);
      buttons.hidden = true;
      mark();
      if (tab === "picture") for (const name of DRAGS) shell.stage.addEventListener(name, drop);
      if (tab === "live" && !state.source) page.empty(h("strong", {}, words.live.none), h("p", {}, words.live.noneChange));
      else if (usable.every((one) => one.problem)) page.empty(h("strong", {}, words.walk.none), h("p", {}, usable[0].problem));
      else open(tab === "picture" ? shell.query.value.trim() : "");
    },
    leave() {
      taken++;
      for (const name of DRAGS) shell.stage.removeEventListener(name, drop);
      stick.stop();
      shell.stick.replaceChildren();
      session.close();
    },
    ask(query) {
      if (tab === "picture" && !known) page.problems.tell("picture", { problem: words.picture.drop, change: words.picture.dropMore });
      else if (!session.active || !session.ask(query)) open(query);
    },
    scene() {
      const { scene } = store;
      if (!scene) return;
      buttons.hidden = !scene.pauses;
      if (store.waiting !== null) return;
      if (scene.seed !== undefined) seed.value = String(scene.seed);
      if (scene.perception) perception.value = scene.perception;
      drive = scene.drive ?? drive;
      mark();
    },
    question(why) {
      const form = fieldQuestion((told) => {
        hfov = told;
        open(session.asked.query || store.scene?.query);
      }, why);
      page.empty(form);
      form.querySelector("input")!.focus();
    },
    steer: (key, down, at) => tab === "walk" && drive === "person" && stick.key(key, down, at),
  };
}
