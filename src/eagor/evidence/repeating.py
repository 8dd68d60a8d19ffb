"""Mistakes that repeat from look to look, and how they fade.

The next look repeats a share of the mistakes: a poster is taken for the target again, and a target overlooked once is
overlooked again. With time and with the camera's motion the view changes, and mistakes fade. The share that a look
repeats of another one, `elapsed` seconds and `moved` metres before it, is

    share * exp(-elapsed / seconds - moved / metres).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

# For error texts.
SECONDS = "seconds above 0, or None if mistakes repeat however long it is"
METRES = "metres above 0, or None if mistakes repeat however far the camera moves"
NO_PAIR = 1e-9  # of the squares: a smaller value is rounding


@dataclass(frozen=True)
class Repeating:
    """The share of mistakes that repeats, and the seconds and metres in which it fades; None: it does not."""

    share: float = 0.0
    seconds: float | None = None
    metres: float | None = None

    @property
    def fades(self) -> bool:
        """Whether the share fades."""
        return self.seconds is not None or self.metres is not None

    def after(self, elapsed: float, moved: float = 0.0) -> float:
        """The share that is repeated after `elapsed` seconds and `moved` metres."""
        return self.share * self.left(elapsed, moved)

    def left(self, elapsed: float, moved: float = 0.0) -> float:
        """The fraction of the share that is left by then, in (0, 1]."""
        faded = 0.0 if self.seconds is None else elapsed / self.seconds
        return math.exp(-faded - (0.0 if self.metres is None else moved / self.metres))


@dataclass(frozen=True)
class CommonError:
    """How far the repeating part of the looks' errors is the same in all looks.

    b is that part of a look's error, scaled to variance 1; the b of two looks have a correlation that fades with the
    time between them. The belief adds looks with weights w: `count` is the sum of w, `squares` the sum of w^2,
    `variance` the variance of the sum of w b, and `newest` the covariance of that sum with the newest look's b.
    """

    count: float = 0.0
    squares: float = 0.0
    variance: float = 0.0
    newest: float = 0.0

    @property
    def correlation(self) -> float:
        """The mean correlation of the b of two looks, weighted by w: 1 for one look, or while nothing has faded.

        This fraction of the variance of b does not average out over the looks.
        """
        pairs = self.count**2 - self.squares
        return max(self.variance - self.squares, 0.0) / pairs if pairs > NO_PAIR * self.squares else 1.0

    def with_look(self, faded: float, repeated: float, tells: bool) -> CommonError:
        """After one more look.

        `faded`: correlation of its b with that of the look before it; `repeated`: deducted from the weight 1 of the
        look before it; `tells`: whether it says anything about directions (weight 1) or nothing (weight 0).
        """
        weight = 1.0 if tells else 0.0
        squares = self.squares - 2 * repeated + repeated**2 + weight
        kept = self.variance - 2 * repeated * self.newest + repeated**2
        shared = faded * (self.newest - repeated)
        return CommonError(self.count - repeated + weight, squares, kept + weight * (2 * shared + 1), shared + weight)


NONE_YET = CommonError()
