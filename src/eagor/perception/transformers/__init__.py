"""Local models through transformers: frozen vision-language models and open-vocabulary localisers as perceptions.

A model is named by its hub name or by a folder with ``config.json``; its family (`eagor.perception.vlm`) decides how
it is run. Conversations follow the checkpoint's own template, otherwise the format that its family was trained on
(`eagor.perception.vlm.Dialogue`); decoding is greedy (temperature 0). Importing this module needs no torch; making a
perception or a conversation does: the extra ``vlm``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import WHOLE_SPHERE
from eagor.grids import Grid, PatchGrid, PerspectiveGrid, tangent_views
from eagor.media.panorama import checked_picture, cut, resized
from eagor.perception.vlm import (
    MAX_TOKENS,
    Account,
    ChatReply,
    Extractor,
    Family,
    Labelled,
    Message,
    chosen,
    phrase,
)
from eagor.perception.vlm.projection import WHOLE, Detection, detected, filled, framed, lift, merged, things, united

if TYPE_CHECKING:
    from eagor.perception.transformers.language import Heads, LanguageModel
    from eagor.perception.transformers.localisers import Localiser

__all__ = ["LocalChat", "TransformersPerception", "conversation"]

_VIEW_FIELD = math.radians(100)


@dataclass(frozen=True, eq=False)
class _Shots:
    """The pictures of one look.

    `seen`: the grid of each and the fraction by which it was rolled; `cells`: the grid of each response. `combine`
    turns the responses of the pictures into one ``(Q, h, w)`` with its coverage (None: everything).
    """

    pictures: list[np.ndarray]
    seen: list[tuple[Grid, float]]
    cells: Sequence[Grid]
    combine: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray | None]]
    told: dict[str, object]


class TransformersPerception:
    """Finds what a query names in panoramas, with a model on this machine.

    `model`: hub name, or folder with ``config.json``, weights, tokenizer and image processor; or a loaded model
    (`loading.load_model`), which leaves only extractors, seam and calibration as options. `calibration`: how responses
    become evidence; None for the default of `Evidence`. With one, boxes are read as a response map, too. `detector`:
    error model of the extractor ``boxes``; None for `DetectorModel()`. For the others see docs/models.md; None means
    the family's default, relative attention (`heads`), CUDA if there is any (`device`), and bfloat16 on a GPU, else
    float32 (`dtype`).

    Raises `EagorError` if packages are missing, the model is of no known family, or an option does not fit it.
    """

    def __init__(
        self,
        model: str | LanguageModel | Localiser,
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
        detector: DetectorModel | None = None,
    ) -> None:
        from eagor.perception.transformers.loading import load_model, switched

        self.calibration, self.detector = calibration, detector
        self.seam = switched("seam", seam)
        if isinstance(model, str):
            model = load_model(
                model, extractor=extractor, per_view=per_view, pixels=pixels, heads=heads, layers=layers,
                presence=presence, revision=revision, device=device, dtype=dtype, max_tokens=max_tokens, batch=batch,
                threshold=threshold,
            )  # fmt: skip
        self.loaded = model
        if detector is None:
            self.detector = DetectorModel.reporting_from(getattr(model, "least", None))
        self.extractor: Extractor = chosen(extractor or self.family.default(heads), self.family, "extractor")
        self.per_view: Extractor = chosen(per_view or self.family.per_view, self.family, "per_view")
        if self.per_view == "views":
            raise EagorError("per_view = 'views'; wanted what to do in each view, such as 'attention' or 'boxes'")

    @property
    def family(self) -> Family:
        """The model's family."""
        return self.loaded.family

    @property
    def rows(self) -> int:
        """Rows of a panorama at the model's full resolution."""
        return round(math.pi * self._cut()[0].focal) if self.extractor == "views" else self.loaded.size(2.0)[0]

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in `panorama` ``(H, W, 3)`` uint8.

        `Evidence.source` holds model, revision, extractor, pixels, token counts and milliseconds. Raises `QueryError`
        for an empty query, `ImageError` for any other array, `AnswerError` if the model's boxes cannot be read.
        """
        shots, began = self._shots(panorama, [query])
        if self._boxed:
            found, cost = self._things(shots, query)
            return detected(united(found), self.detector, WHOLE_SPHERE, stamp, source=self._source(shots, cost, began))
        response, coverage, cost = self._response(shots, [query])
        whole = None if coverage is None or bool((coverage >= WHOLE).all()) else coverage
        grid, source = PatchGrid(*response.shape[-2:]), self._source(shots, cost, began)
        return Evidence.from_response(response[0], grid, self.calibration, stamp, coverage=whole, source=source)

    def respond(self, panorama: np.ndarray, queries: Sequence[str]) -> np.ndarray:
        """Responses ``(Q, h, w)`` float32 in [0, 1] to several queries; each image runs through the model once."""
        return self._response(self._shots(panorama, queries)[0], queries)[0]

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in one perspective picture ``(h, w, 3)`` uint8 with the pixels of `grid`.

        It is on cells with the pose of `grid` (`eagor.perception.partial.ViewPerception`). With the extractor
        ``views``, the picture is the only view. Errors as for a call.
        """
        began = time.perf_counter()
        phrase(query)
        aspect = grid.width / grid.height
        size, shape = self.loaded.size(aspect), self.loaded.cells(aspect, self._each)
        if size[0] * shape[1] != size[1] * shape[0]:  # the model sees only squares: its cells are square in a square
            size, shape = self.loaded.size(1.0), self.loaded.cells(1.0, self._each)
        picture, posed, inner = framed(image, grid, size)
        cells = posed.resized(*shape)
        coverage = None if inner == size else filled(shape, size, inner)
        told: dict[str, object] = {"extractor": self._each, "pixels": list(size)}
        shots = _Shots([picture], [(posed, 0.0)], [cells], lambda found: (found[0], coverage), told)
        if self._boxed:
            found, cost = self._things(shots, query)
            inside = [thing for thing in found[0] if grid.project(thing.direction)[2]]
            return detected(inside, self.detector, grid, stamp, source=self._source(shots, cost, began))
        response, _, cost = self._response(shots, [query])
        source = self._source(shots, cost, began)
        return Evidence.from_response(response[0], cells, self.calibration, stamp, coverage=coverage, source=source)

    def find_heads(self, examples: Iterable[Labelled], take: int = 3) -> Heads:
        """The localisation heads of this model, `take` at most, found on labelled panoramas viewed as in a call.

        With nine panoramas or more, every third is held out to measure the error of the heads. Raises `EagorError`
        for a model without readable attention, or if no head attends to the targets.
        """
        if "attention" not in self.family.extractors:
            raise EagorError(f"{self.family.title} has no attention heads to find; wanted a vision-language model")
        from eagor.perception.transformers.language import fit_heads, judged

        model: Any = self.loaded
        views = self._cut() if self.extractor == "views" else ()
        looks = []
        for example in examples:
            best = max(views, key=lambda view: float(view.body_R_view[:, 0] @ example.direction), default=None)
            looks.append(model.observe(example, best))
        held_out = looks[2::3] if len(looks) >= 9 else []
        kept = [look for look in looks if not any(look is other for other in held_out)]
        return judged(fit_heads(kept, model.name, model.model.config.model_type, take), held_out)

    @property
    def _each(self) -> Extractor:
        """The extractor for each picture."""
        return self.per_view if self.extractor == "views" else self.extractor

    @property
    def _boxed(self) -> bool:
        """Whether the evidence consists of detections."""
        return self.calibration is None and self._each == "boxes"

    def _response(self, shots: _Shots, queries: Sequence[str]) -> tuple[np.ndarray, np.ndarray | None, Account]:
        found, cost = self.loaded.look(shots.pictures, shots.cells, queries, self._each)
        return *shots.combine(found), cost

    def _things(self, shots: _Shots, query: str) -> tuple[list[list[Detection]], Account]:
        """The detections in each picture for one query, and their cost."""
        boxes, cost = self.loaded.boxes(shots.pictures, [query])
        return [things(ones[0], grid, roll) for ones, (grid, roll) in zip(boxes, shots.seen, strict=True)], cost

    def _source(self, shots: _Shots, cost: Account, began: float) -> dict[str, object]:
        known = {"model": self.loaded.name, "revision": self.loaded.revision, "family": self.family.name}
        return {**known, **shots.told, **vars(cost), "milliseconds": 1000 * (time.perf_counter() - began)}

    def _shots(self, panorama: np.ndarray, queries: Sequence[str]) -> tuple[_Shots, float]:
        """The pictures of a look at a panorama, and the time it began."""
        began = time.perf_counter()
        for query in queries:
            phrase(query)  # raises for an empty query before anything runs
        image = checked_picture(panorama)
        return (self._views(image) if self.extractor == "views" else self._whole(image)), began

    def _whole(self, image: np.ndarray) -> _Shots:
        """The panorama at the model's size; with `seam` also rolled by half a turn."""
        aspect = image.shape[1] / image.shape[0]
        size = self.loaded.size(aspect)
        grid = PatchGrid(*self.loaded.cells(aspect, self.extractor))
        picture, shift = resized(image, size, wrap=True), grid.width // 2
        told: dict[str, object] = {"extractor": self.extractor, "pixels": list(size)}
        if not self.seam:
            return _Shots([picture], [(grid, 0.0)], [grid], lambda found: (found[0], None), told)
        # Both pictures in one batch: generating for two takes hardly longer than for one.
        pictures = [picture, np.roll(picture, shift * (size[1] // grid.width), axis=1)]
        roll = shift / grid.width

        def combine(found: np.ndarray) -> tuple[np.ndarray, None]:
            return merged(found[0], np.roll(found[1], -shift, axis=-1), roll), None

        return _Shots(pictures, [(grid, 0.0), (grid, roll)], [grid, grid], combine, told)

    def _views(self, image: np.ndarray) -> _Shots:
        views = self._cut()
        rows, cols = self.loaded.cells(1.0, self.per_view)
        grids = [view.resized(rows, cols) for view in views]
        # Cells as fine as in the middle of a view.
        lines = max(12, min(90, round(math.pi * grids[0].focal)))
        told: dict[str, object] = {"extractor": "views", "pixels": list(self.loaded.size(1.0))}
        return _Shots(
            cut(image, *views), [(view, 0.0) for view in views], grids,
            lambda found: lift(list(found), views, PatchGrid(lines, 2 * lines)), told | {"per_view": self.per_view},
        )  # fmt: skip

    def _cut(self) -> tuple[PerspectiveGrid, ...]:
        """The views that are cut out of a panorama."""
        return tangent_views(min(self.loaded.size(1.0)), _VIEW_FIELD)


# --- conversations ----------------------------------------------------------------------------------------------------


class LocalChat:
    """A `eagor.perception.vlm.Chat` with a model on this machine. Thread-safe; calls run one at a time.

    Arguments as of `eagor.perception.transformers.TransformersPerception`, except `pixels`: the most pixels of a
    picture; None for the limit of the checkpoint's processor. Gemma 3, LLaVA and Janus-Pro always see one square of
    fixed size.

    Raises `EagorError` if packages are missing, nothing can be loaded there, or the model's family cannot talk.
    """

    def __init__(
        self,
        model: str,
        max_tokens: int = MAX_TOKENS,
        pixels: int | None = None,
        revision: str | None = None,
        device: str | None = None,
        dtype: str | None = None,
    ) -> None:
        from eagor.perception.transformers.loading import counted, load_model, read_family

        self._max_tokens = counted("max_tokens", max_tokens, "512")
        _, family = read_family(model, revision)
        if family.dialogue is None:  # checked before weights are read
            raise EagorError(
                f"{model} is {family.title}, which locates things and cannot talk; wanted a vision-language model such "
                "as Qwen/Qwen2.5-VL-7B-Instruct (as a --perception of the agent eagor this one will do)"
            )
        how: dict[str, Any] = {"revision": revision, "device": device, "dtype": dtype}
        self._language: Any = load_model(model, extractor="attention", pixels=pixels, **how)

    def __call__(self, messages: Sequence[Message]) -> ChatReply:
        """The reply to `messages`, with its token counts.

        Raises `EagorError` if conversation and reply are longer than the model allows, `ImageError` for an image that
        is not a picture.
        """
        import torch

        from eagor.perception.transformers import inputs
        from eagor.perception.transformers.inference import share
        from eagor.perception.transformers.language import stops_of

        language, family = self._language, self._language.family
        config, processor = language.model.config, language.processor
        images = [checked_picture(image, "a picture") for message in messages for image in message.images]
        shapes = [image.shape[:2] for image in images]
        plans = [inputs.picture_plan(family, config, processor, shape, language.pixels) for shape in shapes]
        counts = [plan.layout.count for plan in plans]
        written = conversation(language.tokenizer, family, messages)
        prompt = inputs.tokens_of(language.tokenizer, family, written, config.image_token_id, counts)
        length = prompt.prefix.shape[1] + prompt.suffix.shape[1]
        self._check_length(length, counts)
        shown = zip(images, plans, strict=True)
        fed = [inputs.pictures([resized(image, plan.size)], plan, processor) for image, plan in shown]
        tensors = {name: torch.cat([one[name] for one in fed]) for name in (fed[0] if fed else ())}
        with language.lock, torch.inference_mode():
            prefix = share(language.model, family, prompt, tensors, 1, config.image_token_id)
            running = prefix.continued(last=True)
            logits = running.feed(prompt.suffix)
            answer = running.decode(logits, self._max_tokens, stops_of(language.model, language.tokenizer))
        text = language.tokenizer.decode(answer.ids[0], skip_special_tokens=True)
        return ChatReply(text.strip(), length, len(answer.ids[0]))

    def _check_length(self, length: int, counts: Sequence[int]) -> None:
        longest = getattr(self._language.model.config.get_text_config(), "max_position_embeddings", None)
        if longest is not None and length + self._max_tokens > longest:
            raise EagorError(
                f"the conversation has {length} tokens, {sum(counts)} of them for {len(counts)} pictures, and a reply "
                f"may have {self._max_tokens}; {self._language.name} takes {longest} together. Show it less of the "
                "conversation (--set window=2), fewer pixels (?pixels=...), or allow a shorter reply (?max_tokens=...)"
            )


def conversation(tokenizer: Any, family: Family, messages: Sequence[Message]) -> str:
    """`messages` as one text that ends where the reply begins, with the family's expansion in place of each picture.

    It uses the checkpoint's template if that supports pictures and accepts these messages.
    """
    from eagor.perception.transformers.inputs import own_template, templated

    said = [(message.role, [_plain(part, family) for part in message.parts()]) for message in messages]
    pictures = sum(part is None for _, parts in said for part in parts)
    if own_template(tokenizer, family) is not None:
        turns = [
            {
                "role": role,
                "content": [{"type": "image"} if part is None else {"type": "text", "text": part} for part in parts],
            }
            for role, parts in said
        ]
        written = templated(tokenizer, turns)
        words = [part.strip() for _, parts in said for part in parts if part is not None]
        if written.count(family.placeholder) == pictures and all(word in written for word in words):
            return written.replace(family.placeholder, family.expansion)
    return _by_family(family, said).replace(family.placeholder, family.expansion)


def _by_family(family: Family, said: Sequence[tuple[str, Sequence[str | None]]]) -> str:
    manner = family.dialogue
    assert manner is not None
    texts = [(role, "".join(manner.picture if part is None else part for part in parts)) for role, parts in said]
    if texts and texts[0][0] == "system" and not manner.system:
        (_, words), *texts = texts
        place = next((index for index, (role, _) in enumerate(texts) if role == "user"), None)
        if place is not None:
            texts[place] = "user", f"{words}\n\n{texts[place][1]}"
    elif manner.helper and not any(role == "system" for role, _ in texts):
        texts = [("system", manner.helper), *texts]
    forms = {"system": manner.system, "user": manner.user, "assistant": manner.assistant}
    return manner.begin + "".join(forms[role].replace("{text}", text) for role, text in texts) + manner.reply


def _plain(part: str | np.ndarray, family: Family) -> str | None:
    """Text without the tokens that stand for pictures; None for a picture."""
    if not isinstance(part, str):
        return None
    for token in {family.placeholder, family.image_token}:
        part = part.replace(token, token.strip("<|>"))  # written in the text, it would be taken for a picture
    return part
