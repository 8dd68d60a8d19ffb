"""Materials of a home and what draws them: cloth, wood, tiles, plaster; rugs, paintings, books and screens.

Textures are periodic and grey if one drawing serves every colour (the colour
of the `Material` tints them); rugs, paintings, books and screens are coloured pictures. Each is drawn once per process,
from a generator of its own, so that it depends on its name alone. Drawings are linear light ``(h, w, 3)``, or
``(h, w)`` if they are grey, first row at the top.

Named colours are tones of cloth, paint and wood rather than pure primaries; the names are those of
`eagor.queries.COLOURS`. Each has a few tones, and every call of `sRGB` varies the tone a little, so that two red chairs
are both red but not identical. All other colours are linear RGB ``(3,)``.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from eagor._arrays import frozen
from eagor._srgb import to_coded, to_linear
from eagor.lab.worlds.scene import Material

RGB = tuple[float, float, float]

# sRGB, 0 to 255. Each keeps its name from full light down to a third of it, as far as possible: beige and pink in deep
# shade look brown and purple to anyone, white looks grey.
TONES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "black": ((32, 32, 34), (27, 26, 28), (35, 33, 32)),
    "white": ((243, 241, 236), (238, 238, 236), (245, 244, 241)),
    "grey": ((128, 130, 132), (148, 148, 147), (106, 109, 112), (139, 137, 134)),
    "red": ((168, 38, 42), (182, 48, 44), (150, 32, 38)),
    "orange": ((216, 112, 34), (224, 126, 44), (204, 102, 30)),
    "yellow": ((224, 180, 50), (216, 170, 40), (232, 190, 66)),
    "green": ((66, 112, 72), (88, 124, 70), (48, 98, 70)),
    "blue": ((56, 88, 140), (76, 112, 160), (44, 66, 112)),
    "purple": ((106, 62, 132), (122, 78, 150), (92, 52, 116)),
    "pink": ((224, 146, 164), (216, 132, 154), (232, 162, 176)),
    "brown": ((122, 80, 48), (106, 68, 40), (136, 90, 54)),
    "beige": ((216, 198, 166), (222, 206, 176), (208, 190, 156)),
}
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
    tint = to_linear(np.array(tone)) / mean  # so that the mean of texture times colour is the tone
    r, g, b = np.where(tint < 1, to_coded(tint), 1.0)
    return Material(name, (float(r), float(g), float(b)), texture, emission)


def _tone(kind: str, colour: str | None, rng: np.random.Generator) -> RGB:
    choice = colour or _NATURAL[kind][rng.integers(len(_NATURAL[kind]))]
    if isinstance(choice, str):
        return sRGB(choice, rng)
    r, g, b = np.minimum(np.array(choice) / 255 * rng.uniform(0.97, 1.03), 1.0)
    return float(r), float(g), float(b)


def sRGB(colour: str, rng: np.random.Generator) -> RGB:
    """A tone of a named colour, sRGB in [0, 1]."""
    tones = TONES[colour]
    tone = np.array(tones[rng.integers(len(tones))]) / 255
    hue = 0.005 if colour in ("black", "white", "grey") else 0.015  # more would turn white into pink or green
    shifted = tone * rng.uniform(0.95, 1.05) * rng.uniform(1 - hue, 1 + hue, size=3)
    r, g, b = np.clip(shifted, 0.0, 0.97)
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


def _coded(light: np.ndarray) -> np.ndarray:
    return frozen(np.rint(255 * to_coded(light)).astype(np.uint8))


# --- surfaces that are tinted -----------------------------------------------------------------------------------------


def noise(rng: np.random.Generator, shape: tuple[int, int], slope: float = 1.0, stretch: float = 1.0) -> np.ndarray:
    """Periodic noise ``(rows, columns)``: mean 0, standard deviation 1, amplitude 1 / frequency ** slope.

    `stretch` > 1 stretches it along the columns (u), < 1 along the rows.
    """
    rows, columns = shape
    v, u = np.meshgrid(np.fft.fftfreq(rows, 1 / rows), np.fft.rfftfreq(columns, 1 / columns), indexing="ij")
    frequency = np.hypot(u * stretch**0.5, v / stretch**0.5)
    frequency[0, 0] = 1.0
    amplitude = frequency**-slope
    amplitude[0, 0] = 0.0
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * amplitude, shape)
    return field / field.std()


def _layers(size: int, *variants: tuple[tuple[float, ...], ...]) -> Callable[[np.random.Generator, int], np.ndarray]:
    """A function that draws a sum of layers of noise: amplitude, slope and stretch of each layer of each variant."""

    def draw(rng: np.random.Generator, variant: int) -> np.ndarray:
        return np.exp(sum(strength * noise(rng, (size, size), *shape) for strength, *shape in variants[variant]))

    return draw


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


def _to_line(place: np.ndarray, count: int) -> np.ndarray:
    """Pixels to the nearest whole number of `place`, which runs from 0 to `count` over 256 pixels."""
    return np.abs(place - np.round(place)) / count * 256


def _tile(rng: np.random.Generator, variant: int) -> np.ndarray:
    """Tiles with grout: square, brick bond, small squares, or large slabs."""
    rows, columns, shift = ((2, 2, 0.0), (6, 3, 0.5), (6, 6, 0.0), (2, 1, 0.5))[variant]
    v, u = (np.mgrid[:256, :256] + 0.5) / 256
    row = np.floor(v * rows)
    along = (u * columns + shift * (row % 2)) % columns
    edge = np.minimum(_to_line(along, columns), _to_line(v * rows, rows))
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
    line, column = np.mgrid[:256, :256]
    grain = 0.6 * noise(rng, (256, 256), 1.0, 30) + 0.5 * noise(rng, (256, 256), 0.3, 40)
    grain = grain[(line + offset) % 256, (column + 7 * offset) % 256]
    joint = np.where(np.minimum(_to_line(v * rows, rows), _to_line(along, pieces)) < 0.6, 0.55, 1.0)
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


_PLASTER = ((0.012, 0.5), (0.015, 2.0))
SURFACES: dict[str, tuple[int, Callable[[np.random.Generator, int], np.ndarray]]] = {
    "fabric": (4, _fabric), "leather": (2, _leather), "wood": (3, _wood), "wicker": (1, _wicker),
    "marble": (2, _marble), "tile": (4, _tile), "parquet": (3, _parquet), "leaf": (2, _leaf),
    "lampshade": (1, _lampshade), "earth": (1, _layers(128, ((0.35, 0.5),))),
    "carpet": (2, _layers(256, ((0.1, 0.1), (0.05, 1.5)), ((0.1, 0.4), (0.05, 1.5)))),
    "metal": (1, _layers(128, ((0.06, 0.3, 60), (0.04, 1.5)))),
    "paint": (1, _layers(128, ((0.025, 0.6), (0.02, 2)))),
    "plaster": (2, _layers(256, _PLASTER, _PLASTER)),
}  # fmt: skip
"""Kinds that are tinted: how many variants there are, and what draws one. The other kinds are plain."""


# --- pictures ---------------------------------------------------------------------------------------------------------

SPINES = 15  # of books side by side in a "books" texture, each 1/16 of its width; the last sixteenth is cut pages
# For each main colour of a rug: a second colour, and one for small motifs.
_PARTNERS: dict[str, tuple[str, str]] = {
    "red": ("beige", "blue"), "blue": ("beige", "red"), "beige": ("brown", "grey"), "grey": ("white", "black"),
    "green": ("beige", "brown"), "brown": ("beige", "orange"), "orange": ("beige", "brown"),
    "purple": ("beige", "pink"), "yellow": ("white", "grey"), "pink": ("white", "red"), "white": ("grey", "black"),
    "black": ("white", "grey"),
}  # fmt: skip
_ACCENTS = ("red", "orange", "yellow", "green", "blue", "purple", "pink", "grey", "beige")


class Canvas:
    """A picture being drawn: `rgb` ``(h, w, 3)`` linear light, changed in place.

    `x` to the right from 0 to `aspect`, w/h, and `y` up from 0 to 1, each ``(h, w)``, so circles are round.
    """

    def __init__(self, height: int, width: int, colour: np.ndarray) -> None:
        """A canvas of one colour ``(3,)``."""
        self.shape, self.aspect = (height, width), width / height
        v, self.x = (np.mgrid[:height, :width] + 0.5) / height
        self.y = 1 - v
        self.rgb = np.ones((height, width, 1)) * colour

    def fill(self, mask: np.ndarray, colour: np.ndarray) -> None:
        """Lay `colour` ``(3,)`` or ``(h, w, 3)`` where `mask` holds (boolean, or an opacity in [0, 1])."""
        self.rgb += mask[..., None] * (colour - self.rgb)

    def disc(self, x: float, y: float, radius: float, colour: np.ndarray, opacity: float = 1.0) -> None:
        """A disc with a soft edge of about a pixel."""
        distance = np.hypot((self.x - x) / radius, (self.y - y) / radius)
        self.fill(opacity * np.clip((1 - distance) * radius * self.shape[0] + 0.5, 0, 1), colour)

    def ridge(self, rng: np.random.Generator, slope: float) -> np.ndarray:
        """A skyline ``(1, w)``: mean 0, deviation 1; the larger `slope`, the smoother."""
        count = self.shape[1]
        frequency = np.fft.rfftfreq(2 * count, 1 / (2 * count))
        frequency[0] = np.inf
        line = np.fft.irfft(np.fft.rfft(rng.standard_normal(2 * count)) / frequency**slope)[:count]
        return ((line - line.mean()) / line.std())[None, :]


def linear(rgb: tuple[int, int, int]) -> np.ndarray:
    """sRGB from 0 to 255 as linear light ``(3,)``."""
    return to_linear(np.array(rgb) / 255)


PAPER = linear((236, 230, 216))
INK = linear((38, 36, 40))


def pale(main: np.ndarray, share: float) -> np.ndarray:
    """`main` mixed with a share of paper white."""
    return main + share * (PAPER - main)


def _tone_of(colour: str, rng: np.random.Generator) -> np.ndarray:
    tones = TONES[colour]
    return linear(tones[rng.integers(len(tones))])


def _accent(rng: np.random.Generator) -> np.ndarray:
    return _tone_of(_ACCENTS[rng.integers(len(_ACCENTS))], rng)


def _painting(rng: np.random.Generator, colour: str | None, variant: int) -> np.ndarray:
    """An abstract or a landscape dominated by `colour`."""
    draw, formats = _MOTIFS[variant % len(_MOTIFS)]
    size = _FORMATS[rng.integers(formats)]
    main = _tone_of(colour or "blue", rng)
    canvas = Canvas(*size, main)
    draw(rng, canvas, main)
    brush = 0.035 * noise(rng, size, 0.5, 3) + 0.03 * noise(rng, size, 1.2)
    return canvas.rgb * np.exp(brush)[..., None]


def _blocks(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Rectangles between black bars, the largest in the main colour."""
    xs = np.sort(np.append(rng.uniform(0.1, 0.9, 3) * c.aspect, [0, c.aspect]))
    ys = np.sort(np.append(rng.uniform(0.12, 0.88, 3), [0, 1]))
    sizes = np.outer(np.diff(xs), np.diff(ys))
    for rank, cell in enumerate(np.argsort(-sizes.ravel())):
        i, j = divmod(int(cell), 4)
        inside = (c.x >= xs[i]) & (c.x < xs[i + 1]) & (c.y >= ys[j]) & (c.y < ys[j + 1])
        c.fill(inside, main if rank < 3 else (PAPER, PAPER, _accent(rng), main)[rng.integers(4)])
    for place, cuts in ((c.x, xs), (c.y, ys)):
        for at in cuts[1:-1]:
            c.fill(np.abs(place - at) < 0.014, INK)


def _circles(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Discs and rings that overlap."""
    c.rgb[:] = pale(main, 0.08)
    for k in range(14):
        x, y, radius = rng.uniform(0, c.aspect), rng.uniform(0, 1), rng.uniform(0.06, 0.26)
        shade = main * rng.uniform(0.7, 1.2) if k % 4 else _accent(rng)
        c.disc(x, y, radius, shade, 0.85)
        if k % 2:
            c.disc(x, y, radius * 0.62, pale(shade, 0.4), 0.9)
            c.disc(x, y, radius * 0.3, INK if rng.random() < 0.3 else shade)


def _waves(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Bands that swing, from pale to deep."""
    c.rgb[:] = main + c.y[..., None] * (pale(main, 0.4) - main)
    for k, level in enumerate(np.linspace(0.95, 0.05, 10)):
        phase, turns, lift = rng.uniform(0, 7), rng.uniform(4, 7), rng.uniform(0.03, 0.07)
        edge = level + lift * np.sin(turns * c.x + phase)
        shade = pale(main, 0.5 * rng.random()) if k % 4 != 2 else _accent(rng) * 0.9
        c.fill(np.clip((edge - c.y) * 150, 0, 1), shade if k % 2 else main * rng.uniform(0.6, 1.1))


def _sea(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """A horizon, the sun, and its glitter."""
    horizon = rng.uniform(0.38, 0.5)
    c.rgb[:] = pale(main, 0.5) + c.y[..., None] * (main * 1.05 - pale(main, 0.5))
    sun, rise = rng.uniform(0.2, 0.8) * c.aspect, rng.uniform(0.1, 0.3)
    c.disc(sun, horizon + rise, 0.07, linear((250, 226, 160)))
    water = c.y < horizon
    depth = np.clip((horizon - c.y) / horizon, 0, 1)
    c.fill(water, main * (0.9 - 0.45 * depth[..., None]))
    ripples = noise(rng, c.shape, 0.6, 25)
    c.fill(water & (ripples > 1.2), pale(main, 0.45))
    c.fill(water & (np.abs(c.x - sun) < 0.03 + 0.1 * depth) & (ripples > 0.3), linear((246, 220, 160)))


def _mountains(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Ridge behind ridge, paler with distance."""
    mist = linear((244, 226, 204))
    c.rgb[:] = mist + c.y[..., None] * (pale(main, 0.3) - mist)
    if rng.random() < 0.6:
        c.disc(rng.uniform(0.2, 0.8) * c.aspect, 0.8, 0.06, linear((250, 240, 214)))
    for k, level in enumerate((0.66, 0.54, 0.4, 0.27, 0.12)):
        crest = level + (0.08 - 0.009 * k) * c.ridge(rng, 1.25)
        c.fill(np.clip((crest - c.y) * 150, 0, 1), pale(main, 0.45 - 0.12 * k) * (1.0 - 0.09 * k))
        if k == 0:
            c.fill((c.y < crest) & (c.y > 0.7 + 0.02 * c.ridge(rng, 0.8)), PAPER)


# What draws each motif, and how many of the formats (rows, columns) suit it.
_FORMATS = ((192, 256), (208, 208), (256, 192))
_MOTIFS: tuple[tuple[Callable[[np.random.Generator, Canvas, np.ndarray], None], int], ...] = (
    (_blocks, 3), (_circles, 3), (_waves, 3), (_sea, 2), (_mountains, 2),
)  # fmt: skip


def _rug(rng: np.random.Generator, colour: str | None, variant: int) -> np.ndarray:
    """Medallion, stripes, lozenges, trellis, or plain pile with a border; fringes at the short ends."""
    name = colour or "red"
    main = linear(TONES[name][variant % 3])
    light, accent = (linear(TONES[other][0]) for other in _PARTNERS[name])
    dark = main * 0.55
    c = Canvas(192, 256, main)
    x, y = c.x - 2 / 3, c.y - 0.5  # from the middle; x to 0.667, y to 0.5
    edge = np.minimum(0.667 - np.abs(x), 0.5 - np.abs(y))
    design = variant % 5
    if design == 0:
        radius = np.hypot(x / 0.44, y / 0.3) / (1 + 0.08 * np.cos(8 * np.arctan2(y, x)))
        for size, tone in ((1, dark), (0.9, main), (0.62, light), (0.54, accent), (0.3, main), (0.14, light)):
            c.fill(radius < size, tone)
        corner = np.hypot((0.667 - np.abs(x)) / 0.3, (0.5 - np.abs(y)) / 0.22)
        c.fill((corner < 1) & (corner > 0.86), light)
        dots = ((x * 18) % 1 - 0.5) ** 2 + ((y * 18) % 1 - 0.5) ** 2 < 0.02
        c.fill(dots & (radius > 1.05) & (corner > 1.05), dark)
    elif design == 1:
        for centre in np.linspace(-0.6, 0.6, 9):
            width = rng.uniform(0.008, 0.03)
            c.fill(np.abs(x - centre) < width, (light, light, dark, accent)[rng.integers(4)])
    elif design == 2:
        lozenge = np.abs(((x * 3.75) % 1) - 0.5) + np.abs(((y * 3.0) % 1) - 0.5)
        for size, tone in ((0.3, light), (0.22, main), (0.1, accent)):
            c.fill(lozenge < size, tone)
        c.fill(np.abs(lozenge - 0.5) < 0.03, dark)
    elif design == 3:
        p, q = (x * 3 + y * 4) % 1, (x * 3 - y * 4) % 1
        c.fill(np.minimum(np.minimum(p, 1 - p), np.minimum(q, 1 - q)) < 0.07, light)
    if design != 1:
        c.fill(edge < 0.085, dark if design else accent * 0.8)
        c.fill(np.abs(edge - 0.085) < 0.008, light)
        if design in (0, 2):
            along = np.where(0.667 - np.abs(x) < 0.5 - np.abs(y), y, x)
            c.fill((np.abs(edge - 0.045) < 0.018) & ((along * 14) % 1 < 0.5), light)
    fringe = np.abs(x) > 0.652
    c.fill(fringe, linear((226, 216, 196)))
    c.fill(fringe & ((y * 40) % 1 < 0.4), linear((150, 140, 120)))
    pile = 0.05 * noise(rng, c.shape, 0.1) + (0.09 if design == 4 else 0.04) * noise(rng, c.shape, 1.2)
    return c.rgb * np.exp(pile)[..., None]


def _books(rng: np.random.Generator, colour: str | None, variant: int) -> np.ndarray:
    """Spines with title bands in subdued colours."""
    names = ("red", "blue", "green", "brown", "beige", "grey", "black", "orange", "white", "purple", "yellow")
    weights = np.array([3, 4, 3, 3, 3, 3, 2, 1.5, 2, 1, 1])
    c = Canvas(128, 256, linear((214, 204, 180)))
    place, v = c.x / 2 * (SPINES + 1), c.y
    across = place % 1
    c.fill((across * 5) % 1 < 0.3, linear((188, 176, 150)))
    for k, pick in enumerate(rng.choice(len(names), SPINES, p=weights / weights.sum())):
        mine = np.floor(place) == k
        tone = _tone_of(names[pick], rng) * rng.uniform(0.6, 1.0)
        light = linear((216, 190, 120)) if tone.mean() < 0.25 else tone * 0.25
        c.fill(mine, tone)
        band = rng.uniform(0.55, 0.72)
        if rng.random() < 0.5:
            c.fill(mine & ((np.abs(v - 0.88) < 0.012) | (np.abs(v - 0.14) < 0.012)), light)
        if rng.random() < 0.4:
            c.fill(mine & (np.abs(v - band) < 0.13), tone * 0.45)
        c.fill(mine & (np.abs(v - band) < 0.1) & (np.abs(across - 0.5) < 0.12) & ((v * 26) % 1 < 0.72), light)
    return c.rgb * (0.75 + 0.25 * np.clip(np.minimum(across, 1 - across) * 8, 0, 1))[..., None]


def _screen(rng: np.random.Generator, colour: str | None, variant: int) -> np.ndarray:
    """Switched off with a reflection, twice; or a dim picture of hills."""
    c = Canvas(144, 256, linear((14, 15, 18)))
    u, v = c.x / c.aspect, c.y
    if variant < 2:
        sheen = np.clip(1 - np.abs(u + 0.5 * v - (0.55, 1.0)[variant]) / 0.3, 0, 1)
        return c.rgb + (0.012 + 0.03 * sheen * v)[..., None] * np.array([0.8, 0.9, 1.1])
    c.rgb[:] = 0.14 * np.array([0.5, 0.75, 1.0]) * (0.5 + 0.7 * (1 - v))[..., None]
    for base, shade in ((0.5, (52, 66, 84)), (0.38, (44, 60, 54)), (0.22, (30, 44, 34))):
        c.fill(v < base + 0.06 * c.ridge(rng, 1.6), linear(shade))
    return c.rgb


@dataclass(frozen=True)
class Picture:
    """A kind of picture: colours (empty: none), variants, and what draws one of a colour and variant."""

    colours: tuple[str, ...]
    variants: int
    draw: Callable[[np.random.Generator, str | None, int], np.ndarray]
    emission: float = 0.0


PICTURES: dict[str, Picture] = {
    "rug": Picture(tuple(_PARTNERS), 15, _rug),
    "art": Picture(_ACCENTS, 20, _painting),
    "books": Picture((), 4, _books),
    "screen": Picture((), 3, _screen, 0.5),
}
