"""Loads a model from a hub name or a folder, with errors that say what is missing."""

from __future__ import annotations

import hashlib
import math
import sys
import warnings
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor._checks import whole, within
from eagor._extras import EXTRAS, how_to_install, is_older
from eagor.errors import EagorError, MissingExtraError
from eagor.perception.vlm import Family, chosen, family_of

if TYPE_CHECKING:
    from eagor.perception.transformers.language import LanguageModel
    from eagor.perception.transformers.localisers import Localiser


def load_model(
    name: str,
    *,
    pixels: int | None = None,
    extractor: str | None = None,
    per_view: str | None = None,
    heads: str | None = None,
    layers: str | int | Sequence[int] | None = None,
    presence: bool = True,
    revision: str | None = None,
    device: str | None = None,
    dtype: str | None = None,
    max_tokens: int = 512,
    batch: int = 8,
    threshold: float | None = None,
) -> LanguageModel | Localiser:
    """The model with this hub name or in this folder, in evaluation mode on its device; options as in the perception.

    Warns of weights that the checkpoint lacks. Raises `EagorError` if packages are missing, nothing can be loaded
    there, or its family is unknown.
    """
    settings = {
        "presence": switched("presence", presence),
        "most": counted("max_tokens", max_tokens, "512"),
        "batch": counted("batch", batch, "8"),
    }
    config, family = read_family(name, revision)
    import torch
    import transformers

    from eagor.perception.transformers.language import LanguageModel, read_heads
    from eagor.perception.transformers.localisers import KINDS, Localiser

    # All options are checked before gigabytes are read.
    how = chosen(extractor or family.default(heads), family, "extractor")
    each = chosen(per_view or family.per_view, family, "per_view")
    if heads and not family.localiser and (each if how == "views" else how) == "boxes":
        raise EagorError(f"heads = {heads!r} with the extractor {how!r}, which reads boxes; use attention or both")
    foreign = {"heads": heads, "layers": layers} if family.localiser else {"threshold": threshold}
    if given := sorted(key for key, value in foreign.items() if value is not None):
        why = "has no attention to read" if family.localiser else "has none, only localisers do"
        raise EagorError(f"{', '.join(given)} cannot be used with {family.title}, which {why}")
    settings["pixels"] = None if pixels is None else counted("pixels", pixels, "980000 (700 x 1400)")
    if family.localiser:
        del settings["presence"], settings["most"]
        if threshold is not None and not within(threshold, 0, 1):
            raise EagorError(f"threshold = {threshold!r}; wanted a score from 0 to 1, such as 0.2")
        settings["threshold"] = None if threshold is None else float(threshold)
    else:
        settings |= {"heads": read_heads(heads) if heads else None, "layers": _numbers(layers)}
        settings["pixels"] = settings["pixels"] or (family.view_pixels if how == "views" else None)
    where = _device(torch, device)
    kind = dtype or ("float32" if where in ("cpu", "mps") else "bfloat16")
    if kind not in ("float32", "bfloat16", "float16"):
        raise EagorError(f"dtype = {kind!r}; wanted float32, bfloat16 or float16")
    # Pickled weights are programs.
    options: dict[str, Any] = {"dtype": getattr(torch, kind), "use_safetensors": True}
    if where == "auto":
        options["device_map"] = "auto"
    kind = KINDS[family.name].loaded_by if family.localiser else "AutoModelForImageTextToText"
    load = getattr(transformers, kind).from_pretrained
    model, told = _loaded(name, "weights", load, revision, output_loading_info=True, **options)
    if lacking := sorted(told["missing_keys"]):  # transformers fills them with random numbers
        warnings.warn(
            f"the files of {name!r} lack {len(lacking)} weights of the model, such as {lacking[0]}; they are random "
            "now. Fetch the checkpoint again",
            UserWarning,
            stacklevel=2,
        )
    about: dict[str, Any] = {
        "name": name,
        "revision": _revision(name, getattr(config, "_commit_hash", None)),
        "family": family,
        "model": model.eval() if where == "auto" else model.eval().to(where),
        "tokenizer": _loaded(name, "tokenizer", transformers.AutoTokenizer.from_pretrained, revision),
        "processor": _loaded(
            name, "image processor", transformers.AutoImageProcessor.from_pretrained, revision, backend="pil"
        ),
    }
    return Localiser(**about, **settings) if family.localiser else LanguageModel(**about, **settings)


def read_family(name: str, revision: str | None = None) -> tuple[Any, Family]:
    """The configuration and family of the model with this hub name or in this folder; weights are not read.

    Raises `EagorError` if packages are missing, nothing can be loaded there, or the family is unknown.
    """
    try:
        import torch  # noqa: F401
        import transformers
    except ImportError as error:
        raise MissingExtraError(
            f"{name} needs torch and transformers ({error}). On a CPU machine install torch==2.13.0 first, then "
            f"{how_to_install('vlm')} (and no torchvision)"
        ) from error
    least = EXTRAS["vlm"]["transformers"]
    if is_older(transformers.__version__, least):
        raise EagorError(
            f"{name} needs transformers {least} or newer; this is {transformers.__version__}: {how_to_install('vlm')}"
        )
    config = _loaded(name, "config.json", transformers.AutoConfig.from_pretrained, revision)
    return config, family_of(config, name)


def _loaded(name: str, what: str, load: Any, revision: str | None, **options: Any) -> Any:
    """The result of `load` for `name`, without running code from there. Raises `EagorError` with the reason.

    Output that a library prints meanwhile goes to stderr: stdout is for results.
    """
    options |= {"revision": revision} if revision else {}
    try:
        with redirect_stdout(sys.stderr):
            return load(name, trust_remote_code=False, **options)
    except Exception as error:  # damaged files may raise anything
        reason = " ".join(str(error).split())
        raise EagorError(
            f"the {what} of {name!r} cannot be loaded ({type(error).__name__}: {reason[:300]}). Wanted a hub name such "
            "as Qwen/Qwen2.5-VL-7B-Instruct, or a folder that holds a whole checkpoint (config.json, *.safetensors, "
            "tokenizer and preprocessor files)"
        ) from error


def _revision(name: str, commit: str | None) -> str:
    """The commit of a hub checkpoint; for a folder a digest of its configuration and of its weight files' sizes."""
    if commit:
        return str(commit)
    folder = Path(name)
    if not (folder / "config.json").is_file():
        return "unknown"
    digest = hashlib.sha256((folder / "config.json").read_bytes())
    for file in sorted(folder.glob("*.safetensors")):
        digest.update(f"{file.name} {file.stat().st_size}".encode())
    return f"folder:{digest.hexdigest()[:12]}"


def _device(torch: Any, name: str | None) -> str:
    """The device to run on. Raises `EagorError` for an unknown name or a GPU that is not there."""
    if name == "auto":
        return name
    if not name:
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError):
        raise EagorError(f"device = {name!r}; wanted cpu, cuda, cuda:1, mps or auto") from None
    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError):  # torch lacks support for it, or it does not exist; meta holds no numbers
        raise EagorError(
            f"device = {name!r}, but torch finds no such device here; leave it out, or choose cpu"
        ) from None
    return name


def counted(name: str, value: Any, example: str) -> int:
    """The option `value` as a whole number from 1, also from 1e6. Raises `EagorError`, which shows `example`."""
    if not (within(value, 1) and float(value).is_integer()):
        raise EagorError(f"{name} = {value!r}; wanted a whole number from 1, such as {example}")
    return int(value)


def switched(name: str, value: Any) -> bool:
    """The option `value` as true or false. Raises `EagorError` for anything else."""
    if value not in (True, False):
        raise EagorError(f"{name} = {value!r}; wanted true or false")
    return bool(value)


def _numbers(layers: str | int | Sequence[int] | None) -> tuple[int, ...] | None:
    """Layers as numbers."""
    if layers is None:
        return None
    try:
        if isinstance(layers, str):
            return tuple(int(part) for part in layers.split(","))
        found = (layers,) if isinstance(layers, int) else tuple(layers)
        if not all(whole(layer, -math.inf) for layer in found):
            raise TypeError("not all are whole numbers")
        return found
    except (ValueError, TypeError) as error:
        raise EagorError(f"layers = {layers!r}; wanted numbers such as 20,21,22") from error
