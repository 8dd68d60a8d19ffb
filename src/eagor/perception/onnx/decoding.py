"""From the outputs of a network to boxes: one function for each way in which detectors write them; suppression.

Each takes the outputs that its layout names, the `Frame`, and gives `Found`: boxes x0, y0, x1, y1 in pixels of the
network's input. A box comes once for each of its classes that reaches the threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit

from eagor.errors import ResponseError

STRIDES = ((8, 16, 32), (8, 16, 32, 64), (4, 8, 16, 32))  # of the grids that YOLO networks look at
MOST_READ = 30_000  # boxes of a picture that are read on: the best
MOST_COMPARED = 2000  # boxes that are compared with each other: the best
_SLACK = 1e-3  # by which a probability of 16 bits may leave [0, 1]


class Found(NamedTuple):
    """Boxes ``(n, 4)``, their scores ``(n,)`` in [0, 1], and the numbers ``(n,)`` of their classes."""

    boxes: np.ndarray
    scores: np.ndarray
    classes: np.ndarray


@dataclass(frozen=True)
class Frame:
    """What reading needs to know: rows and columns of the input, the least score, how many classes where it is known.

    `sigmoid`: scores are logits, and want the logistic function.
    """

    size: tuple[int, int]
    threshold: float
    classes: int | None = None
    sigmoid: bool = False

    @property
    def sides(self) -> np.ndarray:
        """Columns, rows, columns, rows: what turns fractions x0, y0, x1, y1 into pixels."""
        return np.array([self.size[1], self.size[0]] * 2, dtype=np.float64)


def probabilities(scores: np.ndarray, sigmoid: bool = False) -> np.ndarray:
    """`scores` as they are, or through the logistic function. Raises `ResponseError` unless all are in [0, 1]."""
    scores = expit(np.asarray(scores, dtype=np.float64)) if sigmoid else np.asarray(scores, dtype=np.float64)
    if scores.size and not (scores.min() >= -_SLACK and scores.max() <= 1 + _SLACK):
        raise ResponseError(
            f"the network gives scores from {scores.min():.3g} to {scores.max():.3g}; wanted [0, 1]. If these are "
            "logits, say sigmoid=true; if not, name the right layout=..., or the values=... of the input"
        )
    return np.clip(scores, 0, 1)


def corners(boxes: np.ndarray) -> np.ndarray:
    """Boxes ``(n, 4)`` as centre x, y, width, height, by their corners."""
    centre, half = boxes[:, :2], boxes[:, 2:4] / 2
    return np.concatenate([centre - half, centre + half], axis=1)


def of_table(boxes: np.ndarray, scores: np.ndarray, frame: Frame) -> Found:
    """Boxes ``(n, 4)`` with a score for each class ``(n, C)``."""
    row, column = np.nonzero(scores >= frame.threshold)
    best = _best(scores[row, column])
    row, column = row[best], column[best]
    return Found(boxes[row], scores[row, column], column)


def _best(scores: np.ndarray) -> np.ndarray | slice:
    """The places of the `MOST_READ` best, in their order; of equal scores the earlier is the better."""
    if len(scores) <= MOST_READ:
        return slice(None)
    return np.sort(np.argsort(-scores, kind="stable")[:MOST_READ])


def of_list(boxes: np.ndarray, scores: np.ndarray, classes: np.ndarray, frame: Frame) -> Found:
    """Boxes ``(n, 4)`` with one score and one class each; classes may be written as floats."""
    scores = probabilities(scores, frame.sigmoid)
    keep = np.flatnonzero(scores >= frame.threshold)
    keep = keep[_best(scores[keep])]
    numbers = np.rint(np.asarray(classes, dtype=np.float64))[keep]
    if np.abs(numbers - np.asarray(classes, dtype=np.float64)[keep]).max(initial=0) > _SLACK or (numbers < 0).any():
        raise ResponseError(
            f"the network gives classes such as {np.asarray(classes)[keep][:3].tolist()}; wanted whole numbers from 0: "
            "name the right layout=..."
        )
    return Found(np.asarray(boxes, dtype=np.float64)[keep], scores[keep], numbers.astype(np.int64))


def yolov5(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """``(1, n, 5 + C)``: centre, size, objectness, a score for each class."""
    table = outputs[0][0].astype(np.float64)
    scores = probabilities(table[:, 4:], frame.sigmoid)
    return of_table(corners(table), scores[:, :1] * scores[:, 1:], frame)


def yolov8(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """``(1, 4 + C, n)`` or its transpose: centre, size, a score for each class; then perhaps masks or key points."""
    table = upright(outputs[0][0], frame.classes).astype(np.float64)
    stop = None if frame.classes is None else 4 + frame.classes
    return of_table(corners(table), probabilities(table[:, 4:stop], frame.sigmoid), frame)


def upright(table: np.ndarray, classes: int | None) -> np.ndarray:
    """A table ``(4 + C, n)``, or ``(n, 4 + C)``, as the latter: C tells which, or that boxes outnumber classes."""
    rows, columns = table.shape
    if classes is not None and (rows == 4 + classes) != (columns == 4 + classes):
        return table.T if rows == 4 + classes else table
    return table.T if rows <= columns else table


def end_to_end(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """``(1, n, 6)``: corners, score, class, perhaps masks or key points; nothing is left to suppress."""
    table = outputs[0][0]
    return of_list(table[:, :4], table[:, 4], table[:, 5], frame)


def yolov7_end_to_end(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """``(n, 7)``: picture, corners, class, score; nothing is left to suppress."""
    table = outputs[0]
    return of_list(table[:, 1:5], table[:, 6], table[:, 5], frame)


def yolox(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """``(1, n, 5 + C)``: offset from the cell in strides, logarithm of the size in strides, objectness, classes."""
    table = outputs[0][0].astype(np.float64)
    cells, stride = yolox_cells(frame.size, len(table))
    with np.errstate(over="ignore"):
        sides = np.exp(table[:, 2:4])
    boxes = np.concatenate([table[:, :2] + cells, sides], axis=1) * stride[:, None]
    scores = probabilities(table[:, 4:], frame.sigmoid)
    return of_table(corners(boxes), scores[:, :1] * scores[:, 1:], frame)


def yolox_cells(size: tuple[int, int], count: int) -> tuple[np.ndarray, np.ndarray]:
    """The cells ``(n, 2)`` x, y of the grids of an input, row by row, finest first, and their strides ``(n,)``."""
    for strides in STRIDES:
        if cells_in(size, strides) == count:
            shapes = [(-(-size[0] // step), -(-size[1] // step)) for step in strides]
            cells = [np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).reshape(-1, 2) for h, w in shapes]
            steps = [np.full(len(c), step) for c, step in zip(cells, strides, strict=True)]
            return np.concatenate(cells).astype(np.float64), np.concatenate(steps).astype(np.float64)
    counts = ", ".join(str(cells_in(size, strides)) for strides in STRIDES)
    raise ResponseError(
        f"the network gives {count} boxes for an input of {size[1]} x {size[0]}; YOLOX has one per cell, {counts}. "
        "Name the right layout=..."
    )


def cells_in(size: tuple[int, int], strides: Sequence[int]) -> int:
    """How many cells grids with these strides have on an input of `size` (rows, columns)."""
    return sum(-(-size[0] // step) * -(-size[1] // step) for step in strides)


def ssd(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """Boxes ``(1, n, 4)`` y0, x0, y1, x1 as fractions, classes ``(1, n)``, scores ``(1, n)``, and perhaps a count."""
    boxes, classes, scores = (each[0] for each in outputs[:3])
    count = int(np.ravel(outputs[3])[0]) if len(outputs) > 3 else len(boxes)
    boxes, classes, scores = boxes[:count], classes[:count], scores[:count]
    return of_list(boxes[:, [1, 0, 3, 2]] * frame.sides, scores, classes, frame)


def ssd_rows(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """``(1, 1, n, 7)``: picture, class, score, corners as fractions; what has a picture below 0 is filling."""
    table = outputs[0].reshape(-1, 7)
    table = table[table[:, 0] >= 0]
    return of_list(table[:, 3:7] * frame.sides, table[:, 2], table[:, 1], frame)


def detr(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """Boxes ``(1, n, 4)`` centre, size as fractions; logits ``(1, n, C + 1)``, the last of them "nothing"."""
    boxes, logits = (each[0].astype(np.float64) for each in outputs)
    share = np.exp(logits - logits.max(axis=-1, keepdims=True))
    share /= share.sum(axis=-1, keepdims=True)
    return of_table(corners(boxes) * frame.sides, share[:, :-1], frame)


def rtdetr(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """Boxes ``(1, n, 4)`` centre, size as fractions; logits ``(1, n, C)``, each class by itself.

    Or one output ``(1, n, 4 + C)``: boxes so, and probabilities.
    """
    if len(outputs) == 1:
        table = outputs[0][0].astype(np.float64)
        return of_table(corners(table) * frame.sides, probabilities(table[:, 4:], frame.sigmoid), frame)
    boxes, logits = (each[0].astype(np.float64) for each in outputs)
    return of_table(corners(boxes) * frame.sides, expit(logits), frame)


def listed(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """Boxes ``(n, 4)`` by corners in pixels, labels ``(n,)``, scores ``(n,)``; or the same with a batch of one."""
    boxes, labels, scores = outputs
    return of_list(boxes.reshape(-1, 4), scores.reshape(-1), labels.reshape(-1), frame)


def mmdet(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """``(1, n, 5)``: corners in pixels and the score; labels ``(1, n)``."""
    table = outputs[0].reshape(-1, 5)
    return of_list(table[:, :4], table[:, 4], outputs[1].reshape(-1), frame)


def centernet(outputs: Sequence[np.ndarray], frame: Frame) -> Found:
    """Scores ``(1, C, h, w)``, distances ``(1, 4, h, w)`` to the left, top, right, bottom in pixels of the input.

    The peaks are cells that no neighbour of 3 x 3 exceeds; distances count from the cell's top left corner.
    """
    maps, distances = outputs[0][0], outputs[1][0].astype(np.float64)
    if frame.sigmoid:
        maps = expit(maps.astype(np.float64))
    # Few of a million scores reach the threshold: only these are read further, and the extremes are checked.
    probabilities(np.array([maps.min(), maps.max()]) if maps.size else maps)
    kind, row, column = np.unravel_index(np.flatnonzero(maps >= _in_kind(frame.threshold, maps.dtype)), maps.shape)
    scores = np.clip(maps[kind, row, column].astype(np.float64), 0, 1)
    near = [
        maps[kind, np.clip(row + down, 0, maps.shape[1] - 1), np.clip(column + across, 0, maps.shape[2] - 1)]
        for down in (-1, 0, 1)
        for across in (-1, 0, 1)
    ]
    peaks = np.max(near, axis=0) <= maps[kind, row, column]
    scores, kind, row, column = scores[peaks], kind[peaks], row[peaks], column[peaks]
    best = _best(scores)
    scores, kind, row, column = scores[best], kind[best], row[best], column[best]
    x, y = column * frame.size[1] / maps.shape[2], row * frame.size[0] / maps.shape[1]
    left, top, right, bottom = distances[:, row, column]
    return Found(np.stack([x - left, y - top, x + right, y + bottom], axis=1), scores, kind)


def _in_kind(threshold: float, dtype: np.dtype) -> Any:
    """The least number of this kind that is not below `threshold`: comparing in the array's own kind copies nothing."""
    if dtype.kind != "f":
        return threshold
    level = dtype.type(threshold)
    return level if float(level) >= threshold else np.nextafter(level, dtype.type(np.inf))


# --- suppression ------------------------------------------------------------------------------------------------------


def overlaps(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Intersection over union ``(n, m)`` of `boxes` ``(n, 4)`` and `others` ``(m, 4)``; x0, y0, x1, y1.

    Boxes without area overlap nothing.
    """
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    shared = np.prod(np.clip(high - low, 0, None), axis=-1)
    areas, further = (np.prod(np.clip(b[:, 2:] - b[:, :2], 0, None), axis=-1) for b in (boxes, others))
    union = areas[:, None] + further[None, :] - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)


def kept(boxes: np.ndarray, scores: np.ndarray, classes: np.ndarray | None = None, most: float = 0.5) -> np.ndarray:
    """The places ``(k,)`` of the boxes that stay, the best first.

    A box falls if a better one that stays has its class and overlaps it by more than `most` (intersection over union).
    Of equal scores the earlier is the better. `boxes` ``(n, 4)``, `scores` ``(n,)``, `classes` ``(n,)`` whole numbers
    (None: all are of one). Beyond the best `MOST_COMPARED` boxes none stays.
    """
    order = np.argsort(-np.asarray(scores), kind="stable")[:MOST_COMPARED]
    boxes = np.asarray(boxes, dtype=np.float32)[order]
    beats = np.triu(overlaps(boxes, boxes) > most, 1)  # [better, worse]
    if classes is not None:
        own = np.asarray(classes)[order]
        beats &= own[:, None] == own[None, :]
    beats = beats.astype(np.float32)
    # What falls depends on better boxes only: each pass settles at least one more rank, few passes settle all.
    stays = np.ones(len(order), dtype=bool)
    while True:
        again = (stays.astype(np.float32) @ beats) == 0
        if np.array_equal(again, stays):
            return order[stays]
        stays = again
