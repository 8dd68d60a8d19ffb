"""A perception without a model: it finds the colour that the query names.

It serves for coloured markers and first trials. It judges pixels in CIELAB by what shading leaves unchanged: hue, and
chroma in proportion to lightness. The lit and the shaded side of a red footstool are then both red; a plain colour
difference (Delta E) would call the shaded side black and a pink wall half red.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from eagor._checks import require, warn_unless_whole, whole
from eagor._srgb import to_linear
from eagor.errors import QueryError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detections import View
from eagor.evidence.detector import DetectorModel
from eagor.grids import Grid, PatchGrid, PerspectiveGrid
from eagor.perception.fusion import blobs, blurred, spread_evidence
from eagor.sources.panorama import checked_picture

# A fuzzy interval: 0 up to the first number, 1 between the second and the third, 0 from the fourth on.
Interval = tuple[float, float, float, float]
_INF = math.inf


@dataclass(frozen=True)
class Colour:
    """A colour as fuzzy intervals of CIELAB hue (degrees), saturation and lightness (0 to 100).

    Saturation is chroma / (lightness + 12): nearly constant under shading, and stable in the dark, where chroma is
    noise. Achromatic colours have no hue.
    """

    hue: Interval | None
    saturation: Interval
    lightness: Interval


LEVEL = 0.5  # likeness from which on a cell belongs to a region
LEAST = 1.5  # least weight of a region, in the largest cells: two cells in a row weigh 1 and may be noise, a thing 4
# Across, in a panorama: smaller regions are specks and fringes. With finer rows, photographs have five times as many.
SMALLEST = math.radians(1)
STRIP = 32  # rows that are judged at a time: small arrays stay in the processor's cache, and cost no new memory


def _above(low: float, high: float) -> Interval:
    return (low, high, _INF, _INF)


COLOURS: dict[str, Colour] = {
    "black": Colour(None, (-_INF, -_INF, 0.25, 0.45), (-_INF, -_INF, 14, 24)),
    "white": Colour(None, (-_INF, -_INF, 0.07, 0.13), _above(78, 88)),
    "grey": Colour(None, (-_INF, -_INF, 0.08, 0.14), (18, 28, 72, 84)),
    "red": Colour((-6, 7, 41, 50), _above(0.4, 0.52), (3, 7, 68, 78)),
    "orange": Colour((42, 52, 74, 82), _above(0.55, 0.75), _above(38, 46)),
    "yellow": Colour((76, 86, 112, 120), _above(0.55, 0.75), _above(42, 52)),
    "green": Colour((105, 115, 172, 184), _above(0.18, 0.28), _above(5, 9)),
    "cyan": Colour((174, 184, 215, 226), _above(0.18, 0.28), _above(20, 30)),
    "blue": Colour((215, 228, 307, 312), _above(0.2, 0.3), _above(4, 8)),
    "purple": Colour((306, 312, 334, 344), _above(0.25, 0.35), (4, 8, 72, 80)),
    "pink": Colour((-38, -22, 20, 34), _above(0.18, 0.26), _above(50, 60)),
    "brown": Colour((30, 42, 80, 92), (0.3, 0.45, 1.2, 1.6), (6, 12, 46, 56)),
    "beige": Colour((55, 66, 112, 122), (0.08, 0.14, 0.4, 0.5), _above(58, 68)),
}
SYNONYMS: dict[str, str] = {
    "gray": "grey", "silver": "light grey", "charcoal": "dark grey",
    "crimson": "red", "scarlet": "red", "maroon": "dark red", "burgundy": "dark red",
    "gold": "yellow", "golden": "yellow", "lime": "green", "olive": "dark green",
    "turquoise": "cyan", "teal": "cyan", "aqua": "cyan", "navy": "dark blue",
    "violet": "purple", "magenta": "purple", "lilac": "light purple",
    "tan": "beige", "cream": "beige",
}  # fmt: skip
_SHADES = {"dark": "dark", "deep": "dark", "light": "light", "pale": "light"}


@dataclass(frozen=True, kw_only=True)
class ColourPerception:
    """Finds the first colour that the query names: "red", "the dark green chair", "a light blue ball".

    Each connected region of the colour is a detection. It has the region's mean direction and extent (so that a wall
    points nowhere in particular); its score is the mean likeness.

    Attributes:
        calibration: None for detections. With one, the map of likeness is read as a response map instead.
        rows: the panorama is averaged (in linear light) down to at most this many rows and twice as many columns. A
            thing has to cover two cells each way to count in full; single cells do not count. With 256 rows, things
            from 2 degrees across on are found (half of those of 1.6 degrees), with 512 from 1 degree on, at 2.5 times
            the cost.
        detector: error model of the detections (default: half of the mistakes repeat, since colours do not change).

    Raises `EagorError` for less than one row.
    """

    calibration: Calibration | None = None
    rows: int = 256
    detector: DetectorModel = field(default_factory=DetectorModel)

    def __post_init__(self) -> None:
        require(self, {"rows": (whole(self.rows, 1), "a whole number, 1 or more")})

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in `panorama` ``(H, W, 3)``, uint8, sRGB.

        Raises `QueryError` if the query names no known colour, `ImageError` if the panorama is not such an array.
        """
        response = self.respond(panorama, query)
        warn_unless_whole(np.asarray(panorama))
        grid = PatchGrid(*response.shape)
        return self._evidence(response, grid, grid, stamp)

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence from one perspective picture ``(h, w, 3)``, whose pixels `grid` describes. Errors as for a call."""
        colour = parse_colour(query)
        times = max(grid.height / self.rows, grid.width / (2 * self.rows), 1.0)  # the same factor in both directions
        picture = checked_picture(image, "the picture", grid)
        linear = _reduced(picture, max(1, round(grid.height / times)), max(1, round(grid.width / times)))
        response = _likeness(linear, colour, around=False)
        return self._evidence(response, grid.resized(*response.shape), grid, stamp)

    def _evidence(
        self, response: np.ndarray, cells: PatchGrid | PerspectiveGrid, seen: Grid, stamp: float | None
    ) -> Evidence:
        if self.calibration is not None:
            return Evidence.from_response(response, cells, calibration=self.calibration, stamp=stamp)
        least = LEAST * float(cells.weights.max())
        if isinstance(cells, PatchGrid):
            least = max(least, math.pi / 4 * SMALLEST**2)
        return spread_evidence(blobs(response, cells, LEVEL, least), self.detector, View(seen), stamp)

    def respond(self, panorama: np.ndarray, query: str) -> np.ndarray:
        """The likeness of each cell to the colour of `query`, in [0, 1]; at most ``(rows, 2 * rows)``."""
        colour, linear = parse_colour(query), _reduced(panorama, self.rows, 2 * self.rows)
        return _likeness(linear, colour)


def parse_colour(query: str) -> Colour:
    """The first colour named in `query`, with "dark" or "light" before it. Raises `QueryError` if there is none."""
    if (colour := colour_in(query)) is not None:
        return colour
    raise QueryError(
        f"the query {query!r} names no colour, and this perception sees only colours. Add one, such as 'the red chair' "
        f"or 'dark green'; known are {', '.join([*COLOURS, *SYNONYMS])}"
    )


def colour_in(query: str) -> Colour | None:
    """The first colour named in `query`, with "dark" or "light" before it; None if there is none."""
    words: list[str] = re.findall(r"[a-z]+", query.lower()) if isinstance(query, str) else []
    for previous, word in zip(["", *words], words, strict=False):
        shade, _, name = SYNONYMS.get(word, word).rpartition(" ")
        if name in COLOURS:
            return _shaded(COLOURS[name], _SHADES.get(previous, shade))
    return None


def is_colour(query: str) -> bool:
    """Whether `query` names a colour and nothing else: "red", "dark green"."""
    words = set(re.findall(r"[a-z]+", query.lower()))
    return bool(words) and words <= {*COLOURS, *SYNONYMS, *_SHADES}


def share_of(colour: Colour, picture: np.ndarray) -> float:
    """How much of a picture ``(h, w, 3)`` uint8 has this colour: the mean likeness."""
    return float(_likeness(_reduced(picture, *picture.shape[:2]), colour, around=False).mean())


def _shaded(colour: Colour, shade: str) -> Colour:
    """`colour` made "dark" or "light"; unchanged for ""."""
    zero_low, full_low, full_high, zero_high = colour.lightness
    if shade == "dark":
        return replace(colour, lightness=(zero_low - 20, full_low - 20, min(full_high, 40), min(zero_high, 54)))
    if shade == "light":
        low, high = colour.saturation[:2]  # light colours are pale: half of the saturation suffices
        lightness = (max(zero_low, 46), max(full_low, 60), full_high + 20, zero_high + 20)
        return replace(colour, lightness=lightness, saturation=(low / 2, high / 2, *colour.saturation[2:]))
    return colour


def _reduced(panorama: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """The picture in linear light, averaged over blocks down to at most ``(rows, columns, 3)``, float32."""
    image, table = checked_picture(panorama), to_linear(np.arange(256, dtype=np.float32) / 255)
    height, width = image.shape[:2]
    if height <= rows and width <= columns:
        return table[image]
    # Cells end at the nearest pixel border; rounding down would shift everything by half a pixel, up and to the left.
    tops = np.rint(np.linspace(0, height, min(height, rows) + 1)).astype(int)
    lefts = np.rint(np.linspace(0, width, min(width, columns) + 1)).astype(int)
    strips = [table[image[top:end]].mean(axis=0) for top, end in pairwise(tops)]
    sums = np.add.reduceat(np.stack(strips), lefts[:-1], axis=1)
    return sums / np.diff(lefts)[:, None].astype(np.float32)


# Linear sRGB to CIE XYZ (IEC 61966-2-1), each row over its sum, so that white (D65) is (1, 1, 1).
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]], dtype=np.float32)
_XYZ /= _XYZ.sum(axis=1, keepdims=True)


def _likeness(linear: np.ndarray, colour: Colour, around: bool = True) -> np.ndarray:
    """Likeness of each pixel to `colour`, in [0, 1]: the product of its fuzzy memberships, with lone pixels suppressed.

    Each value is weighted by the agreement of its 3 x 3 neighbourhood; `around`: the last column touches the first.
    """
    strips = np.split(linear, range(STRIP, len(linear), STRIP))
    likeness = np.concatenate([_pixel_likeness(strip, colour) for strip in strips])
    rows = np.flatnonzero(likeness.any(axis=1))
    if len(rows):
        part = slice(max(rows[0] - 1, 0), rows[-1] + 2)  # beyond, there is nothing to suppress
        likeness[part] *= _ramp(blurred(likeness[part], around), 0.25, 0.5)
    return likeness


def _pixel_likeness(linear: np.ndarray, colour: Colour) -> np.ndarray:
    """Likeness of each pixel of ``(h, w, 3)`` by itself, in [0, 1]."""
    ratio = linear @ _XYZ.T  # CIELAB L* (0 to 100), a* and b* (CIE 15, section 8.2.1)
    f, dark = np.cbrt(ratio), ratio <= (6 / 29) ** 3
    f[dark] = ratio[dark] * (29 / 6) ** 2 / 3 + 4 / 29
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    lightness, a, b = 116 * y - 16, 500 * (x - y), 200 * (y - z)
    saturation = np.hypot(a, b) / (lightness + 12)
    # Mostly few: what is too pale or too vivid is not judged any further.
    some = ((saturation > colour.saturation[0]) & (saturation < colour.saturation[-1])).nonzero()
    members = _member(saturation[some], colour.saturation) * _member(lightness[some], colour.lightness)
    if colour.hue is not None:
        start, full_low, full_high, end = colour.hue
        turned = (np.degrees(np.arctan2(b[some], a[some])) - start) % 360  # the interval starts at zero, without a wrap
        members *= _member(turned, (0.0, full_low - start, full_high - start, end - start))
    likeness = np.zeros_like(saturation)
    likeness[some] = members
    return likeness


def _member(values: np.ndarray, interval: Interval) -> np.ndarray:
    """Membership of `values` in a fuzzy interval."""
    zero_low, full_low, full_high, zero_high = interval
    rise = _ramp(values, zero_low, full_low) if full_low > -_INF else 1.0
    fall = _ramp(-values, -zero_high, -full_high) if full_high < _INF else 1.0
    return rise * fall * np.ones_like(values)


def _ramp(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, a smooth cubic between."""
    t = np.clip((values - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
