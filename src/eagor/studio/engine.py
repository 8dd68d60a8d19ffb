"""The process of all sessions: they take turns in one thread, and their looks are taken in another process (the eye).

The server's process only passes messages on, so nothing that is computed here delays another page. Orders come as
``("open", number, Opening)``, ``("told", number, message)`` and ``("close", number)``; what is said is ``(number,
Message)``, number 0 for all: ``ready`` once it is warm.
"""

from __future__ import annotations

import math
import time
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from eagor._processes import Worker, WorkerEnded
from eagor.errors import EagorError
from eagor.lab.agents.methods import BASE
from eagor.studio.following import SOONEST, FollowingSession, warm
from eagor.studio.messages import Message
from eagor.studio.picture import PictureSession, VideoSession
from eagor.studio.session import Close, Opening, Outbox
from eagor.studio.walk import WalkSession

__all__ = ["serve"]

EYE = "eagor.studio.eye:serve"
ENDING = 1.0  # seconds for the eye to leave by itself
SHARE = 0.6  # of the time for computing beliefs
LEARNT = 0.05  # weight of the newest in a running mean
KINDS = {"walk": WalkSession, "picture": PictureSession, "video": VideoSession}


def serve(line: Connection, perceptions: tuple[str, ...], seed: int | None) -> None:
    """The life of the process; it ends when the line or its parent does."""
    engine = _Engine(line, perceptions, seed)
    warm(BASE)
    try:
        while True:
            engine.turn()
    finally:
        engine.close()


class _Engine:
    """Sessions, and the process that sees, the eye; one that dies is started anew."""

    def __init__(self, line: Connection, perceptions: tuple[str, ...], seed: int | None) -> None:
        self._line, self._settings = line, (perceptions, seed)
        self._eye = Worker(EYE, *self._settings, parent=True)
        self._sessions: dict[int, FollowingSession] = {}
        self._out = Outbox(self._send, self._order)
        self._cost = 0.0  # seconds of one computation of a belief, a running mean; more on a busy machine
        self._ready = False

    def close(self) -> None:
        """End the eye."""
        self._eye.close(ENDING)

    def turn(self) -> None:
        """Take in what has come, and let sessions go on that are due, the longest waiting first."""
        due = min((session.due for session in self._sessions.values()), default=math.inf)
        timeout = None if math.isinf(due) else max(0.0, due - time.monotonic())
        for ready in wait([self._line, self._eye.line, self._eye.process.sentinel], timeout):
            if ready is self._line:
                self._obey(self._line.recv())
            elif ready is not self._eye.line or not self._hear():
                self._blind()
                break
        now = time.monotonic()
        soonest = max(SOONEST, self._cost * len(self._sessions) / SHARE)
        late = sorted((each for each in self._sessions.values() if each.due <= now), key=lambda each: each.due)
        for session in late[: max(4, len(late) // 2)]:  # the rest next time, after what has come meanwhile
            took = self._safely(session, session.tick, time.monotonic(), soonest)
            if took:
                self._cost += LEARNT * (took - self._cost)

    def _obey(self, order: tuple[Any, ...]) -> None:
        what, number, *rest = order
        if what == "open":
            opening: Opening = rest[0]
            self._sessions.pop(number, None)
            self._sessions[number] = KINDS[opening.view](number, opening, self._out)
        elif what == "close":
            self._sessions.pop(number, None)
            self._order(Close(number))
        elif (session := self._sessions.get(number)) is not None:
            self._safely(session, session.told, rest[0], time.monotonic())

    def _hear(self) -> bool:
        """Pass on what the eye says; whether it lives."""
        try:
            said = self._eye.receive()
        except (WorkerEnded, EagorError):
            return False
        if said == ("warm",):
            if not self._ready:
                self._ready = True
                self._send(0, Message({"type": "ready"}))
        elif (session := self._sessions.get(said.session)) is not None:
            self._safely(session, session.saw, said, time.monotonic())
        return True

    def _blind(self) -> None:
        """The eye has died: every session begins anew with another one."""
        self._eye.close(ENDING)
        self._eye = Worker(EYE, *self._settings, parent=True)
        for number, session in list(self._sessions.items()):
            text = "The process that sees has ended unexpectedly; it starts anew, and so does this view."
            self._out.problem(number, text, "If this goes on, choose another perception.")
            self._obey(("open", number, session.opening))

    def _safely(self, session: FollowingSession, call: Any, *arguments: Any) -> Any:
        """What the call returns. A session that fails is closed; the others go on."""
        try:
            return call(*arguments)
        except Exception as error:
            self._sessions.pop(session.number, None)
            text = f"{type(error).__name__}: {error}"
            self._out.problem(session.number, f"This view has failed ({text}).", "Open it again.", fatal=True)

    def _send(self, number: int, message: Message) -> None:
        self._line.send((number, message))

    def _order(self, job: Any) -> None:
        with suppress(WorkerEnded):
            self._eye.send(job)
