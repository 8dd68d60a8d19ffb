"""How sessions are opened, what they send, and what they and the process that sees tell each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.lab.agents.methods import BASE
from eagor.studio.messages import Message

if TYPE_CHECKING:
    from eagor.evidence import Evidence
    from eagor.studio.houses import House
    from eagor.tracking import Around

__all__ = [
    "LOOKS", "Built", "Close", "Loaded", "Opened", "Opening", "Outbox", "Panorama", "Question", "Refused", "See",
    "Seen", "Turn", "Turned",
]  # fmt: skip

LOOKS = 4.0  # frames of a video per second that are taken, at most


@dataclass(frozen=True)
class Question:
    """What is asked for, what looks for it, the `number` that the page gave it, and the degree of the belief.

    All that a session says of an answer carries the number, so that a page never shows the answer to another question.
    """

    query: str
    perception: str
    number: int = 0
    degree: int = BASE.degree


@dataclass(frozen=True, eq=False)
class See:
    """What a session wants to be seen: from where, and what to look for in it (None: no look is taken).

    `seed`: the apartment; `picture`: else the file of a photograph. `rows` of the panorama that is sent (0: none).
    `hfov` of an ordinary photograph, radians; None: it is a panorama.
    """

    session: int
    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray | None
    question: Question | None
    rows: int
    seed: int | None = None
    picture: Path | None = None
    hfov: float | None = None


@dataclass(frozen=True)
class Turn:
    """The next frame of a video that a session wants to see, and what to look for in it (None: no look is taken).

    `start`: seconds of the video to begin at (None: go on); `again`: the same frame as before.
    `hfov` of an ordinary camera, radians; None: the frames are panoramas.
    """

    session: int
    path: Path
    question: Question | None
    start: float | None = None
    again: bool = False
    hfov: float | None = None


@dataclass(frozen=True, eq=False)
class Turned:
    """A frame of a video: its time (seconds of the video), the camera's rotation, the picture, and the looks at it.

    `question`: what was looked for; None: no look was taken. `lost`: the rotation could not be followed up to here; the
    world starts anew. `over`: there are no more frames, and the rest means nothing. `around`: as in `Seen`.
    """

    session: int
    stamp: float
    world_R_body: np.ndarray
    jpeg: bytes
    question: Question | None
    looks: tuple[Evidence, ...] = ()
    lost: bool = False
    over: bool = False
    lens: dict[str, Any] | None = None
    around: Around | None = None


@dataclass(frozen=True)
class Close:
    """The session is closed: what is kept for it can go."""

    session: int


@dataclass(frozen=True, eq=False)
class Loaded:
    """A perception is ready, `calibrated` in words and numbers."""

    session: int
    perception: str
    calibrated: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Built:
    """An apartment is ready."""

    session: int
    house: House


@dataclass(frozen=True, eq=False)
class Opened:
    """A photograph is ready: as it is, `jpeg`, with facts from its file, and the `lens` of an ordinary camera."""

    session: int
    jpeg: bytes
    facts: tuple[str, ...]
    lens: dict[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class Panorama:
    """What the camera saw at a stamp."""

    session: int
    stamp: float
    world_R_body: np.ndarray
    jpeg: bytes


@dataclass(frozen=True, eq=False)
class Seen:
    """The looks at what was seen at a stamp; `around`: at all else, by a perception that knows its classes."""

    session: int
    stamp: float
    question: Question
    looks: tuple[Evidence, ...]
    around: Around | None = None


@dataclass(frozen=True)
class Refused:
    """Why something cannot be built, opened or looked for. `part`: house, picture, perception, look or query."""

    session: int
    part: str
    problem: str
    question: Question | None = None


@dataclass(frozen=True)
class Opening:
    """What a page opens: a view, with what it wants to know there. `hfov`: of an ordinary camera, radians."""

    view: str
    question: Question
    seed: int = 0
    drive: str = "policy"
    picture: Path | None = None
    hfov: float | None = None
    frames: int = 0
    name: str = ""
    methods: tuple[str, ...] = ()


@dataclass
class Outbox:
    """Where sessions send: messages to their pages, orders to the eye."""

    send: Callable[[int, Message], None]
    eye: Callable[[Any], None]

    def status(self, session: int, words: str) -> None:
        """What is going on."""
        self.send(session, Message({"type": "status", "words": words}))

    def problem(self, session: int, problem: str, change: str, fatal: bool = False, question: int = 0) -> None:
        """What is wrong, and what to do; `question`: the number of one that is refused."""
        told = {"problem": problem, "change": change, "fatal": fatal, "question": question}
        self.send(session, Message({"type": "problem", **told}))
