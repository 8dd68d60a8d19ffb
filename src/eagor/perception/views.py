"""Any detector for ordinary pictures, made to look all around: `Detector`.

From boxes in overlapping views it makes things on the sphere (`eagor.perception.things`): one detection for each,
however many views show it. A box that touches its view's border may be only a part of the thing.

`boxes_of` reads what detectors return: supervision's ``Detections``, Ultralytics' results, dictionaries as of
torchvision and of Hugging Face's post-processing (tensors too), MediaPipe's results, the blob of an SSD in OpenCV,
lists of dictionaries as in COCO's results and in pipelines, and plain arrays. It knows them by their attributes, so
that no library is imported. Whatever it is, it is checked.
"""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from PIL import Image

from eagor._arrays import to_numpy
from eagor._checks import shown, warn_unless_whole, within
from eagor.errors import EagorError, GridError, ImageError, QueryError, ResponseError
from eagor.evidence import DetectorModel, Evidence, View
from eagor.evidence.shapes import WHOLE_SPHERE, are_fractions
from eagor.grids import PerspectiveGrid, tangent_views
from eagor.media.panorama import checked_picture, cut
from eagor.perception.colour import share_of
from eagor.perception.things import Boxes, Seen, Thing, ViewBox, labels_of, pieces_of, spread_evidence, things
from eagor.perception.words import colour_of, fitting, meant, named, same_name
from eagor.sphere import azimuth_elevation, checked_pose, world_R_body

__all__ = ["Detector", "boxes_of", "is_ultralytics"]

MOST_LABELS = 8  # in a warning
# Of a box's pixels, so many have the thing's colour at least: it fills about half of its box, and has others, too.
COLOURED = 0.25

Shown = list[tuple[PerspectiveGrid, np.ndarray]]  # pictures of one moment


class Detector:
    """A perception of any `function` that finds things in ordinary pictures: it is shown views all around a panorama.

    The views overlap, cover the whole sphere, poles included, and stand level with gravity where the pose is known:
    detectors have learnt upright things. Boxes of one thing in several views are one detection; all views are ONE look.

    - `function`: a picture ``(h, w, 3)`` uint8 RGB, and the query if it takes two arguments; ``boxes, scores[,
      labels]`` out: boxes ``(n, 4)`` x0, y0, x1, y1 in its pixels, scores in [0, 1]. What detectors of known libraries
      return is understood too (`eagor.perception.views.boxes_of`). Of labels, those that fit the query are kept
      (without `classes`: `eagor.perception.words.fitting`); where none ever fitted, a warning names them, once for each
      query. One with a method ``many(pictures, query)``, a list of such results, gets all views of a look at once.
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
        own = getattr(function, "classes", None)
        known = classes if classes is not None else own if own is not None else getattr(function, "names", None)
        self._know(known)
        self._views = _layout(int(size), float(hfov_deg), int(views))
        self._settled: set[str] = set()  # queries that a label fitted, or of which it was said that none does

    @classmethod
    def from_ultralytics(cls, model: Any, **settings: Any) -> Detector:
        """Of a model of Ultralytics; its `names` are the classes. `settings`: as of `Detector`."""
        settings.setdefault("classes", model.names)
        return cls(partial(_of_ultralytics, model), **settings)

    @classmethod
    def from_supervision(cls, function: Callable[..., Any], **settings: Any) -> Detector:
        """Of a function whose ``Detections`` (supervision) have the names of classes in their data."""
        return cls(function, **settings)

    @classmethod
    def from_transformers(cls, pipeline: Any, **settings: Any) -> Detector:
        """Of a pipeline of Hugging Face: "object-detection", whose labels are the classes, or the zero-shot one."""
        if str(getattr(pipeline, "task", "")).startswith("zero-shot"):
            return cls(partial(_of_zero_shot, pipeline), **settings)
        settings.setdefault("classes", pipeline.model.config.id2label)
        return cls(partial(_of_pipeline, pipeline), **settings)

    def _know(self, names: Names | None) -> None:
        """What numbers of classes are called, and so what the detector knows."""
        self._names = names
        self.classes = None if names is None else tuple(names.values() if isinstance(names, Mapping) else names)

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
        (found,) = self.things(panorama, (query,), world_R_body)
        return self._evidence(found, query, View(WHOLE_SPHERE), stamp)

    def things(
        self,
        picture: np.ndarray,
        queries: Sequence[str],
        world_R_body: np.ndarray | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> list[list[Thing]]:
        """What the detector sees of each query, before any reading: one `Thing` each, the surest first; as `seen`."""
        for query in queries:
            self._wanted(query)
        shown, found, seen = self._shown(picture, world_R_body, grid), [], None
        for query in queries:
            if seen is None or self.classes is None:
                seen = self._detected(shown, query)
            found.append(self._meant(shown, seen, query, self._wanted(query)))  # now its results may name its classes
        return found

    def answers(
        self,
        picture: np.ndarray,
        queries: Sequence[str],
        stamp: float | None = None,
        world_R_body: np.ndarray | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> list[Evidence | QueryError]:
        """From one pass of a detector with `classes`: a look for each query, or its `QueryError`."""
        shown, view = self._shown(picture, world_R_body, grid), View(WHOLE_SPHERE if grid is None else grid)
        seen = self._detected(shown, queries[0] if queries else "")

        def answer(query: str) -> Evidence | QueryError:
            try:
                things = self._meant(shown, seen, query, self._wanted(query))
            except QueryError as error:
                return error
            return self._evidence(things, query, view, stamp)

        return [*map(answer, queries)]

    def _shown(self, picture: np.ndarray, pose: np.ndarray | None, grid: PerspectiveGrid | None) -> Shown:
        """What the detector is shown: the views of a panorama, or the ordinary picture of a `grid`."""
        picture = checked_picture(picture, "the panorama" if grid is None else "the picture", grid)
        if grid is not None:
            return [(grid, picture)]
        warn_unless_whole(picture)
        grids = self.views(pose)
        return list(zip(grids, cut(picture, *grids), strict=True))

    def _meant(self, shown: Shown, seen: Sequence[Boxes], query: str, wanted: Sequence[str] | None) -> list[Thing]:
        """What was `seen` in what was `shown` that `query` means, one `Thing` each."""
        pieces: list[ViewBox] = []
        fit = fitting(query, labels_of(seen), wanted)
        self._name_strangers(seen, query, fit)
        for number, ((grid, picture), boxes) in enumerate(zip(shown, seen, strict=True)):
            pieces += self._weighed(pieces_of(number, grid, boxes, fit), picture, query)
        return things(pieces)

    def _name_strangers(self, seen: Sequence[Boxes], query: str, fit: Collection[str]) -> None:
        """Warn, once for each query, of labels that say nothing of it: nobody looked in vain."""
        strangers = {label for label in labels_of(seen) if not same_name(label, self.classes or ())}
        if not strangers or query in self._settled or (fit and self.classes is None):
            self._settled.update([query] if fit else [])
            return
        self._settled.add(query)
        shown = ", ".join(map(repr, sorted(strangers)[:MOST_LABELS])) + ", ..." * (len(strangers) > MOST_LABELS)
        what = f"none fits {query!r}" if self.classes is None else "none of its classes is called so"
        text = f"the detector says {shown}; {what}. If these are its own words, name them: Detector(..., classes=[...])"
        warnings.warn(text, UserWarning, stacklevel=4)

    def _detected(self, shown: Shown, query: str) -> list[Boxes]:
        """What the detector finds in each picture: in all of them at once, if it has a method `many`."""
        pictures, many = [picture for _, picture in shown], getattr(self.function, "many", None)
        more = (query,) if self._takes_query else ()
        found = [self.function(each, *more) for each in pictures] if many is None else many(pictures, query)
        if self.classes is None:
            self._know(next(filter(None, map(_names_in, found)), None))
        return [boxes_of(each, self._names) for each in found]

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
        shown = self._shown(picture, world_R_body, grid)
        return [Seen(view, boxes) for (view, _), boxes in zip(shown, self._detected(shown, query), strict=True)]

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """One look at an ordinary picture ``(h, w, 3)`` uint8 that `grid` describes.

        Errors as for a panorama, and `ImageError` if the picture has another size than `grid`.
        """
        if not isinstance(grid, PerspectiveGrid):
            raise ImageError(f"grid is {type(grid).__name__}; wanted eagor.PerspectiveGrid(height, width, hfov)")
        (found,) = self.things(image, (query,), grid=grid)
        return self._evidence(found, query, View(grid), stamp)

    def _weighed(self, pieces: Iterable[ViewBox], picture: np.ndarray, query: str) -> Iterator[ViewBox]:
        """The boxes of a picture, with lower scores where they show little of the colour that the query names."""
        colour = None if self.classes is None else colour_of(query, self.classes)
        for piece in pieces:
            if colour is None:
                yield piece
                continue
            (x0, y0), (x1, y1) = np.floor(piece.box[:2]).astype(int), np.ceil(piece.box[2:]).astype(int)
            share = share_of(colour, picture[y0:y1, x0:x1])
            if share > 0:
                yield replace(piece, score=piece.score * min(1.0, share / COLOURED))

    def _evidence(self, found: list[Thing], query: str, view: View, stamp: float | None) -> Evidence:
        evidence = spread_evidence(found, self.detector, view, stamp)
        return (
            evidence
            if self.classes is None or not query
            else named(evidence, query, meant(query, self.classes, described=True))
        )

    def _wanted(self, query: str) -> tuple[str, ...] | None:
        if not isinstance(query, str) or not query.strip():
            raise QueryError(f"the query is {query!r}; wanted words, such as 'chair'")
        return None if self.classes is None else meant(query, self.classes, coloured=True)


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


# --- what detectors return --------------------------------------------------------------------------------------------

_SLACK = 1e-6  # by which rounding may take a probability out of [0, 1]

Names = Sequence[str] | Mapping[int, str]
WANTED = (
    "(boxes, scores) or (boxes, scores, labels); supervision's Detections; Ultralytics' results; a dictionary with "
    "boxes, scores, labels; MediaPipe's results; an SSD blob (1, 1, n, 7); a list of dictionaries with bbox (x, y, w, "
    "h) or box"
)


def boxes_of(found: Any, names: Names | None = None, shape: Sequence[int] | None = None) -> Boxes:
    """The boxes, scores and labels in what a detector returned for one picture.

    `names`: of the classes, where `found` numbers them: a list, or names by number. `shape`: the picture's, (h, w) or
    (h, w, 3), for detectors that write fractions of it (OpenCV's SSD, MediaPipe's older solutions).

    Boxes without area are left out. Raises `ResponseError`, which says what came and what was wanted, for anything
    else, boxes with x0 > x1 or y0 > y1, numbers that are not finite, lengths that differ, fractions where pixels were
    wanted, scores outside [0, 1], and numbers of classes without names.
    """
    if isinstance(found, Sequence) and len(found) == 1 and _reader(found[0]):
        found = found[0]  # a batch of one
    read = _reader(found)
    if read is None:
        raise ResponseError(f"the detector returned {_kind(found)}; wanted {WANTED}")
    try:
        boxes, scores, labels, own = read(found, shape)
    except (KeyError, AttributeError, TypeError, IndexError) as error:
        raise ResponseError(f"the detector returned {_kind(found)} without {error}; wanted {WANTED}") from error
    return _checked(boxes, scores, labels, names if names is not None else own)


def _names_in(found: Any) -> Names | None:
    """The names of all that a detector knows, where what it returned tells them: Ultralytics' results do."""
    one = found[0] if isinstance(found, Sequence) and len(found) == 1 else found
    return getattr(one, "names", None) if _reader(one) is _ultralytics else None


def _checked(boxes: Any, scores: Any, labels: Any, names: Names | None) -> Boxes:
    corners, values = _numbers(boxes, "boxes"), _numbers(scores, "scores").reshape(-1)
    corners = corners.reshape(0, 4) if corners.size == 0 else corners
    if corners.ndim != 2 or corners.shape[1] != 4:
        raise ResponseError(f"boxes of shape {corners.shape} came; wanted (n, 4): x0, y0, x1, y1 in pixels")
    if len(values) != len(corners):
        raise ResponseError(f"{len(corners)} boxes and {len(values)} scores came; wanted as many of each")
    for what, each in (("boxes", corners), ("scores", values)):
        if not np.isfinite(each).all():
            raise ResponseError(f"{what} came that are not finite; wanted numbers")
    if values.size and not (values.min() >= -_SLACK and values.max() <= 1 + _SLACK):
        raise ResponseError(
            f"scores from {values.min():.4g} to {values.max():.4g} came; scores outside [0, 1] want a stated "
            "squashing: 1 / (1 + exp(-score)) for logits, score / 100 for percents"
        )
    if wrong := np.flatnonzero((corners[:, 0] > corners[:, 2]) | (corners[:, 1] > corners[:, 3])).tolist():
        raise ResponseError(
            f"the box {corners[wrong[0]].tolist()} came; wanted x0 < x1 and y0 < y1. If it is x, y, width, height, add "
            "x to the width and y to the height"
        )
    if are_fractions(corners):
        raise ResponseError(
            f"boxes came within {corners.max():.3g} of the corner: they seem to be fractions of the picture. Wanted "
            "pixels: multiply x by its width and y by its height"
        )
    texts = None if labels is None else _texts(labels, names, len(corners))
    real = np.flatnonzero((corners[:, 2] > corners[:, 0]) & (corners[:, 3] > corners[:, 1]))
    return Boxes(corners[real], np.clip(values[real], 0, 1), None if texts is None else [texts[at] for at in real])


def _texts(labels: Any, names: Names | None, count: int) -> list[str]:
    found = labels if isinstance(labels, list | tuple) else np.ravel(to_numpy(labels)).tolist()
    if len(found) != count:
        raise ResponseError(f"{count} boxes and {len(found)} labels came; wanted as many of each")
    texts: list[str] = []
    for each in found:
        if isinstance(each, str):
            texts.append(each)
            continue
        value = float(each) if np.ndim(each) == 0 else float("nan")
        if not value.is_integer():
            raise ResponseError(f"the label {shown(each)} came; wanted a text, or the number of a class")
        if names is None:
            raise ResponseError(
                f"labels came as numbers, such as {int(value)}; wanted texts, or names=... of the classes. If all "
                "boxes are what was asked for, return boxes and scores alone"
            )
        try:
            texts.append(str(names[int(value)] if value >= 0 else {}[int(value)]))
        except (KeyError, IndexError):
            raise ResponseError(
                f"the label {int(value)} came, and names has {len(names)} entries without it; wanted a name for "
                "each class"
            ) from None
    return texts


def _numbers(values: Any, what: str) -> np.ndarray:
    try:
        return np.asarray(to_numpy(values), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ResponseError(f"{what} came as {_kind(values)}; wanted numbers, ({what[0]}, 4)" if what == "boxes" else
                            f"{what} came as {_kind(values)}; wanted one number for each box") from error  # fmt: skip


def _kind(found: Any) -> str:
    if isinstance(found, Mapping):
        return f"a dictionary with {', '.join(map(str, [*found][:8])) or 'nothing in it'}"
    if isinstance(found, list | tuple):
        return f"a {type(found).__name__} of {len(found)}" + (f" ({type(found[0]).__name__}, ...)" if found else "")
    if hasattr(found, "shape"):
        return f"an array of shape {tuple(found.shape)}"
    return f"{type(found).__module__}.{type(found).__qualname__}"


# One reader for each kind: boxes, scores, labels or None, names or None.

_Read = tuple[Any, Any, Any, "Names | None"]


def _supervision(found: Any, _: Any) -> _Read:
    if found.confidence is None:
        raise ResponseError(
            "supervision's Detections came without confidence; wanted scores: detections.confidence = "
            "numpy.ones(len(detections)) if there are none"
        )
    named = found.data.get("class_name") if getattr(found, "data", None) else None
    return found.xyxy, found.confidence, found.class_id if named is None else [str(name) for name in named], None


def _ultralytics(found: Any, _: Any) -> _Read:
    boxes = getattr(found, "obb", None) if found.boxes is None else found.boxes
    if boxes is None:
        raise ResponseError("Ultralytics' results came with neither boxes nor oriented boxes (obb), as of a classifier")
    corners = getattr(boxes, "xyxy", None)  # of oriented boxes: what holds them
    if corners is None:
        points = to_numpy(boxes.xyxyxyxy).reshape(-1, 4, 2)
        corners = np.concatenate([points.min(axis=1), points.max(axis=1)], axis=1)
    return corners, boxes.conf, boxes.cls, getattr(found, "names", None)


def _mapping(found: Mapping[str, Any], _: Any) -> _Read:
    labels = next((found[key] for key in ("text_labels", "label_names", "labels") if found.get(key) is not None), None)
    return found["boxes"], found["scores"], labels, None


def _mediapipe(found: Any, shape: Sequence[int] | None) -> _Read:
    boxes, scores, labels = [], [], []
    for each in found.detections or ():
        if hasattr(each, "bounding_box"):  # the tasks
            box, best = each.bounding_box, max(each.categories, key=lambda category: category.score)
            corner = [box.origin_x, box.origin_y]
            boxes.append([*corner, corner[0] + box.width, corner[1] + box.height])
            scores.append(best.score)
            labels.append(best.category_name or best.index)
        else:  # the older solutions: faces, and fractions of the picture
            height, width = _sides(shape, "MediaPipe's relative boxes")
            box = each.location_data.relative_bounding_box
            boxes.append([box.xmin * width, box.ymin * height, (box.xmin + box.width) * width,
                          (box.ymin + box.height) * height])  # fmt: skip
            scores.append(each.score[0])
            labels.append("face")
    return boxes, scores, None if None in labels else labels, None


def _blob(found: Any, shape: Sequence[int] | None) -> _Read:
    rows = to_numpy(found).reshape(-1, 7)
    rows = rows[(rows[:, 0] >= 0) & (rows[:, 2] > 0)]
    height, width = _sides(shape, "the boxes of an SSD blob")
    return rows[:, 3:] * [width, height, width, height], rows[:, 2], rows[:, 1], None


def _records(found: Sequence[Mapping[str, Any]], _: Any) -> _Read:
    keys = ("label", "category", "name", "class", "category_id")
    labels = [next((each[key] for key in keys if key in each), None) for each in found]
    if None in labels and any(label is not None for label in labels):
        raise ResponseError("some dictionaries came with a label, some without; wanted all or none")
    scores = [each["confidence" if "confidence" in each else "score"] for each in found]
    return [_box(each) for each in found], scores, None if None in labels else labels, None


def _box(record: Mapping[str, Any]) -> list[float]:
    """``bbox``: x, y, width, height, as COCO has it; ``box``: corners, by name or in a row."""
    if "bbox" in record:
        x, y, width, height = (float(value) for value in record["bbox"])
        return [x, y, x + width, y + height]
    box = record["box"]
    corners = (box[key] for key in ("xmin", "ymin", "xmax", "ymax")) if isinstance(box, Mapping) else box
    x0, y0, x1, y1 = (float(value) for value in corners)
    return [x0, y0, x1, y1]


def _plain(found: Sequence[Any], _: Any) -> _Read:
    return found[0], found[1], found[2] if len(found) == 3 else None, None


def _sides(shape: Sequence[int] | None, what: str) -> tuple[int, int]:
    if shape is None or len(shape) < 2:
        raise ResponseError(f"{what} are fractions of the picture; wanted shape=picture.shape as well")
    return int(shape[0]), int(shape[1])


def _reader(found: Any) -> Callable[[Any, Sequence[int] | None], _Read] | None:
    """Who reads `found`; None if nobody does."""
    if isinstance(found, Mapping):
        return _mapping if {"boxes", "scores"} <= {*found} else None
    if hasattr(found, "xyxy") and hasattr(found, "confidence"):
        return _supervision
    if hasattr(found, "boxes") and (hasattr(found, "obb") or hasattr(found.boxes, "conf")):
        return _ultralytics
    if hasattr(found, "detections"):
        return _mediapipe
    if hasattr(found, "shape"):
        return _blob if len(found.shape) == 4 and found.shape[-1] == 7 else None
    if not isinstance(found, Sequence) or isinstance(found, str | bytes):
        return None
    if all(isinstance(each, Mapping) and ("bbox" in each or "box" in each) for each in found):
        return _records
    return _plain if len(found) in (2, 3) and not isinstance(found[0], Mapping | str) else None
