"""Coloured textures (rugs, book spines, screens, paintings): linear RGB ``(h, w, 3)``, first row at the top."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eagor.worlds.apartment.canvas import TONES, Canvas, linear, noise
from eagor.worlds.apartment.paintings import MOTIFS_OF, paint

SPINES = 15
"""Book spines side by side in a "books" texture, each 1/16 of its width; the last sixteenth is cut pages."""


@dataclass(frozen=True)
class Picture:
    """A kind of picture: colours (empty: none), variants, `draw(rng, colour, variant)`: linear RGB ``(h, w, 3)``."""

    colours: tuple[str, ...]
    variants: int
    draw: Callable[[np.random.Generator, str | None, int], np.ndarray]
    emission: float = 0.0


# For each main colour of a rug: a second colour, and one for small motifs.
_PARTNERS: dict[str, tuple[str, str]] = {
    "red": ("beige", "blue"), "blue": ("beige", "red"), "beige": ("brown", "grey"), "grey": ("white", "black"),
    "green": ("beige", "brown"), "brown": ("beige", "orange"), "orange": ("beige", "brown"),
    "purple": ("beige", "pink"), "yellow": ("white", "grey"), "pink": ("white", "red"), "white": ("grey", "black"),
    "black": ("white", "grey"),
}  # fmt: skip


def _rug(rng: np.random.Generator, colour: str | None, variant: int) -> np.ndarray:
    """Medallion, stripes, lozenges, trellis, frames, or plain pile with a border; fringes at the short ends."""
    name = colour or "red"
    main = linear(TONES[name][variant % 3])
    pale, accent = (linear(TONES[other][0]) for other in _PARTNERS[name])
    dark = main * 0.55
    c = Canvas.blank(192, 256, main)
    x, y = c.x - 2 / 3, c.y - 0.5  # from the middle; x to 0.667, y to 0.5
    edge = np.minimum(0.667 - np.abs(x), 0.5 - np.abs(y))
    design = variant % 6
    if design == 0:
        wave = 1 + 0.08 * np.cos(8 * np.arctan2(y, x))
        radius = np.hypot(x / 0.44, y / 0.3) / wave
        c.fill(radius < 1, dark).fill(radius < 0.9, main).fill(radius < 0.62, pale).fill(radius < 0.54, accent)
        c.fill(radius < 0.3, main).fill(radius < 0.14, pale)
        corner = np.hypot((0.667 - np.abs(x)) / 0.3, (0.5 - np.abs(y)) / 0.22)
        c.fill((corner < 1) & (corner > 0.86), pale)
        c.fill(((x * 18) % 1 - 0.5) ** 2 + ((y * 18) % 1 - 0.5) ** 2 < 0.02, dark, (radius > 1.05) & (corner > 1.05))
    elif design == 1:
        for centre in np.linspace(-0.6, 0.6, 9):
            width = rng.uniform(0.008, 0.03)
            c.fill(np.abs(x - centre) < width, (pale, pale, dark, accent)[rng.integers(4)])
    elif design == 2:
        lozenge = np.abs(((x * 3.75) % 1) - 0.5) + np.abs(((y * 3.0) % 1) - 0.5)
        c.fill(lozenge < 0.3, pale).fill(lozenge < 0.22, main).fill(lozenge < 0.1, accent)
        c.fill(np.abs(lozenge - 0.5) < 0.03, dark)
    elif design == 3:
        p, q = (x * 3 + y * 4) % 1, (x * 3 - y * 4) % 1
        line = np.minimum(np.minimum(p, 1 - p), np.minimum(q, 1 - q))
        c.fill(line < 0.07, pale)
    elif design == 4:
        for inset, shade in ((0.1, pale), (0.13, main), (0.22, dark), (0.25, main), (0.34, pale), (0.36, main)):
            c.fill(edge > inset, shade)
    if design not in (1, 4):
        c.fill(edge < 0.085, dark if design else accent * 0.8).fill(np.abs(edge - 0.085) < 0.008, pale)
        if design in (0, 2):
            along = np.where(0.667 - np.abs(x) < 0.5 - np.abs(y), y, x)
            c.fill((np.abs(edge - 0.045) < 0.018) & ((along * 14) % 1 < 0.5), pale)
    c.fill(np.abs(x) > 0.652, linear((226, 216, 196)))
    c.fill((np.abs(x) > 0.652) & ((y * 40) % 1 < 0.4), linear((150, 140, 120)))
    pile = 0.05 * noise(rng, (192, 256), 0.1) + (0.09 if design == 5 else 0.04) * noise(rng, (192, 256), 1.2)
    return c.rgb * np.exp(pile)[..., None]


def _books(rng: np.random.Generator, colour: str | None, variant: int) -> np.ndarray:
    """Spines with title bands in subdued colours."""
    names = ("red", "blue", "green", "brown", "beige", "grey", "black", "orange", "white", "purple", "yellow")
    weights = np.array([3, 4, 3, 3, 3, 3, 2, 1.5, 2, 1, 1])
    c = Canvas.blank(128, 256, linear((214, 204, 180)))
    u, v = c.x / 2, c.y
    across = (u * (SPINES + 1)) % 1
    c.fill((across * 5) % 1 < 0.3, linear((188, 176, 150)))
    for k, pick in enumerate(rng.choice(len(names), SPINES, p=weights / weights.sum())):
        mine = np.floor(u * (SPINES + 1)) == k
        tones = TONES[names[pick]]
        tone = linear(tones[rng.integers(len(tones))]) * rng.uniform(0.6, 1.0)
        light = linear((216, 190, 120)) if tone.mean() < 0.25 else tone * 0.25
        c.fill(mine, tone)
        band = rng.uniform(0.55, 0.72)
        if rng.random() < 0.5:
            c.fill(mine & (np.abs(v - 0.88) < 0.012) | mine & (np.abs(v - 0.14) < 0.012), light)
        if rng.random() < 0.4:
            c.fill(mine & (np.abs(v - band) < 0.13), tone * 0.45)
        c.fill(mine & (np.abs(v - band) < 0.1) & (np.abs(across - 0.5) < 0.12) & ((v * 26) % 1 < 0.72), light)
    return c.rgb * (0.75 + 0.25 * np.clip(np.minimum(across, 1 - across) * 8, 0, 1))[..., None]


def _screen(rng: np.random.Generator, colour: str | None, variant: int) -> np.ndarray:
    """Switched off with a reflection, twice; or a dim picture of hills, or of a studio."""
    c = Canvas.blank(144, 256, linear((14, 15, 18)))
    u, v = c.x * 144 / 256, c.y
    if variant < 2:
        sheen = np.clip(1 - np.abs(u + 0.5 * v - (0.55, 1.0)[variant]) / 0.3, 0, 1)
        return c.rgb + (0.012 + 0.03 * sheen * v)[..., None] * np.array([0.8, 0.9, 1.1])
    if variant == 2:
        c.rgb[:] = 0.14 * np.array([0.5, 0.75, 1.0]) * (0.5 + 0.7 * (1 - v))[..., None]
        for base, shade in ((0.5, (52, 66, 84)), (0.38, (44, 60, 54)), (0.22, (30, 44, 34))):
            c.fill(v < base + 0.06 * c.ridge(rng, 1.6), linear(shade))
    else:
        c.rgb[:] = 0.1 * np.array([0.35, 0.5, 1.0]) * (0.4 + np.abs(u - 0.5))[..., None]
        c.fill(np.hypot((u - 0.36) * 1.78, v - 0.62) < 0.13, linear((120, 92, 76)))
        c.fill(np.hypot((u - 0.36) * 1.78 / 1.5, v - 0.2) < 0.25, linear((40, 42, 58)))
        c.fill((np.abs(u - 0.75) < 0.16) & (np.abs(v - 0.6) < 0.18), linear((78, 94, 120)))
        c.fill(v < 0.14, linear((84, 30, 34))).fill((np.abs(v - 0.07) < 0.025) & (u < 0.7), linear((140, 134, 130)))
    return c.rgb


PICTURES: dict[str, Picture] = {
    "rug": Picture(tuple(_PARTNERS), 18, _rug),
    "art": Picture(tuple(MOTIFS_OF), 24, lambda rng, colour, variant: paint(rng, colour or "blue", variant)),
    "books": Picture((), 4, _books),
    "screen": Picture((), 4, _screen, 0.5),
}
