"""``eagor live``: answers from a live camera at a steady rate; ``eagor live replay``: a recorded run again.

With ``--json`` each answer is a line on stdout, otherwise the newest ones once a second. What goes wrong, and when it
works again, is said on stderr, and at the end the last answers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from eagor.cli import checks, terminal
from eagor.cli.answers import in_words
from eagor.cli.options import Axes, Flag, TrackingOptions, bare, refuse

if TYPE_CHECKING:
    from eagor.live.events import Answer, Event
    from eagor.live.loop import Sink


@dataclass(frozen=True, kw_only=True)
class Live(TrackingOptions):
    """Follow objects with a live camera: answers at a steady rate, however slow the detector is.

    A file or folder is played at its own speed. `eagor live replay DIR` plays a recording of --record again.
    """

    words: Annotated[tuple[str, ...], Positional, arg(metavar="SOURCE QUERY ...", help_behavior_hint="(required)")]
    """A camera (/dev/video0, rtsp://..., ros:/topic, -), video, folder or bag, then what to look for; or replay DIR"""
    poses: Annotated[str, arg(metavar="SOURCE")] = "auto"
    """How the camera turns and moves: as for track, or ros:/odom, a ROS 2 topic; go2 (go2:slow, go2:lidar), a robot."""
    axes: Axes = "auto"
    rate: Annotated[float, arg(metavar="HZ")] = 20.0
    """Answers per second."""
    patience: Annotated[float, arg(metavar="SECONDS")] = 60.0
    """Time that one look may take; then the detector is ended and started anew."""
    record: Annotated[Path | None, bare("DIR")] = None
    """Record everything into this new folder: a ROS 2 bag (MCAP)."""
    pictures: Literal["jpeg", "png", "none"] = "jpeg"
    """How --record keeps the pictures; png is exact, but slow."""
    fast: Flag = False
    """Look at every picture of a file or folder, as fast as the detector can; time is that of the recording."""
    seconds: Annotated[float | None, bare("SECONDS")] = None
    """Stop so long after the detector is loaded (default: when the source ends, or at Ctrl-C)."""
    latency: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Time from capture to arrival of the camera's pictures."""
    rows: Annotated[int | None, bare("N")] = None
    """Rows of the pictures at most (default: 960, or what the detector wants)."""
    domain: Annotated[int | None, bare("N")] = None
    """DDS domain of go2 (default: ROS_DOMAIN_ID, else 0)."""
    interface: Annotated[str | None, bare("NAME")] = None
    """Network interface of go2, such as eth0."""
    json: Flag = False
    """Print one JSON object per line: each answer."""


PRINTED = 1.0  # seconds between two lines


def live(options: Live) -> int:
    """Run the command; returns its exit code."""
    if options.words[:1] == ("replay",):
        return _replay(options)
    from eagor.live.loop import Loop
    from eagor.live.threads import already_open
    from eagor.sources.camera_sources import open_source
    from eagor.sources.odometry import poses_for

    if len(options.words) < 2:
        raise terminal.UsageError(f"got {' '.join(options.words)!r}; wanted SOURCE, then one or more QUERY")
    source, queries = options.words[0], checks.checked_queries(options.words[1:])
    checks.check_outputs(options)
    spec = checks.perception_for(queries, options.perception)
    config, mask = checks.tracker_config(spec, options), checks.mask_of(options.mask)
    rows = checks.rows_for(spec, options.rows)
    opens = partial(open_source, source, latency=options.latency, rows=rows, **checks.lens_of(options))
    if source.startswith("ros:"):  # its publishers may not be there yet
        terminal.log(f"waiting for pictures on {source}")
    camera, told, until = opens(), _Printer(options, queries), math.inf
    sinks: list[Sink] = [told]
    try:
        if options.rerun is not None:
            from eagor.live.rerun import RerunLog

            sinks.append(RerunLog(options.rerun, f"{', '.join(queries)}: {source}", realtime=True))
        dds = {"domain": options.domain, "interface": options.interface}
        poses = poses_for(options.poses, camera, axes=options.axes, **dds)
        loop = Loop(
            already_open(camera, opens) if camera.live else camera, poses, spec, queries, not options.fast,
            sinks, config=config, rate=options.rate, patience=options.patience, record=options.record,
            pictures=options.pictures, mask=mask,
        )  # fmt: skip
    except BaseException:
        for each in (camera, *sinks):
            each.close()
        raise
    terminal.log(
        f"{'live' if camera.live else 'recorded'}: {source}, seen by {spec}, {options.rate:g} answers a second"
    )

    def answered(answer: Answer) -> None:
        nonlocal until
        if until == math.inf and options.seconds is not None and loop.knows_classes is not None:  # it is loaded
            until = time.monotonic() + options.seconds
        if time.monotonic() >= until and answer.query == queries[-1]:
            loop.stop()

    try:
        loop.run(answered)
    finally:
        for sink in sinks:
            if problem := getattr(sink, "problem", None):
                terminal.warning(problem)
        counts = loop.counts
        terminal.log(
            f"{counts.frames} pictures, {counts.looks} looks, {counts.poses} poses, {counts.answers} answers"
            + (f"; {counts.skipped} pictures skipped" if counts.skipped else "")
            + (f", recorded in {options.record}" if options.record else "")
        )
    if not counts.looks:
        raise terminal.RunError(f"nothing was looked at: {told.last or 'no picture came'}")
    return terminal.INCOMPLETE if loop.recording_problem else terminal.OK


class _Printer:
    """A sink that prints: lines of JSON, or the newest answers; on stderr what goes wrong, once, and the last answers.

    `last`: what went wrong last.
    """

    def __init__(self, options: Live, queries: Sequence[str]) -> None:
        from eagor.live.events import FaultLog, NextLooks

        self._options, self._queries, self._looks, self._faults = options, queries, NextLooks(), FaultLog()
        self._newest: dict[str, Answer] = {}
        self._begun, self._shown = math.inf, -math.inf
        self._next: list[float] = []  # where to look next: azimuth and elevation, radians
        self.last: str | None = None

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop, and the answers to it."""
        self._looks.take(event, answers)
        for answer in answers:
            self.add(answer)

    def add(self, answer: Answer) -> None:
        """One answer."""
        from eagor.sphere import azimuth_elevation

        options, first = self._options, answer.query == self._queries[0]
        self._newest[answer.query] = answer
        if answer.image_age < math.inf:  # from the first picture on
            self._begun = min(self._begun, answer.stamp - answer.image_age)
        if first:
            for text, wrong in self._faults.of(answer.faults, answer.stamp):  # what is wrong and was not, or well again
                terminal.log(text)
                self.last = text if wrong else self.last
            toward = self._looks.of(answer)
            self._next = [] if toward is None else [*map(float, azimuth_elevation(toward))]
        if options.json:
            found = answer.as_dict(options.modes)
            if first and self._next:
                angles = (round(math.degrees(angle), 6) for angle in self._next)
                found["next_look"] = dict(zip(("azimuth_deg", "elevation_deg"), angles, strict=True))
            terminal.emit(found)
        elif answer.query == self._queries[-1]:
            self._say(answer.stamp)

    def _say(self, stamp: float) -> None:
        """The newest answers, unless they were told a moment ago."""
        from eagor.drawing.style import answer_in_words, in_words

        # Before the first look there is nothing to say: it may be that the detector does not know the words.
        looked = self._options.fast or any(math.isfinite(each.look_age) for each in self._newest.values())
        if stamp - self._shown < PRINTED or not looked or self._begun == math.inf:
            return
        self._shown, parts = stamp, list[str]()
        for query, answer in self._newest.items():
            e = answer.estimate
            cone = "" if e.direction is None else f", {e.certainty}"
            parts.append(f"{query}: {answer_in_words(e)}{cone}, {answer.status_words}")
        if self._next:
            parts.append(f"look next {in_words(*self._next)}")
        terminal.say(f"{stamp - self._begun:.2f} s  {' | '.join(parts)}")

    def close(self) -> None:
        """Say the last answers."""
        for query, answer in {} if self._options.json else self._newest.items():
            terminal.log(in_words(answer.estimate, query, answer.stamp - min(self._begun, answer.stamp)))


def _replay(options: Live) -> int:
    """``eagor live replay DIR``."""
    from eagor.live.recording import Replay

    if len(options.words) != 2:
        raise terminal.UsageError("wanted the folder of one recording: eagor live replay DIR")
    folder = options.words[1]
    again = f"eagor track {folder} QUERY --perception {options.perception}"
    refuse(options, ["perception"], f"{options.perception}: replay gives the answers of then; for another: {again}")
    replay, answers = Replay(Path(folder)), 0
    with closing(_Printer(options, replay.settings.queries)) as told:
        for answers, answer in enumerate(replay, 1):  # noqa: B007
            told.add(answer)
    if not answers:
        raise terminal.RunError(f"{folder} holds no answers: the run was ended before the first")
    return terminal.OK
