"""Paintings: abstracts, flowers and still lifes, and which motifs, landscapes too, suit which leading colour."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from eagor.worlds.apartment import landscapes
from eagor.worlds.apartment.brushes import INK, PAPER, accent, blossom, gradient, pale
from eagor.worlds.apartment.canvas import Canvas, linear, noise
from eagor.worlds.apartment.palette import TONES

_SHAPES = ((192, 256), (256, 192), (208, 208))


def paint(rng: np.random.Generator, colour: str, variant: int) -> np.ndarray:
    """A painting in which `colour` leads, linear RGB ``(h, w, 3)``; `variant` selects among the colour's motifs."""
    motifs = MOTIFS_OF[colour]
    draw, shapes = motifs[variant % len(motifs)]
    height, width = _SHAPES[shapes[int(rng.integers(len(shapes)))]]
    tones = TONES[colour]
    main = linear(tones[int(rng.integers(len(tones)))])
    canvas = Canvas.blank(height, width, main)
    draw(rng, canvas, main)
    brush = 0.035 * noise(rng, canvas.shape, 0.5, 3) + 0.03 * noise(rng, canvas.shape, 1.2)
    return canvas.rgb * np.exp(brush)[..., None]


def _blocks(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Rectangles between black bars, the largest in the main colour."""
    xs = np.sort(np.append(rng.uniform(0.1, 0.9, 3) * c.aspect, [0, c.aspect]))
    ys = np.sort(np.append(rng.uniform(0.12, 0.88, 3), [0, 1]))
    sizes = np.outer(np.diff(xs), np.diff(ys))
    order = np.argsort(-sizes.ravel())
    for rank, cell in enumerate(order):
        i, j = divmod(int(cell), 4)
        inside = (c.x >= xs[i]) & (c.x < xs[i + 1]) & (c.y >= ys[j]) & (c.y < ys[j + 1])
        c.fill(inside, main if rank < 3 else (PAPER, PAPER, accent(rng), main)[rng.integers(4)])
    for at in xs[1:-1]:
        c.fill(np.abs(c.x - at) < 0.014, INK)
    for at in ys[1:-1]:
        c.fill(np.abs(c.y - at) < 0.014, INK)


def _fields(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Two or three soft-edged fields on a ground of the same colour."""
    c.rgb[:] = main * 0.75
    wobble = 0.012 * noise(rng, c.shape, 1.2)
    cuts = np.sort(np.append(rng.uniform(0.3, 0.7, 1), [0.07, 0.93]))
    if rng.random() < 0.5:
        cuts = np.array([0.07, 0.3, rng.uniform(0.5, 0.65), 0.93])
    shades = [main * 1.15, pale(main, 0.45), accent(rng)]
    for k, (low, high) in enumerate(pairwise(cuts)):
        gap = np.minimum(np.minimum(c.x - 0.07, c.aspect - 0.07 - c.x), np.minimum(c.y - low, high - c.y) - 0.015)
        c.fill(np.clip((gap + wobble) / 0.03, 0, 1) * 0.92, shades[(k + 1) % 3] if k else shades[0])


def _circles(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Discs and rings that overlap."""
    c.rgb[:] = pale(main, 0.08)
    for k in range(14):
        x, y, radius = rng.uniform(0, c.aspect), rng.uniform(0, 1), rng.uniform(0.06, 0.26)
        shade = main * rng.uniform(0.7, 1.2) if k % 4 else accent(rng)
        c.spot(x, y, radius, shade, 0.85)
        if k % 2:
            c.spot(x, y, radius * 0.62, pale(shade, 0.4), 0.9)
            c.spot(x, y, radius * 0.3, INK if rng.random() < 0.3 else shade)
    c.fill(c.stroke((0, rng.uniform(0, 1)), (c.aspect, rng.uniform(0, 1)), 0.012), INK)


def _waves(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Bands that swing, from pale to deep."""
    gradient(c, main, pale(main, 0.4))
    for k, level in enumerate(np.linspace(0.95, 0.05, 10)):
        phase, turns, lift = rng.uniform(0, 7), rng.uniform(4, 7), rng.uniform(0.03, 0.07)
        edge = level + lift * np.sin(turns * c.x + phase)
        shade = pale(main, 0.5 * rng.random()) if k % 4 != 2 else accent(rng) * 0.9
        c.fill(np.clip((edge - c.y) * 150, 0, 1), shade if k % 2 else main * rng.uniform(0.6, 1.1))


def _strokes(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Broad brush strokes across each other."""
    c.rgb[:] = main * 0.95
    for k in range(46):
        x, y = rng.uniform(0, c.aspect), rng.uniform(0, 1)
        angle, length = rng.normal(0.6, 0.5), rng.uniform(0.1, 0.4)
        dx, dy = length * np.cos(angle), length * np.sin(angle)
        shade = (main * rng.uniform(0.55, 1.25), pale(main, rng.uniform(0.1, 0.7)), accent(rng))[(0, 0, 1, 0, 2)[k % 5]]
        c.line((x - dx, y - dy), (x + dx, y + dy), rng.uniform(0.03, 0.11), shade, 0.9)


def _vase(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """A bunch of flowers in a vase on a table."""
    gradient(c, main * 0.9, pale(main, 0.2))
    middle = c.aspect / 2
    c.fill(c.y < 0.22, linear((128, 92, 66)))
    body = accent(rng)
    c.fill(c.disc(middle, 0.26, 0.15, 0.16), body).fill(
        (np.abs(c.x - middle) < 0.07) & (np.abs(c.y - 0.42) < 0.06), body
    )
    c.fill(c.disc(middle - 0.05, 0.28, 0.03, 0.08) * 0.5, PAPER)
    heads = np.stack([rng.normal(0, 0.16, 15), rng.uniform(0.5, 0.88, 15)], axis=-1)
    for dx, y in heads:
        c.line((middle, 0.44), (middle + dx, y), 0.012, linear((58, 96, 58)))
        c.fill(c.disc(middle + 0.6 * dx + 0.03, 0.3 + 0.5 * y, 0.05, 0.02), linear((70, 112, 66)))
    for k, (dx, y) in enumerate(heads):
        blossom(
            rng, c, middle + dx, y, rng.uniform(0.045, 0.075), pale(main, 0.1) if k % 2 else pale(accent(rng), 0.25)
        )


def _fruit(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """A bowl of fruit on a cloth."""
    gradient(c, main * 0.75, main * 1.05)
    c.fill(c.y < 0.32, pale(main, 0.6)).fill((c.y < 0.3) & ((c.x * 6) % 1 < 0.12), main)
    middle = c.aspect / 2
    for dx, dy in ((-0.2, 0.13), (0.2, 0.13), (-0.1, 0.21), (0.1, 0.21), (0, 0.15), (0.02, 0.29)):
        shade = linear(TONES[("red", "orange", "yellow", "green", "purple")[rng.integers(5)]][0])
        x, y, size = middle + dx + rng.normal(0, 0.015), 0.36 + dy, rng.uniform(0.085, 0.11)
        c.spot(x, y, size, shade * 0.8)
        c.spot(x - 0.02, y + 0.02, 0.75 * size, shade * 1.15, 0.6)
        c.spot(x - 0.035, y + 0.04, 0.2 * size, PAPER, 0.6)
    c.fill(c.disc(middle, 0.42, 0.36, 0.24) * (c.y < 0.42), linear((198, 202, 206)))
    c.fill(c.disc(middle - 0.08, 0.38, 0.2, 0.12) * (c.y < 0.4) * 0.5, PAPER)
    c.fill(c.disc(middle, 0.18, 0.14, 0.025), linear((150, 152, 158)))


def _botanical(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """A branch with leaves pale on a ground of the colour, as in a print."""
    c.rgb[:] = main
    middle, lean = c.aspect / 2, rng.normal(0, 0.06)
    c.fill(c.stroke((middle - lean, 0.06), (middle + lean, 0.88), 0.016), pale(main, 0.7))
    for k, y in enumerate(np.linspace(0.16, 0.9, 12)):
        side, length = (-1) ** k, 0.34 * (1.15 - 0.75 * y)
        x = middle - lean + 2 * lean * (y - 0.06) / 0.82
        angle = (np.pi / 2 - side * 0.95) if k < 11 else np.pi / 2
        p = (c.x - x) * np.cos(angle) + (c.y - y) * np.sin(angle)
        q = -(c.x - x) * np.sin(angle) + (c.y - y) * np.cos(angle)
        t = np.clip(p / length, 0, 1)
        leaf = np.clip((0.3 * length * np.sin(np.pi * t**0.8) - np.abs(q)) * c.shape[0], 0, 1) * (p > 0) * (p < length)
        c.fill(leaf, pale(main, rng.uniform(0.5, 0.8))).fill(leaf * (np.abs(q) < 0.005), main)


_Motif = tuple[Callable[[np.random.Generator, Canvas, np.ndarray], None], tuple[int, ...]]
_WIDE, _TALL, _ANY = (0, 0, 2), (1,), (0, 1, 2)
_ABSTRACT: tuple[_Motif, ...] = (
    (_blocks, _ANY), (_fields, (1, 2)), (_circles, _ANY), (_waves, _ANY), (_strokes, _ANY),
)  # fmt: skip
MOTIFS_OF: dict[str, tuple[_Motif, ...]] = {
    "blue": (
        *_ABSTRACT,
        (landscapes.sea, _WIDE),
        (landscapes.mountains, _WIDE),
        (landscapes.pines, _ANY),
        (landscapes.skyline, _WIDE),
        (_botanical, _TALL),
    ),
    "green": (
        *_ABSTRACT,
        (landscapes.hills, _WIDE),
        (landscapes.birches, _ANY),
        (_botanical, _TALL),
        (landscapes.pines, _ANY),
        (_fruit, _WIDE),
    ),
    "red": (*_ABSTRACT, (landscapes.poppies, _ANY), (_vase, _TALL), (_fruit, _WIDE), (landscapes.skyline, _WIDE)),
    "orange": (
        *_ABSTRACT,
        (landscapes.sea, _WIDE),
        (landscapes.birches, _ANY),
        (landscapes.poppies, _ANY),
        (landscapes.skyline, _WIDE),
        (_fruit, _WIDE),
    ),
    "yellow": (
        *_ABSTRACT,
        (landscapes.hills, _WIDE),
        (landscapes.birches, _ANY),
        (_vase, _TALL),
        (landscapes.poppies, _ANY),
        (_fruit, _WIDE),
    ),
    "purple": (
        *_ABSTRACT,
        (landscapes.mountains, _WIDE),
        (_vase, _TALL),
        (landscapes.poppies, _ANY),
        (landscapes.pines, _ANY),
    ),
    "pink": (
        *_ABSTRACT,
        (landscapes.sea, _WIDE),
        (_vase, _TALL),
        (landscapes.poppies, _ANY),
        (landscapes.mountains, _WIDE),
    ),
    "grey": (
        *_ABSTRACT,
        (landscapes.mountains, _WIDE),
        (landscapes.pines, _ANY),
        (landscapes.sea, _WIDE),
        (landscapes.birches, _ANY),
    ),
    "beige": (*_ABSTRACT, (landscapes.mountains, _WIDE), (_fruit, _WIDE), (_vase, _TALL), (_botanical, _TALL)),
}
"""The motifs of each colour that paintings come in, and the formats that suit them."""
