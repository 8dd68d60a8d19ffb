"""The lines of a replay file (docs/replay-format.md): reading, checking and writing them."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from eagor._json import parsed
from eagor._json import shown as _short
from eagor.errors import EagorError, FormatError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, Grid, PatchGrid, PerspectiveGrid
from eagor.sphere import direction, world_R_body

KINDS = ("boxes", "points", "response")
_LARGEST = 65536  # pixels along one side; more is taken for a mistake
_LONGEST = 32  # a view this many times longer than wide is taken for a mistake, too


@dataclass(frozen=True, eq=False)
class Record:
    """One line of the file, checked: `kind` is "boxes", "points" or "response".

    `query`: None for any query. `grid`: of the image or of the response; None for points anywhere. `values`: boxes
    ``(n, 4)`` in pixels; points ``(n, 3)`` as azimuth, elevation, spread in radians (NaN if not given); or the
    response. `scores` ``(n,)`` in [0, 1] and `labels` are empty for a response.
    """

    stamp: float
    query: str | None
    kind: str
    grid: Grid | None
    values: np.ndarray
    scores: np.ndarray
    labels: Sequence[str | None]

    def answers(self, query: str) -> bool:
        """Whether this line is for `query`; letter case and spaces do not matter."""
        return self.query is None or _words(self.query) == _words(query)

    def evidence(
        self, query: str, calibration: Calibration | None = None, detector: DetectorModel | None = None
    ) -> Evidence:
        """The evidence for `query`. On a line without a query of its own, items with another label are left out.

        Boxes and points are detections of `detector` (default: `DetectorModel()`); with a `calibration` they are read
        as a response map instead. A point with a spread of its own keeps it.
        """
        if self.kind == "response" and self.grid is not None:
            return Evidence.from_response(self.values, self.grid, calibration=calibration, stamp=self.stamp)
        wanted = set(_words(query))
        keep = [self.query is not None or label is None or wanted.issuperset(_words(label)) for label in self.labels]
        values, scores = self.values[keep], self.scores[keep]
        if self.kind == "boxes" and self.grid is not None:
            return Evidence.from_boxes(values, self.grid, scores, calibration, self.stamp, detector=detector)
        spread = (detector or DetectorModel()).spread
        concentration = np.where(np.isnan(values[:, 2]), spread, values[:, 2]) ** -2.0
        points = direction(values[:, 0], values[:, 1])
        return Evidence.from_points(points, concentration, scores, self.grid, calibration, self.stamp, detector)


def read_records(path: str | os.PathLike[str]) -> tuple[Record, ...]:
    """The records of a JSONL file in order of time; `FormatError` names the file and the line of a fault."""
    name = os.fspath(path)
    try:
        content = Path(path).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise FormatError(f"{name} cannot be read ({error}); give the path of a JSONL file") from error
    lines = content.removeprefix(b"\xef\xbb\xbf").split(b"\n")
    records: list[Record] = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            records.append(parse_record(line))
        except EagorError as error:
            cut = isinstance(error.__cause__, json.JSONDecodeError | UnicodeDecodeError)
            hint = ". The last line is incomplete: the writer was probably interrupted; remove the line"
            hint = hint if cut and number == len(lines) else ""
            raise FormatError(f"{name}, line {number}: {error}{hint}") from error
    if not records:
        raise FormatError(f"{name} holds no records; wanted one JSON object per line, at least one")
    return tuple(sorted(records, key=lambda r: r.stamp))


def parse_record(line: str | bytes) -> Record:
    """One line as a `Record`. Raises `FormatError`, which says what is wrong and what is wanted."""
    try:
        entry = parsed(line.decode("utf-8") if isinstance(line, bytes) else line, strict=True)
    except ValueError as error:  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        raise FormatError(f"is not JSON ({error}); wanted one JSON object") from error
    _need(isinstance(entry, dict), "the line", entry, "one JSON object")
    stamp = _number(entry, "stamp")
    query = entry.get("query")
    _need(query is None or (isinstance(query, str) and _words(query) != []), "query", query, "words, or no such key")
    kinds = [kind for kind in KINDS if entry.get(kind) is not None]
    if len(kinds) != 1:
        raise FormatError(f"has {' and '.join(kinds) or 'none'} of boxes, points, response; wanted exactly one")
    kind, image = kinds[0], {} if entry.get("image") is None else entry["image"]
    _need(isinstance(image, dict), "image", image, "an object with width and height")
    if kind == "response":
        rows, cols, values = _response(entry["response"])
        grid = _view(image, rows, cols) or PatchGrid(rows, cols)
        return Record(stamp, query, kind, grid, values.reshape(rows, cols), np.zeros(0), ())
    items = entry[kind]
    _need(isinstance(items, list) and all(isinstance(i, dict) for i in items), kind, items, "a list of objects")
    scores = np.array([_number(item, "score", 0, 1, default=1.0) for item in items])
    labels = tuple(item.get("label") for item in items)
    _need(all(label is None or isinstance(label, str) for label in labels), "label", labels, "text")
    grid = _view(image)
    if kind == "boxes":
        height, width = _size(image, "height"), _size(image, "width")
        values = np.array([_box(item.get("box"), height, width, grid is None) for item in items]).reshape(-1, 4)
        grid = grid or ErpGrid(height, width)
    else:
        values = np.radians([_point(item) for item in items]).reshape(-1, 3)
    return Record(stamp, query, kind, grid, values, scores, labels)


def write_record(
    file: TextIO,
    stamp: float,
    *,
    query: str | None = None,
    image: Mapping[str, Any] | None = None,
    boxes: Sequence[Mapping[str, Any]] | None = None,
    points: Sequence[Mapping[str, Any]] | None = None,
    response: np.ndarray | None = None,
) -> None:
    """Append one line to an open text file and flush it; the line is checked before anything is written.

    Give exactly one of `boxes`, `points` (entries as in the format) and `response` ``(rows, cols)``. Raises
    `FormatError`.
    """
    entry: dict[str, Any] = {"stamp": stamp, "query": query, "image": image, "boxes": boxes, "points": points}
    if response is not None:
        values = np.asarray(response, dtype=float)
        _need(values.ndim == 2, "response", values.shape, "an array (rows, cols)")
        entry["response"] = {"rows": values.shape[0], "cols": values.shape[1], "values": values.ravel().tolist()}
    try:
        line = json.dumps({k: v for k, v in entry.items() if v is not None}, default=_plain)
    except (TypeError, ValueError) as error:
        raise FormatError(f"the record cannot be written as JSON: {error}") from error
    parse_record(line)
    file.write(line + "\n")
    file.flush()


def _view(image: dict, rows: int | None = None, cols: int | None = None) -> PerspectiveGrid | None:
    """The perspective view that `image` describes, in pixels or in `rows` and `cols`; None for a panorama."""
    projection = image.get("projection", "equirectangular")
    if projection == "equirectangular":
        return None
    _need(projection == "perspective", "projection", projection, '"equirectangular" or "perspective"')
    height, width = rows or _size(image, "height"), cols or _size(image, "width")
    _need(max(height, width) <= _LONGEST * min(height, width), "image", (width, height), f"sides up to {_LONGEST}:1")
    hfov, yaw = _number(image, "hfov_deg", 0.1, 179), _number(image, "yaw_left_deg", -360, 360, default=0.0)
    pitch = _number(image, "pitch_up_deg", -90, 90, default=0.0)
    # In REP-103 a positive pitch turns the nose down.
    return PerspectiveGrid(height, width, math.radians(hfov), world_R_body(math.radians(yaw), -math.radians(pitch)))


def _box(box: Any, height: int, width: int, panorama: bool) -> list[float]:
    """The four pixel coordinates of a box that overlaps the image."""
    wanted = f"[x0, y0, x1, y1] in pixels of the {width} x {height} image (not x, y, width, height, and not 0 to 1)"
    fine = isinstance(box, list) and len(box) == 4 and all(_is_number(v) and abs(v) <= 4 * _LARGEST for v in box)
    _need(fine, "box", box, wanted)
    x0, y0, x1, y1 = (float(v) for v in box)
    left, right = (x0, x1 + width * (x1 < x0)) if panorama else (max(x0, 0.0), min(x1, float(width)))
    _need(left < right <= left + width and max(y0, 0.0) < min(y1, float(height)), "box", box, wanted)
    return [x0, y0, x1, y1]


def _point(item: dict) -> tuple[float, float, float]:
    """Azimuth, elevation and spread (NaN if not given), degrees."""
    azimuth, elevation = _number(item, "azimuth_deg", -360, 360), _number(item, "elevation_deg", -90, 90)
    spread = math.nan if item.get("spread_deg") is None else _number(item, "spread_deg", 0.1, 180)
    return azimuth, elevation, spread


def _response(response: Any) -> tuple[int, int, np.ndarray]:
    """Rows, columns and the values ``(rows * cols,)``."""
    _need(isinstance(response, dict), "response", response, "an object with rows, cols and values")
    rows, cols, values = _size(response, "rows"), _size(response, "cols"), response.get("values")
    fine = isinstance(values, list) and len(values) == rows * cols
    found = f"{len(values)} values" if isinstance(values, list) else values
    _need(fine, "values", found, f"rows * cols = {rows * cols} numbers")
    wrong = [v for v in values if not (_is_number(v) and 0 <= v <= 1)]
    _need(not wrong, "values", wrong[:3], "numbers in [0, 1]")
    return rows, cols, np.array(values, dtype=np.float32)


def _number(entry: dict, key: str, low: float = -1e300, high: float = 1e300, default: float | None = None) -> float:
    value: Any = default if entry.get(key) is None else entry[key]
    bounds = f"a number from {low:g} to {high:g}" if high < 1e300 else "a finite number"
    _need(_is_number(value) and low <= value <= high, key, value, bounds)
    return float(value)


def _size(entry: dict, key: str) -> int:
    value: Any = entry.get(key)
    fine = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _LARGEST
    _need(fine, key, value, f"a whole number from 1 to {_LARGEST}")
    return int(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _need(holds: bool, what: str, came: Any, wanted: str) -> None:
    if not holds:
        found = "is missing" if came is None else f"is {_short(came)}"
        raise FormatError(f"{what} {found}; wanted {wanted}")


def _words(text: str) -> list[str]:
    """Lower-case words: runs of letters and digits of any script."""
    return re.findall(r"\w+", text.casefold())


def _plain(value: Any) -> Any:
    """NumPy numbers and arrays as JSON types."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")
