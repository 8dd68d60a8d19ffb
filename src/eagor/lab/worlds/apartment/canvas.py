"""Drawing tools for textures: named colours, a canvas of linear light, periodic noise, ridges, brushes.

Named colours are tones of cloth, paint and wood rather than pure primaries; the names are those of
`eagor.queries.COLOURS`. Each has a few tones, and every call of `sRGB` varies the tone a little, so that two red
chairs are both red but not identical. All other colours are linear RGB ``(3,)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor._srgb import to_linear

RGB = tuple[float, float, float]
Point = tuple[float, float]

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
    pixels: int  # rows of the whole canvas, of which this may be a window

    @classmethod
    def blank(cls, height: int, width: int, colour: np.ndarray) -> Canvas:
        """A canvas of one colour ``(3,)``."""
        v, x = (np.mgrid[:height, :width] + 0.5) / height
        return cls(np.ones((height, width, 1)) * colour, x, 1 - v, height)

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
        return np.clip((1 - distance) * min(radius, tall) * self.pixels + 0.5, 0, 1)

    def stroke(self, start: Point, end: Point, width: float) -> np.ndarray:
        """Opacity of a line with round ends."""
        (x0, y0), (x1, y1) = start, end
        dx, dy = x1 - x0, y1 - y0
        along = np.clip(((self.x - x0) * dx + (self.y - y0) * dy) / max(dx * dx + dy * dy, 1e-12), 0, 1)
        distance = np.hypot(self.x - x0 - along * dx, self.y - y0 - along * dy)
        return np.clip((width / 2 - distance) * self.pixels + 0.5, 0, 1)

    def window(self, low: Point, high: Point) -> Canvas:
        """The part of the canvas between two corners (x, y); drawing on it draws on the whole."""
        left, top = (self.x[0, 0], 1 - self.y[0, 0]) if self.x.size else (0.0, 0.0)
        columns, rows = (
            slice(max(0, int(self.pixels * (start - edge)) - 1), max(0, int(self.pixels * (end - edge)) + 2))
            for start, end, edge in ((low[0], high[0], left), (1 - high[1], 1 - low[1], top))
        )
        return Canvas(self.rgb[rows, columns], self.x[rows, columns], self.y[rows, columns], self.pixels)

    def spot(self, x: float, y: float, radius: float, colour: np.ndarray, opacity: float = 1.0) -> Canvas:
        """Lay `colour` ``(3,)`` on a disc."""
        near = self.window((x - radius, y - radius), (x + radius, y + radius))
        near.fill(near.disc(x, y, radius) * opacity, colour)
        return self

    def line(self, start: Point, end: Point, width: float, colour: np.ndarray, opacity: float = 1.0) -> Canvas:
        """Lay `colour` ``(3,)`` on a line with round ends."""
        (x0, y0), (x1, y1) = start, end
        low, high = (min(x0, x1) - width, min(y0, y1) - width), (max(x0, x1) + width, max(y0, y1) + width)
        near = self.window(low, high)
        near.fill(near.stroke(start, end, width) * opacity, colour)
        return self

    def ridge(self, rng: np.random.Generator, slope: float) -> np.ndarray:
        """A skyline ``(1, w)``: mean 0, deviation 1; the larger `slope`, the smoother."""
        count = self.x.shape[1]
        frequency = np.fft.rfftfreq(2 * count, 1 / (2 * count))
        frequency[0] = np.inf
        line = np.fft.irfft(np.fft.rfft(rng.standard_normal(2 * count)) / frequency**slope)[:count]
        return ((line - line.mean()) / line.std())[None, :]


PAPER = linear((236, 230, 216))
INK = linear((38, 36, 40))
_ACCENTS = ("red", "orange", "yellow", "green", "blue", "purple", "pink", "brown", "beige")


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
