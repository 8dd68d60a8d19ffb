"""Shared by all pictures: colours, figures without pyplot, and their conversion to images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

INK, PAPER, GRID_LINE, QUIET = "#1f2430", "#ffffff", "#d8dbe2", "#5b6472"


def figure(width: int, height: int) -> Figure:
    """An empty figure of this size in pixels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width / 100, height / 100), dpi=100, facecolor=PAPER)


def image(drawn: Figure) -> Image:
    """The figure as an image, RGB."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text
    from PIL import Image

    for text in drawn.findobj(Text):
        text.set_parse_math(False)  # type: ignore[attr-defined]  # dollars in queries and names are not formulas
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def plain(axes: Axes) -> None:
    """Unobtrusive ticks and frame."""
    axes.tick_params(colors=INK, labelsize=9.5, length=3)
    for spine in axes.spines.values():
        spine.set_color("#9aa1ad")
