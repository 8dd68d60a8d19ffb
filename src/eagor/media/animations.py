"""Pictures that move (GIF, APNG, WebP, AVIF), picture by picture: what FFmpeg does not read of them, Pillow does."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import replace

from PIL import Image

from eagor.errors import ImageError, TimeError
from eagor.media import Frame
from eagor.media.intrinsics import Told
from eagor.media.panorama import Picture, decoded_bytes, opened, photograph_of, resized, resized_mask

__all__ = ["Animation", "is_animation"]

KINDS = ("GIF", "PNG", "WEBP", "AVIF")  # the pages of a TIFF, or of an MPO, are not pictures one after the other
SHORTEST, USUAL = 0.0101, 0.1  # seconds: shorter ones are shown as long as this, as browsers do
LARGEST = 1 << 29  # bytes of a picture in memory


def is_animation(path: str | os.PathLike[str]) -> bool:
    """Whether the file is a picture that moves."""
    try:
        with opened(path) as image:
            return image.format in KINDS and getattr(image, "n_frames", 1) > 1
    except Exception:  # Pillow may raise anything for what is no picture
        return False


class Animation:
    """The pictures of a picture that moves, with their times: as `eagor.media.video.Video`, with the same attributes.

    What is transparent in the first picture counts as not seen. Raises `ImageError`, `TimeError`.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        rate: float | None = None,
        start: float = 0.0,
        end: float | None = None,
        rows: int | None = None,
    ) -> None:
        self.path = os.fspath(path)
        self._rate, self._start, self._end, self._rows = rate, start, end, rows
        with opened(self.path) as image:
            if decoded_bytes(image) > LARGEST:
                raise ImageError(
                    f"{self.path} claims {image.width} x {image.height} pixels; it is corrupt, or too large"
                )
            count, kind, (width, height) = image.n_frames, image.format, image.size  # type: ignore[attr-defined]
        first = next(self._all(), None)
        if first is None:
            raise ImageError(f"{self.path} holds no picture that can be read; fetch or export it again")
        self.shape, self.unseen, self.level_R_body = first[2].picture.shape[:2], first[2].unseen, first[2].level_R_body
        self.frame_rate: float | None = 1 / first[1]
        self.duration: float | None = None
        self.count: int | None = None
        self.motion, self.told = None, Told()
        self.facts = (f"{kind}, {width} x {height} pixels, {count} pictures, one after the other", *first[2].facts)

    def __iter__(self) -> Iterator[Frame]:
        tick, last = -1, -1.0
        for last, _, found in self._all():
            if self._end is not None and last >= self._end - 1e-6:
                return
            at = math.floor((last - self._start + 1e-6) * self._rate) if self._rate else tick + 1
            if last < self._start - 1e-6 or at <= tick:
                continue
            tick = at
            yield Frame(last, found.picture, f"{os.path.basename(self.path)} at {last:.2f} s")
        if tick < 0:
            raise TimeError(f"{self.path} has no picture from {self._start:g} s on; its last one is at {last:g} s")

    def _all(self) -> Iterator[tuple[float, float, Picture]]:
        """Time, seconds for which it is shown, and picture, of each; raises `ImageError` where it is damaged."""
        stamp = 0.0
        try:
            with opened(self.path) as image:
                # Of an APNG the first may be one for programs that know no animations.
                for number in range(int(bool(image.info.get("default_image"))), image.n_frames):  # type: ignore[attr-defined]
                    image.seek(number)
                    image.load()
                    told = float(image.info.get("duration") or 0) / 1000
                    lasts = told if told >= SHORTEST else USUAL
                    yield stamp, lasts, self._made(image)
                    stamp += lasts
        except ImageError:
            raise
        except Exception as error:  # Pillow's decoders may raise anything for damaged files
            raise ImageError(
                f"{self.path} is damaged: its picture after {stamp:.2f} s cannot be read ({type(error).__name__}: "
                f"{error}); fetch or export it again"
            ) from error

    def _made(self, image: Image.Image) -> Picture:
        found = photograph_of(image, self.path)
        height, width = found.picture.shape[:2]
        rows = min(height, self._rows or height)
        if rows == height:
            return found
        size = rows, max(1, round(width * rows / height))
        unseen = None if found.unseen is None else resized_mask(found.unseen, size)
        return replace(found, picture=resized(found.picture, size, wrap=width == 2 * height), unseen=unseen)
