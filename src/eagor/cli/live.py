"""``eagor live``: answers from a live camera at a steady rate; ``eagor live replay``: a recorded run again.

With ``--json`` each answer is a line on stdout. On a terminal one status line shows the newest ones. What goes wrong,
and when it works again, is said on stderr.
"""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from eagor.cli import terminal
from eagor.cli.bag_steps import odometry_of
from eagor.cli.live_options import Live
from eagor.cli.looking import (
    check_looks,
    checked_folder,
    checked_out,
    checked_query,
    make_perception,
    perception_for,
    tracker_config,
)
from eagor.cli.poses import read_poses
from eagor.cli.steps import LEAST_ROWS
from eagor.drawing.words import answer_in_words
from eagor.live.events import Answer, FaultLog
from eagor.live.loop import LiveLoop, Watcher
from eagor.live.sources import GivenPoses, MotionPoses, already_open
from eagor.media.camera_sources import open_camera
from eagor.media.frames import CameraSource, Pose
from eagor.perception import is_model, rows_of
from eagor.robots.poses import GO2, ROS, open_poses
from eagor.robots.ros.sources import BagCamera

MOST_DRIFT = 90  # degrees
MOST_RATE = 1000.0  # answers per second
SHOWN = 0.1  # seconds between two status lines
BY_SIGHT = ("auto", "level")


def live(options: Live) -> int:
    """Run the command; returns its exit code."""
    if options.words[:1] == ("replay",):
        return _replay(options)
    source, queries = asked(options)
    told, watchers = _Told(options, queries), []
    try:
        if options.rerun is not None:
            from eagor.live.rerun import LiveLog

            watchers.append(LiveLog(checked_out(options.rerun, "--rerun"), f"{', '.join(queries)}: {source}"))
        loop = loop_of(options, watchers)
    except BaseException:
        for watcher in watchers:
            watcher.close()
        raise
    until = math.inf if options.seconds is None else time.monotonic() + options.seconds

    def answered(answer: Answer) -> None:
        told.add(answer)
        if time.monotonic() >= until and answer.query == queries[-1]:
            loop.stop()

    try:
        loop.run(answered)
    finally:
        told.close()
        for watcher in watchers:
            if watcher.problem is not None:
                terminal.warning(watcher.problem)
        counts = loop.counts
        terminal.log(
            f"{counts.frames} pictures, {counts.looks} looks, {counts.poses} poses, {counts.answers} answers"
            + (f"; {counts.skipped} pictures skipped" if counts.skipped else "")
            + (f", recorded in {options.record}" if options.record else "")
        )
    if not counts.looks:
        raise terminal.RunError(f"nothing was looked at: {told.last or 'no picture came'}")
    return terminal.INCOMPLETE if loop.recording_problem else terminal.OK


def asked(options: Live) -> tuple[str, list[str]]:
    """The source and the queries, after a check of all numbers. Raises `UsageError`, `QueryError`."""
    if len(options.words) < 2:
        raise terminal.UsageError(f"got {' '.join(options.words)!r}; wanted SOURCE, then one or more QUERY")
    source, *words = options.words
    queries = [checked_query(word) for word in words]
    if len({*queries}) < len(queries):
        raise terminal.UsageError("a query comes twice; name each thing once")
    _check(options)
    return source, queries


def loop_of(options: Live, watchers: Sequence[Watcher] = ()) -> LiveLoop:
    """The loop that the options ask for, with its camera open. Raises `UsageError`, and as `LiveLoop`."""
    source, queries = asked(options)
    spec = _perception(queries, options.perception)
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force)
    config = replace(config, floor_height=options.floor, drift=math.radians(options.drift))
    mask = None
    if options.mask is not None:
        from eagor.perception.partial import read_mask

        mask = read_mask(options.mask)
    rows = options.rows or max(LEAST_ROWS, 0 if is_model(spec) else rows_of(make_perception(spec)))
    opens = partial(open_camera, source, latency=options.latency, rows=rows, rig=options.rig)
    if source.startswith(ROS) and (options.domain is not None or options.interface is not None):
        from eagor.media.rigs import read_rig
        from eagor.robots.ros.sources import RosCamera

        topic = source.removeprefix(ROS)
        opens = partial(
            RosCamera,
            topic,
            domain=options.domain,
            interface=options.interface,
            latency=options.latency,
            rows=rows,
            rig=None if options.rig is None else read_rig(options.rig),
        )
    camera = opens()
    try:
        loop = LiveLoop(
            already_open(camera, opens) if camera.live else camera,
            spec,
            queries,
            poses=_poses(options, camera),
            config=config,
            rate=options.rate,
            patience=options.patience,
            record=options.record,
            pictures=options.pictures,
            fast=options.fast,
            mask=mask,
            watchers=watchers,
        )
    except BaseException:
        camera.close()
        raise
    terminal.log(
        f"{'live' if camera.live else 'recorded'}: {source}, seen by {spec}, {options.rate:g} answers a second"
    )
    return loop


def _check(options: Live) -> None:
    """Raise `UsageError` for numbers that make no sense, before anything is opened."""
    if not 0 < options.rate <= MOST_RATE:
        raise terminal.UsageError(f"--rate {options.rate:g}; wanted answers per second, up to {MOST_RATE:g}")
    if not 0 < options.patience < math.inf:
        raise terminal.UsageError(f"--patience {options.patience:g}; wanted seconds above 0")
    if options.seconds is not None and not 0 < options.seconds < math.inf:
        raise terminal.UsageError(f"--seconds {options.seconds:g}; wanted seconds above 0")
    if not 0 <= options.latency < math.inf:
        raise terminal.UsageError(f"--latency {options.latency:g}; wanted seconds, 0 or more")
    if not 0 <= options.drift <= MOST_DRIFT:
        raise terminal.UsageError(f"--drift {options.drift:g}; wanted degrees from 0 to {MOST_DRIFT}")
    if options.modes < 1:
        raise terminal.UsageError(f"--modes {options.modes}; wanted 1 or more")
    if options.rows is not None and options.rows < 8:
        raise terminal.UsageError(f"--rows {options.rows}; wanted 8 or more")
    if options.record is not None:
        checked_folder(options.record, "--record")
        if options.record.exists():
            raise terminal.UsageError(f"--record {options.record} is there already; name a new folder")


def _perception(queries: Sequence[str], given: str | None) -> str:
    """The one perception that answers all queries."""
    found = {perception_for(query, given) for query in queries}
    if len(found) > 1:
        raise terminal.UsageError(
            f"{' and '.join(sorted(found))} would each answer some of the queries; name one with --perception"
        )
    return found.pop()


def _poses(options: Live, camera: CameraSource) -> Any:
    """What `LiveLoop` takes for ``--poses``."""
    text = options.poses
    if isinstance(camera, BagCamera) and (text == "auto" or text.startswith(ROS)):
        topic = text.removeprefix(ROS) if text != "auto" else None
        return odometry_of(camera.bag, topic, camera) or text
    motion = getattr(camera, "motion", None)
    if text == "auto" and motion is not None:
        return MotionPoses(motion)
    if text in BY_SIGHT:
        return text
    if text == "still":
        return None
    if text.partition(":")[0] == GO2 or text.startswith(ROS):
        if not camera.live:
            raise terminal.UsageError(f"--poses {text} is live, and the pictures are a recording; wanted a CSV file")
        frame = getattr(camera, "frame", None)
        return partial(open_poses, text, domain=options.domain, interface=options.interface, camera=frame)
    if camera.live:
        raise terminal.UsageError(
            f"--poses {text}: a live camera needs live poses; wanted auto, level, still, ros:/TOPIC or go2"
        )
    found = read_poses(text)
    return GivenPoses([Pose(each.stamp, each.world_R_body, each.position) for each in found])


class _Told:
    """What is printed: lines of JSON, or a status line on a terminal; on stderr what goes wrong, once."""

    def __init__(self, options: Live, queries: Sequence[str]) -> None:
        self._json, self._modes, self._queries = options.json, options.modes, queries
        self._line = not options.json and sys.stdout.isatty()
        self._newest: dict[str, Answer] = {}
        self._shown = -math.inf
        self._news = FaultLog()
        self.last: str | None = None

    def add(self, answer: Answer) -> None:
        """One answer."""
        self._newest[answer.query] = answer
        if answer.query == self._queries[0]:
            self._say(answer)
        if self._json:
            terminal.emit(answer.as_json(self._modes))
        elif self._line and answer.query == self._queries[-1] and time.monotonic() - self._shown >= SHOWN:
            self._shown = time.monotonic()
            self._show(" | ".join(map(_in_line, self._newest.values())))

    def _say(self, answer: Answer) -> None:
        """What is wrong now and was not, and the other way round."""
        for text, wrong in self._news.of(answer.faults, answer.stamp):
            self._above(text)
            self.last = text if wrong else self.last

    def _above(self, text: str) -> None:
        if self._line:
            self._show("")
        terminal.log(text)

    def _show(self, text: str) -> None:
        wide = shutil.get_terminal_size().columns
        print(f"\r\x1b[K{terminal.plain(text)[: wide - 1]}", end="", flush=True)

    def close(self) -> None:
        """End the status line."""
        if self._line and self._newest:
            print(flush=True)


def _in_line(answer: Answer) -> str:
    """An answer for the status line: "red chair: 12 degrees to the left, within 5°, tracking"."""
    e = answer.estimate
    cone = "" if e.direction is None else f", within {math.degrees(e.credible_angle):.0f}°"
    return f"{answer.query}: {answer_in_words(e)}{cone}, {answer.status_words}"


def _replay(options: Live) -> int:
    """``eagor live replay DIR``."""
    from eagor.live.recording import Replay

    if len(options.words) != 2:
        raise terminal.UsageError("wanted the folder of one recording: eagor live replay DIR")
    if options.modes < 1:
        raise terminal.UsageError(f"--modes {options.modes}; wanted 1 or more")
    folder = Path(options.words[1])
    if options.perception is not None:
        check_looks(options.perception)
        make_perception(options.perception)
    replay = Replay(folder, options.perception, patience=options.patience)
    told = _Told(options, replay.settings.queries)
    try:
        for answer in replay:
            told.add(answer)
    finally:
        told.close()
    found = replay.compared
    if not found.answers:
        raise terminal.RunError(f"{folder} holds no answers: the run was ended before the first")
    if options.perception is not None:
        terminal.log(f"{found.answers} answers with the looks of {options.perception}")
        return terminal.OK
    terminal.log(found.as_text())
    if found.first is not None:
        played, recorded = found.first
        raise terminal.RunError(
            f"the answer at {recorded['stamp']} differs: {_short(played)} instead of {_short(recorded)}; was it "
            "recorded by another version, or on another machine?"
        )
    return terminal.OK


def _short(answer: dict[str, Any]) -> str:
    return f"{answer['query']} {answer['azimuth_deg']}/{answer['elevation_deg']} {answer['status']}"
