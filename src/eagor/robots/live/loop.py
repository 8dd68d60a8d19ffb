"""The live loop: a camera, poses and a perception at their own rates; answers at a steady one."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Literal, Protocol

import numpy as np

from eagor._checks import above
from eagor.errors import EagorError, QueryError, TimeError
from eagor.perception import Perception
from eagor.robots.frames import CameraSource, Frame, Pose, PoseSource
from eagor.robots.live.answers import Answer, Part
from eagor.robots.live.core import LiveCore
from eagor.robots.live.events import Asked, Event, EvidenceCame, Following, FrameCame, PoseCame, PosesLost, Trouble
from eagor.robots.live.keeper import PATIENCE, Failed, Keeper, Looked
from eagor.robots.live.playing import LoopClock, Pace, paced_frames, paced_poses
from eagor.robots.live.worker import Picture, Worker
from eagor.tracking import TrackerConfig

__all__ = ["Counts", "LiveLoop", "Watcher"]

RATE = 20.0  # answers per second
REOPENED = (0.5, 10.0)  # seconds before a source that is gone is opened again: at first, and at most; doubled
STALLED = 10.0  # seconds without a picture after which a stream is opened again
SLIPPED = 0.1  # seconds by which this machine's clock is set before it is worth a word
LEAVING = 5.0  # seconds that threads have to come back from a device

Camera = CameraSource | Callable[[], CameraSource]
Poses = PoseSource | Callable[[], PoseSource] | Literal["auto", "level"] | None


class Watcher(Protocol):
    """Sees all that comes into the loop and out of it, in the loop's thread: a recording, a viewer."""

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event, and the answers to it (none unless it is `Asked`). Must be quick."""
        ...

    def close(self) -> None:
        """The loop has ended."""
        ...


@dataclass
class Counts:
    """What has happened so far: `frames` came, `looked` at by the perception, `answers` given, `late` ticks missed."""

    frames: int = 0
    poses: int = 0
    looked: int = 0
    skipped: int = 0
    answers: int = 0
    late: int = 0


class LiveLoop:
    """Follows `queries` with a camera, and answers `rate` times a second, however slow the perception is.

    `camera`: a source, or a function that opens one; a function is called again when the camera is gone. A source that
    is not `live` is played at its own speed, or with `fast` as fast as the perception can look at every picture.
    `perception`: text for `eagor.perception.load`, or an object that can be pickled; it runs in a process of its own,
    which is killed and started anew if one look takes more than `patience` seconds. `poses`: a source of odometry, or a
    function that opens one; "auto": rotation from the pictures; "level": the same for a camera that stays level; None:
    the camera stands still. `record`: a folder for a bag of all that happens. `watchers` see it, too.

    Iterate over it for answers, one per query and tick, or call `run`. Once only. Neither the camera, the poses nor the
    perception can hold up an answer; what is wrong with them is said in each answer's `faults`. The sources are closed
    at the end. Raises `QueryError` if the perception understands no query, other `EagorError` if it cannot be loaded,
    or the sources cannot be opened at first. Processes are started by spawning: a script needs
    ``if __name__ == "__main__":``.
    """

    def __init__(
        self,
        camera: Camera,
        perception: str | Perception,
        queries: Sequence[str],
        *,
        poses: Poses = None,
        config: TrackerConfig | None = None,
        rate: float = RATE,
        patience: float = PATIENCE,
        record: Path | None = None,
        fast: bool = False,
        watchers: Sequence[Watcher] = (),
    ) -> None:
        raise NotImplementedError

    def __iter__(self) -> Iterator[Answer]:
        """The answers, until the source ends or `stop` is called: at each tick one per query, in their order."""
        raise NotImplementedError

    def run(self, on_answer: Callable[[Answer], Any]) -> None:
        """Call `on_answer` with every answer until the source ends or `stop` is called."""
        for answer in self:
            on_answer(answer)

    def stop(self) -> None:
        """End the loop, from any thread or from `on_answer`."""
        raise NotImplementedError

    def follow(self, queries: Sequence[str]) -> None:
        """Follow these queries from now on, from any thread. What is known of those that stay is kept."""
        raise NotImplementedError
