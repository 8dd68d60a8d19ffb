"""What every session has: how it is opened, what it sends, and what it and the process that sees tell each other."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from eagor.studio.messages import Message

if TYPE_CHECKING:
    from eagor.evidence import Evidence
    from eagor.studio.houses import House

__all__ = [
    "LOOKS",
    "Built",
    "Close",
    "Opened",
    "Opening",
    "Outbox",
    "Panorama",
    "Refused",
    "See",
    "Seen",
    "Session",
    "Turn",
    "Turned",
]

LOOKS = 4.0  # frames of a video per second that are taken, at most


@dataclass(frozen=True, eq=False)
class See:
    """What a session wants to be seen: from where, and what to look for in it.

    `seed`: the apartment; `picture`: else the file of a photograph. `rows` of the panorama that is sent (0: none).
    `query` None: no look is taken.
    """

    session: int
    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray | None
    perception: str
    query: str | None
    rows: int
    seed: int | None = None
    picture: Path | None = None


@dataclass(frozen=True)
class Turn:
    """The next frame of a video that a session wants to see; `start`: seconds of the video to begin at (None: go on).

    `query` None: no look is taken.
    """

    session: int
    path: Path
    perception: str
    query: str | None
    start: float | None = None


@dataclass(frozen=True, eq=False)
class Turned:
    """A frame of a video: its time (seconds of the video), the camera's rotation, the picture, and the looks at it.

    `lost`: the rotation could not be followed up to here; the world starts anew. `over`: there are no more frames, and
    the rest means nothing.
    """

    session: int
    stamp: float
    world_R_body: np.ndarray
    jpeg: bytes
    query: str | None
    looks: tuple[Evidence, ...] = ()
    lost: bool = False
    over: bool = False


@dataclass(frozen=True)
class Close:
    """The session is closed: what is kept for it can go."""

    session: int


@dataclass(frozen=True, eq=False)
class Built:
    """An apartment is ready, and so is the perception, which is `calibrated` in words and numbers."""

    session: int
    house: House
    calibrated: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Opened:
    """A photograph is ready: as it is, `jpeg`, with facts from its file and the rows that are looked at."""

    session: int
    jpeg: bytes
    facts: tuple[str, ...]
    calibrated: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Panorama:
    """What the camera saw at a stamp."""

    session: int
    stamp: float
    world_R_body: np.ndarray
    jpeg: bytes


@dataclass(frozen=True, eq=False)
class Seen:
    """The looks at what was seen at a stamp, and the seconds that they took."""

    session: int
    stamp: float
    query: str
    looks: tuple[Evidence, ...]
    seconds: float


@dataclass(frozen=True)
class Refused:
    """Why something cannot be built, opened or looked for. `part`: house, picture, look or query; `query`: that one."""

    session: int
    part: str
    problem: str
    query: str | None = None


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
