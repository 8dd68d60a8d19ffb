"""``eagor track``: a video or a sequence of pictures, one line per look.

A frame that cannot be read is reported on stderr; the poses carry the belief over it, and the exit code is 3. A first
frame of which nothing tells where it looks ends the run, because the others will hardly do better. ``--out`` is flushed
after every line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from eagor.cli import answers, checks, terminal
from eagor.cli.frames import FrameStream, Tally, open_stream
from eagor.cli.options import Flag, Footage, TrackingOptions, bare
from eagor.errors import ImageError, PoseError

if TYPE_CHECKING:
    from eagor.live.in_turn import Followed
    from eagor.live.loop import Sink
    from eagor.perception.replay import RecordedLooks


@dataclass(frozen=True, kw_only=True)
class Track(Footage, TrackingOptions):
    """Follow objects through a video or a sequence of pictures: panoramas, or of an ordinary camera."""

    words: Annotated[tuple[str, ...], Positional, arg(metavar="FRAMES QUERY ...", help_behavior_hint="(required)")]
    """A video, folder, images or ROS 2 bag, then what to look for. Or LOOKS.jsonl: without QUERY, all is listed."""
    out: Annotated[Path | None, bare("FILE")] = None
    """Write the answers, one line per frame, to FILE.csv or FILE.jsonl."""
    video: Annotated[Path | None, bare("FILE.mp4")] = None
    """Write a video with the answer drawn in: .mp4, .mkv, .webm, .gif or .webp; of several queries one for each."""
    fps: Annotated[float | None, bare("HZ")] = None
    """Frames per second of --video (default: 10). Between looks the belief moves with the camera."""
    page: Annotated[Path | None, bare("FILE.html")] = None
    """Write one self-contained web page: the frames with the answers, a time line, a table."""
    pictures: Annotated[Path | None, bare("DIR")] = None
    """Draw each frame with the belief into this folder."""
    compare: Flag = False
    """Run the baselines on the same evidence as well."""


FPS = 10.0  # frames per second of a video that is drawn
ANEW = "does not fit to the frames before it: the belief starts anew"


def track(options: Track) -> int:
    """Run the command; returns its exit code."""
    from eagor.live.in_turn import ByFrame
    from eagor.live.loop import Loop
    from eagor.sources.intrinsics import ShapeError

    words, queries = checks.frames_and_queries(options.words)
    places = checks.places_of(words, options.rig is not None)
    looks = answers.recorded(options, places)
    if not queries and looks is None:
        raise terminal.UsageError(
            f"got {' '.join(options.words)!r}; wanted FRAMES (a video, a folder or images), then QUERY"
        )
    spec = checks.perception_for(queries, options.perception) if looks is None else looks.about.perception
    checks.check_outputs(options, [*places, options.poses], out="table")
    config = checks.tracker_config(spec, options)
    if looks is None:
        perception = checks.make_perception(spec, busy=True)
        stream = open_stream(options, places, perception, None if options.video is None else options.fps or FPS)
    else:
        perception, stream = looks.replay, _of_looks(looks)
    if options.floor is not None:
        _check_floor(options.floor, stream)
    if not queries:
        assert looks is not None
        return answers.list_seen(options, looks, config)
    rivals = list[str]()
    if options.compare:
        from eagor.lab.agents.methods import NAMES

        rivals = [name for name in NAMES if name != "eagor"]
    tally, looked, several = Tally(), dict.fromkeys(queries, 0), len(queries) > 1
    entries: list[dict[str, Any]] = []
    last: dict[str, Followed] = {}
    with ExitStack() as stack:
        files = Files(options, queries, rivals, {"perception": spec, "poses": stream.told}, stream, stack)
        advance = stack.enter_context(terminal.progress("looking", stream.count, shown=not options.json))

        def each(result: Followed) -> None:
            first = result.query == queries[0]
            if first and not (tally.frames or options.json):
                print(answers.header(rivals, several), flush=True)
            if result.evidence and not any(looked.values()):
                checks.warn_of_detector(options.detector, result.evidence)
            if first:
                if result.lost:
                    terminal.warning(f"{result.frame} {ANEW}")
                tally.add(result.frame, result.problem, result.picture is not None)
            looked[result.query] += len(result.evidence)
            if result.told:
                last[result.query] = result
                if options.json:
                    entries.append(answers.entry_of(result, options.modes))
                else:
                    print(answers.line(result, stream.begins, several), flush=True)
            files.add(result)
            if result.query == queries[-1]:
                advance()

        sinks: list[Sink] = [ByFrame(each, partial(estimators, rivals, spec) if rivals else dict, terminal.log)]
        if options.rerun:
            from eagor.live.rerun import RerunLog

            sinks.append(RerunLog(options.rerun, f"{', '.join(queries)}: {options.rerun.name}"))
        loop = Loop(
            stream.source, stream.poses, perception, queries, sinks=sinks, config=config, looks=stream.looks,
            mask=checks.mask_of(options.mask),
        )  # fmt: skip
        try:
            for _ in loop:
                pass
        except (ImageError, PoseError) as error:  # nothing computed is lost
            if not tally.frames or isinstance(error, ShapeError):
                raise
            tally.broken = str(error)
    for sink in sinks:
        if problem := getattr(sink, "problem", None):
            terminal.warning(problem)
    code = tally.end([] if loop.frames is None else loop.frames.left_out)
    if options.json:
        what = {"queries": queries} if several else {"query": queries[0]}
        terminal.emit(what | {"perception": spec, "poses": stream.told, "frames": entries, "left_out": tally.bad})
    try:
        tally.check()
        for query in queries:
            checks.say_of_replay(perception, query, looked[query])
        if not any(looked.values()):
            given = [*stream.poses] if hasattr(stream.poses, "ends") else []
            stamps = f" ({given[0].stamp:g} to {given[-1].stamp:g} s)" if given else ""
            raise terminal.RunError(
                f"{spec} has no record for any of the {tally.frames} frames; its stamps must use the clock of the "
                f"frames{stamps}"
            )
        for query, found in {} if options.json else last.items():
            terminal.log(answers.in_words(found.estimate, query, found.stamp - stream.begins))
    finally:
        written = [str(path) for path in files.paths if path.exists()]
        if written and not options.json:
            terminal.log(f"written: {', '.join(written)}")
    return code


def estimators(names: Sequence[str], perception: str) -> dict[str, Any]:
    """These methods by name, with their settings for `perception`."""
    import numpy as np

    from eagor.lab.agents.methods import make_estimator

    return {name: make_estimator(name, np.random.default_rng(0), perception) for name in names}


def _of_looks(looks: RecordedLooks) -> FrameStream:
    """The stream that a file of looks holds: no pictures, and the poses as they were when it was made."""
    about, frames = looks.about, [each.frame for each in looks.posed]
    left = sum(bool(frame.problem) for frame in frames)
    more = f"; {left} more left out" if left else ""
    terminal.log(
        f"{terminal.many(looks.count - left, 'look')} of {about.perception} at {about.of}, {about.poses}{more}"
    )
    span = frames[-1].stamp - frames[0].stamp if frames else None
    return FrameStream(looks, None, about.poses, looks.count, None, None, span, about.begins)


def _check_floor(floor: float, stream: FrameStream) -> None:
    """Raise `UsageError` unless the poses have positions, all above the floor."""
    from eagor.sources.odometry import GivenPoses
    from eagor.sources.ros_messages import IMU
    from eagor.sources.ros_sources import BagPoses

    poses = [*stream.poses] if isinstance(stream.poses, GivenPoses) else []
    poses += [pose for each in getattr(stream.source, "posed", ()) for pose in each.poses]
    lowest = min((float(pose.position[2]) for pose in poses if pose.position is not None), default=math.inf)
    if math.isinf(lowest) and (not isinstance(stream.poses, BagPoses) or stream.poses.kind == IMU):
        wanted = "needs positions: a file of --poses with the columns x,y,z, or a bag's odometry"
        raise terminal.UsageError(f"--floor {floor:g} {wanted}")
    if lowest <= floor:
        comes = f"the camera comes down to z = {lowest:g} m; wanted a floor below that"
        raise terminal.UsageError(f"--floor {floor:g}: {comes}")


class Files:
    """What takes every result beside the lines: the table, pictures, videos, pages. `stack` closes them.

    `used`: what a page says of the settings. `paths` are all files, of which some may not be there.
    """

    def __init__(
        self, options: Track, queries: Sequence[str], rivals: Sequence[str], used: dict[str, str], stream: FrameStream,
        stack: ExitStack,
    ) -> None:  # fmt: skip
        from eagor.drawing import BeliefPage, BeliefVideo, Mosaic
        from eagor.live.recording import slug

        self._options, self._begins, self._numbers = options, stream.begins, count()
        self.paths = [path for path in (options.out, options.pictures, options.rerun) if path is not None]
        self._write = None if options.out is None else stack.enter_context(answers.table(options.out, rivals))
        self._mosaics = {query: Mosaic() for query in queries}
        used |= {"calibration": str(options.calibration)} if options.calibration else {}

        def each(path: Path | None, made: Callable[[Path, str], Any]) -> dict[str, Any]:
            """One for each query: of several, the file's name ends in what was looked for."""
            found: dict[str, Any] = {}
            if path is None:
                return found
            for query in queries:
                name = path.name if len(queries) == 1 else f"{path.stem}-{slug(query)}{path.suffix}"
                self.paths.append(path.with_name(name))
                found[query] = stack.enter_context(made(self.paths[-1], query))
            return found

        span = stream.span
        self._films = each(options.video, lambda path, query: BeliefVideo(path, rate=stream.shown, span=span))
        self._pages = each(options.page, lambda path, query: BeliefPage(path, query=query, used=used, span=span))

    def add(self, result: Followed) -> None:
        """A result; frames that were not looked at are only in the videos."""
        e, query = result.estimate, result.query
        shown = {"stamp": result.stamp - self._begins, "problem": result.problem, "grid": result.grid}
        if query in self._films and result.picture is not None:
            self._films[query].add(result.picture, e, query=query, **shown)
        if not result.told:
            return
        if self._write is not None:
            self._write(answers.entry_of(result, self._options.modes))
        if self._options.pictures is not None:  # numbered as the lines of the table
            path = self._options.pictures / f"{next(self._numbers):04d}.png"
            if result.picture is not None:
                answers.draw(result, path, self._options.modes, f" at {result.stamp:.2f} s", self._mosaics[query])
        if page := self._pages.get(query):
            if result.lost:
                page.notes.append(f"{result.frame} {ANEW}.")
            page.add(result.picture, e, name=result.frame, **shown)
