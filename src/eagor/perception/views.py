"""Any detector for ordinary pictures, made to look all around: `Views`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._checks import within
from eagor.errors import EagorError, GridError, QueryError
from eagor.evidence import DetectorModel, Evidence, View
from eagor.evidence.shapes import WHOLE_SPHERE
from eagor.grids import PerspectiveGrid
from eagor.media.cutting import cut, tangent_views
from eagor.media.panorama import checked_picture
from eagor.perception.adapters import Boxes, boxes_of
from eagor.perception.blobs import spread_evidence
from eagor.perception.pieces import Piece, Thing, things
from eagor.perception.words import meant
from eagor.sphere import azimuth_elevation, check_rotation, world_R_body

__all__ = ["Detect", "Views"]

Detect = Callable[[np.ndarray, str], Any]


class Views:
    """A perception that cuts a panorama into ordinary pictures and shows each to `detect`.

    The views overlap, cover the whole sphere, poles included, and stand level with gravity where the pose is known:
    detectors have learnt upright things. Boxes of one thing in several views are one detection; all views are ONE look.

    - `detect`: ``detect(picture, query) -> boxes, scores[, labels]`` for a picture ``(h, w, 3)`` uint8 RGB: boxes
      ``(n, 4)`` x0, y0, x1, y1 in its pixels, scores in [0, 1]. What detectors of known libraries return is understood
      too (`eagor.perception.adapters.boxes_of`). Where there are labels, those that the query means are kept.
    - `hfov`: field of each view, degrees.
    - `count`: the most views per look. They overlap as far as it allows; more views cut fewer things apart.
    - `size`: pixels along each side of a view.
    - `detector`: how the detector errs (default: `DetectorModel()`).
    - `classes`: names of all that the detector knows (default: its own ``classes``); None: it takes any words.

    Raises `GridError` if so few views of this field cannot cover the sphere, `EagorError` for other wrong settings.
    """

    takes_pose = True

    def __init__(
        self,
        detect: Detect,
        *,
        hfov: float = 110.0,
        count: int = 6,
        size: int = 512,
        detector: DetectorModel | None = None,
        classes: Sequence[str] | None = None,
    ) -> None:
        if not callable(detect):
            raise EagorError(f"detect is a {type(detect).__name__}; wanted a function detect(picture, query)")
        if not within(size, 16, 8192):
            raise EagorError(f"size = {size!r}; wanted pixels along a view's side, 16 to 8192")
        self.detect, self.detector = detect, detector or DetectorModel()
        known = getattr(detect, "classes", None) if classes is None else classes
        self.classes = None if known is None else tuple(known)
        self._views = _layout(int(size), float(hfov), int(count))

    def __repr__(self) -> str:
        view = self._views[0]
        what = f"{len(self._views)} views of {math.degrees(view.hfov):g}°, {view.width} px"
        return f"Views({getattr(self.detect, '__name__', type(self.detect).__name__)}, {what})"

    @property
    def rows(self) -> int:
        """Rows of panoramas that are as fine as the views."""
        return math.ceil(math.pi * self._views[0].focal)

    def views(self, world_R_body_now: np.ndarray | None = None) -> tuple[PerspectiveGrid, ...]:
        """Where the views look, in the body frame: level with gravity and ahead, for a body with this orientation."""
        if world_R_body_now is None:
            return self._views
        pose = check_rotation(np.asarray(world_R_body_now, dtype=np.float64), "world_R_body")
        # Ahead of the body; where it looks straight up or down, its left side tells the heading.
        ahead = pose[:, 0] if np.hypot(*pose[:2, 0]) > 0.1 else np.cross(pose[:, 1], [0.0, 0.0, 1.0])
        level = pose.T @ world_R_body(float(azimuth_elevation(ahead)[0]))
        return tuple(replace(view, body_R_view=level @ view.body_R_view) for view in self._views)

    def __call__(
        self, panorama: np.ndarray, query: str, *, stamp: float | None = None, world_R_body: np.ndarray | None = None
    ) -> Evidence:
        """One look all around for what `query` names; `world_R_body` ``(3, 3)``: the pose at capture, if known.

        Raises `QueryError` if the words mean nothing to the detector, `ImageError` if the panorama is none, and
        `EagorError` if the detector returns something else than boxes.
        """
        return self.looks(panorama, (query,), stamp=stamp, world_R_body=world_R_body)[0]

    def looks(
        self,
        panorama: np.ndarray,
        queries: Sequence[str],
        *,
        stamp: float | None = None,
        world_R_body: np.ndarray | None = None,
    ) -> tuple[Evidence, ...]:
        """One look for each of several queries; a detector with `classes` sees each view once for all of them."""
        found = self.things(panorama, queries, world_R_body)
        return tuple(spread_evidence(each, self.detector, View(WHOLE_SPHERE), stamp) for each in found)

    def things(
        self, panorama: np.ndarray, queries: Sequence[str], world_R_body: np.ndarray | None = None
    ) -> list[list[Thing]]:
        """What the detector sees of each query, before any reading: one `Thing` each, the surest first."""
        wanted = [self._wanted(query) for query in queries]
        panorama = checked_picture(panorama)
        grids = self.views(world_R_body)
        found: list[list[Piece]] = [[] for _ in queries]
        for number, (grid, picture) in enumerate(zip(grids, cut(panorama, *grids), strict=True)):
            seen = None
            for query, words, pieces in zip(queries, wanted, found, strict=True):
                if seen is None or self.classes is None:
                    seen = boxes_of(self.detect(picture, query), self.classes)
                pieces += _pieces(number, grid, seen, query, words)
        return [things(pieces) for pieces in found]

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """One look at an ordinary picture ``(h, w, 3)`` uint8 that `grid` describes."""
        wanted, image = self._wanted(query), checked_picture(image, "the picture")
        pieces = list(_pieces(0, grid, boxes_of(self.detect(image, query), self.classes), query, wanted))
        return spread_evidence(things(pieces), self.detector, View(grid), stamp)

    def _wanted(self, query: str) -> tuple[str, ...] | None:
        if not isinstance(query, str) or not query.strip():
            raise QueryError(f"the query is {query!r}; wanted words, such as 'chair'")
        return None if self.classes is None else meant(query, self.classes)


def _pieces(
    number: int, grid: PerspectiveGrid, seen: Boxes, query: str, wanted: tuple[str, ...] | None
) -> Iterator[Piece]:
    """The boxes of view `number` that the query means."""
    boxes, scores, labels = seen
    size = np.array([grid.width, grid.height] * 2, dtype=np.float64)
    for box, score, label in zip(boxes, scores, labels or [None] * len(boxes), strict=True):
        if label is not None and not _fits(label, query, wanted):
            continue
        inside = np.clip(box, 0, size)
        if (inside[2:] - inside[:2] > 1e-6 * size[:2]).all():
            yield Piece(number, grid, inside, float(score))


def _fits(label: str, query: str, wanted: tuple[str, ...] | None) -> bool:
    """Whether a label is one of the `wanted` classes; of an open vocabulary, whether the query means it."""
    if wanted is not None:
        return label in wanted
    try:
        return label in meant(query, (label,))
    except QueryError:
        return False


@lru_cache(maxsize=16)
def _layout(size: int, hfov: float, count: int) -> tuple[PerspectiveGrid, ...]:
    """At most `count` views of `hfov` degrees that cover the sphere and overlap as far as they can."""
    fewest: tuple[PerspectiveGrid, ...] = ()
    for overlap in range(min(60, math.floor(hfov) - 31), -1, -5):
        fewest = tangent_views(size, math.radians(hfov), math.radians(overlap))
        if len(fewest) <= count:
            return fewest
    if not fewest:
        raise GridError(f"hfov = {hfov:g}; wanted degrees from 35 to 150")
    raise GridError(
        f"count = {count}: {len(fewest)} views of {hfov:g} degrees cover the sphere; allow so many, or widen them"
    )
