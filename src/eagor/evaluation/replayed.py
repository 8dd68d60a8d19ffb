"""Labelled looks from a replay file (docs/replay-format.md) and a file of true directions.

A line of true directions lists ALL instances in the body frame at that time; an empty list says that there is none::

    {"stamp": 12.40, "query": "chair", "targets": [{"azimuth_deg": 62.5, "elevation_deg": -34}]}
    {"stamp": 12.40, "query": "piano", "targets": [], "group": "walk 1"}
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eagor.errors import EagorError, FormatError
from eagor.evaluation.labelled_looks import LabelledLook
from eagor.evidence import Evidence
from eagor.perception.record_fields import json_lines, misplaced, need, number, object_of, only, words_of
from eagor.perception.replay import ReplayPerception
from eagor.sphere import direction

__all__ = ["Truth", "joined", "read_truth", "replayed_looks"]

Pose = tuple[np.ndarray, np.ndarray | None]  # world_R_body ``(3, 3)``, and the position ``(3,)`` if it is known


@dataclass(frozen=True, eq=False)
class Truth:
    """The directions `targets` ``(n, 3)``, body frame, of all that `query` names at `stamp`; n = 0: it is absent.

    `group`: which recording of which thing (default in a file: the query).
    """

    stamp: float
    query: str
    targets: np.ndarray
    group: str


def read_truth(path: str | os.PathLike[str]) -> tuple[Truth, ...]:
    """The lines of a file of true directions. `FormatError` names the file and the line of a fault."""
    found: dict[tuple[float, str, str], Truth] = {}
    for line, where in json_lines(path):
        try:
            truth = _parsed(line)
            key = truth.stamp, " ".join(words_of(truth.query)), truth.group
            if key in found:
                raise FormatError(
                    f"is a second line for {truth.query!r} at {truth.stamp:g} s; wanted all targets in one"
                )
        except EagorError as error:
            raise misplaced(error, where) from error
        found[key] = truth
    if not found:
        raise FormatError(f"{os.fspath(path)} holds no true directions; wanted one JSON object per line, at least one")
    return tuple(sorted(found.values(), key=lambda each: each.stamp))


def _parsed(line: bytes) -> Truth:
    entry = object_of(line)
    only(entry, ("stamp", "query", "targets", "group"), "a line of true directions")
    stamp, query, group, targets = number(entry, "stamp"), entry.get("query"), entry.get("group"), entry.get("targets")
    need(isinstance(query, str) and words_of(query) != [], "query", query, "words")
    need(group is None or (isinstance(group, str) and group != ""), "group", group, "text, or no such key")
    fine = isinstance(targets, list) and all(isinstance(target, dict) for target in targets)
    need(fine, "targets", targets, "a list of objects with azimuth_deg and elevation_deg; [] if the thing is absent")
    angles = []
    for target in entry["targets"]:
        only(target, ("azimuth_deg", "elevation_deg"), "a target")
        angles.append((number(target, "azimuth_deg", -360, 360), number(target, "elevation_deg", -90, 90)))
    azimuths, elevations = np.radians(angles).reshape(-1, 2).T
    name = entry["query"] if group is None else f"{group}: {entry['query']}"
    return Truth(stamp, entry["query"], direction(azimuths, elevations).reshape(-1, 3), name)


def replayed_looks(
    replay: ReplayPerception, truths: Sequence[Truth], pose: Callable[[float], Pose] | None = None
) -> tuple[list[LabelledLook], list[Truth]]:
    """The looks of `replay` at the stamps of `truths`, and the truths without one.

    `pose` tells how the camera stood at a stamp. A look is used once for each query, with the truth that is nearest in
    time. Raises `QueryError` where no label fits
    a query that has targets, `ResponseError` for response maps.
    """
    present = {truth.query for truth in truths if len(truth.targets)}
    found: dict[tuple[str, float], tuple[float, Truth, LabelledLook]] = {}
    left_out: list[Truth] = []
    for truth in truths:
        # What is never there may have no label either: the detector looked and saw none.
        looks = replay.looks_near(truth.query, truth.stamp, strict=truth.query in present)
        if not looks:
            left_out.append(truth)
            continue
        evidence = joined(looks)
        at = (None, None) if pose is None else pose(truth.stamp if evidence.stamp is None else float(evidence.stamp))
        look = LabelledLook(evidence, truth.targets, None, truth.group, *at)
        key, apart = (truth.group, float(look.stamp or 0.0)), abs(float(look.stamp or 0.0) - truth.stamp)
        before = found.get(key)
        if before is not None:
            left_out.append(truth if before[0] <= apart else before[1])
        if before is None or apart < before[0]:
            found[key] = apart, truth, look
    return [look for _, _, look in found.values()], left_out


def joined(looks: Sequence[Evidence]) -> Evidence:
    """The views of one moment as one look."""
    first, *others = looks
    if not others or any(look.detections is None for look in looks):
        return next((look for look in looks if look.detections is None), first)
    joint = first.detections
    for look in others:
        assert joint is not None
        assert look.detections is not None
        joint = joint.joined(look.detections)
    assert joint is not None
    return Evidence.from_detections(joint, first.grid, first.stamp)
