/** A photograph or a video of a person's own. */

import { IDENTITY, pose, RADIANS } from "../math/rotation";
import { field, h, say, segmented } from "../ui/dom";
import { fieldQuestion } from "../ui/field";
import type { Page, ViewHandler } from "../ui/view";
import { Refused, upload } from "../wire/api";
import type { Picture } from "../wire/messages";
import { words } from "../words";

const EVERY = 50; // milliseconds between two attitudes that are sent
const STEEPEST = 80 * RADIANS;

export function picture(page: Page): ViewHandler {
  const { session, shell, store } = page;
  let known: Picture | null = null;
  let turns = "camera";
  let paused = false;
  const attitude = { yaw: 0, pitch: 0, roll: 0 };
  let sending = 0;
  let hfov: number | null = null; // degrees: what a person has said of an ordinary camera
  let asked = 0; // counts the files that were taken, and leaves: what is uploaded for an older one changes nothing
  const file = h("input", { type: "file", accept: "image/*,video/*", hidden: true, id: "file", onchange: () => take(file.files?.[0]) });
  const other = h("button", { type: "button", onclick: () => file.click() }, words.picture.other);
  const perception = h("select", { onchange: () => {
    if (known && !(session.active && session.ask(session.asked.query, perception.value))) open();
  } });
  const dragging = segmented(words.picture.turn, [["camera", words.picture.turnCamera], ["look", words.picture.turnLook]], turns, (what) => {
    turns = what;
    shell.keys.textContent = what === "camera" ? words.panorama.keysCamera : words.panorama.keys;
  });
  const slider = h("input", { type: "range", min: 0, value: 0, step: 1, "aria-label": words.picture.frame, oninput: () => seek() });
  const count = h("output", { class: "count" });
  const pause = h("button", { type: "button", onclick: () => {
    mark(!paused);
    session.send({ type: "pause", on: paused });
  } }, words.walk.pause);
  const frames = h("div", { class: "frames", hidden: true }, pause, slider, count);

  function mark(on: boolean): void {
    paused = on;
    pause.textContent = on ? words.walk.go : words.walk.pause;
  }

  function seek(): void {
    session.send({ type: "seek", frame: Number(slider.value) });
  }

  store.on("step", () => {
    const frame = store.step?.frame;
    if (!known || known.kind !== "video" || !frame) return;
    say(count, `${frame.n + 1} / ${frame.of}`);
    slider.max = String(Math.max(0, frame.of - 1));
    if (document.activeElement !== slider) slider.value = String(frame.n); // a hand on it leads
  });

  function invite(): void {
    const limits = page.state()?.limits;
    page.empty(
      h("strong", {}, words.picture.drop), h("p", {}, words.picture.dropMore),
      h("button", { type: "button", class: "primary", onclick: () => file.click() }, words.picture.choose),
      limits ? h("p", { class: "hint" }, words.picture.limits(limits.upload_bytes / 1e6, limits.pixels / 1e6)) : "");
  }

  async function take(chosen: File | undefined): Promise<void> {
    if (!chosen) return;
    const mine = ++asked;
    page.problems.clear("picture");
    try {
      const most = page.state()?.limits.upload_bytes;
      if (!/^(image|video)\//.test(chosen.type) && chosen.type !== "")
        throw new Refused(words.picture.notPicture(chosen.type), words.picture.notPictureChange);
      if (most && chosen.size > most)
        throw new Refused(words.picture.tooLarge(chosen.size / 1e6, most / 1e6), words.picture.tooLargeChange);
      page.empty(words.picture.uploading);
      const told = await upload(chosen);
      if (mine !== asked) return;
      known = told;
      hfov = null;
      Object.assign(attitude, { yaw: 0, pitch: 0, roll: 0 });
      other.hidden = false;
      frames.hidden = true; // until it plays
      slider.value = "0";
      say(count, "");
      slider.max = String(Math.max(0, known.frames - 1));
      const warnings = known.warnings ?? [];
      if (warnings.length) page.problems.tell("picture", { problem: warnings.join(" "), change: "" });
      session.close();
      store.begin(null);
      page.empty(h("strong", {}, words.picture.ready));
      if (known.ordinary && known.hfov_deg == null) return question();
      if (known.kind === "photo" && !known.ordinary) await showAtOnce(chosen, () => mine === asked && !session.active);
      if (mine !== asked || session.active) return; // it was asked for something meanwhile
      if (shell.query.value.trim()) open();
      else shell.query.focus();
    } catch (problem) {
      if (!(problem instanceof Refused)) throw problem;
      if (mine !== asked) return;
      page.problems.tell("picture", problem);
      if (known) page.empty();
      else invite();
    } finally {
      file.value = "";
    }
  }

  /** The one question about an ordinary camera whose file does not tell it. */
  function question(): void {
    const form = fieldQuestion((degrees) => {
      hfov = degrees;
      page.empty(h("strong", {}, words.picture.ready));
      if (shell.query.value.trim()) open();
      else shell.query.focus();
    });
    page.empty(form);
    form.querySelector("input")!.focus();
  }

  /** The photograph is shown before anything is asked: nothing of the server is needed for it. */
  async function showAtOnce(chosen: File, wanted: () => boolean): Promise<void> {
    const image = await createImageBitmap(chosen, { resizeWidth: 2048, resizeHeight: 1024, resizeQuality: "medium" }).catch(() => null);
    if (!image || !wanted()) return;
    store.panorama = { image, head: { stamp: 0, world_R_camera: IDENTITY } };
    store.emit("panorama");
    page.badge(words.picture.ready);
  }

  function open(): void {
    if (!known) return;
    if (known.ordinary && known.hfov_deg == null && hfov === null) return question();
    if (!store.panorama) page.empty(words.panorama.waiting);
    page.badge("");
    mark(false);
    frames.hidden = known.kind !== "video";
    session.open({ view: "picture", id: known.id, ...(hfov === null ? {} : { hfov }), query: shell.query.value.trim(), perception: perception.value });
  }

  function drop(event: DragEvent): void {
    event.preventDefault();
    shell.stage.classList.remove("over");
    void take(event.dataTransfer?.files[0]);
  }
  const over = (event: DragEvent) => {
    event.preventDefault();
    shell.stage.classList.add("over");
  };
  const out = () => shell.stage.classList.remove("over");

  return {
    enter() {
      const state = page.state();
      const usable = (state?.perceptions ?? []).filter(({ views }) => !views || views.includes("picture"));
      perception.replaceChildren(...usable.map(({ name, words: told, ready, problem }) =>
        h("option", { value: name, disabled: !ready, title: problem ?? told }, name)));
      shell.controls.replaceChildren(
        file, ...(usable.length ? [field(words.walk.perception, perception)] : []), dragging, other, frames);
      other.hidden = known === null;
      shell.keys.textContent = words.panorama.keysCamera;
      shell.stage.addEventListener("dragover", over);
      shell.stage.addEventListener("dragleave", out);
      shell.stage.addEventListener("drop", drop);
      if (known && shell.query.value.trim()) open();
      else invite();
    },
    leave() {
      asked++;
      shell.stage.removeEventListener("dragover", over);
      shell.stage.removeEventListener("dragleave", out);
      shell.stage.removeEventListener("drop", drop);
      shell.keys.textContent = words.panorama.keys;
      session.close();
    },
    ask(query) {
      if (!known) {
        page.problems.tell("picture", { problem: words.picture.drop, change: words.picture.dropMore });
        return;
      }
      if (!session.active || !session.ask(query)) open();
    },
    scene() {
      dragging.hidden = store.scene?.lens !== undefined; // an ordinary picture is shown whole
      if (store.waiting === null && store.scene?.perception) perception.value = store.scene.perception;
    },
    turnsCamera: () => turns === "camera" && session.active && !store.scene?.lens,
    turnCamera(yaw, pitch) {
      attitude.yaw = yaw;
      attitude.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, pitch));
      store.turnTo(pose(attitude.yaw, attitude.pitch, attitude.roll)); // the server's steps come after it
      if (sending) return;
      sending = window.setTimeout(() => {
        session.send({ type: "camera", ...attitude });
        sending = 0;
      }, EVERY);
    },
  };
}
