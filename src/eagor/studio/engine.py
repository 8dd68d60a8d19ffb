"""The process of all sessions: they take turns in one thread, and their looks are taken in another process (the eye).

The server's process only passes messages on, so nothing that is computed here delays another page. Orders come as
``("open", number, Opening)``, ``("told", number, message)`` and ``("close", number)``; what is said is ``(number,
Message)``, number 0 for all: ``ready`` once it is warm.
"""

from __future__ import annotations

import math
import multiprocessing
import time
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from eagor._processes import leave_ctrl_c, leave_with_parent, starting
from eagor.studio.backends import run
from eagor.studio.following import SOONEST, warm
from eagor.studio.messages import Message
from eagor.studio.picture import PictureSession, VideoSession
from eagor.studio.session import Close, Opening, Outbox, Session
from eagor.studio.walk import WalkSession
from eagor.tasks.methods import BASE

__all__ = ["serve"]

EYE = "eagor.studio.eye:serve"
SHARE = 0.6  # of the time for computing beliefs
LEARNT = 0.05  # weight of the newest in a running mean
KINDS = {"walk": WalkSession, "picture": PictureSession, "video": VideoSession}


def serve(line: Connection, perceptions: tuple[str, ...], seed: int | None) -> None:
    """The life of the process; it ends when the line or its parent does."""
    leave_ctrl_c()
    eyes = _Eye(perceptions, seed)
    leave_with_parent(eyes.kill)
    engine = _Engine(line, eyes)
    warm(BASE)
    with suppress(EOFError, OSError):
        while True:
            engine.turn()


class _Eye:
    """The process that sees; one that dies is started anew."""

    def __init__(self, perceptions: tuple[str, ...], seed: int | None) -> None:
        self._settings = perceptions, seed
        self.start()

    def start(self) -> None:
        """Start it, warm."""
        context = multiprocessing.get_context("spawn")
        self.line, there = context.Pipe()
        self.process = context.Process(target=run, args=(EYE, there, *self._settings), daemon=False)
        with starting():
            self.process.start()
        there.close()

    def kill(self) -> None:
        """End it at once."""
        self.process.kill()


class _Engine:
    def __init__(self, line: Connection, eyes: _Eye) -> None:
        self._line, self._eyes = line, eyes
        self._sessions: dict[int, Session] = {}
        self._out = Outbox(self._send, self._order)
        self._cost = 0.0  # seconds of one computation of a belief, a running mean; more on a busy machine
        self._ready = False

    def turn(self) -> None:
        """Take in what has come, and let sessions go on that are due, the longest waiting first."""
        due = min((session.due for session in self._sessions.values()), default=math.inf)
        timeout = None if math.isinf(due) else max(0.0, due - time.monotonic())
        for ready in wait([self._line, self._eyes.line, self._eyes.process.sentinel], timeout):
            if ready is self._line:
                self._obey(self._line.recv())
            elif ready is not self._eyes.line or not self._hear():
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
            self._out.forget(number)
            self._order(Close(number))
        elif (session := self._sessions.get(number)) is not None:
            self._safely(session, session.told, rest[0], time.monotonic())

    def _hear(self) -> bool:
        """Pass on what the eye says; whether it lives."""
        try:
            said = self._eyes.line.recv()
        except (EOFError, OSError):
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
        self._eyes.process.join(1.0)
        self._eyes.start()
        for number, session in list(self._sessions.items()):
            text = "The process that sees has ended unexpectedly; it starts anew, and so does this view."
            self._out.problem(number, text, "If this goes on, choose another perception.")
            self._obey(("open", number, session.opening))

    def _safely(self, session: Session, call: Any, *arguments: Any) -> Any:
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
        with suppress(OSError):
            self._eyes.line.send(job)
