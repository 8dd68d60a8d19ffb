/** The answer in words and numbers, the candidates, the plots and their equivalents in words. */

import { drawPlan, interval } from "../draw/plan";
import { RIVALS } from "../draw/palette";
import { around, BINS, drawPolar } from "../draw/polar";
import { drawSeries, span, type Strip } from "../draw/series";
import type { Stage } from "../draw/stage";
import { apply, azimuthOf, degrees, elevationOf, inverse, wrapped, type Vector } from "../math/rotation";
import type { Store } from "../store";
import { tenths, words } from "../words";
import { h, say } from "./dom";
import type { Shell } from "./shell";

const SLOW = 3; // seconds since the newest look: from here on the page says so
const PLOTS = 150; // milliseconds between two drawings of the plots: the panorama comes first
const TALK = 900; // milliseconds between two changes of the words that stand for plots
const NEWS = 4000; // milliseconds between two announcements to screen readers

export class Panels {
  private scheduled = false;
  private talked = 0;
  private announced = 0;
  private plotted = 0;
  private later = 0;

  constructor(private readonly store: Store, private readonly shell: Shell, private readonly stage: Stage) {
    for (const topic of ["scene", "step", "look", "style", "layers"] as const) store.on(topic, () => this.request());
    new ResizeObserver(() => this.request()).observe(shell.look);
    this.request();
  }

  private request(): void {
    if (this.scheduled) return;
    this.scheduled = true;
    requestAnimationFrame(() => {
      this.scheduled = false;
      this.answer();
      this.modes();
      const wait = PLOTS - (performance.now() - this.plotted);
      if (wait <= 0) this.plots();
      else if (!this.later) this.later = window.setTimeout(() => this.plots(), wait);
      if (performance.now() - this.talked > TALK) this.talk();
      else setTimeout(() => performance.now() - this.talked > TALK && this.talk(), TALK);
    });
  }

  private where(d: Vector): string {
    return words.candidates.row(degrees(azimuthOf(d)), degrees(elevationOf(d)));
  }

  /** "1.2 to 3.4 m", or nothing. */
  private get far(): string {
    const { answer } = this.store;
    const found = answer && answer.status !== "searching" && interval(answer.distance_m, answer.distance_spread);
    return found ? words.answer.metres(rounded(found.near), rounded(found.far)) : "";
  }

  private answer(): void {
    const { store, shell } = this;
    const { answer, direction, lookingFor, step } = store;
    const state = lookingFor === null ? (answer?.status ?? "") : "";
    shell.status.dataset.status = state || "none";
    const named = state ? (words.status[state as "tracking"] as string | undefined) ?? state : words.status.none;
    const name = lookingFor === null ? named : words.status.waiting;
    say(shell.status, name);
    const none = lookingFor === null ? words.answer.none : words.ask.waiting(lookingFor);
    const other = state && answer?.looked_for ? words.answer.lookedFor(answer.looked_for) : "";
    const told = (direction ? this.where(direction) : none) + other;
    say(shell.sentence, told[0].toUpperCase() + told.slice(1));
    const age = store.waiting === null ? (step?.look?.age ?? null) : null;
    const likely = state === "searching" && (answer?.presence ?? 0) > 0.5;
    const means = likely ? words.status.likely : (words.status.means[state] ?? "");
    say(shell.means, age !== null && age > SLOW && state ? words.answer.slow : means);
    const region = store.scene?.region ?? 0.9;
    const dash = words.answer.unknown;
    const rows: [string, string, boolean?][] = [
      [words.answer.presence, answer?.presence == null ? dash : words.percent(answer.presence)],
      [words.answer.cone(region), answer?.credible_angle_deg == null ? dash : words.answer.degrees(answer.credible_angle_deg)],
      [words.answer.sure, answer?.sure == null ? dash : words.answer.howSure(answer.sure)],
      [words.answer.distance, this.far || dash],
      [words.answer.entropy, answer?.entropy == null ? dash : words.answer.nats(answer.entropy)],
    ];
    if (answer?.moving != null) rows.push([words.answer.moving, words.percent(answer.moving)]);
    if (store.truth || store.error !== null)
      rows.push([words.answer.error, store.error === null ? dash : words.answer.degrees(store.error)]);
    rows.push([words.answer.look, age === null ? words.answer.never : words.answer.seconds(age), age !== null && age > SLOW]);
    fill(shell.facts, rows);
    this.news(`${name}. ${told}`);
  }

  private news(text: string): void {
    if (performance.now() - this.announced < NEWS || !this.store.step || text === this.shell.news.textContent) return;
    this.announced = performance.now();
    say(this.shell.news, text);
  }

  private modes(): void {
    const { list, candidates } = this.shell;
    const { modes } = this.store;
    candidates.classList.toggle("none", modes.length === 0);
    if (list.dataset.count !== String(modes.length)) {
      list.dataset.count = String(modes.length);
      list.replaceChildren(...modes.map((_, i) =>
        h("li", {}, h("button", { type: "button", onclick: () => this.stage.lookAt(this.store.modes[i].direction) },
          h("span", { class: "where" }), h("span", { class: "weight" }), h("i", { "aria-hidden": "true" }, h("b"))))));
      if (!modes.length) list.append(h("li", { class: "nothing" }, words.candidates.none));
    }
    modes.forEach(({ direction, weight }, i) => {
      const row = list.children[i];
      row.querySelector("button")!.disabled = this.stage.lens !== null; // there is nowhere to look to
      say(row.querySelector(".where")!, this.where(direction));
      say(row.querySelector(".weight")!, words.percent(weight));
      row.querySelector("b")!.style.inlineSize = `${Math.round(100 * weight)}%`;
    });
  }

  private get byAzimuth(): number[] | null {
    return this.store.waiting === null ? (this.store.step?.around ?? null) : null;
  }

  private plots(): void {
    clearTimeout(this.later);
    this.later = 0;
    this.plotted = performance.now();
    const { store, stage, shell } = this;
    const world_R_body = stage.world_R_body;
    const { gaze } = stage;
    const direction = store.layers.has("estimate") ? store.direction : null;
    drawPolar(shell.polar.canvas, {
      share: this.byAzimuth,
      answer: direction,
      modes: store.layers.has("modes") ? store.modes : [],
      truth: store.layers.has("truth") ? store.truth : null,
      rivals: store.others,
      gaze,
      worldX: store.step ? azimuthOf(apply(inverse(world_R_body), [1, 0, 0])) : null,
    });
    const path = this.path;
    shell.plan.card.hidden = !store.scene?.plan && path.length === 0;
    const far = interval(store.answer?.distance_m, store.answer?.distance_spread);
    const inWorld = direction && apply(world_R_body, direction);
    const view = apply(world_R_body, apply(stage.body_R_view, [1, 0, 0]));
    drawPlan(shell.plan.canvas, {
      plan: store.scene?.plan ?? null,
      path,
      others: (store.scene?.methods ?? []).flatMap(({ name }, index) => {
        const way = store.scene?.paths?.[name];
        return way && store.rivals.has(name) ? [{ path: way, colour: RIVALS[index % RIVALS.length].colour }] : [];
      }),
      heading: azimuthOf(apply(world_R_body, [1, 0, 0])),
      gaze: { azimuth: azimuthOf(view), wide: gaze.wide },
      answer: inWorld && { azimuth: azimuthOf(inWorld), range: far },
      goal: store.step?.goal?.position ?? null,
    });
    drawSeries(shell.series.canvas, { stamps: store.history.map(({ stamp }) => stamp), strips: this.strips, now: store.now });
  }

  private get path(): number[][] {
    return this.store.history.slice(0, this.store.now + 1).flatMap(({ position }) => (position ? [position] : []));
  }

  private get strips(): Strip[] {
    const { history } = this.store;
    const [errors, entropies] = [history.map(({ error }) => error), history.map(({ entropy }) => entropy)];
    const strips: Strip[] = [];
    if (errors.some((value) => value !== null)) {
      const high = [15, 45, 90, 180].find((limit) => errors.every((value) => (value ?? 0) <= limit)) ?? 180;
      strips.push({ name: words.series.error, values: errors, low: 0, high, colour: "error", format: words.answer.degrees });
    }
    strips.push({
      name: words.series.presence, values: history.map(({ presence }) => presence), low: 0, high: 1, colour: "answer", format: words.percent,
    });
    const known = entropies.filter((value) => value !== null);
    strips.push({
      name: words.series.entropy, values: entropies, low: Math.min(-4, ...known.slice(-500)), high: 2.6, colour: "heat-line",
      format: tenths,
    });
    return strips;
  }

  /** The plots in words. */
  private talk(): void {
    this.talked = performance.now();
    const { store, stage, shell } = this;
    const share = this.byAzimuth;
    const ahead = apply(stage.body_R_view, [1, 0, 0]);
    const view = this.where(ahead);
    if (share) {
      let best = 0;
      share.forEach((value, k) => { if (value > share[best]) best = k; });
      const peak = words.side(degrees(wrapped((best / BINS) * 2 * Math.PI)));
      say(shell.polar.text, words.polar.text(peak, around(share, best, Math.round(BINS / 12)), view));
    } else say(shell.polar.text, words.polar.empty);
    let walked = 0;
    this.path.forEach((p, i, all) => { if (i) walked += Math.hypot(p[0] - all[i - 1][0], p[1] - all[i - 1][1]); });
    say(shell.plan.text, this.path.length ? words.plan.text(walked, this.far) : words.plan.none);
    const told = this.strips.flatMap(({ name, values, format }) => {
      const known = values.flatMap((value) => (value === null ? [] : [value]));
      if (!known.length) return [];
      const now = values[store.now] ?? known.at(-1)!;
      return [words.series.text(name, format(known[0]), format(now), format(Math.min(...known)), format(Math.max(...known)))];
    });
    say(shell.series.text, told.join(" ") || words.series.none);
    say(shell.looking, words.panorama.looking(degrees(azimuthOf(ahead)), degrees(elevationOf(ahead)), degrees(store.look.field)));
    say(shell.told, store.step ? `${shell.status.textContent}. ${shell.sentence.textContent}.` : words.panorama.noPicture);
  }

  /** The moment of the time line under a pixel of its canvas. */
  momentAt(x: number): number {
    const { canvas } = this.shell.series;
    const [left, right] = span(canvas.clientWidth);
    const { history } = this.store;
    if (!history.length) return 0;
    const [first, last] = [history[0].stamp, history.at(-1)!.stamp];
    const stamp = first + ((x - left) / (right - left)) * (last - first);
    let best = 0;
    history.forEach((moment, i) => {
      if (Math.abs(moment.stamp - stamp) < Math.abs(history[best].stamp - stamp)) best = i;
    });
    return best;
  }
}

function rounded(metres: number): string {
  if (metres >= 10) return String(Number(metres.toPrecision(2)));
  return String(Math.round(10 * metres) / 10);
}

function fill(list: HTMLElement, rows: [string, string, boolean?][]): void {
  const names = rows.map(([name]) => name).join("|");
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    list.replaceChildren(...rows.map(([name]) => h("div", {}, h("dt", {}, name), h("dd"))));
  }
  rows.forEach(([, value, alarm], i) => {
    const place = list.children[i].lastElementChild!;
    say(place, value);
    place.classList.toggle("alarm", alarm ?? false);
  });
}
