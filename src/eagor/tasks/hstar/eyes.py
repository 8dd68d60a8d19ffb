"""Who looks at a view: any perception, or `truth`, made ready for one episode."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from eagor.errors import EagorError, QueryError
from eagor.evidence import Evidence
from eagor.perception import Perception
from eagor.perception.noise import Noise
from eagor.perception.partial import look_at_view
from eagor.sphere import world_R_body
from eagor.tasks.eyes import shared
from eagor.tasks.hstar.camera import HFOV_DEG, View, render_view
from eagor.tasks.hstar.data import Episode
from eagor.tasks.hstar.files import open_panorama
from eagor.tasks.hstar.truth import TruthEye
from eagor.tasks.hstar.words import head_of, phrase_of, thing_of


@dataclass(frozen=True, eq=False)
class Look:
    """What one look says: the evidence, and the pose ``(3, 3)`` of the frame that it is in."""

    evidence: Evidence
    world_R_capture: np.ndarray


class Eye(Protocol):
    """Looks at views of one episode."""

    def look(self, view: View) -> Look: ...


class PixelEye:
    """A perception that is shown the view, drawn as the benchmark draws it, without the cross.

    It is asked for the thing in the task's words; one that knows only single nouns is asked for less and less.
    """

    def __init__(self, perception: Perception, episode: Episode, resolution: int) -> None:
        self._perception, self._episode, self._resolution = perception, episode, resolution
        self._queries = list(dict.fromkeys((thing_of(episode.task), phrase_of(episode.task), head_of(episode.task))))

    def look(self, view: View) -> Look:
        image = render_view(open_panorama(self._episode.panorama), view.yaw, view.pitch, self._resolution, cross=False)
        pose = world_R_body(-math.radians(view.yaw))
        while True:
            try:
                pitch, hfov = math.radians(view.pitch), math.radians(HFOV_DEG)
                return Look(look_at_view(self._perception, image, pitch, hfov, self._queries[0]), pose)
            except QueryError:
                if len(self._queries) == 1:
                    raise
                del self._queries[0]


class AnnotatedEye:
    """`truth`: sees the annotations through noise; nothing is drawn for it."""

    def __init__(self, eye: TruthEye) -> None:
        self._eye = eye

    def look(self, view: View) -> Look:
        return Look(self._eye.look(view), view.world_R_view)


def open_perception(spec: str) -> Perception | Noise:
    """What `spec` names: a perception, or the noise of ``truth``, ``truth:ideal``, ``truth:miss=0.3,spread=4``.

    A perception is made once per process. Raises `EagorError` if it cannot be made, and what a server has against it.
    """
    name, _, text = spec.partition(":")
    if name == "truth":
        return Noise.parse(text)
    return shared(spec)


def open_eye(perception: Any, episode: Episode, seed: int, resolution: int) -> Eye:
    """`perception`, as `open_perception` returned it, for one episode; `seed` is of truth's mistakes.

    Raises `EagorError` where it is neither.
    """
    if isinstance(perception, Noise):
        luck = [seed, zlib.crc32(episode.id.encode())]
        return AnnotatedEye(TruthEye(episode.yaw, episode.pitch, perception, luck))
    if not isinstance(perception, Perception):
        raise EagorError(f"the perception is a {type(perception).__name__}; wanted what open_perception returns")
    return PixelEye(perception, episode, resolution)
