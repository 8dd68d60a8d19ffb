"""Footage as the commands open it: the recording, its poses, what is said of both on stderr, and what was left out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor.cli import checks, terminal
from eagor.cli.options import Footage, refuse
from eagor.errors import ImageError

if TYPE_CHECKING:
    from eagor.perception import Perception

WORDS = ("auto", "level", "still")  # for --poses; anything else is a file
RATE = 2.0  # looks per second of what moves
BY_SIGHT = 10.0  # frames per second from which an ordinary camera's turn is found: neighbours have to overlap


@dataclass(frozen=True)
class FrameStream:
    """The recording and its poses, as `eagor.Loop` takes them; `told` says in words where the poses are from.

    `count`: how many frames come, if known; `looks` per second (None: at every picture); `shown`: frames per second,
    where they are regular; `span`: seconds from the first frame to the last, if known; `begins`: the stamp of the first
    frame, where stamps are those of another clock.
    """

    source: Any
    poses: Any
    told: str
    count: int | None
    looks: float | None = None
    shown: float | None = None
    span: float | None = None
    begins: float = 0.0


def open_stream(
    options: Footage, places: Sequence[Path], perception: Perception, shown: float | None = None
) -> FrameStream:
    """The recording that the options name; what it tells of itself is said on stderr.

    `shown`: frames per second of a video to be drawn, which shows more than what is looked at. Raises `UsageError`, and
    as `open_footage` and `open_poses`.
    """
    from eagor.perception import rows_of
    from eagor.sources.bags import is_bag
    from eagor.sources.camera_sources import LEAST_ROWS, is_video, open_footage
    from eagor.sources.odometry import open_poses, poses_in_words

    bag = len(places) == 1 and is_bag(places[0])
    moves = bag or is_video(places, options.rig is not None)
    _check(options, places, bag, moves)
    looks = (options.rate or RATE) if moves else None
    rate = max(looks, shown or 0) if looks else options.rate
    words = [f"{places[0]}?topic={options.image_topic}"] if options.image_topic else places
    how = checks.lens_of(options, options.camera_info) | {
        "rows": max(rows_of(perception), LEAST_ROWS) if moves else None,
        "start": options.start, "end": options.end, "force": options.force, "info": options.camera_info,
    }  # fmt: skip
    source = open_footage(words, **how, rate=rate, say=terminal.log)
    if source.video is not None:
        say_of_video(places[0].name, source.video)
    text = options.poses if options.odom_topic is None else f"ros:{options.odom_topic}"
    poses = open_poses(text, source, axes=options.axes, say=terminal.log)
    told = poses_in_words(poses)
    if looks and rate and rate < BY_SIGHT and source.ordinary and "pictures themselves" in told:
        rate = BY_SIGHT
        source = open_footage(words, **how, rate=rate, say=lambda text: None)
    count = span = None
    if (video := source.video) is not None:
        count, end = video.count, options.end or video.duration
        span = None if end is None else end - options.start
        most = looks or RATE
        terminal.log(f"{min(most, video.frame_rate or most):g} looks per second (--rate {most:g}), {told}")
    elif source.bag is not None:
        terminal.log(f"{source.bag.count} pictures of {source.bag.topic}; {looks:g} looks per second (--rate), {told}")
        terminal.log(f"the table's stamps are seconds from {source.begins:.3f}; --out and --json have the full ones")
    elif (images := source.images) is not None:  # with the times that a file of poses tells, or the rate
        count, stamps = len(images.paths), images.stamps
        rate = None if stamps else images.rate
        span = stamps[-1] - stamps[0] if stamps else (count - 1) / images.rate
        if rate is not None:
            terminal.log(f"{terminal.many(count, 'image')}, taken at {rate:g} per second (--rate), {told}")
    return FrameStream(source, poses, told, count, looks, rate, span, source.begins)


def say_of_video(name: str, video: Any) -> None:
    """Say on stderr what a video tells of itself; the first of it is its format."""
    first, *more = video.facts
    for fact in (first if video.duration is None else f"{first}, {video.duration:.1f} s", *more):
        terminal.log(f"{name}: {fact}")


def _check(options: Footage, places: Sequence[Path], bag: bool, moves: bool) -> None:
    """Raise `UsageError` for options that do not belong together."""
    poses, given_poses = options.poses, options.poses not in WORDS
    if given_poses and not os.path.exists(poses):
        raise terminal.UsageError(f"there is no file {poses}; --poses takes {', '.join(WORDS)} or a CSV file")
    if not (given_poses or (bag and poses == "auto")):
        refuse(options, ["axes"], f"{options.axes} is for a file of poses; give one with --poses")
    if not bag:
        refuse(options, ("image_topic", "odom_topic", "camera_info"), f"is for a ROS 2 bag; {places[0]} is none")
    if not moves:
        refuse(options, ("start", "end", "fps"), "is for a video; these are images")
        if given_poses:
            refuse(options, ["rate"], f"is not wanted: {poses} tells when the images were taken")
    if options.odom_topic is not None:
        refuse(options, ["poses"], f"{poses} and --odom-topic: wanted one of them")


class Tally:
    """How many frames came, and which of them could not be used, each of which is said; `broken`: why they ended early.

    What was computed before they did is kept.
    """

    def __init__(self) -> None:
        self.frames = self.bad = self._unread = 0
        self.broken = ""

    def add(self, name: str, problem: str | None, read: bool) -> None:
        """A frame; `read`: whether it has a picture."""
        self.frames += 1
        if problem is not None:
            terminal.warning(f"{name} is left out: {problem}")
            self.bad, self._unread = self.bad + 1, self._unread + (not read)

    def end(self, left_out: Sequence[str]) -> int:
        """Say what is missing; returns the exit code. Raises `RunError` if no frame came."""
        for text in [*left_out, *([f"the frames end early: {self.broken}"] if self.broken else [])]:
            terminal.warning(text)
        if not self.frames:
            raise terminal.RunError("there was no frame to look at")
        return terminal.INCOMPLETE if self.bad or self.broken or left_out else terminal.OK

    def check(self) -> None:
        """Raise `RunError` if all frames were bad, `ImageError` if none could be read: the input is wrong."""
        if self.bad == self.frames:
            error, what = (ImageError, "read") if self._unread == self.frames else (terminal.RunError, "used")
            all_of_them = f"none of the {self.frames} frames could be {what}; the reasons are above"
            raise error(all_of_them if self.bad > 1 else f"the only frame could not be {what}; the reason is above")
        if self.bad:
            terminal.log(f"{self.bad} of {self.frames} frames were left out")
