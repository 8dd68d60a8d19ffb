"""Any detector for ordinary pictures, made to look all around: `Detector`.

From boxes in overlapping views it makes things on the sphere (`eagor.perception.fusion`): one detection for each,
however many views show it. A box that touches its view's border may be only a part of the thing.
"""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from PIL import Image

from eagor._checks import warn_unless_whole, within
from eagor.errors import EagorError, GridError, ImageError, QueryError
from eagor.evidence import DetectorModel, Evidence
from eagor.grids import PerspectiveGrid, tangent_views
from eagor.perception.colour import share_of
from eagor.perception.fusion import ViewBox, ViewDetections, combined
from eagor.perception.results import Names, boxes_of, names_in, numbered
from eagor.perception.vocabulary import colour_of, fitting, listed, match_class, named, same_name
from eagor.sources.panorama import checked_picture, cut
from eagor.sphere import azimuth_elevation, checked_pose, world_R_body

__all__ = ["Detector", "is_ultralytics"]

# Of a box's pixels, so many have the thing's colour at least: it fills about half of its box, and has others, too.
COLOURED = 0.25

Shown = list[tuple[PerspectiveGrid, np.ndarray]]  # pictures of one moment


class Detector:
    """A perception of any `function` that finds things in ordinary pictures: it is shown views all around a panorama.

    The views overlap, cover the sphere, and stand level with gravity where the pose is known: detectors have learnt
    upright things. Boxes of one thing in several views are one detection; all views are ONE look.

    - `function`: a picture ``(h, w, 3)`` uint8 RGB, and the query if it takes two arguments; ``boxes, scores[,
      labels]`` out: boxes ``(n, 4)`` x0, y0, x1, y1 in its pixels, scores in [0, 1]. What detectors of known libraries
      return is understood too (`eagor.perception.results.boxes_of`). Of labels, those that fit the query are kept
      (without `classes`: `eagor.perception.vocabulary.fitting`); where none ever fitted, a warning names them, once
      for each query. One with a method ``many(pictures, query)``, a list of such results, gets all views of a look at
      once.
    - `classes`: names of all that the detector knows, a list or by number (default: its own ``classes`` or ``names``,
      or those in its results, as Ultralytics has them); None: it takes any words. A detector with classes answers
      several queries with one pass. It knows no colours: where the query names one ("brown chair"), the colour weighs
      its boxes.
    - `hfov_deg`: field of each view, degrees.
    - `views`: the most views per look. They overlap as far as it allows; more views cut fewer things apart.
    - `size`: pixels along each side of a view.
    - `detector`: how it errs (default: `DetectorModel()`, with the function's own `threshold` if it has one).

    Raises `GridError` if so few views of this field cannot cover the sphere, `EagorError` for other wrong settings.

        >>> detector = eagor.Detector(lambda picture: ([[10, 10, 60, 80]], [0.9], ["chair"]))
        >>> detector(np.zeros((256, 512, 3), np.uint8), "chair", stamp=0.0)
        Evidence(t=0 s, 6 detections on PatchGrid, read by DetectorModel())
    """

    takes_pose = True

    def __init__(
        self,
        function: Callable[..., Any],
        classes: Names | None = None,
        *,
        hfov_deg: float = 110.0,
        views: int = 6,
        size: int = 512,
        detector: DetectorModel | None = None,
    ) -> None:
        if not callable(function):
            raise EagorError(f"the detector is a {type(function).__name__}; wanted a function that takes a picture")
        if is_ultralytics(function):
            raise EagorError("this is a model of Ultralytics; wanted Detector.from_ultralytics(model)")
        if not within(size, 16, 8192):
            raise EagorError(f"size = {size!r}; wanted pixels along a view's side, 16 to 8192")
        self.function, self._takes_query = function, _takes_query(function)
        self.detector = detector or DetectorModel.reporting_from(getattr(function, "threshold", None))
        own = (classes, getattr(function, "classes", None), getattr(function, "names", None))
        self._know(next((names for names in own if names is not None), None))
        self._views = _layout(int(size), float(hfov_deg), int(views))
        self._settled: set[str] = set()  # queries that a label fitted, or of which it was said that none does

    @classmethod
    def from_ultralytics(cls, model: Any, **settings: Any) -> Detector:
        """Of a model of Ultralytics; its `names` are the classes. `settings`: as of `Detector`."""
        return cls(partial(_of_ultralytics, model), **{"classes": model.names} | settings)

    @classmethod
    def from_supervision(cls, function: Callable[..., Any], **settings: Any) -> Detector:
        """Of a function whose ``Detections`` (supervision) have the names of classes in their data."""
        return cls(function, **settings)

    @classmethod
    def from_transformers(cls, pipeline: Any, **settings: Any) -> Detector:
        """Of a pipeline of Hugging Face: "object-detection", whose labels are the classes, or the zero-shot one."""
        if str(getattr(pipeline, "task", "")).startswith("zero-shot"):
            return cls(partial(_of_zero_shot, pipeline), **settings)
        return cls(partial(_of_pipeline, pipeline), **{"classes": pipeline.model.config.id2label} | settings)

    def _know(self, names: Names | None) -> None:
        """What numbers of classes are called, and so what the detector knows."""
        self._names = names
        self.classes = None if names is None else tuple(numbered(names).values())

    def __repr__(self) -> str:
        view = self._views[0]
        what = f"{len(self._views)} views of {math.degrees(view.hfov):g}°, {view.width} px"
        return f"Detector({getattr(self.function, '__name__', type(self.function).__name__)}, {what})"

    @property
    def rows(self) -> int:
        """Rows of panoramas that are as fine as the views."""
        return math.ceil(math.pi * self._views[0].focal)

    def views(self, world_R_body_now: np.ndarray | None = None) -> tuple[PerspectiveGrid, ...]:
        """Where the views look, in the body frame: level with gravity and ahead, for a body with this orientation."""
        if world_R_body_now is None:
            return self._views
        pose = checked_pose(world_R_body_now)
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
        return self._answer(panorama, query, stamp, world_R_body, None)

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """One look at an ordinary picture ``(h, w, 3)`` uint8 that `grid` describes.

        Errors as for a panorama, and `ImageError` if the picture has another size than `grid`.
        """
        if not isinstance(grid, PerspectiveGrid):
            raise ImageError(f"grid is {type(grid).__name__}; wanted eagor.PerspectiveGrid(height, width, hfov)")
        return self._answer(image, query, stamp, None, grid)

    def _answer(self, picture: np.ndarray, query: str, *more: Any) -> Evidence:
        (answer,) = self.answers(picture, (query,), *more)
        if isinstance(answer, QueryError):
            raise answer
        return answer

    def answers(
        self,
        picture: np.ndarray,
        queries: Sequence[str],
        stamp: float | None = None,
        world_R_body: np.ndarray | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> list[Evidence | QueryError]:
        """A look for each query, or its `QueryError`: of a detector with `classes` from one pass.

        `picture` is a panorama, or an ordinary one with the pixels of `grid`, which then is the only view.
        """
        pictures, seen = self._shown(picture, world_R_body, grid), None
        answers: list[Evidence | QueryError] = []
        for query in queries:
            try:
                wanted = self._wanted(query)
                if seen is None or self.classes is None:
                    seen = self._detected(pictures, query)
                    wanted = self._wanted(query)  # its results may have named its classes
                labels = {label for each in seen for label in each.boxes.labels or ()}
                fit = fitting(query, labels, wanted)
                self._name_strangers(labels, query, fit)
                evidence = combined(seen, fit, self.detector, stamp, partial(self._weighed, pictures, query))
                if self.classes is not None:
                    evidence = named(evidence, query, match_class(query, self.classes, described=True))
                answers.append(evidence)
            except QueryError as error:
                answers.append(error)
        return answers

    def detect(
        self,
        picture: np.ndarray,
        world_R_body: np.ndarray | None = None,
        query: str = "",
        grid: PerspectiveGrid | None = None,
    ) -> list[ViewDetections]:
        """All that the detector finds in each view of a look; one without `classes` is asked for `query`.

        `eagor.perception.fusion.combined` makes of it what `answers` makes of the same picture. Errors as there.
        """
        return self._detected(self._shown(picture, world_R_body, grid), query)

    def _shown(self, picture: np.ndarray, pose: np.ndarray | None, grid: PerspectiveGrid | None) -> Shown:
        """What the detector is shown: the views of a panorama, or the ordinary picture of a `grid`."""
        picture = checked_picture(picture, "the panorama" if grid is None else "the picture", grid)
        if grid is not None:
            return [(grid, picture)]
        warn_unless_whole(picture)
        grids = self.views(pose)
        return list(zip(grids, cut(picture, *grids), strict=True))

    def _detected(self, pictures: Shown, query: str) -> list[ViewDetections]:
        """What the detector finds in each picture: in all of them at once, if it has a method `many`."""
        images, many = [image for _, image in pictures], getattr(self.function, "many", None)
        more = (query,) if self._takes_query else ()
        results = [self.function(each, *more) for each in images] if many is None else many(images, query)
        if self.classes is None:
            self._know(next(filter(None, map(names_in, results)), None))
        return [ViewDetections(view, boxes_of(each, self._names))
                for (view, _), each in zip(pictures, results, strict=True)]  # fmt: skip

    def _wanted(self, query: str) -> tuple[str, ...] | None:
        if not isinstance(query, str) or not query.strip():
            raise QueryError(f"the query is {query!r}; wanted words, such as 'chair'")
        return None if self.classes is None else match_class(query, self.classes, coloured=True)

    def _weighed(self, pictures: Shown, query: str, pieces: Sequence[ViewBox]) -> Sequence[ViewBox]:
        """The boxes, with lower scores where they show little of the colour that the query names."""
        colour = None if self.classes is None else colour_of(query, self.classes)
        if colour is None:
            return pieces
        weighed = []
        for piece in pieces:
            (x0, y0), (x1, y1) = np.floor(piece.box[:2]).astype(int), np.ceil(piece.box[2:]).astype(int)
            share = share_of(colour, pictures[piece.view][1][y0:y1, x0:x1])
            if share > 0:
                weighed.append(replace(piece, score=piece.score * min(1.0, share / COLOURED)))
        return weighed

    def _name_strangers(self, labels: set[str], query: str, fit: Collection[str]) -> None:
        """Warn, once for each query, of labels that say nothing of it: nobody looked in vain."""
        strangers = {label for label in labels if not same_name(label, self.classes or ())}
        vain = bool(strangers) and query not in self._settled and not (fit and self.classes is None)
        if vain or fit:
            self._settled.add(query)
        if vain:
            what = f"none fits {query!r}" if self.classes is None else "none of its classes is called so"
            text = f"the detector says {listed(strangers)}; {what}. If these are its own words, name them: "
            warnings.warn(f"{text}Detector(..., classes=[...])", UserWarning, stacklevel=5)


@lru_cache(maxsize=16)
def _layout(size: int, hfov: float, count: int) -> tuple[PerspectiveGrid, ...]:
    """At most `count` views of `hfov` degrees that cover the sphere and overlap as far as they can."""
    fewest: tuple[PerspectiveGrid, ...] = ()
    for overlap in range(min(60, math.floor(hfov) - 31), -1, -5):
        fewest = tangent_views(size, math.radians(hfov), math.radians(overlap))
        if len(fewest) <= count:
            return fewest
    if not fewest:
        raise GridError(f"hfov_deg = {hfov:g}; wanted degrees from 35 to 150")
    raise GridError(
        f"views = {count}: {len(fewest)} views of {hfov:g} degrees cover the sphere; allow so many, or widen them"
    )


def _takes_query(function: Callable[..., Any]) -> bool:
    """Whether a function wants the query beside the picture."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # built in: nothing tells
        return True
    wanted = [each for each in parameters if each.kind in (each.POSITIONAL_ONLY, each.POSITIONAL_OR_KEYWORD)]
    needed = [each for each in wanted if each.default is each.empty]
    several = any(each.kind is each.VAR_POSITIONAL for each in parameters)
    return several or len(needed) > 1 or any(each.name == "query" for each in wanted)


# --- models of known libraries ----------------------------------------------------------------------------------------


def is_ultralytics(model: Any) -> bool:
    """Whether it is a model of Ultralytics, whose call takes a source of pictures in another order of colours."""
    return hasattr(model, "names") and hasattr(model, "predict")


def _of_ultralytics(model: Any, picture: np.ndarray) -> Any:
    return model.predict(np.ascontiguousarray(picture[..., ::-1]), verbose=False)  # it takes BGR


def _of_pipeline(pipeline: Any, picture: np.ndarray) -> Any:
    return pipeline(Image.fromarray(picture))


def _of_zero_shot(pipeline: Any, picture: np.ndarray, query: str) -> Any:
    return pipeline(Image.fromarray(picture), candidate_labels=[query])
