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
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._checks import require
from eagor._extras import need
from eagor.errors import ImageError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.grids import PatchGrid
from eagor.perception.onnx.network import session
from eagor.perception.words import named
from eagor.queries import parse_query

if TYPE_CHECKING:
    from scipy.sparse import csr_array

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

    calibration: Calibration = CALIBRATION

    def __post_init__(self) -> None:
        need("the scout", "sim", "onnxruntime")
        require(self, {"calibration": (isinstance(self.calibration, Calibration), "an eagor.Calibration; no text")})

    @property
    def rows(self) -> int:
        """Rows of the panoramas that it works on; others are resized."""
        return ROWS

    @property
    def grid(self) -> PatchGrid:
        """The cells of the response: 4.5 degrees each way."""
        return PatchGrid(ROWS // STRIDE, 2 * ROWS // STRIDE)

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
        image = np.asarray(panorama)
        height = image.shape[0] if image.ndim == 3 else 0
        if image.dtype != np.uint8 or height == 0 or image.shape != (height, 2 * height, 3):
            raise ImageError(
                f"the panorama is {image.dtype} of shape {image.shape}; the scout wants uint8 sRGB (H, 2 H, 3). Files: "
                "eagor.media.panorama.read_panorama"
            )
        if not words:
            return np.zeros((0, *self.grid.shape), dtype=np.float32)
        feed = {"image": resized(image, ROWS)[None], "words": np.array(words, dtype=np.int64)}
        return np.clip(_session().run(["response"], feed)[0], 0.0, 1.0)


@lru_cache(maxsize=1)
def _vocabulary() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The categories and the colours, in the order of the network's outputs."""
    stored = json.loads((FOLDER / "vocabulary.json").read_text(encoding="utf-8"))
    return tuple(stored["categories"]), tuple(stored["colours"])


@lru_cache(maxsize=1)
def _session() -> Any:
    return session(FOLDER / "scout.onnx")


def resized(image: np.ndarray, rows: int) -> np.ndarray:
    """`image` ``(H, 2 H, 3)`` uint8 as ``(rows, 2 rows, 3)`` uint8.

    Whole blocks are averaged if `rows` divides H. Otherwise a triangle filter is used, two pixels of the coarser image
    wide; it wraps around the seam and stops at the poles.
    """
    height = image.shape[0]
    if height == rows:
        return image
    if height % rows == 0:
        times = height // rows
        # Columns first would access memory with strides.
        sums = image.reshape(rows, times, 2 * height, 3).sum(axis=1, dtype=np.uint32)
        sums = sums.reshape(rows, 2 * rows, times, 3).sum(axis=2)
        return ((sums + times * times // 2) // (times * times)).astype(np.uint8)
    down = triangles(height, rows, False) @ image.reshape(height, -1).astype(np.float32)
    across = down.reshape(rows, 2 * height, 3).transpose(1, 0, 2).reshape(2 * height, -1)
    found = (triangles(2 * height, 2 * rows, True) @ across).reshape(2 * rows, rows, 3).transpose(1, 0, 2)
    return np.clip(np.rint(found), 0, 255).astype(np.uint8)


@lru_cache(maxsize=8)
def triangles(before: int, after: int, circular: bool) -> csr_array:
    """Weights ``(after, before)`` of the triangle filter; rows sum to 1."""
    from scipy.sparse import csr_array

    scale = before / after
    reach = max(scale, 1.0)
    centre = (np.arange(after) + 0.5) * scale - 0.5
    offset = np.arange(-int(np.ceil(reach)), int(np.ceil(reach)) + 2)
    place = np.floor(centre).astype(int)[:, None] + offset
    weight = np.maximum(1 - np.abs(place - centre[:, None]) / reach, 0)
    place = place % before if circular else np.clip(place, 0, before - 1)
    weight /= weight.sum(axis=1, keepdims=True)
    row = np.repeat(np.arange(after), len(offset))
    return csr_array((weight.ravel().astype(np.float32), (row, place.ravel())), shape=(after, before))
