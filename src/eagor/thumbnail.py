"""Small pictures for notebooks: a belief, an estimate or a look as HTML, with its text below.

The whole sphere as an equirectangular map in the body frame: forward in the middle, left to the left.
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Callable, Sequence

import numpy as np

from eagor._arrays import Array, to_numpy
from eagor.grids import Grid, PatchGrid

GRID = PatchGrid(120, 240)
HALF = 2 * math.pi  # steradians: the border of a larger region is not drawn
NEAR, ALIKE = 0.1, math.pi / 2  # nats, steradians: if so much area is so near to the level, ripples decide the border
MOST = 5.0  # nats: the least range of the colours, so that weak evidence looks pale
# Density, from none to the highest; evidence against, none, for; not looked at.
HEAT = np.array([(22, 18, 40), (101, 21, 110), (212, 72, 66), (252, 165, 10), (252, 255, 164)], dtype=float)
SIGNED = np.array([(33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43)], dtype=float)
UNSEEN, LINES, BORDER, ANSWER = (120, 120, 120), (110, 110, 120), (255, 255, 255), (0, 229, 255)


def density_html(
    text: str,
    log_density: Callable[[np.ndarray], Array],
    border: float,
    area: float,
    modes: Sequence[np.ndarray] = (),
    answer: np.ndarray | None = None,
) -> str:
    """A density, the border of its 90 % region (a log density, steradians), candidates (rings), an answer (dot)."""
    values = np.asarray(log_density(GRID.directions))
    times = 4 * math.pi * np.exp(values)
    most, known = float(times.max()), np.ptp(times) >= 1e-6
    picture = _coloured((1 - 1 / most) * np.sqrt(np.clip((times - 1) / (most - 1), 0, 1)) if known else 0 * times, HEAT)
    if known and not undrawn(values, GRID.weights, border, area):
        inside = np.pad(values >= border, ((1, 1), (0, 0)), mode="edge")
        inner = np.roll(inside, 1, 1) & np.roll(inside, -1, 1) & np.roll(inside, 1, 0) & np.roll(inside, -1, 0)
        picture[(inside & ~inner)[1:-1]] = BORDER
    marks = [(mode, 7.5, 10.0, BORDER) for mode in modes] + ([] if answer is None else [(answer, 0.0, 4.5, ANSWER)])
    for direction, least, widest, colour in marks:
        angle = np.degrees(np.arccos(np.clip(GRID.directions @ direction, -1, 1)))
        picture[(angle >= least) & (angle <= widest)] = colour
    return _html(picture, text)


def unknown_html(text: str) -> str:
    """A picture without a belief."""
    return _html(_coloured(np.zeros(GRID.shape), HEAT), text)


def text_html(text: str) -> str:
    """The text alone."""
    return f"<pre>{html.escape(text)}</pre>"


def ratio_html(text: str, values: np.ndarray, seen: np.ndarray) -> str:
    """Log ratios on `GRID`: red where they speak for the target, blue where against, grey where nobody looked."""
    most = max(float(np.abs(values[seen]).max(initial=0.0)), MOST)
    return _html(_coloured((values / most + 1) / 2, SIGNED, seen), text)


def on_grid(map_: Array, grid: Grid, coverage: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """A map on `grid` (the first of a batch) resampled to `GRID`, and where it was looked at."""
    values = np.asarray(to_numpy(map_), dtype=float)
    values = values.reshape(-1, *values.shape[-2:])[0]
    x, y, seen = grid.project(GRID.directions)
    height, width = values.shape
    column = np.where(seen, x, 0.0).astype(int) % width
    row = np.clip(np.where(seen, y, 0.0).astype(int), 0, height - 1)
    if coverage is not None:
        seen = seen & (coverage[row, column] > 0)
    return np.where(seen, values[row, column], 0.0), seen


def undrawn(log_density: np.ndarray, weights: np.ndarray, border: float, area: float) -> str:
    """Why a region of this `area` (steradians) is not drawn; empty if it is.

    `log_density` on cells of solid angles `weights`; `border`: the level at the border.
    """
    if area > HALF:
        return "over half of the sphere"
    near = np.abs(log_density - border) < NEAR
    return "its border runs where all is alike" if float(weights[near].sum()) > ALIKE else ""


def _coloured(share: np.ndarray, colours: np.ndarray, seen: np.ndarray | None = None) -> np.ndarray:
    """Values in [0, 1] ``(H, W)`` as colours ``(H, W, 3)``, with lines at the horizon, to both sides and ahead."""
    at = np.clip(share, 0, 1) * (len(colours) - 1)
    picture = np.stack([np.interp(at, np.arange(len(colours)), channel) for channel in colours.T], axis=-1)
    if seen is not None:
        picture[~seen] = UNSEEN
    lines = np.zeros(share.shape, dtype=bool)
    lines[len(lines) // 2], lines[:, GRID.width // 4 :: GRID.width // 4] = True, True
    picture[lines] = 0.7 * picture[lines] + 0.3 * np.array(LINES)
    return picture


def _html(picture: np.ndarray, text: str) -> str:
    from PIL import Image

    buffer = io.BytesIO()
    image = Image.fromarray(np.rint(picture).astype(np.uint8)).quantize(64, dither=Image.Dither.NONE)
    image.save(buffer, format="PNG", optimize=True)
    data, told = base64.b64encode(buffer.getvalue()).decode("ascii"), html.escape(text)
    return (
        f'<figure style="margin:0"><img src="data:image/png;base64,{data}" alt="{told}" '
        f'style="width:{2 * GRID.width}px;max-width:100%;image-rendering:pixelated">'
        f'<figcaption style="font-size:0.85em">{told}</figcaption></figure>'
    )
