"""What a perception asks of a loaded model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from eagor.grids import Grid
from eagor.perception.vlm.boxes import Box
from eagor.perception.vlm.families import Extractor, Family


class Looker(Protocol):
    """A loaded model that answers for images of one size; see `language.LanguageModel`."""

    name: str
    revision: str
    family: Family

    def size(self, aspect: float) -> tuple[int, int]: ...

    def cells(self, aspect: float, extractor: Extractor) -> tuple[int, int]: ...

    def look(
        self, images: Sequence[np.ndarray], grids: Sequence[Grid], queries: Sequence[str], extractor: Extractor
    ) -> tuple[np.ndarray, Any]: ...

    def boxes(self, images: Sequence[np.ndarray], queries: Sequence[str]) -> tuple[list[list[list[Box]]], Any]: ...
