"""An episode of a run, played again for the Rerun viewer: what the camera saw, and what a method made of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eagor.drawing.rerun_log import RerunLog
from eagor.errors import EagorError
from eagor.evaluation.study import Told, Worst
from eagor.tasks.episode_files import slot_of
from eagor.tasks.episodes import Slot
from eagor.tasks.methods import TrackerMethod
from eagor.tasks.play import Player, Seen

__all__ = ["log_case", "player_of"]

ROWS = 256  # of panoramas, where the perception needs none


def log_case(run: Told, worst: Worst, name: str | None, path: str | Path) -> str:
    """Play case `name` of a run (None: the worst one) again and log it; returns the case's name.

    Every method sees again what it saw in the run, so the figures are the recorded ones. The method has to have a
    belief: ours, or one of its variants.

    Raises `EagorError` for a benchmark of still pictures, an unknown case, or another method.
    """
    case = _named(run, worst, name)
    player, slot = player_of(run, case)
    (method,) = case["unit"]["methods"]
    if not isinstance(player.method(method, slot), TrackerMethod):
        raise EagorError(f"{method} keeps no belief that could be logged; give --method eagor, or a variant of it")
    with RerunLog(path, f"{run.study.name} {case['case']}: {case['query']}") as log:

        def add(seen: Seen) -> None:
            assert isinstance(seen.method, TrackerMethod)
            log.add(
                seen.panorama, seen.method.estimate, stamp=seen.stamp, query=case["query"], position=seen.position,
                truth=seen.truth,
            )  # fmt: skip

        player.play(slot, [method], add)
    return str(case["case"])


def player_of(run: Told, case: Mapping[str, Any]) -> tuple[Player, Slot]:
    """What plays a case of a run again, with panoramas. Raises `EagorError` for a benchmark of still pictures."""
    if case.get("unit") is None:
        raise EagorError(f"only episodes of simulated tasks can be played again, and {run.study.name} has none")
    return Player(dict(run.settings), rows=ROWS), slot_of(case["unit"]["slot"])


def _named(run: Told, worst: Worst, name: str | None) -> Mapping[str, Any]:
    if not worst.cases:
        raise EagorError(f"the run of {run.study.name} has no case to show")
    if name is None:
        return worst.cases[0]
    for case in worst.cases:
        if case["case"] == name:
            return case
    shown = ", ".join(str(case["case"]) for case in worst.cases[:5])
    raise EagorError(f"the run has no case {name!r}; it has {shown}{', ...' if len(worst.cases) > 5 else ''}")
