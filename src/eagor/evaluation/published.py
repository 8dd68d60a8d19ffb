"""The figures that the paper printed, by task, method and column, and the order of the methods in tables.

Source: the EAGOR paper's tables of Waypoint Following and Map-Free Navigation, digit by digit. They were measured in
the paper's own setting (its worlds, its perception, its rules), so they are no yardstick for single figures of ours;
what can be compared is which method is better than which, and by roughly how much.
"""

from __future__ import annotations

from collections.abc import Iterable

from eagor.tasks.methods import EVERY, ORACLE

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
