"""The perception: one look at a panorama is a plan, its questions, their answers, and one response."""

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
from eagor.media.cutting import check_fields, tangent_views
from eagor.media.images import checked_picture
from eagor.perception.endpoint.addresses import shown_address
from eagor.perception.endpoint.extractors import GRID, Plan, boxes_plan, view_plan, views_plan
from eagor.perception.endpoint.messages import Answer
from eagor.perception.endpoint.server import Asker, Server, named
from eagor.perception.vlm.answers import Frame, Order
from eagor.perception.vlm.families import Style, exact_size, style_of
from eagor.perception.vlm.projection import Thing, detected
from eagor.perception.vlm.prompts import phrase

_SECOND_TRY = 0.5  # temperature after an unreadable answer: at 0 the model would repeat it


@dataclass(frozen=True)
class Look:
    """The result of one look: responses ``(Q, h, w)``, coverage ``(h, w)``, and their source.

    `things`: the detections of all pictures, one list per query; None where no boxes were asked for.
    """

    responses: np.ndarray
    coverage: np.ndarray
    source: dict[str, object]
    things: tuple[list[Thing], ...] | None = None


@dataclass(frozen=True, repr=False)
class EndpointPerception(Asker):
    """Asks a vision-language model on an OpenAI-compatible server.

    Options: docs/models.md, and those of `eagor.perception.endpoint.server.Asker`. `calibration`: how responses become
    evidence; None for the default of `Evidence`. With one, boxes are read as a response map, too. `detector`: error
    model of the boxes; None for `DetectorModel()`.

    Raises `EagorError` for invalid values.
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

        Raises `QueryError` if the query is empty or the server lacks the model, `ImageError` for any other array,
        `ServerError` if the server cannot be reached or refuses, `AnswerError` for an empty or unreadable answer.
        """
        look = self.look(panorama, [query])
        if look.things is not None and self.calibration is None:
            return detected(look.things[0], self.detector, self.grid, stamp, look.coverage, look.source)
        return Evidence.from_response(
            look.responses[0], self.grid, self.calibration, stamp, coverage=look.coverage, source=look.source
        )

    def respond(self, panorama: np.ndarray, queries: Sequence[str]) -> np.ndarray:
        """Responses ``(Q, h, w)`` float32 in [0, 1] on `grid` to several queries, asked concurrently.

        They are 0 also where nothing was looked at (see `look`). Errors as for a call.
        """
        return self.look(panorama, queries).responses

    def look(self, panorama: np.ndarray, queries: Sequence[str]) -> Look:
        """`respond`, with coverage and source: model, pixels, tokens, requests, milliseconds."""
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
        """Evidence for what `query` names in one perspective picture ``(h, w, 3)`` uint8 with the pixels of `grid`.

        It is on cells with the pose of `grid` (`eagor.perception.partial.ViewPerception`). Errors as for a call.
        """
        started = time.perf_counter()
        words, model = phrase(query), self._connected.model()
        style = self.style(model)
        asked = "boxes" if self._extractor(style) == "boxes" else self.per_view
        # A model that takes panoramas in their own shape takes pictures so, too; others want their shape here as well.
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
        """Ask all questions of the plan; repeat those whose answer cannot be read once."""
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
        """Look at a grey picture, to test the setup before a long run; ignores an unreadable answer."""
        rows = self.rows
        with suppress(AnswerError):
            self.look(np.full((rows, 2 * rows, 3), 128, dtype=np.uint8), ["chair"])

    @property
    def rows(self) -> int:
        """Rows of a panorama with as many pixels as are sent; errors as for a call if no model is named."""
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
        """The style of `model`, from its name and the options of this perception."""
        told = {name: getattr(self, name) for name in ("cell", "frame", "order") if getattr(self, name)}
        return replace(style_of(model), **told)

    def views(self, model: str) -> tuple[PerspectiveGrid, ...]:
        """The views that the extractor ``views`` cuts for `model`."""
        style = self.style(model)
        side, _ = exact_size(style.cell, self.pixels or style.view**2, 1.0)
        return tangent_views(side, *self._angles)

    def _extractor(self, style: Style) -> str:
        return self.extractor or ("boxes" if style.grounded else "views")

    def _size(self, style: Style, aspect: float | None = None) -> tuple[int, int]:
        """(height, width) of a picture as sent for boxes; without `aspect`, of a panorama."""
        return exact_size(style.cell, self.pixels or style.pixels, aspect or style.aspect)

    @property
    def _angles(self) -> tuple[float, float, float]:
        """Field of view, overlap and reach of the views, radians."""
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
    """The perception named by ``MODEL@ADDRESS[?option=value&...]``; options passed by name take precedence.

    The model defaults to the only one of the server, the address to ``http://localhost:8000/v1``; an address without a
    path gets ``/v1``. Options are the attributes of `EndpointPerception`.

    Raises `EagorError` for unknown or unreadable options, several addresses, and missing packages.
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
    """Warn if the server's token count shows that it shrinks the picture: boxes in pixels are then wrong."""
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
    """The sum; None if the server did not send all counts."""
    known = [count for count in counts if count is not None]
    return sum(known) if len(known) == len(counts) else None
