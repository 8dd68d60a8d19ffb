"""Videos as frames: of panoramas, of an ordinary camera, or of the lenses of a rig; also pictures that move.

Tracks are decoded (`eagor.sources.tracks`), and `PanoramaBuilder` says what their pictures are.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import above, whole, within
from eagor.cameras import Rig
from eagor.errors import ImageError, TimeError
from eagor.sources import Frame
from eagor.sources.intrinsics import Camera
from eagor.sources.stitching import PanoramaBuilder
from eagor.sources.tracks import Animation, Track, is_animation

__all__ = ["Video", "lens_videos"]

APART = 0.02  # seconds by which the pictures of two lenses may differ in time, beside half an interval
_LENS = re.compile(r"(VID_\d+_\d+_)(00|10)(_\d+\.insv)$", re.IGNORECASE)


class Video:
    """The frames of a video, to iterate over as often as wanted; each time yields `Frame` in order of time.

    With a `rig`, `path` and `others` are the files of its pictures: one may hold a track for each, and of two Insta360
    recordings of the same moment one is enough. `camera`, `force`: as for `PanoramaBuilder`. `rate`: pictures per
    second to take (None: all), `start`, `end`: seconds of the file, as of `eagor.sources.tracks.Track`. `rows`: the
    most rows of a frame; larger pictures are shrunk by area while they are decoded.

    `shape`: rows and columns of the frames; `unseen`: None, or the mask of `shape` of what no frame shows;
    `level_R_body`: None, or the rotation ``(3, 3)`` that makes them level, as the file says; `builder`: what makes
    them; `duration`, `frame_rate`, `count`, `motion`, `hint`, `facts`: as of `Track`.

    Raises as `Track`, and where files do not belong to the rig. Iterating raises `ShapeError` for pictures of which
    nothing tells what they are, and as `Track.pictures`.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *others: str | os.PathLike[str],
        rig: Rig | None = None,
        camera: Camera | None = None,
        force: bool = False,
        rate: float | None = None,
        start: float = 0.0,
        end: float | None = None,
        rows: int | None = None,
    ) -> None:
        if rate is not None and not above(rate, 0):
            raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0, or None for all pictures")
        if not within(start, 0):
            raise TimeError(f"start = {start!r}; wanted seconds from the start of the file, 0 or more")
        if end is not None and not above(end, start):
            raise TimeError(f"end = {end!r}; wanted seconds of the file after start = {start:g}, or None for its end")
        if rows is not None and not whole(rows, 1):
            raise ImageError(f"rows = {rows!r}; wanted a whole number of at least 1, or None for the rows of the video")
        if rig is None and others:
            raise ImageError(f"{len(others) + 1} files are given, and no rig says how they belong together: --rig FILE")
        taken: dict[str, Any] = {"rate": rate, "start": start, "end": end}
        self._tracks: list[Track | Animation]
        if rig is not None:
            self._tracks = [*_lens_tracks((path, *others), len(rig.sizes), taken)]
        else:
            self._tracks = [(Animation if is_animation(path) else Track)(path, **taken)]
        first = self._tracks[0]
        self.path, self.motion, self.hint, self.duration = first.path, first.motion, first.hint, first.duration
        self.frame_rate, self.count = first.frame_rate, first.count
        self.builder = builder = PanoramaBuilder(
            [each.size for each in self._tracks], self.path, rig=rig, camera=camera, hint=first.hint,
            projection=first.projection, rows=rows, force=force,
        )  # fmt: skip
        self.shape, self.level_R_body = builder.grid.shape, builder.level_R_body
        self.unseen, self.facts = builder.hidden(first.hidden), (*first.facts, *builder.facts)
        self._checked = False

    def __iter__(self) -> Iterator[Frame]:
        for stamp, pictures in _together(self._tracks, self.builder.wanted):
            name = f"{os.path.basename(self.path)} at {stamp:.2f} s"
            if not self._checked:
                self.builder.check(*pictures, name=name)
                self._checked = True
            yield Frame(stamp, self.builder.make(*pictures), name, self.builder.view, unseen=self.unseen)


def lens_videos(paths: Sequence[Path], rate: float | None = None) -> Iterator[tuple[np.ndarray, ...]]:
    """The lenses' pictures ``(H, W, 3)`` uint8 as they are, of each moment of a video."""
    tracks = _lens_tracks(paths, None, {"rate": rate})
    yield from (pictures for _, pictures in _together(tracks, [(each.size[1], each.size[0]) for each in tracks]))


def _lens_tracks(paths: Sequence[str | os.PathLike[str]], count: int | None, taken: dict[str, Any]) -> list[Track]:
    """A track for each of `count` pictures: of files of their own, tracks of one, or a file and its partner.

    None: as many as a file has tracks, or it and its partner: the recording of the other lens, as Insta360 names the
    two of one moment (``_00_``, ``_10_``).
    """
    first, *others = map(Path, paths)
    found = Track(first, lenses=True, **taken)
    if not others and count != 1 and found.tracks > 1 and found.tracks >= (count or 0):
        return [found, *(Track(first, number=k, lenses=True, **taken) for k in range(1, count or found.tracks))]
    if not others and count in (None, 2) and (name := _LENS.search(first.name)) is not None:
        other = first.with_name(f"{first.name[: name.start()]}{name[1]}{'10' if name[2] == '00' else '00'}{name[3]}")
        both = sorted([first, other]) if other.is_file() else [first]
        return [Track(path, lenses=True, **taken) for path in both]
    return [found, *(Track(path, lenses=True, **taken) for path in others)]


def _together(
    tracks: Sequence[Track | Animation], sizes: Sequence[tuple[int, int]]
) -> Iterator[tuple[float, tuple[np.ndarray, ...]]]:
    """Stamp and pictures of each moment, at these sizes. Raises `ImageError` where the times of lenses differ."""
    interval, path = 1 / (tracks[0].frame_rate or 25.0), tracks[0].path
    for moment in zip_longest(*(each.pictures(size) for each, size in zip(tracks, sizes, strict=True))):
        if None in moment:
            raise ImageError(f"{path}: the video of one lens ends before that of the other; what both have was taken")
        stamps = [stamp for stamp, _ in moment]
        if (apart := max(stamps) - min(stamps)) > interval / 2 + APART:
            raise ImageError(
                f"{path}: at {stamps[0]:.2f} s the pictures of its lenses are {apart:.3f} s apart: these are not the "
                "lenses of one recording. Give the files of one moment"
            )
        yield stamps[0], tuple(picture for _, picture in moment)
