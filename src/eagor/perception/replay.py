"""A perception that reads recorded detections or responses by time stamp, one JSON object per line.

Any detector can write the file; docs/replay-format.md describes it. A replay may have several views of one moment.
"""

from __future__ import annotations

import math
import os
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Sequence

import numpy as np

from eagor._checks import within
from eagor.errors import FormatError, QueryError, TimeError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import PerspectiveGrid
from eagor.perception import Perception, infer
from eagor.perception.partial import infer_view
from eagor.perception.records import Record, parse_record, read_looks, read_records, write_record
from eagor.perception.vocabulary import colour_of, fitting, match_class, named
from eagor.tracking.tracks import SAME_MOMENT

__all__ = ["Record", "ReplayPerception", "infer_or_replay", "parse_record", "read_records", "write_record"]

MOST_LABELS = 12  # in a sentence


class ReplayPerception:
    """Answers from a file of records (docs/replay-format.md) instead of from the panorama; `records` by rising stamp.

    `calibration`: how responses become evidence (default: `Calibration()`); with one, boxes and points are read as a
    response map, too. `tolerance`: largest time difference, seconds, between a record and the stamp asked for.
    `detector`: error model of the recorded boxes and points (default: `DetectorModel()`). `labels`: how often each
    label occurs on lines without a query of their own.

    `footage`: what the first line says of the footage, None if it says nothing. Where that names the classes of the
    detector, these decide what a query means; its error model is the default of `detector`.

    Raises `FormatError` for a file that does not follow the format, `TimeError` for an invalid tolerance.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        calibration: Calibration | None = None,
        tolerance: float = 0.05,
        detector: DetectorModel | None = None,
    ) -> None:
        self.footage, self.records = read_looks(path)
        own = None if self.footage is None else self.footage.detector
        self.calibration, self.detector = calibration, own if detector is None else detector
        if not within(tolerance, 0):
            raise TimeError(f"tolerance = {tolerance!r}; wanted seconds, 0 or more")
        self.tolerance = float(tolerance)
        self.name = os.fspath(path)
        open_lines = (record for record in self.records if record.query is None)
        self.labels = Counter(label for record in open_lines for label in record.labels if label is not None)

    def looks(self, query: str, stamp: float | None) -> tuple[Evidence, ...]:
        """The evidence of each of `near`: all of them are one look, and have one stamp. Errors as there."""
        return self._evidence(self.near(query, stamp), query)

    def looks_near(self, query: str, stamp: float, strict: bool = True) -> tuple[Evidence, ...]:
        """As `looks`, but empty if there is no record for this time; not `strict`: labels that do not fit are no fault.

        Then the detector looked, and saw nothing of the kind.
        """
        try:
            return self._evidence(self.near(query, stamp, strict), query)
        except TimeError:
            return ()

    def near(self, query: str, stamp: float | None, strict: bool = True) -> tuple[Record, ...]:
        """The records for `query` at the time nearest to `stamp`; several if that moment has several views.

        Raises `QueryError` if no record is for `query`, or (if `strict`) none of the labels fits it, `TimeError` if no
        record is within the tolerance.
        """
        if not isinstance(query, str):
            raise QueryError(f"the query is {query!r}; wanted words")
        if strict:
            self._check_labels(query)
        if stamp is None or not within(stamp, -math.inf):
            raise TimeError(f"replay needs the time of capture, seconds; got stamp={stamp!r}. Pass stamp=...")
        first = bisect_left(self.records, stamp - self.tolerance, key=lambda r: r.stamp)
        last = bisect_right(self.records, stamp + self.tolerance, key=lambda r: r.stamp)
        found = [r for r in self.records[first:last] if r.answers(query)]
        stamps = [r.stamp for r in found or self.records if r.answers(query)]
        if not stamps:
            asked = sorted({str(r.query) for r in self.records if r.kind != "pose"})[:8]
            more = ". That was never looked for, so nobody knows: eagor look FRAMES --for NAME ... looks for it"
            more = f"{', '.join(map(repr, asked))}{more if self.footage else ''}"
            raise QueryError(f"{self.name} has nothing for the query {query!r}; it has {more}")
        nearest = min(stamps, key=lambda at: abs(at - stamp))
        if not found:
            raise TimeError(
                f"{self.name} has no record for {query!r} within {self.tolerance:g} s of stamp {stamp:.6f}; the "
                f"nearest is at {nearest:.6f} ({nearest - stamp:+.6f} s). Do both use one clock? Otherwise raise the "
                "tolerance"
            )
        return tuple(r for r in found if abs(r.stamp - nearest) <= SAME_MOMENT)

    def _evidence(self, records: Sequence[Record], query: str) -> tuple[Evidence, ...]:
        wanted, looks = self._wanted(query), []
        for record in records:
            look = record.evidence(query, self.calibration, self.detector, self.labels, wanted)
            asked = record.query is not None  # the detector had these words
            looks.append(look if asked else named(look, query, wanted or sorted(fitting(query, self.labels))))
        return tuple(looks)

    def _wanted(self, query: str) -> tuple[str, ...] | None:
        """The classes of the detector that `query` means; None where the file does not name them.

        Raises `QueryError` if none is meant, and for a colour, of which nothing was written.
        """
        if self.footage is None or self.footage.classes is None:
            return None
        wanted = match_class(query, self.footage.classes, coloured=True)
        if colour_of(query, self.footage.classes) is not None:
            raise QueryError(
                f"the query {query!r} names a colour, and {self.name} holds boxes without pictures; ask for "
                f"{wanted[0]!r}, or look at the footage itself: eagor track FRAMES {query!r}"
            )
        return wanted

    def used(self, query: str, lines: int) -> str:
        """How many of the lines were used, and which labels stand for `query`: a sentence for the end of a run."""
        sentence = f"{lines} of {len(self.records)} lines of {self.name} used"
        if not self.labels:
            return sentence
        wanted = self._wanted(query) or fitting(query, self.labels)
        means = f"{query!r} means {', '.join(map(repr, sorted(wanted)))}" if wanted else f"none fits {query!r}"
        shown = [f"{label} ({count})" for label, count in self.labels.most_common(MOST_LABELS)]
        more = f" and {len(self.labels) - MOST_LABELS} more" * (len(self.labels) > MOST_LABELS)
        return f"{sentence}; labels in the file: {', '.join(shown)}{more}; {means}"

    def _check_labels(self, query: str) -> None:
        """Raise `QueryError` where labels decide, and all detections of the file have labels that do not fit."""
        if self._wanted(query) is not None:  # else raises: what the detector knows and has not seen is not there
            return
        if not self.labels or fitting(query, self.labels):
            return
        answering = [record for record in self.records if record.answers(query)]
        if any(r.query is not None or r.kind == "response" or None in r.labels for r in answering):
            return
        raise QueryError(
            f"{self.used(query, 0)}. Ask for one of them. If the detector looked for {query!r} and saw none, its lines "
            'want "query": the words that it looked for'
        )

    def __call__(self, panorama: np.ndarray | None, query: str, *, stamp: float | None = None) -> Evidence:
        """The evidence recorded nearest to `stamp`, with the record's own stamp; `panorama` is ignored.

        Raises `QueryError` and `TimeError` as `near` does, and `FormatError` if several records (views) are of that
        moment: then observe each of ``looks(query, stamp)``.
        """
        records = self.near(query, stamp)
        if len(records) > 1:
            raise FormatError(
                f"{self.name} has {len(records)} records for {query!r} at stamp {records[0].stamp:.6f}; wanted one. "
                "If they are views of one moment, use each of looks(query, stamp)"
            )
        return self._evidence(records, query)[0]


def infer_or_replay(
    perception: Perception,
    picture: np.ndarray | None,
    query: str,
    stamp: float,
    world_R_body: np.ndarray | None = None,
    grid: PerspectiveGrid | None = None,
) -> tuple[Evidence, ...]:
    """The evidence of `perception`: one, of a replay one per view, or none where it has no line for this time.

    `picture` ``(H, W, 3)`` uint8 is a panorama, or an ordinary one with the pixels of `grid`.
    """
    if isinstance(perception, ReplayPerception):
        return perception.looks_near(query, stamp)
    assert picture is not None, "only a replay answers without a picture"
    if grid is not None:
        return (infer_view(perception, picture, grid, query, stamp=stamp),)
    return (infer(perception, picture, query, stamp=stamp, world_R_body=world_R_body),)
