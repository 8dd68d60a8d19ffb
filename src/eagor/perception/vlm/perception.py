"""One perception for all vision-language models, local or served: what they are shown, and what is made of it.

Several pictures of one moment overlap: a panorama and the same rolled by half a turn (the seam of one is the middle of
the other), or tangent views. Things are cut at borders, and models waste attention there; so everywhere the picture
counts most in which a direction lies farthest inside.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from eagor.errors import EagorError, ResponseError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detections import View
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import ANYWHERE, WHOLE_SPHERE, moments
from eagor.grids import OVERLAP, Grid, PatchGrid, PerspectiveGrid, depth_inside, tangent_views
from eagor.perception.fusion import spread_evidence
from eagor.perception.vlm import ask_boxes, phrase
from eagor.perception.vlm.answers import Box, Token, parse_boxes
from eagor.perception.vocabulary import contradicts, fitting, listed, plain, same_name
from eagor.sources.panorama import checked_picture, cut, resized
from eagor.sphere import angular_distance

SAME = math.radians(5)  # largest distance between two boxes of one small thing; the extent of large things is added
REACH = math.sqrt(3)  # half the width of a box over its standard deviation
_GENERAL = {"thing", "object", "target", "item", "instance", "region", "detection"}  # in labels that say nothing
_SAMPLES = 3  # along each side of a cell that the responses of views are projected to
Cost = Mapping[str, object]  # tokens, requests and the like, for the source of evidence


def chosen(option: str, asked: str, known: Sequence[str]) -> str:
    """What was `asked` for, or else the first of what is `known`. Raises `EagorError`, which names the `option`."""
    name = asked or known[0]
    if name not in known:
        raise EagorError(f"{option} = {name!r}; for this model it can be {', '.join(dict.fromkeys(known))}")
    return name


class ModelPerception:
    """Asks a `model` where things are; the rest as of `eagor.perception.transformers.TransformersPerception`.

    The `model` answers about pictures of its own size; boxes and responses come with what they cost (`Cost`):

    - ``extractors()``: what it can be asked for in a panorama, and in each of several views; the usual first.
    - ``sizes(aspect, view=False)``: (height, width) that pictures are resized to, and (rows, cols) of its cells.
    - ``view_rows``: rows of the panorama that responses to views are put together on.
    - ``family``: how it is asked, and what its boxes count.
    - ``boxes(images, texts, read)``: per text and image what `read` makes of the answer and its tokens.
    - ``maps(images, queries, wrap)``: responses ``(Q, B, h, w)`` in [0, 1]; `wrap`: the images are panoramas.

    Raises `EagorError` for an extractor that the model does not have.
    """

    def __init__(
        self,
        model: Any,
        extractor: str = "",
        per_view: str = "",
        seam: bool = True,
        calibration: Calibration | None = None,
        detector: DetectorModel | None = None,
    ) -> None:
        self.model, self.seam, self.calibration, self.detector = model, seam, calibration, detector
        self._asked = extractor, per_view
        self._strange_queries: set[str] = set()  # queries for which a warning named labels of the model's own

    @property
    def extractor(self) -> str:
        """How directions are read: ``boxes``, ``attention``, or ``views``."""
        return chosen("extractor", self._asked[0], self.model.extractors()[0])

    @property
    def per_view(self) -> str:
        """How they are read in each view."""
        return chosen("per_view", self._asked[1], self.model.extractors()[1])

    @property
    def rows(self) -> int:
        """Rows of a panorama at the model's full resolution."""
        if self.extractor == "views":
            return round(math.pi * tangent_views(self.model.sizes(1.0, True)[0][0])[0].focal)
        return self.model.sizes(2.0)[0][0]

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in `panorama` ``(H, W, 3)`` uint8; its `source` says model, tokens and time.

        Raises `QueryError` for an empty query, `ImageError` for any other array, `AnswerError` for an answer that
        cannot be read, and for a server what `eagor.perception.endpoint.server.ChatClient` raises.
        """
        return self.observe(panorama, [query], stamp)[0]

    def observe(self, panorama: np.ndarray, queries: Sequence[str], stamp: float | None = None) -> list[Evidence]:
        """The evidence for each of several queries about the same pictures, in one pass. Errors as for a call."""
        began, image, asked = time.perf_counter(), checked_picture(panorama), [phrase(query) for query in queries]
        if not asked:
            return []
        if self.extractor == "views":
            plan = plan_views(image, self.model.sizes(1.0, True)[0][0], self.model.view_rows)
        else:
            size, cells = self.model.sizes(2.0)
            plan = plan_panorama(image, size, cells, self.seam)
        return self._infer(plan, asked, stamp, began)

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in one perspective picture ``(h, w, 3)`` uint8 with the pixels of `grid`.

        It is on cells with the pose of `grid` (`eagor.perception.partial.ViewPerception`). With the extractor
        ``views``, the picture is the only view. Errors as for a call.
        """
        began, words = time.perf_counter(), phrase(query)
        plan = plan_view(image, grid, *self.model.sizes(grid.width / grid.height))
        return self._infer(plan, [words], stamp, began)[0]

    def _infer(self, plan: InferencePlan, queries: list[str], stamp: float | None, began: float) -> list[Evidence]:
        each = self.per_view if self.extractor == "views" else self.extractor
        images, family = [crop.image for crop in plan.crops], self.model.family
        if each == "boxes":
            size = images[0].shape[:2]

            def read(text: str, tokens: Sequence[Token]) -> list[Box]:
                return parse_boxes(text, family.frame, size, family.order, tokens)

            texts = [ask_boxes(query, family.frame, family.order) for query in queries]
            boxes, cost = self.model.boxes(images, texts, read)
            asked = zip(boxes, queries, strict=True)
            found = [self._of_boxes(plan, self._fitting(answers, query), stamp) for answers, query in asked]
        else:
            maps, cost = self.model.maps(images, queries, isinstance(plan.crops[0].grid, PatchGrid))
            responses = (combined(answers, plan.crops, plan.cells) for answers in maps)
            found = [Evidence.from_response(each, plan.cells, self.calibration, stamp) for each in responses]
        how = {"extractor": self.extractor if plan.view is None else each, "per_view": each}
        took = round(1000 * (time.perf_counter() - began), 3)
        source: dict[str, Any] = {**how, "pixels": list(images[0].shape[:2]), **cost, "milliseconds": took}
        return [replace(evidence, source=source) for evidence in found]

    def _fitting(self, answers: Sequence[Sequence[Box]], query: str) -> list[list[Box]]:
        """The boxes of each picture without those that the model itself calls something else.

        Where it calls some as they were asked for, others have to fit; else (it may write another language) all count
        whose labels do not contradict the query, and a warning names the labels, once for each query.
        """
        labels = {box.label for boxes in answers for box in boxes if box.label}
        exact = any(same_name(label, [query]) for label in labels)
        others = {each for each in labels - fitting(query, labels) if _GENERAL.isdisjoint(plain(each).split())}
        wrong = {label for label in others if exact or contradicts(label, query)}
        strange = {each for each in others - wrong if {*plain(query).split()}.isdisjoint(plain(each).split())}
        if strange and query not in self._strange_queries:
            self._strange_queries.add(query)
            text = f"the model calls what it found for {query!r} {listed(strange)}; it counts all the same"
            warnings.warn(text, UserWarning, stacklevel=5)
        return [[box for box in boxes if box.label not in wrong] for boxes in answers]

    def _of_boxes(self, plan: InferencePlan, answers: Sequence[Sequence[Box]], stamp: float | None) -> Evidence:
        if self.calibration is not None:
            raise EagorError("a calibration came for boxes, which are detections; wanted detector=DetectorModel(...)")
        pictures = zip(answers, plan.crops, strict=True)
        found = fuse_detections(box_detections(boxes, crop.grid, crop.roll) for boxes, crop in pictures)
        scored = any(each.score != 1 for each in found)  # a model that tells none has 1 everywhere
        view = View(plan.view or WHOLE_SPHERE)
        return spread_evidence([each[:3] for each in found], self.detector, view, stamp, scored)


# --- what a model is shown --------------------------------------------------------------------------------------------


class Crop(NamedTuple):
    """A picture for the model, with the geometry of `grid`, rolled to the right by the fraction `roll` of its width."""

    image: np.ndarray
    grid: Grid
    roll: float = 0.0


class InferencePlan(NamedTuple):
    """What a model is shown of one moment; one response to all `crops` is made on `cells`.

    `view`: the ordinary picture that is looked at, None: a panorama.
    """

    crops: tuple[Crop, ...]
    cells: Grid
    view: PerspectiveGrid | None = None


def plan_panorama(panorama: np.ndarray, size: tuple[int, int], cells: tuple[int, int], seam: bool) -> InferencePlan:
    """The whole panorama at `size` (height, width), seen in `cells` (rows, cols); with `seam` also rolled by half."""
    picture, grid = resized(panorama, size, wrap=True), PatchGrid(*cells)
    crops, shift = (Crop(picture, grid),), grid.cols // 2 if seam else 0
    if shift:
        crops += (Crop(np.roll(picture, shift * (size[1] // grid.cols), axis=1), grid, shift / grid.cols),)
    return InferencePlan(crops, grid)


def plan_views(panorama: np.ndarray, side: int, rows: int) -> InferencePlan:
    """Tangent views of `side` pixels that cover the sphere; responses come on a panorama of so many `rows`."""
    views = tangent_views(side)
    return InferencePlan(tuple(map(Crop, cut(panorama, *views), views)), PatchGrid(rows, 2 * rows))


def plan_view(image: np.ndarray, grid: PerspectiveGrid, size: tuple[int, int], cells: tuple[int, int]) -> InferencePlan:
    """One ordinary picture with the pixels of `grid`, at `size` (height, width), seen in `cells` (rows, cols).

    What its shape and the size differ by, it is stretched: the lens with it. Raises `ImageError`.
    """
    stretched = PerspectiveGrid.of_lens(grid.lens).resized(*size)
    crop = Crop(resized(checked_picture(image, "the view"), size), stretched)
    return InferencePlan((crop,), stretched.resized(*cells), grid)


# --- boxes ------------------------------------------------------------------------------------------------------------


class Detection(NamedTuple):
    """The direction of a box: mean ``(3,)``, covariance ``(2, 2)`` about it (radians^2), and score.

    `depth`: distance from the border of its picture, where things are cut off; larger is farther inside.
    """

    direction: np.ndarray
    covariance: np.ndarray
    score: float
    depth: float

    def same_object(self, other: Detection) -> bool:
        """Whether boxes of two pictures probably show one thing, which one of the pictures may cut off."""
        small, large = sorted(math.sqrt(float(np.trace(each.covariance)) / 2) for each in (self, other))
        if large > 3 * small + SAME:
            return False
        return float(angular_distance(self.direction, other.direction)) < math.hypot(SAME, REACH * large)


def box_detections(boxes: Iterable[Box], image: Grid, roll: float = 0.0) -> list[Detection]:
    """The boxes in a picture with the geometry of `image` as directions in the body frame.

    For a whole panorama, `image` is any grid of the whole sphere; `roll`: the fraction of its width by which it was
    rolled to the right. A box all around has no direction and counts everywhere.
    """
    height, width = image.shape
    found = []
    for box in boxes:
        corners = [(box.x0 - roll) * width, box.y0 * height, (box.x1 - roll) * width, box.y1 * height]
        try:
            centre, spread = moments(np.array(corners), image)  # columns continue across the seam
        except ResponseError:  # all around: every `Box` has some area
            centre, spread = np.array([1.0, 0.0, 0.0]), ANYWHERE**2 * np.eye(2)
        view = isinstance(image, PerspectiveGrid)
        depth = float(centre @ image.body_R_view[:, 0]) if view else 1 - abs(box.x0 + box.x1 - 1)
        found.append(Detection(centre, spread, box.score, depth))
    return found


def fuse_detections(pictures: Iterable[Sequence[Detection]]) -> list[Detection]:
    """The things in several pictures, each once: from the picture in which it lies farthest inside."""
    marked = [(each, index) for index, found in enumerate(pictures) for each in found]
    kept: list[tuple[Detection, int]] = []
    for each, index in sorted(marked, key=lambda pair: -pair[0].depth):
        if not any(index != other and each.same_object(earlier) for earlier, other in kept):
            kept.append((each, index))
    return [each for each, _ in kept]


# --- responses --------------------------------------------------------------------------------------------------------


def combined(maps: Sequence[np.ndarray], crops: Sequence[Crop], cells: Grid) -> np.ndarray:
    """One response on `cells` from those to the `crops`, each ``(h, w)``."""
    if isinstance(cells, PerspectiveGrid) or len(crops) == 1:
        return np.broadcast_to(maps[0], cells.shape)
    if isinstance(crops[0].grid, PerspectiveGrid):
        return project_to_sphere(maps, [crop.grid for crop in crops if isinstance(crop.grid, PerspectiveGrid)], cells)
    # A panorama, and the same rolled: the weights are sin^2 of half the azimuth from the border, and sum to 1.
    columns, roll = maps[0].shape[-1], crops[1].roll
    fractions, back = (np.arange(columns) + 0.5) / columns, np.roll(maps[1], -round(roll * columns), axis=-1)
    weight, other = np.sin(math.pi * fractions) ** 2, np.sin(math.pi * (fractions + roll)) ** 2
    share = weight / (weight + other)
    return (maps[0] * share + back * (1 - share)).astype(np.float32)


def project_to_sphere(responses: Sequence[np.ndarray], views: Sequence[PerspectiveGrid], grid: Grid) -> np.ndarray:
    """One response ``(h, w)`` float32 on the cells of a panorama from those of views that cover the sphere.

    `responses`: per view the values in [0, 1] of its cells ``(rows, cols)``, which divide the view evenly; a single
    cell covers the whole view. Where views overlap it is the mean, weighted by sin^2 over a margin at each side.
    """
    from scipy.ndimage import map_coordinates

    # Several points per cell: borders of views run through cells, and cells of views may be finer than ours.
    (rows, cols), blocks = grid.shape, (grid.height, _SAMPLES, grid.width, _SAMPLES)
    fine = PatchGrid(rows * _SAMPLES, cols * _SAMPLES)
    total, weights = np.zeros(fine.shape), np.zeros(fine.shape)
    for response, view in zip(responses, views, strict=True):
        depth = depth_inside(fine.directions @ view.body_R_view, view.hfov / 2, view.hfov / 2)
        inside = depth > 0
        weight = np.sin(np.clip(depth[inside] / (OVERLAP / 2), 0, 1) * (math.pi / 2)) ** 2
        x, y, _ = view.project(fine.directions[inside])
        places = [y / view.height * response.shape[0] - 0.5, x / view.width * response.shape[1] - 0.5]
        total[inside] += weight * map_coordinates(response, places, np.float64, order=1, mode="nearest")
        weights[inside] += weight
    total, share = ((each * fine.weights).reshape(blocks).sum(axis=(1, 3)) for each in (total, weights))
    return np.clip(total / share, 0, 1).astype(np.float32)
