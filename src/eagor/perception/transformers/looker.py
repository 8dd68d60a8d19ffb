"""What a perception asks of a loaded model, and what that cost."""

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
    """Images, image tokens, and tokens of questions and answers that went through a model, added up."""

    images: int = 0
    image_tokens: int = 0
    prompt_tokens: int = 0
    answer_tokens: int = 0

    def as_source(self) -> dict[str, int]:
        """As it stands in `Evidence.source`."""
        return dict(vars(self))


class Looker(Protocol):
    """A loaded model that answers for images of one size; see `language.LanguageModel`."""

    name: str
    revision: str
    family: Family

    def size(self, aspect: float) -> tuple[int, int]:
        """(height, width) that images of this aspect (width over height) are resized to before they are looked at."""
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
