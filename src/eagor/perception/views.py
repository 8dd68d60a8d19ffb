"""Any detector for ordinary pictures, made to look all around: `Views`.

From boxes in overlapping views it makes things on the sphere (`eagor.perception.things`): one detection for each,
however many views show it. A box that touches its view's border may be only a part of the thing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from eagor._checks import warn_unless_whole, within
from eagor.errors import EagorError, GridError, QueryError
from eagor.evidence import DetectorModel, Evidence, View
from eagor.evidence.shapes import WHOLE_SPHERE
from eagor.grids import PerspectiveGrid
from eagor.media.cutting import cut, tangent_views
from eagor.media.panorama import checked_picture
from eagor.perception.adapters import Boxes, boxes_of
from eagor.perception.colour import colour_in, share_of
from eagor.perception.things import Thing, ViewBox, spread_evidence, things
from eagor.perception.words import meant
from eagor.sphere import azimuth_elevation, check_rotation, world_R_body

__all__ = ["Detect", "Seen", "Views"]

# Of a box's pixels, so many have the thing's colour at least: it fills about half of its box, and has others, too.
COLOURED = 0.25

Detect = Callable[[np.ndarray, str], Any]


class Seen(NamedTuple):
    """What a detector found in one view, before a query chooses: the view, and boxes in its pixels."""

    grid: PerspectiveGrid
    boxes: Boxes


class Views:
    """A perception that cuts a panorama into ordinary pictures and shows each to `detect`.

    The views overlap, cover the whole sphere, poles included, and stand level with gravity where the pose is known:
    detectors have learnt upright things. Boxes of one thing in several views are one detection; all views are ONE look.

    - `detect`: ``detect(picture, query) -> boxes, scores[, labels]`` for a picture ``(h, w, 3)`` uint8 RGB: boxes
      ``(n, 4)`` x0, y0, x1, y1 in its pixels, scores in [0, 1]. What detectors of known libraries return is understood
      too (`eagor.perception.adapters.boxes_of`). Where there are labels, those that the query means are kept. One with
      a method ``many(pictures, query)``, a list of such results, gets all views of a look at once.
    - `hfov`: field of each view, degrees.
    - `count`: the most views per look. They overlap as far as it allows; more views cut fewer things apart.
    - `size`: pixels along each side of a view.
    - `detector`: how the detector errs (default: `DetectorModel()`).
    - `classes`: names of all that the detector knows (default: its own ``classes``); None: it takes any words. A
      detector with classes knows no colours: where the query names one ("brown chair"), the colour weighs its boxes.

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
        panorama, grids = checked_picture(panorama), self.views(world_R_body)
        warn_unless_whole(panorama)
        return self.things_in(tuple(zip(grids, cut(panorama, *grids), strict=True)), queries)

    def things_in(
        self, pictures: Sequence[tuple[PerspectiveGrid, np.ndarray]], queries: Sequence[str]
    ) -> list[list[Thing]]:
        """As `things`, in ordinary pictures ``(h, w, 3)`` uint8 of one moment, each with its grid."""
        wanted = [self._wanted(query) for query in queries]
        found: list[list[ViewBox]] = [[] for _ in queries]
        seen = None
        for query, words, pieces in zip(queries, wanted, found, strict=True):
            if seen is None or self.classes is None:
                seen = self._detected([picture for _, picture in pictures], query)
            for number, ((grid, picture), boxes) in enumerate(zip(pictures, seen, strict=True)):
                pieces += self._weighed(_pieces(number, grid, boxes, query, words), picture, query)
        return [things(pieces) for pieces in found]

    def _detected(self, pictures: Sequence[np.ndarray], query: str) -> list[Boxes]:
        """What the detector finds in each picture: in all of them at once, if it has a method `many`."""
        many = getattr(self.detect, "many", None)
        found = [self.detect(each, query) for each in pictures] if many is None else many(pictures, query)
        return [boxes_of(each, self.classes) for each in found]

    def seen(
        self,
        picture: np.ndarray,
        world_R_body: np.ndarray | None = None,
        query: str = "",
        grid: PerspectiveGrid | None = None,
    ) -> list[Seen]:
        """All that the detector finds in each view of a look; one without `classes` is asked for `query`.

        `picture` is a panorama, or an ordinary one with the pixels of `grid`: then that is the only view. `combined`
        makes of it what a call, or `view`, makes. Errors as there.
        """
        picture = checked_picture(picture, "the panorama" if grid is None else "the picture")
        grids = self.views(world_R_body) if grid is None else (grid,)
        if grid is None:
            warn_unless_whole(picture)
        found = self._detected(cut(picture, *grids) if grid is None else [picture], query)
        return [Seen(view, boxes) for view, boxes in zip(grids, found, strict=True)]

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """One look at an ordinary picture ``(h, w, 3)`` uint8 that `grid` describes."""
        (found,) = self.things_in([(grid, checked_picture(image, "the picture"))], (query,))
        return spread_evidence(found, self.detector, View(grid), stamp)

    def _weighed(self, pieces: Iterable[ViewBox], picture: np.ndarray, query: str) -> Iterator[ViewBox]:
        """The boxes of a picture, with lower scores where they show little of the colour that the query names."""
        # An orange is a thing, whatever its colour.
        colour = None if self.classes is None or query in self.classes else colour_in(query)
        for piece in pieces:
            if colour is None:
                yield piece
                continue
            (x0, y0), (x1, y1) = np.floor(piece.box[:2]).astype(int), np.ceil(piece.box[2:]).astype(int)
            share = share_of(colour, picture[y0:y1, x0:x1])
            if share > 0:
                yield replace(piece, score=piece.score * min(1.0, share / COLOURED))

    def _wanted(self, query: str) -> tuple[str, ...] | None:
        if not isinstance(query, str) or not query.strip():
            raise QueryError(f"the query is {query!r}; wanted words, such as 'chair'")
        return None if self.classes is None else meant(query, self.classes, coloured=True)


def combined(
    seen: Sequence[Seen],
    query: str,
    wanted: Sequence[str] | None = None,
    detector: DetectorModel | None = None,
    stamp: float | None = None,
) -> Evidence:
    """The evidence of a look from what was `seen` in its views: one view, or several that cover the whole sphere.

    `wanted`: the classes that `query` means; None: the query itself decides about labels, of an open vocabulary.
    """
    pieces = [piece for number, each in enumerate(seen) for piece in _pieces(number, *each, query, wanted)]
    view = View(seen[0].grid if len(seen) == 1 else WHOLE_SPHERE)
    return spread_evidence(things(pieces), detector or DetectorModel(), view, stamp)


def _pieces(
    number: int, grid: PerspectiveGrid, seen: Boxes, query: str, wanted: Sequence[str] | None
) -> Iterator[ViewBox]:
    """The boxes of view `number` that the query means."""
    boxes, scores, labels = seen
    size = np.array([grid.width, grid.height] * 2, dtype=np.float64)
    for box, score, label in zip(boxes, scores, labels or [None] * len(boxes), strict=True):
        if label is not None and not _fits(label, query, wanted):
            continue
        inside = np.clip(box, 0, size)
        if (inside[2:] - inside[:2] > 1e-6 * size[:2]).all():
            yield ViewBox(number, grid, inside, float(score))


def _fits(label: str, query: str, wanted: Sequence[str] | None) -> bool:
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
