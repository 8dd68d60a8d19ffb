"""The lines of a replay file (docs/replay-format.md): reading, checking and writing them."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, TextIO

import msgspec
import numpy as np
from msgspec import Meta
from scipy.special import expit

from eagor.cameras import Lens
from eagor.conventions import rotation_from_wxyz
from eagor.errors import FormatError
from eagor.evidence import BodyMask, Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import are_fractions, is_beside
from eagor.grids import ErpGrid, Grid, PatchGrid, PerspectiveGrid
from eagor.odometry.files import FramePose
from eagor.perception.json_files import Finite, Tilt, Turn, checked, need, object_of, parsed_lines
from eagor.perception.things import Boxes, Seen, combined, labels_of
from eagor.perception.words import fitting, plain, same_name
from eagor.sphere import direction, world_R_body

KINDS = ("boxes", "points", "response", "views")
APART = 1.0  # seconds: lines of one look that lie farther apart are taken for a mistake
LONGEST = 32  # a view this many times longer than wide is taken for a mistake
UNIT = 1e-3  # by how much the length of a quaternion may differ from 1
WHOLE = 0.999  # of the sphere: the least that the solid angles of several views of one look come to
HINTS = {  # for keys that others use, and whose sign or unit may differ
    "pitch_deg": "pitch_up_deg is positive UP, like elevation_deg; pitch_deg of a pose file is positive nose DOWN",
    "pitch": "pitch_up_deg is positive UP, in degrees",
    "yaw": "yaw_left_deg is positive to the LEFT, in degrees",
    "yaw_deg": "yaw_left_deg is positive to the LEFT",
    "roll": "roll_right_deg is positive where the camera leans to its RIGHT, in degrees",
    "roll_deg": "roll_right_deg is positive where the camera leans to its RIGHT",
    "fov": "hfov_deg is the HORIZONTAL field of view, in degrees",
    "vfov_deg": "hfov_deg is the HORIZONTAL field of view",
    "bbox": "box is x0, y0, x1, y1, not x, y, width, height",
}

# --- the structure of a line ------------------------------------------------------------------------------------------

_PIXELS = "a whole number from 1 to 65536"
_CORNERS = "[x0, y0, x1, y1] in pixels of the {}image (not x, y, width, height, and not 0 to 1)"
_SCORE = 'a number from 0 to 1. Of logits, say so: "scores": "logit" in the line; divide percentages by 100'
_VALUES = 'numbers in [0, 1] (of logits, say "scores": "logit" in the line)'
_Pixels = Annotated[int, Meta(ge=1, le=65536)]  # more is taken for a mistake
_Coordinate = Annotated[float, Meta(ge=-4 * 65536, le=4 * 65536)]
_Component = Annotated[float, Meta(ge=-2, le=2)]
_Metres = Annotated[float, Meta(ge=-1e9, le=1e9)]
_FIELD = "a number from 0.1 to 179"
_QUERY = "words, or no such key"
_LOOK = "text or a whole number, the same for all views of a moment"
_LEAN, _TURN = ("yaw_left_deg", "pitch_up_deg", "roll_right_deg"), ("qw", "qx", "qy", "qz")
_OF_LENS = ("focal", "centre", "distortion")
_OF_VIEWS = ("hfov_deg", *_OF_LENS, *_LEAN, *_TURN)
_PAIR = "two numbers, {}, in pixels of an image of width and height"


class _Image(msgspec.Struct, forbid_unknown_fields=True):
    projection: Literal["equirectangular", "perspective"] = "equirectangular"
    width: _Pixels | None = None
    height: _Pixels | None = None
    hfov_deg: Annotated[float, Meta(ge=0.1, le=179)] | None = None
    focal: tuple[Finite, Finite] | None = None
    centre: tuple[Finite, Finite] | None = None
    distortion: Annotated[list[Finite], Meta(max_length=8)] | None = None  # k1, k2, p1, p2, k3, k4, k5, k6
    yaw_left_deg: Turn | None = None
    pitch_up_deg: Tilt | None = None
    roll_right_deg: Turn | None = None
    qw: _Component | None = None
    qx: _Component | None = None
    qy: _Component | None = None
    qz: _Component | None = None


class _Box(msgspec.Struct, forbid_unknown_fields=True):
    box: tuple[_Coordinate, _Coordinate, _Coordinate, _Coordinate]  # x0, y0, x1, y1 in pixels
    score: Finite | None = None
    label: str | None = None


class _Point(msgspec.Struct, forbid_unknown_fields=True):
    azimuth_deg: Turn
    elevation_deg: Tilt
    spread_deg: Annotated[float, Meta(ge=0.1, le=180)] = math.nan
    score: Finite | None = None
    label: str | None = None


class _Response(msgspec.Struct, forbid_unknown_fields=True):
    rows: _Pixels
    cols: _Pixels
    values: list[Finite]


class _View(msgspec.Struct, forbid_unknown_fields=True):
    image: _Image
    boxes: list[_Box]


class _Pose(msgspec.Struct, forbid_unknown_fields=True):
    qw: _Component
    qx: _Component
    qy: _Component
    qz: _Component
    x: _Metres | None = None
    y: _Metres | None = None
    z: _Metres | None = None
    spread_deg: Annotated[float, Meta(ge=0)] = 0.0


class _Unseen(msgspec.Struct, forbid_unknown_fields=True):
    rows: Annotated[int, Meta(ge=1, le=4096)]
    runs: list[Annotated[int, Meta(ge=0)]]  # lengths of runs: seen, not seen, seen, ...


class Footage(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
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


class _Head(msgspec.Struct, forbid_unknown_fields=True):
    footage: Footage


class _Line(msgspec.Struct, forbid_unknown_fields=True):
    stamp: Finite
    query: str | None = None
    look: str | int | None = None
    image: _Image | None = None
    boxes: list[_Box] | None = None
    points: list[_Point] | None = None
    response: _Response | None = None
    scores: Literal["probability", "logit"] = "probability"
    views: list[_View] | None = None
    pose: _Pose | None = None
    frame: str | None = None
    lost: bool = False
    problem: str | None = None
    unseen: _Unseen | None = None


# --- records ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Record:
    """One line of the file, checked: `kind` is "boxes", "points", "response", "views", or "pose" without a look.

    `query`: None for any query. `grid`: of the image or of the response; None for points anywhere. `values`: boxes
    ``(n, 4)`` in pixels; points ``(n, 3)`` as azimuth, elevation, spread in radians (NaN if not given); or the
    response. `scores` ``(n,)`` in [0, 1] and `labels` are empty for a response. `look`: which views are one look; None:
    those of the same stamp. `views`: of one camera, with their boxes. `pose` of the camera, and the `spread` of its
    error (radians per axis); `frame`: the name of what was looked at; `lost`: nothing tells how the camera turned since
    the frame before; `problem`: why the frame could not be used; `unseen`: what the camera never sees.
    """

    stamp: float
    query: str | None
    kind: str
    grid: Grid | None
    values: np.ndarray
    scores: np.ndarray
    labels: Sequence[str | None]
    look: str | None = None
    views: tuple[Seen, ...] = ()
    pose: FramePose | None = None
    spread: float = 0.0
    frame: str | None = None
    lost: bool = False
    problem: str | None = None
    unseen: BodyMask | None = None

    def answers(self, query: str) -> bool:
        """Whether this line is for `query`; letter case and spaces do not matter."""
        if self.kind == "pose":
            return False
        return self.query is None or plain(self.query) == plain(query)

    def evidence(
        self,
        query: str,
        calibration: Calibration | None = None,
        detector: DetectorModel | None = None,
        among: Collection[str] = (),
        wanted: Sequence[str] | None = None,
    ) -> Evidence:
        """The evidence for `query`. On a line without a query of its own, items with another label are left out.

        `among`: the labels of all lines, of which those that `query` names best are meant (`fitting`);
        default: those of this line. Boxes and points are detections of `detector` (default: `DetectorModel()`); with a
        `calibration` they are read as a response map instead. A point with a spread of its own keeps it. `wanted`: the
        labels that `query` means, where that is known.
        """
        found = self._evidence(query, calibration, detector, among, wanted)
        return found if self.unseen is None else found.covered(self.unseen)

    def _evidence(
        self,
        query: str,
        calibration: Calibration | None,
        detector: DetectorModel | None,
        among: Collection[str],
        wanted: Collection[str] | None,
    ) -> Evidence:
        if self.kind == "views":
            if self.query is None and wanted is None and among:
                wanted = fitting(query, among)
            fit = fitting(query, labels_of(each.boxes for each in self.views), wanted)
            return combined(self.views, fit, detector, self.stamp)
        if self.kind == "response" and self.grid is not None:
            return Evidence.from_response(self.values, self.grid, calibration=calibration, stamp=self.stamp)
        own = [label for label in self.labels if label is not None]
        if wanted is None:
            wanted = fitting(query, among or own) if self.query is None and own else ()
        keep = [self.query is not None or label is None or same_name(label, wanted) for label in self.labels]
        values, scores = self.values[keep], self.scores[keep]
        scores = scores if (scores != 1).any() else None  # 1 everywhere: the file tells none
        if self.kind == "boxes" and self.grid is not None:
            return Evidence.from_boxes(values, self.grid, scores, calibration, self.stamp, detector=detector)
        spread = (detector or DetectorModel()).spread
        concentration = np.where(np.isnan(values[:, 2]), spread, values[:, 2]) ** -2.0
        points = direction(values[:, 0], values[:, 1])
        return Evidence.from_points(points, concentration, scores, self.grid, calibration, self.stamp, detector)


def read_records(path: str | os.PathLike[str]) -> tuple[Record, ...]:
    """The records of a JSONL file in order of time; `FormatError` names the file and the line of a fault.

    All views of one `look` get the mean of their stamps.
    """
    return read_looks(path)[1]


def read_looks(path: str | os.PathLike[str]) -> tuple[Footage | None, tuple[Record, ...]]:
    """What the first line says of the footage, if it does, and the records as `read_records` gives them."""
    records, name, footage = [], os.fspath(path), None
    for found, where in parsed_lines(path, _parse):
        if isinstance(found, Record):
            records.append(found)
        elif footage is not None or records:
            raise FormatError(f"{where}: has footage; wanted that in the first line alone")
        else:
            footage = found
    if not records:
        raise FormatError(f"{name} holds no records; wanted one JSON object per line, at least one")
    return footage, tuple(sorted(_joined(records, name), key=lambda r: r.stamp))


def _parse(line: bytes) -> Record | Footage:
    entry = object_of(line)
    if "footage" in entry:
        return checked(entry, _Head, "the first line", noted=True).footage
    return _record(entry)


def _joined(records: Sequence[Record], name: str) -> list[Record]:
    """The records, those of one look at one time."""
    looks: dict[str, list[float]] = {}
    for record in records:
        if record.look is not None:
            looks.setdefault(record.look, []).append(record.stamp)
    for look, stamps in looks.items():
        if max(stamps) - min(stamps) > APART:
            raise FormatError(
                f"{name}: lines of the look {look!r} are {max(stamps) - min(stamps):g} s apart; wanted at most "
                f"{APART:g} s. A look is the views of one moment: each moment wants an id of its own"
            )
    return [r if r.look is None else replace(r, stamp=math.fsum(looks[r.look]) / len(looks[r.look])) for r in records]


def parse_record(line: str | bytes) -> Record:
    """One line as a `Record`. Raises `FormatError`, which says what is wrong and what is wanted."""
    return _record(object_of(line))


def _record(found: dict[str, Any]) -> Record:
    entry = checked(found, _Line, "a line", noted=True, hints=HINTS)
    about = {
        "pose": None if entry.pose is None else _pose(entry.pose, entry.stamp, entry.frame), "frame": entry.frame,
        "spread": 0.0 if entry.pose is None else math.radians(entry.pose.spread_deg), "lost": entry.lost,
        "problem": entry.problem, "unseen": None if entry.unseen is None else _mask(entry.unseen),
    }  # fmt: skip
    return replace(_looked(entry), **about)


def _looked(entry: _Line) -> Record:
    """What a line says of a look, whatever else it says."""
    stamp, query, logits = entry.stamp, entry.query, entry.scores == "logit"
    need(query is None or plain(query) != "", "query", query, _QUERY)
    need(entry.look != "", "look", entry.look, _LOOK)
    look, image = None if entry.look is None else str(entry.look), entry.image or _Image()
    kinds = [kind for kind in KINDS if getattr(entry, kind) is not None]
    nothing = np.zeros(0)
    if not kinds and entry.pose is not None:
        return Record(stamp, query, "pose", None, nothing, nothing, (), look)
    if len(kinds) != 1:
        raise FormatError(f"has {' and '.join(kinds) or 'none'} of {', '.join(KINDS)}; wanted exactly one, or a pose")
    if entry.views is not None:
        views = _views(entry.views, logits)
        labels = tuple(label for view in entry.views for label in [box.label for box in view.boxes])
        return Record(stamp, query, "views", None, nothing, nothing, labels, look, views)
    if entry.response is not None:
        values = _response(entry.response, logits)
        grid = _view_of(image, *values.shape) or PatchGrid(*values.shape)
        return Record(stamp, query, "response", grid, values, nothing, (), look)
    items, grid = entry.boxes if entry.boxes is not None else entry.points or (), _view_of(image)
    scores, labels = _probabilities(items, logits), tuple(each.label for each in items)
    if entry.boxes is None:
        points = [(each.azimuth_deg, each.elevation_deg, each.spread_deg) for each in entry.points or ()]
        return Record(stamp, query, "points", grid, np.radians(points).reshape(-1, 3), scores, labels, look)
    height, width = _size(image)
    values = np.array([_box(each.box, height, width, grid is None) for each in entry.boxes]).reshape(-1, 4)
    return Record(stamp, query, "boxes", grid or ErpGrid(height, width), values, scores, labels, look)


def write_record(
    file: TextIO,
    stamp: float,
    *,
    query: str | None = None,
    image: Mapping[str, Any] | None = None,
    boxes: Sequence[Mapping[str, Any]] | None = None,
    points: Sequence[Mapping[str, Any]] | None = None,
    response: np.ndarray | None = None,
    look: str | int | None = None,
    scores: str | None = None,
) -> None:
    """Append one line to an open text file and flush it; the line is checked before anything is written.

    Give exactly one of `boxes`, `points` (entries as in the format) and `response` ``(rows, cols)``. `look`: the same
    for all views of one moment. `scores`: "logit" if they are logits. Raises `FormatError`.
    """
    entry: dict[str, Any] = {"stamp": stamp, "query": query, "look": look, "image": image}
    entry |= {"boxes": boxes, "points": points, "scores": scores}
    if response is not None:
        values = np.asarray(response, dtype=float)
        need(values.ndim == 2, "response", values.shape, "an array (rows, cols)")
        entry["response"] = {"rows": values.shape[0], "cols": values.shape[1], "values": values.ravel().tolist()}
    try:
        line = json.dumps({k: v for k, v in entry.items() if v is not None}, default=_plain)
    except (TypeError, ValueError) as error:
        raise FormatError(f"the record cannot be written as JSON: {error}") from error
    parse_record(line)
    file.write(line + "\n")
    file.flush()


def _views(views: Sequence[_View], logits: bool) -> tuple[Seen, ...]:
    """The views of one camera, each with its boxes."""
    found = []
    for each in views:
        need(each.image.projection == "perspective", "projection", each.image.projection, '"perspective" in views')
        grid = _view_of(each.image)
        assert grid is not None
        boxes = np.array([_box(b.box, grid.height, grid.width, False) for b in each.boxes]).reshape(-1, 4)
        told = [box.label for box in each.boxes]
        labels = None if None in told else [label for label in told if label is not None]
        need(labels is not None or told == [None] * len(told), "label", None, "one for each box of a view, or for none")
        found.append(Seen(grid, Boxes(boxes, _probabilities(each.boxes, logits), labels)))
    area = sum(float(view.grid.weights.sum()) for view in found)
    if len(found) != 1 and area < 4 * math.pi * WHOLE:
        raise FormatError(
            f"has {len(found)} views of {area:.1f} sr in all; wanted one view, or several that cover the whole sphere. "
            "Views of a part of it want lines of their own, with boxes"
        )
    return tuple(found)


def _pose(pose: _Pose, stamp: float, frame: str | None) -> FramePose:
    place = (pose.x, pose.y, pose.z)
    need(None not in place or place == (None,) * 3, "pose", [*place], "x, y and z, or none of them")
    turn = _rotation({"qw": pose.qw, "qx": pose.qx, "qy": pose.qy, "qz": pose.qz}, "world_R_body")
    return FramePose(stamp, turn, None if None in place else np.array(place, dtype=np.float64), frame)


def _mask(unseen: _Unseen) -> BodyMask:
    """The mask of what is seen, from the lengths of runs along the rows of a panorama, from the upper left on."""
    cells = 2 * unseen.rows**2
    need(sum(unseen.runs) == cells, "runs", f"{sum(unseen.runs)} cells", f"rows * 2 * rows = {cells} in all")
    seen = np.repeat(np.arange(len(unseen.runs)) % 2 == 0, unseen.runs)
    need(bool(seen.any()), "runs", "nothing that is seen", "a camera that sees something")
    return BodyMask(seen.reshape(unseen.rows, 2 * unseen.rows))


def _size(image: _Image) -> tuple[int, int]:
    """Height and width in pixels."""
    for side in ("height", "width"):
        need(getattr(image, side) is not None, side, None, _PIXELS)
    return image.height or 0, image.width or 0


def _view_of(image: _Image, rows: int = 0, columns: int = 0) -> PerspectiveGrid | None:
    """The perspective view that `image` describes, in pixels or in `rows` and `columns`; None for a panorama."""
    told = {key: value for key in _OF_VIEWS if (value := getattr(image, key)) is not None}
    if image.projection == "equirectangular":
        if told:
            raise FormatError(
                f"{next(iter(told))} is for a perspective image, and this one is a panorama; add "
                '"projection": "perspective" to image, or leave the key out'
            )
        return None
    height, width = (rows, columns) if rows else _size(image)
    need(max(height, width) <= LONGEST * min(height, width), "image", (width, height), f"sides up to {LONGEST}:1")
    turn = _body_R_view({key: told[key] for key in (*_LEAN, *_TURN) if key in told})
    if lens := [key for key in _OF_LENS if key in told]:
        return _of_lens(image, lens, turn).resized(height, width)
    need("hfov_deg" in told, "hfov_deg", None, _FIELD)
    return PerspectiveGrid(height, width, math.radians(told["hfov_deg"]), turn)


def _of_lens(image: _Image, told: Sequence[str], body_R_view: np.ndarray) -> PerspectiveGrid:
    """The pixels of a calibrated lens."""
    if image.hfov_deg is not None:
        raise FormatError(f"has hfov_deg and {told[0]}; wanted one of them: focal and centre tell the field")
    need(image.focal is not None, "focal", None, _PAIR.format("of x and of y"))
    need(image.centre is not None, "centre", None, _PAIR.format("x and y"))
    assert image.focal is not None
    assert image.centre is not None
    height, width = _size(image)
    distortion = tuple(image.distortion or ())
    return PerspectiveGrid.of_lens(Lens("view", (width, height), image.focal, image.centre, distortion, body_R_view))


def _body_R_view(told: Mapping[str, float]) -> np.ndarray:
    """Where a view looks ``(3, 3)``: a quaternion, or angles in degrees."""
    turn, angles = [key for key in told if key in _TURN], [key for key in told if key not in _TURN]
    if turn and angles:
        raise FormatError(f"has {turn[0]} and {angles[0]}; wanted the quaternion qw, qx, qy, qz or angles, not both")
    if not turn:
        yaw, pitch, roll = (math.radians(told.get(key, 0.0)) for key in _LEAN)
        return world_R_body(yaw, -pitch, roll)  # in REP-103 a positive pitch turns the nose down
    for key in _TURN:
        need(key in told, key, None, "a number from -2 to 2")
    return _rotation(told, "body_R_view")


def _rotation(told: Mapping[str, float], name: str) -> np.ndarray:
    """The rotation ``(3, 3)`` of a quaternion."""
    wxyz = np.array([told[key] for key in _TURN])
    length = float(np.linalg.norm(wxyz))
    need(abs(length - 1) <= UNIT, "the length of qw, qx, qy, qz", round(length, 4), f"1 (a rotation, {name})")
    return rotation_from_wxyz(wxyz)


def _box(box: tuple[float, float, float, float], height: int, width: int, panorama: bool) -> list[float]:
    """The four pixel coordinates of a box that overlaps the image."""
    x0, y0, x1, y1 = box
    left, right = (x0, x1 + width * (x1 < x0)) if panorama else (max(x0, 0.0), min(x1, float(width)))
    touches = not (panorama and is_beside(x0, x1, width)) and not are_fractions(np.array(box))
    fine = touches and left < right <= left + width and max(y0, 0.0) < min(y1, float(height))
    need(fine, "box", [*box], _CORNERS.format(f"{width} x {height} "))
    return [x0, y0, x1, y1]


def _response(response: _Response, logits: bool) -> np.ndarray:
    """The values ``(rows, cols)`` float32."""
    shape = response.rows, response.cols
    fine = len(response.values) == shape[0] * shape[1]
    need(fine, "values", f"{len(response.values)} values", f"rows * cols = {shape[0] * shape[1]} numbers")
    wrong = [] if logits else [value for value in response.values if not 0 <= value <= 1]
    need(not wrong, "values", wrong[:3], _VALUES)
    table = np.array(response.values, dtype=np.float64).reshape(shape)
    return (expit(table) if logits else table).astype(np.float32)


def _probabilities(items: Sequence[_Box] | Sequence[_Point], logits: bool) -> np.ndarray:
    """The scores of boxes or points ``(n,)`` in [0, 1]; 1 where there is none."""
    for item in items:
        need(logits or item.score is None or 0 <= item.score <= 1, "score", item.score, _SCORE)
    return np.array([1.0 if item.score is None else expit(item.score) if logits else item.score for item in items])


def _plain(value: Any) -> Any:
    """NumPy numbers and arrays as JSON types."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")
