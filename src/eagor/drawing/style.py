"""How answers read and pictures look: directions, distances and statuses in words; colours, fonts, figures.

Figures are made without pyplot; matplotlib is imported for the first one.
"""

from __future__ import annotations

import math
import warnings
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

    from eagor.tracking.estimate import Estimate

STATUS = {
    "searching": "it may not be here, or has not been found yet",
    "tracking": "more likely than not it is here, within 15 degrees of the answer or half its own size",
    "ambiguous": "it is likely here, and several directions fit",
    "stale": "there was an answer, and nothing has been looked at for a while",
}
LIKELY = "it is likely here, but its direction is uncertain"  # searching, and it is present rather than not
_SIGMAS_90 = 1.645  # standard deviations on either side that hold 90 % of a normal distribution


def in_words(azimuth: float, elevation: float) -> str:
    """A direction (radians, azimuth positive left) such as "64 degrees to the left, 33 degrees down".

    Within 4 degrees of an axis it counts as on the axis; within 5 degrees of a pole it is only up or down.
    """
    side, height = round(math.degrees(math.remainder(azimuth, math.tau))), round(math.degrees(elevation))
    if abs(height) >= 85:
        return "straight up" if height > 0 else "straight down"
    where, hand = abs(side), "left" if side > 0 else "right"
    if where <= 4:
        level = "straight ahead"
    elif where <= 112:
        level = f"{where} degrees to the {hand}"
    elif where <= 157:
        level = f"behind you, to the {hand} ({where} degrees)"
    elif where <= 175:
        level = f"behind you, slightly {hand} ({where} degrees)"
    else:
        level = "straight behind you"
    if abs(height) <= 4:
        return level
    return f"{level}, {abs(height)} degrees {'up' if height > 0 else 'down'}"


def answer_in_words(estimate: Estimate) -> str:
    """The answer of an estimate as `in_words`, or "direction not known"; and what was `looked_for`."""
    return _where(estimate) + looked_for(estimate)


def _where(estimate: Estimate) -> str:
    if estimate.azimuth is None or estimate.elevation is None:
        return "direction not known"
    return in_words(estimate.azimuth, estimate.elevation)


def looked_for(estimate: Estimate) -> str:
    """What was looked for, where that is another word than was asked: " (looked for chair)"; else ""."""
    return f" (looked for {estimate.looked_for})" if estimate.looked_for else ""


def status_in_words(status: str, presence: float) -> str:
    """What a status means, as of an estimate with this probability of presence."""
    return LIKELY if status == "searching" and presence > 0.5 else STATUS[status]


def candidates_in_words(estimate: Estimate) -> str:
    """The answer as `answer_in_words`; where it is ambiguous, with the next candidate: "straight ahead; or ..."."""
    if estimate.status != "ambiguous" or len(estimate.modes) < 2:
        return answer_in_words(estimate)
    second = estimate.modes[1]
    return f"{_where(estimate)}; or {in_words(second.azimuth, second.elevation)}{looked_for(estimate)}"


def confidence(estimate: Estimate) -> str:
    """How likely it is that the thing is here, and where the answer says: "80 % sure". The status follows from it.

    That is within 15 degrees of the answer, or half its own size, where that is more. Never 0 % or 100 %.
    """
    return f"{min(max(round(100 * estimate.confidence), 1), 99)} % sure"


def distance_in_words(distance: float | None, spread: float | None) -> str:
    """The 90 % interval of a distance, such as "1.1 to 6.4 m"; "" if not even its order of magnitude is known.

    `distance` is its mean in metres, `spread` the standard deviation of its logarithm, as an `Estimate` gives them. The
    distance counts as log-normal, so its median is below its mean.
    """
    if distance is None or spread is None or not math.isfinite(distance * spread):
        return ""
    half = _SIGMAS_90 * spread
    if 2 * half > math.log(10):
        return ""
    median = distance * math.exp(-(spread**2) / 2)
    nearest, farthest = _rounded(median * math.exp(-half)), _rounded(median * math.exp(half))
    return f"{nearest} m" if nearest == farthest else f"{nearest} to {farthest} m"


def far_in_words(estimate: Estimate) -> str:
    """The distance of the answer as `distance_in_words`; "" while searching, without positions, or if unknown."""
    searching = estimate.status == "searching"
    return "" if searching else distance_in_words(estimate.distance, estimate.distance_spread)


def signed(angle: float | None) -> str:
    """An angle (radians) in degrees with sign and one decimal: "+62.9"; "-" for None."""
    return "-" if angle is None else f"{math.degrees(angle):+.1f}"


def _rounded(metres: float) -> str:
    """Two digits, and at most one after the point from 0.1 m on."""
    return f"{round(metres, 1):g}" if 0.1 <= metres < 10 else f"{float(f'{metres:.2g}'):g}"


# --- pictures ---------------------------------------------------------------------------------------------------------

INK, PAPER, GRID_LINE, QUIET = "#1f2430", "#ffffff", "#d8dbe2", "#5b6472"
DESIGN = 1280  # columns that the sizes of dark pictures are for; one of another width is scaled
DARK, WORDS, FAINT = (18, 21, 27), "#eef1f6", "#a5aebb"  # of dark pictures: ground, words, quiet words
# By status. They differ in brightness too, and each is named beside the time line.
COLOURS = {"searching": "#7d8796", "tracking": "#2fd0e6", "ambiguous": "#ffb000", "stale": "#b48cff"}
# Azimuths in degrees, and what they are called.
SIDES = ((180, "behind"), (90, "left"), (0, "ahead"), (-90, "right"), (-180, "behind"))
# Beside matplotlib's own font, for queries in scripts that it lacks; those that are installed are used.
FONTS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "WenQuanYi Zen Hei", "Noto Sans Arabic", "Noto Sans Devanagari",
    "PingFang SC", "Hiragino Sans", "Microsoft YaHei", "Arial Unicode MS",
)  # fmt: skip


def figure(width: int, height: int, dpi: float = 100) -> Figure:
    """An empty, transparent figure of this size in pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=((width + 0.01) / dpi, (height + 0.01) / dpi), dpi=dpi)
    made.patch.set_visible(False)
    FigureCanvasAgg(made)
    return made


def painted(drawn: Figure, pixels: Any = 255) -> np.ndarray:
    """The figure drawn over `pixels` ``(H, W, 3)`` uint8, or a colour, by default white: a new array ``(H, W, 3)``."""
    from matplotlib.text import Text

    renderer: Any = drawn.canvas.get_renderer()  # type: ignore[attr-defined]
    buffer = np.asarray(renderer.buffer_rgba())
    buffer[..., :3], buffer[..., 3] = pixels, 255
    for text in drawn.findobj(Text):  # dollars in queries and names are not formulas
        text.set_parse_math(False)  # type: ignore[attr-defined]
    with warnings.catch_warnings():  # a character that no font has is drawn as a box
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        drawn.draw(renderer)
    return buffer[..., :3].copy()


def image(drawn: Figure) -> Image:
    """The figure on white paper as an image, RGB."""
    from PIL import Image

    return Image.fromarray(painted(drawn))


@lru_cache(maxsize=1)
def family() -> list[str]:
    """The fonts for words from outside, such as queries."""
    from matplotlib.font_manager import fontManager

    installed = {font.name for font in fontManager.ttflist}
    return ["DejaVu Sans", *(name for name in FONTS if name in installed)]


def plain(axes: Axes) -> None:
    """Unobtrusive ticks and frame."""
    axes.tick_params(colors=INK, labelsize=9.5, length=3)
    for spine in axes.spines.values():
        spine.set_color("#9aa1ad")


def short(text: str, most: int) -> str:
    """A text in one line of at most so many characters."""
    text = " ".join(text.split())
    return text if len(text) <= most else text[: most - 1] + "…"
