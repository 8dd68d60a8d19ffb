"""A search on a map from above: the floor that its looks showed, and in which steps nothing was believed yet.

A record holds no looks. They are made again from its poses (`eagor.tasks.search_space`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import label, map_coordinates

from eagor.evaluation.charts import blank, colour_of, finished, style_of
from eagor.evaluation.published import OURS
from eagor.evaluation.samples import Record
from eagor.tasks.floor_map import CELL, FLOOR, FloorMap
from eagor.tasks.search_space import looked_along

if TYPE_CHECKING:
    from eagor.tasks.places import Place
    from eagor.tasks.rules import Camera
    from eagor.worlds.walkable import Walkable

BLUE = (36, 146, 232)  # red, green, blue: one for a light and a dark page, as the greys of the plan are
FAINT, STRONG = 0.17, 0.4  # how much it covers: floor that was seen from afar, and where looks surely find a thing
HALF = 0.5  # of what is about a point is floor that was seen: the edge of what is shaded
DASHES = (0, (1.5, 1.0))  # of steps in which the body searched, in widths of the line
WIDTH = 3.2  # of the line of our default method


@dataclass(frozen=True, eq=False)
class Search:
    """An episode of our default method that was played with the policy `search`.

    `searching` ``(n,)`` bool: in which steps the body searched, and did not go to where it believed the thing. `found`
    ``(rows, cols)`` of the place's plan: the probability that the looks would have found a thing that stands there, NaN
    where none showed the floor; None if nobody can tell: the record does not name its camera.
    """

    searching: np.ndarray
    found: np.ndarray | None

    @property
    def caption(self) -> str:
        """What to say below a map of it."""
        said = f"How {OURS} searched."
        if self.found is not None:
            said += " Blue: floor that its looks had shown by the end; stronger where they would have found the thing."
        return said

    def in_words(self, free: np.ndarray) -> str:
        """What a map shows of it; `free` ``(rows, cols)`` bool: the floor of the plan on which a body can stand."""
        steps = f"{OURS} searched in {np.count_nonzero(self.searching)} of its steps, whose line is dashed"
        if self.found is None:
            return steps
        seen = 100 * np.mean(np.isfinite(self.found[free]))
        return f"{steps}; its looks showed {seen:.0f} % of the free floor, which is shaded"


def search_of(place: Place, record: Record, camera: Camera | None) -> Search | None:
    """How our default method searched in an episode; None if its body only followed the estimate.

    Without a `camera`, nobody knows what a look showed.
    """
    trace = record["methods"][OURS]["trace"]
    if "searching" not in trace:
        return None
    poses = np.array(trace["pose"], dtype=float)
    found = None if camera is None else _on_plan(looked_along(place, poses, camera), place.ground)
    return Search(np.array(trace["searching"], dtype=bool), found)


def _on_plan(known: FloorMap, ground: Walkable) -> np.ndarray:
    """`Search.found`, for the cells of the plan ``(rows, cols)``: smaller ones, between which it goes evenly."""
    rows, cols = np.indices(ground.free.shape)
    points = ground.origin + ground.cell * (np.stack([cols, rows], axis=-1) + 0.5)
    at = np.moveaxis((points - known.origin) / CELL - 0.5, -1, 0)[::-1]
    floor = (known.state == FLOOR).astype(float)
    shown = map_coordinates(floor, at, order=1, mode="constant")
    found = map_coordinates(floor * (1.0 - known.worth), at, order=1, mode="constant")
    seen = (shown >= HALF) & ~ground.structure  # cells of looks are larger than walls, and reach behind them:
    pieces = np.zeros(seen.shape, dtype=np.int32)
    label(seen, output=pieces)
    seen &= np.isin(pieces, pieces[seen & ground.free])  # such slivers touch no free ground
    return np.where(seen, found / np.maximum(shown, HALF), np.nan)


def shaded(picture: np.ndarray, found: np.ndarray) -> np.ndarray:
    """A plan ``(rows, cols, 4)`` (red, green, blue, cover; uint8) with the blue of `Search.found` over it."""
    cover = np.where(np.isfinite(found), FAINT + (STRONG - FAINT) * np.nan_to_num(found), 0.0)[..., None]
    below = picture[..., 3:] / 255 * (1 - cover)
    total = cover + below
    colour = (cover * np.array(BLUE) + below * picture[..., :3]) / np.maximum(total, 1e-9)
    return np.concatenate([colour, 255 * total], axis=-1).round().astype(np.uint8)


def draw_way(axes: Any, way: np.ndarray, searching: np.ndarray) -> None:
    """The way ``(n, 2)`` of our default method; step k leads from its point k, dashed where `searching` ``(n,)``."""
    turns = np.flatnonzero(np.diff(searching[: len(way) - 1])) + 1
    for first, last in zip([0, *turns], [*turns, len(way) - 1], strict=True):
        style = style_of(OURS, marker="", linewidth=WIDTH)
        if searching[first]:
            style |= {"linestyle": DASHES, "dash_capstyle": "butt"}
        axes.plot(*way[first : last + 1].T, **style)


def key(search: Search, of: str) -> str:
    """What dashes and shades mean, as a picture of its own; `of`: what it belongs to."""
    from matplotlib.patches import Rectangle

    shades = 5 if search.found is not None else 0
    height = 40 if shades else 18
    figure, axes = blank(480, height)
    axes.set_xlim(0, 480)
    axes.set_ylim(0, height)
    text = {"va": "center", "fontsize": 12, "color": colour_of("ink")}
    left, middle = 14, 198
    for x, dashes, words in ((left, DASHES, "searching"), (middle, "-", "going to where it believed the thing")):
        axes.plot([x, x + 36], [height - 9] * 2, **style_of(OURS, marker="", linewidth=WIDTH, linestyle=dashes))
        axes.text(x + 44, height - 9, words, **text)
    for k in range(shades):
        cover = FAINT + (STRONG - FAINT) * k / (shades - 1)
        colour = tuple(part / 255 for part in BLUE)
        axes.add_patch(Rectangle((middle + 22 * k, 3), 22, 13, fc=colour, alpha=cover, lw=0))
    if shades:
        axes.text(left, 9, "looks may miss the thing", **text)
        axes.text(middle + 22 * shades + 8, 9, "looks would find it", **text)
    words = "dashed where it searched, solid where it went to where the thing should be"
    words += "; shaded where looks showed the floor, the stronger the surer they find a thing there" if shades else ""
    return finished(figure, f"Key to the search of {of}", words)
