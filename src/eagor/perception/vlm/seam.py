"""The seam: a panorama looked at twice, rolled by half a turn in between, so that nothing is cut in both looks.

What lies on the border of one picture lies in the middle of the other. Each direction takes most from the look in which
it is farther from the border: cut things, and the attention that models waste on borders and corners, fade out.
"""

from __future__ import annotations

import math

import numpy as np


def merged(first: np.ndarray, second: np.ndarray, roll: float = 0.5) -> np.ndarray:
    """Two responses ``(..., h, w)`` to one panorama, both in its own frame, as one, float32.

    `second` was seen in the panorama rolled to the right by the fraction `roll` of its width (near 1/2), and its
    columns were rolled back already. The weights of the two are sin^2 of half the azimuth from the border; they sum
    to 1 (after division where `roll` is not 1/2).
    """
    fractions = (np.arange(first.shape[-1]) + 0.5) / first.shape[-1]
    weight, other = np.sin(math.pi * fractions) ** 2, np.sin(math.pi * (fractions + roll)) ** 2
    share = weight / (weight + other)
    return (first * share + second * (1 - share)).astype(np.float32)
