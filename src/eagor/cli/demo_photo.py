"""``eagor demo --photo``: a virtual camera turns in a photograph of yours, and our tracker follows the query."""

from __future__ import annotations

import html
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._files import written
from eagor.cli.answers import save_image
from eagor.cli.terminal import RunError, UsageError
from eagor.drawing.page import as_address
from eagor.drawing.style import in_words, looked_for
from eagor.evidence import Evidence
from eagor.lab.agents.methods import TrackerEstimator, make_estimator
from eagor.lab.eval.results import OURS
from eagor.lab.worlds.render import Photograph
from eagor.perception import Perception, look, rows_of, short_name
from eagor.perception.views import Detector
from eagor.sphere import azimuth_elevation, world_R_body
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from PIL.Image import Image

PLACE = 0.1  # weight from which a candidate is named
LOOKS = 24
SECONDS = 0.5  # between looks
LEVEL = 8  # looks before the camera begins to tumble
YAW, TILT = 25.0, 40.0  # degrees: the heading's change per look; the largest pitch and roll
MOST_ROWS = 1024  # of the turned panoramas: more cost much and show a detector nothing new


@dataclass(frozen=True, eq=False)
class Looks:
    """What happened: per look the pose ``(3, 3)``, the number of detections (None: a map) and our estimate.

    `directions` are its answers ``(LOOKS, 3)`` in the frame of the photograph: x through its centre, z up.
    """

    photograph: Photograph
    query: str
    rows: int
    poses: tuple[np.ndarray, ...]
    found: tuple[int | None, ...]
    estimates: tuple[Estimate, ...]
    directions: np.ndarray

    @property
    def answer(self) -> np.ndarray:
        """The last direction ``(3,)``, after all looks."""
        return self.directions[-1]

    @property
    def places(self) -> list[tuple[float, float, float]]:
        """Azimuth and elevation (radians) of each likely candidate after all looks, and its weight."""
        likely = [mode for mode in self.estimates[-1].modes if mode.weight >= PLACE]
        angles = [azimuth_elevation(self.poses[-1] @ mode.direction) for mode in likely]
        return [(float(a), float(e), mode.weight) for (a, e), mode in zip(angles, likely, strict=True)]

    @property
    def azimuths(self) -> np.ndarray:
        """Where the answer is in each picture ``(LOOKS,)``, radians: it crosses the seam because the camera turns."""
        return np.array([azimuth_elevation(pose.T @ self.answer)[0] for pose in self.poses])

    @property
    def crossings(self) -> int:
        """How often it does."""
        return int(np.sum(np.abs(np.diff(self.azimuths)) > math.pi))

    def panorama(self, index: int) -> np.ndarray:
        """What the camera sees at a look, ``(rows, 2 rows, 3)`` uint8."""
        return _seen(self.photograph, self.poses[index], self.rows)


def poses() -> tuple[np.ndarray, ...]:
    """The camera's orientations ``world_R_body``: it turns left, level at first, then it pitches and rolls as well."""
    phases = [max(0, index - LEVEL + 1) * math.tau / (LOOKS - LEVEL) for index in range(LOOKS)]
    turns = [(YAW * k, TILT * math.sin(phase), TILT * math.sin(2 * phase)) for k, phase in enumerate(phases)]
    return tuple(world_R_body(*map(math.radians, turn)) for turn in turns)


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


def rows_for(perception: Perception, image: np.ndarray) -> int:
    """Rows of the panoramas to look at: as fine as the perception needs and the photograph has."""
    return min(max(rows_of(perception), 128), image.shape[0], MOST_ROWS)


def play(
    image: np.ndarray, perception: Perception, spec: str, query: str, advance: Callable[[], object] = lambda: None
) -> Looks:
    """Look `LOOKS` times for `query`, and follow it. Raises `RunError` if nothing was ever seen."""
    rows = rows_for(perception, image)
    small = Photograph(_seen(Photograph(image), np.eye(3), rows))  # shrunk once
    method = make_estimator(OURS, np.random.default_rng(0), spec)
    assert isinstance(method, TrackerEstimator)
    directions: list[np.ndarray] = []
    found: list[int | None] = []
    estimates: list[Estimate] = []
    for index, pose in enumerate(poses()):
        stamp = SECONDS * index
        evidence = look(perception, _seen(small, pose, rows), query, stamp=stamp, world_R_body=pose)
        found.append(None if evidence.detections is None else len(evidence.detections.directions))
        method.move(stamp, pose, None)
        method.see(replace(evidence, stamp=stamp))
        directions.append(pose @ method.direction())
        estimates.append(method.estimate)
        advance()
    if all(count == 0 for count in found):
        raise RunError(f"{spec} saw no {query!r} in any of {LOOKS} looks; ask for something else with --query")
    return Looks(small, query, rows, poses(), tuple(found), tuple(estimates), np.array(directions))


def _seen(photograph: Photograph, pose: np.ndarray, rows: int) -> np.ndarray:
    seen = photograph.panorama((0.0, 0.0, 0.0), pose, rows, range=False, ids=False).rgb
    assert seen is not None
    return seen


# --- in words and numbers, and the report -----------------------------------------------------------------------------


def summary(looks: Looks) -> list[str]:
    """The result in sentences."""
    last, seen = looks.estimates[-1], sum(count != 0 for count in looks.found)
    where = f"{in_words(*map(float, azimuth_elevation(looks.answer)))} ({last.certainty})"
    if last.status == "ambiguous" and len(looks.places) > 1:
        each = "; ".join(f"{in_words(a, e)} ({100 * weight:.0f} %)" for a, e, weight in looks.places)
        where = f"in one of {len(looks.places)} places, or in several of them: {each}"
    found = "a map each time" if looks.found[0] is None else f"it in {seen} of {len(looks.found)} looks"
    turns = f"{looks.crossings} times" if looks.crossings != 1 else "once"
    return [
        f"With the photograph's centre ahead, the {looks.query}{looked_for(last)} is {where}; presence "
        f"{100 * last.presence:.0f} %, {last.status}.",
        f"The detector saw {found}. The camera turned, pitched and rolled; the {looks.query} crossed the seam of the "
        f"picture {turns}.",
        "Nobody has measured where it is: look whether the mark is on it.",
    ]


def as_json(looks: Looks, spec: str, photo: str) -> dict[str, Any]:
    """The result for ``--json``; azimuth and elevation are those in the photograph."""
    last = looks.estimates[-1]
    return {
        "query": looks.query, "photo": photo, "perception": spec, "looks": len(looks.poses), "seen": list(looks.found),
        **_degrees(*azimuth_elevation(looks.answer)),
        "credible_angle_deg": round(math.degrees(last.credible_angle), 4), "presence": round(last.presence, 6),
        "status": last.status, "seam_crossings": looks.crossings,
        "places": [_degrees(a, e) | {"weight": round(weight, 6)} for a, e, weight in looks.places],
        "summary": summary(looks),
    }  # fmt: skip


def _degrees(azimuth: float | np.ndarray, elevation: float | np.ndarray) -> dict[str, float]:
    return {"azimuth_deg": round(math.degrees(azimuth), 4), "elevation_deg": round(math.degrees(elevation), 4)}


def write_report(looks: Looks, spec: str, photo: str, folder: Path) -> Path:
    """Draw the pictures into `folder` and write report.html there; returns its path. Raises `StorageError`."""
    from eagor.drawing import draw_belief
    from eagor.lab.eval.page import Pictures, Section, Text, page

    moments = []
    for index, what in highlights(looks):
        estimate, answer = looks.estimates[index], looks.poses[index].T @ looks.answer
        title = f"Look {index + 1}, {what}: {estimate.status}"
        drawn = draw_belief(looks.panorama(index), estimate, others={"last answer": answer}, title=title, width=900)
        save_image(drawn, folder / f"look-{index + 1:02}.jpg")
        moments.append((_image(drawn, title), title))
    sections = [Section("What the camera saw, and what we believed", [Pictures(moments, "strip")], "looks")]
    first, *more = summary(looks)
    lead = [Text(f"{photo}, seen by {short_name(spec)}. {first}"), *map(Text, more)]
    return written(folder / "report.html", page(f"Where is the {looks.query}?", lead, sections))


def highlights(looks: Looks) -> list[tuple[int, str]]:
    """At most six looks for pictures, in order of time, each with what is special about it."""
    tilt = [float(pose[2, 2]) for pose in looks.poses]  # cosine of the angle between the body's up and the world's
    chosen = {int(np.argmin(tilt)): "the most tilted", int(np.argmax(np.abs(looks.azimuths))): "at the seam"}
    if missed := [index for index, count in enumerate(looks.found) if count == 0]:
        chosen.setdefault(missed[len(missed) // 2], "nothing detected")
    last = len(looks.poses) - 1
    return sorted(({3: "a few looks later"} | chosen | {0: "the first", last: "the last"}).items())[:6]


def _image(picture: Image, text: str) -> str:
    """An element of a page with the picture in it."""
    return f'<img alt="{html.escape(text)}" src="{as_address(np.asarray(picture))}" style="width:100%;height:auto">'
