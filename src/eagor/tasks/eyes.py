"""Adapts a perception to one episode.

Most perceptions see the panorama. `truth` gets the instance ids instead, which only a simulator knows; no picture is
rendered for it.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from eagor.errors import AnswerError
from eagor.evidence import Evidence
from eagor.perception import Perception, load, look
from eagor.perception.calibrated import Calibrated, from_json
from eagor.queries import Named
from eagor.tasks.chat import shared_chat
from eagor.tasks.episodes import Slot


class Eye(Protocol):
    """Looks once per step."""

    privileged: bool  # whether it reads instance ids instead of the panorama

    def look(self, image: np.ndarray, query: str, stamp: float, world_R_body: np.ndarray) -> Evidence | None:
        """The evidence; None if a model's answer could not be read."""
        ...

    def account(self) -> dict[str, Any]:
        """The perception's metadata and cost, for the record of the episode; empty if it gives none."""
        ...


class PixelEye:
    """A perception that sees panoramas."""

    privileged = False

    def __init__(self, perception: Perception) -> None:
        self.perception = perception
        self.source: dict[str, Any] = {}
        self.milliseconds: list[float] = []
        self.looks = 0
        self.unread: list[AnswerError] = []

    def look(self, image: np.ndarray, query: str, stamp: float, world_R_body: np.ndarray) -> Evidence | None:
        """The evidence; an unreadable answer among hundreds costs its step, not the episode."""
        self.looks += 1
        try:
            evidence = look(self.perception, image, query, stamp=stamp, world_R_body=world_R_body)
        except AnswerError as error:
            self.unread.append(error)
            return None
        if evidence.source is not None:
            self.source = dict(evidence.source)
            self.milliseconds.append(float(self.source.pop("milliseconds", 0.0)))
        return evidence

    def account(self) -> dict[str, Any]:
        """Number of looks and of unreadable answers, the mean time of a look, and the source of the last one.

        Raises `AnswerError` if more than half of the answers could not be read: that is no result.
        """
        if 2 * len(self.unread) > self.looks:
            raise AnswerError(
                f"{len(self.unread)} of {self.looks} answers could not be read; the last: {self.unread[-1]}"
            )
        if not (self.source or self.unread):
            return {}
        mean = round(float(np.mean(self.milliseconds)), 1) if self.milliseconds else None
        return {"looks": self.looks, "unread": len(self.unread), "milliseconds": mean, "source": self.source}


class PrivilegedEye:
    """A perception that gets instance ids."""

    privileged = True

    def __init__(self, episode: Any) -> None:
        self.episode = episode

    def look(self, image: np.ndarray, query: str, stamp: float, world_R_body: np.ndarray) -> Evidence:
        return self.episode(image, query, stamp=stamp, world_R_body=world_R_body)

    def account(self) -> dict[str, Any]:
        return {}


def open_eye(perception: Any, things: Sequence[Named], seed: int) -> Eye:
    """`perception` for one episode among `things` (indexed by instance id); `seed` is for its mistakes."""
    begin = getattr(perception, "episode", None)
    return PixelEye(perception) if begin is None else PrivilegedEye(begin(things, seed))


def open_for(perception: Any, slot: Slot, things: Sequence[Named]) -> Eye:
    """`open_eye` for the episode of a slot, whose mistakes are the same each time."""
    return open_eye(perception, things, int(slot.rng("perception").integers(1 << 31)))


def look_around(
    eye: Eye, observation: Mapping[str, Any], info: Mapping[str, Any], stamp: float, query: str = ""
) -> Evidence | None:
    """The evidence in what an environment returned (`eagor.tasks.place_env`); `query`: another than its own."""
    image = info["instances"]["ids"] if eye.privileged else observation["panorama"]
    return eye.look(image, query or info["query"], stamp, info["truth"]["world_R_body"])


@lru_cache(maxsize=1)
def shared(perception: str) -> Perception:
    """The perception of this name, made once per process for all callers: a model may take minutes and gigabytes.

    `release` frees it. Raises as `eagor.perception.load`, and errors of its server.
    """
    made = load(perception)
    check = getattr(made, "check", None)
    if check is not None:
        check()
    return made


def release() -> None:
    """Free the perception of `shared`, the model of `shared_chat`, and their GPU memory."""
    shared.cache_clear()
    shared_chat.cache_clear()
    gc.collect()
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        torch.cuda.empty_cache()


def recalibration(settings: Mapping[str, Any]) -> Calibrated | None:
    """The calibration in the settings of a run ("calibrated"); None: the perception's own."""
    return from_json(settings["calibrated"], "the settings") if settings.get("calibrated") else None


def is_privileged(perception: Any) -> bool:
    """Whether the perception reads instance ids."""
    return hasattr(perception, "episode")
