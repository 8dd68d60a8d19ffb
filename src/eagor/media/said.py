"""What a video file says of itself beside its pictures: projection, motion track, whether it is whole."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import BinaryIO

from eagor.errors import FormatError, ImageError
from eagor.media.boxes import Movie, find, read_movie
from eagor.media.camm import read_camm
from eagor.media.insta360 import read_trailer
from eagor.media.matroska import read_head
from eagor.media.motion import MotionTrack
from eagor.media.projection import EXPORT, Projection, of_head, of_track

__all__ = ["Said", "read_said"]

UNSTITCHED = (".insv", ".360")  # as Insta360 and GoPro name recordings whose lenses are not put together yet


@dataclass(frozen=True, eq=False)
class Said:
    """`projection`: None if the file names none. `motion`: None if it has no motion track that can be used.

    `missing`: bytes that are cut off at the end of the file. `entry`: the codec's four letters, "" if unknown. `facts`:
    sentences about these. `raw`: whether the camera may have left its lenses' circles as they are. `tracks`: how many
    tracks of pictures it has, as far as its index tells.
    """

    projection: Projection | None = None
    motion: MotionTrack | None = None
    missing: int = 0
    entry: str = ""
    facts: tuple[str, ...] = ()
    raw: bool = False
    tracks: int = 1


def read_said(path: str, lenses: bool = False) -> Said:
    """What the file at `path` says. Raises `ImageError` for one that is cut off before its index.

    Also for one with a track for each lens, unless `lenses` are wanted.
    """
    with open(path, "rb") as file:
        try:
            movie = read_movie(file)
        except FormatError as error:
            raise ImageError(f"{path} {error}. Copy it again from the camera") from error
        if movie is not None:
            return _of_movie(path, movie, file, lenses)
        head = read_head(file)
    if head is None:
        return Said(raw=path.lower().endswith(UNSTITCHED))
    crop = "its track is to be cropped by {} (top), {} (bottom), {} (left), {} (right) pixels, which is not done"
    facts = (crop.format(*head.crop),) if any(head.crop) else ()
    return Said(of_head(head), missing=head.missing, facts=facts)


def _of_movie(path: str, movie: Movie, file: BinaryIO, wanted: bool) -> Said:
    motion, facts = None, ()
    raw = path.lower().endswith(UNSTITCHED)
    try:
        motion, facts = read_camm(movie, file)
        trailer = read_trailer(file)
        if trailer is not None:
            raw = True
            facts += (f"the camera is {trailer.camera or 'one of Insta360'}",)
            if motion is None and (motion := trailer.motion()) is not None:
                facts += (
                    "its motion track (Insta360) has axes that are not documented: the one that feels gravity is taken "
                    "for up, so turns of the heading are right, tilts may be about another axis",
                )
    except FormatError as error:
        facts += (f"its motion track cannot be used: it {error}",)
    if motion is not None:
        facts += ("the motion track is the camera's: where its app steadied the pictures, they turn otherwise",)
    lenses = len(movie.pictures)
    if raw and lenses > 1 and not wanted:
        raise ImageError(
            f"{os.path.basename(path)} holds {lenses} tracks of pictures, one for each lens. Give the lenses with "
            f"--rig FILE.yaml (eagor camera calibrate makes one). Or: {EXPORT}"
        )
    if lenses > 1 and not wanted:
        facts += (f"it has {lenses} tracks of pictures, of which the first is taken",)
    if not movie.pictures:
        return Said(None, motion, movie.missing, "", facts, raw)
    picture = movie.pictures[0]
    if find(picture.extensions, "clap") is not None:
        facts += ("its pictures are to be cropped (box clap), which is not done",)
    return Said(of_track(picture), motion, movie.missing, picture.entry, facts, raw, lenses)
