"""Materials of a home and what draws them: cloth, wood, tiles, plaster; rugs, paintings, books and screens.

Textures are periodic, and the colour of the `Material` tints them; rugs, paintings, books and screens are coloured
pictures. Each is drawn once per process, from a generator of its own, so that it depends on its name alone. Drawings
are linear light ``(h, w, 3)``, or ``(h, w)`` if they are grey, first row at the top.

The colours of `eagor.queries.COLOURS` are tones of cloth, paint and wood rather than pure primaries, and each call of
`sRGB` varies the tone a little: two red chairs are both red but not identical. All other colours are linear RGB.
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

Tone = tuple[int, int, int]  # sRGB, 0 to 255

# Each keeps its name from full light down to a third of it, as far as possible: beige and pink in deep shade look brown
# and purple to anyone, white looks grey.
TONES: dict[str, tuple[Tone, ...]] = {
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


@dataclass(frozen=True)
class Kind:
    """A kind of material: metres that a `repeat` of its texture covers, its default colours, and what draws it, if any.

    Leaves, lampshades and pictures are drawn from edge to edge; a picture is drawn in the `natural` colours alone.
    """

    repeat: float
    natural: tuple[str | Tone, ...] = ()
    draw: Callable[..., np.ndarray] | None = None
    variants: int = 1
    picture: bool = False


def material(kind: str, colour: str | None, rng: np.random.Generator) -> Material:
    """A material of a kind of `KINDS`, in a tone of a named colour; None for one of the kind's own.

    All materials of the same variant share the texture; do not write to it.
    """
    look, name = KINDS[kind], f"{colour} {kind}" if colour else kind
    choice = colour or (look.natural[rng.integers(len(look.natural))] if look.natural else None)
    variant = int(rng.integers(look.variants))
    if look.picture:
        emission = 0.5 if kind == "screen" else 0.0
        return Material(name, (1.0, 1.0, 1.0), _texture(kind, choice, variant)[0], emission)
    if isinstance(choice, str):
        tone = sRGB(choice, rng)
    else:
        tone = np.minimum(np.array(choice) / 255 * rng.uniform(0.97, 1.03), 1.0)
    # At full strength a coloured shade would saturate to a primary.
    emission = 0.0 if kind != "lampshade" else 1.5 if colour in (None, "white", "beige") else 0.9
    if look.draw is None:
        return Material(name, tuple(tone.tolist()), None, emission)
    texture, mean = _texture(kind, None, variant)
    tint = to_linear(tone) / mean  # so that the mean of texture times colour is the tone
    return Material(name, tuple(np.where(tint < 1, to_coded(tint), 1.0).tolist()), texture, emission)


def sRGB(colour: str, rng: np.random.Generator) -> np.ndarray:
    """A tone of a named colour ``(3,)``, sRGB in [0, 1]."""
    tones = TONES[colour]
    tone = np.array(tones[rng.integers(len(tones))]) / 255
    hue = 0.005 if colour in ("black", "white", "grey") else 0.015  # more would turn white into pink or green
    return np.clip(tone * rng.uniform(0.95, 1.05) * rng.uniform(1 - hue, 1 + hue, size=3), 0.0, 0.97)


@cache
def _texture(kind: str, colour: str | Tone | None, variant: int) -> tuple[np.ndarray, np.ndarray]:
    """A texture ``(h, w, 3)`` uint8 and its mean ``(3,)`` in linear light.

    A picture in this colour, as bright as it is drawn; or what will be tinted, as bright as 8 bits allow.
    """
    look = KINDS[kind]
    assert look.draw is not None
    name, arguments = (f"{kind} {colour}", (colour, variant)) if look.picture else (kind, (variant,))
    light = look.draw(np.random.default_rng([zlib.crc32(name.encode()), variant]), *arguments)
    if light.ndim == 2:
        light = light[..., None] * np.ones(3)
    light = light if look.picture else light / np.percentile(light, 99)
    texture = frozen(np.rint(255 * to_coded(light)).astype(np.uint8))
    return texture, frozen(to_linear(texture / 255).mean(axis=(0, 1)))


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


def _layers(size: int, *layers: tuple[float, ...]) -> Callable[[np.random.Generator, int], np.ndarray]:
    """A function that draws a sum of layers of noise: amplitude, slope and stretch of each."""

    def draw(rng: np.random.Generator, variant: int) -> np.ndarray:
        return np.exp(sum(strength * noise(rng, (size, size), *shape) for strength, *shape in layers))

    return draw


def _fabric(rng: np.random.Generator, variant: int) -> np.ndarray:
    """Plain weave, twill, melange: fine, with soft large variation."""
    shape = (256, 256)
    v, u = np.mgrid[:256, :256] * (2 * np.pi / 256)
    weave = (
        np.sign(np.sin(64 * u) * np.sin(64 * v)), np.sin(48 * (u + v)),
        1.5 * noise(rng, shape, 0.3, 8) + 1.5 * noise(rng, shape, 0.3, 1 / 8),
    )[variant]  # fmt: skip
    threads = 0.35 * noise(rng, shape, 0.2, 6) + 0.35 * noise(rng, shape, 0.2, 1 / 6)
    return np.exp(0.045 * weave + 0.05 * threads + 0.035 * noise(rng, shape, 1.6))


def _wood(rng: np.random.Generator, variant: int) -> np.ndarray:
    """Grain along u: growth rings cut at a slant, pores, and slow changes of tone."""
    shape = (256, 256)
    v = np.arange(256)[:, None] / 256
    bend = noise(rng, shape, 2.2, 6) * (0.16, 0.3, 0.5)[variant]
    rings = np.sin(2 * np.pi * (v * (10, 6, 4)[variant] + bend))
    grain = 0.5 * rings + 0.5 * noise(rng, shape, 0.9, 30) + 0.4 * noise(rng, shape, 0.2, 60)
    return np.exp(0.11 * grain[..., None] * np.array([0.8, 1.0, 1.25]))


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


# --- pictures ---------------------------------------------------------------------------------------------------------

# For each main colour of a rug: a second colour, and one for small motifs.
_PARTNERS: dict[str, tuple[str, str]] = {
    "red": ("beige", "blue"), "blue": ("beige", "red"), "beige": ("brown", "grey"), "grey": ("white", "black"),
    "green": ("beige", "brown"), "brown": ("beige", "orange"), "orange": ("beige", "brown"),
    "purple": ("beige", "pink"), "yellow": ("white", "grey"), "pink": ("white", "red"), "white": ("grey", "black"),
    "black": ("white", "grey"),
}  # fmt: skip
_COVERS = ("red", "blue", "green", "brown", "beige", "grey", "black", "blue", "yellow")
_ACCENTS = ("red", "orange", "yellow", "green", "blue", "purple", "pink", "grey", "beige")


def _plane(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """x to the right from 0 to width / height, and y up from 0 to 1, ``(height, width)`` each."""
    v, u = (np.mgrid[:height, :width] + 0.5) / height
    return u, 1 - v


def _over(colour: np.ndarray, *layers: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Layers, each where its mask ``(h, w)`` holds, over a colour ``(h, w, 3)`` or ``(3,)``, the last on top."""
    for mask, layer in layers:
        colour = np.where(mask[..., None], layer, colour)
    return colour


def _linear(tone: Tone) -> np.ndarray:
    """sRGB from 0 to 255 as linear light ``(3,)``."""
    return to_linear(np.array(tone) / 255)


def _tone(colour: str, rng: np.random.Generator) -> np.ndarray:
    return _linear(TONES[colour][rng.integers(len(TONES[colour]))])


def _painting(rng: np.random.Generator, colour: str, variant: int) -> np.ndarray:
    """Hills behind hills under a sun, or rectangles between bars; `colour` dominates."""
    size = ((192, 256), (208, 208), (256, 192))[rng.integers(3)]
    (x, y), main, paper = _plane(*size), _tone(colour, rng), _linear((236, 230, 216))
    x = x / x.max()
    if variant % 2:
        sun = np.hypot(x - rng.uniform(0.2, 0.8), y - 0.8) < 0.07
        image = _over(paper + (0.3 + 0.5 * y[..., None]) * (main - paper), (sun, _linear((250, 232, 180))))
        for k, level in enumerate((0.62, 0.48, 0.34, 0.2)):
            crest = level + 0.05 * np.sin(rng.uniform(3, 6) * x + rng.uniform(0, 6)) + 0.02 * np.sin(17 * x + 2 * k)
            image = _over(image, (y < crest, (main + (0.45 - 0.15 * k) * (paper - main)) * (1 - 0.12 * k)))
    else:
        xs, ys = np.sort(rng.uniform(0.12, 0.88, (2, 3)))
        cell, order = 4 * np.searchsorted(ys, y) + np.searchsorted(xs, x), rng.permutation(16)
        shades = (paper, paper, paper, _tone(rng.choice(_ACCENTS), rng), _tone(rng.choice(_ACCENTS), rng))
        image = _over(main * np.ones((*size, 1)), *((cell == order[k], shade) for k, shade in enumerate(shades)))
        bars = np.minimum(np.abs(x[..., None] - xs).min(axis=-1), np.abs(y[..., None] - ys).min(axis=-1))
        image = _over(image, (bars < 0.014, _linear((38, 36, 40))))
    return image * np.exp(0.035 * noise(rng, size, 0.5, 3) + 0.03 * noise(rng, size, 1.2))[..., None]


def _rug(rng: np.random.Generator, colour: str, variant: int) -> np.ndarray:
    """Stripes, lozenges or a medallion within a border; fringes at the short ends."""
    main = _linear(TONES[colour][variant % 3])
    light, accent = (_linear(TONES[other][0]) for other in _PARTNERS[colour])
    x, y = _plane(192, 256)
    x, y = x - 2 / 3, y - 0.5  # from the middle
    edge = np.minimum(2 / 3 - np.abs(x), 0.5 - np.abs(y))
    lozenge = np.abs((x * 3.75) % 1 - 0.5) + np.abs((y * 3) % 1 - 0.5)
    medallion = np.hypot(x / 0.44, y / 0.3) / (1 + 0.08 * np.cos(8 * np.arctan2(y, x))) / 2
    stripes = 2 * np.abs((x * 5) % 1 - 0.5)
    motif = (stripes, lozenge, medallion)[variant % 3]
    image = _over(main, (motif < 0.3, light), (motif < 0.24, main), (motif < 0.12, accent), (motif < 0.05, light))
    image = _over(image, (edge < 0.085, main * 0.55), (np.abs(edge - 0.085) < 0.008, light))
    image = _over(image, (np.abs(edge - 0.045) < 0.012, light), (np.abs(x) > 0.652, _linear((226, 216, 196))))
    image = _over(image, ((np.abs(x) > 0.652) & ((y * 40) % 1 < 0.4), _linear((150, 140, 120))))
    return image * np.exp(0.05 * noise(rng, x.shape, 0.1) + 0.04 * noise(rng, x.shape, 1.2))[..., None]


def _books(rng: np.random.Generator, colour: None, variant: int) -> np.ndarray:
    """Sixteen spines with titles in subdued colours."""
    x, y = _plane(128, 256)
    place = x * 8
    across, image = place % 1, np.zeros((128, 256, 3))
    for k in range(16):
        tone = _tone(rng.choice(_COVERS), rng) * rng.uniform(0.6, 1.0)
        title = _linear((216, 190, 120)) if tone.mean() < 0.25 else tone * 0.25
        mine, band = np.floor(place) == k, rng.uniform(0.55, 0.72)
        letters = (np.abs(y - band) < 0.1) & (np.abs(across - 0.5) < 0.12) & ((y * 26) % 1 < 0.72)
        image = _over(image, (mine, tone), (mine & (letters | (np.abs(y - 0.14) < 0.012)), title))
    return image * (0.75 + 0.25 * np.clip(np.minimum(across, 1 - across) * 8, 0, 1))[..., None]


def _screen(rng: np.random.Generator, colour: None, variant: int) -> np.ndarray:
    """Switched off with a reflection, or a dim picture of hills."""
    u, v = _plane(144, 256)
    if variant < 2:
        sheen = np.clip(1 - np.abs(0.6 * u + 0.5 * v - (0.55, 1.0)[variant]) / 0.3, 0, 1)
        return _linear((14, 15, 18)) + (0.012 + 0.03 * sheen * v)[..., None] * np.array([0.8, 0.9, 1.1])
    image = 0.14 * np.array([0.5, 0.75, 1.0]) * (1.2 - 0.7 * v)[..., None]
    hills = ((0.5, (52, 66, 84)), (0.38, (44, 60, 54)), (0.22, (30, 44, 34)))
    return _over(image, *((v < base + 0.06 * np.sin(5 * u + base * 40), _linear(tone)) for base, tone in hills))


KINDS: dict[str, Kind] = {
    "fabric": Kind(0.4, ("grey", "beige", "blue"), _fabric, 3),
    "leather": Kind(0.6, ("brown", "black"), _layers(256, (0.08, 0.8), (0.06, 2.0)), 2),
    "wood": Kind(1.0, ((150, 104, 66), (122, 80, 50), (176, 134, 92), (92, 60, 40)), _wood, 3),
    "metal": Kind(0.5, ((176, 178, 182), (150, 152, 156)), _layers(128, (0.06, 0.3, 60), (0.04, 1.5))),
    "plastic": Kind(1.0, ("white", "black")),
    "ceramic": Kind(1.0, ("white",)),
    "paint": Kind(1.0, ("white",), _layers(128, (0.025, 0.6), (0.02, 2))),
    "glass": Kind(1.0, ((186, 204, 212),)),
    "marble": Kind(1.2, ((232, 230, 226), (222, 214, 202)), _marble, 2),
    "tile": Kind(0.6, ((232, 230, 224), (206, 212, 214), (214, 204, 188), (186, 196, 196)), _tile, 4),
    "parquet": Kind(1.6, ((178, 138, 96), (150, 110, 74), (196, 164, 124), (122, 86, 58)), _parquet, 3),
    "carpet": Kind(
        0.6, ((178, 170, 158), (150, 150, 150), (140, 128, 116), (126, 134, 142)),
        _layers(256, (0.1, 0.2), (0.05, 1.5)), 2,
    ),
    "plaster": Kind(
        2.0, ((240, 236, 226), (238, 232, 216), (226, 230, 226), (222, 228, 232), (236, 224, 212), (230, 230, 214)),
        _layers(256, (0.012, 0.5), (0.015, 2.0)), 2,
    ),
    "earth": Kind(0.3, ((72, 54, 42),), _layers(128, (0.35, 0.5))),
    "leaf": Kind(1.0, ("green",), _leaf, 2),
    "lampshade": Kind(1.0, ((255, 240, 214),), _lampshade),
    "rug": Kind(1.0, tuple(_PARTNERS), _rug, 9, picture=True),
    "art": Kind(1.0, _ACCENTS, _painting, 8, picture=True),
    "books": Kind(1.0, (), _books, 4, picture=True),
    "screen": Kind(1.0, (), _screen, 3, picture=True),
}  # fmt: skip
