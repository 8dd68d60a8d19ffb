"""How much of what a detector says is lost? The tracker against the ideal filter and strong rivals, on the same looks.

    python benchmarks/ideal.py [--runs N] [--seed FIRST] [--worlds NAME ...] [--methods TEXT ...]

Synthetic detections of which everything is known (`ideal_worlds.py`: 70 % of the looks detect the target, with an error
of 8 degrees, among 0.2 false alarms a look), so that exact Bayes can be computed (`ideal_filters.py`; the others:
`ideal_rivals.py`). The worlds:

- `turning`: the target stands, the camera turns at random where it stands, 30 looks;
- `wrong`: the same looks, the filters' detector wrong by a factor 2 in one parameter at a time (P_D at most 0.95);
- `few`: the same after one, two, three looks: what is claimed, against what the ideal filter claims;
- `sharp`: as `turning`, with detections of 3 and of 1 degree;
- `walking`: the camera walks past the target as well, 0.25 m a look;
- `moving`: a constant turn, random walks, jumps, against filters that know the motion, 45 looks. "Bayes, motion
  unknown" has all of our prior instead (`ideal_fair.py`): on average over that prior no filter is nearer. "told":
  `MotionModel` states the motion; of a turn, whose axis and rate the ideal filter knows, the poses are given in axes
  that turn along, "told that it turns" states neither;
- `drift`: the camera yaws, and its odometry drifts by 1 degree a second; with detections of 8 and of 3 degrees. To
  "Bayes, motion unknown" that is a target that turns;
- `habits`: as `turning`, but the target and what is taken for it are each detected in a share of the looks of their
  own (beta distributions). The model stated is that of this world, the one that is learnt states only the spread,
  "looks independent" is that of the other worlds, P_D and false alarms stated. The target is there; then in half of
  the runs, which scores the presence: the log of the probability that was given to the truth.

Error: degrees from the answer (where the density is highest) to the target, mean over all looks from the first
detection on, and at the end of a run.
Nats: log density at the truth per steradian, behind the ideal filter's, mean over all looks (and from the tenth look
on, when rates are learnt). Coverage: how often the truth is in the smallest region that is said to hold 50, 90, 99 %.
Distance: |log(distance / truth)| at the end. Time: CPU milliseconds a look, answer included (scoring not), contestants
alternating run by run, the median over runs.
"says": how often our tracker says each word, and how often it is then within 15 degrees of the truth.
--runs (by default 100) of each world, from seed --seed on; --methods: only names with one of these texts in them.
Brackets are 95 % bootstrap intervals over runs. Seeds below 2000 are for development; reports start at 8000. `few`
compares what each filter says of ITS OWN answer with what the ideal says of its own; `within 15` is the mass within 15
degrees if the target is there, "both" is that times presence, which is what `Estimate.within` says.

A hundred runs take about ten minutes, most of them for the walking world. The exact walking filter is approximate in
its integrals: its density is 0.006 nats too high on average (finer cells lower it by so much), in its own favour. That
of habits keeps 2,000 hypotheses: with 12,000 its densities change by 0.004 nats on average, and by up to 0.06 over a
run in the few where two things overlap. "Bayes, motion unknown" keeps 3,000 histories by lots: twice as many change
mean nats by 0.006 at most, and a run by up to 0.05.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import common
import numpy as np
from ideal_fair import FairBayes
from ideal_filters import NEAR, Assigned, Contestant, StillOrKnown, Walked
from ideal_rivals import Core, RivalGrid, RivalParticles, Tracker, learnt, stated, stated_habits
from ideal_worlds import STEP, WORLDS, Detector, Run, make

from eagor import MotionModel, TrackerConfig
from eagor.sphere import angular_distance

LEVELS = (0.5, 0.9, 0.99)
FEW = 3  # looks whose claims are kept,
AFTER = (1, 3, 10, 30)  # and others; scores are told after so many looks
LATE = 10  # looks, after which little of a detector is left to learn
IDEAL = "ideal"
OURS = "eagor"
LEARNT = "eagor, model learnt"
TRUE = Detector()
WRONG = {
    "P_D 0.35": Detector(detection=0.35),
    "P_D 0.95": Detector(detection=0.95),
    "clutter 0.1": Detector(alarms=0.1),
    "clutter 0.4": Detector(alarms=0.4),
    "spread 4": Detector(spread=4.0),
    "spread 16": Detector(spread=16.0),
}
PARTICLES = {  # smoothing, whether particles are drawn to their mean first; tuned on seeds 0 to 99
    (5_000, "roughened"): (0.17, False),
    (5_000, "Liu-West"): (0.2, True),
    (20_000, "roughened"): (0.12, False),
    (20_000, "Liu-West"): (0.15, True),
}
GROUPS = {group for group, _ in WORLDS.values()} | {"wrong", "few"}  # these two look at the runs of `turning`
FINE = 256  # HEALPix sides for sharp detections: cells of 0.2 degrees
TOLD = {  # what a user would state who knows as much of the motion as the ideal filter does
    "constant turn, 10 deg/s": MotionModel.still(),  # in axes that turn along
    "random walk, 2 deg/sqrt(s)": MotionModel(wander=(math.radians(2),), turn=(), start=1, stop=0, jump=0),
    "random walk, 10 deg/sqrt(s)": MotionModel(wander=(math.radians(10),), turn=(), start=1, stop=0, jump=0),
    "jumps, every 15 s": MotionModel(wander=(), turn=(math.radians(0.01),), start=1, stop=0, jump=1 / 15),
}
CIRCLING = MotionModel(wander=(), turn=(math.radians(6),), start=1, stop=0, jump=0)  # neither axis nor rate
Factory = Callable[[Run, int], Contestant]
Rows = dict[str, dict[str, np.ndarray]]  # of each contestant, values per run
DIRECTIONS: dict[str, Factory] = {  # rivals that believe in directions alone
    "Belief, degree 15": lambda run, seed: Core(run.detector, 15),
    "Belief, degree 31": lambda run, seed: Core(run.detector, 31),
    "PyRecEst, 12,288 cells": lambda run, seed: RivalGrid(run.detector),
    "PyRecEst, 5,000 directions": lambda run, seed: RivalParticles(
        run.detector, seed, 5_000, *PARTICLES[5_000, "Liu-West"]
    ),
}


def contestants(world: str, wanted: set[str]) -> dict[str, Factory]:
    """Who takes part in this world, as (run, seed) -> filter; the first is the ideal one."""
    group = WORLDS[world][0]
    ours: dict[str, Factory] = {
        OURS: lambda run, seed: Tracker(stated(run.detector)),
        LEARNT: lambda run, seed: Tracker(learnt(run.detector)),
    }
    if group == "walking":
        particles: dict[str, Factory] = {
            f"PyRecEst, {count:,}, {how}": lambda run, seed, c=count, s=settings: RivalParticles(
                TRUE, seed, c, *s, walks=True
            )
            for (count, how), settings in PARTICLES.items()
        }
        return {IDEAL: lambda run, seed: Walked(TRUE), **ours, **particles}
    if group == "sharp":
        return {IDEAL: lambda run, seed: StillOrKnown(run.detector, nside=FINE), OURS: ours[OURS], **DIRECTIONS}
    if group == "habits":
        return {
            IDEAL: lambda run, seed: Assigned(TRUE),
            OURS: lambda run, seed: Tracker(stated_habits(TRUE)),
            LEARNT: ours[LEARNT],
            f"{OURS}, looks independent": ours[OURS],
            "Bayes, looks independent": lambda run, seed: StillOrKnown(TRUE),
        }
    known: dict[str, Factory] = {IDEAL: lambda run, seed: StillOrKnown(run.detector, run.motion)}
    if group in ("moving", "drift"):
        known["Bayes, motion unknown"] = lambda run, seed: FairBayes(run.detector, seed)
    if group == "drift":
        return known | {"Bayes, drift left out": lambda run, seed: StillOrKnown(run.detector)} | ours
    if world in TOLD:
        config = TrackerConfig(target_motion=TOLD[world])
        found = known | ours | {f"{OURS}, told": lambda run, seed: Tracker(stated(TRUE), config, run.motion)}
        if "turn" in world:
            circling = TrackerConfig(target_motion=CIRCLING)
            found[f"{OURS}, told that it turns"] = lambda run, seed: Tracker(stated(TRUE), circling)
        return found
    if wanted & {"turning", "few"}:
        known |= ours
    if "turning" in wanted:
        known |= DIRECTIONS
    if "wrong" in wanted:
        for name, model in WRONG.items():
            known[f"{IDEAL}, {name}"] = lambda run, seed, model=model: StillOrKnown(model)
            known[f"{OURS}, {name}"] = lambda run, seed, model=model: Tracker(stated(model))
    return known


def follow(filter_: Contestant, run: Run) -> dict[str, Any]:
    """One contestant through one run: values per look ``(T,)``, nan where there is nothing to say yet."""
    steps, truths = len(run), run.truths
    error, above, log_density = (np.full(steps, np.nan) for _ in range(3))
    claims, words, seconds = np.full((steps, 2), np.nan), [], 0.0
    for t in range(steps):
        position = None if run.positions is None else run.positions[t]
        before = time.process_time()
        filter_.look(t * STEP, run.told[t], position, run.looks[t])
        seconds += time.process_time() - before
        words.append(filter_.word)
        if t < FEW or t + 1 in AFTER:
            claims[t] = filter_.claim()
        if not run.present:
            continue
        log_density[t] = filter_.log_density(truths[t])
        if any(len(look) for look in run.looks[: t + 1]):
            guess = filter_.direction is None
            error[t] = 90.0 if guess else math.degrees(angular_distance(filter_.direction, truths[t]))
            above[t] = filter_.mass_above(truths[t])
    found = {"error": error, "log_density": log_density, "above": above, "claims": claims}
    found |= {"words": words, "ms": 1000 * seconds / steps, "present": run.present}
    if run.positions is not None:
        told = filter_.distance
        found["distance"] = math.nan if told is None else abs(math.log(told / run.distances[-1]))
    return found


def measure(world: str, factories: Mapping[str, Factory], first: int, runs: int) -> Rows:
    """All contestants on the same runs, in an order that changes from run to run; values per run."""
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in factories}
    names = list(factories)
    for number in range(runs):
        run = make(world, first + number)
        shift = number % len(names)
        for name in names[shift:] + names[:shift]:
            found[name].append(follow(factories[name](run, first + number), run))
        if number % 10 == 9:
            print(f"\r... {world}: {number + 1} of {runs} ", end="", file=sys.stderr, flush=True)
    print(f"\r{'':60s}\r", end="", file=sys.stderr)
    return {name: {key: np.array([r[key] for r in rows]) for key in rows[0]} for name, rows in found.items()}


def show(title: str, rows: Rows, names: Sequence[str], late: bool = False) -> None:
    """The table of a world; `late`: also nats from look `LATE` on.

    Coverage and the mean error count every look alike, their intervals draw whole runs.
    """
    walked = any("distance" in rows[name] for name in names)
    print(f"\n{title}")
    print(
        f"  {'':28s} {'error, mean [95 %]':>22s} {'at the end':>10s} {'nats behind [95 %]':>24s}"
        f"{f'  from look {LATE} on [95 %]' if late else ''}"
        f" {'50':>5s} {'90':>5s} {'99 %':>5s}{'  distance' if walked else ''} {'ms':>7s}"
    )
    for name in names:
        row = rows[name]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a run without any detection has no errors
            error = common.shown(np.nanmean(row["error"], axis=1))
        told, behind = np.isfinite(row["above"]), rows[IDEAL]["log_density"] - row["log_density"]
        nats = "".join(f" {common.shown(behind[:, k:].mean(axis=1), 3):>24s}" for k in (0, LATE - 1)[: 1 + late])
        cover = " ".join(f"{np.mean(row['above'][told] <= level):5.2f}" for level in LEVELS)
        far = f"  {np.mean(row['distance'][np.isfinite(row['distance'])]):8.3f}" if walked else ""
        end = np.nanmean(row["error"][:, -1])
        print(f"  {name:28s} {error:>22s} {end:10.2f}{nats} {cover}{far} {np.median(row['ms']):7.2f}")


def show_presence(title: str, rows: Rows) -> None:
    """The log of what was claimed for the truth, whether the target is there."""
    print(f"\n{title}")
    print(f"  {'looks, [95 %]':28s}" + "".join(f" {count:>24d}" for count in AFTER))
    for name, row in rows.items():
        claimed = row["claims"][..., 0]
        there = np.log(np.maximum(np.where(row["present"][:, None], claimed, 1 - claimed), 1e-12))
        print(f"  {name:28s}" + "".join(f" {common.shown(there[:, count - 1], 3):>24s}" for count in AFTER))


def show_few(rows: Rows) -> None:
    """Claims against the ideal's after 1, 2, 3 looks: mean and largest difference; "within 15" where it answers."""
    print("\nfew looks: away from what the ideal filter claims, mean (largest)")
    print(f"  {'':28s} {'looks':>5s} {'presence':>16s} {'within 15':>16s} {'both':>16s}")
    for name in (name for name in (OURS, LEARNT) if name in rows):
        for look in range(FEW):
            ideal, ours = (rows[n]["claims"][:, look] for n in (IDEAL, name))
            away = np.abs(np.column_stack([ours - ideal, ours.prod(axis=1) - ideal.prod(axis=1)])).T
            known = [column[np.isfinite(column)] for column in away]
            cells = [f"{column.mean():7.3f} ({column.max():.3f})" if len(column) else "-" for column in known]
            print(f"  {name:28s} {look + 1:5d} " + " ".join(f"{cell:>16s}" for cell in cells))


def show_words(rows: dict[str, np.ndarray]) -> None:
    """How often our tracker says each word, and how often it is then within 15 degrees of the truth, with intervals."""
    cells = []
    for word in ("tracking", "ambiguous", "searching"):
        said, right = rows["words"] == word, rows["error"] <= math.degrees(NEAR)  # nan, before any detection, is wrong
        if said.any():
            draws = np.random.default_rng(0).integers(len(said), size=(2000, len(said)))  # whole runs
            counts, hits = said.sum(axis=1)[draws].sum(axis=1), (said & right).sum(axis=1)[draws].sum(axis=1)
            low, high = np.quantile(hits[counts > 0] / counts[counts > 0], [0.025, 0.975])
            cells.append(f"{word} {said.mean():.0%}, right in {right[said].mean():.1%} [{low:.1%}, {high:.1%}]")
    print("  says: " + "; ".join(cells))


def main() -> None:
    options = common.parser(__doc__, runs=100, seed=0, worlds=tuple(sorted(GROUPS)), methods=[""]).parse_args()
    wanted = set(options.worlds)

    print(f"{options.runs} runs from seed {options.seed}")
    for world, (group, _) in WORLDS.items():
        if group not in wanted and not (group == "turning" and wanted & {"wrong", "few"}):
            continue
        factories = {
            name: factory
            for name, factory in contestants(world, wanted).items()
            if name == IDEAL or any(text in name for text in options.methods)
        }
        rows = measure(world, factories, options.seed, options.runs)
        wrong = [n for n in rows if n.removeprefix(f"{IDEAL}, ").removeprefix(f"{OURS}, ") in WRONG]
        if "absent" in world:
            show_presence(f"{world}: log score of the presence", rows)
        else:
            show(world, rows, [name for name in rows if name not in wrong], world in ("turning", "habits"))
        if OURS in rows:
            show_words(rows[OURS])
        if wrong:
            show("turning, the detector wrong by a factor 2", rows, wrong)
        if world == "turning" and "few" in wanted:
            show_few(rows)


if __name__ == "__main__":
    main()
