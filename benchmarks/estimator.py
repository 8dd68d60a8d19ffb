"""What each part of the estimator is worth with a perception that really looks: ours, variants of it, and rivals.

    python benchmarks/estimator.py [--perception scout] [--groups reading memory ...] [--episodes 60] [--seed 900]
                                   [--workers 2] [--folder DIR] [--json FILE]

Waypoint Following and `tracking` are open loop: their episodes are recorded once, in development apartments
(others are refused), and every variant meets the same looks. The table gives means over episodes, and for each variant
the difference to `eagor` as it ships, paired by episode, with a 95 % interval over apartments; + and - mark differences
beyond chance (uncorrected: this table is for finding things out, the reports test).

In the group `detections` the looks are read as if a detector had written down their peaks: with a detector's model, of
which nothing is known or something is stated, or drawn again as a response map. Each line is compared with the first.

Some variants are no options of the product, because they did not win; they live here: linear pooling of responses,
responses as shares of their sum (a detection and a false alarm compete for each frame), and the target's true range,
told with 15 % of error whenever it is in sight, which no perception here gives: the most that any cue to range, such as
where a thing meets the floor, could bring.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import pickle
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import common
import numpy as np
from scipy.ndimage import maximum_filter

from eagor.belief.ranged import RangedBelief
from eagor.evaluation import tables
from eagor.evaluation.calibration import TASKS, Recorder, kept_recordings
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import MIN_SPREAD
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid
from eagor.tasks.methods import NAMES, TrackerMethod
from eagor.tasks.places import load_place
from eagor.tasks.play import Player, Recording

Reading = Callable[[Evidence], Evidence]
OURS = "eagor"


def linear(gain: float) -> Reading:
    """Responses summed, not their logarithms."""

    def read(look: Evidence) -> Evidence:
        summed = (gain * (look.response - look.calibration.neutral)).astype(np.float32)
        return replace(look, drawn=summed, calibration=replace(look.calibration, spread=0.0))

    return read


def shares(false: float, clutter: float, temperature: float) -> Reading:
    """A frame shows the target once, or (with probability `false`) says nothing: its cells compete.

    r = temperature * log(false + (1 - false) 4 pi l / (integral of l + clutter)).
    """

    def read(look: Evidence) -> Evidence:
        response = np.asarray(look.response, dtype=np.float64)
        share = 4 * math.pi * response / ((response * look.grid.weights).sum() + clutter)
        return replace(look, drawn=(temperature * np.log(false + (1 - false) * share)).astype(np.float32))

    return read


def detections(**how: DetectorModel | Calibration) -> Reading:
    """The peaks of the response alone, as a detector would write them down, read by `detector` or `calibration`."""

    def read(look: Evidence) -> Evidence:
        response = np.asarray(look.response, dtype=np.float64)
        peaks = (response == maximum_filter(response, 5, mode=("nearest", "wrap"))) & (response > FAINT)
        where, scores = look.grid.directions[peaks], response[peaks]
        kappa = None if "detector" in how else 1 / MIN_SPREAD**2
        return Evidence.from_points(where, kappa, scores, stamp=look.stamp, **how)  # type: ignore[arg-type]

    return read


DETECTIONS: dict[str, Reading] = {
    "detections": detections(detector=DetectorModel()),
    **{f"detections look_alikes={n}": detections(detector=DetectorModel(look_alikes=n)) for n in (0, 0.1, 2)},
    "detections kept_for=10": detections(detector=DetectorModel(kept_for=10.0)),
    "detections pd=0.5 clutter=0.5": detections(detector=DetectorModel(0.5, 0.5)),
    "detections pd=0.5 clutter=0.5 look_alikes=0.7": detections(detector=DetectorModel(0.5, 0.5, look_alikes=0.7)),
    "detections as a map": detections(calibration=Calibration()),
    "detections as a map temperature=6 persistence=0.5": detections(calibration=Calibration(0.4, 0.05, 6.0, 0.5)),
}
READINGS: dict[str, Reading] = {
    **DETECTIONS,
    "linear gain=4": linear(4.0),
    "linear gain=12": linear(12.0),
    "shares false=0.5 clutter=0.1 temperature=0.5": shares(0.5, 0.1, 0.5),
    "shares false=0.3 clutter=0.03 temperature=0.25": shares(0.3, 0.03, 0.25),
}
TOLD = "range told to 15 %"
FORMER = f"{OURS}:floor=0.065,neutral=0.0204,temperature=3.47,persistence=0.77,spread=0"  # once shipped
GROUPS: dict[str, tuple[str, ...]] = {
    "rivals": tuple(name for name in NAMES if name != OURS),
    "memory": (
        *(f"{OURS}:persistence={share}" for share in (0, 0.5, 0.9)),
        *(f"{OURS}:wander={angles}" for angles in ("0", "5", "10", "2.5+5+10", "1+20")),
        *(f"{OURS}:start={rate}" for rate in (0.001, 0.02)),
        *(f"{OURS}:stop={rate}" for rate in (0.002, 0.05)),
        *(f"{OURS}:jump={rate}" for rate in (0, 0.1)),
        f"{OURS}:birth=0,death=0",
        f"{OURS}:birth=0.01,death=0.01",
    ),
    "reading": (
        *(f"{OURS}:temperature={beta}" for beta in (4, 9)),
        *(f"{OURS}:floor={floor}" for floor in (0.1, 0.8)),
        *(f"{OURS}:spread={angle}" for angle in (0, 2, 5, 8)),
        FORMER,
        *(name for name in READINGS if name not in DETECTIONS),
    ),
    "detections": tuple(DETECTIONS),
    "range": (
        f"{OURS}:shells=0",
        *(f"{OURS}:shells={count}" for count in (20, 30)),
        f"{OURS}:heights=0",
        TOLD,
    ),
    "degree": tuple(f"{OURS}:degree={degree}" for degree in (7, 11, 21, 31)),
    "decoding": (f"{OURS}:decode=mean",),
}
# What is shown, w: of Waypoint Following, t: of Target Direction Estimation; which side is better, "" where neither is.
COLUMNS = {
    **dict.fromkeys(("w.error", "w.sight", "w.hidden", "w.L4", "w.TC"), "low"),
    **{"w.cover": "", "w.dist": "low", "w.log": "high"},
    **dict.fromkeys(("t.error", "t.TC", "t.recov"), "low"),
    **{"t.cover": "", "t.log": "high"},
}
FAINT = 0.1  # a detector writes nothing down that is weaker
LONG = 28  # letters; a longer name has a line of its own


@dataclass
class Scored:
    """A method that notes the log density that it gave to each truth it was asked about."""

    method: Any
    noted: list[float]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.method, name)

    def mass_above(self, direction: np.ndarray) -> float | None:
        if isinstance(self.method, TrackerMethod):
            estimate = self.method.estimate
            self.noted.append(float(estimate.log_density(direction)))
        elif (density := getattr(self.method.filter, "log_density", None)) is not None:
            self.noted.append(float(density(np.asarray(direction)[None])[0]))
        return self.method.mass_above(direction)


@dataclass
class Told(TrackerMethod):
    """Ours, told the target's range with 15 % of error whenever a look has its peak there."""

    ranges: dict[float, tuple[np.ndarray, float]] | None = None  # by stamp: direction, world axes, and range

    def see(self, evidence: Evidence) -> None:
        super().see(evidence)
        told = (self.ranges or {}).get(float(evidence.stamp or 0.0))
        track = self.follower.tracker._tracks["target"]
        state, moment = self.follower.tracker._take_in(track), track.moments[-1]
        still = state.hypotheses.standing
        if told is None or moment.stamp != evidence.stamp or not isinstance(still.coarse, RangedBelief):
            return
        direction, distance = told
        pose = moment.world_R_body
        response = np.asarray(evidence.response)
        peak = pose @ evidence.grid.directions.reshape(-1, 3)[int(response.argmax())]
        if float(peak @ direction) < math.cos(math.radians(12)):
            return
        shells = np.log(still.coarse.ranges)
        level = math.log(float(np.average(_likely(shells, distance), weights=np.gradient(shells))))
        grid = decoding_grid(still.degree)
        near = RealHarmonics(still.degree).analyse(_cap(grid.directions, direction), grid)
        coarse = still.coarse.plus((np.log(_likely(shells, distance)) - level)[:, None] * near)
        windows = tuple(
            window.plus(
                (np.log(_likely(window.logs, distance)) - level)[:, None, None] * _cap(window.directions, direction)
            )
            for window in still.windows
        )
        hypotheses = replace(state.hypotheses, standing=replace(still, coarse=coarse, windows=windows))
        moment.state = replace(state, hypotheses=hypotheses)


def _likely(logs: np.ndarray, distance: float) -> np.ndarray:
    """How likely the range with these logarithms ``(K,)`` is, told `distance`: it says how far, not whether."""
    return 0.1 + 0.9 * np.exp(-0.5 * ((logs - math.log(distance)) / 0.15) ** 2)


def _cap(directions: np.ndarray, about: np.ndarray) -> np.ndarray:
    """A cap of 15 degrees about a direction."""
    return np.exp((directions @ about - 1) / math.radians(15) ** 2)


def ranges_of(recording: Recording, place_radius: float) -> dict[float, tuple[np.ndarray, float]]:
    """Where the target is, and how far away, at each step at which it is in sight."""
    slot = recording.episode.slot
    scene = load_place(slot.world, slot.seed, place_radius).scene
    if recording.episode.targets[0] >= len(scene.instances):
        return {}  # a ball, which is no part of the scene
    centre, found = scene.instances[recording.episode.targets[0]].centre, {}
    for moment, seen in zip(recording.moments, recording.truth["visible"], strict=True):
        offset = centre - moment.position
        away = float(np.linalg.norm(offset))
        if seen and away > 0:
            found[moment.stamp] = (offset / away, away)
    return found


def play(recording: Recording, player: Player, variant: str) -> dict[str, Any]:
    """The record of one episode with one variant, laid out as the records of a run."""
    slot = recording.episode.slot
    if variant in READINGS:
        read = READINGS[variant]
        moments = tuple(
            replace(moment, evidence=read(moment.evidence)) if moment.evidence is not None else moment
            for moment in recording.moments
        )
        recording = replace(recording, moments=moments)
    method: Any = player.method(OURS if variant in READINGS or variant == TOLD else variant, slot)
    if variant == TOLD:
        method = Told(method.follower, ranges=ranges_of(recording, player.camera.radius))
    scored = Scored(method, [])
    judged = player.judge(recording, scored)  # type: ignore[arg-type]
    judged["metrics"]["log"] = float(np.mean(scored.noted)) if scored.noted else None
    return {
        "status": "ok",
        "task": slot.task,
        "episode": {"id": slot.id, "seed": slot.seed},
        "truth": recording.truth,
        "methods": {variant: judged},
    }


def figures(record: dict[str, Any], variant: str) -> dict[str, float]:
    """The columns of one record; those without a case are left out."""
    metrics, task = record["methods"][variant]["metrics"], record["task"]
    made = {part: tables.error_in([record], variant, part) for part in tables.PARTS}
    away = tables.distance_error([record], variant)
    if task == "waypoint":
        found = {"w.error": metrics["mae"], "w.L4": metrics["L4"], "w.TC": metrics["tc"], "w.log": metrics["log"]}
        found |= {"w.sight": made[tables.IN_SIGHT], "w.hidden": made[tables.HIDDEN], "w.dist": away}
        found["w.cover"] = None if metrics["coverage"] is None else 100 * metrics["coverage"]
    else:
        found = {"t.error": metrics["error"], "t.TC": metrics["tc"], "t.recov": metrics["recovery"]}
        found |= {
            "t.log": metrics["log"],
            "t.cover": None if metrics["coverage"] is None else 100 * metrics["coverage"],
        }
    plain = {key: value.mean if isinstance(value, tables.Part) else value for key, value in found.items()}
    return {key: float(value) for key, value in plain.items() if value is not None}


_work: tuple[list[Recording], dict[str, Player]]


def _begin(file: str, perception: str) -> None:
    global _work
    players = Recorder(perception).players
    _work = (pickle.loads(Path(file).read_bytes()), players)


def _play(job: tuple[int, str]) -> tuple[int, str, dict[str, float]]:
    index, variant = job
    recording = _work[0][index]
    return index, variant, figures(play(recording, _work[1][recording.episode.slot.task], variant), variant)


def compared(
    values: dict[int, dict[str, float]], base: dict[int, dict[str, float]], seeds: Sequence[int], column: str
) -> tuple[float, float, float, float] | None:
    """Mean of a column, and the paired difference to the base with its interval; None where there is no case."""
    here = {index: row[column] for index, row in values.items() if column in row}
    if not here:
        return None
    both = [index for index in here if column in base[index]]
    gaps = [here[index] - base[index][column] for index in both]
    return float(np.mean(list(here.values()))), *common.mean_of(gaps, [seeds[index] for index in both])


def show(group: str, names: Sequence[str], found: dict[str, dict[int, dict[str, float]]], seeds: Sequence[int]) -> Any:
    """Print one group, each line against the first; returns it as JSON."""
    width, kept = max(len(name) for name in names if len(name) <= LONG), {}
    print(f"\n{group}\n{'':{width}} " + " ".join(f"{column:>8s}" for column in COLUMNS))
    for name in names:
        cells, kept[name] = [], {}
        for column, better in COLUMNS.items():
            cell = compared(found[name], found[names[0]], seeds, column)
            if cell is None:
                cells.append(f"{'–':>8s}")
                continue
            kept[name][column] = cell
            sure = name != names[0] and better and (cell[2] > 0 or cell[3] < 0)
            cells.append(f"{cell[0]:7.2f}{('+' if (cell[1] > 0) == (better == 'high') else '-') if sure else ' '}")
        before = name if len(name) <= width else f"{name}\n{'':{width}}"
        print(f"{before:{width}} " + " ".join(cells).rstrip(), flush=True)
    return kept


def main() -> int:
    arguments = common.parser(__doc__)
    arguments.add_argument("--perception", default="scout")
    arguments.add_argument("--groups", nargs="+", default=list(GROUPS), choices=list(GROUPS))
    arguments.add_argument("--variants", nargs="+", default=[], help="further ones, as bench --methods takes them")
    arguments.add_argument("--episodes", type=int, default=60)
    arguments.add_argument("--seed", type=int, default=900, help="first apartment, of the development fifth")
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--folder", help="keeps the recordings, and takes those that lie there")
    arguments.add_argument("--json", metavar="FILE")
    options = arguments.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(options.folder or scratch)
        print(f"{options.episodes} episodes of {', '.join(TASKS)}, apartments from {options.seed}", flush=True)
        file = kept_recordings(folder, options.perception, options.episodes, options.seed, left_out=print)
        recordings: list[Recording] = pickle.loads(file.read_bytes())
        seeds = [recording.episode.slot.seed for recording in recordings]
        groups = {group: GROUPS[group] for group in options.groups} | {"further": tuple(options.variants)}
        report: dict[str, Any] = {}
        context = multiprocessing.get_context("spawn")
        with context.Pool(options.workers, _begin, (str(file), options.perception)) as pool:
            found: dict[str, dict[int, dict[str, float]]] = {}
            for group, names in groups.items():
                shown = names if group == "detections" else (OURS, *names)  # these are read without any calibration
                wanted = [name for name in shown if name not in found]
                jobs = [(index, name) for name in wanted for index in range(len(recordings))]
                for index, name, row in pool.imap(_play, jobs):
                    found.setdefault(name, {})[index] = row
                if names:
                    report[group] = show(group, shown, found, seeds)
        print("\n+ better, - worse than the first line (a 95 % interval of the paired difference excludes 0)")
        if options.json:
            Path(options.json).write_text(json.dumps(report, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
