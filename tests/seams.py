"""A panorama looked at twice, in two calls: what the perceptions do in one batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from eagor.perception.vlm.perception import merge_seam


def seamless(respond: Callable[[np.ndarray], np.ndarray], panorama: np.ndarray, cells: int) -> np.ndarray:
    """Responses ``(Q, h, cells)`` to `panorama`, whose width is a multiple of `cells`; `respond` answers one look."""
    shift = cells // 2
    second = respond(np.roll(panorama, shift * (panorama.shape[1] // cells), axis=1))
    return merge_seam(respond(panorama), np.roll(second, -shift, axis=-1), shift / cells)
