"""Pictures that move (GIF, APNG, WebP, AVIF), picture by picture: what FFmpeg does not read of them, Pillow does."""

from __future__ import annotations

import os
from collections.abc import Iterator

from eagor.errors import ImageError, TimeError
from eagor.media import Frame
from eagor.media.intrinsics import IntrinsicsHint
from eagor.media.panorama import Picture, decoded_bytes, opened, photograph_of, shrunk_picture
from eagor.media.video import selected

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

    duration = count = motion = None
    hint = IntrinsicsHint()

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        rate: float | None = None,
        start: float = 0.0,
        end: float | None = None,
        rows: int | None = None,
    ) -> None:
        self.path, self._rows, self._taken = os.fspath(path), rows, (start, end, rate)
        found, lasts = next(self._all(), (0.0, (None, 0.0)))[1]
        if found is None:
            raise ImageError(f"{self.path} holds no picture that can be read; fetch or export it again")
        self.shape, self.unseen, self.level_R_body = found.picture.shape[:2], found.unseen, found.level_R_body
        self.frame_rate: float | None = 1 / lasts
        with opened(self.path) as image:
            about = f"{image.format}, {image.width} x {image.height} pixels, {image.n_frames} pictures"  # type: ignore[attr-defined]
        self.facts = (f"{about}, one after the other", *found.facts)

    def __iter__(self) -> Iterator[Frame]:
        stamp = None
        for stamp, (found, _) in selected(self._all(), *self._taken, 1e-6):
            yield Frame(stamp, found.picture, f"{os.path.basename(self.path)} at {stamp:.2f} s")
        if stamp is None:
            raise TimeError(f"{self.path} has no picture from {self._taken[0]:g} s on; it ends before that")

    def _all(self) -> Iterator[tuple[float, tuple[Picture, float]]]:
        """Time and picture of each, and for how long it is shown; raises `ImageError` where it is damaged."""
        stamp = 0.0
        try:
            with opened(self.path) as image:
                if decoded_bytes(image) > LARGEST:
                    raise ImageError(
                        f"{self.path} claims {image.width} x {image.height} pixels; it is corrupt, or large"
                    )
                # Of an APNG the first may be one for programs that know no animations.
                for number in range(int(bool(image.info.get("default_image"))), image.n_frames):  # type: ignore[attr-defined]
                    image.seek(number)
                    image.load()
                    lasts = float(image.info.get("duration") or 0) / 1000
                    lasts = lasts if lasts >= SHORTEST else USUAL
                    yield stamp, (shrunk_picture(photograph_of(image, self.path), self._rows), lasts)
                    stamp += lasts
        except ImageError:
            raise
        except Exception as error:  # Pillow's decoders may raise anything for damaged files
            what = f"its picture after {stamp:.2f} s cannot be read ({type(error).__name__}: {error})"
            raise ImageError(f"{self.path} is damaged: {what}; fetch or export it again") from error
