"""Extractors: which pictures and questions a look consists of, and how the answers become a response or detections.

Each extractor is a `Plan`: the pictures of one look, the question about each (boxes, or presence of the thing), and
the way to combine the responses of the pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eagor.evidence.shapes import WHOLE_SPHERE, canvas_of
from eagor.grids import Grid, PerspectiveGrid
from eagor.media.cutting import cut
from eagor.media.images import resized
from eagor.perception.endpoint.messages import Answer, Picture, Request, question
from eagor.perception.vlm.answers import Box, parse_boxes, parse_presence
from eagor.perception.vlm.families import Style
from eagor.perception.vlm.projection import Thing, drawn, filled, framed, lift, merged, things, united
from eagor.perception.vlm.prompts import ask_boxes, ask_presence, boxes_schema

GRID = WHOLE_SPHERE  # the grid of all responses to panoramas
Asked = Literal["boxes", "presence"]
Format = Literal["png", "jpeg"]


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture with the geometry of `grid`, rolled by the fraction `roll`; its response is on the grid `canvas`."""

    picture: Picture
    grid: Grid
    canvas: Grid
    roll: float = 0.0


@dataclass(frozen=True, eq=False)
class Reading:
    """The parsed answer about a shot: its boxes, or the probability that the thing is there."""

    shot: Shot
    found: list[Box] | float

    @property
    def things(self) -> list[Thing]:
        """The detections that the boxes stand for; none for a probability."""
        return things(self.found, self.shot.grid, self.shot.roll) if isinstance(self.found, list) else []

    @property
    def response(self) -> np.ndarray:
        """The response on the canvas; for a probability a single cell ``(1, 1)``."""
        if isinstance(self.found, list):
            return drawn(self.found, self.shot.grid, self.shot.canvas, roll=self.shot.roll)
        return np.full((1, 1), self.found)


@dataclass(frozen=True, eq=False)
class Plan:
    """One look: its pictures, with one question per query about each (all queries of a picture in a row).

    `combine` turns the responses of the pictures ``(Q, ...)`` into one ``(Q, h, w)`` with coverage ``(h, w)``.
    """

    shots: tuple[Shot, ...]
    asked: Asked
    style: Style
    combine: Callable[[list[np.ndarray]], tuple[np.ndarray, np.ndarray]]

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the pictures."""
        return self.shots[0].picture.size

    def questions(self, queries: Sequence[str], max_tokens: int) -> list[tuple[Shot, Request]]:
        """The requests, each with its shot."""
        style = self.style
        schema = boxes_schema(style.frame, style.order) if self.asked == "boxes" else None
        texts = [ask_boxes(q, style.frame, style.order) if schema else ask_presence(q) for q in queries]
        return [
            (shot, question(shot.picture, text, max_tokens, schema, alternatives=schema is None))
            for shot in self.shots
            for text in texts
        ]

    def read(self, shot: Shot, answer: Answer) -> Reading:
        """The parsed answer. Raises `AnswerError` if it cannot be read."""
        if self.asked == "presence":
            return Reading(shot, parse_presence(answer.text, answer.verdict))
        style = self.style
        return Reading(shot, parse_boxes(answer.text, style.frame, shot.picture.size, style.order, answer.tokens))

    def response(self, readings: Sequence[Reading], queries: int) -> tuple[np.ndarray, np.ndarray]:
        """The combined response and coverage of `readings` for this many queries."""
        drawn = [one.response for one in readings]
        return self.combine([np.stack(drawn[start : start + queries]) for start in range(0, len(drawn), queries)])

    def things(self, readings: Sequence[Reading], queries: int) -> tuple[list[Thing], ...] | None:
        """The detections of all pictures together, one list per query; None where no boxes were asked for."""
        if self.asked == "presence":
            return None
        return tuple(united(one.things for one in readings[query::queries]) for query in range(queries))


def boxes_plan(panorama: np.ndarray, style: Style, size: tuple[int, int], seam: bool, kind: Format) -> Plan:
    """Ask for boxes in the whole panorama at `size`; with `seam` also in the rolled panorama."""
    image = resized(panorama, size, wrap=True)
    shift = max(1, size[1] // style.cell) // 2 * style.cell if seam else 0
    roll = shift / size[1]
    shots = [Shot(Picture(image, kind), GRID, GRID)]
    if shift:
        shots.append(Shot(Picture(np.roll(image, shift, axis=1), kind), GRID, GRID, roll))

    def combine(looks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return looks[0] if len(looks) == 1 else merged(looks[0], looks[1], roll), np.ones(GRID.shape)

    return Plan(tuple(shots), "boxes", style, combine)


def views_plan(
    panorama: np.ndarray, style: Style, views: Sequence[PerspectiveGrid], margin: float, asked: Asked, kind: Format
) -> Plan:
    """Ask for boxes or presence in each of several views of the panorama."""
    pictures = cut(panorama, *views)
    shots = [Shot(Picture(p, kind), view, canvas_of(view)) for p, view in zip(pictures, views, strict=True)]
    return Plan(tuple(shots), asked, style, lambda looks: lift(looks, views, GRID, margin))


def view_plan(
    image: np.ndarray, grid: PerspectiveGrid, style: Style, size: tuple[int, int], asked: Asked, kind: Format
) -> Plan:
    """Ask for boxes or presence in one perspective picture; the response is on the shot's canvas instead of `GRID`."""
    framing, posed, inner = framed(image, grid, size)
    cells = canvas_of(posed)

    def combine(looks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return np.broadcast_to(looks[0], (1, *cells.shape)).astype(np.float32), filled(cells.shape, size, inner)

    return Plan((Shot(Picture(framing, kind), posed, cells),), asked, style, combine)
