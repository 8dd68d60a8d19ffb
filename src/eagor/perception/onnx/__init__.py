"""Detectors for ordinary pictures in ONNX files: the YOLO family, SSD, DETR, torchvision, MMDetection, CenterNet.

``--perception onnx:MODEL.onnx?labels=coco.txt&size=640`` runs one without a line of code. `LAYOUTS` lists the ways
of writing boxes that are known.

Tested are small graphs with such outputs, DETR and RT-DETR with random weights against their own library, and
published weights of CenterNet alone.
"""

from __future__ import annotations

import ast
import inspect
import os
import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eagor._checks import above, parsed, shown, whole, within
from eagor._files import read_file
from eagor.errors import EagorError, FormatError, ImageError, ResponseError
from eagor.perception.onnx.decoding import Found, Frame, kept
from eagor.perception.onnx.layouts import LAYOUTS, Graph, Layout, choose
from eagor.perception.onnx.network import FITS, ORDERS, VALUES, Fit, Network, Order, Size, Values, place, tensor

if TYPE_CHECKING:
    from eagor.perception import Perception

__all__ = ["LAYOUTS", "OnnxDetector", "from_text"]

MOST = 300  # boxes of a picture: the best


class OnnxDetector:
    """Runs a detector that was exported to ONNX on an ordinary picture.

    Called with a picture ``(h, w, 3)``, uint8 RGB, and a query, which it does not read, it returns boxes ``(n, 4)``
    x0, y0, x1, y1 in pixels of the picture, scores ``(n,)`` in [0, 1], and n labels, the best first. A box comes once
    for each of its classes that reaches the threshold. At most 300 boxes are returned.

    - `path`: the file. `labels`: what the classes are called, a file or a list (default: what the file itself says).
    - `size`: rows and columns of the network's input, a number or a pair (default: what the file says).
    - `threshold`: least score, in [0, 1] (default: as usual for the layout).
    - `layout`: how the network writes boxes, one of `eagor.perception.onnx.LAYOUTS`; "auto" decides by the outputs.
    - `fit` ("letterbox", "corner", "stretch"), `values` ("unit", "byte", "signed", "imagenet"), `order` ("rgb", "bgr"):
      how the picture is put into the input (default: as usual for the layout).
    - `overlap`: intersection over union beyond which the worse of two boxes of a class falls; 1 keeps all (default:
      0.5, and 1 for layouts that have suppressed already).
    - `first`: the number of the first class of a list of labels (default: 1 where 0 is the background, else 0).
    - `sigmoid`: whether scores are logits that want the logistic function.
    - `threads`: cores that the network runs on, for each picture.
    - `together`: pictures that `many` looks at at the same time.

    It tries the network once on a grey picture. Raises `EagorError` for a file that is no such network, for outputs in
    no known layout, and for values that make no sense; `FormatError` for labels that cannot be read or whose number is
    wrong; `MissingExtraError` without onnxruntime, which the extra ``photos`` brings.

    Attributes: `classes`, the names in the order of their numbers; `layout`, its name; `size`, rows and columns.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        labels: Labels | None = None,
        size: int | Size | str | None = None,
        threshold: float | None = None,
        layout: str = "auto",
        *,
        fit: Fit | None = None,
        values: Values | None = None,
        order: Order | None = None,
        overlap: float | None = None,
        first: int | None = None,
        sigmoid: bool = False,
        threads: int = 1,
        together: int = 1,
    ) -> None:
        self._made = {name: value for name, value in locals().items() if name != "self" and name != "__class__"}
        _check(self._made)
        self._network = Network(path, threads)
        names = names_of(labels, self._network.notes, 0)
        self.size = self._network.size(size, LAYOUTS[layout].size if layout in LAYOUTS else 640)
        grey = np.full((*self.size, 3), 114, dtype=np.uint8)
        told = LAYOUTS.get(layout)
        tried = self._network.run(
            self._tensor(grey, values or (told.values if told else "unit"), order or "rgb"), self.size
        )
        if (task := self._network.notes.get("task", "detect")) not in ("detect", "segment", "pose"):
            raise EagorError(f"{path} was made for the task {task!r}; wanted a detector of upright boxes")
        graph = Graph(
            self._network.outputs(tried), self._network.inputs, self.size, self._network.notes, names and names.total
        )
        try:
            self.layout, self._picked = choose(layout, graph)
        except EagorError as error:
            raise EagorError(f"{self._network.path}: {error}") from None
        usual = LAYOUTS[self.layout]
        if layout == "auto":  # the usual size of a network that takes any is known only now
            self.size = self._network.size(size, usual.size)
        self.fit: Fit = fit or usual.fit
        self.values: Values = values or usual.values
        self.order: Order = order or usual.order
        self.threshold = usual.threshold if threshold is None else float(threshold)
        self.overlap = (0.5 if usual.suppress else 1.0) if overlap is None else float(overlap)
        names = names_of(labels, self._network.notes, usual.first if first is None else first)
        shapes = [tried[at].shape for at in self._picked]
        self._names = _checked_names(names, usual, shapes, self._network)
        self._known = None if names is None else (max(self._names) + 1)
        self.classes: tuple[str, ...] = tuple(self._names.values())
        count = usual.columns(shapes) if usual.columns else None
        self._frame = Frame(self.size, self.threshold, count if names is None else names.total, sigmoid)
        self.together = together

    def __call__(self, picture: np.ndarray, query: str = "") -> tuple[np.ndarray, np.ndarray, list[str]]:
        """Boxes, scores and labels in `picture`; see the class.

        Raises `ImageError` for what is no such picture, `ResponseError` if the network answers with numbers that are
        not finite, or with scores outside [0, 1].
        """
        picture = np.asarray(picture)
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
            raise ImageError(f"the picture is {picture.dtype} of shape {picture.shape}; wanted uint8 RGB (h, w, 3)")
        canvas, placed = place(picture, self.size, self.fit)
        outputs = self._network.run(self._tensor(canvas, self.values, self.order), self.size)
        found = self._read([outputs[at] for at in self._picked])
        boxes = placed.back(found.boxes)
        height, width = placed.shape
        boxes = np.clip(boxes, 0, [width, height, width, height])
        real = np.flatnonzero((boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1]))
        order = kept(boxes[real], found.scores[real], found.classes[real], self.overlap)[:MOST]
        best = real[order]
        return boxes[best], found.scores[best], [self._name(int(number)) for number in found.classes[best]]

    def many(self, pictures: Sequence[np.ndarray], query: str = "") -> list[tuple[np.ndarray, np.ndarray, list[str]]]:
        """What is in each of several pictures, as for one; `together` of them are looked at at the same time."""
        if self.together == 1:
            return [self(picture, query) for picture in pictures]
        with ThreadPoolExecutor(self.together, "eagor-look") as pool:
            return [*pool.map(self, pictures)]

    def _read(self, outputs: list[np.ndarray]) -> Found:
        where = f"{self._network.path} (layout {self.layout})"
        for each in outputs:
            if each.dtype.kind == "f" and not np.isfinite(each).all():
                raise ResponseError(
                    f"{where} gives {int((~np.isfinite(each)).sum())} numbers that are not finite; a network in 16 "
                    "bits overflows where values=... is wrong: export it in 32 bits, or name the right values"
                )
        try:
            found = LAYOUTS[self.layout].read(outputs, self._frame)
        except ResponseError as error:
            raise ResponseError(f"{where}: {error}") from None
        if not np.isfinite(found.boxes).all():
            raise ResponseError(f"{where} gives boxes that are not finite; name the right layout=...")
        middles = (found.boxes[:, :2] + found.boxes[:, 2:]) / 2
        if (np.abs(middles / self._frame.sides[:2] - 0.5) > 1.5).any():
            raise ResponseError(f"{where} gives boxes far outside of the picture; name the right layout=...")
        return found

    def _name(self, number: int) -> str:
        if self._known is not None and number >= self._known:
            raise FormatError(
                f"{self._network.path} found class {number}, and the labels end with {self._known - 1}, "
                f"{self._names[self._known - 1]!r}; wanted all of them, or lines with 'id name'"
            )
        return self._names.get(number, f"class {number}")

    def _tensor(self, canvas: np.ndarray, values: Values, order: Order) -> np.ndarray:
        return tensor(canvas, values, order, self._network.dtype, self._network.channels_first)

    def __reduce__(self) -> tuple[Any, ...]:
        """Other processes open the file again."""
        return partial(OnnxDetector, **self._made), ()

    def __repr__(self) -> str:
        return f"OnnxDetector({os.fspath(self._network.path)!r}, {self.layout}, {len(self.classes)} classes)"


def from_text(text: str = "", /, **options: Any) -> Perception:
    """The perception that ``MODEL.onnx[?option=value&...]`` names: the detector in level views of a panorama.

    Options are those of `OnnxDetector`, and of `eagor.Detector` ``hfov_deg``, ``views``, ``detector`` and ``view``
    (pixels of a view's side; default: as many as the network takes); those that are passed by name win. Raises
    `EagorError` for options that do not exist, and as `OnnxDetector` does.
    """
    from eagor.perception import parse_options
    from eagor.perception.views import Detector

    path, _, written = text.partition("?")
    if not path:
        raise EagorError("onnx wants the detector's file: onnx:MODEL.onnx, or onnx:MODEL.onnx?labels=coco.txt&size=640")
    given = parse_options(written) | options
    own = [*inspect.signature(OnnxDetector).parameters][1:]
    if unknown := sorted(given.keys() - {*own, *_OF_VIEWS}):
        raise EagorError(f"onnx has no option {', '.join(unknown)}; it has {', '.join([*own, *_OF_VIEWS])}")
    if isinstance(given.get("labels"), int | float):
        given["labels"] = str(given["labels"])  # a file that is called 80, say
    detect = OnnxDetector(os.path.expanduser(path), **{name: given[name] for name in own if name in given})
    fields: dict[str, Any] = {"size": max(detect.size)} | {
        new: given[old] for old, new in _OF_VIEWS.items() if old in given
    }
    return Detector(detect, **fields)


_OF_VIEWS = {"hfov_deg": "hfov_deg", "views": "views", "view": "size", "detector": "detector"}


def _check(made: dict[str, Any]) -> None:
    """Raise `EagorError` for the first option that makes no sense."""
    rules: dict[str, tuple[Any, str]] = {
        "threshold": (lambda v: v is None or within(v, 0, 1), "a number from 0 to 1"),
        "layout": (lambda v: v == "auto" or v in LAYOUTS, f"auto, {', '.join(LAYOUTS)}"),
        "fit": (lambda v: v is None or v in FITS, ", ".join(FITS)),
        "values": (lambda v: v is None or v in VALUES, ", ".join(VALUES)),
        "order": (lambda v: v is None or v in ORDERS, ", ".join(ORDERS)),
        "overlap": (lambda v: v is None or above(v, 0, 1), "a number above 0, at most 1"),
        "first": (lambda v: v is None or whole(v, 0), "a whole number, 0 or more"),
        "sigmoid": (lambda v: isinstance(v, bool), "true or false"),
        "threads": (lambda v: whole(v, 1, 1024), "a whole number, 1 or more"),
        "together": (lambda v: whole(v, 1, 1024), "a whole number, 1 or more"),
    }
    for name, (fits, wanted) in rules.items():
        if not fits(made[name]):
            raise EagorError(f"OnnxDetector: {name} = {made[name]!r}; wanted {wanted}")


def _checked_names(
    names: Names | None, layout: Layout, shapes: list[tuple[int, ...]], network: Network
) -> dict[int, str]:
    count = layout.columns(shapes) if layout.columns else None
    if names is None:
        if count is None:
            raise EagorError(
                f"{network.path} says neither what its classes are called nor how many there are; name a file with "
                "labels=FILE.txt, one per line"
            )
        return {number: f"class {number}" for number in range(count)}
    more = network.notes.get("task") in ("segment", "pose")  # further columns, after those of the classes
    if count is not None and (names.total > count or (names.complete and names.total < count and not more)):
        raise FormatError(
            f"{names.where}: {names.total} names, and {network.path} has {count} classes; wanted one name for each, or "
            "lines with 'id name'"
        )
    return names.named


# --- what classes are called ------------------------------------------------------------------------------------------

KEYS = ("names", "class_names", "classes", "labels", "id2label")  # of the metadata, the first that is there
_LONGEST = 4_000_000  # characters of a list of labels: tens of thousands of classes
_NOTHING = {"background", "__background__", "bg", "n/a", "na", "???", "none", ""}  # numbers that no class has
_NUMBERED = re.compile(r"(\d+)\s*[:=,\t ]\s*(.+)")

Labels = str | os.PathLike[str] | Sequence[str] | Mapping[int, str]


class Names(NamedTuple):
    """Names by number, how many numbers there are, and whether each of them had its line; `where` they came from."""

    named: dict[int, str]
    total: int
    complete: bool
    where: str


def names_of(labels: Labels | None, notes: Mapping[str, str], first: int) -> Names | None:
    """The names of classes; None where neither `labels` nor `notes`, the file's metadata, has any.

    `labels`: a file (`read_labels`), a list, or names by number. `first`: the number of the first name of a list that
    does not begin with the background; that one always has number 0. Raises `FormatError` for what is no such thing.
    """
    if labels is not None:
        if isinstance(labels, str | os.PathLike):
            return _numbered(read_labels(labels), first, f"the labels in {os.fspath(labels)}")
        return _numbered(labels, first, "labels")
    for key in KEYS:
        if notes.get(key, "").strip():
            where = f"{key!r} in the file's metadata"
            return _numbered(_literal(notes[key], where), first, where)
    return None


def read_labels(path: str | os.PathLike[str]) -> list[str] | dict[int, str]:
    """The labels in a text file: one per line; ``id name`` on each line; or a list or an object as JSON.

    Empty lines at the end do not count, nor does what follows ``#`` at the beginning of a line. Raises `FormatError`,
    which says what is wrong where.
    """
    try:
        text = read_file(path)[: _LONGEST + 1].decode("utf-8-sig")
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read ({error}); wanted a text file of labels, one per line") from error
    if text.lstrip()[:1] in ("[", "{"):
        return _literal(text, str(path))
    lines = [line.strip() for line in text.rstrip().splitlines() if not line.startswith("#")]
    if not any(lines):
        raise FormatError(f"{path} has no labels; wanted one per line, 'id name' lines, or a JSON list")
    found = [_NUMBERED.fullmatch(line) for line in lines]
    if not all(found):
        return lines
    numbers = [int(match[1]) for match in found if match]
    if len(set(numbers)) < len(numbers):
        twice = next(number for number in numbers if numbers.count(number) > 1)
        raise FormatError(f"{path} has the number {twice} twice; wanted 'id name' lines, each id once")
    return {int(match[1]): match[2] for match in found if match}


def _literal(text: str, where: str) -> Any:
    """A list or mapping written as JSON, or as Python writes it; nothing in it is run."""
    if len(text) <= _LONGEST:
        try:
            return parsed(text)
        except ValueError:
            pass
        try:
            return ast.literal_eval(text.strip())
        except (ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
            if re.fullmatch(r"[^\[\]{}\"]+", text) and "," in text:
                return [part.strip() for part in text.split(",")]
    raise FormatError(f"{where} cannot be read: {shown(text)}; wanted a list of names, or {{number: name}}")


def _numbered(found: Any, first: int, where: str) -> Names:
    wanted = f"{where}: {shown(found)}; wanted a list of names, or names by number"
    if isinstance(found, Mapping):
        try:
            names = {int(number): name for number, name in found.items()}
        except (TypeError, ValueError):
            raise FormatError(wanted) from None
    elif isinstance(found, Sequence) and not isinstance(found, str | bytes):
        begins = 0 if found and str(found[0]).strip().lower() in _NOTHING else first
        names = dict(enumerate(found, start=begins))
    else:
        raise FormatError(wanted)
    if not names or min(names) < 0 or not all(isinstance(name, str) for name in names.values()):
        raise FormatError(wanted)
    named = {number: name.strip() for number, name in sorted(names.items()) if name.strip().lower() not in _NOTHING}
    if not named:
        raise FormatError(wanted)
    return Names(named, max(names) + 1, isinstance(found, Sequence), where)
