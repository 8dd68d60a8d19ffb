"""``eagor demo --photo``: a virtual camera turns in a photograph of yours, and our tracker follows the query.

The camera's world is the photograph: x through its centre, z up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from eagor.cli.terminal import RunError, UsageError
from eagor.drawing import BeliefPage
from eagor.drawing.style import in_words, looked_for
from eagor.evidence import Evidence
from eagor.live.in_turn import ByFrame, Followed
from eagor.live.loop import Loop
from eagor.perception import Perception, rows_of
from eagor.perception.views import Detector
from eagor.sources import Pose
from eagor.sources.camera_sources import Footage
from eagor.sources.odometry import GivenPoses
from eagor.sources.panorama import Picture, shrunk, turn
from eagor.sphere import azimuth_elevation, world_R_body

PLACE = 0.1  # weight from which a candidate is named
LOOKS = 24
SECONDS = 0.5  # between looks
LEVEL = 8  # looks before the camera begins to tumble
YAW, TILT = 25.0, 40.0  # degrees: the heading's change per look; the largest pitch and roll
LEAST_ROWS, MOST_ROWS = 128, 1024  # of the turned panoramas: more cost much and show a detector nothing new
NO_TRUTH = "Nobody has measured where it is: look whether the mark is on it."


def poses() -> list[Pose]:
    """The camera's poses: it turns left, level at first, then it pitches and rolls as well."""
    phases = [max(0, index - LEVEL + 1) * math.tau / (LOOKS - LEVEL) for index in range(LOOKS)]
    turns = [(YAW * k, TILT * math.sin(phase), TILT * math.sin(2 * phase)) for k, phase in enumerate(phases)]
    return [Pose(SECONDS * k, world_R_body(*map(math.radians, turned))) for k, turned in enumerate(turns)]


def best_query(perception: Perception, panorama: np.ndarray) -> str:
    """The class that is found in ONE place: with the largest product of its score and its lead over a second place.

    Raises `UsageError` for a perception without classes, `RunError` if it finds nothing.
    """
    if not isinstance(perception, Detector) or perception.classes is None:
        raise UsageError("this perception has no list of classes to choose from; say what to look for with --query")
    best = (-1.0, "")
    for name, seen in zip(perception.classes, perception.answers(panorama, perception.classes), strict=True):
        if isinstance(seen, Evidence) and seen.detections is not None and len(scores := seen.detections.scores):
            second, first = sorted([0.0, *map(float, scores)])[-2:]
            best = max(best, (first * (first - second), name))
    if not best[-1]:
        raise RunError("the detector sees nothing that it knows in this photograph; try another, or --query")
    return best[-1]


def play(
    image: np.ndarray, perception: Perception, query: str, page: BeliefPage, advance: Callable[[], object]
) -> list[Followed]:
    """Look `LOOKS` times for `query`, and follow it on the page. Raises `RunError` if nothing was ever seen."""
    rows = min(max(rows_of(perception), LEAST_ROWS), MOST_ROWS)
    small, way, found = shrunk(image, rows), poses(), list[Followed]()

    def seen(pose: Pose) -> Picture:
        return Picture(turn(small, pose.world_R_body.T))

    def each(result: Followed) -> None:
        found.append(result)
        page.add(result.picture, result.estimate, name=result.frame, stamp=result.stamp, problem=result.problem)
        advance()

    source = Footage(lambda: iter([(pose.stamp, f"look {k}", partial(seen, pose)) for k, pose in enumerate(way, 1)]))
    for _ in Loop(source, GivenPoses(way), perception, query, sinks=[ByFrame(each)]):
        pass
    if all(count == 0 for count in map(detections, found)):
        raise RunError(f"there was no {query!r} to see in any of {LOOKS} looks; ask for something else with --query")
    return found


def detections(look: Followed) -> int | None:
    """How many there were in a look; None for a response map."""
    if any(each.detections is None for each in look.evidence):
        return None
    return sum(len(each.detections.directions) for each in look.evidence if each.detections is not None)


def as_json(looks: Sequence[Followed], spec: str, photo: str) -> dict[str, Any]:
    """The result for ``--json``; azimuth and elevation are those in the photograph."""
    last, query, seen = looks[-1].estimate, looks[-1].query, [*map(detections, looks)]
    likely = [(last.world_R_body @ mode.direction, mode.weight) for mode in last.modes if mode.weight >= PLACE]
    places = [_angles(toward) | {"weight": round(weight, 6)} for toward, weight in likely]
    answer = last.world_R_body @ last.direction if last.direction is not None else None
    where, crossed = "nowhere", 0
    if answer is not None:
        where = f"{_in_words(_angles(answer))} ({last.certainty})"
        across = [azimuth_elevation(each.estimate.world_R_body.T @ answer)[0] for each in looks]
        crossed = int(np.sum(np.abs(np.diff(across)) > math.pi))
    if last.status == "ambiguous" and len(places) > 1:
        each = "; ".join(f"{_in_words(place)} ({100 * place['weight']:.0f} %)" for place in places)
        where = f"in one of {len(places)} places, or in several of them: {each}"
    saw = "a map each time" if None in seen else f"it in {sum(map(bool, seen))} of {len(seen)} looks"
    return {
        "query": query, "photo": photo, "perception": spec, "looks": len(looks), "seen": seen,
        **({} if answer is None else _angles(answer)),
        "credible_angle_deg": round(math.degrees(last.credible_angle), 4), "presence": round(last.presence, 6),
        "status": last.status, "seam_crossings": crossed, "places": places,
        "summary": [
            f"With the photograph's centre ahead, the {query}{looked_for(last)} is {where}; presence "
            f"{100 * last.presence:.0f} %, {last.status}.",
            f"The detector saw {saw}. The camera turned, pitched and rolled; the {query} crossed the seam of the "
            f"picture {'once' if crossed == 1 else f'{crossed} times'}.",
            NO_TRUTH,
        ],
    }  # fmt: skip


def _angles(toward: np.ndarray) -> dict[str, float]:
    names = "azimuth_deg", "elevation_deg"
    return {name: round(math.degrees(angle), 4) for name, angle in zip(names, azimuth_elevation(toward), strict=True)}


def _in_words(place: dict[str, float]) -> str:
    return in_words(math.radians(place["azimuth_deg"]), math.radians(place["elevation_deg"]))
