"""What detectors return, as boxes, scores and labels: known by its attributes, so that no library is imported.

`boxes_of` reads supervision's ``Detections``, Ultralytics' results, dictionaries as of torchvision and of Hugging
Face's post-processing (tensors too), MediaPipe's results, the blob of an SSD in OpenCV, lists of dictionaries as in
COCO's results and in pipelines, and plain arrays. Whatever it is, it is checked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from eagor._arrays import to_numpy
from eagor._json import shown
from eagor.errors import ResponseError

_SLACK = 1e-6  # by which rounding may take a probability out of [0, 1]

Names = Sequence[str] | Mapping[int, str]
WANTED = (
    "(boxes, scores) or (boxes, scores, labels); supervision's Detections; Ultralytics' results; a dictionary with "
    "boxes, scores, labels; MediaPipe's results; an SSD blob (1, 1, n, 7); a list of dictionaries with bbox (x, y, w, "
    "h) or box"
)


class Boxes(NamedTuple):
    """Boxes ``(n, 4)`` x0, y0, x1, y1 in pixels, scores ``(n,)`` in [0, 1], and n labels, or None where none came."""

    boxes: np.ndarray
    scores: np.ndarray
    labels: list[str] | None = None


def boxes_of(found: Any, names: Names | None = None, shape: Sequence[int] | None = None) -> Boxes:
    """The boxes, scores and labels in what a detector returned for one picture.

    `names`: of the classes, where `found` numbers them: a list, or names by number. `shape`: the picture's, (h, w) or
    (h, w, 3), for detectors that write fractions of it (OpenCV's SSD, MediaPipe's older solutions).

    Boxes without area are left out. Raises `ResponseError`, which says what came and what was wanted, for anything
    else, boxes with x0 > x1 or y0 > y1, numbers that are not finite, lengths that differ, fractions where pixels were
    wanted, scores outside [0, 1], and numbers of classes without names.
    """
    if isinstance(found, Sequence) and len(found) == 1 and _reader(found[0]) and not isinstance(found[0], Mapping):
        found = found[0]  # a batch of one
    read = _reader(found)
    if read is None:
        raise ResponseError(f"the detector returned {_kind(found)}; wanted {WANTED}")
    try:
        boxes, scores, labels, own = read(found, shape)
    except (KeyError, AttributeError, TypeError, IndexError) as error:
        raise ResponseError(f"the detector returned {_kind(found)} without {error}; wanted {WANTED}") from error
    return _checked(boxes, scores, labels, names if names is not None else own)


def _checked(boxes: Any, scores: Any, labels: Any, names: Names | None) -> Boxes:
    corners, values = _numbers(boxes, "boxes"), _numbers(scores, "scores").reshape(-1)
    corners = corners.reshape(0, 4) if corners.size == 0 else corners
    if corners.ndim != 2 or corners.shape[1] != 4:
        raise ResponseError(f"boxes of shape {corners.shape} came; wanted (n, 4): x0, y0, x1, y1 in pixels")
    if len(values) != len(corners):
        raise ResponseError(f"{len(corners)} boxes and {len(values)} scores came; wanted as many of each")
    for what, each in (("boxes", corners), ("scores", values)):
        if not np.isfinite(each).all():
            raise ResponseError(f"{what} came that are not finite; wanted numbers")
    if values.size and not (values.min() >= -_SLACK and values.max() <= 1 + _SLACK):
        raise ResponseError(
            f"scores from {values.min():.4g} to {values.max():.4g} came; scores outside [0, 1] want a stated "
            "squashing: 1 / (1 + exp(-score)) for logits, score / 100 for percents"
        )
    if wrong := np.flatnonzero((corners[:, 0] > corners[:, 2]) | (corners[:, 1] > corners[:, 3])).tolist():
        raise ResponseError(
            f"the box {corners[wrong[0]].tolist()} came; wanted x0 < x1 and y0 < y1. If it is x, y, width, height, add "
            "x to the width and y to the height"
        )
    if corners.size and corners.max() <= 1 and (corners[:, 2:] - corners[:, :2]).any():
        raise ResponseError(
            f"boxes came within {corners.max():.3g} of the corner: they seem to be fractions of the picture. Wanted "
            "pixels: multiply x by its width and y by its height"
        )
    texts = None if labels is None else _texts(labels, names, len(corners))
    real = np.flatnonzero((corners[:, 2] > corners[:, 0]) & (corners[:, 3] > corners[:, 1]))
    return Boxes(corners[real], np.clip(values[real], 0, 1), None if texts is None else [texts[at] for at in real])


def _texts(labels: Any, names: Names | None, count: int) -> list[str]:
    found = labels if isinstance(labels, list | tuple) else np.ravel(to_numpy(labels)).tolist()
    if len(found) != count:
        raise ResponseError(f"{count} boxes and {len(found)} labels came; wanted as many of each")
    texts: list[str] = []
    for each in found:
        if isinstance(each, str):
            texts.append(each)
            continue
        value = float(each) if np.ndim(each) == 0 else float("nan")
        if not value.is_integer():
            raise ResponseError(f"the label {shown(each)} came; wanted a text, or the number of a class")
        if names is None:
            raise ResponseError(
                f"labels came as numbers, such as {int(value)}; wanted texts, or names=... of the classes. If all "
                "boxes are what was asked for, return boxes and scores alone"
            )
        try:
            texts.append(str(names[int(value)] if value >= 0 else {}[int(value)]))
        except (KeyError, IndexError):
            raise ResponseError(
                f"the label {int(value)} came, and names has {len(names)} entries without it; wanted a name for "
                "each class"
            ) from None
    return texts


def _numbers(values: Any, what: str) -> np.ndarray:
    try:
        return np.asarray(to_numpy(values), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ResponseError(f"{what} came as {_kind(values)}; wanted numbers, ({what[0]}, 4)" if what == "boxes" else
                            f"{what} came as {_kind(values)}; wanted one number for each box") from error  # fmt: skip


def _kind(found: Any) -> str:
    if isinstance(found, Mapping):
        return f"a dictionary with {', '.join(map(str, [*found][:8])) or 'nothing in it'}"
    if isinstance(found, list | tuple):
        return f"a {type(found).__name__} of {len(found)}" + (f" ({type(found[0]).__name__}, ...)" if found else "")
    if hasattr(found, "shape"):
        return f"an array of shape {tuple(found.shape)}"
    return f"{type(found).__module__}.{type(found).__qualname__}"


# --- one reader for each kind: boxes, scores, labels or None, names or None -----------------------------------------

_Read = tuple[Any, Any, Any, "Names | None"]


def _supervision(found: Any, _: Any) -> _Read:
    if found.confidence is None:
        raise ResponseError(
            "supervision's Detections came without confidence; wanted scores: detections.confidence = "
            "numpy.ones(len(detections)) if there are none"
        )
    named = found.data.get("class_name") if getattr(found, "data", None) else None
    return found.xyxy, found.confidence, found.class_id if named is None else [str(name) for name in named], None


def _ultralytics(found: Any, _: Any) -> _Read:
    boxes = found.boxes
    return boxes.xyxy, boxes.conf, boxes.cls, getattr(found, "names", None)


def _mapping(found: Mapping[str, Any], _: Any) -> _Read:
    labels = next((found[key] for key in ("text_labels", "label_names", "labels") if found.get(key) is not None), None)
    return found["boxes"], found["scores"], labels, None


def _mediapipe(found: Any, shape: Sequence[int] | None) -> _Read:
    boxes, scores, labels = [], [], []
    for each in found.detections or ():
        if hasattr(each, "bounding_box"):  # the tasks
            box, best = each.bounding_box, max(each.categories, key=lambda category: category.score)
            corner = [box.origin_x, box.origin_y]
            boxes.append([*corner, corner[0] + box.width, corner[1] + box.height])
            scores.append(best.score)
            labels.append(best.category_name or best.index)
        else:  # the older solutions: faces, and fractions of the picture
            height, width = _sides(shape, "MediaPipe's relative boxes")
            box = each.location_data.relative_bounding_box
            boxes.append([box.xmin * width, box.ymin * height, (box.xmin + box.width) * width,
                          (box.ymin + box.height) * height])  # fmt: skip
            scores.append(each.score[0])
            labels.append("face")
    return boxes, scores, None if None in labels else labels, None


def _blob(found: Any, shape: Sequence[int] | None) -> _Read:
    rows = to_numpy(found).reshape(-1, 7)
    rows = rows[(rows[:, 0] >= 0) & (rows[:, 2] > 0)]
    height, width = _sides(shape, "the boxes of an SSD blob")
    return rows[:, 3:] * [width, height, width, height], rows[:, 2], rows[:, 1], None


def _records(found: Sequence[Mapping[str, Any]], _: Any) -> _Read:
    boxes, scores, labels = [], [], []
    for each in found:
        boxes.append(_box(each))
        scores.append(each["confidence" if "confidence" in each else "score"])
        labels.append(
            next((each[key] for key in ("label", "category", "name", "class", "category_id") if key in each), None)
        )
    if any(label is None for label in labels):
        if not all(label is None for label in labels):
            raise ResponseError("some dictionaries came with a label, some without; wanted all or none")
        return boxes, scores, None, None
    return boxes, scores, labels, None


def _box(record: Mapping[str, Any]) -> list[float]:
    """``bbox``: x, y, width, height, as COCO has it; ``box``: corners, by name or in a row."""
    if "bbox" in record:
        x, y, width, height = (float(value) for value in record["bbox"])
        return [x, y, x + width, y + height]
    box = record["box"]
    corners = (box[key] for key in ("xmin", "ymin", "xmax", "ymax")) if isinstance(box, Mapping) else box
    x0, y0, x1, y1 = (float(value) for value in corners)
    return [x0, y0, x1, y1]


def _plain(found: Sequence[Any], _: Any) -> _Read:
    return found[0], found[1], found[2] if len(found) == 3 else None, None


def _sides(shape: Sequence[int] | None, what: str) -> tuple[int, int]:
    if shape is None or len(shape) < 2:
        raise ResponseError(f"{what} are fractions of the picture; wanted shape=picture.shape as well")
    return int(shape[0]), int(shape[1])


def _reader(found: Any) -> Callable[[Any, Sequence[int] | None], _Read] | None:
    """Who reads `found`; None if nobody does."""
    if isinstance(found, Mapping):
        return _mapping if {"boxes", "scores"} <= {*found} else None
    if hasattr(found, "xyxy") and hasattr(found, "confidence"):
        return _supervision
    if hasattr(found, "boxes") and all(hasattr(found.boxes, name) for name in ("xyxy", "conf", "cls")):
        return _ultralytics
    if hasattr(found, "detections"):
        return _mediapipe
    if hasattr(found, "shape"):
        return _blob if len(found.shape) == 4 and found.shape[-1] == 7 else None
    if not isinstance(found, Sequence) or isinstance(found, str | bytes):
        return None
    if all(isinstance(each, Mapping) and ("bbox" in each or "box" in each) for each in found):
        return _records
    if len(found) == 1 and isinstance(found[0], Mapping):
        return (lambda batch, shape: _mapping(batch[0], shape)) if _reader(found[0]) else None
    return _plain if len(found) in (2, 3) and not isinstance(found[0], Mapping | str) else None
