"""What a file says of its pictures: projection, eyes, tilt, and which part of the sphere they show.

Of videos FFmpeg tells it (Spherical Video V1 and V2, Matroska's Projection), with the first picture. Of photographs it
is read here: Photo Sphere XMP Metadata (GPano), XMP (ISO 16684-1).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np

from eagor._checks import ROUNDING, is_twice_as_wide
from eagor.errors import ImageError
from eagor.sphere import world_R_body

__all__ = ["EXPORT", "EYES", "GPANO", "LAYOUTS", "Layout", "Projection", "of_photograph", "of_video", "properties"]

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
EXPORT = (
    "Export it as an equirectangular video, twice as wide as high: in the camera's own app choose '360 video', or use "
    "FFmpeg's filter v360"
)

# FFmpeg's AVSphericalProjection and AVStereo3DType (and the latter with its flag "inverted").
SPHERES = ("equirectangular", "cubemap", "equirectangular", "equirectangular", "rectangular", "fisheye")
HALF_SPHERE = 3
STEREO = {0: "mono", 1: "left-right", 2: "top-bottom"}
INVERTED = {"left-right": "right-left", "top-bottom": "bottom-top"}

GPANO = "http://ns.google.com/photos/1.0/panorama/"
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
    def level_R_body(self) -> np.ndarray | None:
        """The rotation ``(3, 3)`` from the picture's axes to level ones; forward stays its centre. None if it is."""
        return world_R_body(0.0, self.pitch, self.roll) if self.pitch or self.roll else None

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

    def facts(self) -> tuple[str, ...]:
        """Sentences for the user."""
        yaw, pitch, roll = (f"{math.degrees(a) + 0.0:+.1f}" for a in (self.yaw, -self.pitch, self.roll))
        rows, columns = 180 * (1 - sum(self.cropped[:2])), 360 * (1 - sum(self.cropped[2:]))
        said = {
            f"{self.source} says: {self.kind}": True,
            f"{self.wrong}; ignored, with all columns for 360 degrees and all rows for 180": self.wrong,
            f"it holds two eyes ({self.stereo}); the left one is taken": self.stereo != "mono",
            f"{self.source} says how the camera was held: yaw {yaw} (left), pitch {pitch} (up), roll {roll} (right "
            "side down) degrees": self.yaw or self.pitch or self.roll,
            f"it shows {columns:.0f} x {rows:.0f} degrees of the sphere; the rest counts as not seen": any(
                self.cropped
            ),
        }
        return tuple(fact for fact, holds in said.items() if holds)

    def layout(self, size: tuple[int, int], rows: int | None, whole: bool) -> Layout:
        """Where an eye of `size` (width, height) goes in a frame of at most `rows` rows: of the `whole` sphere, or not.

        Otherwise it keeps its shape.
        """
        (wide, high), (top, bottom, left, right) = size, self.cropped
        full = high / (1 - top - bottom)
        count = max(1, round(full if rows is None else min(rows, full)))
        columns = 2 * count if whole else max(1, round(wide * count / high))
        return Layout((count, columns), _part(top, bottom, count), _part(left, right, columns), EYES[self.stereo])


def _part(before: float, after: float, count: int) -> slice:
    """Which of `count` rows or columns remain without these shares of them."""
    first = round(before * count)
    return slice(first, max(first + 1, round((1 - after) * count)))


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


def of_video(side_data: Mapping[str, bytes]) -> Projection | None:
    """What a video says, as PyAV's side data of its first picture has it; None if it says nothing.

    The signs are those of the V2 RFC as corrected in 2016: yaw to the left, pitch up, roll clockwise about the forward
    vector for one who looks back along it, which is the left side down.
    """
    found = None
    if len(sphere := side_data.get("SPHERICAL", b"")) >= 32:
        kind, yaw, pitch, roll, *bounds = struct.unpack_from("=4i4I", sphere)
        left, top, right, bottom = (bound / 2**32 for bound in bounds)
        yaw, pitch, roll = (math.radians(angle / 65536) for angle in (yaw, pitch, roll))
        name = SPHERES[kind] if 0 <= kind < len(SPHERES) else f"kind {kind}"
        cropped = HALF if kind == HALF_SPHERE else (top, bottom, left, right)
        found = Projection("its metadata", name, "mono", yaw, -pitch, -roll, cropped)
    if len(eyes := side_data.get("STEREO3D", b"")) >= 8:
        kind, flags = struct.unpack_from("=2i", eyes)
        stereo = STEREO.get(kind, f"kind {kind}")
        stereo = INVERTED.get(stereo, stereo) if flags & 1 else stereo
        found = replace(found or Projection("its metadata", "rectangular"), stereo=stereo)
    return found


# --- photographs ---


def of_photograph(said: Mapping[str, str], size: tuple[int, int]) -> Projection | None:
    """What the GPano properties of a picture of `size` (width, height) say; None if they name no projection.

    The heading is clockwise from north, the pitch up; with the roll the horizon turns counterclockwise in the picture,
    so the camera's right side is down. They are applied in this order.
    """
    if not said.keys() & {"ProjectionType", *AREA}:  # an area without a type: GPano's own is equirectangular
        return None

    def angle(name: str) -> float:
        with suppress(ValueError):
            if math.isfinite(value := float(said.get(f"Pose{name}Degrees", 0))):
                return math.radians(value)
        return 0.0

    kind = said.get("ProjectionType", "equirectangular").lower()
    found = Projection("its XMP (GPano)", kind, "mono", -angle("Heading"), -angle("Pitch"), angle("Roll"))
    area, shape = {name: said[name] for name in AREA if name in said}, f"the picture is {size[0]} x {size[1]}"
    if area:
        cropped = _cropped(area, size)
        listed = ", ".join(f"{key} {value}" for key, value in area.items())
        wrong = f"{found.source} says an area that does not add up: {listed}; {shape}"
        return replace(found, wrong=wrong) if cropped is None else replace(found, cropped=cropped)
    wrong = f"{found.source} says {kind}, and not which part of the sphere; {shape}, not 2:1"
    return found if is_twice_as_wide(size[1], size[0]) else replace(found, wrong=wrong)


def _cropped(area: Mapping[str, str], size: tuple[int, int]) -> tuple[float, float, float, float] | None:
    """What a picture of `size` lacks at the top, bottom, left and right, by its `area`; None if that cannot be.

    What is not told follows from the rest where there is one way only: the sphere is twice as wide as high, and a part
    that fills it begins at its border.
    """
    try:
        width, height, wide, high, left, top = (float(area.get(name, "nan")) for name in AREA)
    except ValueError:
        return None
    wide, high = (own if math.isnan(n) else n for n, own in zip((wide, high), size, strict=True))
    height = width / 2 if math.isnan(height) else height
    width = 2 * height if math.isnan(width) else width
    slack, cropped = max(ROUNDING, 0.002 * width), list[float]()
    for start, n, full in ((top, high, height), (left, wide, width)):
        start = 0.0 if math.isnan(start) and abs(full - n) <= slack else start
        if not (start >= -slack and n >= 1 and start + n <= full + slack < 1e6 and full >= 1):  # or one is missing
            return None
        first = min(max(start / full, 0.0), max(1 - n / full, 0.0))  # a part that juts out by rounding is moved in
        cropped += [first, max(1 - first - n / full, 0.0)]
    square = abs(width - 2 * height) <= 2 * slack  # and the picture is the part that was cut, in any size
    alike = abs(size[0] * high - size[1] * wide) <= 0.02 * size[0] * high + ROUNDING * max(wide, high)
    small = size[0] * size[1] / (wide * high) * width * height <= LARGEST
    return (cropped[0], cropped[1], cropped[2], cropped[3]) if square and alike and small else None


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
