"""What looks have in common: mistakes that repeat, and how they fade.

Of the mistakes of a look the next one repeats a share: a poster is taken for the target again, and what is overlooked
once is overlooked again. In time, and as the camera moves, the view of the poster changes, and the mistake becomes
another. So the share that a look repeats of one `elapsed` seconds and `moved` metres of the camera before it is

    share * exp(-elapsed / seconds - moved / metres).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

# What these may be, for errors.
SECONDS = "seconds above 0, or None if mistakes repeat however long it is"
METRES = "metres above 0, or None if mistakes repeat however far the camera moves"
NO_PAIR = 1e-9  # of the squares: less is rounding


@dataclass(frozen=True)
class Repeating:
    """Which share of the mistakes of a look is repeated, and in what time and way it fades; None: in none."""

    share: float = 0.0
    seconds: float | None = None
    metres: float | None = None

    @property
    def fades(self) -> bool:
        """Whether it does."""
        return self.seconds is not None or self.metres is not None

    def after(self, elapsed: float, moved: float = 0.0) -> float:
        """The share that is repeated after `elapsed` seconds and `moved` metres."""
        return self.share * self.left(elapsed, moved)

    def left(self, elapsed: float, moved: float = 0.0) -> float:
        """What is left of the share by then, in (0, 1]."""
        faded = 0.0 if self.seconds is None else elapsed / self.seconds
        return math.exp(-faded - (0.0 if self.metres is None else moved / self.metres))


@dataclass(frozen=True)
class CommonError:
    """What the errors of looks have in common: how far the part of them that repeats is the same in all looks.

    In a look that part is b, of variance 1 here; of two looks the b have a correlation that fades with the time between
    them. The belief adds looks with weights w: `count` is the sum of the w, `squares` that of the w squared, `variance`
    that of the sum of w b, and `newest` the covariance of this sum with the b of the newest look.
    """

    count: float = 0.0
    squares: float = 0.0
    variance: float = 0.0
    newest: float = 0.0

    @property
    def alike(self) -> float:
        """The mean correlation of the b of two looks, pairs weighed by w: 1 while nothing has faded, or of one look.

        So much of the variance of b is left in the mean of all looks, beside what averages out as of independent looks.
        """
        pairs = self.count**2 - self.squares
        return max(self.variance - self.squares, 0.0) / pairs if pairs > NO_PAIR * self.squares else 1.0

    def with_look(self, faded: float, repeated: float, tells: bool) -> CommonError:
        """After one more look.

        `faded`: correlation of its b with that of the look before it; `repeated`: what is taken from the weight 1 of
        the look before it; `tells`: whether it says anything about a direction (weight 1), or nothing (weight 0).
        """
        weight = 1.0 if tells else 0.0
        squares = self.squares - 2 * repeated + repeated**2 + weight
        kept = self.variance - 2 * repeated * self.newest + repeated**2
        shared = faded * (self.newest - repeated)
        return CommonError(self.count - repeated + weight, squares, kept + weight * (2 * shared + 1), shared + weight)


NONE_YET = CommonError()
