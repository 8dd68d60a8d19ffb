"""What a file says of itself beside its pictures: projection, tilt, cropped area, motion track, whether it is whole.

Sources: Spherical Video V2 RFC (boxes ``st3d`` and ``sv3d``; Matroska's Projection), Spherical Video V1 RFC (XML in a
``uuid`` box), Photo Sphere XMP Metadata (GPano), XMP (ISO 16684-1). FFmpeg tells a part of it: through PyAV, nothing of
meshes, of XML, of eyes from right to left, or of kinds that it does not know, and all that only once a picture is
decoded.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import BinaryIO
from xml.etree import ElementTree

import numpy as np

from eagor._checks import ROUNDING, is_twice_as_wide
from eagor.errors import FormatError, ImageError
from eagor.media.containers import Head, Movie, Track, children, find, read_head, read_movie
from eagor.odometry.imu import MotionTrack, read_insta360
from eagor.sphere import world_R_body

__all__ = [
    "GPANO", "GSPHERICAL", "LAYOUTS", "Layout", "Projection", "VideoMetadata", "of_head", "of_photograph", "of_track",
    "properties", "read_metadata",
]  # fmt: skip

UNSTITCHED = (".insv", ".360")  # as Insta360 and GoPro name recordings whose lenses are not put together yet

SPHERICAL = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")  # the uuid of Spherical Video V1
EYES = {  # where in the picture the left eye's is: first row, first column, rows, columns, as shares
    "mono": (0.0, 0.0, 1.0, 1.0),
    "top-bottom": (0.0, 0.0, 0.5, 1.0),
    "bottom-top": (0.5, 0.0, 0.5, 1.0),
    "left-right": (0.0, 0.0, 1.0, 0.5),
    "right-left": (0.0, 0.5, 1.0, 0.5),
}
HALF = (0.0, 0.0, 0.25, 0.25)  # what half a sphere lacks
LAYOUTS = {  # what --eyes says of a picture: how the eyes share it, what of the sphere each lacks, in words
    "mono": ("mono", (0.0,) * 4, "one panorama"),
    "left-right": ("left-right", (0.0,) * 4, "two whole panoramas side by side"),
    "right-left": ("right-left", (0.0,) * 4, "the same, the left eye's on the right"),
    "top-bottom": ("top-bottom", (0.0,) * 4, "two whole panoramas, the left eye's above"),
    "bottom-top": ("bottom-top", (0.0,) * 4, "the same, the left eye's below"),
    "vr180": ("left-right", HALF, "two half spheres side by side"),
    "vr180-top-bottom": ("top-bottom", HALF, "two half spheres, the left eye's above"),
}
ST3D = {0: "mono", 1: "top-bottom", 2: "left-right", 3: "custom", 4: "right-left"}
MATROSKA_STEREO = {0: "mono", 1: "left-right", 2: "bottom-top", 3: "top-bottom", 11: "right-left"}
MATROSKA_KINDS = {0: "rectangular", 1: "equirectangular", 2: "cubemap", 3: "mesh"}
EXPORT = (
    "Export it as an equirectangular video, twice as wide as high: in the camera's own app choose '360 video', or use "
    "FFmpeg's filter v360"
)

GOPRO = (
    "{0} is a GoPro recording that is not put together yet: its two tracks are the two strips of an equi-angular "
    "cubemap (EAC), which no rig of lenses describes. Export it as an equirectangular MP4 with GoPro's Player or Quik. "
    "Or with FFmpeg, some degrees off where the strips overlap: ffmpeg -i {0} -filter_complex "
    "'[0:v:0][0:v:1]vstack,v360=eac:e' -map 0:a? whole.mp4"
)

GPANO = "http://ns.google.com/photos/1.0/panorama/"
GSPHERICAL = "http://ns.google.com/videos/1.0/spherical/"
LARGEST = 1 << 29  # pixels of a sphere of which a picture is a part
LONGEST_XMP, LONGEST = 1 << 22, 100  # bytes of a packet, characters of a value: errors show them
AREA = (
    "FullPanoWidthPixels", "FullPanoHeightPixels", "CroppedAreaImageWidthPixels", "CroppedAreaImageHeightPixels",
    "CroppedAreaLeftPixels", "CroppedAreaTopPixels",
)  # fmt: skip
AREA_ADVICE = (
    "Directions would be wrong. Put these numbers right (exiftool writes them), or pad the picture to the whole "
    "sphere; a photograph all the same: --force (all columns for 360 degrees, all rows for 180)"
)


@dataclass(frozen=True, eq=False)
class VideoMetadata:
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


def read_metadata(path: str, lenses: bool = False) -> VideoMetadata:
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
        return VideoMetadata(raw=path.lower().endswith(UNSTITCHED))
    crop = "its track is to be cropped by {} (top), {} (bottom), {} (left), {} (right) pixels, which is not done"
    facts = (crop.format(*head.crop),) if any(head.crop) else ()
    return VideoMetadata(of_head(head), missing=head.missing, facts=facts)


def _of_movie(path: str, movie: Movie, file: BinaryIO, wanted: bool) -> VideoMetadata:
    motion, facts = None, ()
    raw = path.lower().endswith(UNSTITCHED)
    try:
        trailer = read_insta360(file)
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
    if lenses > 1 and not wanted and (path.lower().endswith(".360") or any(t.entry == "gpmd" for t in movie.tracks)):
        raise ImageError(GOPRO.format(os.path.basename(path)))
    if raw and lenses > 1 and not wanted:
        raise ImageError(
            f"{os.path.basename(path)} holds {lenses} tracks of pictures, one for each lens. Give the lenses with "
            f"--rig FILE.yaml (eagor camera calibrate makes one). Or: {EXPORT}"
        )
    if lenses > 1 and not wanted:
        facts += (f"it has {lenses} tracks of pictures, of which the first is taken",)
    if not movie.pictures:
        return VideoMetadata(None, motion, movie.missing, "", facts, raw)
    picture = movie.pictures[0]
    if find(picture.extensions, "clap") is not None:
        facts += ("its pictures are to be cropped (box clap), which is not done",)
    return VideoMetadata(of_track(picture), motion, movie.missing, picture.entry, facts, raw, lenses)


# --- projection ---


@dataclass(frozen=True)
class Projection:
    """What a file says; angles in radians.

    `source`: who says so, for texts. `kind`: "equirectangular", "cubemap", ... `stereo`: how two eyes share the
    picture. `yaw` (left), `pitch` (nose DOWN) and `roll` of the camera, as in `eagor.sphere.world_R_body`. `cropped`:
    shares of the whole sphere's rows and columns that the picture lacks at the top, bottom, left and right. `wrong`:
    why that is not known, if so.
    """

    source: str
    kind: str = "equirectangular"
    stereo: str = "mono"
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    cropped: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    wrong: str = ""

    @property
    def world_R_body(self) -> np.ndarray:
        """The rotation ``(3, 3)`` from the picture's axes to a level frame; heading 0 is the file's (GPano: north)."""
        return world_R_body(self.yaw, self.pitch, self.roll)

    @property
    def level_R_body(self) -> np.ndarray:
        """As `world_R_body`, without the heading: forward stays the picture's centre."""
        return world_R_body(0.0, self.pitch, self.roll)

    @classmethod
    def of_eyes(cls, layout: str) -> Projection:
        """What ``--eyes`` says, one of `LAYOUTS`."""
        stereo, cropped, _ = LAYOUTS[layout]
        return cls(f"--eyes {layout}", stereo=stereo, cropped=cropped)  # type: ignore[arg-type]

    def check(self, name: str, force: bool = False) -> None:
        """Raise `ImageError`, about the file `name`, unless it is an equirectangular panorama; `force`: of any area."""
        if self.kind not in ("equirectangular", "rectangular"):
            raise ImageError(f"{name} is a {self.kind} picture, as {self.source} says, not equirectangular. {EXPORT}")
        if self.stereo not in EYES:
            raise ImageError(f"{name} holds two eyes in a way ({self.stereo}) that is not read. {EXPORT}, for one eye")
        if self.wrong and not force:
            raise ImageError(f"{name}: {self.wrong}. {AREA_ADVICE}")
        top, bottom, left, right = self.cropped
        if not (top + bottom < 1 and left + right < 1):
            raise ImageError(f"{name} is damaged: {self.source} says that nothing is left of the picture")

    def facts(self) -> tuple[str, ...]:
        """Sentences for the user."""
        said = [f"{self.source} says: {self.kind}"]
        if self.wrong:
            said.append(f"{self.wrong}; ignored, with all columns for 360 degrees and all rows for 180")
        if self.stereo != "mono":
            said.append(f"it holds two eyes ({self.stereo}); the left one is taken")
        if any((self.yaw, self.pitch, self.roll)):
            angles = [f"{math.degrees(a) + 0.0:+.1f}" for a in (self.yaw, -self.pitch, self.roll)]
            said.append(
                f"{self.source} says how the camera was held: yaw {angles[0]} (left), pitch {angles[1]} (up), roll "
                f"{angles[2]} (right side down) degrees"
            )
        if any(self.cropped):
            rows, columns = 180 * (1 - sum(self.cropped[:2])), 360 * (1 - sum(self.cropped[2:]))
            said.append(f"it shows {columns:.0f} x {rows:.0f} degrees of the sphere; the rest counts as not seen")
        return tuple(said)

    def layout(self, height: int, width: int, rows: int | None = None) -> Layout:
        """Where a picture of `height` and `width` pixels, all its eyes included, goes in a whole panorama.

        With at most `rows` rows. A rectangular picture, or one of which nothing is known, keeps its shape.
        """
        eye = EYES[self.stereo]
        high, wide = max(1, round(height * eye[2])), max(1, round(width * eye[3]))
        top, bottom, left, right = self.cropped
        whole = high / (1 - top - bottom)
        count = max(1, round(whole if rows is None else min(rows, whole)))
        columns = 2 * count if self.kind == "equirectangular" else max(1, round(wide * count / high))
        first, last = round(top * count), max(round(top * count) + 1, round((1 - bottom) * count))
        start, stop = round(left * columns), max(round(left * columns) + 1, round((1 - right) * columns))
        return Layout((count, columns), slice(first, last), slice(start, stop), eye)


@dataclass(frozen=True)
class Layout:
    """Where a picture goes in a panorama of `shape`: to `rows` and `columns`. `eye`: the part of it to take."""

    shape: tuple[int, int]
    rows: slice
    columns: slice
    eye: tuple[float, float, float, float]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width to which the picture is scaled, all its eyes included."""
        high, wide = self.rows.stop - self.rows.start, self.columns.stop - self.columns.start
        return round(high / self.eye[2]), round(wide / self.eye[3])

    def place(self, scaled: np.ndarray) -> np.ndarray:
        """The panorama ``(*shape, 3)``: the eye of a picture of `size`, at its place. Black where nothing is known."""
        high, wide = self.rows.stop - self.rows.start, self.columns.stop - self.columns.start
        top, left = round(self.eye[0] * scaled.shape[0]), round(self.eye[1] * scaled.shape[1])
        part = scaled[top : top + high, left : left + wide]
        if part.shape[:2] == self.shape:
            return np.ascontiguousarray(part)
        panorama = np.zeros((*self.shape, *scaled.shape[2:]), dtype=scaled.dtype)
        panorama[self.rows, self.columns] = part
        return panorama

    @property
    def unseen(self) -> np.ndarray | None:
        """The mask ``shape`` of what the picture does not show; None if it shows the whole sphere."""
        mask = np.ones(self.shape, dtype=bool)
        mask[self.rows, self.columns] = False
        return mask if mask.any() else None


def of_track(track: Track) -> Projection | None:
    """What the boxes of an MP4 track say; None if nothing. V2 has priority over V1, as the V2 RFC wants."""
    inner = find(track.extensions, "sv3d", "proj")
    found = None if inner is None else _of_boxes(inner)
    stereo = find(track.extensions, "st3d")
    mode = ST3D.get(stereo[4], f"mode {stereo[4]}") if stereo is not None and len(stereo) > 4 else None
    if found is None:
        found = _of_xml(track)
    if mode is not None:
        found = Projection("its box st3d", "rectangular", mode) if found is None else replace(found, stereo=mode)
    return found


def _of_boxes(inner: memoryview) -> Projection | None:
    """Of the content of ``proj``.

    The signs are those of the V2 RFC as corrected in 2016: yaw to the left, pitch up, roll clockwise about the forward
    vector for one who looks back along it, which is the left side down.
    """
    kinds = {"equi": "equirectangular", "cbmp": "cubemap", "mshp": "mesh"}
    found = Projection("its box sv3d")
    for kind, body in children(inner):
        if kind == "prhd" and len(body) >= 16:
            yaw, pitch, roll = (value / 65536 for value in struct.unpack_from(">iii", body, 4))
            found = _posed(found, yaw, pitch, roll)
        elif kind == "equi" and len(body) >= 20:
            found = replace(found, kind="equirectangular", cropped=_bounds(bytes(body)))
        elif kind in kinds:
            found = replace(found, kind=kinds[kind])
    return found


def _posed(found: Projection, yaw: float, pitch: float, roll: float) -> Projection:
    """With the pose of the V2 RFC (degrees)."""
    if not all(math.isfinite(angle) for angle in (yaw, pitch, roll)):
        return found
    return replace(found, yaw=math.radians(yaw), pitch=-math.radians(pitch), roll=-math.radians(roll))


def _bounds(equi: bytes) -> tuple[float, float, float, float]:
    """The content of ``equi``: version and flags, then what is cropped, in 2 ** -32 of the whole."""
    top, bottom, left, right = (value / 2**32 for value in struct.unpack_from(">IIII", equi, 4))
    return top, bottom, left, right


def _of_xml(track: Track) -> Projection | None:
    """Spherical Video V1."""
    for kind, body in children(track.body):
        if kind == "uuid" and bytes(body[:16]) == SPHERICAL:
            said = properties(bytes(body[16:]), GSPHERICAL)
            if said.get("Spherical", "").lower() == "true":
                return _with_area(
                    Projection(
                        "its XML of Spherical Video V1",
                        said.get("ProjectionType", "equirectangular").lower(),
                        said.get("StereoMode", "mono").lower(),
                    ),
                    said,
                )
    return None


def _with_area(found: Projection, said: Mapping[str, str], size: tuple[int, int] | None = None) -> Projection:
    """With the cropped area, or with what is wrong about it.

    `size`: width and height of the picture, if known. What is not told follows from the rest where there is one way
    only: the sphere is twice as wide as high, and a part that fills it begins at its border.
    """
    told = {name: said[name] for name in AREA if name in said}
    if not told or (size is None and not told.keys() & set(AREA[2:4])):
        if size is None or is_twice_as_wide(size[1], size[0]):
            return found
        return replace(found, wrong=f"{found.source} says equirectangular, and not which part of the sphere; the "
                       f"picture is {size[0]} x {size[1]}, not 2:1")  # fmt: skip
    words = f"{found.source} says an area that does not add up: " + ", ".join(f"{k} {v}" for k, v in told.items())
    words += f"; the picture is {size[0]} x {size[1]}" if size else ""
    try:
        width, height, wide, high, left, top = (float(told[name]) if name in told else math.nan for name in AREA)
    except ValueError:
        return replace(found, wrong=words)
    shape = size or (math.nan, math.nan)
    wide, high = (shown if math.isnan(n) else n for n, shown in zip((wide, high), shape, strict=True))
    height = width / 2 if math.isnan(height) else height
    width = 2 * height if math.isnan(width) else width
    slack = max(ROUNDING, 0.002 * width)
    left, top = (
        0.0 if math.isnan(start) and (size is None or abs(full - n) <= slack) else start
        for start, n, full in ((left, wide, width), (top, high, height))
    )
    fits = all(
        start >= -slack and n >= 1 and start + n <= full + slack < 1e6 and full >= 1
        for start, n, full in ((left, wide, width), (top, high, height))
    )
    square = abs(width - 2 * height) <= 2 * slack  # and the picture is the part that was cut, in any size
    alike = size is None or abs(size[0] * high - size[1] * wide) <= 0.02 * size[0] * high + ROUNDING * max(wide, high)
    if not (fits and square and alike):  # also where a number is missing
        return replace(found, wrong=words)
    if size is not None and size[0] * size[1] / (wide * high) * width * height > LARGEST:
        return replace(found, wrong=words)
    cropped: list[float] = []
    for start, n, full in ((top, high, height), (left, wide, width)):  # a part that juts out by rounding is moved in
        first = min(max(start / full, 0.0), max(1 - n / full, 0.0))
        cropped += [first, max(1 - first - n / full, 0.0)]
    return replace(found, cropped=tuple(cropped))


def of_head(head: Head) -> Projection | None:
    """What Matroska's elements say.

    Angles are read as in MP4. RFC 9559 has other signs for yaw and roll, as had the V2 RFC before its correction, but
    programs write the same numbers into both kinds of file.
    """
    stereo = MATROSKA_STEREO.get(head.stereo, f"StereoMode {head.stereo}")
    if head.projection is None:
        return Projection("its StereoMode", "rectangular", stereo) if head.stereo else None
    kind = MATROSKA_KINDS.get(head.projection, f"kind {head.projection}")
    found = _posed(Projection("its Projection element", kind, stereo), *head.pose)
    if kind == "equirectangular" and len(head.private) >= 20:
        found = replace(found, cropped=_bounds(head.private))
    return found


def of_photograph(said: Mapping[str, str], size: tuple[int, int]) -> Projection | None:
    """What the GPano properties of a picture of `size` (width, height) say; None if they name no projection.

    The heading is clockwise from north, the pitch up; with the roll the horizon turns counterclockwise in the picture,
    so the camera's right side is down. They are applied in this order.
    """
    if "ProjectionType" not in said:
        return None

    def angle(name: str) -> float:
        try:
            value = float(said.get(f"Pose{name}Degrees", 0))
        except ValueError:
            return 0.0
        return math.radians(value) if math.isfinite(value) else 0.0

    kind = said["ProjectionType"].lower()
    found = Projection("its XMP (GPano)", kind, "mono", -angle("Heading"), -angle("Pitch"), angle("Roll"))
    return _with_area(found, said, size)


# --- XMP ---


def properties(xmp: bytes, namespace: str) -> dict[str, str]:
    """The simple properties of `namespace` in a packet, by name: attributes or elements. Empty if it is unreadable."""
    if len(xmp) > LONGEST_XMP or b"<!DOCTYPE" in xmp or b"<!ENTITY" in xmp:  # no XMP needs these, and they can be bombs
        return {}
    try:
        root = ElementTree.fromstring(xmp.strip(b"\0 \t\r\n"))
    except (ElementTree.ParseError, ValueError, LookupError):  # LookupError: an encoding that is not known
        return {}
    found, prefix = {}, f"{{{namespace}}}"
    for element in root.iter():
        pairs = [*element.items(), (element.tag, element.text or "")]
        found |= {name[len(prefix) :]: text.strip()[:LONGEST] for name, text in pairs if name.startswith(prefix)}
    return found
