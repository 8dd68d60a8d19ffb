"""Calibrations in files: `read_rig` reads ours and those of other programs, which it knows by what is in them.

Ours (`write_rig`) are described in docs/how-to/camera.md. Of others: ROS ``camera_info`` (YAML, or printed by ``ros2
topic echo``), OpenCV's FileStorage (YAML, JSON, XML), Kalibr's camchain, whose cameras are a rig in the axes of the
first, EuRoC's sensor.yaml, COLMAP's cameras.txt. OpenCV, ROS and Kalibr count pixels from the first one's centre: half
a pixel is added to their centre. COLMAP counts as we do.
"""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from eagor._checks import shown
from eagor._extras import require_extra
from eagor._files import read_file, write_atomic
from eagor.cameras import Lens, Rig
from eagor.conventions import OPTICAL_R_BODY, is_optical, rotation_from_wxyz
from eagor.errors import EagorError, FormatError
from eagor.sphere import world_R_body

__all__ = ["lens_of_model", "read_rig", "write_rig"]

WANTED = (
    "pictures and lenses of a rig, ROS camera_info, OpenCV's camera_matrix and distortion_coefficients, or Kalibr's "
    "camchain; COLMAP's cameras.txt is a text file"
)
LARGEST, DEEPEST = 1 << 18, 50  # bytes, and brackets within brackets: a calibration has a few hundred, and four
UNIT = 0.01  # by which the length of a quaternion may differ from 1
FLATTEST = 100  # by how much a picture may be larger than the focal length: a field of 178 degrees
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")
ALIASES = {
    **dict.fromkeys(("K", "k", "cameraMatrix", "mtx"), "camera_matrix"),
    **dict.fromkeys(("D", "d", "dist", "dist_coeff", "dist_coeffs", "distCoeffs"), "distortion_coefficients"),
    "distortion_coeffs": "distortion_coefficients", "width": "image_width", "height": "image_height",
}  # fmt: skip
# Distortion models of ROS, OpenCV and Kalibr: the kind of lens, and how many numbers at most.
MODELS = {
    "plumb_bob": ("pinhole", 5), "rational_polynomial": ("pinhole", 8), "radtan": ("pinhole", 4),
    "radial-tangential": ("pinhole", 4), "none": ("pinhole", 0), "": ("pinhole", 8),
    "equidistant": ("fisheye", 4), "kannala_brandt": ("fisheye", 4),
}  # fmt: skip
# Names of the parameters of COLMAP's models, in order (COLMAP, src/colmap/sensor/models.h).
COLMAP_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy", "PINHOLE": "fx fy cx cy", "SIMPLE_RADIAL": "f cx cy k1", "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2", "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1", "RADIAL_FISHEYE": "f cx cy k1 k2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4", "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
}  # fmt: skip
COLMAP_ORDER = {"pinhole": "k1 k2 p1 p2 k3 k4 k5 k6", "fisheye": "k1 k2 k3 k4 p1 p2 sx1 sy1"}

Kind = TypeVar("Kind")
Pair = tuple[float, float]


class _Size(msgspec.Struct, forbid_unknown_fields=True):
    width: int
    height: int


class _Lens(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    name: str = ""
    kind: str = "fisheye"
    picture: int = 0
    centre: Pair
    focal: float | Pair | None = None
    field_deg: float | None = None
    radius: float = 0.0
    distortion: list[float] = []
    polynomial: list[float] = []  # the distortion of a fisheye
    mirror: float = 0.0
    rotation: dict[str, float] | list[float] = {}
    optical: bool | None = None
    position: tuple[float, float, float] | None = None


class _Rig(msgspec.Struct, forbid_unknown_fields=True):
    pictures: list[_Size]
    lenses: list[_Lens]


class _Region(msgspec.Struct, frozen=True):  # of the sensor, as ROS prints it
    x_offset: int = 0
    y_offset: int = 0
    width: int = 0
    height: int = 0


class _Calibration(msgspec.Struct):  # of ROS and OpenCV
    camera_matrix: list[float]
    image_width: int
    image_height: int
    distortion_coefficients: list[float] = []
    distortion_model: str = ""
    fisheye_model: str | int | bool = "0"
    roi: _Region = _Region()


class _Kalibr(msgspec.Struct):
    camera_model: str
    intrinsics: list[float]
    resolution: tuple[int, int]
    distortion_model: str = "none"
    distortion_coefficients: list[float] = []
    T_cn_cnm1: list[list[float]] | None = None


def read_rig(path: str | os.PathLike[str]) -> Rig:
    """The lenses in a calibration file, with the sizes of the pictures that it was made with.

    Raises `FormatError`, which names the file, the place in it, what is there and what was wanted.
    """
    name = os.fspath(path)
    try:
        if os.path.getsize(name) > LARGEST:
            raise FormatError(f"it is larger than {LARGEST} bytes; wanted {WANTED}")
        text = read_file(name).decode("utf-8-sig")
        return _of_colmap(text) if name.lower().endswith(".txt") else _of_entries(_parsed(text))
    except EagorError as error:  # also for numbers that no lens has
        raise FormatError(f"{name}: {error}") from error
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise FormatError(f"{name} cannot be read as a calibration ({why}); wanted {WANTED}") from error


def _parsed(text: str) -> Any:
    """What YAML, JSON or OpenCV's XML holds. Raises `FormatError`."""
    if text.lstrip().startswith("<"):
        if "<!DOCTYPE" in text or "<!ENTITY" in text:  # no calibration needs these, and they can be bombs
            raise FormatError("it is not XML as OpenCV writes it: it declares entities")
        try:
            return _of_element(ElementTree.fromstring(text))
        except ElementTree.ParseError as error:
            raise FormatError(f"it is not XML ({error}); wanted {WANTED}") from error
    if max(accumulate((each in "[{") - (each in "]}") for each in text), default=0) > DEEPEST:
        raise FormatError(f"it has brackets more than {DEEPEST} deep; wanted {WANTED}")
    require_extra("reading a calibration (YAML)", "photos", "yaml")
    import yaml

    class Loader(yaml.SafeLoader):
        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            found = super().construct_mapping(node, deep)
            if len(found) < len(node.value):
                raise yaml.constructor.ConstructorError("", None, "a name is there twice", node.start_mark)
            return found

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", Loader.construct_yaml_map)
    # OpenCV writes "%YAML:1.0", which YAML does not allow; ros2 topic echo ends each message with ---.
    text = f"#{text}" if text.startswith("%YAML") else text
    try:
        return next(yaml.load_all(text, Loader), None)
    except (yaml.YAMLError, ValueError, TypeError, AttributeError) as error:
        raise FormatError(f"it is not YAML ({' '.join(str(error).split())}); wanted {WANTED}") from error


def _of_element(element: ElementTree.Element) -> Any:
    """What OpenCV writes as XML: names with values; elements called ``_``, and bare words, are members of a list."""
    members = [(each.tag, _of_element(each)) for each in element]
    if members and any(tag != "_" for tag, _ in members):
        return dict(members)
    text = (element.text or "").strip()
    if members or element.tag == "data" or (len(text.split()) > 1 and not text.startswith('"')):
        return [value for _, value in members] or [f"{word}0" if word[-1] == "." else word for word in text.split()]
    return text.strip('"')


def _converted(value: Any, kind: type[Kind], where: str = "$") -> Kind:
    """`value` as `kind`; texts may stand for numbers. Raises `FormatError` with the place."""
    try:
        return msgspec.convert(value, kind, strict=False)
    except msgspec.ValidationError as error:
        text = str(error)
        raise FormatError(text.replace("`$", f"`{where}") if "`$" in text else f"{text} - at `{where}`") from error


def _of_entries(entries: Any) -> Rig:
    if not isinstance(entries, dict):
        raise FormatError(f"it holds {'nothing' if entries is None else 'no names with values'}; wanted {WANTED}")
    if "lenses" in entries or "pictures" in entries:
        return _of_rig(_converted(entries, _Rig))
    cameras = sorted((key for key in entries if re.fullmatch(r"cam\d+", str(key))), key=lambda key: int(key[3:]))
    if cameras or "intrinsics" in entries:
        return _of_kalibr([entries[key] for key in cameras] or [entries])
    return _of_opencv({ALIASES.get(str(key), str(key)): value for key, value in entries.items()})


# --- rigs of ours ---


def _of_rig(told: _Rig) -> Rig:
    sizes, lenses = [(each.width, each.height) for each in told.pictures], []
    for number, entry in enumerate(told.lenses):
        where = f"lenses[{number}]"
        if entry.kind not in ("fisheye", "pinhole", "omni"):
            raise FormatError(f"{where}.kind is {shown(entry.kind)}; wanted fisheye, pinhole or omni")
        if not 0 <= entry.picture < len(sizes):
            raise FormatError(
                f"{where}.picture is {entry.picture}; wanted 0 to {len(sizes) - 1}, as pictures lists them"
            )
        if entry.position is not None:
            warnings.warn(f"{where}.position is ignored: lenses count as in one place", UserWarning, stacklevel=4)
        try:
            lenses.append(_lens(entry, sizes[entry.picture], entry.name or where))
        except EagorError as error:
            raise FormatError(f"{where}: {error}") from error
    return Rig(tuple(sizes), tuple(lenses))


def _lens(told: _Lens, size: tuple[int, int], name: str) -> Lens:
    turn = _rotation(told.rotation)
    if is_optical(name) if told.optical is None else told.optical:
        if not told.rotation:
            raise FormatError("there is no rotation; wanted that of its optical frame (x right, y down, z forward)")
        turn = turn @ OPTICAL_R_BODY
    if (told.focal is None) == (told.field_deg is None) or (told.focal is None and told.kind != "fisheye"):
        raise FormatError(
            "wanted either field_deg (of a fisheye: degrees from rim to rim) or focal (pixels; its: per radian)"
        )
    common: dict[str, Any] = {"body_R_lens": turn, "picture": told.picture}
    common["distortion"] = (*told.distortion, *told.polynomial)
    if told.field_deg is not None:
        return Lens.fisheye(name, size, told.centre, told.radius, math.radians(told.field_deg), **common)
    focal = told.focal if isinstance(told.focal, tuple) else (told.focal, told.focal)
    return Lens(name, size, focal, told.centre, kind=told.kind, radius=told.radius, mirror=told.mirror, **common)  # type: ignore[arg-type]


def _rotation(told: Mapping[str, float] | Sequence[float]) -> np.ndarray:
    """By a quaternion w, x, y, z or by names, or by angles."""
    if isinstance(told, Mapping) and told.keys() <= {*ANGLES}:
        if not all(map(math.isfinite, told.values())):
            raise FormatError(f"rotation has {dict(told)}; wanted degrees that are finite")
        return world_R_body(*(math.radians(told.get(name, 0.0)) for name in ANGLES))
    wxyz = [told[name] for name in "wxyz"] if isinstance(told, Mapping) and told.keys() == {*"wxyz"} else told
    if isinstance(wxyz, Mapping) or len(wxyz) != 4:
        raise FormatError(
            f"rotation has {', '.join(map(str, told))}; wanted {', '.join(ANGLES)}, or a quaternion w, x, y, z"
        )
    norm = float(np.linalg.norm(wxyz))
    if not abs(norm - 1) <= UNIT:
        raise FormatError(f"rotation has length {norm:.3g}; wanted a unit quaternion w, x, y, z")
    return rotation_from_wxyz(np.array(wxyz) / norm)


def write_rig(rig: Rig, path: str | os.PathLike[str], notes: Sequence[str] = ()) -> None:
    """Write a rig so that `read_rig` reads the same; `notes` become comments at its head. Raises `StorageError`."""
    lines = [f"# {' '.join(note.split())}" for note in notes]
    lines += ["pictures:", *(f"  - {{width: {width}, height: {height}}}" for width, height in rig.sizes), "lenses:"]
    for lens in rig.lenses:
        angles = Rotation.from_matrix(lens.body_R_lens).as_euler("ZYX", degrees=True)
        fields: dict[str, Any] = {
            "name": lens.name, "kind": lens.kind, "picture": lens.picture, "centre": lens.centre, "focal": lens.focal,
            "rotation": {key: round(float(angle), 6) for key, angle in zip(ANGLES, angles, strict=True)},
            "polynomial" if lens.kind == "fisheye" else "distortion": lens.distortion,
        }  # fmt: skip
        fields |= {key: value for key, value in (("radius", lens.radius), ("mirror", lens.mirror)) if value}
        first, *others = (f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in fields.items())
        lines += [f"  - {first}", *(f"    {each}" for each in others)]  # JSON's values are YAML's
    write_atomic(Path(path), "\n".join(lines) + "\n")


# --- those of other programs ---


def _of_opencv(named: dict[str, Any]) -> Rig:
    if "camera_matrix" not in named:
        raise FormatError(f"it holds {', '.join([*named][:8]) or 'nothing'}, and no camera_matrix; wanted {WANTED}")
    for key in {"camera_matrix", "distortion_coefficients"} & named.keys():
        rows = named[key].get("data") if isinstance(named[key], dict) else named[key]  # ROS and OpenCV, or bare rows
        if isinstance(rows, list):
            rows = [value for row in rows for value in (row if isinstance(row, list) else [row])]
        named[key] = rows
    told = _converted(named, _Calibration)
    k, size = told.camera_matrix, (told.image_width, told.image_height)
    if len(k) != 9 or (k[3], *k[6:]) != (0, 0, 0, 1) or abs(k[1]) > 1e-6 * k[0]:
        raise FormatError(f"camera_matrix is {k}; wanted 9 numbers, row by row, without skew: fx 0 cx 0 fy cy 0 0 1")
    model = told.distortion_model.lower()
    model = model or ("" if str(told.fisheye_model) in ("0", "false", "False") else "equidistant")
    four = len(told.distortion_coefficients) == 4 and any(told.distortion_coefficients)
    if four and not (model or "fisheye_model" in named):  # OpenCV's pinhole has five, unless asked for fewer
        text = "four distortion_coefficients and no distortion_model are read as k1, k2, p1, p2 of an ordinary lens"
        warnings.warn(f"{text}; of cv2.fisheye: add distortion_model: equidistant", UserWarning, stacklevel=4)
    roi = told.roi if min(told.roi.width, told.roi.height) > 0 else _Region(0, 0, *size)
    size, centre = (roi.width, roi.height), (k[2] + 0.5 - roi.x_offset, k[5] + 0.5 - roi.y_offset)
    return Rig((size,), (lens_of_model(model, size, (k[0], k[4]), centre, told.distortion_coefficients),))


def _of_kalibr(cameras: Sequence[Any]) -> Rig:
    """The cameras of a camchain, in the axes of the first: x ahead along its optical axis."""
    lenses, last_R_first = list[Lens](), np.eye(3)
    for number, entries in enumerate(cameras):
        where = f"cam{number}"
        if isinstance(entries, dict):
            entries = {ALIASES.get(key, key): value for key, value in entries.items()}
        told = _converted(entries, _Kalibr, f"$.{where}")
        if told.camera_model not in ("pinhole", "omni"):
            wanted = "pinhole or omni: calibrate it as one of these (kalibr_calibrate_cameras --models)"
            raise FormatError(f"{where}.camera_model is {shown(told.camera_model)}, which is not read; wanted {wanted}")
        mirror, *others = told.intrinsics if told.camera_model == "omni" else (0.0, *told.intrinsics)
        if len(others) != 4:
            raise FormatError(
                f"{where}.intrinsics has {len(told.intrinsics)} numbers; wanted fu, fv, pu, pv, and for omni xi first"
            )
        fx, fy, cx, cy = others
        if number and told.T_cn_cnm1 is None:
            raise FormatError(f"{where} has no T_cn_cnm1; wanted the place of each camera beside the one before")
        if number:
            last_R_first = _turn_of(told.T_cn_cnm1 or [], where) @ last_R_first
        model, centre = told.distortion_model.lower(), (cx + 0.5, cy + 0.5)
        lens = lens_of_model(model, told.resolution, (fx, fy), centre, told.distortion_coefficients, mirror)
        turn = OPTICAL_R_BODY.T @ last_R_first.T @ OPTICAL_R_BODY
        lenses.append(replace(lens, name=where, body_R_lens=turn, picture=number))
    return Rig(tuple(lens.size for lens in lenses), tuple(lenses))


def _turn_of(transform: Sequence[Sequence[float]], where: str) -> np.ndarray:
    """The rotation ``(3, 3)`` of a transform. Raises `FormatError`."""
    if len(transform) < 3 or any(len(row) < 3 for row in transform):
        raise FormatError(f"{where} has a transform of {len(transform)} rows; wanted four rows of four numbers")
    turn = np.array([row[:3] for row in transform[:3]])
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or np.linalg.det(turn) < 0:
        raise FormatError(f"{where} has a transform that is no rotation: {turn.tolist()}")
    return Rotation.from_matrix(turn).as_matrix()


def _of_colmap(text: str) -> Rig:
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) != 1:
        raise FormatError(
            f"it holds {len(lines)} cameras; wanted one line CAMERA_ID MODEL WIDTH HEIGHT PARAMS...: that of the "
            "camera which took the pictures"
        )
    _, model, *numbers = (*lines[0], "")
    if model not in COLMAP_MODELS:
        raise FormatError(f"the model is {shown(model)}; wanted CAMERA_ID and one of {', '.join(COLMAP_MODELS)}")
    wanted = COLMAP_MODELS[model].split()
    try:
        wide, high, *values = map(float, numbers[:-1])
        found = dict(zip(wanted, values, strict=True))
        if not (np.isfinite(values).all() and min(wide, high) >= 1 and (wide, high) == (int(wide), int(high))):
            raise ValueError
    except (ValueError, OverflowError):
        raise FormatError(
            f"{model} has {shown(' '.join(numbers))}; wanted width, height, {', '.join(wanted)}"
        ) from None
    kind, size = "fisheye" if model.endswith("FISHEYE") else "pinhole", (int(wide), int(high))
    focal = found.get("fx", found.get("f", 0.0)), found.get("fy", found.get("f", 0.0))
    distortion = tuple(found.get(key, 0.0) for key in COLMAP_ORDER[kind].split())
    return Rig((size,), (Lens("camera", size, focal, (found["cx"], found["cy"]), distortion, kind=kind),))


def lens_of_model(
    model: str, size: tuple[int, int], focal: Pair, centre: Pair, values: Sequence[float], mirror: float = 0.0
) -> Lens:
    """The lens of a distortion `model` of ROS, OpenCV or Kalibr (`MODELS`) with these `values`.

    A fisheye goes up to the farthest corner of its picture, or as far as its curve rises. Raises `FormatError`,
    `GridError`.
    """
    if model not in MODELS:
        raise FormatError(f"the distortion model is {model!r}; wanted one of {', '.join(filter(None, MODELS))}")
    kind, most = MODELS[model]
    if any(values[most:]):
        raise FormatError(
            f"the distortion has {len(values)} numbers; wanted at most {most} that are not 0 ({model or 'OpenCV'})"
        )
    if 0 < FLATTEST * min(focal) < max(size) and kind == "pinhole" and not mirror:
        raise FormatError(f"the focal lengths are {focal[0]:g} and {focal[1]:g} in pictures of {size}; wanted pixels")
    (x, y), (wide, high) = centre, size
    if abs(wide - high) > 0.2 * high and abs(2 * x - high) < 0.1 * high and abs(2 * y - wide) < 0.1 * wide:
        raise FormatError(
            f"the centre is ({x:g}, {y:g}) in pictures of {wide} x {high}: that of one that stands, or exchanged; "
            "wanted cx, cy, and width and height of the same pictures"
        )
    kind = "omni" if mirror else kind
    return Lens("camera", size, focal, centre, tuple(values[:most]), kind=kind, mirror=mirror)
