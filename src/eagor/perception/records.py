"""The lines of a replay file (docs/replay-format.md): reading, checking and writing them."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TextIO

import msgspec
import numpy as np
from msgspec import Meta

from eagor._checks import is_twice_as_wide
from eagor.cameras import Lens
from eagor.conventions import rotation_from_wxyz, wxyz_from_rotation
from eagor.errors import FormatError
from eagor.evidence import BodyMask, Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import are_fractions, is_beside
from eagor.grids import ErpGrid, Grid, PatchGrid, PerspectiveGrid
from eagor.perception.fusion import RawDetections, ViewDetections, combined
from eagor.perception.json_files import Finite, Tilt, Turn, checked, object_of, parsed_lines, require_field
from eagor.perception.vocabulary import fitting, plain, same_name
from eagor.sources import Pose
from eagor.sphere import direction, world_R_body

KINDS = ("boxes", "points", "response", "views")
LONGEST = 32  # a view this many times longer than wide is taken for a mistake
UNIT = 1e-3  # by how much the length of a quaternion may differ from 1
WHOLE = 0.999  # of the sphere: the least that the solid angles of several views of one look come to
PIXELS, SCORES, TURNS, METRES = 3, 6, 12, 6  # decimals that are written

# --- the structure of a line ------------------------------------------------------------------------------------------

_Pixels = Annotated[int, Meta(ge=1, le=65536)]  # more is taken for a mistake
_Coordinate = Annotated[float, Meta(ge=-4 * 65536, le=4 * 65536)]
_Metres = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Component = Annotated[float, Meta(ge=-2, le=2)]
_LENS, _LEAN = ("focal", "centre", "distortion"), ("yaw_left_deg", "pitch_up_deg", "roll_right_deg")
_TURN = ("qw", "qx", "qy", "qz")


class _Part(msgspec.Struct, forbid_unknown_fields=True):
    """A part of a line: other keys are refused."""


class _Rotation(_Part):
    qw: _Component | None = None
    qx: _Component | None = None
    qy: _Component | None = None
    qz: _Component | None = None

    def rotation(self, name: str) -> np.ndarray:
        """The rotation ``(3, 3)`` of the quaternion."""
        wxyz = [getattr(self, key) for key in _TURN]
        for key, value in zip(_TURN, wxyz, strict=True):
            require_field(value is not None, key, None, "a number from -2 to 2")
        length = float(np.linalg.norm(wxyz))
        require_field(
            abs(length - 1) <= UNIT, "the length of qw, qx, qy, qz", round(length, 4), f"1 (a rotation, {name})"
        )
        return rotation_from_wxyz(np.array(wxyz, dtype=np.float64))


class _Image(_Rotation):
    projection: Literal["equirectangular", "perspective"] | None = None  # a panorama
    width: _Pixels | None = None
    height: _Pixels | None = None
    hfov_deg: Annotated[float, Meta(ge=2, le=179)] | None = None
    focal: tuple[Finite, Finite] | None = None
    centre: tuple[Finite, Finite] | None = None
    distortion: Annotated[list[Finite], Meta(max_length=8)] | None = None  # k1, k2, p1, p2, k3, k4, k5, k6
    yaw_left_deg: Turn | None = None
    pitch_up_deg: Tilt | None = None
    roll_right_deg: Turn | None = None

    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        for side in ("height", "width"):
            require_field(getattr(self, side) is not None, side, None, "a whole number from 1 to 65536")
        return self.height or 0, self.width or 0

    def view(self, *shape: int) -> PerspectiveGrid | None:
        """The perspective view that it describes, in pixels or in so many rows and columns; None for a panorama."""
        values = {key: getattr(self, key) for key in ("hfov_deg", *_LENS, *_LEAN, *_TURN)}
        stated = {key: value for key, value in values.items() if value is not None}
        if self.projection != "perspective":
            if stated:
                raise FormatError(
                    f"{next(iter(stated))} is for a perspective image, and this one is a panorama; add "
                    '"projection": "perspective" to image, or leave the key out'
                )
            size = self.width, self.height
            whole = None in size or is_twice_as_wide(*self.size()) or self.projection is not None
            words = (
                'a panorama, 2:1, or "projection": "perspective" and hfov_deg (of a squeezed one: "equirectangular")'
            )
            require_field(whole, "image", size, words)
            return None
        height, width = shape or self.size()
        short = max(height, width) <= LONGEST * min(height, width)
        require_field(short, "image", (width, height), f"sides up to {LONGEST}:1")
        turn, lean, lens = ([key for key in keys if key in stated] for keys in (_TURN, _LEAN, _LENS))
        if turn and lean:
            raise FormatError(f"has {turn[0]} and {lean[0]}; wanted the quaternion qw, qx, qy, qz or angles, not both")
        yaw, pitch, roll = (math.radians(stated.get(key, 0.0)) for key in _LEAN)
        # In REP-103 a positive pitch turns the nose down.
        body_R_view = self.rotation("body_R_view") if turn else world_R_body(yaw, -pitch, roll)
        if not lens:
            require_field(self.hfov_deg is not None, "hfov_deg", None, "a number from 2 to 179")
            return PerspectiveGrid(height, width, math.radians(self.hfov_deg or 0.0), body_R_view)
        if self.hfov_deg is not None:
            raise FormatError(f"has hfov_deg and {lens[0]}; wanted one of them: focal and centre tell the field")
        for key in ("focal", "centre"):
            require_field(key in stated, key, None, "two numbers, of x and of y, in pixels")
        rows, columns = self.size()
        of = Lens("view", (columns, rows), stated["focal"], stated["centre"], tuple(self.distortion or ()), body_R_view)
        return PerspectiveGrid.of_lens(of).resized(height, width)


class _Item(_Part, kw_only=True):
    score: Finite = 1.0  # where the file tells none
    label: str | None = None

    def __post_init__(self) -> None:
        wanted = "a number from 0 to 1: 1 / (1 + exp(-score)) of logits; divide percentages by 100"
        require_field(0 <= self.score <= 1, "score", self.score, wanted)


class _Box(_Item, kw_only=True):
    box: tuple[_Coordinate, _Coordinate, _Coordinate, _Coordinate]  # x0, y0, x1, y1 in pixels


class _Point(_Item, kw_only=True):
    azimuth_deg: Turn
    elevation_deg: Tilt
    spread_deg: Annotated[float, Meta(ge=0.1, le=180)] = math.nan


class _Response(_Part):
    rows: _Pixels
    cols: _Pixels
    values: list[Finite]

    def table(self) -> np.ndarray:
        count, values = self.rows * self.cols, self.values
        require_field(len(values) == count, "values", f"{len(values)} values", f"rows * cols = {count} numbers")
        wrong = [value for value in values if not 0 <= value <= 1]
        require_field(not wrong, "values", wrong[:3], "numbers in [0, 1]")
        return np.array(values, dtype=np.float32).reshape(self.rows, self.cols)


class _View(_Part):
    image: _Image
    boxes: list[_Box]


class _Pose(_Rotation):
    x: _Metres | None = None
    y: _Metres | None = None
    z: _Metres | None = None
    spread_deg: Annotated[float, Meta(ge=0)] = 0.0

    def at(self, stamp: float) -> Pose:
        place = [self.x, self.y, self.z]
        require_field(None not in place or place == [None] * 3, "pose", place, "x, y and z, or none of them")
        position = None if None in place else np.array(place, dtype=np.float64)
        return Pose(stamp, self.rotation("world_R_body"), position, math.radians(self.spread_deg))


class _Mask(_Part):
    rows: Annotated[int, Meta(ge=1, le=4096)]
    runs: list[Annotated[int, Meta(ge=0)]]  # lengths of runs, row by row from the upper left: seen, not seen, seen, ...

    def mask(self) -> BodyMask:
        cells = 2 * self.rows**2
        require_field(sum(self.runs) == cells, "runs", f"{sum(self.runs)} cells", f"rows * 2 * rows = {cells} in all")
        seen = np.repeat(np.arange(len(self.runs)) % 2 == 0, self.runs)
        require_field(bool(seen.any()), "runs", "nothing that is seen", "a camera that sees something")
        return BodyMask(seen.reshape(self.rows, 2 * self.rows))


class Footage(msgspec.Struct, forbid_unknown_fields=True, frozen=True, omit_defaults=True):
    """The first line of a file of looks: what was looked at, by whom, and where the poses come from, in words.

    `classes`: all that the detector knows; None: it was asked for the queries of the lines. `detector`: how it errs.
    `begins`: the stamp from which seconds are counted on a terminal.
    """

    of: str
    perception: str
    poses: str = ""
    classes: tuple[str, ...] | None = None
    detector: DetectorModel | None = None
    begins: Finite = 0.0


class _Head(_Part):
    footage: Footage


class _Line(_Part):
    stamp: Finite
    query: str | None = None
    image: _Image = msgspec.field(default_factory=_Image)
    boxes: list[_Box] | None = None
    points: list[_Point] | None = None
    response: _Response | None = None
    views: list[_View] | None = None
    pose: _Pose | None = None
    frame: str | None = None
    lost: bool = False
    problem: str | None = None
    valid_mask: _Mask | None = None


# --- records ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Record:
    """One line of the file, checked: `kind` is "boxes", "points", "response", "views", or "pose" without a look.

    `query`: None for any query. `grid`: of the image or of the response; None for points anywhere. `values`: boxes
    ``(n, 4)`` in pixels; points ``(n, 3)`` as azimuth, elevation, spread in radians (NaN if not given); or the
    response. `scores` ``(n,)`` in [0, 1] and `labels` are empty for a response. `views`: of one camera, with their
    boxes. `pose` of the camera. `frame`: the name of what was looked at; `lost`: nothing tells how the camera turned
    since the frame before; `problem`: why the frame could not be used; `valid_mask`: what the camera sees.
    """

    stamp: float
    query: str | None
    kind: str
    grid: Grid | None = None
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    scores: np.ndarray = field(default_factory=lambda: np.zeros(0))
    labels: Sequence[str | None] = ()
    views: tuple[ViewDetections, ...] = ()
    pose: Pose | None = None
    frame: str | None = None
    lost: bool = False
    problem: str | None = None
    valid_mask: BodyMask | None = None

    def answers(self, query: str) -> bool:
        """Whether this line is for `query`; letter case and spaces do not matter."""
        return self.kind != "pose" and (self.query is None or plain(self.query) == plain(query))

    def evidence(
        self,
        query: str,
        calibration: Calibration | None = None,
        detector: DetectorModel | None = None,
        among: Collection[str] = (),
        wanted: Collection[str] | None = None,
    ) -> Evidence:
        """The evidence for `query`. On a line without a query of its own, items with another label are left out.

        `among`: the labels of all lines, of which those that `query` names best are meant (`fitting`);
        default: those of this line. Boxes and points are detections of `detector` (default: `DetectorModel()`); with a
        `calibration` they are read as a response map instead. A point with a spread of its own keeps it. `wanted`: the
        labels that `query` means, where that is known. Raises `FormatError` for a line without a look.
        """
        own = {label for label in self.labels if label is not None}
        if wanted is None and self.query is None:
            wanted = fitting(query, among or own)
        keep = [self.query is not None or label is None or same_name(label, wanted or ()) for label in self.labels]
        values, scores = self.values, self.scores[keep] if len(self.scores) else self.scores
        stated = scores if (scores != 1).any() else None  # 1 everywhere: the file tells none
        if self.kind == "views":
            found = combined(self.views, fitting(query, own, wanted), detector, self.stamp)
        elif self.kind == "response" and self.grid is not None:
            found = Evidence.from_response(values, self.grid, calibration=calibration, stamp=self.stamp)
        elif self.kind == "boxes" and self.grid is not None:
            found = Evidence.from_boxes(values[keep], self.grid, stated, calibration, self.stamp, detector=detector)
        elif self.kind == "points":
            azimuth, elevation, spread = values[keep].T
            usual = (detector or DetectorModel()).spread
            concentration = np.where(np.isnan(spread), usual, spread) ** -2.0
            points = direction(azimuth, elevation)
            found = Evidence.from_points(points, concentration, stated, self.grid, calibration, self.stamp, detector)
        else:
            raise FormatError(
                f"the line at {self.stamp:g} s is a pose without a look; wanted one of {', '.join(KINDS)}"
            )
        return found if self.valid_mask is None else found.covered(self.valid_mask)


# --- reading ----------------------------------------------------------------------------------------------------------


def read_looks(path: str | os.PathLike[str]) -> tuple[Footage | None, tuple[Record, ...]]:
    """What the first line of a JSONL file says of the footage, if it does, and its records in order of time.

    Raises `FormatError`, which names the file and the line of a fault.
    """
    records, footage = list[Record](), None
    for found, where in parsed_lines(path, _parse):
        if isinstance(found, Record):
            records.append(found)
        elif footage is not None or records:
            raise FormatError(f"{where}: has footage; wanted that in the first line alone")
        else:
            footage = found
    if not records:
        raise FormatError(f"{os.fspath(path)} holds no records; wanted one JSON object per line, at least one")
    return footage, tuple(sorted(records, key=lambda record: record.stamp))


def _parse(line: bytes) -> Record | Footage:
    entry = object_of(line)
    return checked(entry, _Head, "the first line", noted=True).footage if "footage" in entry else _record(entry)


def parse_record(line: str | bytes) -> Record:
    """One line as a `Record`. Raises `FormatError`, which says what is wrong and what is wanted."""
    return _record(object_of(line))


def _record(found: dict[str, Any]) -> Record:
    entry = checked(found, _Line, "a line", noted=True)
    require_field(entry.query is None or plain(entry.query) != "", "query", entry.query, "words, or no such key")
    kinds = [kind for kind in KINDS if getattr(entry, kind) is not None]
    if len(kinds) != 1 and (kinds or entry.pose is None):
        raise FormatError(f"has {' and '.join(kinds) or 'none'} of {', '.join(KINDS)}; wanted exactly one, or a pose")
    look: dict[str, Any] = {}
    if entry.views is not None:
        look = {"views": _views(entry.views), "labels": [box.label for view in entry.views for box in view.boxes]}
    elif entry.response is not None:
        values = entry.response.table()
        look = {"values": values, "grid": entry.image.view(*values.shape) or PatchGrid(*values.shape)}
    elif entry.boxes is not None:
        grid = entry.image.view() or ErpGrid(*entry.image.size())
        look = {"values": _decode_xyxy(entry.boxes, grid), "grid": grid}
    elif entry.points is not None:
        points = [(each.azimuth_deg, each.elevation_deg, each.spread_deg) for each in entry.points]
        look = {"values": np.radians(points).reshape(-1, 3), "grid": entry.image.view()}
    if items := entry.boxes or entry.points:
        look |= {"scores": np.array([each.score for each in items]), "labels": [each.label for each in items]}
    return Record(
        entry.stamp, entry.query, [*kinds, "pose"][0], **look, frame=entry.frame, lost=entry.lost,
        pose=entry.pose and entry.pose.at(entry.stamp), problem=entry.problem,
        valid_mask=entry.valid_mask and entry.valid_mask.mask(),
    )  # fmt: skip


def _views(views: Sequence[_View]) -> tuple[ViewDetections, ...]:
    """The views of one camera, each with its boxes."""
    found = []
    for each in views:
        grid = each.image.view()
        if grid is None:
            raise FormatError("projection is 'equirectangular'; wanted \"perspective\" in views")
        labels = [box.label for box in each.boxes if box.label is not None] or None
        every = len(labels or ()) in (0, len(each.boxes))
        require_field(every, "label", None, "one for each box of a view, or for none")
        scores = np.array([box.score for box in each.boxes])
        found.append(ViewDetections(grid, RawDetections(_decode_xyxy(each.boxes, grid), scores, labels)))
    area = sum(float(view.grid.weights.sum()) for view in found)
    if len(found) != 1 and area < 4 * math.pi * WHOLE:
        raise FormatError(
            f"has {len(found)} views of {area:.1f} sr in all; wanted one view, or several that cover the whole sphere. "
            "Views of a part of it want lines of their own, with boxes"
        )
    return tuple(found)


def _decode_xyxy(boxes: Sequence[_Box], grid: ErpGrid | PerspectiveGrid) -> np.ndarray:
    """The pixel coordinates ``(n, 4)`` of boxes that overlap the image."""
    (height, width), panorama = grid.shape, isinstance(grid, ErpGrid)
    for x0, y0, x1, y1 in (each.box for each in boxes):
        left, right = (x0, x1 + width * (x1 < x0)) if panorama else (max(x0, 0.0), min(x1, float(width)))
        touches = not (panorama and is_beside(x0, x1, width)) and not are_fractions(np.array([x0, y0, x1, y1]))
        fine = touches and left < right <= left + width and max(y0, 0.0) < min(y1, float(height))
        wanted = f"[x0, y0, x1, y1] in pixels of the {width} x {height} image (not x, y, width, height, and not 0 to 1)"
        require_field(fine, "box", [x0, y0, x1, y1], wanted)
    return np.array([each.box for each in boxes], dtype=np.float64).reshape(-1, 4)


# --- writing ----------------------------------------------------------------------------------------------------------


def write_record(file: TextIO, stamp: float, *, response: np.ndarray | None = None, **entry: Any) -> None:
    """Append one line to an open text file and flush it; the line is checked before anything is written.

    Give exactly one of `boxes`, `points` (entries as in the format) and `response` ``(rows, cols)``; besides them what
    a line may have: `query`, `image`, ... Raises `FormatError`.
    """
    entry = {"stamp": stamp, **entry}
    if response is not None:
        values = np.asarray(response, dtype=float)
        require_field(values.ndim == 2, "response", values.shape, "an array (rows, cols)")
        entry["response"] = {"rows": values.shape[0], "cols": values.shape[1], "values": values.ravel().tolist()}
    try:
        line = json.dumps({k: v for k, v in entry.items() if v is not None}, default=lambda value: value.tolist())
    except (TypeError, ValueError, AttributeError) as error:
        raise FormatError(f"the record cannot be written as JSON: {error}") from error
    parse_record(line)
    file.write(line + "\n")
    file.flush()


def pose_entry(pose: Pose) -> dict[str, float]:
    """A pose as a line has it."""
    place = () if pose.position is None else pose.position.tolist()
    entry = _quaternion(pose.world_R_body) | dict(zip("xyz", (round(value, METRES) for value in place), strict=False))
    return entry | ({"spread_deg": round(math.degrees(pose.spread), TURNS)} if pose.spread else {})


def _quaternion(turn: np.ndarray) -> dict[str, float]:
    return dict(zip(_TURN, wxyz_from_rotation(turn).round(TURNS).tolist(), strict=True))


def view_entry(seen: ViewDetections) -> dict[str, Any]:
    """A view with its boxes as a line has it."""
    grid, (boxes, scores, labels) = seen
    image = {"projection": "perspective", "width": grid.width, "height": grid.height}
    if (lens := grid.optics) is None:
        image |= {"hfov_deg": round(math.degrees(grid.hfov), TURNS)}
    else:  # exactly: a millionth of distortion may be pixels at the border
        image |= {"focal": list(lens.focal), "centre": list(lens.centre), "distortion": list(lens.distortion)}
    inside = np.clip(boxes, 0, [grid.width, grid.height] * 2).round(PIXELS)
    entries = [
        {"box": box.tolist(), "score": round(float(score), SCORES)} | ({} if label is None else {"label": label})
        for box, score, label in zip(inside, scores, labels or [None] * len(inside), strict=True)
        if (box[2:] > box[:2]).all()
    ]
    return {"image": image | _quaternion(grid.body_R_view), "boxes": entries}


def mask_entry(mask: BodyMask) -> dict[str, Any]:
    """A mask as the lengths of runs: seen, not seen, seen, ..., along the rows of a panorama twice as wide as high."""
    rows = mask.seen.shape[0]
    seen = mask.at(ErpGrid(rows, 2 * rows).directions).ravel()
    runs = np.diff(np.flatnonzero(np.diff(seen, prepend=True, append=~seen[-1])), prepend=0).tolist()
    return {"rows": rows, "runs": runs}
