"""The detector itself: a picture into the network, boxes out of it."""

from __future__ import annotations

import inspect
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._checks import above, whole, within
from eagor.errors import EagorError, FormatError, ImageError, ResponseError
from eagor.perception.onnx.decoding import Found, Frame
from eagor.perception.onnx.inputs import FITS, ORDERS, VALUES, Fit, Order, Values, place, tensor
from eagor.perception.onnx.layouts import LAYOUTS, Graph, Layout, choose
from eagor.perception.onnx.names import Labels, Names, names_of
from eagor.perception.onnx.network import Network, Size
from eagor.perception.suppression import kept

if TYPE_CHECKING:
    from eagor.perception import Perception

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
    - `threads`: cores that the network runs on.

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
    ) -> None:
        self._made = {name: value for name, value in locals().items() if name != "self" and name != "__class__"}
        _check(self._made)
        self._network = Network(path, threads)
        names = names_of(labels, self._network.notes, 0)
        self.size = self._network.size(size, _usual_size(layout))
        grey = np.full((*self.size, 3), 114, dtype=np.uint8)
        told = LAYOUTS.get(layout)
        tried = self._network.run(
            self._tensor(grey, values or (told.values if told else "unit"), order or "rgb"), self.size
        )
        _check_task(self._network)
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
        return _again, (self._made,)

    def __repr__(self) -> str:
        return f"OnnxDetector({os.fspath(self._network.path)!r}, {self.layout}, {len(self.classes)} classes)"


def from_text(text: str = "", /, **options: Any) -> Perception:
    """The perception that ``MODEL.onnx[?option=value&...]`` names: the detector in level views of a panorama.

    Options are those of `OnnxDetector`, and of `eagor.perception.views.Views` ``hfov``, ``count``, ``detector`` and
    ``view`` (pixels of a view's side; default: as many as the network takes); those that are passed by name win. Raises
    `EagorError` for options that do not exist, and as `OnnxDetector` does.
    """
    from eagor.perception import parse_options
    from eagor.perception.views import Views

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
    return Views(detect, **fields)


_OF_VIEWS = {"hfov": "hfov", "count": "count", "view": "size", "detector": "detector"}


def _again(made: dict[str, Any]) -> OnnxDetector:
    return OnnxDetector(**made)


def _usual_size(layout: str) -> int:
    return LAYOUTS[layout].size if layout in LAYOUTS else 640


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
    }
    for name, (fits, wanted) in rules.items():
        if not fits(made[name]):
            raise EagorError(f"OnnxDetector: {name} = {made[name]!r}; wanted {wanted}")


def _check_task(network: Network) -> None:
    task = network.notes.get("task", "detect")
    if task not in ("detect", "segment", "pose"):
        raise EagorError(f"{network.path} was made for the task {task!r}; wanted a detector of upright boxes")


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
