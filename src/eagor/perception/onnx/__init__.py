"""Detectors for ordinary pictures in ONNX files: the YOLO family, DETR's, torchvision's, CenterNet.

``--perception onnx:MODEL.onnx?labels=coco.txt&layout=yolov8`` runs one without a line of code. Ultralytics' files say
themselves how they write boxes and what their classes are called; `LAYOUTS` lists what else can be stated.

Tested are small graphs with such outputs, DETR and RT-DETR with random weights against their own library, and
published weights of CenterNet alone.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._checks import whole, within
from eagor.errors import EagorError, ImageError, ResponseError
from eagor.evidence.shapes import are_fractions
from eagor.perception.onnx.layouts import LAYOUTS, Labels, choose_layout, literal, names_of
from eagor.perception.onnx.network import FITS, ORDERS, PAD, VALUES, Network, Size, letterbox

if TYPE_CHECKING:
    from eagor.perception.views import Detector

__all__ = ["LAYOUTS", "OnnxDetector", "from_text"]

MOST = 300  # boxes of a picture: the best
MOST_COMPARED = 2000  # boxes that suppression looks at: the best
OVERLAP = 0.5  # intersection over union beyond which two boxes of a class are of one thing
SLACK = 1e-3  # by which a probability of 16 bits may leave [0, 1]
OF_VIEWS = {"hfov_deg": "hfov_deg", "views": "views", "view": "size", "detector": "detector"}  # names of `Detector`
COUNT = "a whole number, 1 or more"


class OnnxDetector:
    """Runs a detector that was exported to ONNX on an ordinary picture.

    Called with a picture ``(h, w, 3)``, uint8 RGB, and a query, which it does not read, it returns boxes ``(n, 4)``
    x0, y0, x1, y1 in pixels of the picture, scores ``(n,)`` in [0, 1], and n labels, the best first. A box comes once
    for each of its classes that reaches the threshold. At most 300 boxes are returned.

    - `path`: the file. `labels`: what the classes are called, a file, a list, or names by number (default: what the
      file itself says). There have to be as many as the network has classes.
    - `size`: rows and columns of the network's input, a number or a pair (default: what the file says).
    - `threshold`: least score, in [0, 1] (default: as usual for the layout).
    - `layout`: how the network writes boxes, one of `LAYOUTS` (default: what the file's metadata settle).
    - `fit` ("letterbox", "corner", "stretch"), `values` ("unit": 0 to 1, "byte", "imagenet": standardised), `order`
      ("rgb", "bgr"): how the picture is put into the input (default: as usual for the layout).
    - `threads`: cores that the network runs on; `together`: pictures that `many` looks at at the same time.

    It tries the network once on a grey picture. Raises `EagorError` for a file that is no such network, for outputs
    whose layout is not told or does not fit, and for values that make no sense; `FormatError` for labels that cannot be
    read; `MissingExtraError` without what the extra ``photos`` brings.

    Attributes: `classes`, the names of all classes; `layout`, its name; `size`, rows and columns.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        labels: Labels | None = None,
        size: int | Size | str | None = None,
        threshold: float | None = None,
        layout: str | None = None,
        *,
        fit: str | None = None,
        values: str | None = None,
        order: str = "rgb",
        threads: int = 1,
        together: int = 1,
    ) -> None:
        self._options: dict[str, Any] = {name: value for name, value in locals().items() if name != "self"}
        for name, fits, wanted in (
            ("layout", layout in (None, *LAYOUTS), ", ".join(LAYOUTS)),
            ("fit", fit in (None, *FITS), ", ".join(FITS)),
            ("values", values in (None, *VALUES), ", ".join(VALUES)),
            ("order", order in ORDERS, ", ".join(ORDERS)),
            ("threshold", threshold is None or within(threshold, 0, 1), "a number from 0 to 1"),
            ("threads", whole(threads, 1, 1024), COUNT),
            ("together", whole(together, 1, 1024), COUNT),
        ):
            if not fits:
                raise EagorError(f"OnnxDetector: {name} = {self._options[name]!r}; wanted {wanted}")
        self._network = Network(path, threads)
        metadata, noted = self._network.metadata, "'names' in the file's metadata"
        usual = LAYOUTS.get(layout or metadata.get("layout", ""), LAYOUTS["yolov8"])  # other metadata are YOLO's
        if labels is not None:
            self._names = names_of(labels, usual.first)
        elif metadata.get("names", "").strip():
            self._names = names_of(literal(metadata["names"], noted), 0, noted)
        else:
            raise EagorError(f"{path} does not say what its classes are called; name a file with labels=FILE.txt")
        self.classes = tuple(filter(None, self._names))
        self.size = self._network.size(size, usual.size)
        tried = self._network.run(np.full((*self.size, 3), PAD, dtype=np.uint8), values or usual.values, order)
        try:
            self.layout, self._outputs = choose_layout(layout, metadata, tried, len(self._names))
        except EagorError as error:
            raise EagorError(f"{path}: {error}") from None
        self._layout = usual = LAYOUTS[self.layout]
        self.fit, self.values, self.order, self.together = fit or usual.fit, values or usual.values, order, together
        self.threshold = usual.threshold if threshold is None else threshold

    def __call__(self, picture: np.ndarray, query: str = "") -> tuple[np.ndarray, np.ndarray, list[str]]:
        """Boxes, scores and labels in `picture`; see the class.

        Raises `ImageError` for what is no such picture, `ResponseError` for an answer that no network of this layout
        gives: numbers that are not finite, scores outside [0, 1], corners in the wrong order, boxes far outside.
        """
        picture = np.asarray(picture)
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
            raise ImageError(f"the picture is {picture.dtype} of shape {picture.shape}; wanted uint8 RGB (h, w, 3)")
        canvas, scale, offset = letterbox(picture, self.size, self.fit)
        outputs = self._network.run(canvas, self.values, self.order)
        boxes, scores, classes = self._detections([outputs[name] for name in self._outputs])
        height, width = picture.shape[:2]
        boxes = np.clip((boxes - np.tile(offset, 2)) / np.tile(scale, 2), 0, [width, height, width, height])
        real = np.flatnonzero((boxes[:, 2:] > boxes[:, :2]).all(axis=1))
        best = real[np.argsort(-scores[real], kind="stable")][:MOST_COMPARED]  # of equal scores the earlier is better
        if not self._layout.suppressed and len(best):
            import cv2

            suppress: Any = cv2.dnn.NMSBoxesBatched  # its types want lists, it takes arrays
            corners_and_sides = np.hstack([boxes[best, :2], boxes[best, 2:] - boxes[best, :2]])
            best = best[np.asarray(suppress(corners_and_sides, scores[best], classes[best], 0.0, OVERLAP), dtype=int)]
        best = best[:MOST]
        return boxes[best], scores[best], [self._names[at] or f"class {at}" for at in classes[best].tolist()]

    def many(self, pictures: Sequence[np.ndarray], query: str = "") -> list[tuple[np.ndarray, np.ndarray, list[str]]]:
        """What is in each of several pictures, as for one; `together` of them are looked at at the same time."""
        if self.together == 1:
            return [self(picture) for picture in pictures]
        with ThreadPoolExecutor(self.together, "eagor-look") as pool:
            return [*pool.map(self, pictures)]

    def _detections(self, outputs: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes in pixels of the input, scores and numbers of classes, of all that reaches the threshold."""
        self._check(all(np.isfinite(each).all() for each in outputs), "numbers that are not finite")
        layout, count = self._layout, len(self._names)
        batched = layout.outputs(count, 0)[0][0] == 1
        single = [(each[0] if batched else each).astype(np.float32, copy=False) for each in outputs]
        boxes, scores, *numbers = (each.astype(np.float64) for each in layout.read(single, count, self.threshold))
        if layout.centred:
            boxes = np.concatenate([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2], axis=1)
        boxes = boxes * np.tile(self.size[::-1], 2) if layout.fractions else boxes
        reach = scores >= self.threshold
        rows, *columns = np.nonzero(reach)
        self._check(not scores.size or (scores.min() >= -SLACK and scores.max() <= 1 + SLACK), "scores outside [0, 1]")
        boxes, scores = boxes[rows], np.clip(scores[reach], 0, 1)
        numbers = numbers[0][rows] if numbers else columns[0]
        classes = np.rint(numbers).astype(np.int64)
        whole_numbers = (np.abs(numbers - classes) <= SLACK) & (classes >= 0) & (classes < len(self._names))
        self._check(
            whole_numbers.all(), f"classes such as {numbers[:3].tolist()} of {len(self._names)} that have labels"
        )
        inverted, middles = (
            (boxes[:, :2] > boxes[:, 2:]).any(axis=1),
            (boxes[:, :2] + boxes[:, 2:]) / 2 / self.size[::-1],
        )
        right = 2 * inverted.sum() <= len(boxes) and not are_fractions(boxes) and (np.abs(middles - 0.5) <= 1.5).all()
        self._check(right, f"boxes such as {boxes[:1].round(3).tolist()}, where corners in pixels are wanted")
        return boxes, scores, classes

    def _check(self, right: Any, what: str) -> None:
        if not right:
            raise ResponseError(
                f"{self._network.path} (layout {self.layout}) gives {what}; state the right layout=... of its outputs, "
                "or the right values=... of its input"
            )

    def __reduce__(self) -> tuple[Any, ...]:
        """Other processes open the file again."""
        return partial(OnnxDetector, **self._options), ()


def from_text(text: str = "", /, **options: Any) -> Detector:
    """The perception that ``MODEL.onnx[?option=value&...]`` names: the detector in level views of a panorama.

    Options are those of `OnnxDetector`, and of `eagor.Detector` ``hfov_deg``, ``views``, ``detector`` and ``view``
    (pixels of a view's side; default: as many as the network takes); those that are passed by name win. Raises
    `EagorError` for options that do not exist, and as `OnnxDetector` does.
    """
    from eagor.perception import parse_options

    path, _, written = text.partition("?")
    if not path:
        raise EagorError("onnx wants the detector's file: onnx:MODEL.onnx, or onnx:MODEL.onnx?labels=coco.txt&size=640")
    given = parse_options(written) | options
    if isinstance(given.get("labels"), int | float):
        given["labels"] = str(given["labels"])  # a file that is called 80, say
    return in_views("onnx", os.path.expanduser(path), given)


def in_views(name: str, path: str | os.PathLike[str], given: dict[str, Any]) -> Detector:
    """The detector in a file, looking around, with options as of `from_text`; `name`: of the perception, for errors."""
    from eagor.perception.views import Detector

    own = [*inspect.signature(OnnxDetector).parameters][1:]
    if unknown := sorted(given.keys() - {*own, *OF_VIEWS}):
        raise EagorError(f"{name} has no option {', '.join(unknown)}; it has {', '.join([*own, *OF_VIEWS])}")
    detect = OnnxDetector(path, **{key: given[key] for key in own if key in given})
    settings: dict[str, Any] = {"size": max(detect.size)}
    return Detector(detect, **settings | {OF_VIEWS[key]: given[key] for key in OF_VIEWS if key in given})
