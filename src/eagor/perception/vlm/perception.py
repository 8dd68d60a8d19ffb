"""One perception for all vision-language models, local or served: what they are shown, and what is made of it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detections import View
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import WHOLE_SPHERE
from eagor.grids import PatchGrid, PerspectiveGrid, tangent_views
from eagor.media.panorama import checked_picture
from eagor.perception.things import spread_evidence
from eagor.perception.vlm import phrase
from eagor.perception.vlm.answers import Box
from eagor.perception.vlm.projection import (
    InferencePlan,
    box_detections,
    fuse_detections,
    plan_panorama,
    plan_view,
    plan_views,
)

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
    - ``boxes(images, queries)``: per query and image what it writes; ``AnswerError`` if that cannot be read.
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
        size, cells = self.model.sizes(grid.width / grid.height)
        if size[0] * cells[1] != size[1] * cells[0]:  # it sees only squares: its cells are square in a square
            size, cells = self.model.sizes(1.0)
        return self._infer(plan_view(image, grid, size, cells), [words], stamp, began)[0]

    def _infer(self, plan: InferencePlan, queries: list[str], stamp: float | None, began: float) -> list[Evidence]:
        each = self.per_view if self.extractor == "views" else self.extractor
        images = [crop.image for crop in plan.crops]
        if each == "boxes":
            boxes, cost = self.model.boxes(images, queries)
            found = [self._of_boxes(plan, answers, stamp) for answers in boxes]
        else:
            maps, cost = self.model.maps(images, queries, isinstance(plan.crops[0].grid, PatchGrid))
            found = [Evidence.from_response(plan.combine(answers), plan.cells, self.calibration, stamp, plan.coverage)
                     for answers in maps]  # fmt: skip
        how = {"extractor": self.extractor if plan.view is None else each, "per_view": each}
        took = round(1000 * (time.perf_counter() - began), 3)
        source: dict[str, Any] = {**how, "pixels": list(images[0].shape[:2]), **cost, "milliseconds": took}
        return [replace(evidence, source=source) for evidence in found]

    def _of_boxes(self, plan: InferencePlan, answers: Sequence[Sequence[Box]], stamp: float | None) -> Evidence:
        if self.calibration is not None:
            raise EagorError("a calibration came for boxes, which are detections; wanted detector=DetectorModel(...)")
        pictures = zip(answers, plan.crops, strict=True)
        found = fuse_detections(box_detections(boxes, crop.grid, crop.roll) for boxes, crop in pictures)
        if plan.view is not None:
            found = [each for each in found if plan.view.project(each.direction)[2]]
        scored = any(each.score != 1 for each in found)  # a model that tells none has 1 everywhere
        return spread_evidence([each[:3] for each in found], self.detector, View(plan.view or WHOLE_SPHERE), stamp,
                               scored)  # fmt: skip
