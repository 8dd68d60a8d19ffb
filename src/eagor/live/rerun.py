"""A log of the live loop for the Rerun viewer, written by a thread of its own: drawing never holds up an answer."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eagor.drawing.rerun_log import RerunLog
from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.live.events import Answer, Event, FaultLog, ImageReceived, PoseReceived

__all__ = ["LiveLog"]

INTERVAL = 0.1  # seconds between two logged answers: a person sees no more, and each takes tens of milliseconds
LEAVING = 10.0  # seconds for the last answers to be written


class LiveLog:
    """A sink of the loop (`eagor.live.loop.Sink`) that logs its newest answers, pictures and faults.

    Where drawing cannot keep up, answers in between are left out. A picture is logged with the first answers after it.
    `problem`: why the log ended before the loop did, or None. Errors as of `RerunLog`.
    """

    def __init__(self, path: str | Path, title: str = "eagor live") -> None:
        self._log = RerunLog(path, title)
        self.problem: str | None = None
        self._turn = threading.Condition()
        self._picture: np.ndarray | None = None
        self._grid: PerspectiveGrid | None = None
        self._position: np.ndarray | None = None
        self._answers: tuple[Answer, ...] = ()
        self._taken = -math.inf
        self._ended = False
        self._news = FaultLog()
        self._thread = threading.Thread(target=self._draw, name="Rerun log", daemon=True)
        self._thread.start()

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop, and the answers to it."""
        with self._turn:
            if isinstance(event, ImageReceived):
                self._picture, self._grid = event.picture, event.grid
            elif isinstance(event, PoseReceived):
                self._position = event.pose.position
            if answers and answers[0].stamp - self._taken >= INTERVAL:
                self._taken, self._answers = answers[0].stamp, tuple(answers)
                self._turn.notify()

    def close(self) -> None:
        """Write what is left, and finish the file."""
        with self._turn:
            self._ended = True
            self._turn.notify()
        self._thread.join(LEAVING)
        self._log.close()

    def _draw(self) -> None:
        while True:
            with self._turn:
                self._turn.wait_for(lambda: self._answers or self._ended)
                if not self._answers:
                    return
                answers, self._answers = self._answers, ()
                (picture, self._picture), position = (self._picture, None), self._position
                grid = self._grid
            try:
                self._write(answers, picture, grid, position)
            except (EagorError, OSError) as error:
                self.problem = f"the log for Rerun ends here: {error}"
                return

    def _write(
        self,
        answers: Sequence[Answer],
        picture: np.ndarray | None,
        grid: PerspectiveGrid | None,
        position: np.ndarray | None,
    ) -> None:
        for text, wrong in self._news.of(answers[0].faults, answers[0].stamp):
            self._log.say(answers[0].stamp, text, "WARN" if wrong else "INFO")
        for answer in answers:
            self._log.add(
                picture, answer.estimate, stamp=answer.stamp, query=answer.query, position=position, grid=grid
            )
            picture = None  # once, with the first query's belief on it
