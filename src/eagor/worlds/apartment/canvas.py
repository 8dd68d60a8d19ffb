"""What textures are drawn with: a canvas of linear light, noise that repeats, and ridges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor._srgb import to_linear


def linear(rgb: tuple[int, int, int]) -> np.ndarray:
    """sRGB from 0 to 255 as linear light ``(3,)``."""
    return to_linear(np.array(rgb) / 255)


def noise(rng: np.random.Generator, shape: tuple[int, int], slope: float = 1.0, stretch: float = 1.0) -> np.ndarray:
    """Noise ``(rows, columns)`` that repeats without a seam: mean 0, deviation 1, amplitude 1 / frequency ** slope.

    `stretch` > 1 draws it out along the columns (u), < 1 along the rows.
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
    """A picture in the making: `rgb` ``(h, w, 3)`` linear light, drawn on in place.

    `x` to the right from 0 to w/h and `y` up from 0 to 1, each ``(h, w)``: a circle is a circle.
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

    def stroke(self, start: tuple[float, float], end: tuple[float, float], width: float) -> np.ndarray:
        """Opacity of a line with round ends."""
        (x0, y0), (x1, y1) = start, end
        dx, dy = x1 - x0, y1 - y0
        along = np.clip(((self.x - x0) * dx + (self.y - y0) * dy) / max(dx * dx + dy * dy, 1e-12), 0, 1)
        distance = np.hypot(self.x - x0 - along * dx, self.y - y0 - along * dy)
        return np.clip((width / 2 - distance) * self.pixels + 0.5, 0, 1)

    def window(self, low: tuple[float, float], high: tuple[float, float]) -> Canvas:
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

    def line(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        width: float,
        colour: np.ndarray,
        opacity: float = 1.0,
    ) -> Canvas:
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
