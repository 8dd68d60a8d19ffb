"""What is asked about a panorama, and how the answers become a response, or a set of detections.

Each extractor is a plan: the pictures and questions of one look at a panorama, and what the answers, in the order of
the questions, amount to.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eagor.detections import WHOLE_SPHERE, canvas_of
from eagor.grids import Grid, PerspectiveGrid
from eagor.perception.endpoint.messages import Answer, Picture, Question
from eagor.perception.vlm.boxes import Box, parse_boxes
from eagor.perception.vlm.drawing import drawn
from eagor.perception.vlm.found import Thing, things
from eagor.perception.vlm.presence import parse_presence
from eagor.perception.vlm.prompts import ask_boxes, ask_presence, boxes_schema
from eagor.perception.vlm.seam import merged
from eagor.perception.vlm.sizes import resized
from eagor.perception.vlm.styles import Style
from eagor.perception.vlm.views import cut, filled, framed, lift

GRID = WHOLE_SPHERE  # where all responses come


@dataclass(frozen=True)
class Manner:
    """How all questions of a perception are sent."""

    max_tokens: int
    image_format: Literal["png", "jpeg"]


@dataclass(frozen=True)
class Boxed:
    """Boxes in a picture with the geometry of `image`, rolled by the fraction `roll`; drawn on `canvas`."""

    boxes: list[Box]
    image: Grid
    canvas: Grid
    roll: float

    @property
    def things(self) -> list[Thing]:
        """What they mean."""
        return things(self.boxes, self.image, self.roll)

    @property
    def response(self) -> np.ndarray:
        """On the canvas."""
        return drawn(self.boxes, self.image, self.canvas, roll=self.roll)


Reading = Boxed | np.ndarray  # of one answer: boxes, or a response on the cells that the picture stands for


@dataclass(frozen=True)
class Item:
    """One question and how its answer is read."""

    question: Question
    read: Callable[[Answer], Reading]


@dataclass(frozen=True)
class Plan:
    """One look: what is asked, and the response ``(Q, h, w)`` and coverage ``(h, w)`` on `GRID` of what was read.

    `combine` takes the readings in the order of `items`.
    """

    items: tuple[Item, ...]
    combine: Callable[[Sequence[Reading]], tuple[np.ndarray, np.ndarray]]
    size: tuple[int, int]  # (height, width) of the pictures
    pictures: int


def boxes_plan(
    panorama: np.ndarray, queries: Sequence[str], style: Style, size: tuple[int, int], seam: bool, manner: Manner
) -> Plan:
    """Boxes in the whole panorama at `size`; with `seam` in the rolled panorama, too."""
    image = resized(panorama, size, wrap=True)
    cells = max(1, size[1] // style.cell)
    shift = cells // 2 * style.cell if seam else 0
    rolls = (0, shift) if shift else (0,)
    items: list[Item] = []
    for roll in rolls:
        picture = Picture(np.roll(image, roll, axis=1) if roll else image, manner.image_format)
        for query in queries:
            items.append(_boxes_item(picture, query, style, GRID, GRID, manner.max_tokens, roll / size[1]))

    def combine(read: Sequence[Reading]) -> tuple[np.ndarray, np.ndarray]:
        looks = _stacked(read, len(queries))
        response = looks[0] if len(looks) == 1 else merged(looks[0], looks[1], shift / size[1])
        return response, np.ones(GRID.shape)

    return Plan(tuple(items), combine, size, len(rolls))


def views_plan(
    panorama: np.ndarray,
    queries: Sequence[str],
    style: Style,
    views: Sequence[PerspectiveGrid],
    margin: float,
    boxes: bool,
    manner: Manner,
) -> Plan:
    """Boxes in, or the presence in, each of several views of the panorama."""
    items: list[Item] = []
    for view in views:
        picture = Picture(cut(panorama, view), manner.image_format)
        for query in queries:
            if boxes:
                items.append(_boxes_item(picture, query, style, view, canvas_of(view), manner.max_tokens))
            else:
                question = Question(picture, ask_presence(query), manner.max_tokens, alternatives=True)
                items.append(Item(question, _presence))

    def combine(read: Sequence[Reading]) -> tuple[np.ndarray, np.ndarray]:
        return lift(_stacked(read, len(queries)), views, GRID, margin)

    return Plan(tuple(items), combine, views[0].shape, len(views))


def view_plan(
    image: np.ndarray,
    grid: PerspectiveGrid,
    query: str,
    style: Style,
    size: tuple[int, int],
    boxes: bool,
    manner: Manner,
) -> tuple[Plan, PerspectiveGrid]:
    """Boxes in, or the presence in, one ordinary picture; and the cells that the response is on, instead of `GRID`."""
    framing, posed, inner = framed(image, grid, size)
    picture, cells = Picture(framing, manner.image_format), canvas_of(posed)
    assert isinstance(cells, PerspectiveGrid)  # a coarse copy of the view
    if boxes:
        item = _boxes_item(picture, query, style, posed, cells, manner.max_tokens)
    else:
        item = Item(Question(picture, ask_presence(query), manner.max_tokens, alternatives=True), _presence)

    def combine(read: Sequence[Reading]) -> tuple[np.ndarray, np.ndarray]:
        (response,) = _stacked(read, 1)
        return np.broadcast_to(response, (1, *cells.shape)).astype(np.float32), filled(cells.shape, size, inner)

    return Plan((item,), combine, size, 1), cells


def _boxes_item(
    picture: Picture,
    query: str,
    style: Style,
    image: Grid,
    canvas: Grid,
    max_tokens: int,
    roll: float = 0.0,
) -> Item:
    text, schema = ask_boxes(query, style.frame, style.order), boxes_schema(style.frame, style.order)

    def read(answer: Answer) -> Boxed:
        found = parse_boxes(answer.text, style.frame, picture.size, style.order, answer.tokens)
        return Boxed(found, image, canvas, roll)

    return Item(Question(picture, text, max_tokens, schema), read)


def _stacked(read: Sequence[Reading], count: int) -> list[np.ndarray]:
    """The responses of each picture ``(Q, h, w)`` to `count` queries."""
    drawn = [one.response if isinstance(one, Boxed) else one for one in read]
    return [np.stack(drawn[start : start + count]) for start in range(0, len(drawn), count)]


def _presence(answer: Answer) -> np.ndarray:
    """The probability of presence, as the one cell of a view."""
    return np.full((1, 1), parse_presence(answer.text, answer.verdict))
