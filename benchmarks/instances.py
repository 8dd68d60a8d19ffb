"""One thing, one among others like it, or several alike: are the candidates, the status and the decision right?

    python benchmarks/instances.py [--perception scout] [--episodes 60] [--seed 940] [--out DIR] [--workers 2]

Along the routes of Waypoint Following, at each step, the tracker is asked for

- *one of a kind*: a thing whose category is there once ("sofa");
- *one among others*: a thing that its colour singles out among others of its category ("red chair");
- *several alike*: a category that is there more than once ("chair"): any of them is a right answer, and once two have
  been in sight the honest status is `ambiguous`.

A direction counts as right within `RIGHT` degrees of a thing that answers the query. Printed, with 95 % intervals over
apartments: how often the answer is right, how often each status is said, how often it is right when it is said, how
many of the modes are things that answer and how many of those seen are among the modes. With --out the reliability of
the modes is drawn: where the tracker gives a mode the weight w (the probability of its basin), a share w of such modes
should be right.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import json
import multiprocessing
import sys
from collections import Counter
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.evaluation.calibration import Recorder
from eagor.queries import COLOURS
from eagor.sphere import angular_distance
from eagor.statistics import bootstrap_interval
from eagor.tasks.episodes import Slot
from eagor.tasks.places import APARTMENT, UNTARGETED, Place, load_place
from eagor.tasks.play import Recording
from eagor.tracking.tracker import DirectionTracker

RIGHT = 15.0  # degrees
KINDS = ("one of a kind", "one among others", "several alike")
STATUS = ("searching", "tracking", "ambiguous")
PIXELS = 2  # of a 64 x 128 panorama, from which on a thing counts as in sight, as in the tasks
BINS = np.linspace(0, 1, 11)
PER_PLACE = 2


@dataclass(frozen=True)
class Step:
    """One answer: how many things that answer were seen so far, how many are in sight now, and what was said."""

    seed: int
    kind: str
    seen: int
    in_sight: int
    right: bool
    status: str
    presence: float
    modes: tuple[tuple[float, bool], ...]  # weight, and whether a thing that answers lies there
    found: int  # how many of those seen are among the modes


@cache
def _recorder(perception: str) -> Recorder:
    return Recorder(perception)


def steps_of(job: tuple[str, Slot]) -> list[Step]:
    """All answers along one route, about one thing and about several."""
    perception, slot = job
    player = _recorder(perception).players["waypoint"]
    try:
        episode = player.plan(slot)
    except EagorError as error:
        print(f"  {slot.id} left out: {error}", file=sys.stderr)
        return []
    place = load_place(slot.world, slot.seed, player.camera.radius)
    things = place.scene.instances
    counts = Counter(thing.category for thing in things if thing.category not in UNTARGETED)
    several = sorted(category for category, count in counts.items() if count > 1)
    rng = slot.rng("several")
    other = str(rng.choice(several)) if several else ""
    recording = player.record(episode, other)
    coloured = episode.query.split()[0] in COLOURS
    asked = [(KINDS[1] if coloured else KINDS[0], list(episode.targets), False)]
    if other:
        asked.append((KINDS[2], [i for i, thing in enumerate(things) if thing.category == other], True))
    return [
        step for kind, members, second in asked for step in _answers(recording, place, kind, members, second, player)
    ]


def _answers(
    recording: Recording, place: Place, kind: str, members: list[int], second: bool, player: Any
) -> list[Step]:
    tracker, seen, found = DirectionTracker(player.ours), np.zeros(len(members), dtype=bool), []
    centres = np.array([place.scene.instances[member].centre for member in members])
    for moment in recording.moments:
        tracker.add_pose(moment.stamp, moment.world_R_body, moment.position)
        evidence = moment.other if second else moment.evidence
        if evidence is not None:
            tracker.observe(evidence)
        ids = place.ids(moment.position, moment.world_R_body)
        in_sight = np.array([np.count_nonzero(ids == member) >= PIXELS for member in members])
        seen |= in_sight
        estimate = tracker.estimate(moment.stamp)
        offset = (centres - moment.position) @ moment.world_R_body
        ways = offset / np.linalg.norm(offset, axis=-1, keepdims=True)

        def near(direction: np.ndarray, ways: np.ndarray = ways) -> np.ndarray:
            return np.degrees(angular_distance(direction[None], ways)) < RIGHT

        found.append(
            Step(
                seed=recording.episode.slot.seed,
                kind=kind,
                seen=int(seen.sum()),
                in_sight=int(in_sight.sum()),
                right=estimate.direction is not None and bool(near(estimate.direction).any()),
                status=estimate.status,
                presence=estimate.presence,
                modes=tuple((mode.weight, bool(near(mode.direction).any())) for mode in estimate.modes),
                found=int(sum(near(mode.direction) for mode in estimate.modes)[seen].astype(bool).sum())
                if estimate.modes and seen.any()
                else 0,
            )
        )
    return found


def share(values: list[tuple[int, float]]) -> str:
    """Mean in percent with its interval over apartments; a dash where there is no case."""
    if len({seed for seed, _ in values}) < 2:
        return "–"
    seeds, numbers = zip(*values, strict=True)
    interval = bootstrap_interval(numbers, np.random.default_rng(0), groups=seeds)
    return f"{100 * np.mean(numbers):.0f} [{100 * interval.low:.0f} {100 * interval.high:.0f}]"


def tables(steps: list[Step]) -> dict[str, Any]:
    """Print the tables; returns them."""
    report: dict[str, Any] = {}
    print(f"\n{'after the first sighting, %':34s}" + "".join(f"{kind:>22s}" for kind in KINDS))

    def line(title: str, read: Any, chosen: Any = lambda step: step.seen > 0) -> None:
        cells = [share([(s.seed, float(read(s))) for s in steps if s.kind == kind and chosen(s)]) for kind in KINDS]
        report[title] = dict(zip(KINDS, cells, strict=True))
        print(f"{title:34s}" + "".join(f"{cell:>22s}" for cell in cells))

    line("the answer is right", lambda s: s.right)
    line("modes that are right, by weight", _weighted, lambda s: s.seen > 0 and s.modes)
    line("seen things among the modes", lambda s: s.found / s.seen)
    for said in STATUS:
        line(f"says {said}", lambda s, said=said: s.status == said)
        line(f"  right when it says {said}", lambda s: s.right, lambda s, said=said: s.seen > 0 and s.status == said)
    line("ambiguous while one was seen", lambda s: s.status == "ambiguous", lambda s: s.seen == 1)
    line("ambiguous once two were seen", lambda s: s.status == "ambiguous", lambda s: s.seen >= 2)
    line("ambiguous while two are in sight", lambda s: s.status == "ambiguous", lambda s: s.in_sight >= 2)
    line("before: says searching", lambda s: s.status == "searching", lambda s: s.seen == 0)
    line("before: says tracking", lambda s: s.status == "tracking", lambda s: s.seen == 0)
    return report


def _weighted(step: Step) -> float:
    total = sum(weight for weight, _ in step.modes)
    return sum(weight for weight, right in step.modes if right) / total if total else 0.0


def reliability(steps: list[Step]) -> list[dict[str, float]]:
    """For modes of queries with one answer: bins of weight, how often they are right, and how many there are."""
    pairs = [(w, right, s.seed) for s in steps if s.kind != KINDS[2] and s.seen > 0 for w, right in s.modes]
    weights, right = np.array([w for w, _, _ in pairs]), np.array([r for _, r, _ in pairs])
    rows = []
    for low, high in pairwise(BINS):
        chosen = (weights > low) & (weights <= high)
        if chosen.any():
            rows.append(
                {"weight": float(weights[chosen].mean()), "right": float(right[chosen].mean()), "n": int(chosen.sum())}
            )
    error = sum(row["n"] * abs(row["weight"] - row["right"]) for row in rows) / max(len(pairs), 1)
    print("\nweight of a mode, how often it is right, number (queries with one answer, after the first sighting)")
    for row in rows:
        print(f"  {row['weight']:.2f}  {row['right']:.2f}  {row['n']:.0f}")
    print(f"expected calibration error: {error:.3f}")
    return rows


def draw(rows: list[dict[str, float]], file: Path) -> None:
    """The reliability diagram."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(4.2, 4.0), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    sizes = [8 + 90 * row["n"] / max(r["n"] for r in rows) for row in rows]
    axes.plot([row["weight"] for row in rows], [row["right"] for row in rows], color="#3366aa", linewidth=1.2)
    axes.scatter([row["weight"] for row in rows], [row["right"] for row in rows], sizes, color="#3366aa")
    axes.set(
        xlim=(0, 1), ylim=(0, 1), xlabel="weight of the mode", ylabel="share of modes that are right", aspect="equal"
    )
    figure.savefig(file, dpi=120)


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--perception", default="scout")
    arguments.add_argument("--episodes", type=int, default=60)
    arguments.add_argument("--seed", type=int, default=940, help="first apartment")
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--out", type=Path, help="folder for reliability.png and instances.json")
    options = arguments.parse_args()
    slots = [
        Slot("waypoint", APARTMENT, options.seed + number // PER_PLACE, number % PER_PLACE, number)
        for number in range(options.episodes)
    ]
    with multiprocessing.get_context("spawn").Pool(options.workers) as pool:
        steps = [
            step for found in pool.imap(steps_of, [(options.perception, slot) for slot in slots]) for step in found
        ]
    print(f"{len(steps)} answers of {options.perception} along {len(slots)} routes, apartments from {options.seed}")
    report = {"tables": tables(steps), "reliability": reliability(steps)}
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "instances.json").write_text(json.dumps(report, indent=1), encoding="utf-8")
        draw(report["reliability"], options.out / "reliability.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
