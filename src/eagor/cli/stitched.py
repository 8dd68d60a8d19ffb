"""Pictures and videos of lenses, stitched with ``--rig``, for the commands that look at files."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from eagor.cli.terminal import UsageError
from eagor.errors import ImageError

if TYPE_CHECKING:
    from eagor.media.camera_sources import StitchedVideo
    from eagor.media.panorama import PanoramaFile
    from eagor.media.stitching import Panoramas

__all__ = ["LensPictures", "film_of"]


class LensPictures:
    """Reads pictures of lenses as panoramas, with the lenses of the YAML file `rig`; `rows`: the most of them."""

    def __init__(self, rig: Path, rows: int | None = None) -> None:
        from eagor.media.rigs import read_rig

        self.path, self.rig, self.rows = rig, read_rig(rig), rows
        self._sizes: tuple[tuple[int, int], ...] = ()
        self._panoramas: Panoramas | None = None
        if len(self.rig.sizes) > 1:
            raise UsageError(
                f"--rig {rig} is for {len(self.rig.sizes)} pictures at a time, one for each lens; give a video, or "
                "pictures with all circles in one"
            )

    def read(self, path: Path) -> PanoramaFile:
        """The panorama of the picture at `path`. Raises `ImageError`."""
        from eagor.media.panorama import PanoramaFile, read_panorama
        from eagor.media.stitching import Panoramas

        with warnings.catch_warnings():  # of its shape: it is no panorama
            warnings.simplefilter("ignore")
            picture = read_panorama(path)
        sizes = ((picture.shape[1], picture.shape[0]),)
        if self._panoramas is None or sizes != self._sizes:
            self._panoramas, self._sizes = Panoramas(sizes, self.rig, self.rows, str(path)), sizes
        return PanoramaFile(self._panoramas.make(picture), self._panoramas.unseen)


def film_of(
    paths: Sequence[Path],
    rig: Path,
    *,
    rate: float | None = None,
    start: float = 0.0,
    end: float | None = None,
    rows: int | None = None,
) -> StitchedVideo:
    """The video of lenses in one file, or in one for each picture of the rig. Raises `ImageError`, `FormatError`."""
    from eagor.media.camera_sources import StitchedVideo
    from eagor.media.rigs import read_rig

    lenses = read_rig(rig)
    if len(paths) > len(lenses.sizes):
        raise ImageError(f"{len(paths)} videos are given, and {rig} is for {len(lenses.sizes)}; give one per lens")
    return StitchedVideo(paths, lenses, rate=rate, start=start, end=end, rows=rows)
