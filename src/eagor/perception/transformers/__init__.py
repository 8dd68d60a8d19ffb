"""Local models through transformers: frozen vision-language models and open-vocabulary localisers as perceptions.

A model is named by its hub name or by a folder with ``config.json``; its family (`families`) decides how it is fed and
read. Importing this module needs no torch; making a perception does: ``pip install eagor[vlm]``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from eagor.calibration import Calibration
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.grids import Grid, PatchGrid, PerspectiveGrid
from eagor.perception.vlm.families import Extractor, Family, chosen, family_of
from eagor.perception.vlm.prompts import phrase

if TYPE_CHECKING:
    from eagor.perception.transformers.heads import Heads
    from eagor.perception.vlm.labelled import Labelled

__all__ = ["Looker", "TransformersPerception", "family_of"]

_VIEW_FIELD = math.radians(100)
_WHOLE = 0.95  # coverage at the corners of views, from which on everything counts as seen


class Looker(Protocol):
    """A loaded model that answers for images of one size; see `language.LanguageModel`."""

    name: str
    revision: str
    family: Family

    def size(self, aspect: float) -> tuple[int, int]: ...

    def cells(self, aspect: float, extractor: Extractor) -> tuple[int, int]: ...

    def look(
        self, images: Sequence[np.ndarray], grids: Sequence[Grid], queries: Sequence[str], extractor: Extractor
    ) -> tuple[np.ndarray, Any]: ...


class TransformersPerception:
    """Finds what a query names in panoramas, with a model that runs here.

    Args:
        model: hub name, or folder with ``config.json``, weights, tokenizer and image processor; or a model that is
            loaded already (`loading.load_model`): then only extractors, seam and calibration are options.
        extractor: ``attention``, ``boxes``, ``both`` (boxes and attention from one call, half each), ``mask``, or
            ``views`` (tangent views that cover the sphere); None for the family's default.
        per_view: the extractor in each view; None for the family's default.
        pixels: how many pixels an image (with ``views``: each view) has at most; None for the family's default.
        seam: look twice, the panorama rolled by half a turn in between, so that nothing is cut by the seam. Views never
            see one.
        heads: file of localisation heads (`heads`), for attention; None for relative attention. With it, attention is
            the default of every family that does not want views.
        layers: layers that relative attention reads, ``"20,21,22"`` or numbers; None for the family's depth.
        presence: multiply attention by the probability that the model answers yes when asked if the thing is there.
        calibration: how responses become evidence.
        revision: of a hub checkpoint.
        device: ``cpu``, ``cuda``, ``cuda:1``, ``mps``, or ``auto`` (spread over all GPUs by accelerate); None: CUDA
            where there is any.
        dtype: ``float32``, ``bfloat16``, ``float16``; None: bfloat16 on a GPU, else float32.
        max_tokens: that an answer may have.
        batch: images run at once.
        threshold: score below which a localiser's boxes are dropped; None for the family's.

    Raises `EagorError` if packages are missing, the model is of no known family, or an option does not fit it.
    """

    def __init__(
        self,
        model: str | Looker,
        extractor: str | None = None,
        per_view: str | None = None,
        pixels: int | None = None,
        seam: bool = True,
        heads: str | None = None,
        layers: str | int | Sequence[int] | None = None,
        presence: bool = True,
        calibration: Calibration | None = None,
        revision: str | None = None,
        device: str | None = None,
        dtype: str | None = None,
        max_tokens: int = 512,
        batch: int = 8,
        threshold: float | None = None,
    ) -> None:
        from eagor.perception.transformers.loading import counted, load_model, switched

        self.calibration = calibration
        self.seam = switched("seam", seam)
        if isinstance(model, str):
            model = load_model(
                model,
                extractor=extractor,
                per_view=per_view,
                pixels=pixels,
                heads=heads,
                layers=layers,
                presence=switched("presence", presence),
                revision=revision,
                device=device,
                dtype=dtype,
                most=counted("max_tokens", max_tokens, "512"),
                batch=counted("batch", batch, "8"),
                threshold=threshold,
            )
        self.looker = model
        self.extractor: Extractor = chosen(extractor or self.family.default(heads), self.family, "extractor")
        self.per_view: Extractor = chosen(per_view or self.family.per_view, self.family, "per_view")
        if self.per_view == "views":
            raise EagorError("per_view = 'views'; wanted what to do in each view, such as 'attention' or 'boxes'")

    @property
    def family(self) -> Family:
        """The model's family."""
        return self.looker.family

    @property
    def rows(self) -> int:
        """Rows of a panorama that shows the model as much as it can see."""
        if self.extractor == "views":
            views = self._cut()
            return round(math.pi * views[0].focal)
        return self.looker.size(2.0)[0]

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in `panorama` ``(H, W, 3)`` uint8.

        `Evidence.source` tells model, revision, extractor, pixels, token counts and milliseconds. Raises `QueryError`
        if there are no words, `ImageError` for another image, `AnswerError` if the model's boxes cannot be read.
        """
        response, coverage, source = self._respond(panorama, [query])
        whole = None if coverage is None or bool((coverage >= _WHOLE).all()) else coverage
        grid = PatchGrid(*response.shape[-2:])
        return Evidence.from_response(response[0], grid, self.calibration, stamp, coverage=whole, source=source)

    def respond(self, panorama: np.ndarray, queries: Sequence[str]) -> np.ndarray:
        """Responses ``(Q, h, w)`` float32 in [0, 1] to several queries; each image is run through the model once."""
        return self._respond(panorama, list(queries))[0]

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in one ordinary picture ``(h, w, 3)`` uint8, whose pixels `grid` describes.

        It is on cells with the grid's pose (`eagor.perception.partial.ViewPerception`). Where the extractor is
        ``views``, the picture is the view. Errors as for a call.
        """
        from eagor.perception.vlm.views import filled, framed

        began = time.perf_counter()
        phrase(query)
        extractor = self.per_view if self.extractor == "views" else self.extractor
        aspect = grid.width / grid.height
        size, shape = self.looker.size(aspect), self.looker.cells(aspect, extractor)
        if size[0] * shape[1] != size[1] * shape[0]:  # a model of one square size: its cells are square in a square
            size, shape = self.looker.size(1.0), self.looker.cells(1.0, extractor)
        picture, posed, inner = framed(image, grid, size)
        cells = replace(posed, height=shape[0], width=shape[1])
        found, cost = self.looker.look([picture], [cells], [query], extractor)
        coverage = None if inner == size else filled(shape, size, inner)
        source = {**self._known(), "extractor": extractor, "pixels": list(size), **cost.as_source()}
        source["milliseconds"] = 1000 * (time.perf_counter() - began)
        return Evidence.from_response(found[0, 0], cells, self.calibration, stamp, coverage=coverage, source=source)

    def find_heads(self, examples: Iterable[Labelled], take: int = 3) -> Heads:
        """The localisation heads of this model, found on labelled panoramas, which are looked at as a call would.

        `take`: how many heads at most. Of nine panoramas or more every third is held out, and only tells how far the
        heads are off. Raises `EagorError`
        for a model without attention to read, or if no head looks at the targets.
        """
        if "attention" not in self.family.extractors:
            raise EagorError(f"{self.family.title} has no attention heads to find; wanted a vision-language model")
        from eagor.perception.transformers.heads import fit_heads, judged

        model: Any = self.looker
        views = self._cut() if self.extractor == "views" else ()
        looks = []
        for example in examples:
            best = max(views, key=lambda view: float(view.body_R_view[:, 0] @ example.direction), default=None)
            looks.append(model.observe(example, best))
        held_out = looks[2::3] if len(looks) >= 9 else []
        kept = [look for look in looks if not any(look is other for other in held_out)]
        return judged(fit_heads(kept, model.name, model.model.config.model_type, take), held_out)

    def _respond(
        self, panorama: np.ndarray, queries: list[str]
    ) -> tuple[np.ndarray, np.ndarray | None, dict[str, object]]:
        """Responses, coverage (None: the whole sphere) and what they cost."""
        from eagor.perception.vlm.sizes import checked_picture

        began = time.perf_counter()
        for query in queries:
            phrase(query)  # said before anything is run
        image = checked_picture(panorama)
        look = self._views if self.extractor == "views" else self._whole
        response, coverage, source = look(image, queries)
        source = {**self._known(), "extractor": self.extractor, **source}
        source["milliseconds"] = 1000 * (time.perf_counter() - began)
        return response, coverage, source

    def _known(self) -> dict[str, object]:
        return {"model": self.looker.name, "revision": self.looker.revision, "family": self.family.name}

    def _whole(self, image: np.ndarray, queries: list[str]) -> tuple[np.ndarray, None, dict[str, object]]:
        from eagor.perception.vlm.seam import merged
        from eagor.perception.vlm.sizes import resized

        aspect = image.shape[1] / image.shape[0]
        size, extractor = self.looker.size(aspect), self.extractor
        grid = PatchGrid(*self.looker.cells(aspect, extractor))
        picture, shift = resized(image, size, wrap=True), grid.width // 2
        looks = [picture]
        if self.seam:  # both looks in one batch: writing takes hardly longer for two than for one
            looks.append(np.roll(picture, shift * (size[1] // grid.width), axis=1))
        found, cost = self.looker.look(looks, [grid] * len(looks), queries, extractor)
        response = found[0]
        if self.seam:
            response = merged(found[0], np.roll(found[1], -shift, axis=-1), shift / grid.width)
        return response, None, {"pixels": list(size), **cost.as_source()}

    def _cut(self) -> tuple[PerspectiveGrid, ...]:
        """The views that are cut out of a panorama."""
        from eagor.perception.vlm.views import tangent_views

        return tangent_views(min(self.looker.size(1.0)), _VIEW_FIELD)

    def _views(self, image: np.ndarray, queries: list[str]) -> tuple[np.ndarray, np.ndarray, dict[str, object]]:
        from eagor.perception.vlm.views import cut, lift

        height, width = self.looker.size(1.0)
        views = self._cut()
        rows, cols = self.looker.cells(1.0, self.per_view)
        grids = [replace(view, height=rows, width=cols) for view in views]
        found, cost = self.looker.look([cut(image, view) for view in views], grids, queries, self.per_view)
        # Cells as fine as in the middle of a view.
        lines = max(12, min(90, round(math.pi * grids[0].focal)))
        response, coverage = lift(list(found), views, PatchGrid(lines, 2 * lines))
        return response, coverage, {"pixels": [height, width], "per_view": self.per_view, **cost.as_source()}
