"""The embedded perception: a small network that finds things in the built-in apartments, on the CPU.

It lets you try everything at once, without a download or a GPU. It was trained on renderings of the built-in world
only: it fails on photographs and guesses on imported scenes. For the real world use a vision-language model.

The weights (``scout.onnx``) and the words (``vocabulary.json``) lie next to this file; ``training/scout`` of the
repository made them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import require
from eagor._extras import need
from eagor.errors import ImageError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.grids import PatchGrid
from eagor.perception.onnx import session
from eagor.perception.words import named
from eagor.queries import parse_query
from eagor.sources.panorama import by_area, checked_picture, resized

__all__ = ["CALIBRATION", "ScoutPerception"]

FOLDER = Path(__file__).parent
ROWS = 160  # of the network's input
STRIDE = 4  # input pixels per cell of the response
# From `eagor calibrate` and comparison on development apartments (docs/results.md), with default `TrackerConfig`.
CALIBRATION = Calibration(floor=0.279, neutral=0.0236, temperature=6.0, persistence=0.776, spread=0.061)
COARSEST = 16  # rolling the input by a multiple of this many pixels rolls the response


@dataclass(frozen=True)
class ScoutPerception:
    """Finds "[colour] category" in panoramas of the built-in apartments; it fails on photographs.

    The response of a cell is the network's heat there times its probability that the thing is in view at all. It peaks
    at the centre of a thing and is low everywhere if the thing is not in view.

    Attributes:
        calibration: how responses become evidence (default: fitted on development apartments).

    Raises `EagorError` for any other type of calibration, such as text after ``scout:``; `MissingExtraError` without
    onnxruntime, which the extra ``sim`` brings.
    """

    rows = ROWS  # of the panoramas that it works on; others are resized
    grid = PatchGrid(ROWS // STRIDE, 2 * ROWS // STRIDE)  # the cells of the response: 4.5 degrees each way
    calibration: Calibration = CALIBRATION

    def __post_init__(self) -> None:
        need("the scout", "sim", "onnxruntime")
        require(self, {"calibration": (isinstance(self.calibration, Calibration), "an eagor.Calibration; no text")})

    @property
    def categories(self) -> tuple[str, ...]:
        """The categories that it knows (`eagor.queries` maps other words to some of them)."""
        return _vocabulary()[0]

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for the thing that `query` names in `panorama` ``(H, 2 H, 3)``, uint8 sRGB.

        Raises `QueryError`, which lists the known words, for other words; `ImageError` for any other array.
        """
        response = self.respond(panorama, [query])[0]
        meant = parse_query(query, self.categories).category
        return named(Evidence.from_response(response, self.grid, self.calibration, stamp), query, (meant,))

    def respond(self, panorama: np.ndarray, queries: Sequence[str]) -> np.ndarray:
        """Responses ``(Q, h, w)`` float32 in [0, 1] to several queries, from one pass. Errors as for a call."""
        categories, colours = _vocabulary()
        asked = [parse_query(query, categories) for query in queries]
        words = [[categories.index(q.category), colours.index(q.colour) if q.colour else len(colours)] for q in asked]
        image = checked_picture(panorama)
        if image.shape[1] != 2 * image.shape[0]:
            raise ImageError(f"the panorama has shape {image.shape}; the scout wants uint8 sRGB (H, 2 H, 3)")
        size = (ROWS, 2 * ROWS)
        image = by_area(image, *size) if len(image) >= ROWS else resized(image, size, wrap=True)
        feed = {"image": image[None], "words": np.array(words, dtype=np.int64)}
        return np.clip(_session().run(["response"], feed)[0], 0.0, 1.0)


@lru_cache(maxsize=1)
def _vocabulary() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The categories and the colours, in the order of the network's outputs."""
    stored = json.loads((FOLDER / "vocabulary.json").read_text(encoding="utf-8"))
    return tuple(stored["categories"]), tuple(stored["colours"])


@lru_cache(maxsize=1)
def _session() -> Any:
    return session(FOLDER / "scout.onnx")
