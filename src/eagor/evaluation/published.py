"""The figures that the papers printed (``published.toml``), and the order of the methods in tables."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path

from eagor.tasks.methods import EVERY, ORACLE

OURS, PAPERS = "eagor", "eagor_paper"  # our default, and the method as published
RIVALS = ("centroid", "cent_circ", "grid")  # what the paper compares itself with
ORDER = (*EVERY, ORACLE)

_PRINTED = tomllib.loads((Path(__file__).parent / "published.toml").read_text(encoding="utf-8"))
FIGURES: dict[str, dict[str, dict[str, float]]] = {
    task: {name: dict(zip(rows["columns"], row, strict=False)) for name, row in rows.items() if name != "columns"}
    for task, rows in _PRINTED["figures"].items()
}
FAILURE_TAGS: dict[str, dict[str, tuple[float, float]]] = _PRINTED["failure_tags"]
RESOLUTION_DEG = {7: 25.0}  # "about 25 degrees of angular resolution", by degree


def ordered(names: Iterable[str]) -> list[str]:
    """Method names in the order of the tables: plain, the paper's, the further rivals, ours, the oracle, ablations."""
    place = {name: index for index, name in enumerate(ORDER)}
    return sorted(names, key=lambda name: (place.get(name, len(place)), *_natural(name)))


def is_ablation(name: str) -> bool:
    """Whether the method is a variation of another one: "eagor:degree=7"."""
    return ":" in name


def varied_by(name: str) -> tuple[str, tuple[str, ...]]:
    """The varied method, and the names of the settings: "eagor:degree=7" is ("eagor", ("degree",))."""
    base, _, text = name.partition(":")
    return base, tuple(item.partition("=")[0] for item in text.split(","))


def degree_of(name: str) -> int | None:
    """The degree that a variant such as "eagor:degree=7" sets; None where it sets none."""
    value = name.rpartition("=")[2]
    return int(value) if value.isdecimal() else None


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
