"""Shared by all pictures: colours, fonts, figures without pyplot, and their conversion to images."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

INK, PAPER, GRID_LINE, QUIET = "#1f2430", "#ffffff", "#d8dbe2", "#5b6472"
DESIGN = 1280  # columns that the sizes of dark pictures are for; one of another width is scaled
DARK, WORDS, FAINT = "#12151b", "#eef1f6", "#a5aebb"  # of dark pictures: ground, words, quiet words
# Beside matplotlib's own font, for queries in scripts that it lacks; those that are installed are used.
FONTS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "WenQuanYi Zen Hei", "Noto Sans Arabic", "Noto Sans Devanagari",
    "PingFang SC", "Hiragino Sans", "Microsoft YaHei", "Arial Unicode MS",
)  # fmt: skip


def figure(width: int, height: int) -> Figure:
    """An empty figure of this size in pixels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width / 100, height / 100), dpi=100, facecolor=PAPER)


def image(drawn: Figure) -> Image:
    """The figure as an image, RGB."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    _plain_words(drawn)
    canvas = FigureCanvasAgg(drawn)
    with _no_complaints():
        canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


@dataclass(frozen=True, eq=False)
class Sheet:
    """A transparent figure that is drawn again and again, over pixels that others made."""

    figure: Figure
    renderer: Any


def blank(width: int, height: int, dpi: float = 100) -> Sheet:
    """A transparent figure of this size in pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=((width + 0.01) / dpi, (height + 0.01) / dpi), dpi=dpi)
    made.patch.set_visible(False)
    return Sheet(made, FigureCanvasAgg(made).get_renderer())


def ground(width: int, height: int) -> np.ndarray:
    """The ground ``(height, width, 3)`` uint8 of a dark picture."""
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    pixels[:] = [int(DARK[at : at + 2], 16) for at in (1, 3, 5)]
    return pixels


def over(sheet: Sheet, pixels: np.ndarray) -> np.ndarray:
    """The figure drawn over `pixels` ``(H, W, 3)`` uint8; a new array of the same shape."""
    buffer = np.asarray(sheet.renderer.buffer_rgba())
    buffer[..., :3], buffer[..., 3] = pixels, 255
    _plain_words(sheet.figure)
    with _no_complaints():
        sheet.figure.draw(sheet.renderer)
    return buffer[..., :3].copy()


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


def _plain_words(drawn: Figure) -> None:
    """Dollars in queries and names are not formulas."""
    from matplotlib.text import Text

    for text in drawn.findobj(Text):
        text.set_parse_math(False)  # type: ignore[attr-defined]


@contextmanager
def _no_complaints() -> Iterator[None]:
    """A character that no font has is drawn as a box; a warning for each would help nobody."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        yield
