"""``eagor demo --photo --hfov``: an ordinary camera searches a photograph by turning, and so do two others.

The body stays level and turns its heading; the camera is tilted on it. A tracker follows all looks. Who chooses
where it looks next is one of `CHOICES`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor._files import written
from eagor.cli.checks import keep_picture
from eagor.cli.demo_photo import as_image
from eagor.cli.terminal import RunError
from eagor.drawing.style import in_words, looked_for, sureness
from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.lab.tasks.hstar.agents import SWEEP
from eagor.media.panorama import cut, turn
from eagor.perception import Perception, look, short_name
from eagor.perception.partial import look_at_view
from eagor.sphere import angular_distance, azimuth_elevation, world_R_body
from eagor.tracking import DirectionTracker, Estimate, Heights, TurningCamera

OURS, SHOWN = "next", ("next", "follow", "sweep")
MOST = 16  # looks
AROUND = (0, 20, 40, 60)  # degrees: headings of the looks all around, to which the answers are compared
WIDTH, RATIO = 640, 4 / 3  # of the camera's pictures
PRESENT = 0.9  # presence from which on a search is sure
SECONDS = 1.0  # between looks

Heading = tuple[float, float]  # azimuth, positive left, and elevation, degrees, world frame
Look = Callable[[np.ndarray, PerspectiveGrid, float], Evidence]  # the body's pose, the view in the body, the time


@dataclass(frozen=True, eq=False)
class LookTaken:
    """One look: the body's orientation ``(3, 3)``, the pixels of the camera, and the estimate after it."""

    world_R_body: np.ndarray
    grid: PerspectiveGrid
    estimate: Estimate

    @property
    def sure(self) -> bool:
        """Whether a direction is known and the thing is likely here."""
        return self.estimate.direction is not None and self.estimate.presence > PRESENT


Choice = Callable[[LookTaken, TurningCamera, int, float], Heading]


def _next_look(last: LookTaken, camera: TurningCamera, number: int, start: float) -> Heading:
    toward = last.estimate.next_look(camera, Heights(), last.grid.body_R_view).direction
    return _heading(last, toward)


def _follow(last: LookTaken, camera: TurningCamera, number: int, start: float) -> Heading:
    known = last.estimate.direction
    return _heading(last, last.grid.body_R_view[:, 0] if known is None else known)


def _sweep(last: LookTaken, camera: TurningCamera, number: int, start: float) -> Heading:
    yaw, pitch = SWEEP[number % len(SWEEP)]
    return start - yaw, pitch


def _ring(last: LookTaken, camera: TurningCamera, number: int, start: float) -> Heading:
    return start - 90.0 * number, 0.0


CHOICES: dict[str, tuple[Choice, str]] = {
    "next": (_next_look, "looks where a look is expected to tell most"),
    "follow": (_follow, "looks where the estimate points"),
    "sweep": (_sweep, "ten views in a fixed order: around the horizon, below it, above it; then again"),
    "ring": (_ring, "four views around the horizon, again and again"),
}


def search(look: Look, choice: str, view: PerspectiveGrid, most: int, start: float = 0.0) -> Iterator[LookTaken]:
    """At most so many looks for one thing, one a second; `choice` is one of `CHOICES`, and `view` looks forward.

    The first look is level and at the azimuth `start` (degrees). Raises what `look` raises, and `GridError` for a view
    that `TurningCamera` refuses.
    """
    camera = TurningCamera.of_view(view)
    tracker, heading = DirectionTracker(), (start, 0.0)
    for number in range(1, most + 1):
        stamp, pose = SECONDS * number, world_R_body(math.radians(heading[0]))
        grid = replace(view, body_R_view=world_R_body(0.0, -math.radians(heading[1])))
        tracker.add_pose(stamp, pose)
        tracker.observe(look(pose, grid, stamp))
        taken = LookTaken(pose, grid, tracker.estimate(stamp))
        yield taken
        heading = CHOICES[choice][0](taken, camera, number, start)


def _heading(last: LookTaken, toward: np.ndarray) -> Heading:
    """In the world, to whole degrees."""
    azimuth, elevation = np.degrees(azimuth_elevation(last.world_R_body @ toward))
    return float(round(float(azimuth))), float(round(float(elevation)))


@dataclass(frozen=True, eq=False)
class Searches:
    """What became of the searches, by who chose; `around` ``(3,)``: the answer of looks all around, world frame.

    `pictures`: what the camera saw in our looks.
    """

    query: str
    hfov: float
    around: np.ndarray
    taken: dict[str, tuple[LookTaken, ...]]
    pictures: tuple[np.ndarray, ...]

    def looks(self, choice: str) -> int | None:
        """How many looks it took until it was sure; None if it never was."""
        return len(self.taken[choice]) if self.taken[choice][-1].sure else None

    def off(self, choice: str) -> float | None:
        """Degrees between its last answer and that of the looks all around; None without one."""
        last = self.taken[choice][-1]
        toward = last.estimate.direction
        return None if toward is None else math.degrees(angular_distance(last.world_R_body @ toward, self.around))


def play(
    image: np.ndarray,
    perception: Perception,
    spec: str,
    query: str,
    hfov: float,
    advance: Callable[[], object] = lambda: None,
) -> Searches:
    """Search the photograph `image` for `query` with a camera of `hfov` degrees, until it is sure.

    Raises `RunError` if looks all around do not see the thing.
    """
    whole = DirectionTracker()
    poses = [world_R_body(math.radians(azimuth)) for azimuth in AROUND]
    for stamp, pose in enumerate(poses):
        whole.add_pose(stamp, pose)
        whole.observe(look(perception, turn(image, pose.T), query, stamp=stamp, world_R_body=pose))
    around = whole.estimate(len(AROUND) - 1).direction
    if around is None:
        raise RunError(f"{spec} sees no {query!r} in this photograph, all around; ask for something else with --query")
    around = poses[-1] @ around
    view = PerspectiveGrid(round(WIDTH / RATIO), WIDTH, math.radians(hfov))
    taken, pictures = {}, []
    for choice in SHOWN:
        seen: list[np.ndarray] = []

        def camera(pose: np.ndarray, grid: PerspectiveGrid, stamp: float, seen: list[np.ndarray] = seen) -> Evidence:
            seen += cut(image, replace(grid, body_R_view=pose @ grid.body_R_view))
            advance()
            return look_at_view(perception, seen[-1], grid, query, stamp=stamp)

        looks = []
        for each in search(camera, choice, view, MOST):
            looks.append(each)
            if each.sure:
                break
        taken[choice], pictures = tuple(looks), seen if choice == OURS else pictures
    return Searches(query, hfov, around, taken, tuple(pictures))


def as_text(searches: Searches) -> list[str]:
    """One line for each who chose."""
    heads = f"{'where to look':14}{'looks until sure':>18}{'off the looks all around':>26}"
    lines = [f"{choice:14}{told:>18}{f'{off} °' if off else '-':>26}" for choice, told, off in _cells(searches)]
    return [heads, *lines]


def _cells(searches: Searches) -> Iterator[tuple[str, str, str]]:
    """Who chose, how many looks it took, and by how many degrees it is off, "" if that is not known."""
    for choice in searches.taken:
        count, off = searches.looks(choice), searches.off(choice)
        yield choice, f"not in {MOST}" if count is None else str(count), "" if off is None else f"{off:.0f}"


def summary(searches: Searches) -> list[str]:
    """The result in sentences."""
    last = searches.taken[OURS][-1]
    toward = last.estimate.direction
    said = "is not known"
    if toward is not None:
        azimuth, elevation = map(float, azimuth_elevation(last.world_R_body @ toward))
        said = f"is {in_words(azimuth, elevation)} ({sureness(last.estimate)})"
    return [
        f"With the photograph's centre ahead, the {searches.query}{looked_for(last.estimate)} {said}.",
        f"Sure is a presence above {PRESENT:g}. " + "; ".join(f"{c}: {CHOICES[c][1]}" for c in searches.taken) + ".",
        "Nobody has measured where it is: the angles are to the answer of a few looks all around.",
    ]


def as_json(searches: Searches, spec: str, photo: str) -> dict[str, Any]:
    """The result for ``--json``; azimuths and elevations are those in the photograph."""
    azimuth, elevation = np.degrees(azimuth_elevation(searches.around))
    found = {}
    for choice in searches.taken:
        last, off = searches.taken[choice][-1], searches.off(choice)
        found[choice] = {
            "looks": searches.looks(choice),
            "off_deg": None if off is None else round(off, 4),
            "presence": round(last.estimate.presence, 6),
        }
    return {
        "query": searches.query,
        "photo": photo,
        "perception": spec,
        "hfov_deg": searches.hfov,
        "around": {"azimuth_deg": round(float(azimuth), 4), "elevation_deg": round(float(elevation), 4)},
        "searches": found,
        "summary": summary(searches),
    }


def write_report(searches: Searches, spec: str, photo: str, folder: Path) -> Path:
    """Draw our looks into `folder` and write report.html there; returns its path. Raises `StorageError`."""
    from eagor.drawing import Mosaic, draw_belief
    from eagor.lab.eval.page import Cell, Pictures, Row, Section, Table, Text, page

    mosaic, moments = Mosaic(), []
    for number, (taken, picture) in enumerate(zip(searches.taken[OURS], searches.pictures, strict=True), 1):
        title = f"Look {number}: {taken.estimate.status}"
        drawn = draw_belief(picture, taken.estimate, title=title, width=900, grid=taken.grid, mosaic=mosaic)
        keep_picture(drawn, folder / f"look-{number:02}.jpg")
        moments.append((as_image(drawn, title), f"{title}, presence {taken.estimate.presence:.2f}"))
    rows = [
        Row(
            choice, (Cell(looks), Cell(off or "-"), Cell(CHOICES[choice][1])), "text ours" if choice == OURS else "text"
        )
        for choice, looks, off in _cells(searches)
    ]
    heads = ("where to look", "looks until sure", "off the looks all around (°)", "what it is")
    sections = [
        Section("looks", "What the camera saw, and what we believed", [Pictures(moments, "strip")]),
        Section("searches", "Each search side by side", [Table("Looks until sure", heads, tuple(rows))]),
    ]
    lead = [Text(f"{photo}, seen by {short_name(spec)} through {searches.hfov:g} degrees. {summary(searches)[0]}")]
    lead += map(Text, summary(searches)[1:])
    return written(folder / "report.html", page(f"Where is the {searches.query}?", lead, sections))
