"""Pictures for the page."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

__all__ = ["jpeg"]

QUALITY = 80


def jpeg(panorama: np.ndarray) -> bytes:
    """A picture ``(H, W, 3)`` uint8 as JPEG."""
    buffer = io.BytesIO()
    Image.fromarray(panorama).save(buffer, "JPEG", quality=QUALITY)
    return buffer.getvalue()
