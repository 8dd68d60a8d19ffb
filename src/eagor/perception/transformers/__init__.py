"""Models on this machine, through transformers: frozen vision-language models, and detectors of the hub.

A model is named by its hub name or by a folder with ``config.json``; its family (`eagor.perception.vlm`) decides how
it is run. Decoding is greedy (temperature 0). Importing this module needs no torch; making a perception does: the
extra ``vlm``.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from eagor._extras import extras, how_to_install, is_older, need
from eagor.errors import EagorError
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import tangent_views
from eagor.perception.json_files import checked
from eagor.perception.vlm import FAMILIES, MAX_TOKENS, Family, Labelled
from eagor.perception.vlm.perception import ModelPerception, chosen

if TYPE_CHECKING:
    from eagor.perception.transformers.heads import Heads
    from eagor.perception.transformers.language import LanguageModel
    from eagor.perception.views import Detector

__all__ = ["TransformersPerception", "hub_detector", "load_model", "perception_here"]


class TransformersPerception(ModelPerception):
    """Finds what a query names in panoramas, with a vision-language model on this machine.

    `model`: hub name, or folder with ``config.json``, weights, tokenizer and image processor; or a loaded model
    (`load_model`). `extractor`, `per_view`: empty for the family's. `calibration`: how responses of attention become
    evidence; None for the default of `Evidence`. `detector`: error model of boxes; None for `DetectorModel()`.
    `options`: those of `load_model`; docs/models.md says what each means.

    Raises `EagorError` if packages are missing, the model is of no known family, or an option does not fit it.
    """

    def __init__(
        self,
        model: str | LanguageModel,
        extractor: str = "",
        per_view: str = "",
        *,
        seam: bool = True,
        calibration: Calibration | None = None,
        detector: DetectorModel | None = None,
        **options: Any,
    ) -> None:
        if seam not in (True, False):
            raise EagorError(f"seam = {seam!r}; wanted true or false")
        self.loaded = load_model(model, extractor, per_view, **options) if isinstance(model, str) else model
        super().__init__(self.loaded, extractor, per_view, seam, calibration, detector)

    @property
    def family(self) -> Family:
        """The model's family."""
        return self.loaded.family

    def find_heads(self, examples: Iterable[Labelled], take: int = 3) -> Heads:
        """The localisation heads of this model, `take` at most, found on labelled panoramas viewed as in a call.

        Raises `EagorError` if no head attends to the targets.
        """
        from eagor.perception.transformers.heads import fit_heads

        model, looks = self.loaded, []
        views = tangent_views(model.sizes(1.0, True)[0][0]) if self.extractor == "views" else ()
        for example in examples:
            best = max(views, key=lambda view: float(view.body_R_view[:, 0] @ example.direction), default=None)
            looks.append(model.observe(example, best))
        return fit_heads(looks, model.name, model.model.config.model_type, take)


# --- loading ----------------------------------------------------------------------------------------------------------

Count = Annotated[int, msgspec.Meta(ge=1)]


class _Place(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Which version of a checkpoint, and where it runs."""

    revision: str | None = None
    device: str | None = None
    dtype: Annotated[str, msgspec.Meta(pattern="^(float32|bfloat16|float16|)$")] = ""


class _Options(_Place, kw_only=True, forbid_unknown_fields=True):
    heads: str | None = None
    presence: bool = True
    pixels: Count | None = None
    max_tokens: Count = MAX_TOKENS
    batch: Count = 8


class _DetectorOptions(_Place, kw_only=True, forbid_unknown_fields=True):
    threshold: Annotated[float, msgspec.Meta(ge=0, le=1)] | None = None


def load_model(name: str, extractor: str = "", per_view: str = "", **options: Any) -> LanguageModel:
    """The vision-language model with this hub name or in this folder, in evaluation mode on its device.

    `options`: ``heads`` (a file), ``presence``, ``pixels``, ``max_tokens``, ``batch``, ``revision``,
    ``device`` and ``dtype``, as in docs/models.md. All are checked before gigabytes are read. Raises `EagorError` if
    packages are missing, nothing can be loaded there, or its family is unknown.
    """
    given = checked(options, _Options, "a model here")
    config = read_config(name, given.revision)
    family = next((each for each in FAMILIES if config.model_type in each.model_types), None)
    if family is None:
        raise _unknown(name, config)
    known = family.choices(bool(given.heads))
    how, each = chosen("extractor", extractor, known[0]), chosen("per_view", per_view, known[1])
    if given.heads and (each if how == "views" else how) == "boxes":
        raise EagorError(f"heads = {given.heads!r} with the extractor {how!r}, which reads boxes; use attention")
    from eagor.perception.transformers.heads import read_heads
    from eagor.perception.transformers.language import LanguageModel

    heads = read_heads(given.heads) if given.heads else None
    model, processor, revision = _weights(name, config, given, "AutoModelForImageTextToText", "AutoImageProcessor")
    tokenizer = _loaded(name, "AutoTokenizer", given.revision)
    return LanguageModel(name, revision, family, model, tokenizer, processor, heads, given.presence,
                         given.max_tokens, given.batch, given.pixels)  # fmt: skip


def hub_detector(
    name: str, *, hfov_deg: float = 100.0, views: int = 6, size: int = 640, detector: DetectorModel | None = None,
    **options: Any,
) -> Detector:  # fmt: skip
    """The detector with this hub name or in this folder, shown level views all around a panorama.

    It is one with classes (`AutoModelForObjectDetection`) or an open-vocabulary one. `hfov_deg`, `views`, `size`,
    `detector`: as of `eagor.Detector`. `options`: ``threshold`` (the least score), ``revision``, ``device``, ``dtype``.
    Errors as of `load_model`.
    """
    given = checked(options, _DetectorOptions, "a detector")
    config = read_config(name, given.revision)
    import transformers

    from eagor.perception.transformers.localisers import CLASSES, KINDS, HubDetector
    from eagor.perception.views import Detector

    kind = KINDS.get(config.model_type, CLASSES)
    if kind is CLASSES and type(config) not in transformers.AutoModelForObjectDetection._model_mapping:
        raise _unknown(name, config)
    classes = None if kind.sentence else config.id2label
    processor = "AutoProcessor" if kind.sentence else "AutoImageProcessor"
    model, prepared, _ = _weights(name, config, given, kind.loaded_by, processor)
    threshold = kind.threshold if given.threshold is None else given.threshold
    function = HubDetector(model, prepared, kind, threshold, classes)
    return Detector(function, classes, hfov_deg=hfov_deg, views=views, size=size, detector=detector)


def perception_here(name: str, **options: Any) -> TransformersPerception | Detector:
    """The perception of a model on this machine: a vision-language model, or with `hub_detector` a detector."""
    config = read_config(name, options.get("revision"))
    language = any(config.model_type in family.model_types for family in FAMILIES)
    return TransformersPerception(name, **options) if language else hub_detector(name, **options)


def _unknown(name: str, config: Any) -> EagorError:
    known = ", ".join(f"{family.title} ({', '.join(family.model_types)})" for family in FAMILIES)
    return EagorError(
        f"{name} holds a model of type {config.model_type!r}, which cannot be read here; known are {known}, and "
        "detectors of the hub. Other models can be served and reached as endpoint:MODEL@URL"
    )


def read_config(name: str, revision: str | None = None) -> Any:
    """The configuration of the model with this hub name or in this folder; weights are not read.

    Raises `EagorError` if packages are missing, or nothing can be loaded there.
    """
    need(name, "vlm", "torch", "transformers")
    import transformers

    if is_older(transformers.__version__, least := extras().get("vlm", {}).get("transformers", "0")):
        raise EagorError(
            f"{name} needs transformers {least} or newer; this is {transformers.__version__}: {how_to_install('vlm')}"
        )
    return _loaded(name, "AutoConfig", revision)


def _loaded(name: str, kind: str, revision: str | None, **options: Any) -> Any:
    """What the class `kind` of transformers loads for `name`, without running code from there. Raises `EagorError`."""
    import transformers

    options |= {"revision": revision} if revision else {}
    try:
        with redirect_stdout(sys.stderr):  # stdout is for results
            return getattr(transformers, kind).from_pretrained(name, trust_remote_code=False, **options)
    except Exception as error:  # damaged files may raise anything
        reason = " ".join(str(error).split())
        raise EagorError(
            f"{name!r} cannot be loaded ({kind}: {type(error).__name__}: {reason[:300]}). Wanted a hub name such as "
            "Qwen/Qwen2.5-VL-7B-Instruct, or a folder that holds a whole checkpoint (config.json, *.safetensors, "
            "tokenizer and preprocessor files)"
        ) from error


def _weights(name: str, config: Any, given: _Place, kind: str, processor: str) -> tuple[Any, Any, str]:
    """The model on its device, its processor, and its revision: the hub's commit, or a digest of a folder's files."""
    import torch

    where = given.device or ("cuda" if torch.cuda.is_available() else "cpu")
    try:
        if where != "auto":
            torch.zeros(1, device=where).item()
    except (RuntimeError, AssertionError, TypeError) as error:  # no such device, or one that holds no numbers
        raise EagorError(
            f"device = {where!r} cannot be used ({error}); wanted cpu, cuda, cuda:1, mps or auto"
        ) from error
    dtype = getattr(torch, given.dtype or ("float32" if where in ("cpu", "mps") else "bfloat16"))
    # Pickled weights are programs.
    model = _loaded(name, kind, given.revision, dtype=dtype, use_safetensors=True, device_map=where).eval()
    backend = {"backend": "pil"} if processor == "AutoImageProcessor" else {}
    prepared = _loaded(name, processor, given.revision, **backend)
    revision = getattr(config, "_commit_hash", None)
    if not revision:
        files = [f"{file.name} {file.stat().st_size}" for file in sorted(Path(name).glob("*.safetensors"))]
        digest = hashlib.sha256(Path(name, "config.json").read_bytes() + "".join(files).encode())
        revision = f"folder:{digest.hexdigest()[:12]}"
    return model, prepared, str(revision)
