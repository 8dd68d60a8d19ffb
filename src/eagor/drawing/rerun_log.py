"""Logs for the Rerun viewer: panorama, belief, directions, pose and status over time, in one .rrd file.

Entities: ``world/path`` and ``world/body`` in 3-D, where a ball around the camera shows the panorama with the belief,
and arrows point to the answers; ``panorama`` with its marks in 2-D; ``plots/...``; ``status``. Of an ordinary camera
also ``picture`` with its marks in 2-D, and ``world/body/camera``, its frustum; ``panorama`` then shows what was looked
at so far.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._extras import need
from eagor.drawing.panorama import BEHIND, Heat, arrow, backdrop, heat_of, places, worth_an_arrow
from eagor.drawing.style import answer_in_words, sureness
from eagor.drawing.view import Mosaic, edge, heat_in_view, lines_in_view, outline_of, place_in_view
from eagor.errors import EagorError, StorageError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.sphere import azimuth_elevation, direction
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["RerunLog"]

WIDTH = 768  # columns of the logged panorama
QUALITY = 85  # of its JPEG
BALL = ErpGrid(36, 72)  # vertices of the ball around the camera
RADIUS = 0.25  # metres: of the ball
SHORTEST, LONGEST, ANYWHERE = 0.6, 20.0, 2.0  # metres: of arrows; the last to a thing at an unknown distance
CALENDAR = 1e8  # seconds: stamps beyond count from 1970, and are shown as dates
OURS, MODE, TRUTH, OTHER = (255, 176, 0), (255, 120, 60), (60, 220, 120), (150, 160, 180)
WHITE = (255, 255, 255)
DOTTED = ("azimuth", "truth")  # angles that jump where they cross the back: drawn as dots, without lines over the plot
BLANK = (60, 64, 72)
LEVELS = {"stale": "WARN"}


class RerunLog:
    """Writes an .rrd file; a context manager.

    `title` names the recording in the viewer. The file grows while it is written, and what was written can be opened
    even if the program ends without closing it.

    Raises `MissingExtraError` without rerun-sdk, `EagorError` for another suffix, `StorageError` if the file cannot be
    written.
    """

    def __init__(self, path: str | Path, title: str = "eagor") -> None:
        need("a log for the Rerun viewer", "rerun", "rerun")
        self.path = Path(path)
        if self.path.suffix != ".rrd":
            raise EagorError(f"{path} does not end in .rrd; name a file such as run.rrd")
        self._rerun = rerun = _rerun()
        self._log: Any = rerun.RecordingStream("eagor", send_properties=False)
        try:
            with open(self.path, "wb"):
                pass
            self._log.save(self.path, default_blueprint=_layout())
        except OSError as error:
            raise StorageError(
                f"{path} cannot be written ({error.strerror or error}); name a folder that can be written to"
            ) from error
        self._log.send_recording_name(title)
        self._log.log("world", rerun.ViewCoordinates.FLU, static=True)
        self._log.log("world/body/ball", _ball(), static=True)
        self._walked: list[np.ndarray] = []
        self._said: dict[str, str] = {}
        self._mosaic: Mosaic | None = None  # once there was a picture of an ordinary camera

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Finish the file. May be called twice."""
        if self._log is not None:
            self._log.flush()
            self._log.disconnect()
            self._log = None

    def add(
        self,
        picture: np.ndarray | None,
        estimate: Estimate,
        *,
        stamp: float,
        query: str = "target",
        position: np.ndarray | None = None,
        truth: np.ndarray | None = None,
        others: Mapping[str, np.ndarray | None] | None = None,
        problem: str | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> None:
        """Log one answer.

        Args:
            picture: ``(H, W, 3)`` uint8: a panorama in the body frame, or with `grid` what an ordinary camera saw; None
                between frames: the one before stays.
            estimate: the answer; its `world_R_body` is the orientation.
            stamp: seconds; beyond 1e8 they count from 1970.
            query: what is asked for. Several queries may be logged at one stamp; the first one of a stamp with a
                panorama is drawn on the ball.
            position: ``(3,)`` metres, world frame.
            truth: true direction ``(3,)``, body frame, where it is known.
            others: directions ``(3,)`` of other methods by name.
            problem: what went wrong, in words.
            grid: which directions of the body the pixels of an ordinary camera show.
        """
        self._at(stamp)
        heat = heat_of(estimate)
        self._pose(estimate.world_R_body, position)
        if picture is not None:
            self._picture(picture if grid is None else self._looked(picture, grid, estimate, heat), heat)
        elif not self._said:  # the ball has to have some colour before the first picture
            self._log.log("world/body/ball", self._rerun.Mesh3D.from_fields(vertex_colors=[BLANK] * len(_vertices())))
        name = re.sub(r"[^\w\-]+", "_", query).strip("_") or "target"
        self._marks(name, estimate, heat, truth, others or {})
        self._arrows(name, estimate, truth, others or {})
        self._plots(name, estimate, truth)
        if grid is not None:
            self._marks_in_view(name, estimate, heat, grid, truth)
        self._status(name, query, estimate, problem)

    def say(self, stamp: float, what: str, level: str = "WARN") -> None:
        """Log a line of text, such as a fault of the camera; `level`: INFO, WARN or ERROR."""
        self._at(stamp)
        self._line(what, level)

    def _at(self, stamp: float) -> None:
        if self._log is None:
            raise StorageError(f"{self.path} is closed")
        if stamp > CALENDAR:
            self._log.set_time("time", timestamp=stamp)
        else:
            self._log.set_time("time", duration=stamp)

    def _pose(self, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        place = np.zeros(3) if position is None else np.asarray(position, dtype=float)
        self._log.log("world/body", self._rerun.Transform3D(translation=place, mat3x3=world_R_body))
        if position is not None and (not self._walked or np.linalg.norm(place - self._walked[-1]) > 0.02):
            self._walked.append(place)
            self._log.log("world/path", self._rerun.LineStrips3D([self._walked], colors=OTHER, radii=0.01))

    def _picture(self, panorama: np.ndarray, heat: Heat | None) -> None:
        pixels = backdrop(panorama, heat, WIDTH, WIDTH // 2)
        self._log.log("panorama", self._rerun.Image(pixels).compress(jpeg_quality=QUALITY))
        x, y, _ = ErpGrid(*pixels.shape[:2]).project(_vertices())
        column, row = x.astype(int) % pixels.shape[1], np.clip(y.astype(int), 0, pixels.shape[0] - 1)
        self._log.log("world/body/ball", self._rerun.Mesh3D.from_fields(vertex_colors=pixels[row, column]))

    def _looked(self, picture: np.ndarray, grid: PerspectiveGrid, estimate: Estimate, heat: Heat | None) -> np.ndarray:
        """Log the picture of an ordinary camera; returns what it has shown so far, a panorama in the body frame."""
        if self._mosaic is None:
            self._mosaic = Mosaic()
            self._log.send_blueprint(_layout(picture=True))
        self._mosaic.add(picture, grid, estimate.world_R_body)
        height, width = _shape_in_view(grid)
        there = None if heat is None else Heat(heat_in_view(heat, grid, height // 2, width // 2))
        pixels = backdrop(picture, there, width, height)
        self._log.log("picture", self._rerun.Image(pixels).compress(jpeg_quality=QUALITY))
        lens = self._rerun.Pinhole(
            focal_length=grid.focal, width=grid.width, height=grid.height, camera_xyz=self._rerun.ViewCoordinates.FLU,
            image_plane_distance=2 * RADIUS,
        )  # fmt: skip
        self._log.log("world/body/camera", self._rerun.Transform3D(mat3x3=grid.body_R_view), lens)
        outline = [_pixels(line) for line in outline_of(grid)]
        self._log.log("panorama/view", self._rerun.LineStrips2D(outline, colors=WHITE, draw_order=10))
        return self._mosaic.seen_from(estimate.world_R_body, BEHIND)

    def _marks_in_view(
        self, name: str, estimate: Estimate, heat: Heat | None, grid: PerspectiveGrid, truth: np.ndarray | None
    ) -> None:
        """Over the picture of an ordinary camera: the border, the answer, or an arrow at the edge; the truth."""
        height, width = _shape_in_view(grid)
        size, answer = np.array([width, height]), estimate.direction
        lines = [] if heat is None else [size * line for line in lines_in_view(heat.border, grid)]
        pointed = [(answer, OURS, name), (truth, TRUTH, "truth")]
        self._draw(f"picture/{name}", lines, pointed, lambda where: size * place_in_view(where, grid))
        arrows, said = [], []
        if answer is not None and not len(place_in_view(answer, grid)):
            out = edge(answer, grid, width, height)
            arrows, said = [(out.tip, 0.16 * min(height, width) * out.way)], [f"{out.angle:.0f}°, {sureness(estimate)}"]
        self._log.log(
            f"picture/{name}/edge",
            self._rerun.Arrows2D(
                vectors=[way for _, way in arrows], origins=[tip - way for tip, way in arrows], colors=OURS, radii=4,
                labels=said, draw_order=40,
            ),
        )  # fmt: skip

    def _marks(
        self, name: str, estimate: Estimate, heat: Heat | None, truth: np.ndarray | None, others: Mapping[str, Any]
    ) -> None:
        """Over the panorama: the border of the region, the arrow, the candidates, other methods and the truth."""
        lines = [] if heat is None else [_pixels(line) for line in heat.border]
        if estimate.direction is not None and worth_an_arrow(estimate) and len(way := arrow(estimate.direction)):
            jumps = np.flatnonzero(np.abs(np.diff(way[:, 0])) > 180) + 1
            lines += [_pixels(part) for part in np.split(way, jumps)]
        pointed = [(each.direction, MODE, f"{each.weight:.0%}") for each in estimate.modes[1:3]]
        pointed += [(where, OTHER, method) for method, where in others.items()]
        pointed += [(estimate.direction, OURS, name), (truth, TRUTH, "truth")]
        self._draw(f"panorama/{name}", lines, pointed, lambda where: _pixels(places(where)))

    def _draw(
        self,
        path: str,
        lines: Sequence[np.ndarray],
        pointed: Sequence[tuple[np.ndarray | None, tuple[int, int, int], str]],
        at: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        """Lines, and a point at each place of each direction that is known."""
        known = [(where, colour, label) for where, colour, label in pointed if where is not None]
        marks = [(place, colour, label) for where, colour, label in known for place in at(where)]
        points, colours, labels = zip(*marks, strict=True) if marks else ((), (), ())
        self._log.log(f"{path}/lines", self._rerun.LineStrips2D(lines, colors=OURS, draw_order=20))
        drawn = self._rerun.Points2D(points, colors=colours, labels=labels, radii=5, draw_order=30)
        self._log.log(f"{path}/points", drawn)

    def _arrows(
        self, name: str, estimate: Estimate, truth: np.ndarray | None, others: Mapping[str, np.ndarray | None]
    ) -> None:
        far = min(max(estimate.distance or ANYWHERE, SHORTEST), LONGEST)
        pointed = [(where, OTHER, 0.005) for where in others.values() if where is not None]
        if truth is not None:
            pointed.append((truth, TRUTH, 0.01))
        if estimate.direction is not None and worth_an_arrow(estimate):
            pointed.append((estimate.direction, OURS, 0.02))
        self._log.log(
            f"world/body/{name}",
            self._rerun.Arrows3D(
                vectors=[far * np.asarray(where) for where, _, _ in pointed],
                origins=np.zeros((len(pointed), 3)),
                colors=[colour for _, colour, _ in pointed],
                radii=[thick for _, _, thick in pointed],
            ),
        )

    def _plots(self, name: str, estimate: Estimate, truth: np.ndarray | None) -> None:
        """Angles in degrees; a value that is not known leaves a gap."""
        values: dict[str, float | None] = {"presence/presence": estimate.presence}
        known = estimate.direction is not None
        values["angles/azimuth"] = math.degrees(float(estimate.azimuth)) if estimate.azimuth is not None else None
        values["angles/cone"] = math.degrees(estimate.credible_angle) if known else None
        if truth is not None:
            values["angles/truth"] = math.degrees(float(azimuth_elevation(truth)[0]))
        for key, value in values.items():
            kind, what = key.split("/")
            path = f"plots/{kind}/{name}/{what}"
            if what in DOTTED and path not in self._said:
                self._said[path] = what
                self._log.log(path, self._rerun.SeriesPoints(marker_sizes=2.5), static=True)
            self._log.log(path, self._rerun.Scalars([math.nan if value is None else value]))

    def _status(self, name: str, query: str, estimate: Estimate, problem: str | None) -> None:
        """A line where the status changes, or something is wrong."""
        told = answer_in_words(estimate)
        if self._said.get(name) != (said := estimate.status):
            self._said[name] = said
            self._line(f"“{query}”: {said}: {told}", LEVELS.get(estimate.status, "INFO"))
        if problem is not None:
            self._line(problem, "WARN")

    def _line(self, what: str, level: str) -> None:
        self._log.log("status", self._rerun.TextLog(what, level=level))


def _shape_in_view(grid: PerspectiveGrid) -> tuple[int, int]:
    """Rows and columns of the logged picture of an ordinary camera."""
    return max(2, round(WIDTH * grid.height / grid.width)), WIDTH


def _pixels(where: np.ndarray) -> np.ndarray:
    """Places in degrees ``(n, 2)`` as pixels of the logged panorama."""
    where = np.asarray(where, dtype=float)
    return np.stack([(180 - where[:, 0]) * WIDTH / 360, (90 - where[:, 1]) * WIDTH / 360], axis=-1)


def _vertices() -> np.ndarray:
    """Directions of the ball's vertices ``(n, 3)``: rows from pole to pole, the first column again at the end."""
    elevation = np.linspace(math.pi / 2, -math.pi / 2, BALL.height)[:, None]
    azimuth = np.linspace(math.pi, -math.pi, BALL.width + 1)[None, :]
    return direction(*np.broadcast_arrays(azimuth, elevation)).reshape(-1, 3)


def _rerun() -> Any:
    import rerun

    return rerun


def _ball() -> Any:
    """The ball around the camera. Its colours come with each panorama; without normals nothing shades them."""
    rerun = _rerun()
    wide = BALL.width + 1
    corner = (np.arange(BALL.height - 1)[:, None] * wide + np.arange(BALL.width)[None, :]).reshape(-1)
    triangles = np.concatenate(
        [
            np.stack([corner, corner + wide, corner + 1], axis=1),
            np.stack([corner + 1, corner + wide, corner + wide + 1], axis=1),
        ]
    )
    return rerun.Mesh3D(vertex_positions=RADIUS * _vertices(), triangle_indices=triangles)


def _layout(picture: bool = False) -> Any:
    """What the viewer shows at first; `picture`: of an ordinary camera, too."""
    import rerun.blueprint as view

    seen = [view.Spatial2DView(origin="picture", name="Picture")] if picture else []
    return view.Blueprint(
        view.Horizontal(
            view.Vertical(
                *seen,
                view.Spatial2DView(origin="panorama", name="Panorama"),
                view.TimeSeriesView(
                    origin="plots/angles",
                    name="Azimuth and 90 % cone, degrees",
                    axis_y=view.ScalarAxis(range=(-180, 180)),
                ),
                view.TimeSeriesView(origin="plots/presence", name="Presence", axis_y=view.ScalarAxis(range=(0, 1))),
                row_shares=[3] * len(seen) + [3, 2, 1],
            ),
            view.Vertical(
                view.Spatial3DView(origin="world", name="World"),
                view.TextLogView(origin="status", name="Status"),
                row_shares=[3, 1],
            ),
            column_shares=[3, 2],
        ),
        collapse_panels=True,
    )
