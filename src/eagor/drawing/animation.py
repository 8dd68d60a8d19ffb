"""Animated WebP and GIF files, by Pillow. Pictures are shown at their own stamps, from the first one on."""

from __future__ import annotations

import io
import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from eagor._files import written
from eagor.drawing.movies import NOMINAL
from eagor.errors import StorageError, TimeError

__all__ = ["ANIMATIONS", "Animation", "Thinned"]

ANIMATIONS = {".webp": "WEBP", ".gif": "GIF"}
MOST = 240  # pictures, which are held in memory: about a megabyte each


class Thinned:
    """At most `most` items of a stream of unknown length, evenly spread: when it is full, every second one goes."""

    def __init__(self, most: int) -> None:
        self.items: list[Any] = []
        self.count, self.stride, self.most = 0, 1, most

    @property
    def wants(self) -> bool:
        """Whether the next item would be kept."""
        return self.count % self.stride == 0

    def add(self, item: Any) -> None:
        """Append an item, or pass over it."""
        if self.wants:
            self.items.append(item)
        self.count += 1
        if len(self.items) > self.most:
            self.items, self.stride = self.items[::2], 2 * self.stride


class Animation:
    """An animated WebP or GIF, held in memory until it is closed; of more than 240 pictures every second one goes."""

    def __init__(self, path: Path, rate: float | None) -> None:
        self.path, self._last = path, 1 / (rate or NOMINAL)
        self._kept, self._closed = Thinned(MOST), False
        self._end, self._before = 0.0, 0.0  # the last stamp, and the seconds from the one before it
        if not os.access(path.absolute().parent, os.W_OK):
            raise StorageError(f"{path} cannot be written; name a folder that can be written to")

    @property
    def count(self) -> int:
        """Pictures in the file."""
        return len(self._kept.items)

    def add(self, pixels: np.ndarray, stamp: float) -> None:
        """Append a picture ``(height, width, 3)`` uint8; `stamp` in seconds from the first one."""
        from PIL import Image

        if self._kept.items and round(1000 * stamp) <= round(1000 * self._end):
            raise TimeError(f"a picture at {stamp:g} s, less than a millisecond after the one before it")
        if self._kept.wants:
            buffer = io.BytesIO()
            picture = Image.fromarray(pixels)
            if self.path.suffix.lower() == ".gif":
                picture = picture.quantize(256, dither=Image.Dither.NONE)
            picture.save(buffer, "PNG", compress_level=1)
            self._kept.add((buffer.getvalue(), stamp))
        else:
            self._kept.add(None)
        self._end, self._before = stamp, stamp - self._end

    def close(self) -> None:
        """Write the file; nothing without pictures. Raises `StorageError`."""
        from PIL import Image

        if self._closed or not self._kept.items:
            return
        self._closed = True
        kind = self.path.suffix.lower()
        step = 10 if kind == ".gif" else 1  # milliseconds: the clock of a GIF
        stamps = [stamp for _, stamp in self._kept.items]
        stamps.append(self._end + (self._before or self._last))
        at = [step * round(1000 * stamp / step) for stamp in stamps]
        shown = [max(step, end - begin) for begin, end in pairwise(at)]
        first, *others = [Image.open(io.BytesIO(data)) for data, _ in self._kept.items]
        buffer, quality = io.BytesIO(), {} if kind == ".gif" else {"quality": 78, "method": 4}
        first.save(
            buffer, ANIMATIONS[kind], save_all=True, append_images=others, duration=shown, loop=0, **quality
        )  # fmt: skip
        written(self.path, buffer.getvalue())
