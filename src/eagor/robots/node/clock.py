"""Times of a node of ROS 2: the clock of a simulation or of a bag that is played, and the stamps of its answers."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from eagor.errors import DeviceError
from eagor.live.core import deviation
from eagor.live.events import Answer, Event, FrameCame, PoseCame
from eagor.live.sources import LoopClock
from eagor.media.bags.messages import CLOCK, seconds
from eagor.media.frames import Pose
from eagor.robots.ros.graph import Graph

__all__ = ["SimClock", "Stamps"]

TOPIC = "/clock"
FIRST = 10.0  # seconds of real time in which the first time has to be told
WAITING = 0.1  # seconds after which who waits for it looks whether to go on


class SimClock(LoopClock):
    """What ``/clock`` said last, as nodes of ROS with ``use_sim_time`` take it: it stands while a simulation stands.

    `back` is called in a thread, with the seconds, whenever the time goes back: a bag begins again, a simulation was
    reset. `ended` says whether nobody wants the time any more. Raises `DeviceError` if nobody tells it within `wait`
    seconds.
    """

    def __init__(
        self,
        graph: Graph,
        back: Callable[[float], Any],
        ended: Callable[[], bool] = lambda: False,
        wait: float | None = None,
    ) -> None:
        wait = FIRST if wait is None else wait
        self._now, self._back = math.nan, back
        self._told = threading.Event()
        self._reader = graph.subscribe(TOPIC, CLOCK, self._heard, depth=1)
        for _ in range(math.ceil(wait / WAITING)):
            if self._told.wait(WAITING) or ended():
                return
        self.close()
        raise DeviceError(
            f"nothing came on {TOPIC} within {wait:g} s, and use_sim_time is set: start the simulation, or play the "
            "bag with --clock; or leave use_sim_time out"
        )

    def now(self) -> float:
        return self._now

    def slip(self) -> float:
        """Nothing sets it but ``/clock`` itself."""
        return 0.0

    def close(self) -> None:
        """Listen no more."""
        self._reader.close()

    def _heard(self, received: Any, _: float) -> None:
        now = seconds(received.clock)
        if now < self._now:  # told first: nobody should ask for answers of a time that is gone
            self._back(self._now - now)
        self._now = now
        self._told.set()


class Stamps:
    """A watcher of the loop: an answer as of the inputs that it rests on.

    That is the newest pose: the answer is told in the axes that the camera had there, with the stamp of that pose. So
    whoever has the transforms of the inputs has the one for it, whatever clock the robot uses, and nothing is told of a
    turn that nobody has measured yet. Without poses it is the newest picture.
    """

    def __init__(self) -> None:
        self._pose: Pose | None = None
        self._picture = 0.0

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        if isinstance(event, PoseCame):
            self._pose = event.pose
        elif isinstance(event, FrameCame):
            self._picture = event.stamp

    def close(self) -> None:
        """Nothing is held."""

    def of(self, answer: Answer, otherwise: float, between: float = 0.0) -> Answer:
        """The same answer there; at the stamp `otherwise`, if no input has told a time.

        `between`: standard deviation, radians, of a pose that is interpolated between two of the odometry, as those of
        the pictures are; regions are as much wider.
        """
        pose = self._pose
        if pose is None:
            return replace(answer, stamp=self._picture if self._picture > 0 else otherwise)
        estimate = answer.estimate.turned(answer.estimate.stamp, pose.world_R_body, deviation(between**2 / 2))
        return replace(answer, stamp=pose.stamp if pose.stamp > 0 else otherwise, estimate=estimate)
