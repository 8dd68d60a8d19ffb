"""A perception that reads what some detector wrote: detections or responses by time stamp, one JSON object per line.

Any detector can write the file (JSON Lines, UTF-8). Each line is one look at the world, with these keys:

- ``stamp``: seconds, when the image was captured. Required.
- ``query``: what was looked for. Absent: the line holds for any query, and labels decide (see below).
- ``image``: what the pixels mean, ``{"width": 1024, "height": 512, "projection": "equirectangular"}`` or
  ``{"width": 640, "height": 480, "projection": "perspective", "hfov_deg": 90, "yaw_left_deg": 0, "pitch_up_deg": 0}``.
  The view of a perspective image points `yaw_left_deg` to the left of forward and `pitch_up_deg` up (default 0).
  Default: equirectangular. `width` and `height` are required for boxes, and for points in a perspective image.

and exactly one of:

- ``boxes``: ``[{"box": [x0, y0, x1, y1], "score": 0.9, "label": "chair"}, ...]``, pixels from the upper left corner of
  the image. In an equirectangular image x0 > x1 or x1 > width means across the seam. ``[]``: looked and saw nothing.
- ``points``: ``[{"azimuth_deg": 30, "elevation_deg": -5, "spread_deg": 4, "score": 0.9, "label": "chair"}, ...]`` in
  the body frame (azimuth positive to the left); `spread_deg` is the standard deviation about the point (default: the
  detector's, 5).
- ``response``: ``{"rows": 18, "cols": 36, "values": [...]}``, row by row from the upper left, over the whole image; in
  a perspective image the cells are square.

A perspective image says nothing about what lies outside it.

Scores and response values lie in [0, 1]; `score` is 1 where absent. A `label` matters on lines without ``query``: the
detection then counts if every word of its label occurs in the query (letter case aside): "chair" and "red chair" count
for "the red chair", "armchair" does not. Detections without a label always count. Other keys are ignored, and null is
as good as absent.
"""

from __future__ import annotations

import math
import os
from bisect import bisect_left, bisect_right

import numpy as np

from eagor._checks import within
from eagor.calibration import Calibration
from eagor.detector import DetectorModel
from eagor.errors import EagorError, FormatError, QueryError, TimeError
from eagor.evidence import Evidence
from eagor.perception.records import Record, parse_record, read_records, write_record
from eagor.tracks import SAME_MOMENT

__all__ = ["Record", "ReplayPerception", "parse_record", "read_records", "write_record"]


class ReplayPerception:
    """Answers from a file of records instead of from the panorama.

    Args:
        path: the JSONL file (format: this module's text).
        calibration: how responses become evidence (default: `Calibration()`); where one is given, boxes and points are
            read as a response map, too.
        tolerance: seconds by which a record may be away from the time that is asked for.
        detector: how the detector errs that wrote boxes and points (default: `DetectorModel()`).

    Attributes:
        records: all `Record` objects by rising stamp.

    Raises `FormatError` for a file that does not follow the format, `TimeError` for a tolerance that is none.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        calibration: Calibration | None = None,
        tolerance: float = 0.05,
        detector: DetectorModel | None = None,
    ) -> None:
        self.records = read_records(path)
        self.calibration, self.detector = calibration, detector
        if not within(tolerance, 0):
            raise TimeError(f"tolerance = {tolerance!r}; wanted seconds, 0 or more")
        self.tolerance = float(tolerance)
        self._name = os.fspath(path)

    def near(self, query: str, stamp: float | None) -> tuple[Record, ...]:
        """The records for `query` at the time nearest to `stamp`: several where views were taken at one moment.

        Raises `QueryError` if no record is for `query`, `TimeError` if none is within the tolerance.
        """
        if not isinstance(query, str):
            raise QueryError(f"the query is {query!r}; wanted words")
        if stamp is None or not within(stamp, -math.inf):
            raise TimeError(f"replay needs the time of capture, seconds; got stamp={stamp!r}. Pass stamp=...")
        first = bisect_left(self.records, stamp - self.tolerance, key=lambda r: r.stamp)
        last = bisect_right(self.records, stamp + self.tolerance, key=lambda r: r.stamp)
        found = [r for r in self.records[first:last] if r.answers(query)]
        if not found:
            raise self._nothing(query, stamp)
        nearest = min(found, key=lambda r: abs(r.stamp - stamp)).stamp
        return tuple(r for r in found if abs(r.stamp - nearest) <= SAME_MOMENT)

    def _nothing(self, query: str, stamp: float) -> EagorError:
        """Why there is no record for `query` at `stamp`."""
        stamps = [r.stamp for r in self.records if r.answers(query)]
        if not stamps:
            asked = sorted({str(r.query) for r in self.records})[:8]
            return QueryError(f"{self._name} has nothing for the query {query!r}; it has {', '.join(map(repr, asked))}")
        nearest = min(stamps, key=lambda s: abs(s - stamp))
        return TimeError(
            f"{self._name} has no record for {query!r} within {self.tolerance:g} s of stamp {stamp:.6f}; the nearest "
            f"is at {nearest:.6f} ({nearest - stamp:+.6f} s). Are both on one clock? Else raise the tolerance"
        )

    def __call__(self, panorama: np.ndarray | None, query: str, *, stamp: float | None = None) -> Evidence:
        """The evidence recorded nearest to `stamp`, with the record's own stamp; `panorama` is not looked at.

        Raises `QueryError` and `TimeError` as `near` does, and `FormatError` where several records are of that moment
        (views): update the belief with each of ``near(query, stamp)`` instead.
        """
        record, *others = self.near(query, stamp)
        if others:
            raise FormatError(
                f"{self._name} has {1 + len(others)} records for {query!r} at stamp {record.stamp:.6f}; wanted one. "
                "If they are views of one moment, use each of near(query, stamp)"
            )
        return record.evidence(query, self.calibration, self.detector)
