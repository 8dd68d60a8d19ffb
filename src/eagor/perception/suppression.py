"""Non-maximum suppression: of boxes that overlap and have one class, the best stays."""

from __future__ import annotations

import numpy as np

MOST = 2000  # boxes that are compared with each other: the best


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
    (None: all are of one). Beyond the best `MOST` boxes none stays.
    """
    order = np.argsort(-np.asarray(scores), kind="stable")[:MOST]
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
