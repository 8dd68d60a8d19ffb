"""The layouts that detectors write their outputs in, and which of them a file has.

`LAYOUTS` lists them. `choose` decides by names, shapes and metadata; where it cannot tell, its error says what came.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eagor.errors import EagorError
from eagor.perception.onnx import decoding
from eagor.perception.onnx.decoding import STRIDES, Found, Frame, cells_in
from eagor.perception.onnx.network import Fit, Order, Output, Values


@dataclass(frozen=True)
class Graph:
    """What a choice is made by: outputs, names of further inputs, size of the input, metadata, number of names."""

    outputs: tuple[Output, ...]
    inputs: tuple[str, ...]
    size: tuple[int, int]
    notes: Mapping[str, str]
    classes: int | None = None

    @property
    def suppressed(self) -> bool:
        """Whether the metadata say that the table lists what was found, as of YOLO26 and exports with nms=True."""
        return self.notes.get("end2end") == "True" or bool(re.search("nms.{1,3}True", self.notes.get("args", "")))

    def shown(self) -> str:
        """The outputs, for an error text."""
        return ", ".join(f"{o.name} {o.shape}{' whole numbers' if o.whole else ''}" for o in self.outputs)


Pick = Callable[[Graph], tuple[int, ...] | None]


@dataclass(frozen=True)
class Layout:
    """How one family of detectors takes pictures and writes boxes.

    `pick` finds the outputs that `read` takes, None if they are not there; `sure` says whether a graph with such
    outputs is of this family rather than of another. `columns`: the number of classes, from the shapes of what was
    picked; None where they do not tell. `first`: number of the first name of a list of labels.
    """

    wanted: str
    pick: Pick
    read: Callable[[Sequence[np.ndarray], Frame], Found]
    sure: Callable[[Graph], bool]
    columns: Callable[[Sequence[tuple[int, ...]]], int] | None = None
    fit: Fit = "letterbox"
    values: Values = "unit"
    order: Order = "rgb"
    size: int = 640
    first: int = 0
    suppress: bool = True
    threshold: float = 0.25


def choose(name: str, graph: Graph) -> tuple[str, tuple[int, ...]]:
    """The layout of `graph`, and the places of its outputs; `name`: the layout that it has to be.

    "auto": as the metadata say under ``layout``; else as names, shapes and metadata tell.

    Raises `EagorError`, which lists the outputs and the layouts, if none or several fit.
    """
    name = graph.notes.get("layout", name) if name == "auto" else name
    if name != "auto":
        if name not in LAYOUTS:
            raise EagorError(f"layout = {name!r}; wanted auto, {', '.join(LAYOUTS)}")
        picked = LAYOUTS[name].pick(graph)
        if picked is None:
            raise EagorError(
                f"the outputs do not fit layout {name!r}, which wants {LAYOUTS[name].wanted}; they are {graph.shown()}."
                f" Name another layout: {_listed()}"
            )
        return name, picked
    fitting = {key: picked for key, layout in LAYOUTS.items() if (picked := layout.pick(graph)) is not None}
    sure = [key for key in fitting if LAYOUTS[key].sure(graph)]
    if not sure and graph.classes is not None:  # the names may be too many or too few, which is said later
        sure = [key for key in fitting if LAYOUTS[key].sure(replace(graph, classes=None))]
    if len(sure) == 1:
        return sure[0], fitting[sure[0]]
    some = f"could be {' or '.join(sure or fitting)}" if fitting else "fit no layout"
    raise EagorError(
        f"the outputs {some}: {graph.shown()}. Say which by layout=NAME: {_listed()}. For other outputs, call the "
        "network yourself, and give eagor.Detector a function that returns boxes and scores"
    )


def _listed() -> str:
    return "; ".join(f"{key}: {layout.wanted}" for key, layout in LAYOUTS.items())


# --- which outputs ---------------------------------------------------------------------------------------------------


def _places(graph: Graph, rank: int, last: int | None = None, whole: bool = False) -> list[int]:
    """The places of the outputs of so many axes, with `last` entries along the last; of fractional or whole numbers."""
    kind = [at for at, each in enumerate(graph.outputs) if len(each.shape) == rank and each.whole == whole]
    return kind if last is None else [at for at in kind if graph.outputs[at].shape[-1] == last]


def _each_one(*places: list[int]) -> tuple[int, ...] | None:
    """One place of each kind; None unless there is exactly one."""
    return tuple(place for (place,) in places) if all(len(found) == 1 for found in places) else None


def _one(graph: Graph, rank: int, last: int | None = None) -> tuple[int, ...] | None:
    """The only output of so many axes with fractional numbers; its last axis has `last` entries."""
    return _each_one(_places(graph, rank)) and _each_one(_places(graph, rank, last))


def _table(least: int, fits: Callable[[Graph, int, int], bool] = lambda graph, a, b: True) -> Pick:
    """One output ``(1, a, b)`` whose shorter side has at least so many entries, and which `fits`."""

    def pick(graph: Graph) -> tuple[int, ...] | None:
        found = _one(graph, 3)
        if found is None:
            return None
        batch, *sides = graph.outputs[found[0]].shape
        return found if batch == 1 and min(sides) >= least and fits(graph, *sides) else None

    return pick


def _cells(graph: Graph, *counts: float) -> bool:
    """Whether one of `counts` is the number of cells of grids of neighbouring strides, and nothing was suppressed."""
    strides = (4, 8, 16, 32, 64, 128)
    runs = [strides[first : last + 1] for first in range(6) for last in range(first + 1, 6)]
    return not graph.suppressed and any(cells_in(graph.size, run) in counts for run in runs)


def _listed_boxes(graph: Graph, n: int, columns: int) -> bool:
    """Whether a table lists what was found: corners, score, class, and perhaps masks or key points (not an angle)."""
    return columns > 5 and columns != 7 and not _cells(graph, max(n, columns), n / 3)


def _queries_with_scores(graph: Graph, n: int, columns: int) -> bool:
    return not graph.suppressed and graph.classes in (None, columns - 4)


def _named(*wanted: str | tuple[str, ...]) -> Pick:
    """Outputs by name, each one of several names; the last may be missing where it begins with "?"."""

    def pick(graph: Graph) -> tuple[int, ...] | None:
        found: list[int] = []
        for names in wanted:
            names = (names,) if isinstance(names, str) else names
            here = [at for at, each in enumerate(graph.outputs) if each.plain in [n.removeprefix("?") for n in names]]
            if len(here) == 1:
                found += here
            elif not names[0].startswith("?"):
                return None
        return tuple(found)

    return pick


def _three(batch: bool) -> Pick:
    """Boxes ``(n, 4)``, labels ``(n,)`` as whole numbers and scores ``(n,)``, known by their kinds; or with a batch."""
    rank = 2 if batch else 1
    return lambda graph: _each_one(_places(graph, rank + 1, 4), _places(graph, rank, whole=True), _places(graph, rank))


def _boxes_and_logits(graph: Graph) -> tuple[int, ...] | None:
    """Two outputs ``(1, n, 4)`` and ``(1, n, k)``; where k is 4, too, their names tell."""
    tables = _places(graph, 3)
    boxes = [at for at in tables if "box" in graph.outputs[at].plain or graph.outputs[at].plain == "dets"]
    boxes = boxes or _places(graph, 3, 4)
    others = [at for at in tables if at not in boxes]
    if len(boxes) != 1 or len(others) != 1:
        return None
    box, logits = graph.outputs[boxes[0]].shape, graph.outputs[others[0]].shape
    return (boxes[0], others[0]) if box[:2] == logits[:2] and box[-1] == 4 else None


def _dets_and_labels(graph: Graph) -> tuple[int, ...] | None:
    """Boxes with their scores ``(1, n, 5)`` and labels ``(1, n)``."""
    return _each_one(_places(graph, 3, 5), _places(graph, 2, whole=True))


def _maps(graph: Graph) -> tuple[int, ...] | None:
    """Scores ``(1, C, h, w)`` and distances ``(1, 4, h, w)``; where C is 4, too, their names tell."""
    maps = _places(graph, 4)
    if len(maps) != 2 or len({graph.outputs[at].shape[2:] for at in maps}) != 1:
        return None
    by_name = [at for at in maps if graph.outputs[at].plain in ("distances", "wh")]
    by_shape = [at for at in maps if graph.outputs[at].shape[1] == 4]
    distances = by_name if len(by_name) == 1 else by_shape
    if len(distances) != 1 or graph.outputs[distances[0]].shape[1] != 4:
        return None
    return next(at for at in maps if at != distances[0]), distances[0]


# --- which family ----------------------------------------------------------------------------------------------------


def _family(graph: Graph) -> str | None:
    """The family of a graph with one table ``(1, a, b)``: by the number of names, of cells, and of boxes."""
    found = _table(5)(graph)
    if found is None:
        return None
    (_, a, b), name = graph.outputs[found[0]].shape, graph.outputs[found[0]].plain
    grids = [cells_in(graph.size, strides) for strides in STRIDES]
    per_cell, per_anchor = (n in grids for n in (a, b)), a in [3 * count for count in grids]
    rows_are_cells, columns_are_cells = per_cell
    known = graph.classes
    if "rtdetr" in graph.notes.get("description", "").lower().replace("-", ""):
        return "rtdetr"
    if graph.suppressed:
        return "end-to-end"
    if per_anchor and b > 5 and known in (None, b - 5):
        return "yolov5"
    if rows_are_cells and b > 5 and (known == b - 5 or (known is None and b > 6)):
        # YOLOv6 writes boxes in pixels, and calls its output "outputs"; YOLOX calls it "output".
        return "yolov5" if name == "outputs" else "yolox"
    if columns_are_cells and (known is None or a >= 4 + known):
        return "yolov8"
    if rows_are_cells and known == b - 4:
        return "yolov8"
    if a <= 1000 and (b == 6 or graph.notes.get("task") in ("segment", "pose")):
        return "end-to-end"
    if known is not None and a == 4 + known and b > a:
        return "yolov8"
    if known is not None and b == 4 + known and a in (100, 300, 900):
        return "rtdetr"
    return None


def _is(family: str) -> Callable[[Graph], bool]:
    return lambda graph: _family(graph) == family


def _queries(graph: Graph) -> str | None:
    """The family of a graph with boxes and logits: by how many more logits than names there are."""
    picked = _boxes_and_logits(graph)
    if picked is None:
        return None
    columns, names = graph.outputs[picked[1]].shape[-1], {each.plain for each in graph.outputs}
    if {"dets", "labels"} <= names:
        return "rfdetr"
    if graph.classes is not None:
        return {graph.classes + 1: "detr", graph.classes: "rtdetr"}.get(columns)
    return {92: "detr", 80: "rtdetr", 91: "rtdetr", 365: "rtdetr", 366: "rtdetr"}.get(columns)


def _always(graph: Graph) -> bool:
    return True


_TFLITE = "tflite_detection_postprocess"
LAYOUTS: dict[str, Layout] = {
    "yolov5": Layout(
        "one output (1, n, 5 + C), boxes in pixels, objectness (YOLOv5, v6, v7)",
        _table(6, lambda graph, n, columns: _cells(graph, n, n / 3)), decoding.yolov5, _is("yolov5"),
        lambda shapes: shapes[0][2] - 5,
    ),
    "yolov8": Layout(
        "one output (1, 4 + C, n), boxes in pixels (YOLOv8, v9, v11, v12)", _table(5, _cells),
        decoding.yolov8, _is("yolov8"), lambda shapes: min(shapes[0][1:]) - 4,
    ),
    "end-to-end": Layout(
        "one output (1, n, 6): corners, score, class (YOLOv10, YOLO26, exports with nms=True), and perhaps "
        "masks or key points", _table(1, _listed_boxes), decoding.end_to_end, _is("end-to-end"), suppress=False,
    ),
    "yolov7-end-to-end": Layout(
        "one output (n, 7): picture, corners, class, score", lambda graph: _one(graph, 2, 7),
        decoding.yolov7_end_to_end, _always, suppress=False,
    ),
    "yolox": Layout(
        "one output (1, n, 5 + C), boxes in strides from their cells (YOLOX)",
        _table(6, lambda graph, n, columns: _cells(graph, n)), decoding.yolox, _is("yolox"),
        lambda shapes: shapes[0][2] - 5, fit="corner", values="byte", order="bgr",
    ),
    "ssd": Layout(
        "detection_boxes (1, n, 4) y first as fractions, detection_classes, detection_scores, perhaps num_detections "
        "(TensorFlow's object detection)",
        _named("detection_boxes", "detection_classes", "detection_scores", ("?num_detections", "?detection_count")),
        decoding.ssd, _always, fit="stretch", values="byte", size=320, first=1, suppress=False,
    ),
    "ssd-tflite": Layout(
        "TFLite_Detection_PostProcess (1, n, 4), :1 classes, :2 scores, :3 count",
        _named(_TFLITE, f"{_TFLITE}:1", f"{_TFLITE}:2", f"?{_TFLITE}:3"), decoding.ssd, _always,
        fit="stretch", values="signed", size=320, suppress=False,
    ),
    "ssd-rows": Layout(
        "one output (1, 1, n, 7): picture, class, score, corners as fractions (Caffe, OpenVINO)",
        lambda graph: _one(graph, 4, 7), decoding.ssd_rows, _always,
        fit="stretch", values="byte", order="bgr", size=300, suppress=False,
    ),
    "detr": Layout(
        "boxes (1, n, 4) centre and size as fractions, logits (1, n, C + 1), the last for nothing (DETR)",
        _boxes_and_logits, decoding.detr, lambda graph: _queries(graph) == "detr",
        lambda shapes: shapes[1][2] - 1, fit="stretch", values="imagenet", size=800, suppress=False,
    ),
    "rtdetr": Layout(
        "boxes (1, n, 4) centre and size as fractions, logits (1, n, C) (RT-DETR, D-FINE); or one output (1, n, 4 + C) "
        "with probabilities",
        lambda graph: _boxes_and_logits(graph) or _table(5, _queries_with_scores)(graph), decoding.rtdetr,
        lambda graph: "rtdetr" in (_queries(graph), _family(graph)),
        lambda shapes: shapes[1][2] if len(shapes) > 1 else shapes[0][2] - 4, fit="stretch", suppress=False,
    ),
    "rfdetr": Layout(
        "dets (1, n, 4) centre and size as fractions, labels (1, n, C) logits (RF-DETR)", _boxes_and_logits,
        decoding.rtdetr, lambda graph: _queries(graph) == "rfdetr", lambda shapes: shapes[1][2],
        fit="stretch", values="imagenet", size=560, suppress=False,
    ),
    "rtdetr-boxes": Layout(
        "boxes (1, n, 4) by corners in pixels, labels (1, n), scores (1, n), and an input orig_target_sizes",
        _three(True), decoding.listed, lambda graph: "orig_target_sizes" in graph.inputs, fit="stretch", suppress=False,
    ),
    "torchvision": Layout(
        "boxes (n, 4) by corners in pixels, labels (n,) whole numbers, scores (n,)", _three(False), decoding.listed,
        _always, first=1, suppress=False,
    ),
    "mmdet": Layout(
        "dets (1, n, 5): corners in pixels and the score; labels (1, n) (MMDetection)", _dets_and_labels,
        decoding.mmdet, _always, fit="corner", values="imagenet", suppress=False,
    ),
    "centernet": Layout(
        "scores (1, C, h, w), distances (1, 4, h, w) to left, top, right, bottom in pixels (CenterNet)", _maps,
        decoding.centernet, _always, lambda shapes: shapes[0][1], fit="stretch", values="byte", size=512, threshold=0.2,
    ),
}  # fmt: skip
