"""The node: pictures, odometry and queries of a ROS 2 graph in; directions, markers, beliefs, diagnostics out.

It runs the live loop (`eagor.live`), so it answers at a steady rate however slow the perception is. The graph is
DDS without ROS (`eagor.robots.ros.graph.DdsGraph`), or `rclpy` (the package ``eagor_ros`` in ``ros2/``).
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from eagor._checks import above, require
from eagor.errors import DeviceError, EagorError, QueryError
from eagor.live.events import Answer, Fault, FaultLog, NextLooks, Part
from eagor.live.loop import RATE, LiveLoop, Watcher
from eagor.live.threads import LoopClock, already_open
from eagor.media.intrinsics import Camera
from eagor.media.rigs import Rig
from eagor.media.ros_messages import CLOCK, TEXT, seconds
from eagor.perception import Perception
from eagor.robots.ros.driving import TwistGate
from eagor.robots.ros.graph import Graph, GraphReader
from eagor.robots.ros.odometry import BODY, unnamed
from eagor.robots.ros.pose_sources import RosPoses
from eagor.robots.ros.publishing import Outbox, OutgoingAnswer, Stamps, trouble
from eagor.robots.ros.sources import RosCamera
from eagor.robots.safety.walking import Odometer, Steering, WalkSettings
from eagor.tracking import TrackerConfig

__all__ = ["QUERY", "Node", "NodeSettings", "queries_after"]

MOST = 16  # queries at a time

QUERY = "~/query"
AGAIN = 2.0  # seconds before sources that are gone are looked for again
IDLE = 1.0  # seconds between two words of a node that has nothing to do

CLOCK_TOPIC = "/clock"
FIRST = 10.0  # seconds of real time in which the first time has to be told
WAITING = 0.1  # seconds after which who waits for it looks whether to go on


def queries_after(now: Sequence[str], text: str) -> tuple[str, ...]:
    """The queries that are followed after a message.

    "red chair" replaces all by one; "red chair; blue ball" by two. "+blue ball" is followed as well, "-blue ball" no
    longer. An empty text ends them all. At most `MOST` are followed; further ones are left out.
    """
    found, fresh = list(now), False
    for part in (part.strip() for part in re.split(r"[;\n]", text)):
        word = part.lstrip("+-").strip()
        if not re.search(r"\w", word):
            continue
        if part.startswith("-"):
            found = [each for each in found if each != word]
            fresh = True
            continue
        if not part.startswith("+") and not fresh:
            found, fresh = [], True
        if word not in found:
            found.append(word)
    if not text.strip():
        return ()
    return tuple(found[:MOST])


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
        self._reader = graph.subscribe(CLOCK_TOPIC, CLOCK, self._heard, depth=1)
        for _ in range(math.ceil(wait / WAITING)):
            if self._told.wait(WAITING) or ended():
                return
        self.close()
        raise DeviceError(
            f"nothing came on {CLOCK_TOPIC} within {wait:g} s, and use_sim_time is set: start the simulation, or play "
            "the bag with --clock; or leave use_sim_time out"
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


@dataclass(frozen=True)
class NodeSettings:
    """What a node reads, and how it answers.

    `image_topic`, `odom_topic`: None is the only one; of several cameras, their topics with commas between. `poses`:
    "odom", or without odometry "auto" (rotation from the pictures), "level" (the same for a camera that stays level),
    "still". `body`: the frame of the answers; `camera`: the camera's (None: as the pictures name it, those of the first
    camera; with a `rig` for several topics, the body's); `world`: of the poses, for transforms. `rate`: answers per
    second; `belief_rate`: pictures of the belief per second, 0 for none. `cmd_vel`: a topic of velocities that walk the
    base to the first thing, as `walking` says, by odometry with places; None: the node drives nothing. `lens`: of an
    ordinary camera; `camera_info`: the topic that tells it. Others as for `LiveLoop` and `RosCamera`. `use_sim_time`:
    the time is what ``/clock`` says.
    """

    image_topic: str | None = None
    odom_topic: str | None = None
    poses: Literal["odom", "auto", "level", "still"] = "odom"
    body: str = BODY
    camera: str | None = None
    world: str | None = None
    rate: float = RATE
    belief_rate: float = 2.0
    belief_encoding: Literal["mono8", "32FC1"] = "mono8"
    latency: float = 0.0
    rows: int | None = None
    patience: float = 60.0
    rig: Rig | None = None
    lens: Camera | None = None
    camera_info: str | None = None
    stitched: bool = False
    record: Path | None = None
    cmd_vel: str | None = None
    walking: WalkSettings = field(default_factory=WalkSettings)
    config: TrackerConfig = field(default_factory=TrackerConfig)
    use_sim_time: bool = False

    def __post_init__(self) -> None:
        encodings = ("mono8", "32FC1")
        require(
            self,
            {
                "rate": (above(self.rate, 0, 1000), "answers per second, up to 1000"),
                "belief_rate": (self.belief_rate >= 0, "pictures per second, or 0"),
                "belief_encoding": (self.belief_encoding in encodings, f"one of {', '.join(encodings)}"),
                "patience": (above(self.patience, 0), "seconds above 0"),
                "cmd_vel": (
                    self.cmd_vel is None or self.poses == "odom",
                    "None without odometry (poses = 'odom'): a base that does not know how it moves is not driven",
                ),
                "poses": (self.poses in ("odom", "auto", "level", "still"), "odom, auto, level or still"),
            },
        )


class Node:
    """Answers on a `graph` until `stop` is called.

    `perception`: for `LiveLoop`; or `choose`, which names one for the queries that are followed, and may raise
    `QueryError`. `queries`: what is followed at first; others come on ``~/query`` (`queries_after`).
    `said` is told what goes wrong, in words. Topics: docs/how-to/ros2.md.
    """

    def __init__(
        self,
        graph: Graph,
        perception: str | Perception = "colour",
        queries: Sequence[str] = (),
        settings: NodeSettings | None = None,
        *,
        choose: Callable[[Sequence[str]], str | Perception] | None = None,
        said: Callable[[str], Any] = lambda _: None,
    ) -> None:
        self.graph, self.settings, self.queries = graph, settings or NodeSettings(), tuple(queries)
        self._choose: Callable[[Sequence[str]], str | Perception] = choose or (lambda _: perception)
        self._said = said
        self._news = threading.Condition()
        self._stopped = False
        self._loop: LiveLoop | None = None
        self._spec: str | Perception | None = None
        self._poses: RosPoses | None = None
        self._frame: str | None = ""
        self._sim: SimClock | None = None
        self._rewound = ""  # what is to be said of a clock that went back
        self._told = FaultLog()
        self.answers = 0

    def run(self) -> None:
        """Follow until `stop`. Raises `EagorError` if the first camera, odometry or query cannot be used."""
        reader: GraphReader = self.graph.subscribe(QUERY, TEXT, self._asked, reliable=True, depth=10, transient=True)
        first, given = True, self.queries
        try:
            if self.settings.use_sim_time:
                self._sim = SimClock(self.graph, self._went_back, self._ended)
            with Outbox(self.graph, self.settings, self._now) as outbox:
                while self._wait_for_queries(outbox):
                    try:
                        self._follow(outbox)
                        first = False
                    except QueryError as error:
                        if first and self.queries == given:
                            raise
                        self._tell(outbox, "perception", str(error))
                        with self._news:
                            self.queries = ()
                    except (EagorError, OSError) as error:
                        if self._rewound:  # an answer for a time that is gone
                            continue
                        if first:
                            raise
                        self._tell(outbox, "camera", f"{error}; tried again")
                        self._pause(AGAIN)
        finally:
            reader.close()
            if self._sim is not None:
                self._sim.close()

    def _ended(self) -> bool:
        """Whether nobody waits for a source any more."""
        loop = self._loop
        return self._stopped or (loop is not None and loop.stopped)

    def _now(self) -> float:
        """The time of the node, for what rests on no picture."""
        return time.time() if self._sim is None else self._sim.now()

    def _went_back(self, by: float) -> None:
        """The time of the graph went back: begin anew, as tf2 forgets its transforms then."""
        with self._news:
            self._rewound = f"the time went back by {by:.2f} s: all begins anew"
            if self._loop is not None:
                self._loop.stop()

    def stop(self) -> None:
        """End `run`, from any thread."""
        with self._news:
            self._stopped = True
            if self._loop is not None:
                self._loop.stop()
            self._news.notify_all()

    def _asked(self, received: Any, _: float) -> None:
        """A message on ``~/query``."""
        with self._news:
            queries = queries_after(self.queries, received.data)
            if queries == self.queries:
                return
            self.queries = queries
            if self._loop is not None:
                if queries and self._same(queries):
                    self._loop.follow(queries)
                else:
                    self._loop.stop()  # another perception, or nothing to look for
            self._news.notify_all()

    def _same(self, queries: Sequence[str]) -> bool:
        try:
            chosen = self._choose(queries)
            return chosen is self._spec or (isinstance(chosen, str) and chosen == self._spec)
        except QueryError:
            return False

    def _wait_for_queries(self, outbox: Outbox) -> bool:
        """Wait for something to look for. False once the node is stopped."""
        while True:
            with self._news:
                if self._stopped:
                    return False
                if self.queries:
                    return True
            outbox.say(trouble(self._now(), "waiting for a query on ~/query (std_msgs/String)", level=0))
            self._pause(IDLE)

    def _pause(self, seconds: float) -> None:
        with self._news:
            if not self._stopped:
                self._news.wait(seconds)

    def _follow(self, outbox: Outbox) -> None:
        """Run a loop until it ends, is stopped, or fails."""
        s = self.settings
        with self._news:
            queries, rewound, self._rewound = self.queries, self._rewound, ""
        if rewound:
            self._tell(outbox, "clock", rewound)
        spec = self._choose(queries)
        camera = self._camera()
        self._frame = s.camera or camera.frame
        loop: LiveLoop
        stamps, looks = Stamps(), NextLooks()
        watchers: list[Watcher] = [stamps, looks]
        gate: TwistGate | None = None
        steering: Steering | None = None
        try:
            poses = self._first_poses()
            if s.cmd_vel is not None:
                gate = TwistGate(self.graph, s.cmd_vel, self._mount)
                odometer = Odometer(gate, lambda: loop.clock.now())
                steering = Steering(gate, odometer, s.walking, lambda: loop.clock.now())
                watchers += [odometer, gate]
            loop = LiveLoop(
                already_open(camera, self._camera), spec, queries, poses=poses, config=s.config, rate=s.rate,
                patience=s.patience, record=self._record(), clock=self._sim, watchers=watchers,
            )  # fmt: skip
        except BaseException:
            camera.close()
            raise
        with self._news:
            self._loop, self._spec = loop, spec
            if self._stopped or self._rewound or self.queries != queries:
                if not (self._stopped or self._rewound) and self.queries and self._same(self.queries):
                    loop.follow(self.queries)
                else:
                    loop.stop()
        try:
            with gate or nullcontext():
                loop.run(lambda answer: self._answered(answer, loop, outbox, steering, stamps, looks))
        finally:
            with self._news:
                self._loop = None
            if self._poses is not None:
                self._poses.close()
                self._poses = None

    def _camera(self) -> RosCamera:
        s, now = self.settings, None if self._sim is None else self._sim.now
        return RosCamera(
            s.image_topic, graph=self.graph, latency=s.latency, rows=s.rows, rig=s.rig, camera=s.lens,
            info=s.camera_info, stitched=s.stitched, ended=self._ended, now=now,
        )  # fmt: skip

    def _record(self) -> Path | None:
        """The folder to record into: each time that all begins anew, another one."""
        path, number = self.settings.record, 1
        while path is not None and path.exists():
            number += 1
            path = path.with_name(f"{self.settings.record.name}_{number}")  # type: ignore[union-attr]
        return path

    def _odometry(self) -> RosPoses:
        s = self.settings
        self._poses = RosPoses(
            s.odom_topic, graph=self.graph, camera=self._frame, body=s.body, world=s.world, ended=self._ended
        )
        return self._poses

    def _first_poses(self) -> Any:
        """What `LiveLoop` takes as poses."""
        if self.settings.poses == "still":
            return None
        if self.settings.poses != "odom":
            return self.settings.poses
        try:
            return already_open(self._odometry(), self._odometry)
        except DeviceError as error:
            raise DeviceError(f"{error}. Without odometry: --poses auto takes turns from the pictures") from error

    def _answered(
        self,
        answer: Answer,
        loop: LiveLoop,
        outbox: Outbox,
        steering: Steering | None,
        stamps: Stamps,
        looks: NextLooks,
    ) -> None:
        queries = loop.core.queries
        self.answers += 1
        self._say_faults(answer)
        number = queries.index(answer.query) if answer.query in queries else 0
        between = 0.0 if self._poses is None else self._poses.reader.turning.midway
        told_of = stamps.of(answer, self._now(), between)
        counts, mount = loop.counts, self._mount(told_of.stamp)
        told = {
            "pictures": str(counts.frames), "looks": str(counts.looks), "skipped": str(counts.skipped),
            "poses": str(counts.poses), "answers": str(counts.answers), "late": str(counts.late),
        }  # fmt: skip
        if self._poses is not None:
            told["between_poses_deg"] = f"{math.degrees(between):.2f}"
        if steering is not None and number == 0:
            step = steering.step(answer, mount)
            told |= {"drive": step.wish.words, "gate": "; ".join((step.state.mode, *step.state.reasons))}
        camera = self._frame or self.settings.body
        outbox.put(OutgoingAnswer(told_of, answer.stamp, number, len(queries), mount, camera, told, looks))

    def _mount(self, stamp: float) -> np.ndarray:
        """body_R_camera."""
        poses = self._poses
        return np.eye(3) if poses is None else poses.body_R_camera(stamp)

    def _say_faults(self, answer: Answer) -> None:
        """Say what begins to be wrong, lasts, and ends."""
        now, faults = time.monotonic(), list(answer.faults)
        if (problem := self._unplaced() if self._poses is None else self._poses.problem) is not None:
            faults.append(Fault("poses", problem, answer.stamp))
        for text, _ in self._told.of(faults, now):
            self._said(text)

    def _unplaced(self) -> str | None:
        """What to say of the camera's place on the body, where no odometry is read, and so no transforms."""
        body = self.settings.body
        if self._frame in (None, body):
            return None
        if not self._frame:
            return unnamed(body)
        return f"without odometry no transforms are read: the axes of {self._frame} are taken for those of {body}"

    def _tell(self, outbox: Outbox, part: Part, text: str) -> None:
        """Say what is wrong while no loop runs."""
        if self._told.worth(Fault(part, text, self._now()), time.monotonic()):
            self._said(text)
        outbox.say(trouble(self._now(), text))
