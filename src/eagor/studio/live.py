"""A live source for the page: one loop for all who watch it, in a process of its own."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.live.events import Answer, Event, EvidenceCame, FrameCame, PoseCame
from eagor.live.loop import LiveLoop, Watcher
from eagor.studio.messages import Blob, Message, rounded
from eagor.studio.steps import FLOATS, belief_of, believed, calibration_of, small_jpeg

__all__ = ["Shown", "watch"]

PICTURES = 0.2  # seconds between two panoramas that are sent, at least
ROWS = 384  # of them, at most


class Shown:
    """A watcher of the loop that says what happens, as messages for the page: `say` is called with each."""

    def __init__(self, say: Callable[[Message], Any], source: str, perception: str) -> None:
        self._say, self._source, self._perception = say, source, perception
        self._picture: FrameCame | None = None
        self._sent = -math.inf
        self._position: np.ndarray | None = None
        self._fresh = False
        self._shown: Any = None  # the belief that was sent last
        self._number = 0
        self._query = ""
        self._faults = ""
        self.core: Any = None  # of the loop: where the camera pointed when a picture was taken

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop, and the answers to it."""
        if isinstance(event, FrameCame) and event.panorama is not None:
            self._picture = event
        elif isinstance(event, PoseCame):
            self._position = event.pose.position
        elif isinstance(event, EvidenceCame):
            self._fresh = True
        for answer in answers[:1]:
            self._answered(answer)

    def close(self) -> None:
        """The loop has ended."""
        self._say(Message({"type": "status", "words": f"{self._source} has ended."}))

    def _answered(self, answer: Answer) -> None:
        estimate = answer.estimate
        if answer.query != self._query:
            self._query = answer.query
            self._scene(estimate.config)
        header: dict[str, Any] = {
            "type": "step",
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
        picture = self._picture
        if picture is not None and picture.panorama is not None and answer.stamp - self._sent >= PICTURES:
            self._picture, self._sent = None, answer.stamp
            pose = None if self.core is None else self.core.orientation(picture.stamp)
            pose = estimate.world_R_body if pose is None else pose
            header["panorama"] = {"stamp": rounded(answer.stamp), "world_R_camera": rounded(pose.reshape(9), 6)}
            blobs["panorama"] = Blob("image/jpeg", small_jpeg(picture.panorama, ROWS))
        self._say(Message(header, blobs))

    def _scene(self, config: Any) -> None:
        scene = {
            "type": "scene",
            "view": "live",
            "title": self._source,
            "session": "live",
            "query": self._query,
            "targets": [],
            "plan": None,
            "degree": config.degree,
            "calibration": calibration_of(None, config),
            "perception": self._perception,
            "methods": [],
            "region": 0.9,
        }
        self._say(Message(scene))


def watch(
    line: Connection, source: str, perception: str, opens: Callable[[Sequence[Watcher]], LiveLoop]
) -> None:  # fmt: skip
    """Run the loop that `opens` makes and say what happens, until the line or the parent ends.

    It is told ``("query", text)``. What cannot be opened is said as a fatal problem.
    """
    lock = threading.Lock()

    def say(message: Message) -> None:
        with lock, suppress(OSError):
            line.send(message)

    shown = Shown(say, source, perception)
    try:
        loop = opens([shown])
    except (EagorError, OSError) as error:
        _problem(say, str(error))
        _until_told_to_end(line, None)
        return
    shown.core = loop.core
    threading.Thread(target=_until_told_to_end, args=(line, loop), daemon=True).start()
    say(Message({"type": "status", "words": f"Opening {source}. The perception is being loaded."}))
    try:
        loop.run(lambda _: None)
    except EagorError as error:
        _problem(say, str(error))
    _until_told_to_end(line, None)


def _problem(say: Callable[[Message], None], text: str) -> None:
    words = {"problem": f"{text[:1].upper()}{text[1:]}.", "change": "Start eagor studio with another --source."}
    say(Message({"type": "problem", **words, "fatal": True}))


def _until_told_to_end(line: Connection, loop: LiveLoop | None) -> None:
    with suppress(EOFError, OSError):
        while (told := line.recv()) is not None:
            if loop is not None and told[0] == "query":
                loop.follow([told[1]])
    if loop is not None:
        loop.stop()
