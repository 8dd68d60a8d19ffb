"""The perception itself: one look at a panorama is a plan, its questions, their answers, and one response."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from eagor._checks import above, require, whole, within
from eagor.errors import AnswerError, EagorError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.perception.cutting import check_fields, tangent_views
from eagor.perception.endpoint.addresses import shown_address
from eagor.perception.endpoint.extractors import GRID, Plan, boxes_plan, view_plan, views_plan
from eagor.perception.endpoint.messages import Answer
from eagor.perception.endpoint.server import Asker, Server, named
from eagor.perception.vlm.boxes import Frame, Order
from eagor.perception.vlm.found import Thing, detected
from eagor.perception.vlm.prompts import phrase
from eagor.perception.vlm.sizes import checked_picture, exact_size
from eagor.perception.vlm.styles import Style, style_of

_SECOND_TRY = 0.5  # temperature when an answer could not be read: at 0 it would be the same again


@dataclass(frozen=True)
class Look:
    """What came of one look: responses ``(Q, h, w)``, coverage ``(h, w)``, and what produced them.

    `things`: what the boxes of all pictures mean, one list for each query; None where no boxes were asked for.
    """

    responses: np.ndarray
    coverage: np.ndarray
    source: dict[str, object]
    things: tuple[list[Thing], ...] | None = None


@dataclass(frozen=True, repr=False)
class EndpointPerception(Asker):
    """Asks a vision-language model that runs on an OpenAI-compatible server.

    Options: docs/models.md, and those of `eagor.perception.endpoint.server.Asker`. `calibration`: how responses become
    evidence; None for the default of `Evidence`. With one, boxes are read as a response map, too. `detector`: how the
    boxes err; None for `DetectorModel()`.

    Raises `EagorError` for values that make no sense.
    """

    extractor: Literal["", "boxes", "views"] = ""
    per_view: Literal["presence", "boxes"] = "presence"
    pixels: int = 0
    cell: int = 0
    frame: Frame | Literal[""] = ""
    order: Order | Literal[""] = ""
    seam: bool = True
    hfov_deg: float = 100.0
    overlap_deg: float = 10.0
    reach_deg: float = 90.0
    image_format: Literal["png", "jpeg"] = "png"
    max_tokens: int = 1024
    concurrency: int = 4
    calibration: Calibration | None = None
    detector: DetectorModel | None = None

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                wanted = ", ".join(choice or "nothing" for choice in choices)
                raise EagorError(f"{name} is {getattr(self, name)!r}; wanted {wanted}")
        wanted = {
            "pixels": (whole(self.pixels, 0), "0 or more, a whole number"),
            "cell": (whole(self.cell, 0), "a whole number of pixels, 0 or more"),
            "max_tokens": (whole(self.max_tokens, 1), "a whole number, 1 or more"),
            "concurrency": (whole(self.concurrency, 1), "a whole number, 1 or more"),
            "seam": (isinstance(self.seam, bool), "True or False"),
            "hfov_deg": (above(self.hfov_deg, 0, 150), "degrees above 0, at most 150"),
            "overlap_deg": (within(self.overlap_deg, 0, 150), "degrees from 0 to 150"),
            "reach_deg": (above(self.reach_deg, 0, 90), "degrees above 0, at most 90"),
        }
        require(self, wanted)
        check_fields(*self._angles)
        super().__post_init__()

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for the thing that `query` names in `panorama` ``(H, W, 3)`` uint8, with its `source`.

        Raises `QueryError` if the query is empty or the server lacks the model, `ImageError` for another image,
        `ServerError` if the server cannot be reached or refuses, `AnswerError` if its answer is empty or unreadable.
        """
        look = self.look(panorama, [query])
        if look.things is not None and self.calibration is None:
            return detected(look.things[0], self.detector, self.grid, stamp, look.coverage, look.source)
        return Evidence.from_response(
            look.responses[0], self.grid, self.calibration, stamp, coverage=look.coverage, source=look.source
        )

    def respond(self, panorama: np.ndarray, queries: Sequence[str]) -> np.ndarray:
        """Responses ``(Q, h, w)`` float32 in [0, 1] on `grid` to several queries, asked side by side.

        0 where nothing was seen, too (see `look`). Errors as for a call.
        """
        return self.look(panorama, queries).responses

    def look(self, panorama: np.ndarray, queries: Sequence[str]) -> Look:
        """`respond`, with the coverage and the source: model, pixels, tokens, requests, milliseconds."""
        started = time.perf_counter()
        image = checked_picture(panorama)
        words = [phrase(query) for query in queries]
        if not words:
            return Look(np.zeros((0, *GRID.shape), np.float32), np.ones(GRID.shape), {})
        model = self._connected.model()
        style = self.style(model)
        if self._extractor(style) == "boxes":
            plan = boxes_plan(image, style, self._size(style), self.seam, self.image_format)
        else:
            margin = math.radians(self.overlap_deg) / 2
            plan = views_plan(image, style, self.views(model), margin, self.per_view, self.image_format)
        return self._look(plan, words, model, started)

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in one ordinary picture ``(h, w, 3)`` uint8, whose pixels `grid` describes.

        It is on cells with the grid's pose (`eagor.perception.partial.ViewPerception`). Errors as for a call.
        """
        started = time.perf_counter()
        words, model = phrase(query), self._connected.model()
        style = self.style(model)
        asked = "boxes" if self._extractor(style) == "boxes" else self.per_view
        # What is fed panoramas as they are takes pictures as they are; what wants another shape wants it here, too.
        aspect = grid.width / grid.height if style.aspect == 2.0 else style.aspect
        plan = view_plan(image, grid, style, self._size(style, aspect), asked, self.image_format)
        look = self._look(plan, [words], model, started)
        coverage = None if (look.coverage >= 1).all() else look.coverage
        source = {**look.source, "extractor": asked}
        if look.things is not None and self.calibration is None:
            inside = [thing for thing in look.things[0] if grid.project(thing.direction)[2]]
            return detected(inside, self.detector, grid, stamp, source=source)
        cells = plan.shots[0].canvas
        return Evidence.from_response(look.responses[0], cells, self.calibration, stamp, coverage, source)

    def _look(self, plan: Plan, queries: list[str], model: str, started: float) -> Look:
        """Ask what is planned, once more where an answer cannot be read."""
        questions = plan.questions(queries, self.max_tokens)
        answers = self._connected.ask([asked for _, asked in questions])
        readings, again = [], []
        for (shot, asked), answer in zip(questions, answers, strict=True):
            try:
                readings.append(plan.read(shot, answer))
            except AnswerError:
                (second,) = self._connected.ask([replace(asked, temperature=_SECOND_TRY)])
                again.append(second)
                readings.append(plan.read(shot, second))
        _warn_if_shrunk(plan, model, answers)
        responses, coverage = plan.response(readings, len(queries))
        source = self._source(plan, model, [*answers, *again], 1000 * (time.perf_counter() - started))
        return Look(responses, coverage, source, plan.things(readings, len(queries)))

    def check(self) -> None:
        """One look at a grey picture, before a long run: is there a server, and does it know model, key and pictures?

        Raises what a look raises, but for an answer that cannot be read: there is nothing to see.
        """
        rows = self.rows
        with suppress(AnswerError):
            self.look(np.full((rows, 2 * rows, 3), 128, dtype=np.uint8), ["chair"])

    @property
    def rows(self) -> int:
        """Rows of a panorama that shows the model as much as it is sent; errors as for a call if no model is named."""
        model = self._connected.model()
        style = self.style(model)
        if self._extractor(style) == "boxes":
            return self._size(style)[0]
        return round(math.pi * self.views(model)[0].focal)

    @property
    def grid(self) -> PatchGrid:
        """The cells of the responses: 2 degrees each way."""
        return GRID

    def style(self, model: str) -> Style:
        """How `model` sees and answers: by its name, with what this perception was told."""
        told = {name: getattr(self, name) for name in ("cell", "frame", "order") if getattr(self, name)}
        return replace(style_of(model), **told)

    def views(self, model: str) -> tuple[PerspectiveGrid, ...]:
        """The views that ``views`` cuts for `model`."""
        style = self.style(model)
        side, _ = exact_size(style.cell, self.pixels or style.view**2, 1.0)
        return tangent_views(side, *self._angles)

    def _extractor(self, style: Style) -> str:
        return self.extractor or ("boxes" if style.grounded else "views")

    def _size(self, style: Style, aspect: float | None = None) -> tuple[int, int]:
        """(height, width) of a picture as it is sent for boxes: of a panorama, unless its aspect is named."""
        return exact_size(style.cell, self.pixels or style.pixels, aspect or style.aspect)

    @property
    def _angles(self) -> tuple[float, float, float]:
        """Field, overlap and reach of the views, radians."""
        return math.radians(self.hfov_deg), math.radians(self.overlap_deg), math.radians(self.reach_deg)

    @property
    def _connected(self) -> Server:
        return self._server(self.concurrency, self.max_tokens)

    def _source(self, plan: Plan, model: str, answers: Sequence[Answer], milliseconds: float) -> dict[str, object]:
        revisions = {answer.revision for answer in answers if answer.revision}
        return {
            "perception": "endpoint",
            "model": model,
            "served_as": ", ".join(sorted({answer.model for answer in answers if answer.model})),
            "revision": ", ".join(sorted(revisions)) or None,
            "servers": [shown_address(url) for url in self.servers],
            "family": plan.style.family,
            "extractor": self._extractor(plan.style),
            "height": plan.size[0],
            "width": plan.size[1],
            "pictures": len(plan.shots),
            "requests": sum(answer.requests for answer in answers),
            "prompt_tokens": _sum([answer.prompt_tokens for answer in answers]),
            "completion_tokens": _sum([answer.completion_tokens for answer in answers]),
            "probabilities": any(answer.tokens for answer in answers),
            "milliseconds": round(milliseconds, 3),
        }


def from_text(text: str = "", /, **options: Any) -> EndpointPerception:
    """The perception that ``MODEL@ADDRESS[?option=value&...]`` names; options passed by name win.

    Model and address may be missing: the only model of the server, and ``http://localhost:8000/v1``. An address without
    a path gets ``/v1``. Options are the attributes of `EndpointPerception`.

    Raises `EagorError` for options that do not exist or cannot be read, several addresses, and without the packages.
    """
    return named(EndpointPerception, text, **options)


_CHOICES: dict[str, tuple[str, ...]] = {
    "extractor": ("", "boxes", "views"),
    "per_view": ("presence", "boxes"),
    "frame": ("", *get_args(Frame)),
    "order": ("", *get_args(Order)),
    "image_format": ("png", "jpeg"),
}


def _warn_if_shrunk(plan: Plan, model: str, answers: Sequence[Answer]) -> None:
    """Boxes in pixels are off if the server resizes the picture; its count of tokens shows that."""
    height, width = plan.size
    cells = height * width // plan.style.cell**2
    counted = [answer.prompt_tokens for answer in answers if answer.prompt_tokens]
    if plan.style.frame == "pixels" and counted and min(counted) < cells:
        warnings.warn(
            f"{model} read {min(counted)} tokens, but the picture of {width} x {height} alone has {cells}: the server "
            "seems to shrink it, and boxes in its pixels are then off. Send fewer pixels (pixels=...) or raise the "
            "server's limit (vLLM --mm-processor-kwargs)",
            UserWarning,
            stacklevel=4,
        )


def _sum(counts: Sequence[int | None]) -> int | None:
    """The sum, None if the server did not tell all of them."""
    known = [count for count in counts if count is not None]
    return sum(known) if len(known) == len(counts) else None
