"""What the motifs of paintings share: paper and ink, tints, gradients, blossoms. Colours are linear RGB ``(3,)``."""

from __future__ import annotations

import numpy as np

from eagor.worlds.apartment.canvas import Canvas, linear
from eagor.worlds.apartment.palette import TONES

PAPER = linear((236, 230, 216))
INK = linear((38, 36, 40))
_ACCENTS = ("red", "orange", "yellow", "green", "blue", "purple", "pink", "brown", "beige")


def accent(rng: np.random.Generator) -> np.ndarray:
    """A colour of any name."""
    tones = TONES[_ACCENTS[rng.integers(len(_ACCENTS))]]
    return linear(tones[rng.integers(len(tones))])


def pale(main: np.ndarray, share: float = 0.6) -> np.ndarray:
    """`main` mixed with a share of paper white."""
    return main + share * (PAPER - main)


def gradient(c: Canvas, low: np.ndarray, high: np.ndarray, power: float = 1.0) -> None:
    """The whole canvas from one colour at its bottom to another at its top."""
    rise = (c.y**power)[..., None]
    c.rgb[:] = low + rise * (high - low)


def blossom(rng: np.random.Generator, c: Canvas, x: float, y: float, size: float, shade: np.ndarray) -> None:
    """A flower with five to seven petals round a yellow or dark heart."""
    turn, petals = rng.uniform(0, 6), int(rng.integers(5, 8))
    c = c.window((x - size, y - size), (x + size, y + size))
    angle = np.arctan2(c.y - y, c.x - x) * petals / 2 + turn
    distance = np.hypot(c.x - x, c.y - y) / size
    petal = 0.72 + 0.28 * np.abs(np.cos(angle))
    c.fill(
        np.clip((petal - distance) * size * c.pixels, 0, 1), shade * (1.1 - 0.35 * np.clip(distance, 0, 1))[..., None]
    )
    c.spot(x, y, 0.22 * size, linear((222, 176, 60)) if shade[0] < 0.5 else shade * 0.3)
