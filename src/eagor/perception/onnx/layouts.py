"""The layouts in which families of detectors write boxes, which of them a file's metadata settle, and names of classes.

Where they settle none, none is guessed: with the wrong one a box is wrong, and its score is not. An error lists the
outputs and the layouts instead.
"""

from __future__ import annotations

import ast
import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit, softmax

from eagor._checks import shown
from eagor._files import read_file
from eagor.errors import EagorError, FormatError

MASKS = 32  # further columns of Ultralytics' tables with masks
STRIDE = 4  # pixels per cell of CenterNet
BOXES = ("box", "dets", "distances", "wh")  # in the names of outputs that hold boxes

Arrays = Sequence[np.ndarray]


@dataclass(frozen=True)
class Layout:
    """How one family of detectors takes pictures and writes boxes.

    - `outputs`: their shapes, boxes first, for so many classes and further columns (masks, key points); None: any.
    - `read`: from these outputs without the axis of the batch, the number of classes and the least score: boxes
      ``(n, 4)``, and scores ``(n, C)`` for each class, or ``(n,)`` and the numbers ``(n,)`` of the classes.
    - `centred`: boxes are centre and size, else corners. `fractions`: of the input's sides, else pixels.
    - `first`: number of the first name of a list of labels. `suppressed`: one box is left for each thing. `logits`:
      the second output is no probabilities.
    """

    title: str
    outputs: Callable[[int, int], Sequence[tuple[int | None, ...]]]
    read: Callable[[Arrays, int, float], Sequence[np.ndarray]]
    centred: bool = False
    fractions: bool = False
    suppressed: bool = True
    logits: bool = False
    fit: str = "stretch"
    values: str = "unit"
    size: int = 640
    first: int = 0
    threshold: float = 0.25


def _peaks(outputs: Arrays, classes: int, threshold: float) -> tuple[np.ndarray, ...]:
    """CenterNet's: peaks are cells that no neighbour of 3 x 3 exceeds; distances are from a cell's top left corner."""
    distances, scores = outputs
    kind, row, column = np.nonzero(scores >= threshold)  # a few of a million
    padded = np.pad(scores, [(0, 0), (1, 1), (1, 1)], mode="edge")
    around = [padded[kind, row + down, column + across] for down, across in np.ndindex(3, 3)]
    peaks = scores[kind, row, column] >= np.max(around, axis=0, initial=-np.inf)
    kind, row, column = kind[peaks], row[peaks], column[peaks]
    corners = STRIDE * np.stack([column, row, column, row], axis=1)
    return corners + distances[:, row, column].T * [-1, -1, 1, 1], scores[kind, row, column], kind


LAYOUTS: dict[str, Layout] = {
    "yolov5": Layout(
        "one output (1, n, 5 + C): centre, size in pixels, objectness, classes (YOLOv5, v6, v7)",
        lambda c, more: [(1, None, 5 + c)], lambda o, c, t: (o[0][:, :4], o[0][:, 4:5] * o[0][:, 5:]),
        centred=True, suppressed=False, fit="letterbox",
    ),
    "yolov8": Layout(
        "one output (1, 4 + C, n): centre, size in pixels, classes (YOLOv8, v9, 11, 12)",
        lambda c, more: [(1, 4 + c + more, None)], lambda o, c, t: (o[0][:4].T, o[0][4 : 4 + c].T),
        centred=True, suppressed=False, fit="letterbox",
    ),
    "end-to-end": Layout(
        "one output (1, n, 6): corners in pixels, score, class (YOLOv10, YOLO26, exports with nms=True)",
        lambda c, more: [(1, None, 6 + more)], lambda o, c, t: (o[0][:, :4], o[0][:, 4], o[0][:, 5]), fit="letterbox",
    ),
    "detr": Layout(
        "boxes (1, n, 4): centre, size as fractions; logits (1, n, C + 1), the last for nothing (DETR)",
        lambda c, more: [(1, None, 4), (1, None, c + 1)], lambda o, c, t: (o[0], softmax(o[1], axis=-1)[:, :-1]),
        centred=True, fractions=True, logits=True, values="imagenet", size=800,
    ),
    "rtdetr": Layout(
        "boxes (1, n, 4): centre, size as fractions; logits (1, n, C) (RT-DETR, D-FINE)",
        lambda c, more: [(1, None, 4), (1, None, c)], lambda o, c, t: (o[0], expit(o[1])),
        centred=True, fractions=True, logits=True,
    ),
    "rfdetr": Layout(
        "the same, from colours standardised as ImageNet's (RF-DETR, Deformable DETR)",
        lambda c, more: [(1, None, 4), (1, None, c)], lambda o, c, t: (o[0], expit(o[1])),
        centred=True, fractions=True, logits=True, values="imagenet", size=560,
    ),
    "rtdetr-table": Layout(
        "one output (1, n, 4 + C): centre, size as fractions, classes (RT-DETR by Ultralytics)",
        lambda c, more: [(1, None, 4 + c)], lambda o, c, t: (o[0][:, :4], o[0][:, 4:]), centred=True, fractions=True,
    ),
    "rtdetr-boxes": Layout(
        "boxes (1, n, 4) by corners in pixels, scores (1, n), labels (1, n) (RT-DETR, D-FINE with post-processing)",
        lambda c, more: [(1, None, 4), (1, None), (1, None)], lambda o, c, t: o,
    ),
    "torchvision": Layout(
        "boxes (n, 4) by corners in pixels, scores (n,), labels (n,)",
        lambda c, more: [(None, 4), (None,), (None,)], lambda o, c, t: o, fit="letterbox", first=1,
    ),
    "centernet": Layout(
        "distances (1, 4, h, w) to left, top, right, bottom in pixels, scores (1, C, h, w) (CenterNet)",
        lambda c, more: [(1, 4, None, None), (1, c, None, None)], _peaks,
        suppressed=False, values="byte", size=512, threshold=0.2,
    ),
}  # fmt: skip


def choose_layout(
    stated: str | None, metadata: Mapping[str, str], outputs: Mapping[str, np.ndarray], classes: int
) -> tuple[str, tuple[str, ...]]:
    """The layout of a network, and the names of its outputs in the order in which the layout reads them.

    `stated`: by the user, None: by nobody. Raises `EagorError` where the metadata settle nothing and nothing is stated,
    where they contradict what is, and where the outputs do not fit.
    """
    task = metadata.get("task", "detect")
    if task not in ("detect", "segment", "pose"):
        raise EagorError(f"it was made for the task {task!r}; wanted a detector of upright boxes")
    key_points = [int(side) for side in re.findall(r"\d+", metadata.get("kpt_shape", "[17, 3]"))]
    more = {"detect": 0, "segment": MASKS, "pose": int(np.prod(key_points))}[task]
    picks = {name: picked for name in LAYOUTS if (picked := _match_outputs(name, outputs, classes, more))}
    listing = "; ".join(f"{name}: {LAYOUTS[name].title}" for name in picks or LAYOUTS)
    shapes = ", ".join(f"{name} {array.shape}" for name, array in outputs.items()) + f", of {classes} classes"
    settled = _layout_in_metadata(metadata, picks)
    if not stated and not settled:
        raise EagorError(
            f"its metadata do not say how it writes boxes: {shapes}. Say it by layout=NAME; by the shapes "
            f"{'it can be' if picks else 'it is none of'} {listing}. For other outputs, call the network yourself, and "
            "give eagor.Detector a function that returns boxes and scores"
        )
    name = stated or settled or ""
    if settled not in (name, None):
        raise EagorError(f"layout = {name!r}, and the file's metadata say {settled!r}; leave layout out")
    if name not in picks:
        raise EagorError(
            f"the outputs do not fit layout {name!r}; they are {shapes}. Wanted as many labels=... as there are "
            f"classes, and {'a layout that fits' if picks else 'one of the layouts'}: {listing}"
        )
    return name, picks[name]


def _layout_in_metadata(metadata: Mapping[str, str], picks: Mapping[str, Any]) -> str | None:
    """The layout that the metadata settle: our own, under ``layout``; those of Ultralytics, with a task; YOLOv5's."""
    if "task" not in metadata:
        return metadata.get("layout") or ("yolov5" if {"stride", "names"} <= metadata.keys() else None)
    if "rtdetr" in metadata.get("description", "").lower().replace("-", ""):
        return "rtdetr-table"
    if metadata.get("end2end") == "True" or re.search("nms.{1,3}True", metadata.get("args", "")):
        return "end-to-end"
    tables = [name for name in ("yolov8", "end-to-end") if name in picks]
    return tables[0] if len(tables) == 1 else None  # early exports of YOLOv10 do not say what they are: shapes do


def _match_outputs(name: str, outputs: Mapping[str, np.ndarray], classes: int, more: int) -> tuple[str, ...] | None:
    """The names of the outputs that a layout reads; None unless there is exactly one for each of its shapes.

    Of two with the same shape, boxes are known by their name, and labels by whole numbers.
    """
    if name == "detr" and "dets" in outputs:  # RF-DETR with one class more than there are labels: no softmax
        return None
    picked: list[str] = []
    for place, shape in enumerate(LAYOUTS[name].outputs(classes, more)):
        fits = [
            key for key, array in outputs.items()
            if key not in picked and array.ndim == len(shape) and (place == 2) == (array.dtype.kind in "iu")
            and all(wanted in (None, side) for wanted, side in zip(shape, array.shape, strict=True))
        ]  # fmt: skip
        if len(fits) > 1 and not picked:
            fits = [key for key in fits if any(word in key.lower() for word in BOXES)]
        if len(fits) != 1:
            return None
        picked += fits
    return tuple(picked)


# --- what classes are called ------------------------------------------------------------------------------------------

MOST = 100_000  # classes
WANTED = "wanted a list of names, or names by number"
_NOTHING = {"background", "__background__", "n/a", "none", "???", ""}  # what numbers are called that no class has
_NUMBERED = re.compile(r"(\d+)\s*[:=,\t ]\s*(.+)")

Labels = str | os.PathLike[str] | Sequence[str] | Mapping[int, str]


def names_of(labels: Labels, first: int, where: str = "labels") -> tuple[str, ...]:
    """The names of classes in the order of their numbers, "" for a number without a class.

    `labels`: a file (`read_labels`), a list, or names by number. `first`: the number of the first name of a list that
    does not begin with the background, which has number 0. Raises `FormatError` for what is no such thing.
    """
    listed: Any = labels
    if isinstance(labels, str | os.PathLike):
        where, listed = f"the labels in {os.fspath(labels)}", read_labels(labels)
    try:
        if not isinstance(listed, Mapping):
            listed = dict(enumerate(listed, 0 if listed[0].strip().lower() in _NOTHING else first))
        names = {int(number): name.strip() for number, name in listed.items()}
    except (TypeError, ValueError, AttributeError, IndexError):
        names = {}
    names = {number: "" if name.lower() in _NOTHING else name for number, name in names.items()}
    if not any(names.values()) or min(names) < 0 or max(names) >= MOST:
        raise FormatError(f"{where}: {shown(listed)}; {WANTED}")
    return tuple(names.get(number, "") for number in range(max(names) + 1))


def read_labels(path: str | os.PathLike[str]) -> Any:
    """The labels in a text file: one per line, ``id name`` on each line, or a list or an object as JSON.

    Empty lines at the end do not count. Raises `FormatError`, which says what is wrong where.
    """
    try:
        text = read_file(path).decode("utf-8-sig").rstrip()
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read ({error}); wanted a text file of labels, one per line") from error
    if not text:
        raise FormatError(f"{path} has no labels; wanted one per line, 'id name' lines, or a JSON list")
    if text.lstrip()[0] in "[{":
        return literal(text, str(path))
    lines = [line.strip() for line in text.splitlines()]
    numbered = [match.groups() for line in lines if (match := _NUMBERED.fullmatch(line))]
    if len(numbered) < len(lines):
        return lines
    if len({int(number) for number, _ in numbered}) < len(numbered):
        raise FormatError(f"{path} has a number twice; wanted 'id name' lines, each id once")
    return {number: name for number, name in numbered}


def literal(text: str, where: str) -> Any:
    """A list or mapping written as JSON or as Python writes it; nothing in it is run. Raises `FormatError`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's own, of "1in" or a backslash
            return ast.literal_eval(text.strip())
    except (ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
        raise FormatError(f"{where} cannot be read: {shown(text)}; {WANTED}") from None
