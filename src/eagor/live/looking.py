"""Where the ordinary camera of a live loop should look next (`eagor.tracking.TurningCamera`)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from eagor.errors import GridError
from eagor.grids import PerspectiveGrid
from eagor.live.events import Answer, Event, FrameCame, PosesLost
from eagor.tracking import TurningCamera

__all__ = ["NextLooks"]

APART = 0.5  # seconds between two computations, which take about 40 ms each


class NextLooks:
    """A watcher of the loop that tells where to look next for the thing of one query: a camera can turn one way only.

    It is computed anew with a new look, at most every `APART` seconds, and stands in the world until then. A panorama
    sees all, so that there is nothing to tell. `of` is for one thread, which may be another than the loop's.
    """

    def __init__(self) -> None:
        self._grid: PerspectiveGrid | None = None
        self._query, self._looked, self._when = "", -math.inf, -math.inf  # of what was computed last
        self._toward: np.ndarray | None = None  # world axes

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        if isinstance(event, FrameCame):
            self._grid = event.grid
        elif isinstance(event, PosesLost):
            self._query = ""

    def close(self) -> None:
        """Nothing is held."""

    def of(self, answer: Answer) -> np.ndarray | None:
        """The direction ``(3,)``, in the body frame of the answer, to which the camera's axis should turn.

        None before the first look, for panoramas, and for a field that `TurningCamera` refuses.
        """
        estimate, grid = answer.estimate, self._grid
        looked = estimate.stamp - estimate.age  # when the newest evidence in it was captured
        if grid is None or not math.isfinite(looked):
            return None
        news = looked > self._looked + 1e-6 and estimate.stamp >= self._when + APART
        if answer.query != self._query or news:
            self._query, self._looked, self._when = answer.query, looked, estimate.stamp
            try:
                found = estimate.next_look(TurningCamera.of_view(grid), body_R_view=grid.body_R_view)
            except GridError:
                self._toward = None
            else:
                self._toward = estimate.world_R_body @ found.direction
        return None if self._toward is None else self._toward @ estimate.world_R_body
