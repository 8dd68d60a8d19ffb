"""What looks: a perception made ready for one episode.

Most perceptions see the panorama. `truth` sees which instance each direction shows, which only a simulator knows; it
needs no picture, so that none is rendered for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from eagor.evidence import Evidence
from eagor.perception import Perception
from eagor.queries import Named

ROWS = 256  # of the panoramas, for perceptions that do not say


class Eye(Protocol):
    """Looks once per step."""

    privileged: bool  # whether it reads instance ids instead of the panorama

    def look(self, image: np.ndarray, query: str, stamp: float, world_R_body: np.ndarray) -> Evidence: ...


class PixelEye:
    """A perception that sees panoramas."""

    privileged = False

    def __init__(self, perception: Perception) -> None:
        self.perception = perception

    def look(self, image: np.ndarray, query: str, stamp: float, world_R_body: np.ndarray) -> Evidence:
        return self.perception(image, query, stamp=stamp)


class PrivilegedEye:
    """A perception that sees instance ids."""

    privileged = True

    def __init__(self, episode: Any) -> None:
        self.episode = episode

    def look(self, image: np.ndarray, query: str, stamp: float, world_R_body: np.ndarray) -> Evidence:
        return self.episode(image, query, stamp=stamp, world_R_body=world_R_body)


def open_eye(perception: Any, things: Sequence[Named], seed: int) -> Eye:
    """`perception` for one episode among `things` (whose places are the instance ids); `seed` is of its mistakes."""
    begin = getattr(perception, "episode", None)
    return PixelEye(perception) if begin is None else PrivilegedEye(begin(things, seed))


def rows_of(perception: Any) -> int:
    """Rows of the panoramas that the perception works at (its attribute `rows`, where it has one)."""
    return int(getattr(perception, "rows", ROWS))


def is_privileged(perception: Any) -> bool:
    """Whether the perception reads instance ids."""
    return hasattr(perception, "episode")
