"""The lines of a replay file (docs/replay-format.md): reading, checking and writing them."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TextIO

import numpy as np

from eagor.errors import EagorError, FormatError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, Grid, PatchGrid
from eagor.perception.labels import fitting
from eagor.perception.record_fields import (
    LARGEST,
    is_number,
    json_lines,
    misplaced,
    need,
    number,
    object_of,
    only,
    probability,
    score_kind,
    size,
    view_of,
    words_of,
)
from eagor.sphere import direction

KINDS = ("boxes", "points", "response")
KEYS = ("stamp", "query", "look", "image", *KINDS, "scores")
OF_ITEMS = {
    "boxes": ("box", "score", "label"),
    "points": ("azimuth_deg", "elevation_deg", "spread_deg", "score", "label"),
}
APART = 1.0  # seconds: lines of one look that lie farther apart are taken for a mistake


@dataclass(frozen=True, eq=False)
class Record:
    """One line of the file, checked: `kind` is "boxes", "points" or "response".

    `query`: None for any query. `grid`: of the image or of the response; None for points anywhere. `values`: boxes
    ``(n, 4)`` in pixels; points ``(n, 3)`` as azimuth, elevation, spread in radians (NaN if not given); or the
    response. `scores` ``(n,)`` in [0, 1] and `labels` are empty for a response. `look`: which views are one look; None:
    those of the same stamp.
    """

    stamp: float
    query: str | None
    kind: str
    grid: Grid | None
    values: np.ndarray
    scores: np.ndarray
    labels: Sequence[str | None]
    look: str | None = None

    def answers(self, query: str) -> bool:
        """Whether this line is for `query`; letter case and spaces do not matter."""
        return self.query is None or words_of(self.query) == words_of(query)

    def evidence(
        self,
        query: str,
        calibration: Calibration | None = None,
        detector: DetectorModel | None = None,
        among: Collection[str] = (),
    ) -> Evidence:
        """The evidence for `query`. On a line without a query of its own, items with another label are left out.

        `among`: the labels of all lines, of which those that `query` names best are meant (`eagor.perception.labels`);
        default: those of this line. Boxes and points are detections of `detector` (default: `DetectorModel()`); with a
        `calibration` they are read as a response map instead. A point with a spread of its own keeps it.
        """
        if self.kind == "response" and self.grid is not None:
            return Evidence.from_response(self.values, self.grid, calibration=calibration, stamp=self.stamp)
        own = [label for label in self.labels if label is not None]
        wanted = fitting(query, among or own) if self.query is None and own else frozenset[str]()
        keep = [self.query is not None or label is None or label in wanted for label in self.labels]
        values, scores = self.values[keep], self.scores[keep]
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
    records: list[Record] = []
    for line, where in json_lines(path):
        try:
            records.append(parse_record(line))
        except EagorError as error:
            raise misplaced(error, where) from error
    name = os.fspath(path)
    if not records:
        raise FormatError(f"{name} holds no records; wanted one JSON object per line, at least one")
    return tuple(sorted(_joined(records, name), key=lambda r: r.stamp))


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
    entry = object_of(line)
    only(entry, KEYS, "a line")
    stamp = number(entry, "stamp")
    query, look = entry.get("query"), entry.get("look")
    need(query is None or (isinstance(query, str) and words_of(query) != []), "query", query, "words, or no such key")
    is_id = isinstance(look, str | int) and not isinstance(look, bool) and look != ""
    need(look is None or is_id, "look", look, "text or a whole number, the same for all views of a moment")
    look, scores = None if look is None else str(look), score_kind(entry)
    kinds = [kind for kind in KINDS if entry.get(kind) is not None]
    if len(kinds) != 1:
        raise FormatError(f"has {' and '.join(kinds) or 'none'} of boxes, points, response; wanted exactly one")
    kind, image = kinds[0], {} if entry.get("image") is None else entry["image"]
    need(isinstance(image, dict), "image", image, "an object with width and height")
    if kind == "response":
        rows, columns, values = _response(entry["response"], scores)
        grid = view_of(image, rows, columns) or PatchGrid(rows, columns)
        return Record(stamp, query, kind, grid, values.reshape(rows, columns), np.zeros(0), (), look)
    items = entry[kind]
    need(isinstance(items, list) and all(isinstance(i, dict) for i in items), kind, items, "a list of objects")
    for item in items:
        only(item, OF_ITEMS[kind], f"an item of {kind}")
    found = np.array([1.0 if item.get("score") is None else probability(item["score"], scores) for item in items])
    labels = tuple(item.get("label") for item in items)
    need(all(label is None or isinstance(label, str) for label in labels), "label", labels, "text")
    grid = view_of(image)
    if kind == "boxes":
        height, width = size(image, "height"), size(image, "width")
        values = np.array([_box(item.get("box"), height, width, grid is None) for item in items]).reshape(-1, 4)
        grid = grid or ErpGrid(height, width)
    else:
        values = np.radians([_point(item) for item in items]).reshape(-1, 3)
    return Record(stamp, query, kind, grid, values, found, labels, look)


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


def _box(box: Any, height: int, width: int, panorama: bool) -> list[float]:
    """The four pixel coordinates of a box that overlaps the image."""
    wanted = f"[x0, y0, x1, y1] in pixels of the {width} x {height} image (not x, y, width, height, and not 0 to 1)"
    fine = isinstance(box, list) and len(box) == 4 and all(is_number(v) and abs(v) <= 4 * LARGEST for v in box)
    need(fine, "box", box, wanted)
    x0, y0, x1, y1 = (float(v) for v in box)
    left, right = (x0, x1 + width * (x1 < x0)) if panorama else (max(x0, 0.0), min(x1, float(width)))
    need(left < right <= left + width and max(y0, 0.0) < min(y1, float(height)), "box", box, wanted)
    return [x0, y0, x1, y1]


def _point(item: dict) -> tuple[float, float, float]:
    """Azimuth, elevation and spread (NaN if not given), degrees."""
    azimuth, elevation = number(item, "azimuth_deg", -360, 360), number(item, "elevation_deg", -90, 90)
    spread = math.nan if item.get("spread_deg") is None else number(item, "spread_deg", 0.1, 180)
    return azimuth, elevation, spread


def _response(response: Any, scores: str) -> tuple[int, int, np.ndarray]:
    """Rows, columns and the values ``(rows * cols,)``."""
    need(isinstance(response, dict), "response", response, "an object with rows, cols and values")
    only(response, ("rows", "cols", "values"), "response")
    rows, columns, values = size(response, "rows"), size(response, "cols"), response.get("values")
    fine = isinstance(values, list) and len(values) == rows * columns
    found = f"{len(values)} values" if isinstance(values, list) else values
    need(fine, "values", found, f"rows * cols = {rows * columns} numbers")
    wrong = [v for v in values if not (is_number(v) and (scores == "logit" or 0 <= v <= 1))]
    need(not wrong, "values", wrong[:3], 'numbers in [0, 1] (of logits, say "scores": "logit" in the line)')
    table = np.array(values, dtype=np.float64)
    if scores == "logit":
        table = 1 / (1 + np.exp(-np.clip(table, -500, 500)))
    return rows, columns, table.astype(np.float32)


def _plain(value: Any) -> Any:
    """NumPy numbers and arrays as JSON types."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")
