"""``eagor track``: a video or a sequence of pictures, one line per look.

A frame that cannot be read is reported on stderr; the poses carry the belief over it, and the exit code is 3. A first
frame of which nothing tells where it looks ends the run, because the others will hardly do better. ``--out`` is flushed
after every line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from eagor.cli import checks, terminal
from eagor.cli.answers import header, in_words, line, list_seen, methods_as_dict, recorded, table
from eagor.cli.footage import Journey, journey_of
from eagor.cli.options import Detector, Drift, Flag, Floor, Footage, Mask, Modes, Out, Rerun, Static, Whole, bare
from eagor.errors import ImageError, PoseError

if TYPE_CHECKING:
    from eagor.live.events import Answer, Event
    from eagor.live.in_turn import Followed, Method
    from eagor.live.loop import Loop, Sink
    from eagor.live.rerun import RerunLog
    from eagor.perception import Perception
    from eagor.perception.recordings import RecordedLooks


@dataclass(frozen=True, kw_only=True)
class Track(Footage):
    """Follow objects through a video or a sequence of pictures: panoramas, or of an ordinary camera."""

    runs: ClassVar[str] = "track"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="FRAMES QUERY ...", help_behavior_hint="(required)")]
    (
        "A video, a folder of pictures, several image files (sorted by name), or a ROS 2 bag; then what to look for, "
        "each thing in quotes. Or what eagor look wrote (LOOKS.jsonl); without QUERY, that lists what was seen."
    )
    video: Annotated[Path | None, bare("FILE.mp4")] = None
    """Write a video with the answer drawn in: .mp4, .mkv, .webm, .gif or .webp; of several queries one for each."""
    fps: Annotated[float | None, bare("HZ")] = None
    """Frames per second of --video (default: 10). Between looks the belief moves with the camera."""
    page: Annotated[Path | None, bare("FILE.html")] = None
    """Write one self-contained web page: the frames with the answers, a time line, a table."""
    perception: Annotated[str | None, bare("NAME")] = None
    """The detector: colour, coco, replay:FILE.jsonl, onnx:MODEL.onnx, my.py:FUNCTION, a model, or an installed one."""
    floor: Floor = None
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception and of forgetting, from `eagor calibrate`."""
    detector: Detector = None
    static: Static = False
    drift: Drift = None
    compare: Flag = False
    """Run the baselines on the same evidence as well."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    modes: Modes = 10
    picture: Annotated[Path | None, arg(name="pictures", metavar="DIR", help_behavior_hint="")] = None
    """Draw each frame with the belief into this folder."""
    rerun: Rerun = None
    out: Out = None
    mask: Mask = None


FPS = 10.0  # frames per second of a video that is drawn


def track(options: Track) -> int:
    """Run the command; returns its exit code."""
    from eagor.live.in_turn import ByFrame
    from eagor.live.loop import Loop
    from eagor.media.footage import ShapeError
    from eagor.perception.recordings import HiddenParts

    words, queries = checks.frames_and_queries(options.words)
    places = checks.places_of(words, options.rig is not None)
    looks = recorded(options, places)
    if not queries and looks is None:
        raise terminal.UsageError(
            f"got {' '.join(options.words)!r}; wanted FRAMES (a video, a folder or images), then QUERY"
        )
    spec = checks.perception_for(queries, options.perception) if looks is None else looks.about.perception
    checks.check_not_read(options.out, "--out", [*places, Path(options.poses)])
    outputs = {"pictures": options.picture, "video": options.video, "page": options.page, "rerun": options.rerun}
    for name, path in outputs.items():
        checks.check_not_read(path, f"--{name}", places)
    config = checks.tracker_config(
        options.degree, spec, options.calibration, options.detector, options.force, options.static
    )
    checks.checked_number(options.modes, "--modes")
    if looks is None:
        perception = checks.make_perception(spec, busy=True)
        checks.checked_number(options.fps, "--fps")
        journey = journey_of(options, places, perception, None if options.video is None else options.fps or FPS)
    else:
        perception, journey = looks.replay, _of_looks(looks)
    floor = _checked_floor(options.floor, journey)
    config = replace(config, floor_height=floor, drift=checks.checked_drift(options.drift))
    mask = checks.mask_of(options.mask)
    if not queries:
        assert looks is not None
        return list_seen(options, looks, config, HiddenParts([mask] if mask else []), options.modes)
    run = _Run(options, queries, spec, perception, journey)
    with ExitStack() as stack:
        keep = _outputs(options, queries, spec, journey, stack)
        advance = stack.enter_context(terminal.progress("looking", journey.count, shown=not options.json))

        def each(result: Followed) -> None:
            run.add(result)
            for output in keep:
                output(result)
            if result.query == queries[-1]:
                advance()

        log: RerunLog | None = None
        sinks: list[Sink] = [Notes(), ByFrame(each, partial(_rivals, spec) if options.compare else dict)]
        if options.rerun:
            from eagor.live.rerun import RerunLog

            title = f"{', '.join(queries)}: {options.rerun.name}"
            log = RerunLog(checks.checked_out(options.rerun, "--rerun"), title)
            sinks.append(log)
        loop = Loop(
            journey.source, journey.poses, perception, queries, sinks=sinks, config=config, looks=journey.looks,
            mask=mask,
        )  # fmt: skip
        try:
            for _ in loop:
                pass
        except (ImageError, PoseError) as error:  # nothing computed is lost
            if not run.frames or isinstance(error, ShapeError):
                raise
            run.broken = str(error)
        if log is not None and log.problem is not None:
            terminal.warning(log.problem)
    return run.close(loop)


class Notes:
    """A sink that says what the loop has to say of the footage, once each."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        from eagor.live.events import Trouble

        if isinstance(event, Trouble) and event.passing and event.text not in self._said:
            self._said.add(event.text)
            terminal.log(event.text)

    def close(self) -> None:
        """Nothing is held."""


def _rival_names() -> tuple[str, ...]:
    """The other methods, in the order of the columns."""
    from eagor.lab.agents.methods import NAMES

    return tuple(name for name in NAMES if name != "eagor")


def _rivals(perception: str) -> dict[str, Method]:
    """Every other method by name, with its settings for `perception`."""
    import numpy as np

    from eagor.lab.agents.methods import make_estimator

    return {name: make_estimator(name, np.random.default_rng(0), perception) for name in _rival_names()}


def _of_looks(looks: RecordedLooks) -> Journey:
    """The journey that a file of looks holds: no pictures, and the poses as they were when it was made."""
    about, frames = looks.about, [each.frame for each in looks.posed]
    left = sum(bool(frame.problem) for frame in frames)
    more = f"; {left} more left out" if left else ""
    terminal.log(
        f"{terminal.many(looks.count - left, 'look')} of {about.perception} at {about.of}, {about.poses}{more}"
    )
    span = frames[-1].stamp - frames[0].stamp if frames else None
    return Journey(looks, None, about.poses, looks.count, None, None, span, about.begins)


def _checked_floor(floor: float | None, journey: Journey) -> float | None:
    """The floor's height, if every pose with a position is above it; else raises `UsageError`."""
    from eagor.media.bag_sources import BagPoses
    from eagor.media.odometry import GivenPoses
    from eagor.media.ros_messages import IMU

    if floor is None:
        return None
    poses = [*journey.poses] if isinstance(journey.poses, GivenPoses) else []
    poses += [pose for each in getattr(journey.source, "posed", ()) for pose in each.poses]
    heights = [float(pose.position[2]) for pose in poses if pose.position is not None]
    placed = isinstance(journey.poses, BagPoses) and journey.poses.kind != IMU
    if not heights and not placed:
        raise terminal.UsageError(
            f"--floor {floor:g} needs positions: a file of --poses with the columns x,y,z, or a bag's odometry"
        )
    if not math.isfinite(floor):
        raise terminal.UsageError(f"--floor {floor:g}; wanted a height in metres")
    if heights and min(heights) <= floor:
        raise terminal.UsageError(
            f"--floor {floor:g}: the camera comes down to z = {min(heights):g} m; wanted a floor below that"
        )
    return floor


# --- what is said and written ---------------------------------------------------------------------------------------


def _entry(result: Followed, modes: int) -> dict[str, Any]:
    """A frame for ``--json`` and for files, with at most so many candidates."""
    entry = {"query": result.query, "frame": result.frame, **result.estimate.as_dict(modes), "stamp": result.stamp}
    entry["looks"] = len(result.evidence)
    if result.lost:
        entry["lost"] = True
    if result.problem is not None:
        entry["problem"] = result.problem
    if result.others:
        entry["methods"] = methods_as_dict(result.others)
    return entry


class _Run:
    """What the command says and counts on the way."""

    def __init__(
        self, options: Track, queries: Sequence[str], spec: str, perception: Perception, journey: Journey
    ) -> None:
        self.options, self.queries, self.spec, self.perception = options, queries, spec, perception
        self.journey = journey
        self.frames = self.bad = self.unread = 0
        self.looked = dict.fromkeys(queries, 0)
        self.entries: list[dict[str, Any]] = []
        self.broken: str | None = None
        self.last: dict[str, Followed] = {}

    def add(self, result: Followed) -> None:
        """Print and count one result; frames that were not looked at are only drawn."""
        first = result.query == self.queries[0]
        if not self.frames and first and not self.options.json:
            print(header(_rival_names() if self.options.compare else (), len(self.queries) > 1), flush=True)
        if result.evidence and not any(self.looked.values()):
            checks.warn_of_detector(self.options.detector, result.evidence)
        if first:
            self.frames += 1
            if result.lost:
                terminal.warning(f"{result.frame} does not fit to the frames before it: the belief starts anew")
            if result.problem is not None:
                terminal.warning(f"{result.frame} is left out: {result.problem}")
                self.bad += 1
                self.unread += result.picture is None
        self.looked[result.query] += len(result.evidence)
        if not result.told:
            return
        self.last[result.query] = result
        if self.options.json:
            self.entries.append(_entry(result, self.options.modes))
        else:
            print(line(result, self.journey.begins, len(self.queries) > 1), flush=True)

    def close(self, loop: Loop) -> int:
        """Print the rest; returns the exit code."""
        lost = [] if loop.frames is None else loop.frames.left_out
        for text in lost:
            terminal.warning(text)
        if self.options.json:
            what = {"query": self.queries[0]} if len(self.queries) == 1 else {"queries": list(self.queries)}
            summary = what | {"perception": self.spec, "poses": self.journey.told, "frames": self.entries}
            terminal.emit(summary | {"left_out": self.bad})
        if self.broken is not None:
            terminal.warning(f"the frames end early: {self.broken}")
        if self.frames == 0:
            raise terminal.RunError("there was no frame to look at")
        if self.bad == self.frames:
            self._say_written()
            raise checks.nothing_of(self.bad, self.unread)
        for query in self.queries:
            checks.say_of_replay(self.perception, query, self.looked[query])
        if not any(self.looked.values()):
            given = [*self.journey.poses] if hasattr(self.journey.poses, "ends") else []
            stamps = f" ({given[0].stamp:g} to {given[-1].stamp:g} s)" if given else ""
            raise terminal.RunError(
                f"{self.spec} has no record for any of the {self.frames} frames; its stamps must use the clock of the "
                f"frames{stamps}"
            )
        if self.bad:
            terminal.log(f"{self.bad} of {self.frames} frames were left out")
        for query, last in {} if self.options.json else self.last.items():
            terminal.log(in_words(last.estimate, query, last.stamp - self.journey.begins))
        self._say_written()
        return terminal.INCOMPLETE if self.bad or self.broken or lost else terminal.OK

    def _say_written(self) -> None:
        options = self.options
        one_each = [
            _of_query(path, each, self.queries) for path in (options.video, options.page) for each in self.queries
        ]
        files = (options.out, options.picture, options.rerun, *one_each)
        written = [str(each) for each in files if each is not None and each.exists()]
        if written and not options.json:
            terminal.log(f"written: {', '.join(written)}")


Output = Callable[["Followed"], object]


def _of_query(path: Path | None, query: str, queries: Sequence[str]) -> Path | None:
    """The file of one query: of several, its name ends in what was looked for."""
    from eagor.live.recording import slug

    if path is None or len(queries) == 1:
        return path
    return path.with_name(f"{path.stem}-{slug(query)}{path.suffix}")


def _outputs(options: Track, queries: Sequence[str], spec: str, journey: Journey, stack: ExitStack) -> list[Output]:
    """What takes every result beside the lines: the table, pictures, videos, a log, pages. `stack` closes them."""
    outputs: list[Output] = []
    if options.out:
        write = stack.enter_context(table(options.out, _rival_names() if options.compare else ()))
        outputs.append(lambda result: write(_entry(result, options.modes)) if result.told else None)
    if options.picture:
        outputs.append(_painter(options.picture, queries, options.modes))
    used = {"perception": spec, "poses": journey.told}
    used |= {"calibration": str(options.calibration)} if options.calibration else {}
    for query in queries:
        if video := _of_query(options.video, query, queries):
            from eagor.drawing.video import BeliefVideo

            film = BeliefVideo(checks.checked_out(video, "--video"), rate=journey.shown, span=journey.span)
            outputs.append(_filmed(stack.enter_context(film), query, journey.begins))
        if path := _of_query(options.page, query, queries):
            from eagor.drawing.page import BeliefPage

            page = BeliefPage(checks.checked_out(path, "--page"), query=query, used=used, span=journey.span)
            outputs.append(_paged(stack.enter_context(page), query, journey.begins))
    return outputs


def _filmed(video: Any, query: str, begins: float) -> Output:
    def add(result: Followed) -> None:
        if result.picture is not None and result.query == query:
            video.add(result.picture, result.estimate, query=query, **_shown(result, begins))

    return add


def _paged(page: Any, query: str, begins: float) -> Output:
    def add(result: Followed) -> None:
        if not result.told or result.query != query:
            return
        if result.lost:
            page.notes.append(f"{result.frame} does not fit to the frames before it: the belief starts anew there.")
        page.add(result.picture, result.estimate, name=result.frame, **_shown(result, begins))

    return add


def _shown(result: Followed, begins: float) -> dict[str, Any]:
    return {"stamp": result.stamp - begins, "problem": result.problem, "grid": result.grid}


def _painter(folder: Path, queries: Sequence[str], most: int) -> Output:
    """A function that draws a frame with its belief into `folder`; unreadable frames are skipped.

    Pictures are numbered as the lines of the table, and show at most `most` candidates.
    """
    from eagor.drawing import Mosaic, draw_belief
    from eagor.drawing.style import answer_in_words

    checks.checked_out(folder, "--pictures", folder=True)
    numbers, mosaics = count(), {query: Mosaic() for query in queries}

    def draw(result: Followed) -> None:
        if not result.told:
            return
        number = next(numbers)
        if result.picture is None:
            return
        estimate, query = result.estimate, result.query
        title = f"“{query}” at {result.stamp:.2f} s: {answer_in_words(estimate)} ({estimate.status})"
        shown = {name: result.others[name] for name in ("centroid", "eagor_paper") if name in result.others}
        modes = [mode.direction for mode in estimate.modes[:most]]
        drawn = draw_belief(
            result.picture, estimate, modes=modes, others=shown, title=title, grid=result.grid, mosaic=mosaics[query]
        )
        checks.keep_picture(drawn, folder / f"{number:04d}.png")

    return draw
