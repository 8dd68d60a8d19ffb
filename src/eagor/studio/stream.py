"""What a page watches: a loop over one source, in a process of its own, whose sink says what happens.

The server tells the process an `Opening`, which begins anew, or what a page that steers says; it says messages for the
pages. A source that is live is followed in real time. A recording is looked at picture by picture, no faster than it
was taken, and its last picture stays.
"""

from __future__ import annotations

import itertools
import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, cast

import numpy as np

from eagor.errors import EagorError
from eagor.live.events import Answer, Diagnostic, Event, ImageReceived, ObservationReceived, PoseReceived
from eagor.live.loop import LOADING, Loop
from eagor.live.threads import already_open
from eagor.sources import Frame
from eagor.sources.camera_sources import Footage, open_source
from eagor.sources.intrinsics import ShapeError
from eagor.sources.odometry import poses_for
from eagor.studio.answers import belief_of, evidence_of, lens_of, picture_of, plan_of, scene_of, step_of
from eagor.studio.messages import Ask, Drive, Message, Opening, Pause, Restart, rounded
from eagor.tracking import TrackerConfig

__all__ = ["PacedFootage", "Stream", "StudioSink", "serve"]

RATE = 10.0  # answers per second of a live source
LOOKS = 4.0  # pictures of a video per second that are looked at, at most
ROWS = 960  # of panoramas that are looked at, at most; those of walks have rows of their own
SHOWN_ROWS, FINE_ROWS, ORDINARY_ROWS = 512, 1024, 480  # of what is sent, at most: fine where the camera may stand
FLOOR = 0.0  # metres: the height of the floor in the built-in world
PICTURES = 0.2  # seconds between two pictures that are sent, at least
WAITING = 6  # pictures that wait for their pose, at least half of `PICTURES` apart
LATE = 1.0  # seconds after which a picture is shown without
AGAIN = 0.5  # seconds of the recording from its last picture to the same one again


class PacedFootage(Footage):
    """A recording for people: no faster than it was taken. It can pause, and its last picture comes again if wanted."""

    waits = True

    def __init__(self, source: Footage) -> None:
        vars(self).update(vars(source))
        self._changed = threading.Condition()
        self._paused = self._wanted = False

    def __iter__(self) -> Iterator[Frame]:
        begun, last = -math.inf, None
        for frame in super().__iter__():
            begun = max(begun, time.monotonic() - frame.stamp)  # what takes long delays all that follows
            if not self._wait(begun + frame.stamp):
                return
            last = frame
            yield frame
        while last is not None and self._wait(math.inf):
            last = replace(last, stamp=last.stamp + AGAIN)
            yield last

    def _wait(self, until: float) -> bool:
        """Wait until then, on `time.monotonic`, and while paused, unless a picture is wanted; False once closed."""
        with self._changed:
            while not (self.closed or self._wanted):
                left = math.inf if self._paused else until - time.monotonic()
                if left <= 0:
                    break
                self._changed.wait(None if math.isinf(left) else left)
            self._wanted = False
            return not self.closed

    def pause(self, on: bool) -> None:
        """Stand still, or go on, with a picture at once: somebody wants to see."""
        with self._changed:
            self._paused, self._wanted = on, not on
            self._changed.notify_all()

    def close(self) -> None:
        with self._changed:
            self.closed = True
            self._changed.notify_all()


class StudioSink:
    """A sink of the loop that says what happens, as messages for the pages: `say` is called with each.

    A new query is looked for beside the one that is answered, and takes its place with the first look for it: one that
    is refused changes nothing. Every answer carries the number of its question. `whole`: each has the belief, also
    where that was only turned.
    """

    loop: Any  # set once it is made

    def __init__(self, say: Callable[[Message], Any], opening: Opening, source: Any, whole: bool = False) -> None:
        self._say, self._opening, self._source, self._whole = say, opening, source, whole
        self._lock = threading.Lock()  # questions come in a thread of their own
        self._numbers = itertools.count(1)
        self._asked: tuple[str, int] = opening.query or getattr(source, "query", ""), opening.question
        self.next: tuple[str, int] | None = None  # what is looked for in its place
        self._begun, self._ended, self._fresh = False, False, False
        self._frames: deque[ImageReceived] = deque(maxlen=WAITING)  # those that wait for their pose
        self._lens: dict[str, Any] | None = None  # of an ordinary camera
        self._position: np.ndarray | None = None
        self._answer: Answer | None = None  # the newest
        self._look: ObservationReceived | None = None  # the newest that has not been sent
        self._shown: Any = None  # the belief that was sent last,
        self._picture: np.ndarray | None = None  # the picture,
        self._sent = -math.inf  # and when

    @property
    def query(self) -> str:
        """What is answered."""
        return self._asked[0]

    def ask(self, query: str, number: int) -> None:
        """Look for something else, too, until it is seen or refused; then for one of the two alone."""
        with self._lock:
            self._refused("something else was asked before this could be looked for")
            self.next = query, number
            if self._ended:
                self._refused(f"{self._opening.title} has ended: nothing more can be looked for in it")
                return
        self.loop.follow([*dict.fromkeys((self.query, query))])
        if hasattr(self._source, "pause"):  # who asks wants to see
            self._source.pause(False)

    def _refused(self, problem: str) -> None:
        """Say why the newest question is not answered; the one before goes on."""
        if self.next is not None:
            self._say(Message.problem(problem, question=self.next[1]))
        self.next = None

    def _tried(self, event: Event, answers: Sequence[Answer]) -> None:
        """Take up a new query with the first look for it; drop one that cannot be looked for."""
        if self.next is None:
            return
        query = self.next[0]
        seen = any(each.query == query and math.isfinite(each.look_age) for each in answers)
        if seen or (isinstance(event, ObservationReceived) and event.query == query):
            self._asked, self.next = self.next, None
            self._scene()
        elif isinstance(event, Diagnostic) and event.part == "perception" and event.about == query and event.text:
            self._refused(event.text)
        else:
            return
        self.loop.follow([self.query])

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop, and the answers to it."""
        with self._lock:
            self._tried(event, answers)
        if isinstance(event, ImageReceived) and event.picture is not None:
            self._frame(event)
        elif isinstance(event, PoseReceived):
            self._position = event.pose.position
        elif isinstance(event, ObservationReceived) and event.looks and event.query == self.query:
            self._fresh, self._look = True, event
        for answer in answers:
            placed = not self._opening.simulated or self._position is not None
            if answer.query == self.query and placed:
                self._say_answer(answer)

    def close(self) -> None:
        """The loop has ended."""
        with self._lock:
            self._ended = True
            self._refused(f"{self._opening.title} has ended")

    def _frame(self, frame: ImageReceived) -> None:
        if (lens := lens_of(frame.grid)) != self._lens:
            self._lens, self._begun = lens, False
        if self._paused or not self._frames or frame.arrival - self._frames[-1].arrival >= PICTURES / 2:
            self._frames.append(frame)
        if self._paused and self._answer is not None:  # no more answers come, but a finer picture
            self._say_answer(self._answer)

    @property
    def _paused(self) -> bool:
        """Whether time stands still."""
        return bool(getattr(getattr(self._source, "clock", None), "paused", False))

    def _taken(self, now: float) -> ImageReceived | None:
        """The newest picture whose pose is known; after `LATE` seconds, or while all stands still, the newest.

        One that is shown before its pose is known would be drawn where the camera pointed before.
        """
        frames = self._frames
        count = max((k + 1 for k, each in enumerate(frames) if self.loop.core.posed(each.stamp)), default=0)
        if not count and frames and (self._paused or now - frames[0].arrival > LATE):
            count = len(frames)
        taken = [frames.popleft() for _ in range(count)]
        return taken[-1] if taken and taken[-1].picture is not self._picture else None

    def _orientation(self, stamp: float) -> np.ndarray | None:
        """`world_R_body` ``(3, 3)`` at the picture of this stamp, if known; a camera that stands has the world's."""
        return self.loop.core.orientation(stamp) if self.loop.core.has_poses else np.eye(3)

    def _say_answer(self, answer: Answer) -> None:
        """A step: what is believed, and what is new of belief, look and picture."""
        self._answer, estimate, simulated = answer, answer.estimate, self._opening.simulated
        if not self._begun:
            self._begun, self._shown = True, None
            self._scene()
        truth, goal = self._source.truth(answer.query, estimate.world_R_body.T) if simulated else (None, None)
        faults = [] if simulated else [each.text for each in answer.faults if each.text != LOADING]
        header = {
            "type": "step", "number": next(self._numbers), "sent": time.time(), "question": self._asked[1],
            **step_of(estimate, answer.stamp, self._position, truth), "goal": rounded(goal, 3), "faults": faults,
            "look": {"age": rounded(answer.look_age, 3), "fresh": self._fresh},
        }  # fmt: skip
        self._fresh, blobs = False, dict[str, bytes]()
        if self._whole or estimate.hypotheses is not self._shown:  # computed anew, not only turned
            self._shown = estimate.hypotheses
            header["belief"], heat = belief_of(estimate)
            blobs |= {"belief": heat} if heat else {}
        if self._look is not None and (pose := self._orientation(self._look.stamp)) is not None:
            look, self._look = self._look.looks[0], None
            header["evidence"], blobs["evidence"] = {}, evidence_of(look, pose)
        soon = answer.stamp - self._sent < PICTURES and not self._paused
        if not soon and (frame := self._taken(answer.stamp)) is not None and frame.picture is not None:
            self._sent, self._picture = answer.stamp, frame.picture
            pose = self._orientation(frame.stamp)
            pose = estimate.world_R_body if pose is None else pose
            header["panorama"] = rounded({"stamp": frame.stamp, "world_R_camera": pose.reshape(9)}, 6)
            fine = FINE_ROWS if simulated or self._opening.poses == "still" else SHOWN_ROWS
            rows = fine if frame.grid is None else ORDINARY_ROWS
            blobs["panorama"] = picture_of(frame.picture, frame.grid, rows)
        self._say(Message(header, blobs))

    def _scene(self) -> None:
        opening, source, (query, number) = self._opening, self._source, self._asked
        about: dict[str, Any] = {"question": number, "perception": opening.perception, "lens": self._lens}
        about["pauses"] = hasattr(source, "pause") and opening.poses != "still"
        if opening.simulated:
            about |= {"targets": source.names, "plan": plan_of(source.place, source.targets(query))}
            about |= {"seed": source.seed, "drive": source.walker.by}
        self._say(Message({"type": "scene", **scene_of(opening.title, query, **about)}))


class Stream:
    """The life of a process that shows one source after the other: what it is told, and what it says."""

    def __init__(self, line: Connection) -> None:
        self._line, self._saying = line, threading.Lock()
        self._openings: SimpleQueue[Opening | None] = SimpleQueue()
        self._opening: Opening | None = None
        self._sink: StudioSink | None = None
        self._source: Any = None

    def run(self) -> None:
        """Until the line ends."""
        threading.Thread(target=self._listen, daemon=True).start()
        while (opening := self._openings.get()) is not None:
            self._opening = opening
            self._say(Message.status(f"Opening {opening.title}."))
            try:
                self._play(opening)
                self._say(Message.status(f"{opening.title} has ended."))
            except (EagorError, OSError) as error:
                words = " ".join(str(error).replace(opening.source, opening.title).split()).partition("; ")
                asked = self._sink.next if self._sink and self._sink.next else (opening.query, opening.question)
                more = {"asks": "hfov"} if isinstance(error, ShapeError) else {}
                self._say(Message.problem(words[0], words[2], True, asked[1], **more))
            finally:
                self._sink = self._source = None

    def _play(self, opening: Opening) -> None:
        """Follow a source until it ends, or something else is to be shown."""
        how: dict[str, Any] = {}
        if not opening.simulated:
            rate = LOOKS if os.path.isfile(opening.source) else None
            how = {"rows": ROWS, "rig": opening.rig, "rate": rate, "camera": opening.camera}
        again = partial(open_source, opening.source, **how)
        with closing(again()) as source:
            if not self._openings.empty():
                return
            poses, live = poses_for(opening.poses, source), source.live
            self._source = source if live else PacedFootage(cast(Footage, source))
            sink = StudioSink(self._say, opening, self._source)
            shown = already_open(source, again) if live and not opening.simulated else self._source
            config = TrackerConfig(floor_height=FLOOR if opening.simulated else None)
            sink.loop = loop = Loop(
                shown, poses, opening.perception, sink.query, live, [sink], rate=RATE, config=config,
                clock=getattr(source, "clock", None),
            )  # fmt: skip
            self._sink = sink
            loop.run(lambda _: None)

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._obey(self._line.recv())
        self._begin(None)

    def _obey(self, order: Opening | Ask | Drive | Pause | Restart) -> None:
        opening, sink, source = self._opening, self._sink, self._source
        if isinstance(order, Opening):
            self._begin(order)
        elif isinstance(order, Ask) and opening is not None:
            perception = order.perception or opening.perception
            if sink is not None and perception == opening.perception:
                sink.ask(order.query, order.question)
            else:
                self._begin(replace(opening, query=order.query, perception=perception, question=order.question))
        elif isinstance(order, Restart) and opening is not None:
            self._begin(opening if sink is None else replace(opening, query=sink.query))
        elif isinstance(order, Pause) and hasattr(source, "pause"):
            source.pause(order.on)
        elif isinstance(order, Drive) and hasattr(source, "drive"):
            source.drive(order.by, order.forward, order.turn, order.seconds)

    def _begin(self, opening: Opening | None) -> None:
        """Begin with something else, or end."""
        self._openings.put(opening)
        if self._sink is not None:
            self._sink.loop.stop()
        if self._source is not None:
            self._source.close()

    def _say(self, message: Message) -> None:
        with self._saying, suppress(OSError):
            self._line.send(message)


def serve(line: Connection) -> None:
    """The life of the process."""
    Stream(line).run()
