"""Perceptions: a panorama and a query in, evidence about directions out.

A perception is any callable with the signature of `Perception`. `load` makes one from a line of text. Packages add
their own under the entry-point group ``eagor.perceptions`` (a name, and a class or function that makes the perception).
Every perception has to pass `check_perception`.
"""

from __future__ import annotations

import inspect
import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import EntryPoint
from pathlib import Path
from runpy import run_path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from eagor import plugins
from eagor._checks import shown
from eagor.errors import EagorError, QueryError, ResponseError
from eagor.evidence import Evidence

__all__ = [
    "Perception", "as_perception", "check_perception", "infer", "is_model", "known", "knows_classes", "load",
    "parse_options", "rows_of", "short_name",
]  # fmt: skip

GROUP = "eagor.perceptions"
# Listed here so that they are known even where the package runs from a folder, without installed metadata.
BUILT_IN = {
    "coco": "eagor.perception.coco:from_text",
    "colour": "eagor.perception.colour:ColourPerception",
    "endpoint": "eagor.perception.endpoint:from_text",
    "onnx": "eagor.perception.onnx:from_text",
    "replay": "eagor.perception.replay:ReplayPerception",
    "scout": "eagor.perception.scout:ScoutPerception",
    "truth": "eagor.perception.truth:TruthPerception",
}

ROWS = 256  # of panoramas, for a perception without the attribute `rows`

_TEXTS = ("revision", "heads")  # options that stay text even if they look like numbers


@runtime_checkable
class Perception(Protocol):
    """A detector: finds things in a panorama."""

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for where in `panorama` the thing is that `query` names, in the body frame of the panorama.

        `panorama`: equirectangular image ``(H, W, 3)``, 2:1, uint8 sRGB, in the layout of `eagor.sphere`; it is not
        changed. The colours are red, green, blue, and no array can tell that they are not: of what OpenCV has read
        (blue, green, red) pass ``picture[..., ::-1]``.
        `stamp`: time of capture in seconds; the evidence carries it. Raises `QueryError` if this perception does not
        understand the query, `ImageError` if the image is unusable. Not finding the thing is no error: the evidence
        then says that it was not seen.

        A perception that sees better in level pictures has a true attribute ``takes_pose`` and takes the pose at
        capture as ``world_R_body`` ``(3, 3)``, None if it is unknown. `infer` calls any perception.
        """
        ...


class NoEvidenceError(ResponseError):
    """What a perception returned is no `Evidence` at all: it is not written as it should be."""


def infer(
    perception: Perception,
    panorama: np.ndarray,
    query: str,
    *,
    stamp: float | None = None,
    world_R_body: np.ndarray | None = None,
) -> Evidence:
    """What `perception` says of one picture; one that takes the pose at capture ``(3, 3)`` is told it.

    Raises `NoEvidenceError` if something else comes, besides the perception's own errors.
    """
    pose = {"world_R_body": world_R_body} if getattr(perception, "takes_pose", False) else {}
    answer = perception(panorama, query, stamp=stamp, **pose)
    if not isinstance(answer, Evidence):
        raise NoEvidenceError(
            f"the perception returned {type(answer).__name__} {' '.join(shown(answer).split())}; wanted "
            "eagor.Evidence, such as Evidence.from_boxes(...)"
        )
    return answer


def known() -> dict[str, EntryPoint]:
    """The perceptions that `load` can make, by name. Imports none of them."""
    return plugins.known(GROUP, BUILT_IN)


def load(spec: str, **options: Any) -> Perception:
    """The perception that `spec` names: ``"colour"``, ``"replay:detections.jsonl"``, an installed one, or a model.

    The text after the first colon is the first argument of the class or function; where that takes arguments by name
    only, it is options, as in ``colour:rows=512``. `options` are passed on by name. A folder with ``config.json``, or
    any other text with a slash, is a model for `eagor.perception.transformers`; options can follow it, as in
    ``folder?extractor=boxes&pixels=401408``. ``my_detector.py:detect`` is a function in a file of yours: a perception,
    or one that `eagor.Detector` takes. Raises `QueryError` for an unknown name, `EagorError` if the perception cannot
    be imported or does not take the arguments.
    """
    name, colon, text = str(spec).partition(":")
    if _in_a_file(spec):
        return _of_file(spec, options)
    choices = known()
    if name not in choices:
        model, _, written = str(spec).partition("?")
        if _names_a_model(model):
            return _local_model(model, parse_options(written) | options)
        raise QueryError(
            f"there is no perception {name!r}; known are {', '.join(sorted(choices))}, folders with a model, and hub "
            "names such as Qwen/Qwen2.5-VL-7B-Instruct. A model on a server is endpoint:MODEL@ADDRESS"
        )
    make: Callable[..., Perception] = plugins.bring(choices[name], "perception")
    arguments, takes = (text,) if colon else (), inspect.signature(make)
    try:
        if colon and all(each.kind is each.KEYWORD_ONLY for each in takes.parameters.values()):
            arguments, options = (), parse_options(text) | options
        takes.bind(*arguments, **options)
    except (EagorError, TypeError) as error:
        raise EagorError(
            f"perception {spec!r} cannot be made with the options {sorted(options)}: {error}. It takes {name}{takes}; "
            "the text after ':' is the first argument, or name=value"
        ) from error
    return make(*arguments, **options)


def _of_file(spec: str, options: dict[str, Any]) -> Perception:
    """The perception, or what makes one, that ``FILE.py:NAME`` names. Raises `EagorError`."""
    file, _, name = str(spec).rpartition(":")
    path = Path(os.path.expanduser(file))
    if not path.is_file():
        raise EagorError(f"there is no file {file}; wanted a file of Python and a function in it: {path.name}:detect")
    if (folder := str(path.resolve().parent)) not in sys.path:
        sys.path.insert(0, folder)  # what stands beside it can be imported, as in a script
    try:
        names = run_path(str(path))
    except Exception as error:
        raise EagorError(f"{file} cannot be run: {type(error).__name__}: {error}") from error
    if not callable(detect := names.get(name)):
        functions = [each for each, value in names.items() if callable(value) and not each.startswith("_")]
        raise EagorError(f"{file} has no function {name!r}; it has {', '.join(functions) or 'none'}")
    perception = as_perception(detect(**options) if isinstance(detect, type) else detect)
    assert not isinstance(perception, str)
    return perception


def _local_model(name: str, options: dict[str, Any]) -> Perception:
    """The perception of the model with this hub name or in this folder. Raises `EagorError` without one."""
    from eagor.perception.transformers import perception_here

    folder = Path(os.path.expanduser(name))  # leaves the name as it is if there is no such user
    if os.path.isdir(folder):
        if not os.path.isfile(folder / "config.json"):
            raise EagorError(f"the folder {name!r} has no config.json; wanted one that holds a model")
        return perception_here(str(folder), **options)
    if name.startswith((".", "~", "/")):
        raise EagorError(f"there is no folder {name!r}; wanted one that holds a model, or a hub name")
    return perception_here(name, **options)


def as_perception(perception: str | Perception | Callable[..., Any]) -> str | Perception:
    """The same, with any other function that finds things in pictures (`eagor.Detector`) made a perception.

    A perception takes the `stamp` of a picture. Raises `EagorError` for what is no function.
    """
    if isinstance(perception, str):
        return perception
    if not callable(perception):
        raise EagorError(
            f"a {type(perception).__name__} came for a perception; wanted text, such as 'coco', or a function that "
            "takes a picture and returns boxes, scores and labels"
        )
    with suppress(TypeError, ValueError):  # built in: nothing tells what it takes
        if "stamp" in inspect.signature(perception).parameters:
            return perception
    from eagor.perception.views import Detector, is_ultralytics

    return Detector.from_ultralytics(perception) if is_ultralytics(perception) else Detector(perception)


def knows_classes(perception: Any) -> bool:
    """Whether one pass of `perception` answers for every class that it knows: with its method ``answers``."""
    return getattr(perception, "classes", None) is not None and hasattr(perception, "answers")


def rows_of(perception: Any) -> int:
    """Rows of the panoramas that `perception` works on: its attribute `rows`, or `ROWS` if it has none."""
    return int(getattr(perception, "rows", ROWS))


def is_model(spec: str) -> bool:
    """Whether `load` would read `spec` as a model, on this machine or on a server."""
    name = str(spec).partition(":")[0]
    return name == "endpoint" if name in known() or _in_a_file(spec) else _names_a_model(str(spec).partition("?")[0])


def place_of(text: str) -> tuple[str, str]:
    """Model and address of a server in ``MODEL@ADDRESS``; empty where missing."""
    if first := re.search(r"https?://", text):  # a password in an address may hold another @
        return text[: first.start()].removesuffix("@"), text[first.start() :]
    model, at, address = text.rpartition("@")
    return (model, address) if at else (text, "")


def _in_a_file(spec: str) -> bool:
    """Whether it is a function in a file of Python."""
    return str(spec).rpartition(":")[0].endswith(".py")


def _names_a_model(text: str) -> bool:
    """Whether `text` is a folder with a model, or looks like a path or a hub name."""
    return os.path.isfile(os.path.join(text, "config.json")) or ("/" in text.replace(os.sep, "/") and "://" not in text)


def short_name(spec: str) -> str:
    """A short form of `spec` for file names, not unique: ``scout``, ``endpoint-qwen2.5vl-7b``."""
    name, _, text = str(spec).partition(":")
    text = text.partition("?")[0]
    if name == "endpoint":
        model = place_of(text)[0].rstrip("/").rpartition("/")[2]
        name = f"endpoint-{model}" if model else name
    elif name == "onnx":
        name = f"onnx-{Path(text).stem}"
    elif _in_a_file(spec):
        name = Path(str(spec).rpartition(":")[0]).stem
    elif name not in known():
        name = Path(os.path.expanduser(str(spec).partition("?")[0])).resolve().name
    return re.sub(r"[^\w.+-]+", "-", name).strip("-.") or "perception"


def parse_options(text: str) -> dict[str, Any]:
    """Options from text such as ``extractor=boxes&pixels=401408``; true, false and numbers are converted.

    `revision` and `heads` stay text: a commit may look like a number (``1234567``, ``12e4567``).
    Raises `EagorError` for a part without a name or a value, and for a name that comes twice.
    """
    options: dict[str, Any] = {}
    for part in filter(None, text.split("&")):
        name, _, value = part.partition("=")
        if not name or not value or name in options:
            raise EagorError(f"{part!r} in the options {text!r}; wanted name=value, each once, with & between them")
        options[name] = value if name in _TEXTS else _value(value)
    return options


def _value(text: str) -> Any:
    for kind in ({"true": True, "false": False}.__getitem__, int, float):
        with suppress(KeyError, ValueError):
            return kind(text.lower())
    return text


def check_perception(
    perception: Perception,
    panorama: np.ndarray,
    query: str,
    *,
    stamp: float = 12.5,
    roll: int | None = None,
    tolerance: float = 1e-3,
) -> None:
    """Raise `AssertionError` unless `perception` keeps the contract on this panorama and query.

    It must return `Evidence` that carries `stamp`, with a response in [0, 1] that fits its grid and finite
    coefficients. It must not change the panorama, and must answer a second call on the same grid.
    With `roll`, a panorama rolled by that many columns must give the response rolled by the same angle, within
    `tolerance` (largest difference). Use this for perceptions that treat all azimuths alike.
    """

    def require(holds: Any, came: str, wanted: str) -> None:
        if not holds:
            raise AssertionError(f"the perception {came}; wanted {wanted}")

    before = panorama.copy()
    evidence = perception(panorama, query, stamp=stamp)
    require(isinstance(evidence, Evidence), f"returned {type(evidence).__name__}", "eagor.Evidence")
    require(np.array_equal(before, panorama), "changed the panorama", "it unchanged: work on a copy")
    came = f"was given stamp={stamp}, and its evidence carries {evidence.stamp}"
    require(evidence.stamp == stamp, came, "the same: pass stamp=stamp on to what makes the evidence")
    response, grid = np.asarray(evidence.response), evidence.grid
    came = f"gives a response of shape {response.shape} on a grid of {grid.shape}"
    require(response.shape == tuple(grid.shape), came, "the grid that the response was computed on")
    came = f"gives responses from {response.min():g} to {response.max():g}"
    require(((response >= 0) & (response <= 1)).all(), came, "[0, 1]: logits want a sigmoid")
    finite = np.isfinite(np.asarray(evidence.log_ratio)).all() and np.isfinite(evidence.coefficients(3)).all()
    require(finite, "gives evidence that is not finite", "finite log ratios: make it with Evidence.from_response")
    again = perception(panorama, query, stamp=stamp).grid
    came = f"answers on a {type(grid).__name__} of {grid.shape}, then on a {type(again).__name__} of {again.shape}"
    same = (type(grid), grid.shape) == (type(again), again.shape)
    require(same, came, "the same grid: a call must not change the perception")
    if roll is None:
        return
    columns, rest = divmod(roll * response.shape[1], panorama.shape[1])
    require(not rest, f"answers with {response.shape[1]} columns, which roll={roll} shifts by a part", "another roll")
    rolled = np.asarray(perception(np.roll(panorama, roll, axis=1), query, stamp=stamp).response)
    came = f"answers with {response.shape}, and for the rolled panorama with {rolled.shape}"
    require(rolled.shape == response.shape, came, "the same grid for every panorama of one size")
    worst = float(np.abs(rolled - np.roll(response, columns, axis=1)).max())
    came = f"answers a panorama rolled by {roll} columns otherwise than the rolled answer by {worst:.3g}"
    require(
        worst <= tolerance, came, f"at most {tolerance:g}: treat all azimuths alike, the seam too, or leave roll out"
    )
