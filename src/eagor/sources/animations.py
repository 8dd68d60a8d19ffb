"""Pictures that move (GIF, APNG, WebP, AVIF), decoded by Pillow, one after the other."""

from __future__ import annotations

import math
import os
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from eagor.errors import ImageError, TimeError
from eagor.sources.intrinsics import IntrinsicsHint
from eagor.sources.panorama import decoded_bytes, opened, projection_of, seen_of

if TYPE_CHECKING:
    from PIL import Image

Item = TypeVar("Item")
MOVING = ("GIF", "PNG", "WEBP", "AVIF")  # the pages of a TIFF, or of an MPO, are not pictures one after the other
SHORTEST, USUAL = 0.0101, 0.1  # seconds: shorter ones are shown as long as this, as browsers do
MOST_BYTES = 1 << 29  # of a picture that moves, in memory


class Animation:
    """The pictures of a picture that moves: as `eagor.sources.video.Track`, with the same attributes.

    `hidden` ``(H, W)``: what is transparent in the first picture, or None. Raises `ImageError`, `TimeError`.
    """

    duration = count = motion = None
    hint = IntrinsicsHint()

    def __init__(
        self, path: str | os.PathLike[str], *, rate: float | None = None, start: float = 0.0, end: float | None = None
    ) -> None:
        self.path, self._taken = os.fspath(path), (start, end, rate)
        with closing(self._all()) as coming:  # which holds the file open
            found = next(coming, None)
            if found is None:
                raise ImageError(f"{self.path} holds no picture that can be read; fetch or export it again")
            _, lasts, (_, self.hidden), image = found
            self.size, self.projection, self.frame_rate = image.size, projection_of(image), 1 / lasts
            about = f"{image.format}, {image.width} x {image.height} pixels, {image.n_frames} pictures"  # type: ignore[attr-defined]
        untold = "" if image.info.get("duration") else f"; it tells no times: {USUAL} s each"
        self.facts = (f"{about}, one after the other{untold}",)

    def pictures(self, size: tuple[int, int]) -> Iterator[tuple[float, np.ndarray]]:
        """As those of `Track`, in their own size."""
        stamp = None
        for stamp, picture in selected(((at, seen[0]) for at, _, seen, _ in self._all()), *self._taken, 1e-6):
            yield stamp, picture
        if stamp is None:
            raise TimeError(f"{self.path} has no picture from {self._taken[0]:g} s on; it ends before that")

    def _all(self) -> Generator[tuple[float, float, tuple[np.ndarray, np.ndarray | None], Image.Image], None, None]:
        """Time, for how long it is shown, picture and mask, and the file; raises `ImageError` where it is damaged."""
        stamp = 0.0
        try:
            with opened(self.path) as image:
                if decoded_bytes(image) > MOST_BYTES:
                    raise ImageError(f"claims {image.width} x {image.height} pixels; it is corrupt, or large")
                # Of an APNG the first may be one for programs that know no animations.
                for number in range(int(bool(image.info.get("default_image"))), image.n_frames):  # type: ignore[attr-defined]
                    image.seek(number)
                    image.load()
                    lasts = float(image.info.get("duration") or 0) / 1000
                    lasts = lasts if lasts >= SHORTEST else USUAL
                    yield stamp, lasts, seen_of(image), image
                    stamp += lasts
        except ImageError as error:
            raise ImageError(f"{self.path} {error}") from error
        except Exception as error:  # Pillow's decoders may raise anything for damaged files
            what = f"its picture after {stamp:.2f} s cannot be read ({type(error).__name__}: {error})"
            raise ImageError(f"{self.path} is damaged: {what}; fetch or export it again") from error


def is_animation(path: str | os.PathLike[str]) -> bool:
    """Whether the file is a picture that moves."""
    if not os.path.isfile(path):  # a pipe would never open
        return False
    try:
        with opened(path) as image:
            return image.format in MOVING and getattr(image, "n_frames", 1) > 1
    except Exception:  # Pillow may raise anything for what is no picture
        return False


def selected(
    items: Iterable[tuple[float, Item]], start: float, end: float | None, rate: float | None, slack: float
) -> Iterator[tuple[float, Item]]:
    """Of each tick of `rate` per second from `start` to `end` (seconds) the first item at or after it, once."""
    next_tick = 0
    for stamp, item in items:
        if end is not None and stamp >= end - slack:
            return
        if stamp < start - slack:
            continue
        if rate is not None:
            tick = math.floor((stamp - start + slack) * rate)
            if tick < next_tick:
                continue
            next_tick = tick + 1
        yield stamp, item
