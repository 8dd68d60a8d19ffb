"""Recorded detections and responses in place of pictures: one JSON object per line (docs/replay-format.md).

Any detector can write the file. `ReplayPerception` answers from it by time stamp. `eagor look` writes one of all that a
detector sees in footage, with the poses (`detection_lines`): look once, ask often. `RecordedLooks` gives such a file
back as a source without pictures.
"""

from __future__ import annotations

import json
import math
import os
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from eagor._checks import within
from eagor.errors import EagorError, FormatError, ImageError, PoseError, QueryError, TimeError
from eagor.evidence import Evidence, model_as_json
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.perception import Perception, infer, records
from eagor.perception.partial import ValidMasks, infer_view
from eagor.perception.records import Record, parse_record, read_looks, write_record
from eagor.perception.views import Detector
from eagor.perception.vocabulary import colour_of, fitting, match_class, named
from eagor.sources import Frame, Pose
from eagor.sources.odometry import PosedFrame
from eagor.sources.panorama import Picture
from eagor.tracking.tracks import SAME_MOMENT

__all__ = [
    "Record", "RecordedLooks", "ReplayPerception", "detection_lines", "first_line",
    "infer_or_replay", "parse_record", "write_record",
]  # fmt: skip

MOST_LABELS = 12  # in a sentence


class ReplayPerception:
    """Answers from a file of records instead of from the panorama; `records` by rising stamp.

    `calibration`: how responses become evidence (default: `Calibration()`); with one, boxes and points are read as a
    response map, too. `tolerance`: largest time difference, seconds, between a record and the stamp asked for.
    `detector`: error model of the recorded boxes and points (default: that of the file's first line, or
    `DetectorModel()`). `footage`: what that line says, None if it says nothing; where it names the classes of the
    detector, these decide what a query means. `labels`: how often each occurs on lines without a query of their own.

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
        self.calibration, self.detector = calibration, detector or (self.footage and self.footage.detector)
        if not within(tolerance, 0):
            raise TimeError(f"tolerance = {tolerance!r}; wanted seconds, 0 or more")
        self.tolerance, self.name = float(tolerance), os.fspath(path)
        open_lines = (record for record in self.records if record.query is None)
        self.labels = Counter(label for record in open_lines for label in record.labels if label is not None)

    def __call__(self, panorama: np.ndarray | None, query: str, *, stamp: float | None = None) -> Evidence:
        """The evidence recorded nearest to `stamp`, with the record's own stamp; `panorama` is ignored.

        Errors as of `near`, and `FormatError` if several records (views) are of that moment.
        """
        found = self.looks(query, stamp)
        if len(found) != 1:
            raise FormatError(
                f"{self.name} has {len(found)} records for {query!r} at stamp {found[0].stamp:.6f}; wanted one. "
                "If they are views of one moment, use each of looks(query, stamp)"
            )
        return found[0]

    def looks(self, query: str, stamp: float | None, strict: bool = True) -> tuple[Evidence, ...]:
        """The evidence of each of `near`: all of them are one look, and have one stamp. Errors as there."""
        found, wanted, looks = self.near(query, stamp, strict), self._wanted(query), []
        for record in found:
            look = record.evidence(query, self.calibration, self.detector, self.labels, wanted)
            asked = record.query is not None  # the detector had these words
            looks.append(look if asked else named(look, query, wanted or sorted(fitting(query, self.labels))))
        return tuple(looks)

    def looks_near(self, query: str, stamp: float, strict: bool = True) -> tuple[Evidence, ...]:
        """As `looks`, but empty if there is no record for this time."""
        try:
            return self.looks(query, stamp, strict)
        except TimeError:
            return ()

    def near(self, query: str, stamp: float | None, strict: bool = True) -> tuple[Record, ...]:
        """The records for `query` at the time nearest to `stamp`; several if that moment has several views.

        Raises `QueryError` if no record is for `query`, or (if `strict`: else the detector looked, and saw nothing of
        the kind) none of the labels fits it, `TimeError` if no record is within the tolerance.
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
            has = ", ".join(map(repr, asked)) + (more if self.footage else "")
            raise QueryError(f"{self.name} has nothing for the query {query!r}; it has {has}")
        nearest = min(stamps, key=lambda at: abs(at - stamp))
        if not found:
            raise TimeError(
                f"{self.name} has no record for {query!r} within {self.tolerance:g} s of stamp {stamp:.6f}; the "
                f"nearest is at {nearest:.6f} ({nearest - stamp:+.6f} s). Do both use one clock? Otherwise raise the "
                "tolerance"
            )
        return tuple(r for r in found if abs(r.stamp - nearest) <= SAME_MOMENT)

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

    def _check_labels(self, query: str) -> None:
        """Raise `QueryError` where labels decide, and all detections of the file have labels that do not fit."""
        if self._wanted(query) is not None:  # else raises: what the detector knows and has not seen is not there
            return
        if not self.labels or fitting(query, self.labels):
            return
        answering = (r for r in self.records if r.answers(query))
        if not any(r.query is not None or r.kind == "response" or None in r.labels for r in answering):
            raise QueryError(
                f"{self.used(query, 0)}. Ask for one of them. If the detector looked for {query!r} and saw none, its "
                'lines want "query": the words that it looked for'
            )

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


# --- a file of looks --------------------------------------------------------------------------------------------------


def first_line(of: str, perception: str, views: Detector, poses: str, begins: float = 0.0) -> str:
    """The line about the footage: what was looked at, by which perception, where its poses come from, in words."""
    about: dict[str, Any] = {"of": of, "perception": perception, "poses": poses, "begins": begins}
    about |= {"detector": model_as_json(views.detector), "classes": list(views.classes or ())}
    return json.dumps({"footage": {key: value for key, value in about.items() if value}})


def detection_lines(
    frames: Iterable[PosedFrame], views: Detector, queries: Sequence[str], masks: ValidMasks
) -> Iterator[tuple[PosedFrame, list[dict[str, Any]]]]:
    """Each frame, and its entries, one for each line: the poses before it, then one for a look.

    Without classes there is one for each of `queries`; of a frame that cannot be used one with the reason. What
    `masks` hide is written as not seen. Raises `EagorError` for a query without meaning, and what `frames` raise.
    """
    for posed in frames:
        frame, pose = posed.frame, posed.pose or Pose(posed.frame.stamp, np.eye(3))
        *entries, at = (
            {"stamp": float(each.stamp), "pose": records.pose_entry(each)} for each in (*posed.before, pose)
        )
        at["stamp"] = float(frame.stamp)
        if not posed.looked:
            yield posed, [*entries, at]
            continue
        at |= {"frame": frame.name} | ({"lost": True} if posed.lost else {})
        try:
            if frame.picture is None:
                raise ImageError(frame.problem)
            mask = masks.of(Picture(frame.picture, frame.unseen, grid=frame.grid))
            if mask is not None:
                at["valid_mask"] = records.mask_entry(mask)
            for query in queries or (None,):
                seen = views.detect(frame.picture, pose.world_R_body, query or "", frame.grid)
                entries.append(at | ({"query": query} if query else {}) | {"views": [*map(records.view_entry, seen)]})
        except QueryError:
            raise
        except EagorError as error:
            entries.append(at | {"problem": str(error)})
        yield posed, entries


class RecordedLooks:
    """A source of what `eagor look` wrote: frames without pictures, `posed`, for which `replay` answers.

    `about`: what the first line says, `count`: how many frames there are; `after`: the poses after the last one. Raises
    `FormatError` without that line, `PoseError` for a look without a pose.
    """

    live = False
    latency, dropped = 0.0, 0

    def __init__(self, replay: ReplayPerception) -> None:
        if replay.footage is None:
            raise FormatError(
                f"{replay.name} does not begin with a line about its footage; wanted a file that eagor look wrote, or "
                '{"footage": {"of": "clip.mp4", "perception": "NAME"}} as its first line'
            )
        self.replay, self.about = replay, replay.footage
        self.posed: list[PosedFrame] = []
        before: list[Pose] = []
        for record in replay.records:
            if self.posed and not before and self.posed[-1].frame.stamp == record.stamp:
                continue  # a further view or query of the same moment
            if record.pose is None:
                raise PoseError(
                    f"{replay.name} has a look at {record.stamp:g} s without a pose; wanted "
                    '"pose": {"qw", "qx", "qy", "qz"} (world_R_body) in its line, as eagor look writes it. With the '
                    "footage or its poses at hand: eagor track FRAMES QUERY --perception replay:FILE.jsonl"
                )
            if record.kind == "pose" and record.problem is None:
                before.append(record.pose)
                continue
            frame = Frame(record.stamp, None, record.frame or f"{record.stamp:.2f} s", problem=record.problem or "")
            self.posed.append(PosedFrame(frame, record.pose, tuple(before), lost=record.lost))
            before = []
        self.after, self.count = tuple(before), len(self.posed)

    @property
    def grid(self) -> ErpGrid:
        """There are no pictures."""
        raise FormatError(f"{self.replay.name} holds no pictures")

    def __iter__(self) -> Iterator[Frame]:
        return (each.frame for each in self.posed)

    def close(self) -> None:
        """Nothing is held."""

    def asked_for(self) -> list[str]:
        """What the file can be asked for, each once: the labels of what was seen, and what was looked for."""
        queries = [record.query for record in self.replay.records if record.query is not None and record.kind != "pose"]
        return [*dict.fromkeys([*sorted(self.replay.labels), *queries])]
