"""Procedural, periodic materials of a home: cloth, wood, tiles, plaster and others.

Furniture and walls only need `material`. Textures are grey if one drawing serves every colour (the colour of the
`Material` tints them), and coloured for rugs, paintings, books and screens. Each is drawn once per process, from a
generator of its own, so that it depends on its name alone.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import cache

import numpy as np

from eagor._arrays import frozen
from eagor._srgb import to_coded, to_linear
from eagor.lab.worlds.apartment.pictures import PICTURES, noise, sRGB
from eagor.lab.worlds.scene import Material

# Metres that one repeat covers, in u and v. Leaves, lampshades, rugs, art, screens and books are drawn from edge to
# edge; their builders set uv from 0 to 1.
REPEAT: dict[str, float] = {
    "fabric": 0.4, "leather": 0.6, "wood": 1.0, "metal": 0.5, "plastic": 1.0, "ceramic": 1.0, "paint": 1.0,
    "wicker": 0.16, "glass": 1.0, "marble": 1.2, "tile": 0.6, "parquet": 1.6, "carpet": 0.6, "plaster": 2.0,
    "earth": 0.3, "leaf": 1.0, "rug": 1.0, "art": 1.0, "screen": 1.0, "books": 1.0, "lampshade": 1.0,
}  # fmt: skip

# Default colour of a kind: a named colour, or sRGB tones (0 to 255).
_NATURAL: dict[str, tuple[str | tuple[int, int, int], ...]] = {
    "fabric": ("grey", "beige", "blue"), "leather": ("brown", "black"), "plastic": ("white", "black"),
    "ceramic": ("white",), "paint": ("white",), "leaf": ("green",), "earth": ((72, 54, 42),),
    "glass": ((186, 204, 212),), "lampshade": ((255, 240, 214),), "metal": ((176, 178, 182), (150, 152, 156)),
    "wicker": ((176, 140, 96), (150, 112, 72)), "marble": ((232, 230, 226), (222, 214, 202)),
    "wood": ((150, 104, 66), (122, 80, 50), (176, 134, 92), (92, 60, 40)),
    "tile": ((232, 230, 224), (206, 212, 214), (214, 204, 188), (186, 196, 196)),
    "parquet": ((178, 138, 96), (150, 110, 74), (196, 164, 124), (122, 86, 58)),
    "carpet": ((178, 170, 158), (150, 150, 150), (140, 128, 116), (126, 134, 142)),
    "plaster": ((240, 236, 226), (238, 232, 216), (226, 230, 226), (222, 228, 232), (236, 224, 212), (230, 230, 214)),
}  # fmt: skip


def material(kind: str, colour: str | None, rng: np.random.Generator) -> Material:
    """A material of a kind of `REPEAT`, in a tone of a named colour; None for the kind's default.

    All materials of the same variant share the texture; do not write to it.
    """
    name = f"{colour} {kind}" if colour else kind
    if kind in PICTURES:
        picture = PICTURES[kind]
        if colour is None and picture.colours:
            colour = picture.colours[rng.integers(len(picture.colours))]
        texture = _picture(kind, colour, int(rng.integers(picture.variants)))
        return Material(name, (1.0, 1.0, 1.0), texture, picture.emission)
    tone = _tone(kind, colour, rng)
    # At full strength a coloured shade would saturate to a primary.
    emission = 0.0 if kind != "lampshade" else 1.5 if colour in (None, "white", "beige") else 0.9
    if kind not in SURFACES:
        return Material(name, tone, None, emission)
    variants, _ = SURFACES[kind]
    texture, mean = _surface(kind, int(rng.integers(variants)))
    linear = to_linear(np.array(tone)) / mean  # so that the mean of texture times colour is the tone
    r, g, b = np.where(linear < 1, to_coded(linear), 1.0)
    return Material(name, (float(r), float(g), float(b)), texture, emission)


def _tone(kind: str, colour: str | None, rng: np.random.Generator) -> tuple[float, float, float]:
    if colour is not None:
        return sRGB(colour, rng)
    choices = _NATURAL[kind]
    choice = choices[rng.integers(len(choices))]
    if isinstance(choice, str):
        return sRGB(choice, rng)
    r, g, b = np.minimum(np.array(choice) / 255 * rng.uniform(0.97, 1.03), 1.0)
    return float(r), float(g), float(b)


@cache
def _surface(kind: str, variant: int) -> tuple[np.ndarray, np.ndarray]:
    """A tintable texture ``(h, w, 3)`` uint8, as bright as 8 bits allow, and its mean ``(3,)`` in linear light."""
    relative = SURFACES[kind][1](_generator(kind, variant), variant)
    if relative.ndim == 2:
        relative = relative[..., None] * np.ones(3)
    texture = _coded(relative / np.percentile(relative, 99))
    return texture, frozen(to_linear(texture / 255).mean(axis=(0, 1)))


@cache
def _picture(kind: str, colour: str | None, variant: int) -> np.ndarray:
    """A coloured texture with its brightness as drawn."""
    return _coded(PICTURES[kind].draw(_generator(f"{kind} {colour}", variant), colour, variant))


def _generator(name: str, variant: int) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(name.encode()), variant])


def _coded(linear: np.ndarray) -> np.ndarray:
    return frozen(np.rint(255 * to_coded(linear)).astype(np.uint8))


def _carpet(rng: np.random.Generator, variant: int) -> np.ndarray:
    return np.exp(0.1 * noise(rng, (256, 256), 0.1 + 0.3 * variant) + 0.05 * noise(rng, (256, 256), 1.5))


def _leather(rng: np.random.Generator, variant: int) -> np.ndarray:
    grain = np.abs(noise(rng, (256, 256), 0.8)) ** 0.5
    return np.exp(0.12 * grain + 0.06 * noise(rng, (256, 256), 2.0))


def _fabric(rng: np.random.Generator, variant: int) -> np.ndarray:
    """Plain weave, twill, melange, corduroy: fine, with soft large variation."""
    size = 256
    v, u = np.mgrid[:size, :size]
    turns = 2 * np.pi / size
    if variant == 0:
        weave = np.where((u // 2 + v // 2) % 2 == 0, np.sin(turns * 64 * v), np.sin(turns * 64 * u))
    elif variant == 1:
        weave = np.sin(turns * 48 * (u + v))
    elif variant == 2:
        weave = 1.5 * noise(rng, (size, size), 0.3, 8) + 1.5 * noise(rng, (size, size), 0.3, 1 / 8)
    else:
        weave = 1.6 * np.abs(np.sin(turns * 16 * u)) ** 0.5
    threads = 0.35 * noise(rng, (size, size), 0.2, 6) + 0.35 * noise(rng, (size, size), 0.2, 1 / 6)
    return np.exp(0.045 * weave + 0.05 * threads + 0.035 * noise(rng, (size, size), 1.6))


def _wood(rng: np.random.Generator, variant: int) -> np.ndarray:
    """Grain along u: growth rings cut at a slant, pores, and slow changes of tone."""
    shape = (256, 256)
    v = np.arange(256)[:, None] / 256
    bend = noise(rng, shape, 2.2, 6) * (0.16, 0.3, 0.5)[variant]
    rings = np.sin(2 * np.pi * (v * (10, 6, 4)[variant] + bend))
    grain = 0.5 * rings + 0.5 * noise(rng, shape, 0.9, 30) + 0.4 * noise(rng, shape, 0.2, 60)
    return np.exp(0.11 * grain[..., None] * np.array([0.8, 1.0, 1.25]))


def _wicker(rng: np.random.Generator, variant: int) -> np.ndarray:
    v, u = np.mgrid[:128, :128] / 128
    over = (np.floor(u * 4) + np.floor(v * 8)) % 2
    strand = np.abs(np.sin(np.pi * 8 * v)) * (0.55 + 0.45 * np.abs(np.sin(np.pi * (4 * u + 0.5 * over))))
    return 0.35 + 0.65 * strand**0.6 * np.exp(0.1 * noise(rng, (128, 128), 0.8, 8))


def _marble(rng: np.random.Generator, variant: int) -> np.ndarray:
    veins = np.abs(noise(rng, (256, 256), 2.1) + 0.03 * noise(rng, (256, 256), 1.0))
    return np.exp(-0.35 * np.exp(-12 * veins) + 0.05 * noise(rng, (256, 256), 1.8))


def _tile(rng: np.random.Generator, variant: int) -> np.ndarray:
    """Tiles with grout: square, brick bond, small squares, or large slabs."""
    rows, columns, shift = ((2, 2, 0.0), (6, 3, 0.5), (6, 6, 0.0), (2, 1, 0.5))[variant]
    v, u = (np.mgrid[:256, :256] + 0.5) / 256
    row = np.floor(v * rows)
    along = (u * columns + shift * (row % 2)) % columns
    edge_u = np.abs(along - np.round(along)) / columns
    edge_v = np.abs(v * rows - np.round(v * rows)) / rows
    edge = np.minimum(edge_u, edge_v) * 256
    tones = np.exp(0.035 * rng.standard_normal((rows, columns)))[row.astype(int), np.floor(along).astype(int)]
    body = tones * np.exp(0.02 * noise(rng, (256, 256), 1.5)) * (0.93 + 0.07 * np.clip((edge - 1) / 3, 0, 1))
    return np.where(edge < 1.4, 0.62, body)


def _parquet(rng: np.random.Generator, variant: int) -> np.ndarray:
    """Boards along u with shifted ends, each with its own tone and piece of grain."""
    rows, pieces = ((12, 2), (8, 1), (16, 3))[variant]
    v, u = (np.mgrid[:256, :256] + 0.5) / 256
    row = np.floor(v * rows).astype(int)
    along = (u * pieces + rng.random(rows)[row]) % pieces
    board = np.floor(along).astype(int)
    tone = rng.normal(0, 0.12, (rows, pieces))[row, board]
    offset = rng.integers(0, 256, (rows, pieces))[row, board]
    column, line = np.arange(256)[None, :], np.arange(256)[:, None]
    grain = (0.6 * noise(rng, (256, 256), 1.0, 30) + 0.5 * noise(rng, (256, 256), 0.3, 40))[
        (line + offset) % 256, (column + 7 * offset) % 256
    ]
    gap_v = np.abs(v * rows - np.round(v * rows)) / rows * 256
    gap_u = np.abs(along - np.round(along)) / pieces * 256
    joint = np.where(np.minimum(gap_v, gap_u) < 0.6, 0.55, 1.0)
    return joint[..., None] * np.exp((tone + 0.09 * grain)[..., None] * np.array([0.85, 1.0, 1.2]))


def _leaf(rng: np.random.Generator, variant: int) -> np.ndarray:
    """A midrib along u at the middle of v, side veins, and mottling; u from stalk to tip."""
    v, u = (np.mgrid[:128, :128] + 0.5) / 128
    across = np.abs(v - 0.5) * 2
    rib = np.exp(-((across / 0.06) ** 2))
    veins = np.exp(-((((u * 8 - across * 2.5) % 1) - 0.5) ** 2) / 0.012)
    light = 0.3 * rib + 0.14 * veins + 0.08 * noise(rng, (128, 128), 1.2)
    return np.exp(light[..., None] * np.array([1.15, 1.0, 0.9]))


def _lampshade(rng: np.random.Generator, variant: int) -> np.ndarray:
    """Cloth lit from inside: brightest a little below its middle; u round it, v from bottom to top."""
    v = 1 - (np.arange(64)[:, None] + 0.5) / 64
    glow = 0.6 + 0.4 * np.exp(-(((v - 0.42) / 0.35) ** 2))
    weave = np.exp(0.03 * noise(rng, (64, 64), 0.2, 8) + 0.03 * noise(rng, (64, 64), 0.2, 1 / 8))
    return (glow * weave)[..., None] * (glow[..., None] ** np.array([0.0, 0.12, 0.35]))


def _layers(size: int, *layers: tuple[float, ...]) -> Callable[[np.random.Generator, int], np.ndarray]:
    """A function that draws a sum of layers of noise: amplitude, slope and stretch of each."""

    def draw(rng: np.random.Generator, variant: int) -> np.ndarray:
        return np.exp(sum(strength * noise(rng, (size, size), *shape) for strength, *shape in layers))

    return draw


SURFACES: dict[str, tuple[int, Callable[[np.random.Generator, int], np.ndarray]]] = {
    "fabric": (4, _fabric), "leather": (2, _leather), "wood": (3, _wood), "wicker": (1, _wicker),
    "marble": (2, _marble), "tile": (4, _tile), "parquet": (3, _parquet), "carpet": (2, _carpet),
    "leaf": (2, _leaf), "lampshade": (1, _lampshade), "earth": (1, _layers(128, (0.35, 0.5))),
    "metal": (1, _layers(128, (0.06, 0.3, 60), (0.04, 1.5))),
    "paint": (1, _layers(128, (0.025, 0.6), (0.02, 2))),
    "plaster": (2, _layers(256, (0.012, 0.5), (0.015, 2.0))),
}  # fmt: skip
"""Kinds that are tinted: how many variants there are, and what draws one. The other kinds are plain."""
