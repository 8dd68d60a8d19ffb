"""What the figures of the documentation share: colours, a plain look, small files."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL.Image import Dither

from eagor.drawing.style import GRID_LINE, INK, QUIET, figure, image, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

__all__ = ["INK", "OURS", "QUIET", "SIGNED", "TARGET", "THEIRS", "THIRD"]
__all__ += ["figure", "keep", "lines", "plain", "titled"]

IMAGES = Path(__file__).parents[1] / "images"

# Okabe and Ito's colours, which stay apart for the colour-blind: blue is ours, vermilion what it is compared with,
# green the truth.
OURS, THEIRS, TARGET, THIRD = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
SIGNED = "RdBu_r"  # fields that are for the target (red) or against it


def titled(axes: Axes, text: str, more: str = "") -> None:
    """A title at the left edge, and a quieter line below it."""
    axes.set_title(text + ("\n" if more else ""), loc="left", fontsize=11, color=INK, weight="bold", pad=6)
    if more:
        axes.text(0, 1.02, more, transform=axes.transAxes, fontsize=9, color=QUIET, va="bottom", ha="left")


def lines(axes: Axes) -> None:
    """A quiet grid behind curves, and no box around them."""
    plain(axes)
    axes.grid(color=GRID_LINE, linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def keep(drawn: Any, name: str) -> None:
    """Write a figure into docs/images, or the folder that the command line names.

    A PNG gets few colours; what has photographs in it keeps its own as WebP.
    """
    picture: Image = image(drawn)
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    if path.suffix == ".webp":
        picture.save(path, quality=85, method=6)
    else:
        picture.quantize(128, dither=Dither.NONE).save(path, optimize=True)
    print(f"   {path.name}: {path.stat().st_size // 1024} kB", flush=True)
