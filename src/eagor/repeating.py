"""What looks have in common: mistakes that repeat, and how they fade.

Of the mistakes of a look the next one repeats a share: a poster is taken for the target again, and what is overlooked
once is overlooked again. In time the view of the poster changes, and the mistake becomes another. So the share that a
look repeats of one `elapsed` seconds before it is

    share * exp(-elapsed / lasts).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SECONDS = "seconds above 0, or None if mistakes repeat however long it is"  # what `lasts` may be, for errors
NO_PAIR = 1e-9  # of the squares: less is rounding


def share_after(share: float, lasts: float | None, elapsed: float) -> float:
    """What is left of a `share` of mistakes after `elapsed` seconds; `lasts`: seconds, None: mistakes never fade."""
    return share if lasts is None else share * math.exp(-elapsed / lasts)


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
