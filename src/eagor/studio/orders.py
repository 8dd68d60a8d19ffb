"""What sessions tell the process that sees, and what it says to them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from eagor.evidence import Evidence
    from eagor.studio.houses import House

__all__ = ["Built", "Opened", "Panorama", "Refused", "See", "Seen"]


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
    """Why something cannot be built, opened or looked for. `part`: house, picture, look or query."""

    session: int
    part: str
    problem: str
