"""``eagor demo``: a whole path from pixels to a direction, every method on the same evidence, and a report of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eagor.belief import Belief
from eagor.cli import terminal
from eagor.cli.methods import Rivals
from eagor.cli.options import Demo
from eagor.cli.walk import QUERY, Moment, walk
from eagor.perception.colour import ColourPerception
from eagor.sphere import angular_distance
from eagor.tracker import DirectionTracker, Estimate, TrackerConfig

OURS, TURNING = "ours", "ours, turning only"
STAGES = ("all", "last third", "covered")
FEWEST = 12


@dataclass(frozen=True, eq=False)
class Run:
    """What came of the walk: our estimates and beliefs, and every method's directions ``(steps, 3)``, by moment."""

    moments: list[Moment]
    estimates: list[Estimate]
    beliefs: list[Belief]
    directions: dict[str, np.ndarray]

    @property
    def errors(self) -> dict[str, np.ndarray]:
        """Direction error of each method ``(steps,)``, degrees."""
        truth = np.array([moment.truth for moment in self.moments])
        return {name: np.degrees(angular_distance(found, truth)) for name, found in self.directions.items()}

    @property
    def covered(self) -> np.ndarray:
        """Which moments had no camera ``(steps,)``."""
        return np.array([moment.covered for moment in self.moments])

    def table(self) -> dict[str, dict[str, float]]:
        """Mean error (degrees) of each method in each stage."""
        late = np.arange(len(self.moments)) >= 2 * len(self.moments) // 3
        parts = zip(STAGES, (np.ones_like(late), late, self.covered), strict=True)
        masks = dict(parts)
        return {
            name: {stage: float(error[mask].mean()) for stage, mask in masks.items()}
            for name, error in self.errors.items()
        }

    def distance_error(self) -> float:
        """Mean relative error of the distance over the last third."""
        late = range(2 * len(self.moments) // 3, len(self.moments))
        return float(np.mean([abs((self.estimates[i].distance or 0.0) / self.moments[i].distance - 1) for i in late]))


def demo(options: Demo) -> int:
    """Run the command; returns its exit code."""
    if options.steps < FEWEST:
        raise terminal.UsageError(f"--steps {options.steps}; wanted {FEWEST} or more, to have something to look at")
    if options.seed < 0:
        raise terminal.UsageError(f"--seed {options.seed}; wanted 0 or more")
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise terminal.UsageError(f"--out {options.out}: cannot be made a folder ({error})") from error
    moments = walk(options.steps, options.seed)
    if not options.json:
        print(
            f"A camera walks and turns in a painted room, {len(moments)} panoramas, looking for the {QUERY}.",
            flush=True,
        )
    run = run_walk(moments, options.seed)
    report = _write_report(run, options.out)
    if options.json:
        terminal.emit(_as_json(run, options, report))
    else:
        print()
        print("\n".join(as_text(run)))
        print()
        print("\n".join(summary(run)))
        print(f"\nThe report with pictures: {report}")
    return terminal.OK


def run_walk(moments: list[Moment], seed: int) -> Run:
    """Every method through the walk, on the same evidence."""
    perception, rivals = ColourPerception(), Rivals(seed)
    trackers = {OURS: DirectionTracker(), TURNING: DirectionTracker(TrackerConfig(ranges=None))}
    estimates: list[Estimate] = []
    beliefs: list[Belief] = []
    found: list[dict[str, np.ndarray]] = []
    with terminal.progress("walking", len(moments)) as advance:
        for moment in moments:
            looks = moment.look(perception)
            for tracker in trackers.values():
                tracker.rotate(moment.stamp, moment.world_R_body, moment.position)
                for evidence in looks:
                    tracker.observe(evidence)
            rivals.move(moment.world_R_body, moment.position)
            rivals.see(looks)
            answers = {name: tracker.estimate(moment.stamp) for name, tracker in trackers.items()}
            estimates.append(answers[OURS])
            beliefs.append(trackers[OURS].belief(moment.stamp))
            found.append({name: e.direction for name, e in answers.items()} | rivals.directions())
            advance()
    return Run(moments, estimates, beliefs, {name: np.array([f[name] for f in found]) for name in found[0]})


def as_text(run: Run) -> list[str]:
    """The table of mean errors; a star marks the best of each column."""
    table = run.table()
    best = {stage: min(row[stage] for row in table.values()) for stage in STAGES}
    covered = int(run.covered.sum())
    lines = [
        "mean direction error (degrees)",
        f"{'':20}{'all steps':>11}{'last third':>12}{f'covered ({covered})':>14}",
    ]
    for name, row in table.items():
        cells = [f"{row[stage]:.1f}{'*' if row[stage] == best[stage] else ' '}" for stage in STAGES]
        lines.append(f"{name:20}{cells[0]:>11}{cells[1]:>12}{cells[2]:>14}")
    return lines


def summary(run: Run) -> list[str]:
    """The result in plain words, from the numbers, whoever they favour."""
    table = run.table()
    ours, published = table[OURS], table["published"]
    lines = [
        f"Our estimate was off by {ours['all']:.1f} degrees on average, the published recursion by "
        f"{published['all']:.1f}.",
        f"While the camera was covered, ours was off by {ours['covered']:.1f} degrees; without the belief over "
        f"distance (turning only) by {table[TURNING]['covered']:.1f}.",
        f"Nobody told us the distance: over the last third it was wrong by {100 * run.distance_error():.0f} %.",
    ]
    for stage, when in zip(STAGES, ("over the whole walk", "over the last third", "while covered"), strict=True):
        name = min(table, key=lambda n: table[n][stage])
        if name != OURS:
            lines.append(f"Best {when}: {name}, {table[name][stage]:.1f} degrees (ours {ours[stage]:.1f}).")
    return lines


def _as_json(run: Run, options: Demo, report: Path) -> dict[str, Any]:
    methods = {
        name: {f"{stage.replace(' ', '_')}_deg": round(error, 4) for stage, error in row.items()}
        for name, row in run.table().items()
    }
    return {
        "query": QUERY,
        "steps": options.steps,
        "seed": options.seed,
        "methods": methods,
        "distance_error": round(run.distance_error(), 4),
        "summary": summary(run),
        "report": str(report),
    }


def _write_report(run: Run, folder: Path) -> Path:
    from eagor.cli.report import write_report

    try:
        return write_report(run, folder)
    except OSError as error:
        raise terminal.RunError(f"the report cannot be written into {folder} ({error})") from error


def stretch(run: Run) -> tuple[float, float]:
    """When the camera was covered: first and last time, seconds."""
    stamps = [moment.stamp for moment in run.moments if moment.covered]
    return (stamps[0], stamps[-1]) if stamps else (math.nan, math.nan)
