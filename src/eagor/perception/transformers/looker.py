"""The interface between a perception and a loaded model, with its cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from eagor.grids import Grid
from eagor.perception.vlm.boxes import Box
from eagor.perception.vlm.families import Extractor, Family


@dataclass
class Account:
    """Running totals of images, image tokens, and tokens of questions and answers."""

    images: int = 0
    image_tokens: int = 0
    prompt_tokens: int = 0
    answer_tokens: int = 0

    def as_source(self) -> dict[str, int]:
        """As entries of `Evidence.source`."""
        return dict(vars(self))


class Looker(Protocol):
    """A loaded model that answers for images of one size; see `language.LanguageModel`."""

    name: str
    revision: str
    family: Family

    def size(self, aspect: float) -> tuple[int, int]:
        """(height, width) to resize images of this aspect ratio (width over height) to."""
        ...

    def cells(self, aspect: float, extractor: Extractor) -> tuple[int, int]:
        """Rows and columns of the response."""
        ...

    def look(
        self, images: Sequence[np.ndarray], grids: Sequence[Grid], queries: Sequence[str], extractor: Extractor
    ) -> tuple[np.ndarray, Account]:
        """Responses ``(B, Q, h, w)`` float32 in [0, 1] on `grids`, the cells of each image."""
        ...

    def boxes(self, images: Sequence[np.ndarray], queries: Sequence[str]) -> tuple[list[list[list[Box]]], Account]:
        """Boxes per image and query."""
        ...
