"""``eagor track``: a video or a sequence of panoramas, one line per look.

A frame that cannot be read is reported on stderr; the poses carry the belief over it, and the exit code is 3. A first
frame that is not 2:1 ends the run, because the others will hardly be. ``--out`` is flushed after every line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

from eagor.cli import terminal
from eagor.cli.columns import header, line
from eagor.cli.following import RIVALS, Result, follow, make_rivals
from eagor.cli.looking import (
    ShapeError,
    check_not_read,
    checked_folder,
    checked_out,
    checked_query,
    closing,
    keep_picture,
    make_perception,
    perception_for,
    say_of_video,
    tracker_config,
    warn_of_detector,
)
from eagor.cli.options import Track
from eagor.cli.poses import Pose, read_poses
from eagor.cli.shared_options import given
from eagor.cli.steps import LEAST_ROWS, Film, Source, Step, images, is_video, thinned, with_file, with_imu, with_sight
from eagor.cli.stitched import film_of
from eagor.cli.tables import table
from eagor.drawing.words import answer_in_words
from eagor.errors import ImageError, PoseError
from eagor.perception import Perception, rows_of

MOST_DRIFT = 90  # degrees
SEEN = {
    "auto": "orientations from the pictures themselves",
    "level": "headings from the pictures themselves, which are taken as level",
}
RATE, FPS = 2.0, 10.0  # looks and frames per second of a video


def track(options: Track) -> int:
    """Run the command; returns its exit code."""
    if len(options.words) < 2:
        raise terminal.UsageError(
            f"got {' '.join(options.words)!r}; wanted FRAMES (a video, a folder or images), then QUERY"
        )
    query = checked_query(options.words[-1])
    spec = perception_for(query, options.perception)
    places = [Path(word) for word in options.words[:-1]]
    check_not_read(options.out, "--out", [*places, Path(options.poses)])
    check_not_read(options.picture, "--pictures", places)
    check_not_read(options.video, "--video", places)
    check_not_read(options.page, "--page", places)
    check_not_read(options.rerun, "--rerun", places)
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force)
    if options.modes < 1:
        raise terminal.UsageError(f"--modes {options.modes}; wanted 1 or more")
    perception = make_perception(spec)
    journey = journey_of(options, places, perception)
    floor, drift = _checked_floor(options.floor, journey), _checked_drift(options.drift)
    config = replace(config, floor_height=floor, drift=drift)
    run = _Run(options, query, spec, perception, journey.begins)
    rivals = partial(make_rivals, spec) if options.compare else dict
    with ExitStack() as stack:
        keep = [stack.enter_context(sink) for sink in _sinks(options, query, spec, journey)]
        advance = stack.enter_context(terminal.progress("looking", journey.count, shown=not options.json))
        results = follow(journey.steps, perception, query, config, rivals, options.mask)
        for result in _until_it_breaks(results, run):
            run.add(result)
            for each in keep:
                each(result)
            advance()
    return run.close(journey)


@dataclass(frozen=True)
class Journey:
    """Where the frames and the poses come from: `told` says it in words; `poses` are those of a file, if any."""

    steps: Iterator[Step]
    count: int | None
    told: str
    poses: Sequence[Pose] = ()
    shown: float | None = None  # frames per second
    span: float | None = None  # seconds from the first frame to the last, if known
    begins: float = 0.0  # the stamp of the first frame, where stamps are those of another clock
    placed: bool = False  # whether positions come, though not as `poses`


def journey_of(options: Track, places: Sequence[Path], perception: Perception) -> Journey:
    """The stream that the options name; what a video tells of itself is said on stderr."""
    by_file = options.poses not in ("auto", "level")
    poses: tuple[Pose, ...] = read_poses(options.poses) if by_file else ()
    for name in ("rate", "fps"):
        if (value := getattr(options, name)) is not None and not (math.isfinite(value) and value > 0):
            raise terminal.UsageError(f"--{name} {value:g}; wanted a number per second above 0")
    from eagor.media.bags.reader import is_bag

    if len(places) == 1 and is_bag(places[0]):
        return _recorded(options, places[0], poses, perception)
    if given(options, ("image_topic", "odom_topic")):
        raise terminal.UsageError(f"--image-topic and --odom-topic are for a ROS 2 bag; {places[0]} is none")
    if is_video(places, options.rig):
        looks = options.rate or RATE
        shown = looks if options.video is None else max(looks, options.fps or FPS)
        rows = max(rows_of(perception), LEAST_ROWS)
        video = _video(options, places, shown, rows)
        say_of_video(places[0].name, video.facts, video.duration)
        source: Source = Film(video, options.force)
        motion, end = video.motion, options.end or video.duration
        span = None if end is None else end - options.start
    else:
        if given(options, wrong := ("start", "end", "fps")):
            raise terminal.UsageError(f"--{given(options, wrong)[0]} is for a video; these are images")
        if by_file and options.rate is not None:
            raise terminal.UsageError(f"--rate {options.rate:g}: {options.poses} tells when the images were taken")
        source, motion, looks = images(places, options.rate or 1.0, options.force, options.rig), None, None
        shown = None if by_file else options.rate or 1.0
        span = poses[-1].stamp - poses[0].stamp if poses else (source.count - 1) / (options.rate or 1.0)
    if by_file:
        steps, told = with_file(source, poses, Path(options.poses)), f"poses from {options.poses}"
    elif motion is not None and options.poses == "auto":
        steps, told = with_imu(source, motion), "orientations from the video's IMU"
    else:
        from eagor._extras import need

        need("the rotation from pictures", "photos", "cv2")
        steps, told = with_sight(source, options.poses == "level"), SEEN[options.poses]
    if looks is not None:
        terminal.log(f"{looks:g} looks per second (--rate), {told}")
    elif not by_file:
        many = "1 image" if source.count == 1 else f"{source.count} images"
        terminal.log(f"{many}, taken at {options.rate or 1.0:g} per second (--rate), {told}")
    return Journey(thinned(steps, looks), source.count, told, poses, shown, span)


def _video(options: Track, places: Sequence[Path], rate: float, rows: int) -> Any:
    """The video, stitched with ``--rig``."""
    if options.rig is not None:
        return film_of(places, options.rig, rate=rate, start=options.start, end=options.end, rows=rows)
    from eagor.media.video import Video

    return Video(places[0], rate=rate, start=options.start, end=options.end, rows=rows)


def _recorded(options: Track, place: Path, poses: Sequence[Pose], perception: Perception) -> Journey:
    """The stream of a ROS 2 bag."""
    from eagor.cli.bag_steps import BagFilm, odometry_of, with_odometry
    from eagor.media.bags.messages import IMU
    from eagor.media.bags.reader import Bag
    from eagor.robots.ros.sources import BagCamera

    bag = Bag(place)
    looks = options.rate or RATE
    shown = looks if options.video is None else max(looks, options.fps or FPS)
    rig = None
    if options.rig is not None:
        from eagor.media.rigs import read_rig

        rig = read_rig(options.rig)
    camera = BagCamera(bag, options.image_topic, rows=max(rows_of(perception), LEAST_ROWS), rig=rig)
    source = BagFilm(camera, shown, options.start, options.end, options.force)
    if poses and options.odom_topic:
        raise terminal.UsageError(f"--poses {options.poses} and --odom-topic: wanted one of them")
    odometry = None if poses or options.poses == "level" else odometry_of(bag, options.odom_topic, camera)
    if poses:
        steps, told = with_file(source, poses, Path(options.poses)), f"poses from {options.poses}"
    elif odometry is not None:
        steps, told = with_odometry(source, odometry), f"poses from {odometry.topic}"
    else:
        from eagor._extras import need

        need("the rotation from pictures", "photos", "cv2")
        steps, told = with_sight(source, options.poses == "level"), SEEN[options.poses]
    terminal.log(f"{camera.count} pictures of {camera.topic}; {looks:g} looks per second (--rate), {told}")
    terminal.log(f"the table's stamps are seconds from {camera.begins:.3f}; --out and --json have the full ones")
    return Journey(
        thinned(steps, looks, camera.begins),
        None,
        told,
        poses,
        shown,
        None,
        camera.begins,
        odometry is not None and odometry.kind != IMU,
    )


def _until_it_breaks(results: Iterator[Result], run: _Run) -> Iterator[Result]:
    """The results; where the frames end in an error after some, it is kept for the end: nothing computed is lost."""
    try:
        yield from results
    except (ImageError, PoseError) as error:
        if not run.frames or isinstance(error, ShapeError):
            raise
        run.broken = str(error)


class _Run:
    """What the command says and counts on the way."""

    def __init__(self, options: Track, query: str, spec: str, perception: Perception, begins: float) -> None:
        self.options, self.query, self.spec, self.perception = options, query, spec, perception
        self.begins = begins
        self.frames = self.bad = self.looked = 0
        self.entries: list[dict[str, Any]] = []
        self.broken: str | None = None

    def add(self, result: Result) -> None:
        """Print and count one result; frames that were not looked at are only drawn."""
        self.frames += 1
        if self.frames == 1 and not self.options.json:
            print(header(RIVALS if self.options.compare else ()), flush=True)
        if result.lost:
            terminal.warning(f"{result.frame} does not fit to the frames before it: the belief starts anew")
        if result.evidence and not self.looked:
            warn_of_detector(self.options.detector, result.evidence)
        if result.problem is not None:
            terminal.warning(f"{result.frame} is left out: {result.problem}")
            self.bad += 1
        self.looked += len(result.evidence)
        if not result.told:
            return
        if self.options.json:
            self.entries.append(result.as_json(self.options.modes))
        else:
            print(line(replace(result, stamp=result.stamp - self.begins)), flush=True)

    def close(self, journey: Journey) -> int:
        """Print the rest; returns the exit code."""
        if self.options.json:
            summary = {"query": self.query, "perception": self.spec, "poses": journey.told, "frames": self.entries}
            terminal.emit(summary | {"left_out": self.bad})
        if self.broken is not None:
            terminal.warning(f"the frames end early: {self.broken}")
        if self.frames == 0:
            raise terminal.RunError("there was no frame to look at")
        if self.bad == self.frames:
            raise terminal.RunError(f"none of the {self.bad} frames could be used; the reasons are above")
        if (said := closing(self.perception, self.query, self.looked)) is not None:
            terminal.log(said)
        if self.looked == 0:
            stamps = f" ({journey.poses[0].stamp:g} to {journey.poses[-1].stamp:g} s)" if journey.poses else ""
            raise terminal.RunError(
                f"{self.spec} has no record for any of the {self.frames} frames; its stamps must use the clock of the "
                f"frames{stamps}"
            )
        if self.bad:
            terminal.log(f"{self.bad} of {self.frames} frames were left out")
        return terminal.INCOMPLETE if self.bad or self.broken else terminal.OK


Sink = Callable[[Result], None]


def _sinks(options: Track, query: str, spec: str, journey: Journey) -> Iterator[AbstractContextManager[Sink]]:
    """What is written beside the lines: the table, pictures, a video, a page. Each takes every result."""
    if options.out:
        yield _listed(options.out, RIVALS if options.compare else (), options.modes)
    if options.picture:
        yield nullcontext(_painter(options.picture, query, options.modes))
    if options.video:
        yield _filmed(options.video, query, journey)
    if options.rerun:
        yield _logged(options.rerun, query)
    if options.page:
        used = {"perception": spec, "poses": journey.told}
        used |= {"calibration": str(options.calibration)} if options.calibration else {}
        yield _paged(options.page, query, used, journey)


@contextmanager
def _listed(path: Path, rivals: Sequence[str], modes: int) -> Iterator[Sink]:
    with table(path, rivals) as write:
        yield lambda result: write(result.as_json(modes)) if result.told else None


@contextmanager
def _filmed(path: Path, query: str, journey: Journey) -> Iterator[Sink]:
    from eagor.drawing.video import BeliefVideo

    with BeliefVideo(checked_out(path, "--video"), rate=journey.shown, span=journey.span) as video:

        def add(result: Result) -> None:
            if result.panorama is not None:
                video.add(
                    result.panorama,
                    result.estimate,
                    stamp=result.stamp - journey.begins,
                    query=query,
                    problem=result.problem,
                )

        yield add


@contextmanager
def _logged(path: Path, query: str) -> Iterator[Sink]:
    from eagor.drawing.rerun_log import RerunLog

    with RerunLog(checked_out(path, "--rerun"), f"{query}: {path.name}") as log:

        def add(result: Result) -> None:
            if result.panorama is not None or result.told:
                log.add(
                    result.panorama, result.estimate, stamp=result.stamp, query=query, position=result.position,
                    others=result.others, problem=result.problem,
                )  # fmt: skip

        yield add


@contextmanager
def _paged(path: Path, query: str, used: dict[str, str], journey: Journey) -> Iterator[Sink]:
    from eagor.drawing.page import BeliefPage

    with BeliefPage(checked_out(path, "--page"), query=query, used=used, span=journey.span) as page:

        def add(result: Result) -> None:
            if not result.told:
                return
            if result.lost:
                page.note(f"{result.frame} does not fit to the frames before it: the belief starts anew there.")
            at, problem = result.stamp - journey.begins, result.problem
            page.add(result.panorama, result.estimate, stamp=at, name=result.frame, problem=problem)

        yield add


def _checked_drift(drift: float) -> float:
    """``--drift`` in radians."""
    if not 0 <= drift <= MOST_DRIFT:
        raise terminal.UsageError(f"--drift {drift:g}; wanted degrees from 0 to {MOST_DRIFT}")
    return math.radians(drift)


def _checked_floor(floor: float | None, journey: Journey) -> float | None:
    """The floor's height, if every pose with a position is above it; else raises `UsageError`."""
    heights = [float(pose.position[2]) for pose in journey.poses if pose.position is not None]
    if floor is not None and not heights and not journey.placed:
        raise terminal.UsageError(
            f"--floor {floor:g} needs positions: a file of --poses with the columns x,y,z, or a bag's odometry"
        )
    if floor is not None and not math.isfinite(floor):
        raise terminal.UsageError(f"--floor {floor:g}; wanted a height in metres")
    if floor is not None and heights and min(heights) <= floor:
        raise terminal.UsageError(
            f"--floor {floor:g}: the camera comes down to z = {min(heights):g} m; wanted a floor below that"
        )
    return floor


def _painter(folder: Path, query: str, most: int) -> Callable[[Result], None]:
    """A function that draws a frame with its belief into `folder`; unreadable frames are skipped.

    Pictures are numbered as the lines of the table, and show at most `most` candidates.
    """
    from eagor.drawing import draw_belief

    checked_folder(folder, "--pictures")
    numbers = count()

    def draw(result: Result) -> None:
        if not result.told:
            return
        number = next(numbers)
        if result.panorama is None:
            return
        estimate = result.estimate
        title = f"“{query}” at {result.stamp:.2f} s: {answer_in_words(estimate)} ({estimate.status})"
        shown = {name: result.others[name] for name in ("centroid", "eagor_paper") if name in result.others}
        modes = [mode.direction for mode in estimate.modes[:most]]
        picture = draw_belief(result.panorama, estimate, modes=modes, others=shown, title=title)
        keep_picture(picture, folder / f"{number:04d}.png")

    return draw
