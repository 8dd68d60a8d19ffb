"""A log of a loop for the Rerun viewer: what was seen and believed, directions, the pose, and what there is to say.

Entities: ``picture``, what was seen with the belief on it; in 3-D ``world/body`` with an arrow to each answer, and
``world/path``; over time ``plots/angles`` and ``plots/presence``; ``status``, lines of text.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from eagor._extras import need
from eagor.drawing import StepPainter
from eagor.drawing.marks import Marks, worth_an_arrow
from eagor.drawing.style import answer_in_words
from eagor.errors import EagorError, StorageError
from eagor.live.events import Answer, Event, FaultLog, ImageReceived, PoseReceived

__all__ = ["RerunLog"]

WIDTH, QUALITY = 1024, 85  # columns of a picture, and of its JPEG
INTERVAL = 0.2  # seconds between two answers of a loop in real time: drawing takes half of it
SHORTEST, LONGEST, ANYWHERE = 0.6, 20.0, 2.0  # metres: of arrows; the last to a thing at an unknown distance
CALENDAR = 1e8  # seconds: stamps beyond count from 1970, and are shown as dates
OURS, PATH = (0, 229, 255), (150, 160, 180)


class RerunLog:
    """A sink of the loop (`eagor.live.loop.Sink`) that writes an .rrd file.

    Of a loop in turn every answer is logged. With `realtime` a thread of its own draws, so that it never holds up an
    answer, and answers that come meanwhile or within 0.2 s are left out. With several queries the belief about the
    first one is drawn, and the answers to the others are marked. `title` names the recording in the viewer. The file
    grows while it is written, and what was written can be opened even if the program ends without closing it.
    `problem`: why the log ended before the loop did, or None.

    Raises `MissingExtraError` without rerun-sdk, `EagorError` for another suffix, `StorageError` if the file cannot be
    written.
    """

    def __init__(self, path: str | Path, title: str = "eagor", realtime: bool = False) -> None:
        need("a log for the Rerun viewer", "rerun", "rerun")
        if Path(path).suffix != ".rrd":
            raise EagorError(f"{path} does not end in .rrd; name a file such as run.rrd")
        self._rerun: Any = import_module("rerun")
        self._log: Any = self._rerun.RecordingStream("eagor", send_properties=False)
        try:
            Path(path).write_bytes(b"")
            self._log.save(path, default_blueprint=_layout())
        except OSError as error:
            raise StorageError(f"{path} cannot be written ({error.strerror}); name a folder that can be") from error
        self._log.send_recording_name(title)
        self._log.log("world", self._rerun.ViewCoordinates.FLU, static=True)
        self.problem: str | None = None
        self._realtime, self._taken = realtime, -math.inf
        self._thread, self._job = ThreadPoolExecutor(1), Future[None]()
        self._job.set_result(None)
        self._painter, self._faults = StepPainter(WIDTH, bare=True), FaultLog()
        self._frame: ImageReceived | None = None  # that was not logged yet
        self._poses: list[PoseReceived] = []  # the last one before an answer, and those after it: in turn, one is ahead
        self._path: list[np.ndarray] = []
        self._said: dict[str, str] = {}  # the last status, by query

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop, and the answers to it."""
        if isinstance(event, ImageReceived):
            self._frame = event
        elif isinstance(event, PoseReceived) and event.pose.position is not None:
            self._poses.append(event)
        late = self._realtime and answers and (not self._job.done() or answers[0].stamp - self._taken < INTERVAL)
        if answers and not late and not self._ended():
            self._taken = now = answers[0].stamp
            while len(self._poses) > 1 and self._poses[1].arrival <= now:
                del self._poses[0]
            position = self._poses[0].pose.position if self._poses else None
            self._job = self._thread.submit(self._write, answers, self._frame, position)
            self._frame = None
            if not self._realtime:
                self._ended()

    def close(self) -> None:
        """Write what is left, and finish the file."""
        self._ended()
        self._thread.shutdown()
        self._log.disconnect()

    def _ended(self) -> bool:
        """Wait for what is being written; whether that has failed."""
        if (error := self._job.exception()) is not None:
            self.problem = f"the log for Rerun ends early: {error}"
        return error is not None

    def _write(self, answers: Sequence[Answer], frame: ImageReceived | None, position: np.ndarray | None) -> None:
        rerun, first, log = self._rerun, answers[0], self._log.log
        self._log.set_time("time", **{"timestamp" if first.stamp > CALENDAR else "duration": first.stamp})
        place = np.zeros(3) if position is None else np.asarray(position, dtype=float)
        log("world/body", rerun.Transform3D(translation=place, mat3x3=first.estimate.world_R_body))
        if position is not None and (not self._path or np.linalg.norm(place - self._path[-1]) > 0.02):
            self._path.append(place)
            log("world/path", rerun.LineStrips3D([self._path], colors=PATH, radii=0.01))
        said = [(text, "WARN" if wrong else "INFO") for text, wrong in self._faults.of(first.faults, first.stamp)]
        if frame is not None:
            others = Marks(others={answer.query: answer.direction for answer in answers[1:]})
            how: dict[str, Any] = {"problem": frame.problem, "grid": frame.grid, "more": others}
            pixels = self._painter.paint(frame.picture, first.estimate, **how)
            log("picture", rerun.Image(pixels).compress(jpeg_quality=QUALITY))
            said += [(f"{frame.name} is left out: {frame.problem}", "WARN")] if frame.problem else []
        for answer in answers:
            e, name = answer.estimate, re.sub(r"[^\w\-]+", "_", answer.query).strip("_") or "target"
            azimuth, cone, arrows = math.nan, math.nan, []  # what is not known leaves a gap
            if e.direction is not None and e.azimuth is not None:
                azimuth, cone = math.degrees(e.azimuth), math.degrees(e.credible_angle)
                far = min(max(e.distance or ANYWHERE, SHORTEST), LONGEST)
                arrows = [far * e.direction] if worth_an_arrow(e) else []
            labels = [answer.query] * len(arrows)
            log(f"world/body/{name}", rerun.Arrows3D(vectors=arrows, colors=OURS, radii=0.02, labels=labels))
            if name not in self._said:  # azimuths jump where they cross the back: dots, without lines over the plot
                log(f"plots/angles/{name}/azimuth", rerun.SeriesPoints(marker_sizes=2.5), static=True)
            log(f"plots/angles/{name}/azimuth", rerun.Scalars([azimuth]))
            log(f"plots/angles/{name}/cone", rerun.Scalars([cone]))
            log(f"plots/presence/{name}", rerun.Scalars([e.presence]))
            if self._said.get(name) != e.status:
                self._said[name] = e.status
                text = f"“{answer.query}”: {e.status}: {answer_in_words(e)}"
                said.append((text, "WARN" if e.status == "stale" else "INFO"))
        for text, level in said:
            log("status", rerun.TextLog(text, level=level))


def _layout() -> Any:
    """What the viewer shows at first."""
    import rerun.blueprint as view

    half, share = view.ScalarAxis(range=(-180, 180)), view.ScalarAxis(range=(0, 1))
    seen = view.Spatial2DView(origin="picture", name="What was seen, and what is believed")
    angles = view.TimeSeriesView(origin="plots/angles", name="Azimuth and 90 % cone, degrees", axis_y=half)
    presence = view.TimeSeriesView(origin="plots/presence", name="Presence", axis_y=share)
    world, status = view.Spatial3DView(origin="world", name="World"), view.TextLogView(origin="status", name="Status")
    left, right = view.Vertical(seen, angles, presence, row_shares=[3, 2, 1]), view.Vertical(world, status)
    return view.Blueprint(view.Horizontal(left, right, column_shares=[3, 2]), collapse_panels=True)
