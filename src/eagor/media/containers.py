"""The containers of videos: boxes of MP4 and QuickTime, elements of Matroska and WebM; of what FFmpeg does not tell.

Sources: ISO/IEC 14496-12, "ISO base media file format"; RFC 9559; Spherical Video V2 RFC.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from eagor.errors import FormatError

__all__ = ["Head", "Movie", "Track", "children", "find", "read_head", "read_movie", "samples"]

LARGEST_INDEX = 1 << 28  # bytes: the index ("moov") of a day of video with a motion track of 1 kHz stays below
MOST_BOXES = 4096  # boxes side by side: a fragmented recording has two for each fragment
KNOWN = {"ftyp", "moov", "mdat", "free", "skip", "wide", "pnot", "uuid", "meta", "moof", "mfra", "sidx", "styp"}
VISUAL = 78  # bytes of a VisualSampleEntry before its boxes, without the box's own header

HEAD = 1 << 22  # bytes at the start of a file in which its tracks are described
EBML, SEGMENT, TRACKS, TRACK, VIDEO = 0x1A45DFA3, 0x18538067, 0x1654AE6B, 0xAE, 0xE0
STEREO, PROJECTION = 0x53B8, 0x7670
KIND, PRIVATE, YAW, PITCH, ROLL = 0x7671, 0x7672, 0x7673, 0x7674, 0x7675
CROPS = (0x54BB, 0x54AA, 0x54CC, 0x54DD)  # PixelCropTop, -Bottom, -Left, -Right
UNKNOWN = -1  # the size of an element that ends where the file ends


# --- MP4 and QuickTime ---


@dataclass(frozen=True)
class Track:
    """One track: `handler` ("vide", "meta", ...), `entry`: the type of its samples ("avc1", "camm", ...) and `body`.

    `extensions`: the boxes in the entry of a picture track, such as ``sv3d``. `scale`: units per second of the file.
    """

    handler: str
    entry: str
    body: memoryview
    extensions: memoryview
    scale: int


@dataclass(frozen=True)
class Movie:
    """The index of a file: its tracks; `missing`: bytes that are cut off at the file's end."""

    tracks: tuple[Track, ...]
    missing: int

    @property
    def pictures(self) -> tuple[Track, ...]:
        """The tracks of moving pictures."""
        return tuple(t for t in self.tracks if t.handler == "vide" and t.entry.strip() not in ("jpeg", "png"))


def read_movie(file: BinaryIO) -> Movie | None:
    """The index of an MP4 or QuickTime file; None if `file` is of another kind.

    Raises `FormatError` if its index is missing, which is so where a recording was cut off, or damaged.
    """
    size = file.seek(0, os.SEEK_END)
    found, missing = {}, 0
    for kind, start, end in _top_level(file, size):
        if not found and kind not in KNOWN:
            return None
        found.setdefault(kind, (start, min(end, size)))
        missing = max(0, end - size) if kind in KNOWN else 0
    if "moov" not in found:
        if not found.keys() & {"ftyp", "mdat"} or not found.keys() <= KNOWN:
            return None
        raise FormatError("has no index (box 'moov'): the recording or the copy was cut off before its end")
    start, end = found["moov"]
    if end - start > LARGEST_INDEX:
        raise FormatError(f"claims an index of {end - start} bytes; wanted at most {LARGEST_INDEX}: it is corrupt")
    file.seek(start)
    body = memoryview(file.read(end - start))
    header = find(body, "mvhd") or memoryview(b"")
    at = 20 if header[:1] == b"\1" else 12
    scale = struct.unpack_from(">I", header, at)[0] if len(header) >= at + 4 else 0
    tracks = (_track(inner, scale) for kind, inner in children(body) if kind == "trak")
    return Movie(tuple(track for track in tracks if track is not None), missing)


def _top_level(file: BinaryIO, size: int) -> Iterator[tuple[str, int, int]]:
    """Kind, start of the content and end of each box of the file. The last may end beyond the file."""
    at = 0
    for _ in range(MOST_BOXES):
        file.seek(at)
        head = file.read(16)
        if len(head) < 8:
            return
        length, kind = struct.unpack_from(">I4s", head)
        start = at + 8
        if length == 1 and len(head) == 16:
            length, start = struct.unpack_from(">Q", head, 8)[0], at + 16
        end = size if length == 0 else at + length
        if end < start or not kind.isalnum():
            return
        yield kind.decode("latin-1"), start, end
        if end >= size:
            return
        at = end


def children(body: memoryview) -> Iterator[tuple[str, memoryview]]:
    """Kind and content of each box in `body`; ends at what is no box."""
    at = 0
    for _ in range(MOST_BOXES):
        if at + 8 > len(body):
            return
        length, kind = struct.unpack_from(">I4s", body, at)
        start = at + 8
        if length == 1 and at + 16 <= len(body):
            length, start = struct.unpack_from(">Q", body, at + 8)[0], at + 16
        end = len(body) if length == 0 else at + length
        if end < start or end > len(body):
            return
        yield kind.decode("latin-1"), body[start:end]
        at = end


def find(body: memoryview, *path: str) -> memoryview | None:
    """The content of the first box at `path` below `body`; None if there is none."""
    for kind in path:
        below = next((inner for name, inner in children(body) if name == kind), None)
        if below is None:
            return None
        body = below
    return body


def _track(body: memoryview, scale: int) -> Track | None:
    handler, description = find(body, "mdia", "hdlr"), find(body, "mdia", "minf", "stbl", "stsd")
    if handler is None or len(handler) < 12 or description is None or len(description) < 16:
        return None
    entry = next(children(description[8:]), None)
    if entry is None:
        return None
    return Track(bytes(handler[8:12]).decode("latin-1"), entry[0], body, entry[1][VISUAL:], scale)


def samples(track: Track, file: BinaryIO) -> Iterator[tuple[float, bytes]]:
    """The time (seconds on the file's clock) and the bytes of each sample of `track`, by its tables.

    FFmpeg tells the same, but before PyAV 18 only by reading all pictures of the file as well.
    Raises `FormatError` if the tables are damaged. Samples beyond the end of a cut-off file are left out.
    """
    size = file.seek(0, os.SEEK_END)
    try:
        times, offsets, lengths = _tables(track, size)
    except (struct.error, ValueError, IndexError, TypeError) as error:
        raise FormatError(f"has a damaged table of samples in its track {track.entry!r} ({error})") from error
    for time, offset, length in zip(times.tolist(), offsets.tolist(), lengths.tolist(), strict=True):
        if offset + length <= size:
            file.seek(offset)
            yield time, file.read(length)


def _tables(track: Track, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (seconds), offsets in the file and lengths (bytes) of all samples."""
    table = find(track.body, "mdia", "minf", "stbl")
    header = find(track.body, "mdia", "mdhd")
    assert table is not None
    if header is None:
        raise ValueError("there is no time scale")
    scale = struct.unpack_from(">I", header, 20 if header[0] == 1 else 12)[0]
    if scale == 0:
        raise ValueError("the time scale is 0")
    lengths = _lengths(table, size)
    runs = _column(table, "stts", 2)
    if runs[:, 0].sum() < len(lengths):
        raise ValueError("there are fewer times than samples")
    kept = np.minimum(np.cumsum(runs[:, 0]), len(lengths))
    steps = np.repeat(runs[:, 1], np.diff(kept, prepend=0))
    times = (np.cumsum(steps) - steps) / scale + _shift(track, scale)
    return times, _offsets(table, lengths), lengths


def _lengths(table: memoryview, size: int) -> np.ndarray:
    """Bytes of each sample (``stsz``)."""
    sizes = find(table, "stsz")
    if sizes is None:
        raise ValueError("there is no stsz")
    each, count = struct.unpack_from(">II", sizes, 4)
    if each == 0:
        return np.frombuffer(sizes, ">u4", count, 12).astype(np.int64)
    if each * count > size:
        raise ValueError(f"{count} samples of {each} bytes do not fit in the file")
    return np.full(count, each, dtype=np.int64)


def _offsets(table: memoryview, lengths: np.ndarray) -> np.ndarray:
    """Where each sample lies in the file: chunks (``stco``, ``co64``), and the samples in each (``stsc``)."""
    kind, width = ("co64", ">u8") if find(table, "co64") is not None else ("stco", ">u4")
    body = find(table, kind)
    if body is None:
        raise ValueError("there is no stco")
    chunks = np.frombuffer(body, width, struct.unpack_from(">I", body, 4)[0], 8).astype(np.int64)
    runs = _column(table, "stsc", 3)
    if len(lengths) == 0:
        return np.zeros(0, dtype=np.int64)
    first = runs[:, 0] - 1
    if len(runs) == 0 or first[0] != 0 or (np.diff(first) <= 0).any() or (runs[:, 1] < 1).any():
        raise ValueError("stsc is out of order")
    first = first[first < len(chunks)]
    per_chunk = np.repeat(runs[: len(first), 1], np.diff(first, append=len(chunks)))
    kept = np.minimum(np.cumsum(per_chunk), len(lengths))
    if kept[-1] < len(lengths):
        raise ValueError("there are fewer chunks than samples")
    counts = np.diff(kept, prepend=0)
    before = np.cumsum(lengths) - lengths
    start_of_chunk = np.repeat(before[np.minimum(kept - counts, len(lengths) - 1)], counts)
    return np.repeat(chunks, counts) + before - start_of_chunk


def _column(table: memoryview, kind: str, width: int) -> np.ndarray:
    """The rows ``(N, width)`` of a table."""
    body = find(table, kind)
    if body is None:
        raise ValueError(f"there is no {kind}")
    count = struct.unpack_from(">I", body, 4)[0]
    return np.frombuffer(body, ">u4", width * count, 8).astype(np.int64).reshape(count, width)


def _shift(track: Track, scale: int) -> float:
    """Seconds from a sample's own time to the file's clock, by the first edit that shows something (``elst``)."""
    edits = find(track.body, "edts", "elst")
    if edits is None:
        return 0.0
    wide = edits[0] == 1
    shift = 0.0
    for k in range(min(struct.unpack_from(">I", edits, 4)[0], 2)):
        duration, start = struct.unpack_from(">Qq" if wide else ">Ii", edits, 8 + k * (20 if wide else 12))
        if start >= 0:
            return shift - start / scale
        shift += duration / track.scale if track.scale else 0.0
    return shift


# --- Matroska and WebM ---


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
