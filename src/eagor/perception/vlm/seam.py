"""The seam: two looks at a panorama, the second rolled by half a turn, so that nothing is cut off in both.

The border of one picture is the middle of the other. Each direction weights the look in which it lies farther from the
border, so that cut things, and the attention that models waste on borders and corners, fade out.
"""

from __future__ import annotations

import math

import numpy as np


def merged(first: np.ndarray, second: np.ndarray, roll: float = 0.5) -> np.ndarray:
    """One response, float32, from two ``(..., h, w)`` to one panorama, both in the panorama's own frame.

    `second` was seen in the panorama rolled to the right by the fraction `roll` of its width (near 1/2); its columns
    are rolled back already. The weights are sin^2 of half the azimuth from the border; they sum to 1 (after division
    if `roll` is not 1/2).
    """
    fractions = (np.arange(first.shape[-1]) + 0.5) / first.shape[-1]
    weight, other = np.sin(math.pi * fractions) ** 2, np.sin(math.pi * (fractions + roll)) ** 2
    share = weight / (weight + other)
    return (first * share + second * (1 - share)).astype(np.float32)
