"""What detectors return, read and checked: boxes, scores and labels.

`boxes_of` knows the results of libraries by their attributes, so that none is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from eagor._arrays import to_numpy
from eagor._checks import shown
from eagor.errors import ResponseError
from eagor.evidence.shapes import are_fractions
from eagor.perception.fusion import RawDetections

Names = Sequence[str] | Mapping[int, str]

_SLACK = 1e-6  # by which rounding may take a probability out of [0, 1]

LABELS = (  # keys of labels in a dictionary, texts before numbers
    "text_labels", "label_names", "class_names", "class_name", "names", "phrases", "labels", "classes", "class_ids",
    "class_id", "pred_classes", "category_ids", "categories", "cls",
)  # fmt: skip
WANTED = (
    "(boxes, scores) or (boxes, scores, labels); supervision's Detections; Ultralytics' results; a dictionary with "
    "boxes, scores, labels; MediaPipe's results; a list of dictionaries with bbox (x, y, w, h) or box"
)


def boxes_of(result: Any, names: Names | None = None) -> RawDetections:
    """The boxes, scores and labels in what a detector returned for one picture.

    Known are supervision's ``Detections``, Ultralytics' results, dictionaries as of torchvision and of Hugging Face's
    post-processing (tensors too), MediaPipe's results, lists of dictionaries as in COCO's results and in pipelines, and
    plain arrays. `names`: of the classes, where `result` numbers them: a list, or names by number.

    Boxes without area are left out. Raises `ResponseError`, which says what came and what was wanted, for anything
    else, boxes with x0 > x1 or y0 > y1, numbers that are not finite, lengths that differ, fractions where pixels were
    wanted, scores outside [0, 1], and numbers of classes without names.
    """
    if isinstance(result, Sequence) and len(result) == 1 and _reader(result[0]):
        result = result[0]  # a batch of one
    read = _reader(result)
    if read is None:
        raise ResponseError(f"the detector returned {_kind(result)}; wanted {WANTED}")
    try:
        boxes, scores, labels = read(result)
    except (LookupError, AttributeError, TypeError) as error:
        raise ResponseError(f"the detector returned {_kind(result)} without {error}; wanted {WANTED}") from error
    except (ValueError, OverflowError) as error:
        if isinstance(error, ResponseError):
            raise
        raise ResponseError(f"the detector returned {_kind(result)} with an error: {error}; wanted {WANTED}") from error
    corners = _numbers(boxes, "boxes", "numbers, (n, 4)")
    values = _numbers(scores, "scores", "one number for each box").reshape(-1)
    corners = corners.reshape(0, 4) if corners.size == 0 else corners
    if corners.ndim != 2 or corners.shape[1] != 4:
        raise ResponseError(f"boxes of shape {corners.shape} came; wanted (n, 4): x0, y0, x1, y1 in pixels")
    if len(values) != len(corners):
        raise ResponseError(f"{len(corners)} boxes and {len(values)} scores came; wanted as many of each")
    if values.size and not (values.min() >= -_SLACK and values.max() <= 1 + _SLACK):
        raise ResponseError(
            f"scores from {values.min():.4g} to {values.max():.4g} came; scores outside [0, 1] want a stated "
            "squashing: 1 / (1 + exp(-score)) for logits, score / 100 for percents"
        )
    if wrong := np.flatnonzero((corners[:, :2] > corners[:, 2:]).any(axis=1)).tolist():
        raise ResponseError(
            f"the box {corners[wrong[0]].tolist()} came; wanted x0 < x1 and y0 < y1. If it is x, y, width, height, add "
            "x to the width and y to the height"
        )
    if are_fractions(corners, 0.5) or 0 < corners.max(initial=0) <= 1:
        raise ResponseError(
            f"boxes came within {corners.max():.3g} of the corner: they seem to be fractions of the picture. Wanted "
            "pixels: multiply x by its width and y by its height"
        )
    names = names_in(result) if names is None else names
    if read is _records and not isinstance(names, Mapping | None) and any("category_id" in each for each in result):
        raise ResponseError(
            "numbers came as category_id, and names as a list; COCO's begin at 1, and leave some out. Wanted names by "
            "number, such as {1: 'person', 62: 'chair'}"
        )
    texts = None if labels is None else _texts(labels, names, len(corners))
    real = np.flatnonzero((corners[:, 2:] > corners[:, :2]).all(axis=1))
    return RawDetections(
        corners[real], np.clip(values[real], 0, 1), None if texts is None else [texts[at] for at in real]
    )


def names_in(result: Any) -> Names | None:
    """The names of all that a detector knows, where what it returned tells them: Ultralytics' results do."""
    one = result[0] if isinstance(result, Sequence) and len(result) == 1 else result
    return getattr(one, "names", None) if _reader(one) is _ultralytics else None


def numbered(names: Any) -> dict[int, str]:
    """Names of classes by number: of a list, of names by number, or of numbers by name. Raises `ResponseError`."""
    try:
        if isinstance(names, Mapping):
            turned = all(isinstance(key, str) and not key.strip().isdecimal() for key in names)
            return {int(value if turned else key): str(key if turned else value) for key, value in names.items()}
        if not isinstance(names, str | bytes | set | frozenset):
            return dict(enumerate(map(str, names)))
    except (TypeError, ValueError):
        pass
    raise ResponseError(f"names of classes came as {shown(names)}; wanted a list, or names by number")


def _texts(labels: Any, names: Names | None, count: int) -> list[str]:
    labels = labels if isinstance(labels, list | tuple) else np.ravel(to_numpy(labels)).tolist()
    if len(labels) != count:
        raise ResponseError(f"{count} boxes and {len(labels)} labels came; wanted as many of each")
    known = {} if names is None else numbered(names)
    texts: list[str] = []
    for each in labels:
        each = each.decode("utf-8", "replace") if isinstance(each, bytes) else each
        if isinstance(each, str) and not (known and each.isdecimal() and each not in known.values()):
            texts.append(each)
            continue
        try:
            whole = float(each).is_integer()
        except (TypeError, ValueError, OverflowError):
            whole = False
        if not whole:
            raise ResponseError(
                f"the label {shown(each)} came; wanted a text, or the number of a class. If all boxes are what was "
                "asked for, return boxes and scores alone"
            )
        if names is None:
            raise ResponseError(
                f"labels came as numbers, such as {int(each)}; wanted texts, or names=... of the classes. If all boxes "
                "are what was asked for, return boxes and scores alone"
            )
        if int(each) not in known:
            raise ResponseError(
                f"the label {int(each)} came, and names has {len(known)} entries without it; wanted one for each class"
            )
        texts.append(str(known[int(each)]))
    return texts


def _numbers(values: Any, what: str, wanted: str) -> np.ndarray:
    try:
        numbers = np.asarray(to_numpy(values), dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise ResponseError(f"{what} came as {_kind(values)}; wanted {wanted}") from error
    if not np.isfinite(numbers).all():
        raise ResponseError(f"{what} came that are not finite; wanted numbers")
    return numbers


def _kind(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"a dictionary with {', '.join(map(str, [*value][:8])) or 'nothing in it'}"
    if isinstance(value, list | tuple):
        return f"a {type(value).__name__} of {len(value)}" + (f" ({type(value[0]).__name__}, ...)" if value else "")
    if hasattr(value, "shape"):
        return f"an array of shape {tuple(value.shape)}"
    return f"{type(value).__module__}.{type(value).__qualname__}"


_Read = tuple[Any, Any, Any]  # boxes, scores, labels or None: by one reader for each kind


def _supervision(result: Any) -> _Read:
    if result.confidence is None:
        raise ResponseError(
            "supervision's Detections came without confidence; wanted scores: detections.confidence = "
            "numpy.ones(len(detections)) if there are none"
        )
    named = result.data.get("class_name") if getattr(result, "data", None) else None
    return result.xyxy, result.confidence, result.class_id if named is None else [str(name) for name in named]


def _ultralytics(result: Any) -> _Read:
    boxes = result.boxes if getattr(result, "obb", None) is None else result.obb
    if boxes is None:
        raise ResponseError("Ultralytics' results came with neither boxes nor oriented boxes (obb), as of a classifier")
    corners = getattr(boxes, "xyxy", None)  # of oriented boxes: what holds them
    if corners is None:
        points = to_numpy(boxes.xyxyxyxy).reshape(-1, 4, 2)
        corners = np.concatenate([points.min(axis=1), points.max(axis=1)], axis=1)
    return corners, boxes.conf, boxes.cls


def _mapping(result: Mapping[str, Any]) -> _Read:
    labels = (each for key in LABELS if (each := result.get(key)) is not None)
    return result["boxes"], result["scores"], next(labels, None)


def _mediapipe(result: Any) -> _Read:
    boxes, best = [], []
    for each in result.detections or ():
        box = each.bounding_box
        boxes.append([box.origin_x, box.origin_y, box.origin_x + box.width, box.origin_y + box.height])
        best.append(max(each.categories, key=lambda category: category.score))
    labels = [category.category_name or category.index for category in best]
    return boxes, [category.score for category in best], None if None in labels else labels


def _records(result: Sequence[Mapping[str, Any]]) -> _Read:
    """``bbox``: x, y, width, height, as COCO has it; ``box``: corners, by name or in a row."""
    keys = ("label", "category", "name", "class", "category_id")
    labels = [next((each[key] for key in keys if key in each), None) for each in result]
    if None in labels and any(label is not None for label in labels):
        raise ResponseError("some dictionaries came with a label, some without; wanted all or none")
    boxes = []
    for each in result:
        if "bbox" in each:
            x, y, width, height = map(float, each["bbox"])
            boxes.append([x, y, x + width, y + height])
        else:
            box, corners = each["box"], ("xmin", "ymin", "xmax", "ymax")
            boxes.append([*map(float, [box[key] for key in corners] if isinstance(box, Mapping) else box)])
    scores = [each["confidence" if "confidence" in each else "score"] for each in result]
    return boxes, scores, None if None in labels else labels


def _plain(result: Sequence[Any]) -> _Read:
    return result[0], result[1], result[2] if len(result) == 3 else None


def _reader(result: Any) -> Callable[[Any], _Read] | None:
    """Who reads `result`; None if nobody does."""
    if isinstance(result, Mapping):
        return _mapping if {"boxes", "scores"} <= {*result} else None
    if hasattr(result, "xyxy") and hasattr(result, "confidence"):
        return _supervision
    if hasattr(result, "boxes") and (hasattr(result, "obb") or hasattr(result.boxes, "conf")):
        return _ultralytics
    if hasattr(result, "detections"):
        return _mediapipe
    if not isinstance(result, Sequence) or isinstance(result, str | bytes):
        return None
    if all(isinstance(each, Mapping) and ("bbox" in each or "box" in each) for each in result):
        return _records
    return _plain if len(result) in (2, 3) and not isinstance(result[0], Mapping | str) else None
