"""A live source for the page: one loop for all who watch it, in a process of its own."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from eagor.drawing import Mosaic
from eagor.errors import EagorError
from eagor.live.core import LiveCore
from eagor.live.events import Answer, Event, EvidenceCame, FrameCame, PoseCame, PosesLost, Trouble
from eagor.live.loop import Loop, Sink
from eagor.media.intrinsics import ShapeError
from eagor.studio.messages import Blob, Message, rounded
from eagor.studio.steps import (
    FLOATS,
    Listing,
    belief_of,
    believed,
    calibration_of,
    lens_of,
    scene_of,
    shown_jpeg,
    small_jpeg,
)

__all__ = ["Shown", "Waiting", "watch"]

PICTURES = 0.2  # seconds between two panoramas that are sent, at least; also between rows of what else is here
ROWS = 384  # of them, at most
ORDINARY = 480  # rows of an ordinary camera's picture
PASTED, UNSEEN = 256, (20, 23, 29)  # rows of what several cameras show together; where none has looked
WAITING = 6  # pictures that wait for their pose, at least half of `PICTURES` apart
LATE = 1.0  # seconds after which a picture is shown without


class Waiting:
    """Pictures that wait for their pose: one that is shown before it would be drawn where the camera pointed before."""

    def __init__(self) -> None:
        self._frames: deque[FrameCame] = deque(maxlen=WAITING)

    def add(self, frame: FrameCame) -> None:
        """A picture has come."""
        if not self._frames or frame.arrival - self._frames[-1].arrival >= PICTURES / 2:
            self._frames.append(frame)

    def take(self, core: LiveCore, now: float) -> FrameCame | None:
        """The newest picture whose pose is known; after `LATE` seconds, the newest. None: there is none yet."""
        frames = self._frames
        last = max((number for number, each in enumerate(frames) if core.posed(each.stamp)), default=-1)
        if last < 0 and frames and now - frames[0].arrival > LATE:
            last = len(frames) - 1
        taken = [frames.popleft() for _ in range(last + 1)]
        return taken[-1] if taken else None


class Shown:
    """A sink of the loop that says what happens, as messages for the page: `say` is called with each.

    The pictures of several cameras are looked at one by one, and shown pasted together where they looked.
    """

    def __init__(self, say: Callable[[Message], Any], source: str, perception: str) -> None:
        self._say, self._source, self._perception = say, source, perception
        self._waiting: dict[int, Waiting] = {}  # by lens
        self._mosaic: Mosaic | None = None  # what several cameras have shown
        self._sent = -math.inf
        self._position: np.ndarray | None = None
        self._fresh = False
        self._shown: Any = None  # the belief that was sent last
        self._asked: tuple[str, int] | None = None  # the query that is answered, and the number of its question
        self._next: tuple[str, int] | None = None  # what is looked for in its place
        self._lens: dict[str, Any] | None = None  # of an ordinary camera
        self._ended = False
        self.loop: Any = None
        self._listing, self._listed = Listing(), -math.inf  # of what else is here, and when it was renewed
        self._lock = threading.Lock()  # questions come in a thread of their own

    def ask(self, query: str, number: int) -> None:
        """Look for something else, too, until it is seen or refused; then for one of the two alone."""
        with self._lock:
            if self._next is not None:
                self._refused(f"Before {self._next[0]!r} could be looked for, something else was asked.")
            self._next = query, number
            if self._ended:
                self._refused(f"{self._source} has ended: nothing more can be looked for in it.")
                return
            self.loop.follow([*([self._asked[0]] if self._asked else self.loop.core.queries[:1]), query])

    def _refused(self, problem: str) -> None:
        """Say why the newest question is not answered; the one before goes on."""
        if self._next is not None:
            said = {"problem": problem, "change": "", "fatal": False, "question": self._next[1]}
            self._say(Message({"type": "problem", **said}))
        self._next = None

    def _tried(self, event: Event, answers: Sequence[Answer]) -> None:
        """Take up a new query with the first look for it, at once if it was seen before; drop one that cannot be."""
        asked = self._next
        if asked is None or self._asked is None:
            return
        known = any(each.query == asked[0] and math.isfinite(each.look_age) for each in answers)
        if known or (isinstance(event, EvidenceCame) and event.query == asked[0]):
            self._asked, self._next = asked, None
            self._scene()
        elif isinstance(event, Trouble) and event.part == "perception" and event.about == asked[0] and event.text:
            self._refused(f"{event.text[:1].upper()}{event.text[1:]}.")
        else:
            return
        self.loop.follow([self._asked[0]])

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop, and the answers to it."""
        with self._lock:
            self._tried(event, answers)
        if isinstance(event, FrameCame) and event.picture is not None:
            self._waiting.setdefault(event.lens, Waiting()).add(event)
            if len(self._waiting) > 1 and self._mosaic is None:
                self._mosaic = Mosaic(PASTED)
            lens = lens_of(event.grid) if self._mosaic is None else None
            if lens != self._lens:
                self._lens = lens
                if self._asked is not None:
                    self._scene()
        elif isinstance(event, PoseCame):
            self._position = event.pose.position
        elif isinstance(event, PosesLost) and self._mosaic is not None:
            self._mosaic = Mosaic(PASTED)
        elif isinstance(event, EvidenceCame):
            self._fresh = True
        for answer in answers:
            if self._asked is None:
                self._asked = answer.query, 0
                self._scene()
            if answer.query == self._asked[0]:
                self._answered(answer, self._asked[1])

    def close(self) -> None:
        """The loop has ended."""
        with self._lock:
            self._ended = True
            self._refused(f"{self._source} has ended.")
        self._say(Message({"type": "status", "words": f"{self._source} has ended."}))

    def _answered(self, answer: Answer, number: int) -> None:
        estimate = answer.estimate
        header: dict[str, Any] = {
            "type": "step",
            "question": number,
            **believed(estimate, answer.stamp, self._position),
            "rivals": {},
            "goal": None,
            "faults": [fault.text for fault in answer.faults],
        }
        header["look"] = {"age": rounded(answer.look_age, 3), "fresh": self._fresh}
        self._fresh = False
        blobs: dict[str, Blob] = {}
        if estimate.hypotheses is not self._shown:  # computed anew, not only turned
            self._shown = estimate.hypotheses
            header["belief"], coefficients = belief_of(estimate, answer.stamp, estimate.config.degree)
            blobs["belief"] = Blob(FLOATS, coefficients)
        around = self.loop.core.around
        if around is not None and around.names and answer.stamp - self._listed >= PICTURES:
            self._listed, header["things"] = answer.stamp, self._listing.renew(around, answer.stamp)
        soon = answer.stamp - self._sent < PICTURES
        if not soon and (found := self._pictured(answer)) is not None:
            self._sent, (pose, picture) = answer.stamp, found
            header["panorama"] = {"stamp": rounded(answer.stamp), "world_R_camera": rounded(pose.reshape(9), 6)}
            blobs["panorama"] = Blob("image/jpeg", picture)
        self._say(Message(header, blobs))

    def _pictured(self, answer: Answer) -> tuple[np.ndarray, bytes] | None:
        """The newest picture, and the orientation ``(3, 3)`` that it was taken with; None if there is no new one."""
        core, pose = self.loop.core, answer.estimate.world_R_body
        taken = [each for each in (lens.take(core, answer.stamp) for lens in self._waiting.values()) if each]
        for frame in taken:
            known = core.orientation(frame.stamp)
            pose = answer.estimate.world_R_body if known is None else known
            assert frame.picture is not None
            if self._mosaic is None:
                return pose, shown_jpeg(frame.picture, frame.grid, ROWS if frame.grid is None else ORDINARY)
            if frame.grid is not None:
                self._mosaic.add(frame.picture, frame.grid, pose)
        if not taken or self._mosaic is None:
            return None
        return pose, small_jpeg(self._mosaic.seen_from(pose, UNSEEN), ROWS)

    def _scene(self) -> None:
        assert self._asked is not None
        query, number = self._asked
        config = self.loop.core.config
        calibrated = calibration_of(None, config)
        about = {"question": number, "degree": config.degree, "perception": self._perception, "calibration": calibrated}
        about |= {} if self._lens is None else {"lens": self._lens}
        self._say(Message({"type": "scene", **scene_of("live", self._source, query, **about)}))


def watch(
    line: Connection,
    source: str,
    perception: str,
    opens: Callable[[Sequence[Sink], float | None], Loop],
) -> None:
    """Run the loop that `opens` makes and say what happens, until the line or the parent ends.

    It is told ``("query", text, number)``: the number of the question, which answers carry. What cannot be opened is
    said as a fatal problem. Where the pictures are those of an ordinary camera of which nothing is known, the page is
    asked; it is told ``("hfov", degrees)``, which `opens` gets (None at first).
    """
    lock = threading.Lock()

    def say(message: Message) -> None:
        with lock, suppress(OSError):
            line.send(message)

    shown = Shown(say, source, perception)
    loop, hfov = None, None
    while loop is None:
        try:
            loop = opens([shown], hfov)
        except ShapeError as error:
            _problem(say, str(error).partition("; ")[0], asks="hfov")
            if (hfov := _field_told(line)) is None:
                return
        except (EagorError, OSError) as error:
            _problem(say, str(error))
            _until_told_to_end(line, None)
            return
    shown.loop = loop
    listening = threading.Thread(target=_until_told_to_end, args=(line, shown), daemon=True)
    listening.start()
    say(Message({"type": "status", "words": f"Opening {source}. The perception is being loaded."}))
    try:
        loop.run(lambda _: None)
    except EagorError as error:
        _problem(say, str(error))
    listening.join()  # questions to a source that has ended are refused there


def _problem(say: Callable[[Message], None], text: str, asks: str = "") -> None:
    words = {"problem": f"{text[:1].upper()}{text[1:]}.", "change": "Start eagor studio with another --source."}
    say(Message({"type": "problem", **words, "fatal": True, **({"asks": asks} if asks else {})}))


def _field_told(line: Connection) -> float | None:
    """Wait for the field of view that a page tells, degrees; None if the line ends before."""
    with suppress(EOFError, OSError):
        while (told := line.recv()) is not None:
            if told[0] == "hfov":
                return float(told[1])
    return None


def _until_told_to_end(line: Connection, shown: Shown | None) -> None:
    with suppress(EOFError, OSError):
        while (told := line.recv()) is not None:
            if shown is not None and told[0] == "query":
                shown.ask(*told[1:])
    if shown is not None:
        shown.loop.stop()
