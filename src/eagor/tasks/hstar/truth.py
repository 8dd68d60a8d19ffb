"""A detector of known quality for H*Bench's views, made from the annotations.

What an agent does with what it sees is then measured apart from how well a model sees.

The same noise as in simulated worlds (`eagor.perception.noise.Noise`), with these differences: a view shows part of the
sphere; what counts is how much of the target's box it shows; and nothing but the targets is annotated, so that a false
alarm is somewhere in the view, and stays there in the world for as long as it lasts.
"""

from __future__ import annotations

import math

import numpy as np

from eagor.calibration import Calibration
from eagor.detections import MIN_SPREAD
from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.perception.noise import Noise
from eagor.perception.truth import Report, displaced, drawn
from eagor.tasks.hstar.camera import HFOV_DEG, View, box_points, inside

# Found on development apartments (benchmarks/search.py --fit).
CALIBRATION = Calibration(floor=0.125, neutral=0.124, temperature=2.59)
LENS = PerspectiveGrid(27, 48, math.radians(HFOV_DEG))  # the cells of its response: 2 degrees in the middle
WHOLE = 0.5  # share of a box in view from which on it is found as well as if it were whole


class TruthEye:
    """Looks at views of one episode and remembers its mistakes from look to look.

    Each look draws the same amount of randomness whatever it shows, so that agents that look elsewhere meet the same
    luck look by look.
    """

    def __init__(
        self,
        yaw: tuple[float, float],
        pitch: tuple[float, float] | None,
        noise: Noise,
        seed: int | list[int],
        calibration: Calibration = CALIBRATION,
    ) -> None:
        self._points = box_points(yaw, pitch)
        self._noise, self._calibration = noise, calibration
        self._rng = np.random.default_rng(seed)
        self._started = False
        self._luck = np.zeros((2, 2))  # of the target and of the false alarm: reported or not, and the score
        self._error = np.zeros((2, 3))  # standard normal, in the world's axes
        self._place = np.zeros(2)  # of the false alarm in its view, 0 to 1
        self._alarm: np.ndarray | None = None  # where it is in the world, once a view had it

    def look(self, view: View, stamp: float | None = None) -> Evidence:
        """The next look: evidence on `LENS`, in the view's own frame."""
        response = drawn(self.reports(view), LENS, self._noise.floor)
        return Evidence.from_response(response, LENS, self._calibration, stamp)

    def reports(self, view: View) -> list[Report]:
        """The next look as the list of what is reported, in the view's own frame."""
        self._advance()
        noise, found = self._noise, []
        shown = inside(view, self._points)
        seen = min(1.0, float(shown.mean()) / WHOLE)
        if shown.any() and self._luck[0, 0] < (1 - noise.miss) * seen:
            points = self._points[shown] @ view.world_R_view
            found.append(self._report("found", 0, *_moments(points), view))
        if self._luck[1, 0] < noise.false_alarm:
            if self._alarm is None:
                x, y = self._place * (LENS.width, LENS.height)
                self._alarm = view.world_R_view @ LENS.unproject(np.array(x), np.array(y))
            if inside(view, self._alarm[None])[0]:
                size = np.zeros((3, 3))
                found.append(self._report("false alarm", 1, self._alarm @ view.world_R_view, size, view, False))
        return found

    def _advance(self) -> None:
        """Go on by one look: mistakes are kept, or drawn anew."""
        drawn_now, error = self._rng.random((2, 5)), self._rng.standard_normal((2, 3))
        anew = drawn_now[:, 0] >= self._noise.persistence if self._started else np.ones(2, dtype=bool)
        self._luck[anew], self._error[anew] = drawn_now[anew, 1:3], error[anew]
        if anew[1]:
            self._place, self._alarm = drawn_now[1, 3:5], None
        self._started = True

    def _report(
        self, kind: str, row: int, centre: np.ndarray, covariance: np.ndarray, view: View, moves: bool = True
    ) -> Report:
        error = view.world_R_view.T @ self._error[row] * self._noise.spread if moves else np.zeros(3)
        placed, carry = displaced(centre, error)
        width = self._noise.spread**2 + MIN_SPREAD**2  # as detections are drawn: less is lost to a belief
        covariance = carry @ covariance @ carry.T + width * (np.eye(3) - np.outer(placed, placed))
        score = self._noise.weakest + (1 - self._noise.weakest) * float(self._luck[row, 1])
        return Report(kind, None, placed, covariance, score)


def _moments(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean direction ``(3,)`` of points ``(n, 3)``, and their covariance ``(3, 3)`` in the tangent plane there."""
    centre = points.mean(axis=0)
    centre /= np.linalg.norm(centre)
    offsets = points - (points @ centre)[:, None] * centre
    return centre, offsets.T @ offsets / len(points)
