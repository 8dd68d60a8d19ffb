"""Coloured textures (rugs, book spines, screens, paintings): linear RGB ``(h, w, 3)``, first row at the top.

Paintings are abstracts, flowers, still lifes and landscapes; `MOTIFS_OF` says which of them suit which main colour.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment.canvas import INK, PAPER, TONES, Canvas, accent, blossom, gradient, linear, noise, pale

_SHAPES = ((192, 256), (256, 192), (208, 208))
_WIDE, _TALL, _ANY = (0, 0, 2), (1,), (0, 1, 2)
_SUITING = {
    "blue": "sea mountains pines skyline botanical",
    "green": "hills birches botanical pines fruit",
    "red": "poppies vase fruit skyline",
    "orange": "sea birches poppies skyline fruit",
    "yellow": "hills birches vase poppies fruit",
    "purple": "mountains vase poppies pines",
    "pink": "sea vase poppies mountains",
    "grey": "mountains pines sea birches",
    "beige": "mountains fruit vase botanical",
}
SPINES = 15  # of books side by side in a "books" texture, each 1/16 of its width; the last sixteenth is cut pages
# For each main colour of a rug: a second colour, and one for small motifs.
_PARTNERS: dict[str, tuple[str, str]] = {
    "red": ("beige", "blue"), "blue": ("beige", "red"), "beige": ("brown", "grey"), "grey": ("white", "black"),
    "green": ("beige", "brown"), "brown": ("beige", "orange"), "orange": ("beige", "brown"),
    "purple": ("beige", "pink"), "yellow": ("white", "grey"), "pink": ("white", "red"), "white": ("grey", "black"),
    "black": ("white", "grey"),
}  # fmt: skip


def paint(rng: np.random.Generator, colour: str, variant: int) -> np.ndarray:
    """A painting dominated by `colour`, linear RGB ``(h, w, 3)``; `variant` selects among the colour's motifs."""
    motifs = MOTIFS_OF[colour]
    draw, shapes = _MOTIFS[motifs[variant % len(motifs)]]
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
    for place, cuts in ((c.x, xs), (c.y, ys)):
        for at in cuts[1:-1]:
            c.fill(np.abs(place - at) < 0.014, INK)


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
    c.fill(c.disc(middle, 0.26, 0.15, 0.16), body)
    c.fill((np.abs(c.x - middle) < 0.07) & (np.abs(c.y - 0.42) < 0.06), body)
    c.fill(c.disc(middle - 0.05, 0.28, 0.03, 0.08) * 0.5, PAPER)
    heads = np.stack([rng.normal(0, 0.16, 15), rng.uniform(0.5, 0.88, 15)], axis=-1)
    for dx, y in heads:
        c.line((middle, 0.44), (middle + dx, y), 0.012, linear((58, 96, 58)))
        c.fill(c.disc(middle + 0.6 * dx + 0.03, 0.3 + 0.5 * y, 0.05, 0.02), linear((70, 112, 66)))
    for k, (dx, y) in enumerate(heads):
        size = rng.uniform(0.045, 0.075)
        blossom(rng, c, middle + dx, y, size, pale(main, 0.1) if k % 2 else pale(accent(rng), 0.25))


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


def _sea(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """A horizon, the sun, its glitter, and a sailing boat."""
    horizon = rng.uniform(0.38, 0.5)
    gradient(c, pale(main, 0.5), main * 1.05, 1.0)
    sun = (rng.uniform(0.2, 0.8) * c.aspect, horizon + rng.uniform(0.1, 0.3))
    c.fill(c.disc(*sun, 0.07), linear((250, 226, 160)))
    water = c.y < horizon
    depth = np.clip((horizon - c.y) / horizon, 0, 1)[..., None]
    c.fill(water, main * (0.9 - 0.45 * depth))
    ripples = noise(rng, c.shape, 0.6, 25)
    c.fill(water & (ripples > 1.2), pale(main, 0.45))
    c.fill(water & (np.abs(c.x - sun[0]) < 0.03 + 0.1 * depth[..., 0]) & (ripples > 0.3), linear((246, 220, 160)))
    x, y = rng.uniform(0.25, 0.75) * c.aspect, horizon - rng.uniform(0.02, 0.1)
    up, right = (c.y - y) / 0.2, (c.x - x) / 0.09
    c.fill((up > 0.08) & (right > 0.04) & (up < 1 - right), PAPER)
    c.fill((up > 0.12) & (right < -0.04) & (up < 0.8 + 1.1 * right), linear((214, 200, 180)))
    c.fill(c.disc(x, y, 0.1, 0.022) * (c.y < y + 0.008), linear((92, 52, 40)))


def _mountains(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Ridge behind ridge, paler with distance."""
    gradient(c, linear((244, 226, 204)), pale(main, 0.3))
    if rng.random() < 0.6:
        c.fill(c.disc(rng.uniform(0.2, 0.8) * c.aspect, 0.8, 0.06), linear((250, 240, 214)))
    for k, level in enumerate((0.66, 0.54, 0.4, 0.27, 0.12)):
        crest = level + (0.08 - 0.009 * k) * c.ridge(rng, 1.25)
        c.fill(np.clip((crest - c.y) * 150, 0, 1), pale(main, 0.45 - 0.12 * k) * (1.0 - 0.09 * k))
        if k == 0:
            c.fill((c.y < crest) & (c.y > 0.7 + 0.02 * c.ridge(rng, 0.8)), PAPER)


def _hills(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Fields and trees under a sky with clouds."""
    gradient(c, linear((220, 232, 238)), linear((120, 168, 214)))
    c.fill(np.clip(noise(rng, c.shape, 1.6, 4) - 0.4, 0, 1) * (c.y > 0.5), PAPER)
    for k, level in enumerate((0.6, 0.48, 0.34, 0.16)):
        crest = level + 0.045 * c.ridge(rng, 2.2)
        c.fill(np.clip((crest - c.y) * 150, 0, 1), main * (1.25 - 0.17 * k))
        if k < 3:
            for _ in range(5):
                at = int(rng.integers(c.shape[1]))
                x, y, size = float(c.x[0, at]), float(crest[0, at]), rng.uniform(0.02, 0.045) * (1 + 0.4 * k)
                c.line((x, y - size), (x, y + size), 0.3 * size, linear((78, 58, 44)))
                c.spot(x, y + 1.5 * size, 1.1 * size, linear((44, 84, 52)) * rng.uniform(0.7, 1.2))
        else:
            c.fill((noise(rng, c.shape, 0.3, 0.4) > 1.4) & (c.y < crest), pale(main, 0.4))


def _birches(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """White trunks before foliage."""
    gradient(c, main * 0.7, main * 1.1)
    c.fill(np.clip(noise(rng, c.shape, 0.9) - 0.2, 0, 0.8), pale(main, 0.35))
    c.fill(np.clip(noise(rng, c.shape, 0.8) - 0.6, 0, 0.8), main * 0.5)
    for x in np.linspace(0.06, c.aspect - 0.06, 7) + rng.normal(0, 0.04, 7):
        width, lean = rng.uniform(0.025, 0.06), rng.normal(0, 0.04)
        trunk = c.stroke((x, -0.1), (x + lean, 1.1), width)
        side = np.clip((c.x - x - lean * c.y) / width + 0.5, 0, 1)[..., None]
        c.fill(trunk, linear((232, 228, 218)) * (0.55 + 0.45 * side))
        c.fill(trunk * (noise(rng, c.shape, 0.7, 12) > 1.3), INK)


def _poppies(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Blossoms in a meadow, larger towards the viewer."""
    gradient(c, linear((62, 92, 52)), linear((206, 220, 214)), 1.6)
    c.fill(np.clip(noise(rng, c.shape, 0.5, 0.15) - 0.5, 0, 0.7) * (c.y < 0.6), linear((112, 140, 80)))
    for y in np.sort(rng.uniform(0.03, 0.8, 60))[::-1]:
        x, size = rng.uniform(0, c.aspect), 0.02 + 0.085 * (0.85 - y)
        c.line((x, y), (x + rng.normal(0, 0.02), y - 3 * size), 0.1 * size + 0.004, linear((70, 104, 60)))
        blossom(rng, c, x, y, size, main * rng.uniform(0.85, 1.15))


def _skyline(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Houses of a town at dusk, windows lit."""
    gradient(c, pale(main, 0.4), main)
    for depth, (height, dark) in enumerate(((0.62, 0.55), (0.45, 0.3))):
        left = -0.03
        while left < c.aspect:
            width, top = rng.uniform(0.07, 0.17), height * rng.uniform(0.5, 1.15)
            near = c.window((left, 0), (left + width, top))
            house = (near.x >= left) & (near.x < left + width) & (near.y < top)
            near.fill(house, main * dark * rng.uniform(0.85, 1.15))
            cell = rng.random((20, 8)) < 0.45
            across, up = np.maximum(near.x - left, 0) * 22, near.y * 18
            lit = cell[up.astype(int), np.minimum(across, 7).astype(int)] & (up % 1 < 0.5) & (across % 1 < 0.5)
            near.fill(house & lit & (depth == 1), linear((244, 206, 120)))
            left += width + 0.004


def _pines(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Conifers in mist under a moon."""
    gradient(c, pale(main, 0.35), main * 0.85)
    c.fill(c.disc(rng.uniform(0.2, 0.8) * c.aspect, rng.uniform(0.72, 0.85), 0.08), linear((246, 242, 226)))
    for layer in range(4):
        mist = pale(main, 0.3 - 0.1 * layer)
        for x in rng.uniform(0, c.aspect, 9):
            high, foot = rng.uniform(0.25, 0.42) * (0.75 + 0.17 * layer), 0.36 - 0.13 * layer
            t = np.clip((foot + high - c.y) / high, 0, 1)
            half = 0.17 * high * t * (0.65 + 0.35 * ((t * 7) % 1)) * 1.6
            c.fill((np.abs(c.x - x) < half) & (c.y > foot - 0.05), mist * (0.95 - 0.2 * layer))
        ground = c.y < 0.34 - 0.13 * layer + 0.01 * c.ridge(rng, 1.5)
        c.fill(ground, mist * (0.9 - 0.2 * layer))


# The function that draws each motif, and the formats that suit it.
_MOTIFS: dict[str, tuple[Callable[[np.random.Generator, Canvas, np.ndarray], None], tuple[int, ...]]] = {
    "blocks": (_blocks, _ANY), "fields": (_fields, (1, 2)), "circles": (_circles, _ANY), "waves": (_waves, _ANY),
    "strokes": (_strokes, _ANY), "vase": (_vase, _TALL), "fruit": (_fruit, _WIDE), "botanical": (_botanical, _TALL),
    "sea": (_sea, _WIDE), "mountains": (_mountains, _WIDE), "hills": (_hills, _WIDE), "birches": (_birches, _ANY),
    "poppies": (_poppies, _ANY), "skyline": (_skyline, _WIDE), "pines": (_pines, _ANY),
}  # fmt: skip
MOTIFS_OF = {colour: (*list(_MOTIFS)[:5], *names.split()) for colour, names in _SUITING.items()}
"""The motifs of each colour that paintings come in: the abstract ones suit all."""


@dataclass(frozen=True)
class Picture:
    """A kind of picture: colours (empty: none), variants, `draw(rng, colour, variant)`: linear RGB ``(h, w, 3)``."""

    colours: tuple[str, ...]
    variants: int
    draw: Callable[[np.random.Generator, str | None, int], np.ndarray]
    emission: float = 0.0


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
