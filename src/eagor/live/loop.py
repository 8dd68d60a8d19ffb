"""The live loop: a camera, poses and a perception at their own rates; answers at a steady one."""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Protocol, runtime_checkable

import numpy as np

from eagor._checks import above
from eagor.errors import EagorError, ImageError, QueryError, TimeError
from eagor.evidence import BodyMask
from eagor.live.core import LiveCore, LoopSettings, warm
from eagor.live.events import (
    Answer,
    Diagnostic,
    Event,
    ImageReceived,
    ObservationReceived,
    OdometryReset,
    Part,
    PoseReceived,
    QueriesChanged,
    Tick,
)
from eagor.live.in_turn import answers_in_turn
from eagor.live.inference import PATIENCE, InferenceWorker, why_here
from eagor.live.recording import Pictures, Recorder
from eagor.live.threads import FrozenCamera, LatestWorker, LoopClock, Reader
from eagor.odometry.visual import WALKS, VisualOdometer
from eagor.perception import Perception, as_perception
from eagor.perception.replay import RecordedLooks
from eagor.sources import CameraSource, Frame, Pose, PoseSource
from eagor.sources.camera_sources import open_source
from eagor.sources.odometry import PosedFrame, PosedFrames, poses_for, prefetched
from eagor.tracking import TrackerConfig

__all__ = ["LOADING", "Counts", "Loop", "Sink"]

RATE = 20.0  # answers per second
STALLED = 10.0  # seconds without a picture after which a stream is opened again
LONGEST_LATE = 60.0  # seconds: evidence may come so late, if the perception has the patience
ON_DEMAND = 0.2  # seconds between pictures while the perception is busy
LEAVING = 5.0  # seconds that threads have to come back from a device
AHEAD = 4  # looks that may wait to be taken in: a perception that is quicker than the tracker waits, and answers do not
LOADING = "the perception is being loaded"  # a fault until it is

Source = str | CameraSource | Callable[[], CameraSource]
Poses = str | PoseSource | Callable[[], PoseSource] | VisualOdometer | None


@runtime_checkable
class Sink(Protocol):
    """Sees all that comes into the loop and out of it, in the loop's thread: a recording, a viewer."""

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event, and the answers to it (none unless it is a `Tick`). Must be quick."""
        ...

    def close(self) -> None:
        """The loop has ended."""
        ...


@dataclass
class Counts:
    """What has happened so far.

    `frames`, `poses` came; `looks`: at a picture for one query; `skipped`: pictures that the perception did not come
    to, or the camera dropped; `answers` given.
    """

    frames: int = 0
    poses: int = 0
    looks: int = 0
    skipped: int = 0
    answers: int = 0


class Loop:
    """Follows `queries` through the pictures of a `source`: answers in the order of time, one per query and time.

    In turn, the perception looks at the pictures one after the other, `looks` in each second of the recording (None:
    all), and an answer comes for each of them. With `realtime`, and always with a source that is `live`, answers come
    `rate` times a second, however slow the perception is, which looks at the newest picture. A source that is a sink as
    well hears the answers, such as a simulated body that follows them.

    - `source`: text for `eagor.open_source`, a source, or a function that opens one, which is called again when the
      camera is gone. It is closed at the end.
    - `poses`: text for `eagor.open_poses` ("auto": what the source tells of its motion, else the pictures do; "still"),
      a source of odometry, or a function that opens one; None: the camera stands still.
    - `perception`: text for `eagor.load`, a perception, or any function that `eagor.Detector` takes. In real time it
      runs in a process of its own, which is killed and started anew if one look takes more than `patience` seconds. It
      is spawned: a script needs ``if __name__ == "__main__":``. What cannot be sent there, such as a lambda,
      works in this process, with a warning.
    - `sinks` see all that comes in and out. `record`: a new folder for a bag of all that happens
      (`eagor.live.recording`), with the `pictures` as "jpeg", "png" or "none".
    - `acceleration`, `extrapolate`: see `LoopSettings`. `mask`: what the camera never sees. `clock`: what tells the
      time; one that stands still, as a simulation's does, gives no answers meanwhile.

    Iterate over it for answers, or call `run`. Once only. In real time, neither the camera, the poses nor the
    perception can hold up an answer; what is wrong with them is said in each answer's `faults`. Raises `QueryError` if
    the perception understands no query, other `EagorError` if it cannot be loaded, or the sources cannot be opened at
    first.

    ```python
    for answer in eagor.Loop("walk.mp4", "auto", "coco", ["chair", "tv"]):
        print(answer.as_dict())
    ```
    """

    def __init__(
        self,
        source: Source,
        poses: Poses,
        perception: str | Perception | Callable[..., Any],
        queries: str | Sequence[str],
        realtime: bool = False,
        sinks: Sequence[Sink] = (),
        *,
        config: TrackerConfig | None = None,
        rate: float = RATE,
        looks: float | None = None,
        patience: float = PATIENCE,
        record: Path | None = None,
        pictures: Pictures = "jpeg",
        acceleration: float = LoopSettings.acceleration,
        extrapolate: bool = True,
        mask: BodyMask | None = None,
        clock: LoopClock | None = None,
    ) -> None:
        for name, value in ("rate", rate), ("looks", looks), ("patience", patience), ("acceleration", acceleration):
            if value is not None and not above(value, 0):
                raise TimeError(f"{name} = {value!r}; wanted a number above 0")
        queries = (queries,) if isinstance(queries, str) else tuple(queries)
        if not queries:
            raise QueryError("there is no query; say what to look for, such as 'red chair'")
        perception = as_perception(perception)
        self.clock, self.counts = clock or LoopClock(), Counts()
        self._events: SimpleQueue[Event | None] = SimpleQueue()
        self._looks = threading.Semaphore(AHEAD)
        self._stopped = threading.Event()
        self._shift = 0.0  # seconds from the clock of a recording to the loop's; 0 for live sources
        self._frames = Reader(
            "camera",
            partial(open_source, source) if isinstance(source, str) else source,
            give=self._frame,
            trouble=partial(self._trouble, "camera"),
            ended=self._frames_ended,
        )
        self._camera: CameraSource = self._frames.opened()
        self.live = self._camera.live
        self.rate, self.realtime = rate, realtime or self.live
        try:
            poses = poses_for(poses, self._camera) if isinstance(poses, str) else poses
        except BaseException:
            self._camera.close()
            raise
        self._odometer = poses if isinstance(poses, VisualOdometer) else None
        self._odometry: Reader | None = None
        if poses is not None and self._odometer is None:
            trouble = partial(self._trouble, "poses")
            self._odometry = Reader("poses", poses, give=self._pose, trouble=trouble, ended=trouble)
        config = config or TrackerConfig()
        config = replace(config, history=max(config.history, min(patience, LONGEST_LATE)))  # evidence may come so late
        recorded = isinstance(self._camera, RecordedLooks)
        self._settings = LoopSettings(
            queries, config, poses is not None or recorded, self._camera.latency, acceleration,
            extrapolate, exact=not self.realtime,
        )  # fmt: skip
        self.core = LiveCore(self._settings)
        self.frames: PosedFrames | None = None  # of a recording
        if not (self.live or recorded):
            odometry = None if self._odometry is None else self._odometry.opened()
            say = partial(self._trouble, "poses", passing=True)
            sight = None if self.realtime else self._odometer  # in real time the newest pictures tell, if not all
            self.frames = PosedFrames(self._camera, sight or odometry, None if self.realtime else looks, say)
        self._recorded = self._camera.posed if isinstance(self._camera, RecordedLooks) else self.frames
        unseen = getattr(self._camera, "unseen", None)  # what no picture of it shows
        masks = [] if mask is None else [mask]
        masks += [] if unseen is None or not unseen.any() else [BodyMask(~unseen)]
        why = why_here(perception) if self.realtime else ""
        if why:
            warnings.warn(
                f"the perception works in this process, where nothing ends it if it hangs: {why}. A function at the "
                "top of a file can have a process of its own",
                stacklevel=2,
            )
        self._inference = InferenceWorker(
            perception,
            isolated=self.realtime and not why,
            patience=patience,
            masks=masks,
            say=partial(self._trouble, "camera", passing=True),
        )
        self._recorder: Recorder | None = None
        if record is not None:
            self._recorder = Recorder(record, self._settings, partial(self._trouble, "recording"), pictures)
        self._sinks: list[Sink] = [*sinks, *([] if self._recorder is None else [self._recorder])]
        if isinstance(self._camera, Sink):  # a simulated body follows the answers to its pictures
            self._sinks.insert(0, self._camera)
        self._perception: LatestWorker[Frame] | None = None
        self._seer: LatestWorker[Frame] | None = None  # finds how the camera turns in its pictures
        # A source that keeps the newest picture itself makes it a panorama when asked: not more often than needed.
        keeps_newest = getattr(self._camera, "keeps_newest", False)
        self._on_demand = keeps_newest and self._odometer is None and record is None
        self._last_frame = self.clock.now()  # its arrival
        self._over, self._ended = False, -math.inf  # whether a recording has, and when its last picture came
        self._fatal: EagorError | None = None
        self._refused: set[str] = set()
        self._now = -math.inf
        self._problems: dict[Part, str | None] = {}  # what the camera and the odometry say of themselves
        self._frozen = FrozenCamera(self.core.orientation)

    def __iter__(self) -> Generator[Answer, None, None]:
        """The answers, until the source ends or `stop` is called: at each tick one per query, in their order."""
        try:
            yield from self._paced() if self.realtime else self._in_turn()
        finally:
            self._close()

    def run(self, on_answer: Callable[[Answer], Any]) -> None:
        """Call `on_answer` with every answer until the source ends or `stop` is called."""
        with closing(iter(self)) as answers:
            for answer in answers:
                on_answer(answer)

    @property
    def recording_problem(self) -> str | None:
        """Why the recording has ended before the loop, in words; None if it has not."""
        return None if self._recorder is None else self._recorder.problem

    @property
    def knows_classes(self) -> bool | None:
        """Whether the perception tells what else is here; None while it is not loaded."""
        return self._inference.knows_classes

    @property
    def stopped(self) -> bool:
        """Whether it ends, or has ended."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """End the loop, from any thread or from `on_answer`."""
        self._stopped.set()
        self._events.put(None)

    def follow(self, queries: Sequence[str]) -> None:
        """Follow these queries from now on, from any thread. What is known of those that stay is kept."""
        self._events.put(QueriesChanged(self.clock.now(), tuple(queries)))

    # --- the two paces: of the clock, and of the perception ---

    def _paced(self) -> Iterator[Answer]:
        """Answers at ticks of the real time; events are taken in as they come."""
        self._trouble("perception", LOADING)
        self._perception = LatestWorker("perception", self._infer, self._load, self._perception_ended)
        warm(self._settings)  # while the perception is loaded
        if self._odometer is not None:
            self._seer = LatestWorker("visual poses", partial(self._see, self._odometer))
        if self.live:
            self._start_reading()
        next_tick, last = self.clock.now(), -math.inf
        while not self._stopped.is_set():
            self._take_events(next_tick)
            if self._fatal is not None:
                raise self._fatal
            if self._stopped.is_set():
                return
            workers_idle = self._perception.idle and (self._seer is None or self._seer.idle)
            over = self._over and workers_idle and self._events.empty()  # all of a recording has been looked at
            self._look_after()
            now = self.clock.now()
            if over:  # what was found meanwhile is told of the end, not of a later time that nobody has seen
                now = max(self._ended, last)
            if over or not self._over:
                last = now
                yield from self._taken(Tick(now))
            if over:
                return
            next_tick += (max(0, math.floor((now - next_tick) * self.rate)) + 1) / self.rate  # without those missed

    def _in_turn(self) -> Iterator[Answer]:
        """As fast as the perception looks at every picture; time is that of the recording."""
        frames = self._recorded
        assert frames is not None
        waits = getattr(self._camera, "waits", False)  # for what is said of its pictures: none is read ahead
        try:
            with closing((each for each in frames) if waits else prefetched(frames)) as ahead:
                for answer in answers_in_turn(self._drained(ahead), self.core, self._inference, self._taken, waits):
                    if self._stopped.is_set():
                        return
                    yield answer
        finally:
            self._drain()

    def _drained(self, frames: Iterable[PosedFrame]) -> Iterator[PosedFrame]:
        """The same, after what was posted while each of them was waited for."""
        for frame in frames:
            self._drain()
            yield frame

    def _drain(self) -> None:
        """Take in what has been posted, without waiting."""
        while not self._events.empty():
            if (event := self._events.get()) is not None:
                self._taken(replace(event, arrival=self._now))

    def _take_events(self, until: float) -> None:
        """Take in what comes until a time, and what is there then: an answer waits for no more than that."""
        while (left := until - self.clock.now()) > 0 and not self._stopped.is_set() and self._fatal is None:
            with suppress(Empty):
                self._received(self._events.get(timeout=left))
        for _ in range(self._events.qsize()):
            if self._stopped.is_set() or self._fatal is not None:
                return
            self._received(self._events.get())

    def _received(self, event: Event | None) -> None:
        if event is not None:
            self._taken(event)
        if isinstance(event, ObservationReceived):
            self._looks.release()

    def _taken(self, event: Event) -> list[Answer]:
        self._now = max(self._now, event.arrival)
        answers, counts = self.core.take(event), self.counts
        counts.frames += isinstance(event, ImageReceived)
        counts.poses += isinstance(event, PoseReceived)
        counts.looks += isinstance(event, ObservationReceived) and bool(event.looks)
        counts.answers += len(answers)
        for sink in self._sinks:
            sink.take(event, answers)
        return answers

    def _trouble(self, part: Part, text: str, about: str = "", passing: bool = False) -> None:
        self._events.put(Diagnostic(self.clock.now(), part, text, about, passing))

    def _look_after(self) -> None:
        """What nobody else notices: a stream that stalls, a source that says what is wrong with it."""
        now = self.clock.now()
        if self.live and now - self._last_frame > STALLED:
            self._last_frame = now
            self._frames.interrupt()
        for reader in filter(None, (self._frames, self._odometry)):
            if (problem := getattr(reader.source, "problem", None)) != self._problems.get(reader.name):
                self._problems[reader.name] = problem
                self._trouble(reader.name, problem or "", "itself")

    # --- in the threads ---

    def _load(self) -> None:
        """Load the perception; a recording begins then."""
        self._trouble("perception", self._inference.start())
        if not self.live:
            self._start_reading()

    def _start_reading(self) -> None:
        self._last_frame = self.clock.now()
        self._frames.start(None if self.live else self._played)
        if self.live and self._odometry is not None:
            self._odometry.start()

    def _played(self, _: CameraSource) -> Iterator[Frame]:
        """The frames of a recording, and its poses, when they are due: the first frame at once, all else by stamps."""
        begins: float | None = None
        for posed in self._recorded or ():
            frame = posed.frame
            if begins is None:
                begins, self._shift = frame.stamp, self.clock.now() - frame.stamp
            for pose in (*(each for each in posed.poses if each.stamp >= begins), None):
                stamp = frame.stamp if pose is None else pose.stamp
                if self._stopped.wait(max(0.0, stamp + self._shift - self.clock.now())):
                    return
                if pose is not None:
                    self._pose(pose)
            yield frame

    def _frame(self, frame: Frame) -> None:
        now = self._last_frame = self.clock.now()
        stamp, shown = frame.stamp + self._shift, frame.picture if self._sinks else None  # who else would hold it?
        self._events.put(ImageReceived(now, stamp, frame.name, shown, frame.grid, frame.problem))
        if frame.picture is None:
            return
        before = self._frozen.problem
        if self.live and self._frozen.take(frame.picture, stamp) != before:
            self._trouble("camera", self._frozen.problem, "frozen")
        if self._seer is not None:
            self._seer.give(frame)
        assert self._perception is not None
        self._perception.give(frame)
        if self._on_demand:
            self._perception.wait(ON_DEMAND)

    def _frames_ended(self, text: str) -> None:
        if text:
            self._trouble("camera", f"the recording ends early: {text}")
            if not self.counts.frames:
                self._fatal = ImageError(text)
        self._over, self._ended = True, self._last_frame

    def _pose(self, pose: Pose) -> None:
        self._events.put(PoseReceived(self.clock.now(), replace(pose, stamp=pose.stamp + self._shift)))

    def _see(self, odometer: VisualOdometer, frame: Frame) -> None:
        """Find how the camera has turned until a frame."""
        stamp, now, walked = frame.stamp + self._shift, self.clock.now, odometer.walks
        try:
            turned = odometer.add(frame.picture, stamp, frame.grid)
        except EagorError as error:
            self._trouble("poses", str(error))
            return
        if turned.lost:
            text = "a picture does not fit to those before it: the belief starts anew"
            self._events.put(OdometryReset(now(), text))
        if odometer.walks and not walked:
            self._trouble("poses", WALKS, passing=True)
        pose = Pose(stamp, np.asarray(turned.world_R_body), spread=turned.std, walks=odometer.walks)
        self._events.put(PoseReceived(now(), pose, of_picture=True))

    def _infer(self, frame: Frame) -> None:
        """Look at a frame for what the perception has not refused to look for."""
        stamp = frame.stamp + self._shift
        queries = [] if self.stopped else [query for query in self.core.queries if query not in self._refused]
        for found in self._inference.infer(frame, queries, self.core.orientation(stamp)) if queries else ():
            if self._stopped.is_set():
                return
            if found.refused and found.query is not None:
                self._refused.add(found.query)
                if all(query in self._refused for query in self.core.queries):
                    self._fatal = QueryError(found.problem)
            for event in found.events(self.clock.now(), stamp, frame.stamp):
                while isinstance(event, ObservationReceived) and not self._looks.acquire(timeout=ON_DEMAND):
                    if self._stopped.is_set():
                        return
                self._events.put(event)

    def _perception_ended(self, error: EagorError | None) -> None:
        self._inference.close()
        self._fatal = self._fatal or error
        self._events.put(None)

    def _close(self) -> None:
        """End threads and processes, let go of devices, finish the recording."""
        self._stopped.set()
        self._inference.kill()
        if self._perception is not None:
            self._perception.close()
            self.counts.skipped = self._perception.skipped + getattr(self._frames.source, "dropped", 0)
        self._inference.close()
        for thread in (self._frames, self._seer, self._odometry):
            if thread is not None:
                thread.close(LEAVING)
        for sink in self._sinks:
            sink.close()
