"""What each part of the estimator is worth with a perception that really looks: ours, variants of it, and rivals.

    python benchmarks/estimator.py [--perception scout] [--groups reading memory ...] [--episodes 60] [--seed 900]
                                   [--workers 2] [--folder DIR]

Waypoint Following and `tracking` are open loop: their episodes are recorded once, in development apartments
(others are refused), and every variant meets the same looks. The table gives means over episodes, and for each variant
the difference to `eagor` as it ships, paired by episode, with a 95 % interval over apartments; + and - mark differences
beyond chance (uncorrected: this table is for finding things out, the reports test).

"""

from __future__ import annotations

import multiprocessing
import pickle
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
import numpy as np

from eagor.evaluation import tables
from eagor.evaluation.calibration import TASKS, Recorder, kept_recordings
from eagor.tasks.methods import NAMES, TrackerMethod
from eagor.tasks.play import Player, Recording

OURS = "eagor"
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
    ),
    "range": (*(f"{OURS}:shells={count}" for count in (0, 20, 30)), f"{OURS}:heights=0"),
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


def play(recording: Recording, player: Player, variant: str) -> dict[str, Any]:
    """The record of one episode with one variant, laid out as the records of a run."""
    slot = recording.episode.slot
    method: Any = player.method(variant, slot)
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


def show(group: str, names: Sequence[str], found: dict[str, dict[int, dict[str, float]]], seeds: Sequence[int]) -> None:
    """Print one group, each line against the first."""
    width = max(len(name) for name in names if len(name) <= LONG)
    print(f"\n{group}\n{'':{width}} " + " ".join(f"{column:>8s}" for column in COLUMNS))
    for name in names:
        cells = []
        for column, better in COLUMNS.items():
            cell = compared(found[name], found[names[0]], seeds, column)
            if cell is None:
                cells.append(f"{'–':>8s}")
                continue
            sure = name != names[0] and better and (cell[2] > 0 or cell[3] < 0)
            cells.append(f"{cell[0]:7.2f}{('+' if (cell[1] > 0) == (better == 'high') else '-') if sure else ' '}")
        before = name if len(name) <= width else f"{name}\n{'':{width}}"
        print(f"{before:{width}} " + " ".join(cells).rstrip(), flush=True)


def main() -> int:
    arguments = common.parser(__doc__)
    arguments.add_argument("--perception", default="scout")
    arguments.add_argument("--groups", nargs="+", default=list(GROUPS), choices=list(GROUPS))
    arguments.add_argument("--variants", nargs="+", default=[], help="further ones, as bench --methods takes them")
    arguments.add_argument("--episodes", type=int, default=60)
    arguments.add_argument("--seed", type=int, default=900, help="first apartment, of the development fifth")
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--folder", help="keeps the recordings, and takes those that lie there")
    options = arguments.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(options.folder or scratch)
        print(f"{options.episodes} episodes of {', '.join(TASKS)}, apartments from {options.seed}", flush=True)
        file = kept_recordings(folder, options.perception, options.episodes, options.seed, left_out=print)
        recordings: list[Recording] = pickle.loads(file.read_bytes())
        seeds = [recording.episode.slot.seed for recording in recordings]
        groups = {group: GROUPS[group] for group in options.groups} | {"further": tuple(options.variants)}
        context = multiprocessing.get_context("spawn")
        with context.Pool(options.workers, _begin, (str(file), options.perception)) as pool:
            found: dict[str, dict[int, dict[str, float]]] = {}
            for group, names in groups.items():
                shown = (OURS, *names)
                wanted = [name for name in shown if name not in found]
                jobs = [(index, name) for name in wanted for index in range(len(recordings))]
                for index, name, row in pool.imap(_play, jobs):
                    found.setdefault(name, {})[index] = row
                if names:
                    show(group, shown, found, seeds)
        print("\n+ better, - worse than the first line (a 95 % interval of the paired difference excludes 0)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
