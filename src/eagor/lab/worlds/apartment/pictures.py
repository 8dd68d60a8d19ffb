"""Coloured textures (rugs, book spines, screens, paintings), and what draws them: a canvas, noise, named colours.

Textures are linear RGB ``(h, w, 3)``, first row at the top. Paintings are abstracts and landscapes. Named colours are
tones of cloth, paint and wood rather than pure primaries; the names are those of `eagor.queries.COLOURS`. Each has a
few tones, and every call of `sRGB` varies the tone a little, so that two red chairs are both red but not identical.
All other colours are linear RGB ``(3,)``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eagor._srgb import to_linear

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


def sRGB(colour: str, rng: np.random.Generator) -> RGB:
    """A tone of a named colour, sRGB in [0, 1]."""
    tones = TONES[colour]
    tone = np.array(tones[rng.integers(len(tones))]) / 255
    hue = 0.005 if colour in ("black", "white", "grey") else 0.015  # more would turn white into pink or green
    shifted = tone * rng.uniform(0.95, 1.05) * rng.uniform(1 - hue, 1 + hue, size=3)
    r, g, b = np.clip(shifted, 0.0, 0.97)
    return float(r), float(g), float(b)


def linear(rgb: tuple[int, int, int]) -> np.ndarray:
    """sRGB from 0 to 255 as linear light ``(3,)``."""
    return to_linear(np.array(rgb) / 255)


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


@dataclass(frozen=True, eq=False)
class Canvas:
    """A picture being drawn: `rgb` ``(h, w, 3)`` linear light, changed in place.

    `x` to the right from 0 to w/h and `y` up from 0 to 1, each ``(h, w)``, so circles are round.
    """

    rgb: np.ndarray
    x: np.ndarray
    y: np.ndarray

    @classmethod
    def blank(cls, height: int, width: int, colour: np.ndarray) -> Canvas:
        """A canvas of one colour ``(3,)``."""
        v, x = (np.mgrid[:height, :width] + 0.5) / height
        return cls(np.ones((height, width, 1)) * colour, x, 1 - v)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.x.shape[0], self.x.shape[1]

    @property
    def aspect(self) -> float:
        """Width over height."""
        return self.x.shape[1] / self.x.shape[0]

    def fill(self, mask: np.ndarray, colour: np.ndarray, also: np.ndarray | bool = True) -> Canvas:
        """Lay `colour` ``(3,)`` or ``(h, w, 3)`` where `mask` (boolean, or an opacity in [0, 1]) and `also` hold."""
        opacity = (mask * np.asarray(also))[..., None]
        self.rgb[:] += opacity * (colour - self.rgb)
        return self

    def disc(self, x: float, y: float, radius: float, height: float | None = None) -> np.ndarray:
        """Opacity of an ellipse with a soft edge of about a pixel; `height` is its other radius."""
        tall = radius if height is None else height
        distance = np.hypot((self.x - x) / radius, (self.y - y) / tall)
        return np.clip((1 - distance) * min(radius, tall) * self.shape[0] + 0.5, 0, 1)

    def ridge(self, rng: np.random.Generator, slope: float) -> np.ndarray:
        """A skyline ``(1, w)``: mean 0, deviation 1; the larger `slope`, the smoother."""
        count = self.x.shape[1]
        frequency = np.fft.rfftfreq(2 * count, 1 / (2 * count))
        frequency[0] = np.inf
        line = np.fft.irfft(np.fft.rfft(rng.standard_normal(2 * count)) / frequency**slope)[:count]
        return ((line - line.mean()) / line.std())[None, :]


PAPER = linear((236, 230, 216))
INK = linear((38, 36, 40))
_ACCENTS = ("red", "orange", "yellow", "green", "blue", "purple", "pink", "grey", "beige")


def accent(rng: np.random.Generator) -> np.ndarray:
    """A random named colour."""
    tones = TONES[_ACCENTS[rng.integers(len(_ACCENTS))]]
    return linear(tones[rng.integers(len(tones))])


def pale(main: np.ndarray, share: float = 0.6) -> np.ndarray:
    """`main` mixed with a share of paper white."""
    return main + share * (PAPER - main)


def gradient(c: Canvas, low: np.ndarray, high: np.ndarray, power: float = 1.0) -> None:
    """The whole canvas from one colour at its bottom to another at its top."""
    rise = (c.y**power)[..., None]
    c.rgb[:] = low + rise * (high - low)


# --- paintings --------------------------------------------------------------------------------------------------------


def paint(rng: np.random.Generator, colour: str, variant: int) -> np.ndarray:
    """A painting dominated by `colour`, linear RGB; `variant` selects the motif."""
    draw, formats = _MOTIFS[variant % len(_MOTIFS)]
    height, width = _FORMATS[int(rng.integers(formats))]
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


def _circles(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Discs and rings that overlap."""
    c.rgb[:] = pale(main, 0.08)
    for k in range(14):
        x, y, radius = rng.uniform(0, c.aspect), rng.uniform(0, 1), rng.uniform(0.06, 0.26)
        shade = main * rng.uniform(0.7, 1.2) if k % 4 else accent(rng)
        c.fill(0.85 * c.disc(x, y, radius), shade)
        if k % 2:
            c.fill(0.9 * c.disc(x, y, radius * 0.62), pale(shade, 0.4))
            c.fill(c.disc(x, y, radius * 0.3), INK if rng.random() < 0.3 else shade)


def _waves(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """Bands that swing, from pale to deep."""
    gradient(c, main, pale(main, 0.4))
    for k, level in enumerate(np.linspace(0.95, 0.05, 10)):
        phase, turns, lift = rng.uniform(0, 7), rng.uniform(4, 7), rng.uniform(0.03, 0.07)
        edge = level + lift * np.sin(turns * c.x + phase)
        shade = pale(main, 0.5 * rng.random()) if k % 4 != 2 else accent(rng) * 0.9
        c.fill(np.clip((edge - c.y) * 150, 0, 1), shade if k % 2 else main * rng.uniform(0.6, 1.1))


def _sea(rng: np.random.Generator, c: Canvas, main: np.ndarray) -> None:
    """A horizon, the sun, and its glitter."""
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


# The function that draws each motif, and the formats (rows, columns) that suit it.
_FORMATS = ((192, 256), (208, 208), (256, 192))
_MOTIFS: tuple[tuple[Callable[[np.random.Generator, Canvas, np.ndarray], None], int], ...] = (
    (_blocks, 3), (_circles, 3), (_waves, 3), (_sea, 2), (_mountains, 2),
)  # fmt: skip


# --- rugs, books, screens ---------------------------------------------------------------------------------------------

SPINES = 15  # of books side by side in a "books" texture, each 1/16 of its width; the last sixteenth is cut pages
# For each main colour of a rug: a second colour, and one for small motifs.
_PARTNERS: dict[str, tuple[str, str]] = {
    "red": ("beige", "blue"), "blue": ("beige", "red"), "beige": ("brown", "grey"), "grey": ("white", "black"),
    "green": ("beige", "brown"), "brown": ("beige", "orange"), "orange": ("beige", "brown"),
    "purple": ("beige", "pink"), "yellow": ("white", "grey"), "pink": ("white", "red"), "white": ("grey", "black"),
    "black": ("white", "grey"),
}  # fmt: skip


@dataclass(frozen=True)
class Picture:
    """A kind of picture: colours (empty: none), variants, `draw(rng, colour, variant)`: linear RGB ``(h, w, 3)``."""

    colours: tuple[str, ...]
    variants: int
    draw: Callable[[np.random.Generator, str | None, int], np.ndarray]
    emission: float = 0.0


def _rug(rng: np.random.Generator, colour: str | None, variant: int) -> np.ndarray:
    """Medallion, stripes, lozenges, trellis, or plain pile with a border; fringes at the short ends."""
    name = colour or "red"
    main = linear(TONES[name][variant % 3])
    pale, accent = (linear(TONES[other][0]) for other in _PARTNERS[name])
    dark = main * 0.55
    c = Canvas.blank(192, 256, main)
    x, y = c.x - 2 / 3, c.y - 0.5  # from the middle; x to 0.667, y to 0.5
    edge = np.minimum(0.667 - np.abs(x), 0.5 - np.abs(y))
    design = variant % 5
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
    if design != 1:
        c.fill(edge < 0.085, dark if design else accent * 0.8).fill(np.abs(edge - 0.085) < 0.008, pale)
        if design in (0, 2):
            along = np.where(0.667 - np.abs(x) < 0.5 - np.abs(y), y, x)
            c.fill((np.abs(edge - 0.045) < 0.018) & ((along * 14) % 1 < 0.5), pale)
    c.fill(np.abs(x) > 0.652, linear((226, 216, 196)))
    c.fill((np.abs(x) > 0.652) & ((y * 40) % 1 < 0.4), linear((150, 140, 120)))
    pile = 0.05 * noise(rng, (192, 256), 0.1) + (0.09 if design == 4 else 0.04) * noise(rng, (192, 256), 1.2)
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
    """Switched off with a reflection, twice; or a dim picture of hills."""
    c = Canvas.blank(144, 256, linear((14, 15, 18)))
    u, v = c.x / c.aspect, c.y
    if variant < 2:
        sheen = np.clip(1 - np.abs(u + 0.5 * v - (0.55, 1.0)[variant]) / 0.3, 0, 1)
        return c.rgb + (0.012 + 0.03 * sheen * v)[..., None] * np.array([0.8, 0.9, 1.1])
    c.rgb[:] = 0.14 * np.array([0.5, 0.75, 1.0]) * (0.5 + 0.7 * (1 - v))[..., None]
    for base, shade in ((0.5, (52, 66, 84)), (0.38, (44, 60, 54)), (0.22, (30, 44, 34))):
        c.fill(v < base + 0.06 * c.ridge(rng, 1.6), linear(shade))
    return c.rgb


PICTURES: dict[str, Picture] = {
    "rug": Picture(tuple(_PARTNERS), 15, _rug),
    "art": Picture(_ACCENTS, 20, lambda rng, colour, variant: paint(rng, colour or "blue", variant)),
    "books": Picture((), 4, _books),
    "screen": Picture((), 3, _screen, 0.5),
}
