"""Motifs for paintings: sea, mountains, fields, woods, a town; `main` leads in each."""

from __future__ import annotations

import numpy as np

from eagor.worlds.apartment.brushes import INK, PAPER, blossom, gradient, pale
from eagor.worlds.apartment.canvas import Canvas, linear, noise


def sea(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
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
    c.fill((up > 0.08) & (right > 0.04) & (up < 1 - right), PAPER).fill(
        (up > 0.12) & (right < -0.04) & (up < 0.8 + 1.1 * right), linear((214, 200, 180))
    )
    c.fill(c.disc(x, y, 0.1, 0.022) * (c.y < y + 0.008), linear((92, 52, 40)))


def mountains(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Ridge behind ridge, paler with distance."""
    gradient(c, linear((244, 226, 204)), pale(main, 0.3))
    if rng.random() < 0.6:
        c.fill(c.disc(rng.uniform(0.2, 0.8) * c.aspect, 0.8, 0.06), linear((250, 240, 214)))
    for k, level in enumerate((0.66, 0.54, 0.4, 0.27, 0.12)):
        crest = level + (0.08 - 0.009 * k) * c.ridge(rng, 1.25)
        c.fill(np.clip((crest - c.y) * 150, 0, 1), pale(main, 0.45 - 0.12 * k) * (1.0 - 0.09 * k))
        if k == 0:
            c.fill((c.y < crest) & (c.y > 0.7 + 0.02 * c.ridge(rng, 0.8)), PAPER)


def hills(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
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


def birches(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
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


def poppies(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Blossoms in a meadow, larger towards the viewer."""
    gradient(c, linear((62, 92, 52)), linear((206, 220, 214)), 1.6)
    c.fill(np.clip(noise(rng, c.shape, 0.5, 0.15) - 0.5, 0, 0.7) * (c.y < 0.6), linear((112, 140, 80)))
    for y in np.sort(rng.uniform(0.03, 0.8, 60))[::-1]:
        x, size = rng.uniform(0, c.aspect), 0.02 + 0.085 * (0.85 - y)
        c.line((x, y), (x + rng.normal(0, 0.02), y - 3 * size), 0.1 * size + 0.004, linear((70, 104, 60)))
        blossom(rng, c, x, y, size, main * rng.uniform(0.85, 1.15))


def skyline(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
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


def pines(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Conifers in mist under a moon."""
    gradient(c, pale(main, 0.35), main * 0.85)
    c.fill(c.disc(rng.uniform(0.2, 0.8) * c.aspect, rng.uniform(0.72, 0.85), 0.08), linear((246, 242, 226)))
    for layer in range(4):
        for x in rng.uniform(0, c.aspect, 9):
            high, foot = rng.uniform(0.25, 0.42) * (0.75 + 0.17 * layer), 0.36 - 0.13 * layer
            t = np.clip((foot + high - c.y) / high, 0, 1)
            half = 0.17 * high * t * (0.65 + 0.35 * ((t * 7) % 1)) * 1.6
            c.fill((np.abs(c.x - x) < half) & (c.y > foot - 0.05), pale(main, 0.3 - 0.1 * layer) * (0.95 - 0.2 * layer))
        c.fill(
            c.y < 0.34 - 0.13 * layer + 0.01 * c.ridge(rng, 1.5), pale(main, 0.3 - 0.1 * layer) * (0.9 - 0.2 * layer)
        )
