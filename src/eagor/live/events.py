"""What comes into the live loop, each with its time of arrival (seconds on the loop's clock).

Stamps are those of the source, on its own clock; the core relates the clocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from eagor.evidence import Evidence
from eagor.live.answers import Part
from eagor.media.frames import Pose

__all__ = ["Asked", "Event", "EvidenceCame", "Following", "FrameCame", "PoseCame", "PosesLost", "Trouble"]


@dataclass(frozen=True, eq=False)
class FrameCame:
    """A picture; `stamp`: its capture. The core needs no `panorama` ``(H, W, 3)``; a recording does."""

    arrival: float
    stamp: float
    name: str
    panorama: np.ndarray | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class PoseCame:
    """A pose; `of_picture`: it was found in a picture, and its stamp is on the camera's clock."""

    arrival: float
    pose: Pose
    of_picture: bool = False


@dataclass(frozen=True, eq=False)
class PosesLost:
    """Nothing relates the poses from here on to those before: the world starts anew, and with it every belief."""

    arrival: float
    text: str


@dataclass(frozen=True, eq=False)
class EvidenceCame:
    """What the perception says about `query` in the picture of `stamp`; `looks` has several items for several views.

    `told`: the stamp that the perception was told, on whose clock the looks are. `seconds`: how long it took.
    """

    arrival: float
    stamp: float
    told: float
    query: str
    looks: tuple[Evidence, ...]
    seconds: float = 0.0


@dataclass(frozen=True)
class Trouble:
    """Something is wrong with a part, in words; an empty `text`: it works again.

    `about`: the query that alone is concerned, or which of a part's faults this is; empty for the part as a whole.
    """

    arrival: float
    part: Part
    text: str = ""
    about: str = ""


@dataclass(frozen=True)
class Following:
    """The queries to follow from now on."""

    arrival: float
    queries: tuple[str, ...]


@dataclass(frozen=True)
class Asked:
    """An answer to every query is wanted for this time."""

    arrival: float


Event = FrameCame | PoseCame | PosesLost | EvidenceCame | Trouble | Following | Asked
