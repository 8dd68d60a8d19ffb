"""The head of Matroska and WebM files: the projection of the picture track (RFC 9559; Spherical Video V2 RFC)."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

__all__ = ["Head", "read_head"]

HEAD = 1 << 22  # bytes at the start of a file in which its tracks are described
EBML, SEGMENT, TRACKS, TRACK, VIDEO = 0x1A45DFA3, 0x18538067, 0x1654AE6B, 0xAE, 0xE0
STEREO, PROJECTION = 0x53B8, 0x7670
KIND, PRIVATE, YAW, PITCH, ROLL = 0x7671, 0x7672, 0x7673, 0x7674, 0x7675
CROPS = (0x54BB, 0x54AA, 0x54CC, 0x54DD)  # PixelCropTop, -Bottom, -Left, -Right
UNKNOWN = -1  # the size of an element that ends where the file ends


@dataclass(frozen=True)
class Head:
    """What the first picture track says; `projection` is None if it says nothing of one.

    `stereo`: the StereoMode. `projection`: ProjectionType. `private`: ProjectionPrivate. `pose`: ProjectionPoseYaw,
    -Pitch and -Roll, degrees. `crop`: pixels to cut off at the top, bottom, left and right. `missing`: bytes cut off at
    the end of the file.
    """

    stereo: int = 0
    projection: int | None = None
    private: bytes = b""
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    crop: tuple[int, int, int, int] = (0, 0, 0, 0)
    missing: int = 0


def read_head(file: BinaryIO) -> Head | None:
    """The head of a Matroska or WebM file; None if `file` is of another kind. What cannot be read is left out."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    data = memoryview(file.read(HEAD))
    top = {name: (at, length) for name, at, length in _elements(data, cut=True)}
    if EBML not in top:
        return None
    if SEGMENT not in top:
        return Head()
    at, length = top[SEGMENT]
    missing = 0 if length == UNKNOWN else max(0, at + length - size)
    tracks = _inside(data[at:], TRACKS)
    for name, start, length in _elements(tracks):
        video = _inside(tracks[start : start + length], VIDEO) if name == TRACK else memoryview(b"")
        if len(video):
            return _picture(video, missing)
    return Head(missing=missing)


def _picture(video: memoryview, missing: int) -> Head:
    found = {name: bytes(video[at : at + length]) for name, at, length in _elements(video)}
    crop = tuple(int.from_bytes(found.get(name, b"")) for name in CROPS)
    stereo = int.from_bytes(found.get(STEREO, b""))
    if PROJECTION not in found:
        return Head(stereo=stereo, crop=crop, missing=missing)  # pyright: ignore[reportArgumentType]
    inner = memoryview(found[PROJECTION])
    said = {name: bytes(inner[at : at + length]) for name, at, length in _elements(inner)}
    pose = tuple(_float(said.get(name, b"")) for name in (YAW, PITCH, ROLL))
    kind = int.from_bytes(said.get(KIND, b""))
    return Head(stereo, kind, said.get(PRIVATE, b""), pose, crop, missing)  # pyright: ignore[reportArgumentType]


def _inside(data: memoryview, wanted: int) -> memoryview:
    """The content of the first element `wanted` in `data`, or nothing."""
    found = next(((at, length) for name, at, length in _elements(data, cut=True) if name == wanted), None)
    return (
        memoryview(b"") if found is None else data[found[0] :] if found[1] == UNKNOWN else data[found[0] : sum(found)]
    )


def _elements(data: memoryview, cut: bool = False) -> Iterator[tuple[int, int, int]]:
    """Name, start and length of each element in `data`; with `cut` the last may go on beyond its end."""
    at = 0
    while at < len(data):
        name, start, _ = _number(data, at, keep=True)
        length, start, unknown = _number(data, start, keep=False)
        if start > len(data) or (not cut and (unknown or start + length > len(data))):
            return
        yield name, start, UNKNOWN if unknown else length
        if unknown:
            return
        at = start + length


def _number(data: memoryview, at: int, keep: bool) -> tuple[int, int, bool]:
    """A number of variable length: its value (with its marker if `keep`), its end, whether it stands for "unknown"."""
    if at >= len(data) or data[at] == 0:
        return 0, len(data) + 1, False
    width = 9 - data[at].bit_length()
    if at + width > len(data):
        return 0, len(data) + 1, False
    value, marker = int.from_bytes(data[at : at + width]), 1 << 7 * width
    return value if keep else value - marker, at + width, not keep and value == 2 * marker - 1


def _float(data: bytes) -> float:
    return struct.unpack(">f" if len(data) == 4 else ">d", data)[0] if len(data) in (4, 8) else 0.0
