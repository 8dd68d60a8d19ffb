"""What every kind of session has: how it is opened, what it sends, and the Protocol that the engine goes by."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from eagor.studio.wire import Message

__all__ = ["SEED", "Opening", "Outbox", "Session"]

SEED = 602  # the apartment of `eagor demo`: its search was chosen because it is instructive


@dataclass(frozen=True)
class Opening:
    """What a page opens: a view, with what it wants to see there."""

    view: str
    query: str
    perception: str
    seed: int = 0
    drive: str = "policy"
    picture: Path | None = None
    frames: int = 0
    name: str = ""
    methods: tuple[str, ...] = ()


@dataclass
class Outbox:
    """Where sessions send: messages to their pages, orders to the eye."""

    send: Callable[[int, Message], None]
    eye: Callable[[Any], None]
    _numbers: dict[int, int] = field(default_factory=dict)

    def step(self, session: int, message: Message) -> None:
        """A step, with its number and the time at which it is sent."""
        number = self._numbers[session] = self._numbers.get(session, 0) + 1
        self.send(session, Message({**message.header, "number": number, "sent": time.time()}, message.blobs))

    def status(self, session: int, words: str) -> None:
        """What is going on."""
        self.send(session, Message({"type": "status", "words": words}))

    def problem(self, session: int, problem: str, change: str, fatal: bool = False) -> None:
        """What is wrong, and what to do."""
        self.send(session, Message({"type": "problem", "problem": problem, "change": change, "fatal": fatal}))

    def forget(self, session: int) -> None:
        """The session is closed."""
        self._numbers.pop(session, None)


class Session(Protocol):
    """One page's view of something. `due`: when `tick` wants to be called, on `time.monotonic`."""

    number: int
    opening: Opening
    due: float

    def tick(self, now: float, soonest: float) -> float:
        """Go on; `soonest`: seconds between two computations of the belief. Returns the seconds of one, or 0."""
        ...

    def saw(self, said: Any, now: float) -> None:
        """What the eye says to this session."""
        ...

    def told(self, message: dict[str, Any], now: float) -> None:
        """What the page says, checked."""
        ...
