"""Boxes in what a model wrote: lenient reading of JSON, of lists in prose, and of the markup of some families."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from eagor.errors import AnswerError

__all__ = ["AnswerError", "Box", "Frame", "Order", "Token", "parse_boxes"]

Frame = Literal["pixels", "thousand", "unit"]  # pixels of the image that the model saw; 0..1000 of its sides; 0..1
Order = Literal["xyxy", "yxyx"]
Token = tuple[str, float]  # a piece of the answer and the natural logarithm of its probability


@dataclass(frozen=True)
class Box:
    """A detection in fractions of the image's width and height, [0, 1], with x0 < x1 and y0 < y1; y grows down."""

    x0: float
    y0: float
    x1: float
    y1: float
    label: str = ""
    score: float = 1.0


def parse_boxes(
    text: str,
    frame: Frame,
    size: tuple[int, int],
    order: Order = "xyxy",
    tokens: Sequence[Token] | None = None,
) -> list[Box]:
    """The boxes in an answer; [] where it says that there is none. Raises `AnswerError` if nothing can be read."""
    raise NotImplementedError
