"""``eagor demo --photo``: a virtual camera turns in a photograph of yours, and every method follows the query."""

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
from eagor.lab.agents.methods import NAMES, TrackerEstimator, make_estimator
from eagor.lab.eval.results import OURS
from eagor.lab.worlds.render import Photograph
from eagor.media.panorama import cut
from eagor.perception import Perception, look, rows_of, short_name
from eagor.perception.views import Detector
from eagor.sphere import angular_distance, azimuth_elevation, world_R_body
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from PIL.Image import Image

NEAR = 15  # degrees
RIVALS = ("centroid", "eagor_paper", "vmf", "particle_filter")  # in the picture, whose legend has no room for more
LOOKS = 24
SECONDS = 0.5  # between looks
LEVEL = 8  # looks before the camera begins to tumble
YAW, TILT = 25.0, 40.0  # degrees: the heading's change per look; the largest pitch and roll
MOST_ROWS = 1024  # of the turned panoramas: more cost much and show a detector nothing new


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
    def figures(self) -> dict[str, dict[str, float]]:
        """Each method's angles (degrees) to our last answer: mean, last, and the share (%) within `NEAR` degrees."""
        found = {name: self.angles(name) for name in self.directions}
        return {
            name: {"mean_deg": each.mean(), "last_deg": each[-1], f"within_{NEAR}_deg": 100 * (each < NEAR).mean()}
            for name, each in found.items()
        }

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
    """The class that a detector finds with the highest score. Raises `UsageError`, `RunError` if there is none."""
    if not isinstance(perception, Detector) or perception.classes is None:
        raise UsageError("this perception has no list of classes to choose from; say what to look for with --query")
    best: tuple[float, str] = (0.0, "")
    for picture in cut(panorama, *perception.views()):
        _, scores, labels = perception.function(picture, perception.classes[0])
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
    methods = {name: make_estimator(name, np.random.default_rng(0), spec) for name in NAMES}
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
            if name == OURS and isinstance(method, TrackerEstimator):
                estimates.append(method.estimate)
        advance()
    if all(count == 0 for count in found):
        raise RunError(f"{spec} saw no {query!r} in any of {LOOKS} looks; ask for something else with --query")
    told: dict[str, Any] = {name: np.array(each) for name, each in directions.items()}
    return Looks(small, query, rows, poses(), tuple(found), tuple(estimates), told)


def _seen(photograph: Photograph, pose: np.ndarray, rows: int) -> np.ndarray:
    seen = photograph.panorama((0.0, 0.0, 0.0), pose, rows, range=False, ids=False).rgb
    assert seen is not None
    return seen


# --- in words and numbers, and the report -----------------------------------------------------------------------------


def as_text(looks: Looks) -> list[str]:
    """One line per method."""
    lines = [f"{'angle to our last answer':25}{'mean':>8}{'last':>8}{f'within {NEAR}°':>13}"]
    for name, figures in looks.figures.items():
        lines.append("{:25}{:>6.1f} °{:>6.1f} °{:>11.0f} %".format(name, *figures.values()))
    return lines


def summary(looks: Looks) -> list[str]:
    """The result in sentences."""
    last, seen = looks.estimates[-1], sum(count != 0 for count in looks.found)
    where = in_words(*map(float, azimuth_elevation(looks.answer)))
    found = "a map each time" if looks.found[0] is None else f"it in {seen} of {len(looks.found)} looks"
    turns = f"{looks.crossings} times" if looks.crossings != 1 else "once"
    return [
        f"With the photograph's centre ahead, the {looks.query}{looked_for(last)} is {where} ({last.certainty}); "
        f"presence {100 * last.presence:.0f} %, {last.status}.",
        f"The detector saw {found}. The camera turned, pitched and rolled; the {looks.query} crossed the seam of the "
        f"picture {turns}.",
        "Nobody has measured where it is. The angles are to our own answer after all looks: they show how steady a "
        "method is, not how right.",
    ]


def as_json(looks: Looks, spec: str, photo: str) -> dict[str, Any]:
    """The result for ``--json``; azimuth and elevation are those in the photograph."""
    azimuth, elevation = np.degrees(azimuth_elevation(looks.answer)).round(4).tolist()
    last = looks.estimates[-1]
    return {
        "query": looks.query, "photo": photo, "perception": spec, "looks": len(looks.poses), "seen": list(looks.found),
        "azimuth_deg": azimuth, "elevation_deg": elevation,
        "credible_angle_deg": round(math.degrees(last.credible_angle), 4), "presence": round(last.presence, 6),
        "status": last.status, "seam_crossings": looks.crossings,
        "methods": {name: {k: round(float(v), 4) for k, v in each.items()} for name, each in looks.figures.items()},
        "summary": summary(looks),
    }  # fmt: skip


def write_report(looks: Looks, spec: str, photo: str, folder: Path) -> Path:
    """Draw the pictures into `folder` and write report.html there; returns its path. Raises `StorageError`."""
    from eagor.drawing import draw_belief, draw_errors
    from eagor.lab.agents.methods import DESCRIPTIONS
    from eagor.lab.eval.page import Cell, Pictures, Row, Section, Table, Text, page

    names = sorted(looks.directions, key=lambda name: name != OURS)  # ours first: it is drawn on top
    angles, moments = {name: looks.angles(name).tolist() for name in names}, []
    for index, what in highlights(looks):
        estimate, answer = looks.estimates[index], looks.poses[index].T @ looks.answer
        title = f"Look {index + 1}, {what}: {estimate.status}"
        drawn = draw_belief(looks.panorama(index), estimate, others={"last answer": answer}, title=title, width=900)
        save_image(drawn, folder / f"look-{index + 1:02}.jpg")
        moments.append((_image(drawn, title), f"{title}, {angles[OURS][index]:.0f}° from the last answer"))
    times = [SECONDS * index for index in range(len(looks.poses))]
    errors = draw_errors(times, angles, title="Angle to our last answer", what="angle")
    rivals = {name: looks.poses[-1].T @ looks.directions[name][-1] for name in RIVALS}
    every = draw_belief(looks.panorama(-1), looks.estimates[-1], others=rivals, title="Methods after the last look")
    save_image(errors, folder / "angles.png")
    save_image(every, folder / "methods.jpg")
    rows = []
    for name, figures in looks.figures.items():
        cells = [*map("{:.{}f}".format, figures.values(), (1, 1, 0)), DESCRIPTIONS[name]]
        rows.append(Row(name, [*map(Cell, cells)], "text ours" if name == OURS else "text"))
    heads = ("method", "mean angle (°)", "last look (°)", f"within {NEAR}° (%)", "what it is")
    table = Table(f"Angles to our last answer, over {len(looks.poses)} looks", heads, rows)
    steady = "How steady each method is: no truth is known, so the angles are to our last answer"
    last = "Our estimate at the end, and those of four others"
    both = [
        (_image(errors, "Angle of each method to our last answer, over time"), steady),
        (_image(every, "The last look with the direction of each method"), last),
    ]
    sections = [
        Section("What the camera saw, and what we believed", [Pictures(moments, "strip")], "looks"),
        Section("Each method side by side", [table, Pictures(both)], "methods"),
    ]
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
