"""The looks of ``eagor demo --photo``: a virtual camera turns in a photograph, and every method follows the query."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from eagor.cli.terminal import RunError, UsageError
from eagor.evaluation.published import OURS
from eagor.media.cutting import cut
from eagor.perception import Perception, look, rows_of
from eagor.perception.views import Views
from eagor.sphere import angular_distance, azimuth_elevation, world_R_body
from eagor.tasks.methods import NAMES, TrackerMethod, make_method
from eagor.tracking.estimate import Estimate
from eagor.worlds.photograph import Photograph

LOOKS = 24
SECONDS = 0.5  # between looks
LEVEL = 8  # looks before the camera begins to tumble
YAW, TILT = 25.0, 40.0  # degrees: the heading's change per look; the largest pitch and roll
MOST_ROWS = 1024  # of the turned panoramas: more cost much and show a detector nothing new
_STILL = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Looks:
    """What happened: per look the pose ``(3, 3)``, the number of detections (None: a map) and our estimate.

    `directions` are each method's ``(LOOKS, 3)`` in the frame of the photograph: x through its centre, z up.
    """

    photograph: Photograph
    query: str
    rows: int
    poses: tuple[np.ndarray, ...]
    found: tuple[int | None, ...]
    estimates: tuple[Estimate, ...]
    directions: dict[str, np.ndarray]

    @property
    def answer(self) -> np.ndarray:
        """Our last direction ``(3,)``, after all looks."""
        return self.directions[OURS][-1]

    def angles(self, name: str) -> np.ndarray:
        """Angles (degrees) of a method to the answer, one per look."""
        return np.degrees(angular_distance(self.directions[name], self.answer))

    @property
    def crossings(self) -> int:
        """How often the answer crosses the seam of the picture, because the camera turns."""
        azimuths = [float(azimuth_elevation(pose.T @ self.answer)[0]) for pose in self.poses]
        return sum(abs(b - a) > math.pi for a, b in pairwise(azimuths))

    def panorama(self, index: int) -> np.ndarray:
        """What the camera sees at a look, ``(rows, 2 rows, 3)`` uint8."""
        return _seen(self.photograph, self.poses[index], self.rows)


def poses() -> tuple[np.ndarray, ...]:
    """The camera's orientations ``world_R_body``: it turns left, level at first, then it pitches and rolls as well."""
    turned = []
    for index in range(LOOKS):
        phase = max(0, index - LEVEL + 1) * math.tau / (LOOKS - LEVEL)
        pitch, roll = TILT * math.sin(phase), TILT * math.sin(2 * phase)
        turned.append(world_R_body(*(math.radians(angle) for angle in (YAW * index, pitch, roll))))
    return tuple(turned)


def best_query(perception: Perception, panorama: np.ndarray) -> str:
    """The class that a detector finds with the highest score. Raises `UsageError`, `RunError` if there is none."""
    if not isinstance(perception, Views) or perception.classes is None:
        raise UsageError("this perception has no list of classes to choose from; say what to look for with --query")
    best: tuple[float, str] = (0.0, "")
    for picture in cut(panorama, *perception.views()):
        _, scores, labels = perception.detect(picture, perception.classes[0])
        best = max([best, *((float(score), label) for score, label in zip(scores, labels, strict=True))])
    if not best[1]:
        raise RunError("the detector sees nothing that it knows in this photograph; try another, or --query")
    return best[1]


def rows_for(perception: Perception, image: np.ndarray) -> int:
    """Rows of the panoramas to look at: as fine as the perception needs and the photograph has."""
    return min(max(rows_of(perception), 128), image.shape[0], MOST_ROWS)


def play(
    image: np.ndarray, perception: Perception, spec: str, query: str, advance: Callable[[], object] = lambda: None
) -> Looks:
    """Look `LOOKS` times for `query`, and let every method follow. Raises `RunError` if nothing was ever seen."""
    rows = rows_for(perception, image)
    small = Photograph(_seen(Photograph(image), np.eye(3), rows))  # shrunk once
    methods = {name: make_method(name, np.random.default_rng(0), spec) for name in NAMES}
    directions: dict[str, list[np.ndarray]] = {name: [] for name in NAMES}
    found: list[int | None] = []
    estimates: list[Estimate] = []
    for index, pose in enumerate(poses()):
        stamp = SECONDS * index
        evidence = look(perception, _seen(small, pose, rows), query, stamp=stamp, world_R_body=pose)
        found.append(None if evidence.detections is None else len(evidence.detections.directions))
        for name, method in methods.items():
            method.move(stamp, pose, None)
            method.see(replace(evidence, stamp=stamp))
            directions[name].append(pose @ method.direction())
            if name == OURS and isinstance(method, TrackerMethod):
                estimates.append(method.estimate)
        advance()
    if all(count == 0 for count in found):
        raise RunError(f"{spec} saw no {query!r} in any of {LOOKS} looks; ask for something else with --query")
    told: dict[str, Any] = {name: np.array(each) for name, each in directions.items()}
    return Looks(small, query, rows, poses(), tuple(found), tuple(estimates), told)


def _seen(photograph: Photograph, pose: np.ndarray, rows: int) -> np.ndarray:
    seen = photograph.panorama(_STILL, pose, rows, range=False, ids=False).rgb
    assert seen is not None
    return seen
