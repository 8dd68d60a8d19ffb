"""Cameras with lenses: all that is needed to make panoramas of their pictures, and their YAML files.

The format::

    pictures:                    # one, or one per lens
      - {width: 3840, height: 1920}
    lenses:
      - name: front
        kind: fisheye            # fisheye (default) or pinhole
        picture: 0               # which of the pictures shows it (default: 0)
        centre: [960.0, 960.0]   # x, y of the optical axis, pixels; the first pixel's centre is at 0.5
        radius: 960.0            # fisheye: pixels from the centre to the rim
        field_deg: 200.0         # fisheye: angle from rim to rim; or focal, pixels per radian at the centre
        polynomial: [0, 0, 0, 0] # fisheye: factors of angle^3, ^5, ^7, ^9 (radians) (default: equidistant)
        rotation: {yaw_deg: 0, pitch_deg: 0, roll_deg: 0}   # of the lens in the body: left, nose DOWN, roll
      - name: side
        kind: pinhole
        focal: [610.0, 611.0]    # pinhole: pixels, one number or x and y
        centre: [640.0, 360.0]
        distortion: [-0.1, 0.01, 0, 0, 0]                   # k1, k2, p1, p2, k3, k4, k5, k6, as OpenCV orders them
        rotation: [0.707, 0, 0, 0.707]                      # or a unit quaternion w, x, y, z
      - name: left_optical_frame # or optical: true: the rotation is that of axes x right, y down, z forward
        kind: pinhole
        focal: 610.0
        centre: [640.0, 360.0]
        rotation: {x: -0.5, y: 0.5, z: -0.5, w: 0.5}        # or a quaternion by names, as a ROS static transform has it
        position: [0.1, 0.0, 0.3]                           # ignored: lenses count as in one place

YAML is read node by node: errors name the line, the entry, what is there and what was wanted. OpenCV writes YAML, too
(FileStorage), with a first line and tags of its own, and the same as XML; `read_yaml` takes both.
"""

from __future__ import annotations

import json
import math
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError, ParserCreate

import numpy as np
from scipy.spatial.transform import Rotation

from eagor._checks import shown
from eagor._extras import need
from eagor._files import read_file, written
from eagor.conventions import OPTICAL_R_BODY, is_optical, rotation_from_wxyz
from eagor.errors import EagorError, FormatError, GridError, ImageError
from eagor.lenses import MOST, FisheyeLens, Lens, PinholeLens
from eagor.sphere import world_R_body

__all__ = ["Place", "Rig", "dual_fisheye", "read_rig", "read_yaml", "sizes_of", "write_rig"]

SHAPE = 0.01  # by which the ratio of a picture's sides may differ from the rig's: rounding to even numbers

BOTH = ("name", "kind", "picture", "centre", "rotation", "optical", "position")
KEYS = {
    "fisheye": (*BOTH, "focal", "field_deg", "radius", "polynomial"),
    "pinhole": (*BOTH, "focal", "distortion"),
}
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")
QUATERNION = ("x", "y", "z", "w")
UNIT = 0.01  # by which the length of a quaternion may differ from 1


@dataclass(frozen=True, eq=False)
class Rig:
    """The `lenses` of a camera, in pixels of pictures of the `sizes` (width, height): one, or one per lens.

    Raises `GridError` where there is no lens, or one refers to a picture that there is not.
    """

    sizes: tuple[tuple[int, int], ...]
    lenses: tuple[Lens, ...]

    def __post_init__(self) -> None:
        if not self.lenses or not self.sizes:
            raise GridError("a rig needs at least one lens and one picture")
        if not all(0 < side <= MOST for size in self.sizes for side in size):
            raise GridError(f"a rig has pictures of {shown(self.sizes)}; wanted pixels, 1 to {MOST:g} along each side")
        for lens in self.lenses:
            if not 0 <= lens.picture < len(self.sizes):
                raise GridError(
                    f"the lens {lens.name!r} is in picture {lens.picture}; wanted 0 to {len(self.sizes) - 1}"
                )

    @property
    def rows(self) -> int:
        """Rows of a panorama that is as fine as the pictures, an even number."""
        return max(2, 2 * round(math.pi * max(lens.pixels_per_radian for lens in self.lenses) / 2))

    def scaled(self, factor: float) -> Rig:
        """The same for pictures that are `factor` times as large."""
        sizes = tuple((max(1, round(w * factor)), max(1, round(h * factor))) for w, h in self.sizes)
        return Rig(sizes, tuple(lens.scaled(factor) for lens in self.lenses))

    def turned(self, new_R_old: np.ndarray) -> Rig:
        """The same on a body with other axes: ``new_R_old @ direction_old = direction_new``."""
        lenses = tuple(replace(lens, body_R_lens=new_R_old @ lens.body_R_lens) for lens in self.lenses)
        return Rig(self.sizes, lenses)

    def factor_of(self, sizes: tuple[tuple[int, int], ...], name: str) -> float:
        """How much larger than the rig's own are pictures of these `sizes` (width, height).

        Raises `ImageError`, about `name`, if they are others: another number, or another shape.
        """
        if len(sizes) != len(self.sizes):
            raise ImageError(
                f"{name} gives {len(sizes)} picture{'s' if len(sizes) > 1 else ''} at a time, and the rig is for "
                f"{len(self.sizes)}; give as many files or streams as the rig lists pictures, with commas between"
            )
        factors = [width / own[0] for (width, _), own in zip(sizes, self.sizes, strict=True)]
        for (width, height), own, factor in zip(sizes, self.sizes, factors, strict=True):
            if abs(height / own[1] / factor - 1) > SHAPE or abs(factor / factors[0] - 1) > SHAPE:
                raise ImageError(
                    f"{name} is {width} x {height}, and the rig is for pictures of {own[0]} x {own[1]}, or the same "
                    "shape in another size. Set the camera to that resolution, or calibrate the rig with pictures of "
                    "this one (eagor camera calibrate)"
                )
        return factors[0]


def sizes_of(pictures: Iterable[np.ndarray]) -> tuple[tuple[int, int], ...]:
    """Width and height of each picture ``(H, W, ...)``, as rigs count them."""
    return tuple((picture.shape[1], picture.shape[0]) for picture in pictures)


def dual_fisheye(width: int, height: int, fov: float = math.radians(200)) -> Rig:
    """Two ideal lenses back to back, their circles side by side in one picture, the front one on the left.

    Each circle touches the top and the bottom of the picture; `fov`: the angle across it, radians.
    """
    places = (("front", width / 4, 0.0), ("back", 3 * width / 4, math.pi))
    lenses = tuple(
        FisheyeLens.of_field(name, (x, height / 2), min(height, width / 2) / 2, fov, body_R_lens=world_R_body(yaw))
        for name, x, yaw in places
    )
    return Rig(((width, height),), lenses)


# --- YAML files ---


def read_rig(path: str | os.PathLike[str]) -> Rig:
    """The rig in the YAML file at `path`; the format is this module's text.

    Raises `FormatError`, which names the line, what is there and what was wanted.
    """
    name = os.fspath(path)
    root = read_yaml(name, "a rig", "pictures and lenses")
    try:
        return _rig(root)
    except EagorError as error:
        raise FormatError(f"{name}, {error}") from error


def _rig(root: Place) -> Rig:
    entries = root.mapping(("pictures", "lenses"))
    for key in ("pictures", "lenses"):
        if key not in entries:
            raise root.wrong(f"has no {key}; wanted pictures (width and height of each) and lenses")
    sizes = []
    for picture in entries["pictures"].items("a list of width and height, one entry per picture"):
        sides = picture.mapping(("width", "height"))
        if len(sides) < 2:
            raise picture.wrong("lacks a side; wanted width and height, in pixels")
        width, height = (int(sides[side].number("a whole number of pixels", True)) for side in ("width", "height"))
        if min(width, height) < 1:
            raise picture.wrong(f"is {width} x {height}; wanted pixels, at least 1")
        sizes.append((width, height))
    if not sizes:
        raise entries["pictures"].wrong("is empty; wanted width and height of at least one picture")
    lenses = []
    for place in entries["lenses"].items("a list of lenses"):
        try:
            lenses.append(_lens(place, sizes))
        except FormatError:
            raise
        except EagorError as error:  # values that are numbers, but no lens
            raise place.wrong(f"cannot be: {error}") from error
    if not lenses:
        raise entries["lenses"].wrong("is empty; wanted at least one lens")
    return Rig(tuple(sizes), tuple(lenses))


def _lens(place: Place, sizes: Sequence[tuple[int, int]]) -> Lens:
    every = dict.fromkeys(key for keys in KEYS.values() for key in keys)
    found = place.mapping(tuple(every))
    kind = found["kind"].text() if "kind" in found else "fisheye"
    if kind not in KEYS:
        raise found["kind"].wrong(f"is {kind!r}; wanted fisheye or pinhole")
    found = place.mapping(KEYS[kind])
    name = found["name"].text() if "name" in found else place.path
    picture = int(found["picture"].number("the number of a picture, from 0", True)) if "picture" in found else 0
    if not 0 <= picture < len(sizes):
        raise found["picture"].wrong(f"is {picture}; wanted 0 to {len(sizes) - 1}, since pictures lists {len(sizes)}")
    rotation = _rotation(found["rotation"]) if "rotation" in found else np.eye(3)
    optical = found["optical"].text().lower() if "optical" in found else str(is_optical(name)).lower()
    if optical not in ("true", "false"):
        raise found["optical"].wrong(f"is {optical!r}; wanted true or false")
    if optical == "true" and "rotation" not in found:
        raise place.wrong("has no rotation; wanted that of its optical frame (x right, y down, z forward) in the body")
    if optical == "true":
        rotation = rotation @ OPTICAL_R_BODY
    if "position" in found:
        found["position"].numbers(3, 3, "x, y, z, metres")
        warnings.warn(f"{place.path}.position is ignored: lenses count as in one place", UserWarning, stacklevel=2)
    if "centre" not in found:
        raise place.wrong("has no centre; wanted x and y of the optical axis, pixels")
    x, y = found["centre"].numbers(2, 2, "x and y, pixels")
    common: dict[str, Any] = {"body_R_lens": rotation, "picture": picture}
    if kind == "pinhole":
        if "focal" not in found:
            raise place.wrong("has no focal; wanted the focal length in pixels, one number or x and y")
        focal = _pair(found["focal"])
        distortion = ()
        if "distortion" in found:
            distortion = found["distortion"].numbers(0, 8, "up to eight numbers: k1, k2, p1, p2, k3, k4, k5, k6")
        return PinholeLens(name, sizes[picture], focal, (x, y), distortion, **common)
    if "radius" not in found or ("focal" in found) == ("field_deg" in found):
        raise place.wrong(
            "needs radius (pixels from the centre to the rim), and either field_deg (degrees from rim to rim) or focal "
            "(pixels per radian at the centre)"
        )
    radius = found["radius"].number("pixels")
    if "polynomial" in found:
        common["polynomial"] = found["polynomial"].numbers(0, 4, "up to four numbers")
    if "field_deg" in found:
        fov = math.radians(found["field_deg"].number("degrees"))
        return FisheyeLens.of_field(name, (x, y), radius, fov, **common)
    return FisheyeLens(name, (x, y), found["focal"].number("pixels per radian"), radius, **common)


def _pair(place: Place) -> tuple[float, float]:
    """One number for both, or two."""
    if isinstance(place.node.value, str):
        value = place.number("pixels: one number, or x and y")
        return value, value
    x, y = place.numbers(2, 2, "pixels: one number, or x and y")
    return x, y


def _rotation(place: Place) -> np.ndarray:
    if place.node.tag.endswith("seq"):
        wxyz = np.array(place.numbers(4, 4, "a quaternion w, x, y, z, or yaw_deg, pitch_deg and roll_deg"))
        return _unit_quaternion(place, wxyz)
    if place.node.id == "mapping" and {key.value for key, _ in place.node.value} & set(QUATERNION):
        named = place.mapping(QUATERNION)
        if len(named) < 4:
            raise place.wrong(f"has {', '.join(named)} only; wanted a quaternion x, y, z, w")
        return _unit_quaternion(place, np.array([named[name].number() for name in ("w", "x", "y", "z")]))
    found = place.mapping(ANGLES)
    return world_R_body(*(math.radians(found[name].number("degrees")) if name in found else 0.0 for name in ANGLES))


def _unit_quaternion(place: Place, wxyz: np.ndarray) -> np.ndarray:
    norm = float(np.linalg.norm(wxyz))
    if abs(norm - 1) > UNIT:
        raise place.wrong(f"has length {norm:.3g}; wanted a unit quaternion w, x, y, z")
    return rotation_from_wxyz(wxyz / norm)


def write_rig(rig: Rig, path: str | os.PathLike[str], notes: Sequence[str] = ()) -> None:
    """Write a rig so that `read_rig` reads the same; `notes` become comments at its head. Raises `StorageError`."""
    lines = [f"# {' '.join(note.split())}" for note in notes]
    lines += ["pictures:", *(f"  - {{width: {width}, height: {height}}}" for width, height in rig.sizes), "lenses:"]
    for lens in rig.lenses:
        fields = _fields(lens)
        first, *others = (f"{key}: {value}" for key, value in fields.items())
        lines += [f"  - {first}", *(f"    {each}" for each in others)]
    written(Path(path), "\n".join(lines) + "\n")


def _fields(lens: Lens) -> Mapping[str, str]:
    yaw, pitch, roll = Rotation.from_matrix(lens.body_R_lens).as_euler("ZYX", degrees=True)
    angles = ", ".join(f"{key}: {value:.6f}" for key, value in zip(ANGLES, (yaw, pitch, roll), strict=True))
    common = {"picture": str(lens.picture), "centre": _list(lens.centre), "rotation": f"{{{angles}}}"}
    # JSON's strings are YAML's.
    head = {"name": json.dumps(lens.name, ensure_ascii=False)}
    if isinstance(lens, PinholeLens):
        own = {"focal": _list(lens.focal), "distortion": _list(lens.distortion)}
        return head | {"kind": "pinhole"} | common | own
    own = {"focal": f"{lens.focal:.6f}", "radius": f"{lens.radius:.6f}", "polynomial": _list(lens.polynomial)}
    about = {"focal": f"{own.pop('focal')}  # {2 * math.degrees(lens.reach):.2f} degrees from rim to rim"}
    return head | {"kind": "fisheye"} | common | about | own


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value:.9g}' for value in values)}]"


# --- YAML, node by node ---


LARGEST = 1 << 20  # bytes: a calibration has a few hundred
DEEPEST = 50  # nesting of XML


def read_yaml(path: str | os.PathLike[str], kind: str, wanted: str) -> Place:
    """The root of the YAML file at `path`, a file of this `kind` with what is `wanted`. Raises `FormatError`."""
    need("reading a calibration (YAML)", "photos", "yaml")
    import yaml

    name = os.fspath(path)
    try:
        if os.path.getsize(name) > LARGEST:
            raise FormatError(f"{name} is larger than {LARGEST} bytes; wanted {wanted}")
        text = read_file(name).decode("utf-8-sig")
        if text.lstrip().startswith("<"):
            return Place(_of_xml(text), "")
        if text.startswith("%YAML"):  # OpenCV writes "%YAML:1.0", which YAML does not allow; the line stays counted
            text = "#" + text
        root = next(yaml.compose_all(text, Loader=yaml.SafeLoader), None)  # ros2 topic echo ends each message with ---
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise FormatError(f"{name} cannot be read as {kind} ({why}); give a YAML file with {wanted}") from error
    except (yaml.YAMLError, ExpatError) as error:
        kind = "XML" if isinstance(error, ExpatError) else "YAML"
        raise FormatError(f"{name} is not {kind} ({' '.join(str(error).split())}); wanted {wanted}") from error
    if root is None:
        raise FormatError(f"{name} is empty; wanted {wanted}")
    return Place(root, "")


def _of_xml(text: str) -> Any:
    """The node of what OpenCV writes as XML, as PyYAML has it of the same as YAML. Raises `ExpatError`.

    Elements called ``_``, and words without quotes, are the members of a list.
    """
    import yaml

    parser = ParserCreate()
    inside: list[list[tuple[Any, Any]]] = [[]]  # of each element that is open: its names and values, and its texts
    texts: list[list[str]] = [[]]

    def mark() -> Any:
        return yaml.Mark("", 0, parser.CurrentLineNumber - 1, 0, None, 0)

    def scalar(value: str) -> Any:
        return yaml.ScalarNode("tag:yaml.org,2002:str", value, mark())

    def refuse(*_: Any) -> None:
        raise ExpatError(f"line {parser.CurrentLineNumber}: it declares entities, or is nested too deep")

    def begin(name: str, _: Any) -> None:
        if len(texts) > DEEPEST:
            refuse()
        inside[-1].append((scalar(name), None))
        inside.append([])
        texts.append([])

    def end(name: str) -> None:
        members, said = inside.pop(), "".join(texts.pop()).strip()
        key = inside[-1].pop()[0]
        if members and any(each.value != "_" for each, _ in members):
            node = yaml.MappingNode("tag:yaml.org,2002:map", members, key.start_mark)
        elif members or name == "data" or (len(said.split()) > 1 and not said.startswith('"')):
            listed = [each for _, each in members] or [*map(scalar, said.split())]
            node = yaml.SequenceNode("tag:yaml.org,2002:seq", listed, key.start_mark)
        else:
            node = scalar(said.strip('"'))
        inside[-1].append((key, node))

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler = lambda words: texts[-1].append(words)
    parser.EntityDeclHandler = refuse
    parser.Parse(text, True)
    return inside[0][0][1]


class Place:
    """A node of a file, of PyYAML: reads it as what is wanted, or raises `FormatError` with its line."""

    def __init__(self, node: Any, path: str) -> None:
        self.node, self.path = node, path

    def wrong(self, wanted: str) -> FormatError:
        return FormatError(f"line {self.node.start_mark.line + 1}: {self.path or 'the file'} {wanted}")

    def mapping(self, keys: Sequence[str] | None = None) -> dict[str, Place]:
        """The entries; only `keys` are allowed."""
        if self.node.id != "mapping":
            raise self.wrong(f"is {self._what()}; wanted names with values" + (f": {', '.join(keys)}" if keys else ""))
        found: dict[str, Place] = {}
        for key, value in self.node.value:
            name = str(key.value)
            place = Place(value, f"{self.path}.{name}" if self.path else name)
            line = key.start_mark.line + 1
            if name in found:
                raise FormatError(f"line {line}: {place.path} is there twice")
            if keys is not None and name not in keys:
                near = get_close_matches(name, keys, 1)
                hint = f"; did you mean {near[0]}?" if near else ""
                raise FormatError(f"line {line}: {place.path} is no key here{hint} Wanted: {', '.join(keys)}")
            found[name] = place
        return found

    def items(self, wanted: str) -> list[Place]:
        """The members of a list."""
        if self.node.id != "sequence":
            raise self.wrong(f"is {self._what()}; wanted {wanted}")
        return [Place(each, f"{self.path}[{index}]") for index, each in enumerate(self.node.value)]

    def number(self, wanted: str = "a number", whole: bool = False) -> float:
        try:
            if self.node.id != "scalar" or "_" in self.node.value:
                raise ValueError
            value = float(self.node.value)
        except ValueError:
            raise self.wrong(f"is {self._what()}; wanted {wanted}") from None
        if not math.isfinite(value) or (whole and value != int(value)):
            raise self.wrong(f"is {self._what()}; wanted {wanted}")
        return value

    def numbers(self, least: int, most: int, wanted: str) -> tuple[float, ...]:
        found = self.items(wanted)
        if not least <= len(found) <= most:
            raise self.wrong(f"has {len(found)} members; wanted {wanted}")
        return tuple(each.number() for each in found)

    def text(self) -> str:
        if self.node.id != "scalar":
            raise self.wrong(f"is {self._what()}; wanted a text")
        return str(self.node.value)

    def _what(self) -> str:
        value = self.node.value
        if isinstance(value, str):
            return repr(value if len(value) < 60 else value[:57] + "...")
        return "a list" if self.node.tag.endswith("seq") else "names with values"
