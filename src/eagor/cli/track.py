"""``eagor track``: a video or a sequence of pictures, one line per look.

A frame that cannot be read is reported on stderr; the poses carry the belief over it, and the exit code is 3. A first
frame of which nothing tells where it looks ends the run, because the others will hardly do better. ``--out`` is flushed
after every line.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from eagor.cli import checks, terminal
from eagor.cli.answers import header, in_words, line, list_seen, methods_as_dict, recorded, table
from eagor.cli.options import Detector, Drift, Flag, Floor, Footage, Mask, Modes, Out, Rerun, Static, Whole, bare, given
from eagor.errors import ImageError, PoseError

if TYPE_CHECKING:
    from eagor.media.footage import FrameCheck, Frames
    from eagor.media.posed_frames import PosedFrame
    from eagor.media.rigs import Rig
    from eagor.odometry.files import FramePose
    from eagor.perception import Perception
    from eagor.perception.footage import FollowedFrame, Method
    from eagor.perception.replay import ReplayPerception


@dataclass(frozen=True, kw_only=True)
class Track(Footage):
    """Follow an object through a video or a sequence of pictures: panoramas, or of an ordinary camera."""

    runs: ClassVar[str] = "track"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="FRAMES QUERY", help_behavior_hint="(required)")]
    (
        "A video, a folder of pictures, several image files (sorted by name), or a ROS 2 bag; then what to look for. "
        "Or what eagor look wrote (LOOKS.jsonl); without QUERY, that lists what was seen."
    )
    video: Annotated[Path | None, bare("FILE.mp4")] = None
    """Write a video with the answer drawn in: .mp4, .mkv, .webm, .gif or .webp."""
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


SEEN = {
    "auto": "orientations from the pictures themselves",
    "level": "headings from the pictures themselves, which are taken as level",
}
RATE, FPS = 2.0, 10.0  # looks and frames per second of a video
BY_SIGHT = 10.0  # frames per second from which an ordinary camera's turn is found: neighbours have to overlap


def track(options: Track) -> int:
    """Run the command; returns its exit code."""
    from eagor.media.posed_frames import ahead
    from eagor.perception.footage import HiddenParts, about, follow

    words, query = checks.frames_and_query(options.words)
    places, alone = checks.places_of(words, options.rig is not None), not query
    replay = recorded(options, places)
    if alone and replay is None:
        raise terminal.UsageError(
            f"got {' '.join(options.words)!r}; wanted FRAMES (a video, a folder or images), then QUERY"
        )
    spec = checks.perception_for(query, options.perception) if replay is None else about(replay).perception
    checks.check_not_read(options.out, "--out", [*places, Path(options.poses)])
    outputs = {"pictures": options.picture, "video": options.video, "page": options.page, "rerun": options.rerun}
    for name, path in outputs.items():
        checks.check_not_read(path, f"--{name}", places)
    config = checks.tracker_config(
        options.degree, spec, options.calibration, options.detector, options.force, options.static
    )
    checks.checked_modes(options.modes)
    if replay is None:
        perception = checks.make_perception(spec, busy=True)
        checks.checked_rate(options.fps, "--fps")
        shown = None if options.video is None else options.fps or FPS
        journey = journey_of(options, places, perception, shown)
    else:
        perception, journey = replay, _of_looks(replay)
    floor = _checked_floor(options.floor, journey)
    config = replace(config, floor_height=floor, drift=checks.checked_drift(options.drift))
    hidden = HiddenParts(checks.mask_of(options.mask), terminal.log)
    if alone:
        assert replay is not None
        return list_seen(options, replay, config, hidden, options.modes)
    run = _Run(options, query, spec, perception, journey.begins)
    rivals = partial(_rivals, spec) if options.compare else dict
    with ExitStack() as stack:
        keep = _sinks(options, query, spec, journey, stack)
        advance = stack.enter_context(terminal.progress("looking", journey.count, shown=not options.json))
        results = follow(ahead(journey.frames), perception, query, config, rivals, hidden)
        for result in _until_it_breaks(results, run):
            run.add(result)
            for each in keep:
                each(result)
            advance()
    return run.close(journey)


def _rival_names() -> tuple[str, ...]:
    """The other methods, in the order of the columns."""
    from eagor.lab.agents.methods import NAMES

    return tuple(name for name in NAMES if name != "eagor")


def _rivals(perception: str) -> dict[str, Method]:
    """Every other method by name, with its settings for `perception`."""
    import numpy as np

    from eagor.lab.agents.methods import make_estimator

    return {name: make_estimator(name, np.random.default_rng(0), perception) for name in _rival_names()}


# --- where frames and poses come from -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Journey:
    """Where the frames and the poses come from: `told` says it in words; `poses` are those of a file, if any."""

    frames: Iterator[PosedFrame]
    count: int | None
    told: str
    poses: Sequence[FramePose] = ()
    shown: float | None = None  # frames per second
    span: float | None = None  # seconds from the first frame to the last, if known
    begins: float = 0.0  # the stamp of the first frame, where stamps are those of another clock
    placed: bool = False  # whether positions come, though not as `poses`
    left_out: Callable[[], list[str]] = list  # what of a bag could not be used, in words; once the frames have come

    def say_left_out(self) -> bool:
        """Warn of what of a bag could not be used, once the frames have come; whether there is any."""
        lost = self.left_out()
        for text in lost:
            terminal.warning(text)
        return bool(lost)


def journey_of(options: Footage, places: Sequence[Path], perception: Perception, shown: float | None = None) -> Journey:
    """The stream that the options name; what a video tells of itself is said on stderr.

    `shown`: frames per second of a video to be drawn, which shows more than what is looked at.
    """
    from eagor.media.bags import is_bag
    from eagor.media.footage import LEAST_ROWS, is_video
    from eagor.odometry.files import read_poses
    from eagor.perception import rows_of
    from eagor.perception.replay import takes_pictures

    if options.poses not in SEEN and not os.path.exists(options.poses):
        raise terminal.UsageError(f"there is no file {options.poses}; --poses takes {', '.join(SEEN)} or a CSV file")
    poses = () if options.poses in SEEN else read_poses(options.poses)
    checks.checked_rate(options.rate, "--rate")
    rows, looks = max(rows_of(perception), LEAST_ROWS), options.rate or RATE
    rates = looks, max(looks, shown or 0)
    if len(places) == 1 and is_bag(places[0]):
        return _of_bag(options, places[0], poses, rows, *rates, not takes_pictures(perception))
    if given(options, ("image_topic", "odom_topic", "camera_info")):
        topics = "--image-topic, --odom-topic and --camera-info"
        raise terminal.UsageError(f"{topics} are for a ROS 2 bag; {places[0]} is none")
    rig, stitched = checks.rig_of(options.rig), not takes_pictures(perception)
    if is_video(places, rig is not None):
        return _of_video(options, places, poses, rows, rig, stitched, *rates)
    return _of_images(options, places, poses, rig, stitched)


def _of_looks(replay: ReplayPerception) -> Journey:
    """The journey that a file of looks holds: no pictures, and the poses as they were when it was made."""
    from eagor.perception.footage import about, recorded_frames

    frames, footage = recorded_frames(replay), about(replay)
    named = [each for each in frames if each.frame is not None]
    looks = sum(each.read is None for each in named)  # the others could not be read, and were left out
    span = frames[-1].pose.stamp - frames[0].pose.stamp
    poses = [each.pose for each in frames]
    left = f"; {len(named) - looks} more left out" if looks < len(named) else ""
    terminal.log(f"{terminal.many(looks, 'look')} of {footage.perception} at {footage.of}, {footage.poses}{left}")
    return Journey(iter(frames), len(named), footage.poses, poses, None, span, footage.begins)


def _of_video(
    options: Footage, places: Sequence[Path], poses: Sequence[FramePose], rows: int, rig: Rig | None, stitched: bool,
    looks: float, shown: float,
) -> Journey:  # fmt: skip
    from eagor.media.footage import VideoFrames
    from eagor.media.posed_frames import thinned
    from eagor.media.rig_videos import LensVideos, open_video

    opened = partial(open_video, places, rig, stitched=stitched, start=options.start, end=options.end, rows=rows)
    video, check = opened(rate=shown), _check(options)
    lenses = len(video.grids) if isinstance(video, LensVideos) else 0
    sighted = not poses and (options.poses == "level" or video.motion is None)
    ordinary_lens = lenses > 0 or (rig is None and check.takes_as_ordinary(*video.shape))
    if sighted and shown < BY_SIGHT and ordinary_lens:
        shown = BY_SIGHT
        video = opened(rate=shown)
    checks.say_of_video(places[0].name, video.facts, video.duration)
    source = VideoFrames(video, check)
    poses = _in_our_axes(options, source, poses)
    frames, told = _posed(options, source, poses, video.motion)
    terminal.log(f"{checks.looks_in_words(looks, video.frame_rate)}, {told}")
    end = options.end or video.duration
    span = None if end is None else end - options.start
    return Journey(thinned(frames, looks, lenses=max(1, lenses)), source.count, told, poses, shown, span)


def _of_images(
    options: Footage, places: Sequence[Path], poses: Sequence[FramePose], rig: Rig | None, stitched: bool
) -> Journey:
    from eagor.media.footage import images

    if wrong := given(options, ("start", "end", "fps")):
        raise terminal.UsageError(f"--{wrong[0]} is for a video; these are images")
    if poses and options.rate is not None:
        raise terminal.UsageError(f"--rate {options.rate:g}: {options.poses} tells when the images were taken")
    rate = options.rate or 1.0
    source = images(places, rate, _check(options), rig, stitched)
    poses = _in_our_axes(options, source, poses)
    frames, told = _posed(options, source, poses)
    if poses:
        return Journey(frames, source.count, told, poses, None, poses[-1].stamp - poses[0].stamp)
    terminal.log(f"{terminal.many(source.count, 'image')}, taken at {rate:g} per second (--rate), {told}")
    return Journey(frames, source.count, told, poses, rate, (len(source.paths) - 1) / rate)


def _of_bag(
    options: Footage, place: Path, poses: Sequence[FramePose], rows: int, looks: float, shown: float, stitched: bool
) -> Journey:
    from eagor.media.bag_sources import BagCamera, bag_odometry
    from eagor.media.bags import Bag
    from eagor.media.footage import BagFrames, FrameCheck
    from eagor.media.intrinsics import in_words
    from eagor.media.posed_frames import posed_by_odometry, thinned
    from eagor.media.ros_messages import IMU

    lens = checks.ordinary(options.hfov, options.camera, options.rig, options.camera_info)
    bag, rig = Bag(place), checks.rig_of(options.rig)
    one = None if options.eyes is None else replace(lens, eyes="mono")  # the source takes one of them
    camera = BagCamera(
        bag, options.image_topic, rows=rows, rig=rig, camera=lens, info=options.camera_info, stitched=stitched
    )
    if camera.lens is not None:
        terminal.log(f"{camera.topic}: {in_words(camera.lens.name, camera.views[0])}")
    if poses and options.odom_topic:
        raise terminal.UsageError(f"--poses {options.poses} and --odom-topic: wanted one of them")
    odometry = None if poses or options.poses == "level" else bag_odometry(bag, options.odom_topic, camera.frame)
    if camera.views[0] is not None and not poses and odometry is None:
        shown = max(shown, BY_SIGHT)
    source = BagFrames(camera, shown, options.start, options.end, FrameCheck(options.force, terminal.log, camera=one))
    poses = _in_our_axes(options, source, poses)
    lost: list[str] = []
    if odometry is not None:
        frames = posed_by_odometry(source, odometry, terminal.log, lost.append)
        told = f"poses from {odometry.topic}"
    else:
        frames, told = _posed(options, source, poses)
    terminal.log(f"{camera.count} pictures of {camera.topic}; {looks:g} looks per second (--rate), {told}")
    terminal.log(f"the table's stamps are seconds from {camera.begins:.3f}; --out and --json have the full ones")
    placed = odometry is not None and odometry.kind != IMU

    def left_out() -> list[str]:
        back = {f"pictures of {camera.topic}": camera.back}
        if odometry is not None:
            back[f"poses of {odometry.topic}"] = odometry.reader.back
        return lost + [f"{many} {what} whose stamps go back are left out" for what, many in back.items() if many]

    frames = thinned(frames, looks, camera.begins, len(camera.views))
    return Journey(frames, None, told, poses, shown, None, camera.begins, placed, left_out)


def _check(options: Footage) -> FrameCheck:
    """What is asked of each frame: a whole panorama, or a lens that the options or its file tell."""
    from eagor.media.footage import FrameCheck

    return FrameCheck(
        options.force, terminal.log, checks.ordinary(options.hfov, options.camera, options.rig, eyes=options.eyes)
    )


def _in_our_axes(options: Footage, source: Frames, poses: Sequence[FramePose]) -> Sequence[FramePose]:
    """The poses of a file as a camera with our axes has them."""
    from eagor.media.posed_frames import posed_by_file
    from eagor.odometry.axes import settled
    from eagor.odometry.files import Poses

    if not isinstance(poses, Poses):
        if options.axes != "auto":
            raise terminal.UsageError(f"--axes {options.axes} is for a file of poses; give one with --poses")
        return poses
    name = Path(options.poses)
    return settled(
        poses, options.axes, options.poses, lambda: ((at.pose, at.read) for at in posed_by_file(source, poses, name)),
        terminal.log,
    )  # fmt: skip


def _posed(
    options: Footage, source: Frames, poses: Sequence[FramePose], motion: Any = None
) -> tuple[Iterator[PosedFrame], str]:
    """The frames with the poses of a file, those of an IMU, or those that the pictures tell; and which, in words."""
    from eagor._extras import need
    from eagor.media.posed_frames import posed_by_file, posed_by_imu, posed_by_sight

    if poses:
        return posed_by_file(source, poses, Path(options.poses)), f"poses from {options.poses}"
    if motion is not None and options.poses == "auto":
        return posed_by_imu(source, motion), "orientations from the video's IMU"
    need("the rotation from pictures", "photos", "cv2")
    return posed_by_sight(source, options.poses == "level"), SEEN[options.poses]


def _checked_floor(floor: float | None, journey: Journey) -> float | None:
    """The floor's height, if every pose with a position is above it; else raises `UsageError`."""
    if floor is None:
        return None
    heights = [float(pose.position[2]) for pose in journey.poses if pose.position is not None]
    if not heights and not journey.placed:
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


def _until_it_breaks(results: Iterator[FollowedFrame], run: _Run) -> Iterator[FollowedFrame]:
    """The results; where the frames end in an error after some, it is kept for the end: nothing computed is lost."""
    from eagor.media.footage import ShapeError

    try:
        yield from results
    except (ImageError, PoseError) as error:
        if not run.frames or isinstance(error, ShapeError):
            raise
        run.broken = str(error)


def _entry(result: FollowedFrame, query: str, modes: int) -> dict[str, Any]:
    """A frame for ``--json`` and for files, with at most so many candidates."""
    entry = {"query": query, "frame": result.frame, **result.estimate.as_dict(modes), "stamp": result.stamp}
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

    def __init__(self, options: Track, query: str, spec: str, perception: Perception, begins: float) -> None:
        self.options, self.query, self.spec, self.perception = options, query, spec, perception
        self.begins = begins
        self.frames = self.bad = self.unread = self.looked = 0
        self.entries: list[dict[str, Any]] = []
        self.broken: str | None = None
        self.last: FollowedFrame | None = None

    def add(self, result: FollowedFrame) -> None:
        """Print and count one result; frames that were not looked at are only drawn."""
        self.frames += 1
        if self.frames == 1 and not self.options.json:
            print(header(_rival_names() if self.options.compare else ()), flush=True)
        if result.lost:
            terminal.warning(f"{result.frame} does not fit to the frames before it: the belief starts anew")
        if result.evidence and not self.looked:
            checks.warn_of_detector(self.options.detector, result.evidence)
        if result.problem is not None:
            terminal.warning(f"{result.frame} is left out: {result.problem}")
            self.bad += 1
            self.unread += result.picture is None
        self.looked += len(result.evidence)
        if not result.told:
            return
        self.last = result
        if self.options.json:
            self.entries.append(_entry(result, self.query, self.options.modes))
        else:
            print(line(result, self.begins), flush=True)

    def close(self, journey: Journey) -> int:
        """Print the rest; returns the exit code."""
        lost = journey.say_left_out()
        if self.options.json:
            summary = {"query": self.query, "perception": self.spec, "poses": journey.told, "frames": self.entries}
            terminal.emit(summary | {"left_out": self.bad})
        if self.broken is not None:
            terminal.warning(f"the frames end early: {self.broken}")
        if self.frames == 0:
            raise terminal.RunError("there was no frame to look at")
        if self.bad == self.frames:
            self._say_written()
            raise checks.nothing_of(self.bad, self.unread)
        checks.say_of_replay(self.perception, self.query, self.looked)
        if self.looked == 0:
            stamps = f" ({journey.poses[0].stamp:g} to {journey.poses[-1].stamp:g} s)" if journey.poses else ""
            raise terminal.RunError(
                f"{self.spec} has no record for any of the {self.frames} frames; its stamps must use the clock of the "
                f"frames{stamps}"
            )
        if self.bad:
            terminal.log(f"{self.bad} of {self.frames} frames were left out")
        if not self.options.json and self.last is not None:
            terminal.log(in_words(self.last.estimate, self.query, self.last.stamp - self.begins))
        self._say_written()
        return terminal.INCOMPLETE if self.bad or self.broken or lost else terminal.OK

    def _say_written(self) -> None:
        options = self.options
        files = (options.out, options.picture, options.video, options.rerun, options.page)
        written = [str(each) for each in files if each is not None and each.exists()]
        if written and not options.json:
            terminal.log(f"written: {', '.join(written)}")


Sink = Callable[["FollowedFrame"], object]


def _sinks(options: Track, query: str, spec: str, journey: Journey, stack: ExitStack) -> list[Sink]:
    """What takes every result beside the lines: the table, pictures, a video, a log, a page. `stack` closes them."""
    sinks: list[Sink] = []
    if options.out:
        write = stack.enter_context(table(options.out, _rival_names() if options.compare else ()))
        sinks.append(lambda result: write(_entry(result, query, options.modes)) if result.told else None)
    if options.picture:
        sinks.append(_painter(options.picture, query, options.modes))
    if options.video:
        from eagor.drawing.video import BeliefVideo

        video = BeliefVideo(checks.checked_out(options.video, "--video"), rate=journey.shown, span=journey.span)
        sinks.append(_filmed(stack.enter_context(video), query, journey.begins))
    if options.rerun:
        from eagor.drawing.rerun_log import RerunLog

        log = RerunLog(checks.checked_out(options.rerun, "--rerun"), f"{query}: {options.rerun.name}")
        sinks.append(_logged(stack.enter_context(log), query))
    if options.page:
        from eagor.drawing.page import BeliefPage

        used = {"perception": spec, "poses": journey.told}
        used |= {"calibration": str(options.calibration)} if options.calibration else {}
        page = BeliefPage(checks.checked_out(options.page, "--page"), query=query, used=used, span=journey.span)
        sinks.append(_paged(stack.enter_context(page), journey.begins))
    return sinks


def _filmed(video: Any, query: str, begins: float) -> Sink:
    def add(result: FollowedFrame) -> None:
        if result.picture is not None:
            video.add(
                result.picture, result.estimate, stamp=result.stamp - begins, query=query, problem=result.problem,
                grid=result.grid,
            )  # fmt: skip

    return add


def _logged(log: Any, query: str) -> Sink:
    def add(result: FollowedFrame) -> None:
        if result.picture is not None or result.told:
            log.add(
                result.picture, result.estimate, stamp=result.stamp, query=query, position=result.position,
                others=result.others, problem=result.problem, grid=result.grid,
            )  # fmt: skip

    return add


def _paged(page: Any, begins: float) -> Sink:
    def add(result: FollowedFrame) -> None:
        if result.told and result.lost:
            page.note(f"{result.frame} does not fit to the frames before it: the belief starts anew there.")
        if result.told:
            page.add(
                result.picture, result.estimate, stamp=result.stamp - begins, name=result.frame,
                problem=result.problem, grid=result.grid,
            )  # fmt: skip

    return add


def _painter(folder: Path, query: str, most: int) -> Sink:
    """A function that draws a frame with its belief into `folder`; unreadable frames are skipped.

    Pictures are numbered as the lines of the table, and show at most `most` candidates.
    """
    from eagor.drawing import Mosaic, draw_belief
    from eagor.drawing.style import answer_in_words

    checks.checked_folder(folder, "--pictures")
    numbers, mosaic = count(), Mosaic()

    def draw(result: FollowedFrame) -> None:
        if not result.told:
            return
        number = next(numbers)
        if result.picture is None:
            return
        estimate = result.estimate
        title = f"“{query}” at {result.stamp:.2f} s: {answer_in_words(estimate)} ({estimate.status})"
        shown = {name: result.others[name] for name in ("centroid", "eagor_paper") if name in result.others}
        modes = [mode.direction for mode in estimate.modes[:most]]
        drawn = draw_belief(
            result.picture, estimate, modes=modes, others=shown, title=title, grid=result.grid, mosaic=mosaic
        )
        checks.keep_picture(drawn, folder / f"{number:04d}.png")

    return draw
