"""A vision-language model on a server: vLLM, SGLang, Ollama, llama.cpp, ``transformers serve``, or a hosted one.

It works with any server that speaks OpenAI's chat completions. A server returns text and, at best, token probabilities.
It is asked for ``boxes`` in the whole panorama and again in the panorama rolled by half a turn, or shown ``views`` that
cover the sphere (docs/models.md). Attention needs a local model: `eagor.perception.transformers`.

One look is a `LookPlan`: its pictures, the question about each (boxes, or presence of the thing), and the way to
combine the responses of the pictures.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from eagor._checks import above, require, whole, within
from eagor.errors import AnswerError, EagorError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import WHOLE_SPHERE, canvas_of
from eagor.grids import Grid, PatchGrid, PerspectiveGrid, check_fields, tangent_views
from eagor.media.panorama import checked_picture, cut, resized
from eagor.perception.endpoint.addresses import shown_address
from eagor.perception.endpoint.client import Answer, Picture, Request, question
from eagor.perception.endpoint.server import Asker, Server, named
from eagor.perception.vlm import Served, ask_boxes, ask_presence, boxes_schema, exact_size, phrase, style_of
from eagor.perception.vlm.answers import Box, Frame, Order, parse_boxes, parse_presence
from eagor.perception.vlm.projection import Detection, detected, drawn, filled, framed, lift, merged, things, united

__all__ = ["EndpointPerception", "ServedLook", "from_text"]

_SECOND_TRY = 0.5  # temperature after an unreadable answer: at 0 the model would repeat it


@dataclass(frozen=True)
class ServedLook:
    """The result of one look: responses ``(Q, h, w)``, coverage ``(h, w)``, and their source.

    `things`: the detections of all pictures, one list per query; None where no boxes were asked for.
    """

    responses: np.ndarray
    coverage: np.ndarray
    source: dict[str, object]
    things: tuple[list[Detection], ...] | None = None


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

    def look(self, panorama: np.ndarray, queries: Sequence[str]) -> ServedLook:
        """`respond`, with coverage and source: model, pixels, tokens, requests, milliseconds."""
        started = time.perf_counter()
        image = checked_picture(panorama)
        words = [phrase(query) for query in queries]
        if not words:
            return ServedLook(np.zeros((0, *GRID.shape), np.float32), np.ones(GRID.shape), {})
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

    def _look(self, plan: LookPlan, queries: list[str], model: str, started: float) -> ServedLook:
        """Ask all questions of the plan; repeat those whose answer cannot be read once."""
        questions = plan.questions(queries, self.max_tokens)
        answers = self._connected.ask([asked for _, asked in questions])
        readings, again = [], []
        for (shot, asked), answer in zip(questions, answers, strict=True):
            try:
                readings.append((shot, plan.read(shot, answer)))
            except AnswerError:
                (second,) = self._connected.ask([replace(asked, temperature=_SECOND_TRY)])
                again.append(second)
                readings.append((shot, plan.read(shot, second)))
        _warn_if_shrunk(plan, model, answers)
        responses, coverage = plan.response(readings, len(queries))
        source = self._source(plan, model, [*answers, *again], 1000 * (time.perf_counter() - started))
        return ServedLook(responses, coverage, source, plan.things(readings, len(queries)))

    def check(self) -> None:
        """ServedLook at a grey picture, to test the setup before a long run; ignores an unreadable answer."""
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

    def style(self, model: str) -> Served:
        """The style of `model`, from its name and the options of this perception."""
        told = {name: getattr(self, name) for name in ("cell", "frame", "order") if getattr(self, name)}
        return replace(style_of(model), **told)

    def views(self, model: str) -> tuple[PerspectiveGrid, ...]:
        """The views that the extractor ``views`` cuts for `model`."""
        style = self.style(model)
        side, _ = exact_size(style.cell, self.pixels or style.view**2, 1.0)
        return tangent_views(side, *self._angles)

    def _extractor(self, style: Served) -> str:
        return self.extractor or ("boxes" if style.grounded else "views")

    def _size(self, style: Served, aspect: float | None = None) -> tuple[int, int]:
        """(height, width) of a picture as sent for boxes; without `aspect`, of a panorama."""
        return exact_size(style.cell, self.pixels or style.pixels, aspect or style.aspect)

    @property
    def _angles(self) -> tuple[float, float, float]:
        """Field of view, overlap and reach of the views, radians."""
        return math.radians(self.hfov_deg), math.radians(self.overlap_deg), math.radians(self.reach_deg)

    @property
    def _connected(self) -> Server:
        return self._server(self.concurrency, self.max_tokens)

    def _source(self, plan: LookPlan, model: str, answers: Sequence[Answer], milliseconds: float) -> dict[str, object]:
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


def _warn_if_shrunk(plan: LookPlan, model: str, answers: Sequence[Answer]) -> None:
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


# --- what one look asks -----------------------------------------------------------------------------------------------

GRID = WHOLE_SPHERE  # the grid of all responses to panoramas
Asked = Literal["boxes", "presence"]
Format = Literal["png", "jpeg"]


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture with the geometry of `grid`, rolled by the fraction `roll`; its response is on the grid `canvas`."""

    picture: Picture
    grid: Grid
    canvas: Grid
    roll: float = 0.0


Reading = list[Box] | float  # of the answer about a shot: its boxes, or the probability that the thing is there


@dataclass(frozen=True, eq=False)
class LookPlan:
    """One look: its pictures, with one question per query about each (all queries of a picture in a row).

    `combine` turns the responses of the pictures ``(Q, ...)`` into one ``(Q, h, w)`` with coverage ``(h, w)``.
    """

    shots: tuple[Shot, ...]
    asked: Asked
    style: Served
    combine: Callable[[list[np.ndarray]], tuple[np.ndarray, np.ndarray]]

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the pictures."""
        return self.shots[0].picture.size

    def questions(self, queries: Sequence[str], max_tokens: int) -> list[tuple[Shot, Request]]:
        """The requests, each with its shot."""
        style = self.style
        schema = boxes_schema(style.frame, style.order) if self.asked == "boxes" else None
        texts = [ask_boxes(q, style.frame, style.order) if schema else ask_presence(q) for q in queries]
        return [
            (shot, question(shot.picture, text, max_tokens, schema, alternatives=schema is None))
            for shot in self.shots
            for text in texts
        ]

    def read(self, shot: Shot, answer: Answer) -> Reading:
        """The parsed answer. Raises `AnswerError` if it cannot be read."""
        if self.asked == "presence":
            return parse_presence(answer.text, answer.verdict)
        style = self.style
        return parse_boxes(answer.text, style.frame, shot.picture.size, style.order, answer.tokens)

    def response(self, readings: Sequence[tuple[Shot, Reading]], queries: int) -> tuple[np.ndarray, np.ndarray]:
        """The combined response and coverage of `readings` for this many queries; a probability is a single cell."""
        maps = [
            drawn(found, shot.grid, shot.canvas, shot.roll) if isinstance(found, list) else np.full((1, 1), found)
            for shot, found in readings
        ]
        return self.combine([np.stack(maps[start : start + queries]) for start in range(0, len(maps), queries)])

    def things(self, readings: Sequence[tuple[Shot, Reading]], queries: int) -> tuple[list[Detection], ...] | None:
        """The detections of all pictures together, one list per query; None where no boxes were asked for."""
        if self.asked == "presence":
            return None
        found = [things(boxes, shot.grid, shot.roll) for shot, boxes in readings if isinstance(boxes, list)]
        return tuple(united(found[query::queries]) for query in range(queries))


def boxes_plan(panorama: np.ndarray, style: Served, size: tuple[int, int], seam: bool, kind: Format) -> LookPlan:
    """Ask for boxes in the whole panorama at `size`; with `seam` also in the rolled panorama."""
    image = resized(panorama, size, wrap=True)
    shift = max(1, size[1] // style.cell) // 2 * style.cell if seam else 0
    roll = shift / size[1]
    shots = [Shot(Picture(image, kind), GRID, GRID)]
    if shift:
        shots.append(Shot(Picture(np.roll(image, shift, axis=1), kind), GRID, GRID, roll))

    def combine(looks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return looks[0] if len(looks) == 1 else merged(looks[0], looks[1], roll), np.ones(GRID.shape)

    return LookPlan(tuple(shots), "boxes", style, combine)


def views_plan(
    panorama: np.ndarray, style: Served, views: Sequence[PerspectiveGrid], margin: float, asked: Asked, kind: Format
) -> LookPlan:
    """Ask for boxes or presence in each of several views of the panorama."""
    pictures = cut(panorama, *views)
    shots = [Shot(Picture(p, kind), view, canvas_of(view)) for p, view in zip(pictures, views, strict=True)]
    return LookPlan(tuple(shots), asked, style, lambda looks: lift(looks, views, GRID, margin))


def view_plan(
    image: np.ndarray, grid: PerspectiveGrid, style: Served, size: tuple[int, int], asked: Asked, kind: Format
) -> LookPlan:
    """Ask for boxes or presence in one perspective picture; the response is on the shot's canvas instead of `GRID`."""
    framing, posed, inner = framed(image, grid, size)
    cells = canvas_of(posed)

    def combine(looks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return np.broadcast_to(looks[0], (1, *cells.shape)).astype(np.float32), filled(cells.shape, size, inner)

    return LookPlan((Shot(Picture(framing, kind), posed, cells),), asked, style, combine)
