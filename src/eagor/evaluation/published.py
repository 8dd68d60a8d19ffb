"""The figures that the paper printed, and the columns in which its tables and ours are laid out.

Source: the EAGOR paper's tables of Waypoint Following and Map-Free Navigation, digit by digit. They were measured in
the paper's own setting (its worlds, its perception, its rules), so they are no yardstick for single figures of ours;
what can be compared is which method is better than which, and by roughly how much.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from eagor.tasks.methods import EVERY, ORACLE


@dataclass(frozen=True)
class Column:
    """A column of a task's table.

    `metric` is the name in the records' metrics; figures there times `scale` are what is shown. `better` is "low",
    "high", or None where neither is better. `share`: the metric is 0 or 1 per episode, so its interval is Wilson's.
    `only_if`: count only episodes whose metric of this name is above 0. `why`: what makes a method that is worse in all
    other columns better in this one, for where ours is behind.
    """

    key: str
    title: str
    unit: str
    better: str | None
    metric: str
    what: str
    scale: float = 1.0
    digits: int = 1
    share: bool = False
    only_if: str | None = None
    why: str = ""


_COVERAGE = Column(
    "coverage", "Coverage", "%", None, "coverage", "share of steps with the truth inside the 90 % region; 90 is right",
    scale=100.0,
)  # fmt: skip
_TC = "jump of the estimate from step to step, beyond what the true motion explains"
_CALM = "an estimate that hardly follows its target hardly jumps: read it beside the error"
_HOLD = (
    "a filter with a short memory leaves the old place sooner; ours weighs all that spoke for it, which is what keeps "
    "hidden targets"
)
COLUMNS: dict[str, tuple[Column, ...]] = {
    "waypoint": (
        Column("L1", "L1", "°", "low", "L1", "mean error on the first leg"),
        Column("L2", "L2", "°", "low", "L2", "mean error on the second leg"),
        Column("L3", "L3", "°", "low", "L3", "mean error on the third leg"),
        Column("L4", "L4", "°", "low", "L4", "mean error on the fourth leg"),
        Column("delta", "Δ", "°", "low", "delta", "growth of the error, L4 minus L1, mean over the episodes"),
        Column("occ", "Occ", "°", "low", "occ", "mean error while the target is hidden"),
        Column("seam", "Seam", "°", "low", "seam", "mean error where the true bearing crosses the seam"),
        Column("tc", "TC", "°/step", "low", "tc", f"{_TC} (rotation and translation)", why=_CALM),
        Column(
            "tc_rotation", "TC, rotation", "°/step", "low", "tc_rotation",
            f"{_TC} (rotation alone: parallax counts as a jump, so that who does not follow it scores low)",
            why="it rewards an estimate that ignores parallax: it is the paper's reading, not one that we aim at",
        ),
        _COVERAGE,
    ),
    "navigation": (
        Column("sr", "SR", "%", "high", "success", "episodes that end at the target", scale=100.0, share=True),
        Column("spl", "SPL", "%", "high", "spl", "success weighted by path length", scale=100.0),
        Column("soft_spl", "SoftSPL", "%", "high", "soft_spl", "progress weighted by path length", scale=100.0),
        Column("steps", "Steps", "", "low", "steps", "mean number of steps"),
        Column("mae", "MAE", "°", "low", "mae", "mean direction error"),
        Column(
            "seam_success", "Seam", "%", "high", "success", "success where the true bearing crossed the seam",
            scale=100.0, share=True, only_if="seam_crossings",
        ),
        _COVERAGE,
    ),
    "tracking": (
        Column("error", "Error", "°", "low", "error", "mean direction error"),
        Column("tc", "TC", "°/step", "low", "tc", f"{_TC} (rotation and translation)", why=_CALM),
        Column("time_lost", "Time lost", "%", "low", "time_lost", "share of steps at which the target is lost"),
        Column(
            "recovery", "Recovery", "s", "low", "recovery", "from the target's return until it is found again",
            why=_HOLD,
        ),
        _COVERAGE,
    ),
}  # fmt: skip

TITLES = {
    "waypoint": "Waypoint Following",
    "navigation": "Map-Free Navigation",
    "tracking": "Target Direction Estimation",
}

OURS, PAPERS = "eagor", "eagor_paper"  # our default, and the method as published
RIVALS = ("centroid", "cent_circ", "grid")  # what the paper compares itself with
ORDER = (*EVERY, ORACLE)

# Published rows, by our names. The paper's Delta is near L4 - L1 but not equal to it: it is given as printed.
_WAYPOINT = ("L1", "L2", "L3", "L4", "delta", "occ", "seam", "tc")
_NAVIGATION = ("sr", "spl", "steps", "mae", "seam_success")
FIGURES: dict[str, dict[str, dict[str, float]]] = {
    "waypoint": {
        "centroid": dict(zip(_WAYPOINT, (25.5, 49.4, 90.9, 66.7, 40.3, 31.1, 59.1, 11.6), strict=True)),
        "cent_circ": dict(zip(_WAYPOINT, (25.5, 49.3, 66.3, 72.8, 46.4, 31.1, 51.0, 7.3), strict=True)),
        "grid": dict(zip(_WAYPOINT, (23.2, 138.9, 37.3, 75.9, 52.3, 135.2, 42.4, 19.2), strict=True)),
        "eagor_paper": dict(zip(_WAYPOINT, (21.1, 31.1, 40.9, 47.1, 25.4, 15.5, 22.9, 2.6), strict=True)),
    },
    "navigation": {
        "centroid": dict(zip(_NAVIGATION, (82.0, 54.4, 61.0, 45.9, 19.6), strict=True)),
        "cent_circ": dict(zip(_NAVIGATION, (62.0, 41.5, 77.8, 46.5, 33.5), strict=True)),
        "grid": dict(zip(_NAVIGATION, (82.0, 41.4, 63.6, 54.2, 15.8), strict=True)),
        "eagor_paper": dict(zip(_NAVIGATION, (94.0, 56.8, 50.2, 33.8, 70.6), strict=True)),
    },
    "tracking": {},
}
RESOLUTION_DEG = {7: 25.0}  # "about 25 degrees of angular resolution", by degree


def ordered(names: Iterable[str]) -> list[str]:
    """Method names in the order of the tables: plain, the paper's, the further rivals, ours, the oracle, ablations."""
    place = {name: index for index, name in enumerate(ORDER)}
    return sorted(names, key=lambda name: (place.get(name, len(place)), *_natural(name)))


def is_ablation(name: str) -> bool:
    """Whether the method is a variation of another one: "eagor:degree=7"."""
    return ":" in name


def is_rival(name: str) -> bool:
    """Whether the method competes: neither a variation nor one that is told the truth."""
    return not is_ablation(name) and name != ORACLE


def compared_with(name: str, reference: str) -> str:
    """What a method is measured against: an ablation against the method that it varies, all others against one."""
    return name.partition(":")[0] if is_ablation(name) else reference


def _natural(name: str) -> tuple[str, float, str]:
    """A sort key that puts degree=7 before degree=15."""
    head, _, value = name.rpartition("=")
    try:
        return head, float(value), ""
    except ValueError:
        return (head or name), 0.0, value
