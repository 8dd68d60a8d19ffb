"""One look that may give several pieces of evidence: a replay has several views of one moment."""

from __future__ import annotations

import numpy as np

from eagor.errors import TimeError
from eagor.evidence import Evidence
from eagor.perception import Perception
from eagor.perception import look as one_look
from eagor.perception.replay import ReplayPerception

__all__ = ["look", "look_if_recorded"]


def look(
    perception: Perception,
    panorama: np.ndarray,
    query: str,
    stamp: float,
    world_R_body: np.ndarray | None = None,
) -> tuple[Evidence, ...]:
    """The evidence of `perception`: one, or one per view if a replay has several views of one moment."""
    if isinstance(perception, ReplayPerception):
        return perception.looks(query, stamp)
    return (one_look(perception, panorama, query, stamp=stamp, world_R_body=world_R_body),)


def look_if_recorded(
    perception: Perception,
    panorama: np.ndarray,
    query: str,
    stamp: float,
    world_R_body: np.ndarray | None = None,
) -> tuple[Evidence, ...]:
    """As `look`, but empty if a replay has no line for this time."""
    try:
        return look(perception, panorama, query, stamp, world_R_body)
    except TimeError:
        if isinstance(perception, ReplayPerception):
            return ()
        raise
