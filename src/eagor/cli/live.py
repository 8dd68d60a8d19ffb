"""``eagor live``: answers from a live camera at a steady rate; ``eagor live replay``: a recorded run again.

With ``--json`` each answer is a line on stdout. On a terminal the newest ones are shown in place, elsewhere once a
second. What goes wrong, and when it works again, is said on stderr, and at the end the last answers.
"""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg

from eagor.cli import terminal
from eagor.cli.checks import (
    checked_drift,
    checked_number,
    checked_out,
    checked_queries,
    checked_record,
    mask_of,
    ordinary,
    perception_for,
    rig_of,
    rows_for,
    tracker_config,
)
from eagor.cli.options import (
    Axes,
    CameraFile,
    Common,
    Detector,
    Drift,
    Eyes,
    Flag,
    Floor,
    Force,
    Hfov,
    Mask,
    Modes,
    Rerun,
    Static,
    Whole,
    bare,
)

if TYPE_CHECKING:
    from eagor.live.events import Answer, NextLooks
    from eagor.live.loop import Loop, Sink


@dataclass(frozen=True, kw_only=True)
class Live(Common):
    """Follow objects with a live camera: answers at a steady rate, however slow the detector is.

    A file or folder is played at its own speed. `eagor live replay DIR` plays a recording of --record again.
    """

    runs: ClassVar[str] = "live"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="SOURCE QUERY ...", help_behavior_hint="(required)")]
    (
        "A camera (/dev/video0, rtsp://HOST/PATH, http://..., udp://..., ros:/image_topic, - or pipe:rgb24:1920x960 "
        "for standard input), a video, a folder, or a ROS 2 bag (BAG?topic=/image); then what to look for, each in "
        "quotes. Or: replay DIR."
    )
    poses: Annotated[str, arg(metavar="SOURCE")] = "auto"
    (
        "How the camera turns and moves. auto: by a bag's odometry, a video's IMU, else the pictures (rotation only); "
        "level: the same for a camera that keeps its pictures level; still: it stands; ros:/odom: a ROS 2 topic, also "
        "of a bag; go2: the robot's odometry; CSV: a file, as for track, for a recorded source."
    )
    axes: Axes = "auto"
    rate: Annotated[float, arg(metavar="HZ")] = 20.0
    """Answers per second."""
    perception: Annotated[str | None, bare("NAME")] = None
    """The detector: colour, coco, onnx:MODEL.onnx, my.py:FUNCTION, a model, or an installed one."""
    patience: Annotated[float, arg(metavar="SECONDS")] = 60.0
    """Time that one look may take; then the detector is ended and started anew."""
    record: Annotated[Path | None, bare("DIR")] = None
    """Record everything into this new folder: a ROS 2 bag (MCAP)."""
    pictures: Literal["jpeg", "png", "none"] = "jpeg"
    """How --record keeps the pictures; png is exact, but slow."""
    rerun: Rerun = None
    fast: Flag = False
    """Look at every picture of a file or folder, as fast as the detector can; time is that of the recording."""
    seconds: Annotated[float | None, bare("SECONDS")] = None
    """Stop so long after the detector is loaded (default: when the source ends, or at Ctrl-C)."""
    latency: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Time from capture to arrival of the camera's pictures."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses, if the pictures are those of fisheye or ordinary lenses."""
    hfov: Hfov = None
    camera: CameraFile = None
    eyes: Eyes = None
    rows: Annotated[int | None, bare("N")] = None
    """Rows of the pictures at most (default: 960, or what the detector wants)."""
    domain: Annotated[int | None, bare("N")] = None
    """DDS domain of go2 (default: ROS_DOMAIN_ID, else 0)."""
    interface: Annotated[str | None, bare("NAME")] = None
    """Network interface of go2, such as eth0."""
    modes: Modes = 10
    floor: Floor = None
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    drift: Drift = None
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception and of forgetting, from `eagor calibrate`."""
    detector: Detector = None
    static: Static = False
    mask: Mask = None
    force: Force = False
    json: Flag = False
    """Print one JSON object per line: each answer."""


MOST_RATE = 1000.0  # answers per second
SHOWN = 0.1  # seconds between two status lines on a terminal,
PRINTED = 1.0  # ... and elsewhere, where each stays


def live(options: Live) -> int:
    """Run the command; returns its exit code."""
    if options.words[:1] == ("replay",):
        return _replay(options)
    from eagor.live.events import NextLooks

    source, queries = asked(options)
    looks = NextLooks()
    told, sinks = _Told(options, queries, looks), []
    try:
        if options.rerun is not None:
            from eagor.live.rerun import RerunLog

            title = f"{', '.join(queries)}: {source}"
            sinks.append(RerunLog(checked_out(options.rerun, "--rerun"), title, realtime=True))
        loop = loop_of(options, [*sinks, looks])
    except BaseException:
        for sink in sinks:
            sink.close()
        raise
    until = math.inf

    def answered(answer: Answer) -> None:
        nonlocal until
        if until == math.inf and options.seconds is not None and loop.knows_classes is not None:  # it is loaded
            until = time.monotonic() + options.seconds
        told.add(answer)
        if time.monotonic() >= until and answer.query == queries[-1]:
            loop.stop()

    try:
        loop.run(answered)
    finally:
        told.close()
        for sink in sinks:
            if sink.problem is not None:
                terminal.warning(sink.problem)
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
    queries = checked_queries(words)
    if not 0 < options.rate <= MOST_RATE:
        raise terminal.UsageError(f"--rate {options.rate:g}; wanted answers per second, up to {MOST_RATE:g}")
    checked_number(options.patience, "--patience")
    checked_number(options.seconds, "--seconds")
    checked_number(options.latency, "--latency")
    checked_drift(options.drift)
    checked_number(options.modes, "--modes")
    checked_number(options.rows, "--rows")
    checked_record(options.record)
    return source, queries


def loop_of(options: Live, sinks: Sequence[Sink] = ()) -> Loop:
    """The loop that the options ask for, with its camera open.

    Raises `UsageError`, and as `Loop`.
    """
    from eagor.evidence import BodyMask
    from eagor.live.loop import Loop
    from eagor.live.threads import already_open
    from eagor.media.camera_sources import open_source
    from eagor.media.odometry import poses_for

    source, queries = asked(options)
    spec = perception_for(queries, options.perception)
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force, options.static)
    config = replace(config, floor_height=options.floor, drift=checked_drift(options.drift))
    mask, rows = mask_of(options.mask), rows_for(spec, options.rows)
    told = ordinary(options.hfov, options.camera, options.rig, eyes=options.eyes)
    lenses = rig_of(options.rig)
    how: dict[str, Any] = {"latency": options.latency, "rows": rows, "rig": lenses, "camera": told}
    opens = partial(open_source, source, **how)
    if source.startswith("ros:"):  # its publishers may not be there yet
        terminal.log(f"waiting for pictures on {source}")
    camera = opens()
    if options.eyes is not None and mask is None and (unseen := getattr(camera, "unseen", None)) is not None:
        mask = BodyMask(~unseen)
    try:
        dds = {"domain": options.domain, "interface": options.interface}
        poses = poses_for(options.poses, camera, axes=options.axes, **dds)
        loop = Loop(
            already_open(camera, opens) if camera.live else camera, poses, spec, queries, not options.fast, sinks,
            config=config, rate=options.rate, patience=options.patience, record=options.record,
            pictures=options.pictures, mask=mask,
        )  # fmt: skip
    except BaseException:
        camera.close()
        raise
    terminal.log(
        f"{'live' if camera.live else 'recorded'}: {source}, seen by {spec}, {options.rate:g} answers a second"
    )
    return loop


class _Told:
    """What is printed: lines of JSON, or the newest answers; on stderr what goes wrong, once, and the last answers."""

    def __init__(self, options: Live, queries: Sequence[str], looks: NextLooks | None = None) -> None:
        from eagor.live.events import FaultLog

        self._json, self._modes, self._queries = options.json, options.modes, queries
        self._line, self._fast = not options.json and sys.stdout.isatty(), options.fast
        self._newest: dict[str, Answer] = {}
        self._begun, self._now, self._shown, self._rows = math.inf, -math.inf, -math.inf, 1
        self._news, self._looks = FaultLog(), looks
        self._next: tuple[float, float] | None = None  # where to look next: azimuth and elevation, radians
        self.last: str | None = None

    def add(self, answer: Answer) -> None:
        """One answer."""
        self._newest[answer.query], self._now = answer, answer.stamp
        if answer.image_age < math.inf:  # from the first picture on
            self._begun = min(self._begun, answer.stamp - answer.image_age)
        first = answer.query == self._queries[0]
        if first:
            self._say(answer)
            self._next = self._advice(answer)
        if self._json:
            more = {}
            if first and self._next is not None:
                azimuth, elevation = (round(math.degrees(angle), 6) for angle in self._next)
                more = {"next_look": {"azimuth_deg": azimuth, "elevation_deg": elevation}}
            terminal.emit(answer.as_dict(self._modes) | more)
        elif answer.query == self._queries[-1]:
            now, apart = (time.monotonic(), SHOWN) if self._line else (answer.stamp, PRINTED)
            # Before the first look there is nothing to say: it may be that the detector does not know the words.
            looked = self._fast or any(math.isfinite(each.look_age) for each in self._newest.values())
            if now - self._shown >= apart and (self._line or (looked and self._begun < math.inf)):
                self._shown = now
                text = " | ".join([*map(_in_line, self._newest.values()), *self._hints()])
                if self._line:
                    self._show(text)
                else:
                    terminal.say(f"{answer.stamp - self._begun:.2f} s  {text}")

    def _advice(self, answer: Answer) -> tuple[float, float] | None:
        """Where the camera should look next, if anything tells it."""
        from eagor.sphere import azimuth_elevation

        toward = None if self._looks is None else self._looks.of(answer)
        if toward is None:
            return None
        azimuth, elevation = azimuth_elevation(toward)
        return float(azimuth), float(elevation)

    def _hints(self) -> Iterator[str]:
        """Where to look next."""
        from eagor.drawing.style import in_words

        if self._next is not None:
            yield f"look next {in_words(*self._next)}"

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
        """Write over what was shown last, however many rows of the terminal it took."""
        up = f"\x1b[{self._rows - 1}A" if self._rows > 1 else ""
        print(f"\r{up}\x1b[J{terminal.plain(text)}", end="", flush=True)
        self._rows = max(1, math.ceil(len(text) / shutil.get_terminal_size().columns))

    def close(self) -> None:
        """End the status line, and say the last answers."""
        from eagor.cli.answers import in_words

        if self._line and self._newest:
            print(flush=True)
        for query, answer in {} if self._json else self._newest.items():
            terminal.log(in_words(answer.estimate, query, answer.stamp - min(self._begun, answer.stamp)))


def _in_line(answer: Answer) -> str:
    """An answer for the status line: "red chair: 12 degrees to the left, 90 % within 5°, tracking"."""
    from eagor.drawing.style import answer_in_words

    e = answer.estimate
    cone = "" if e.direction is None else f", {e.certainty}"
    return f"{answer.query}: {answer_in_words(e)}{cone}, {answer.status_words}"


def _replay(options: Live) -> int:
    """``eagor live replay DIR``."""
    from eagor.live.recording import Replay

    if len(options.words) != 2:
        raise terminal.UsageError("wanted the folder of one recording: eagor live replay DIR")
    checked_number(options.modes, "--modes")
    folder = Path(options.words[1])
    if options.perception is not None:
        raise terminal.UsageError(
            f"replay gives the answers of then; for another detector: eagor track {folder} QUERY "
            f"--perception {options.perception}"
        )
    replay = Replay(folder)
    told, answers = _Told(options, replay.settings.queries), 0
    try:
        for answers, answer in enumerate(replay, 1):  # noqa: B007
            told.add(answer)
    finally:
        told.close()
    if not answers:
        raise terminal.RunError(f"{folder} holds no answers: the run was ended before the first")
    return terminal.OK
