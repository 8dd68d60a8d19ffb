"""The live loop: a camera, poses and a perception at their own rates; answers at a steady one."""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Protocol, runtime_checkable

from eagor._checks import above
from eagor.errors import EagorError, ImageError, QueryError, TimeError
from eagor.evidence import BodyMask
from eagor.live.core import LiveCore, LoopSettings, warm
from eagor.live.events import Answer, Asked, Event, EvidenceCame, Following, FrameCame, Part, PoseCame, Trouble
from eagor.live.in_turn import answers_in_turn
from eagor.live.inference import PATIENCE, Failed, Inference, InferenceWorker, Looked, why_here
from eagor.live.recording import Pictures, Recorder
from eagor.live.threads import (
    FrozenCamera,
    LoopClock,
    Pace,
    PerceptionThread,
    Picture,
    Reader,
    VisualPosesThread,
    opener,
    paced_frames,
    paced_poses,
)
from eagor.media import CameraSource, Frame, Pose, PoseSource
from eagor.media.camera_sources import open_source
from eagor.media.odometry import poses_for
from eagor.media.posed_frames import PosedFrame, PosedFrames, prefetched
from eagor.odometry.visual import VisualOdometer
from eagor.perception import Perception, as_perception
from eagor.perception.recordings import RecordedLooks
from eagor.tracking import TrackerConfig

__all__ = ["LOADING", "Counts", "Loop", "Sink"]

RATE = 20.0  # answers per second
STALLED = 10.0  # seconds without a picture after which a stream is opened again
SLIPPED = 0.1  # seconds by which this machine's clock is set before it is worth a word
LONGEST_LATE = 60.0  # seconds: evidence may come so late, if the perception has the patience
ON_DEMAND = 0.2  # seconds between pictures while the perception is busy
LEAVING = 5.0  # seconds that threads have to come back from a device
LOADING = "the perception is being loaded"  # a fault until it is

Source = str | CameraSource | Callable[[], CameraSource]
Poses = str | PoseSource | Callable[[], PoseSource] | VisualOdometer | None


@runtime_checkable
class Sink(Protocol):
    """Sees all that comes into the loop and out of it, in the loop's thread: a recording, a viewer."""

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event, and the answers to it (none unless it is `Asked`). Must be quick."""
        ...

    def close(self) -> None:
        """The loop has ended."""
        ...


@dataclass
class Counts:
    """What has happened so far.

    `frames`, `poses` came; `looks`: at a picture for one query; `skipped`: pictures that the perception did not come
    to, or the camera dropped; `answers` given; `late`: ticks that were missed.
    """

    frames: int = 0
    poses: int = 0
    looks: int = 0
    skipped: int = 0
    answers: int = 0
    late: int = 0


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
        numbers = ("rate", rate), ("looks", looks), ("patience", patience), ("acceleration", acceleration)
        for name, value in numbers:
            if value is not None and not above(value, 0):
                raise TimeError(f"{name} = {value!r}; wanted a number above 0")
        queries = (queries,) if isinstance(queries, str) else tuple(queries)
        if not queries:
            raise QueryError("there is no query; say what to look for, such as 'red chair'")
        perception = as_perception(perception)
        self.clock, self.counts = clock or LoopClock(), Counts()
        self._events: SimpleQueue[Event | None] = SimpleQueue()
        self._stopped = threading.Event()
        reopen, opened = opener(partial(open_source, source) if isinstance(source, str) else source)
        self._camera: CameraSource = opened if reopen is None else reopen()
        self.live = self._camera.live
        self.rate, self.realtime = rate, realtime or self.live
        try:
            poses = poses_for(poses, self._camera) if isinstance(poses, str) else poses
        except BaseException:
            self._camera.close()
            raise
        self._odometer = poses if isinstance(poses, VisualOdometer) else None
        self._frames, self._odometry = self._readers(reopen, poses)
        config = config or TrackerConfig()
        config = replace(config, history=max(config.history, min(patience, LONGEST_LATE)))  # evidence may come so late
        recorded = isinstance(self._camera, RecordedLooks)
        self._settings = LoopSettings(
            queries, config, poses is not None or recorded, self._camera.latency, acceleration,
            extrapolate, exact=not self.realtime,
        )  # fmt: skip
        self.core = LiveCore(self._settings)
        self.frames: PosedFrames | None = None  # of a recording that is looked at in turn
        if not (self.realtime or recorded):
            odometry = None if self._odometry is None else self._odometry.opened()
            say = partial(self._trouble, "poses", passing=True)
            self.frames = PosedFrames(self._camera, self._odometer or odometry, looks, say)
        masks = [each for each in (mask, _mask_of(self._camera)) if each is not None]
        own_process = self.realtime
        if own_process and (why := why_here(perception)):
            own_process = False
            warnings.warn(
                f"the perception works in this process, where nothing ends it if it hangs: {why}. A function at the "
                "top of a file can have a process of its own",
                stacklevel=2,
            )
        self._inference: Inference | InferenceWorker = (
            InferenceWorker(perception, patience=patience, masks=masks)
            if own_process
            else Inference(perception, masks=masks, say=partial(self._trouble, "camera", passing=True))
        )
        self._recorder: Recorder | None = None
        if record is not None:
            self._recorder = Recorder(record, self._settings, partial(self._trouble, "recording"), pictures)
        self._sinks: list[Sink] = [*sinks, *([] if self._recorder is None else [self._recorder])]
        if isinstance(self._camera, Sink):  # a simulated body follows the answers to its pictures
            self._sinks.insert(0, self._camera)
        self._perception: PerceptionThread | None = None
        self._seer: VisualPosesThread | None = None
        # A source that keeps the newest picture itself makes it a panorama when asked: not more often than needed.
        keeps_newest = getattr(self._camera, "keeps_newest", False)
        self._on_demand = keeps_newest and self._odometer is None and record is None
        self._last_frame = self.clock.now()  # its arrival
        self._over, self._ended = False, -math.inf  # whether a recording has, and when its last picture came
        self._fatal: EagorError | None = None
        self._refused: set[str] = set()
        self._slip, self._now = 0.0, -math.inf
        self._problems: dict[Part, str | None] = {}  # what the camera and the odometry say of themselves
        self._frozen, self._froze = FrozenCamera(self.core.orientation), ""  # and what was said of it last

    def _readers(
        self, reopen: Callable[[], CameraSource] | None, poses: Any
    ) -> tuple[Reader[tuple[Frame, float]], Reader[Pose] | None]:
        """The threads that read the camera, and the odometry if there is one; a recording at its own speed."""
        pace = Pace(self.clock, self._stopped)
        frames = Reader(
            "camera",
            self._camera,
            reopen,
            items=_as_told if self.live else partial(paced_frames, pace=pace),
            again=self.live,
            give=self._frame,
            trouble=partial(self._trouble, "camera"),
            ended=self._frames_ended,
        )
        if poses is None or poses is self._odometer:
            return frames, None
        open_poses, opened = opener(poses)
        return frames, Reader(
            "poses",
            opened,
            open_poses,
            items=iter if self.live else partial(paced_poses, pace=pace),
            again=self.live,
            give=lambda pose: self._post(PoseCame(self.clock.now(), pose)),
            trouble=partial(self._trouble, "poses"),
            ended=lambda text: self._trouble("poses", text) if text else None,
        )

    def __iter__(self) -> Iterator[Answer]:
        """The answers, until the source ends or `stop` is called: at each tick one per query, in their order."""
        try:
            yield from self._paced() if self.realtime else self._in_turn()
        finally:
            self._close()

    def run(self, on_answer: Callable[[Answer], Any]) -> None:
        """Call `on_answer` with every answer until the source ends or `stop` is called."""
        answers = iter(self)
        try:
            for answer in answers:
                on_answer(answer)
        finally:
            answers.close()  # type: ignore[attr-defined]

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
        self._post(Following(self.clock.now(), tuple(queries)))

    def _paced(self) -> Iterator[Answer]:
        """Answers at ticks of the real time; events are taken in as they come."""
        self._begin()
        next_tick, last = self.clock.now(), -math.inf
        while not self._stopped.is_set():
            self._take_events(next_tick)
            if self._fatal is not None:
                raise self._fatal
            if self._stopped.is_set():
                return
            over = self._is_over()
            self._look_after()
            now = self.clock.now()
            if over:  # what was found meanwhile is told of the end, not of a later time that nobody has seen
                now = max(self._ended, last)
            if over or not self._over:
                last = now
                yield from self._taken(Asked(now))
            if over:
                return
            missed = max(0, math.floor((now - next_tick) * self.rate))
            self.counts.late += missed
            next_tick += (missed + 1) / self.rate

    def _begin(self) -> None:
        self._trouble("perception", LOADING)
        self._perception = PerceptionThread(
            self._inference,
            self.core.queries,
            found=self._found,
            ready=self._ready,
            ended=self._perception_ended,
            pose=self.core.orientation,
        )
        warm(self._settings)  # while the perception is loaded
        if self._odometer is not None:
            self._seer = VisualPosesThread(self._odometer, self._post, self.clock.now)
        if self.live:
            self._start_reading()

    def _ready(self) -> None:
        """The perception is loaded: a recording begins now."""
        self._trouble("perception", "")
        if not self.live:
            self._start_reading()

    def _start_reading(self) -> None:
        self._last_frame = self.clock.now()
        self._frames.start()
        if self._odometry is not None:
            self._odometry.start()

    def _in_turn(self) -> Iterator[Answer]:
        """As fast as the perception looks at every picture; time is that of the recording."""
        frames = self._camera.posed if isinstance(self._camera, RecordedLooks) else self.frames
        assert frames is not None
        assert isinstance(self._inference, Inference)
        waits = getattr(self._camera, "waits", False)  # for what is said of its pictures: none is read ahead
        ahead = self._drained(frames) if waits else prefetched(frames)
        try:
            for answer in answers_in_turn(ahead, self.core, self._inference, self._taken, waits):
                self._drain()
                if self._stopped.is_set():
                    return
                yield answer
        finally:
            ahead.close()
            self._drain()

    def _drained(self, frames: Iterable[PosedFrame]) -> Generator[PosedFrame, None, None]:
        """The same, after what was posted while each of them was waited for."""
        for frame in frames:
            self._drain()
            yield frame

    def _drain(self) -> None:
        """Take in what has been posted, without waiting."""
        while not self._events.empty():
            if (event := self._events.get()) is not None:
                self._taken(replace(event, arrival=self._now))
        if self._fatal is not None:
            raise self._fatal

    def _take_events(self, until: float) -> None:
        """Take in what comes until a time, and all that is there then."""
        while not self._stopped.is_set() and self._fatal is None:
            left = until - self.clock.now()
            try:
                event = self._events.get(timeout=left) if left > 0 else self._events.get_nowait()
            except Empty:
                if left > 0:  # a clock may be slower than the time that was waited
                    continue
                return
            if event is not None:
                self._taken(event)

    def _taken(self, event: Event) -> list[Answer]:
        self._now = max(self._now, event.arrival)
        answers = self.core.take(event)
        self._count(event, len(answers))
        for sink in self._sinks:
            sink.take(event, answers)
        return answers

    def _count(self, event: Event, answers: int) -> None:
        match event:
            case FrameCame():
                self.counts.frames += 1
            case PoseCame():
                self.counts.poses += 1
            case EvidenceCame():
                self.counts.looks += bool(event.looks)
            case Asked():
                self.counts.answers += answers
            case Following():
                if self._perception is not None:
                    self._perception.queries = event.queries

    def _post(self, event: Event) -> None:
        self._events.put(event)

    def _trouble(self, part: Part, text: str, passing: bool = False) -> None:
        self._post(Trouble(self.clock.now(), part, text, passing=passing))

    def _look_after(self) -> None:
        """What nobody else notices: a stream that stalls, this machine's clock being set."""
        now = self.clock.now()
        if self.live and now - self._last_frame > STALLED:
            self._last_frame = now
            self._frames.interrupt()
        for reader in filter(None, (self._frames, self._odometry)):
            if (problem := getattr(reader.source, "problem", None)) != self._problems.get(reader.name):
                self._problems[reader.name] = problem
                self._post(Trouble(now, reader.name, problem or "", "itself"))
        slip = self.clock.slip()
        if abs(slip - self._slip) > SLIPPED:
            way = "forward" if slip > self._slip else "back"
            text = f"this machine's clock was set {way} by {abs(slip - self._slip):.2f} s; the loop's goes on as it was"
            self._slip = slip
            self._trouble("clock", text, passing=True)

    def _is_over(self) -> bool:
        """Whether a recording has ended, and all of it has been looked at."""
        if not self._over or (self._seer is not None and not self._seer.done):
            return False
        return self._perception is not None and self._perception.idle and self._events.empty()

    def _frames_ended(self, text: str) -> None:
        if text:
            self._trouble("camera", f"the recording ends early: {text}")
            if not self.counts.frames:
                self._fatal = ImageError(text)
        if self._seer is not None:
            self._seer.pictures.end()
        self._over, self._ended = True, self._last_frame

    def _frame(self, item: tuple[Frame, float]) -> None:
        frame, told = item
        self._last_frame = self.clock.now()
        shown = frame.picture if self._sinks else None  # who else would hold on to it?
        self._post(FrameCame(self._last_frame, frame.stamp, frame.name, shown, frame.grid, frame.problem))
        if frame.picture is None:
            return
        if self.live:
            before, self._froze = self._froze, self._frozen.take(frame.picture, frame.stamp)
            if self._froze != before:
                self._post(Trouble(self._last_frame, "camera", self._froze, "frozen"))
        picture = Picture(frame.stamp, told, frame.picture, frame.grid, frame.unseen)
        if self._seer is not None:
            self._seer.pictures.give(picture)
        assert self._perception is not None
        self._perception.pictures.give(picture)
        if self._on_demand:
            self._perception.pictures.wait(ON_DEMAND)

    def _found(self, picture: Picture | None, said: Looked | Failed) -> None:
        """What the perception says."""
        now = self.clock.now()
        if isinstance(said, Looked) and picture is not None:
            self._post(EvidenceCame(now, picture.stamp, picture.told, said.query, said.looks, said.seconds))
            self._post(Trouble(now, "perception"))
            self._post(Trouble(now, "perception", about=said.query))
        elif isinstance(said, Failed):
            if said.refused and said.query is not None:
                self._refused.add(said.query)
                if all(query in self._refused for query in self.core.queries):
                    self._fatal = QueryError(said.text)
            self._post(Trouble(now, "perception", said.text, said.query or ""))

    def _perception_ended(self, error: EagorError | None) -> None:
        self._fatal = self._fatal or error
        self._events.put(None)

    def _close(self) -> None:
        """End threads and processes, let go of devices, finish the recording."""
        self._stopped.set()
        if self._perception is not None:
            self._perception.stop()
            self.counts.skipped = self._perception.pictures.skipped + getattr(self._frames.source, "dropped", 0)
        self._inference.close()
        self._frames.close(LEAVING)
        if self._seer is not None:
            self._seer.close(LEAVING)
        if self._odometry is not None:
            self._odometry.close(LEAVING)
        for sink in self._sinks:
            sink.close()


def _as_told(source: CameraSource) -> Iterator[tuple[Frame, float]]:
    for frame in source:
        yield frame, frame.stamp


def _mask_of(camera: CameraSource) -> BodyMask | None:
    """What no picture of a camera shows, if it says so."""
    unseen = getattr(camera, "unseen", None)
    return None if unseen is None or not unseen.any() else BodyMask(~unseen)
