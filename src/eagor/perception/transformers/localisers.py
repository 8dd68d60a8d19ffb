"""Detectors of the hub as functions for `eagor.Detector`: with classes of their own, or for any words.

Whatever transformers loads as ``AutoModelForObjectDetection`` (DETR, RT-DETR, D-FINE, YOLOS, ...) knows its classes;
OWL-ViT, OWLv2 (Minderer et al., arXiv 2306.09683) and Grounding DINO (Liu et al., arXiv 2303.05499) take any words.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import RLock
from typing import Any, NamedTuple

import numpy as np
import torch

_MOST = 50  # boxes per picture

RawDetections = tuple[np.ndarray, np.ndarray] | tuple[np.ndarray, np.ndarray, list[str]]  # boxes, scores, labels


class Kind(NamedTuple):
    """Detectors of a model type: their class in transformers, the usual least score, and how a query is written."""

    loaded_by: str
    threshold: float
    sentence: str = ""  # empty for a detector with classes


_OWL = Kind("AutoModelForZeroShotObjectDetection", 0.1, "a photo of a {}")
_DINO = Kind("AutoModelForZeroShotObjectDetection", 0.25, "{}.")
CLASSES = Kind("AutoModelForObjectDetection", 0.3)
KINDS = {"owlvit": _OWL, "owlv2": _OWL, "grounding-dino": _DINO, "mm-grounding-dino": _DINO}


@dataclass
class HubDetector:
    """A loaded detector: pictures ``(h, w, 3)`` uint8 of one size and a query in; boxes, scores, labels out.

    `classes`: its labels by number; None: it takes any words, and its boxes have no labels.
    """

    model: Any
    processor: Any
    kind: Kind
    threshold: float
    classes: dict[int, str] | None
    lock: Any = field(default_factory=RLock, repr=False)

    def __call__(self, picture: np.ndarray, query: str) -> RawDetections:
        """What it finds in one picture."""
        return self.many([picture], query)[0]

    @torch.inference_mode()
    def many(self, pictures: Sequence[np.ndarray], query: str) -> list[RawDetections]:
        """What it finds in each of several pictures."""
        words = query.lower().rstrip(".") if self.kind is _DINO else query.lower()
        if self.kind is not _DINO and words.split(" ")[0] in ("the", "an", "a"):
            words = words.partition(" ")[2]
        text = {"text": [self.kind.sentence.format(words)] * len(pictures)} if self.kind.sentence else {}
        inputs = self.processor(images=list(pictures), return_tensors="pt", **text).to(self.model.device)
        inputs["pixel_values"] = inputs["pixel_values"].to(self.model.dtype)
        with self.lock:
            out = self.model(**inputs)
        name = "post_process_grounded_object_detection" if text else "post_process_object_detection"
        more = {"input_ids": inputs["input_ids"]} if self.kind is _DINO else {}
        sizes = [picture.shape[:2] for picture in pictures]
        read = getattr(self.processor, name)
        return [self._best(found) for found in read(out, threshold=self.threshold, target_sizes=sizes, **more)]

    def _best(self, found: dict[str, Any]) -> RawDetections:
        best = found["scores"].argsort(descending=True)[:_MOST]
        boxes, scores = (found[key][best].float().cpu().numpy() for key in ("boxes", "scores"))
        if self.classes is None:
            return boxes, scores
        return boxes, scores, [self.classes[number] for number in found["labels"][best].tolist()]
