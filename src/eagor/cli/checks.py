"""What options say, checked before long work, and made into perceptions, settings and files.

Every check returns what it was given, or raises `UsageError`. What is heavy is imported where it is needed: help and
usage errors come at once.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor.cli.terminal import UsageError, log, warning
from eagor.errors import EagorError, QueryError

if TYPE_CHECKING:
    from eagor.cli.options import Lens, Looking
    from eagor.evidence import BodyMask, Evidence
    from eagor.perception import Perception
    from eagor.perception.calibrated import Calibrated
    from eagor.tracking.config import TrackerConfig

SHARED = ("coco", "onnx")  # perceptions that look at several views at the same time, one core each
ABOVE = math.ulp(0)
SECONDS, RATE, SOME = (ABOVE, math.inf, "seconds above 0"), "a number per second above 0", (1, math.inf, "1 or more")
LIMITS = {  # of an option of any command: least, most, and what is wanted
    "degree": (1, 63, "1 to 63 (15 resolves about 12 degrees)"), "rows": (8, math.inf, "8 or more"), "modes": SOME,
    "drift": (0, 90, "degrees from 0 to 90"), "latency": (0, math.inf, "seconds, 0 or more"), "seconds": SECONDS,
    "patience": SECONDS, "every": SECONDS, "most": SECONDS, "rate": (ABOVE, 1000, f"{RATE}, up to 1000"),
    "fps": (ABOVE, math.inf, RATE), "workers": SOME, "trials": SOME, "take": SOME, "episodes": SOME,
    "speed": (0, 3, "0 to 3 metres per second"), "limit": (0, math.inf, "0 or more"),
    "floor": (-math.inf, math.inf, "a height in metres"), "port": (0, 65535, "a port from 0 to 65535"),
}  # fmt: skip
ENDINGS = {"picture": (".png", ".jpg", ".jpeg", ".webp"), "table": (".csv", ".jsonl"), "looks": (".jsonl",)}
OUTPUTS = {
    "out": "file", "picture": "picture", "pictures": "folder", "video": "file", "page": "file", "rerun": "file",
    "record": "new folder",
}  # fmt: skip


# --- numbers and words ---------------------------------------------------------------------------------------------


def check_numbers(options: object) -> None:
    """Raise `UsageError` unless the numbers of a command are within `LIMITS`."""
    for name, (least, most, wanted) in LIMITS.items():
        value = getattr(options, name, None)
        if isinstance(value, int | float) and not (least <= value <= most and abs(value) < math.inf):
            raise UsageError(f"--{name} {value:g}; wanted {wanted}")


def checked_query(query: str) -> str:
    """`query`, if it contains a word; else raises `QueryError`."""
    if not re.search(r"\w", query):
        raise QueryError(f"the query {query!r} has no words; say what to look for, such as 'red chair'")
    return query


def checked_queries(words: Sequence[str]) -> list[str]:
    """Several queries, each once."""
    queries = [checked_query(word) for word in words]
    if len({*queries}) < len(queries):
        raise UsageError("a query comes twice; name each thing once")
    return queries


# --- places to read from, and to write to --------------------------------------------------------------------------


def places_of(words: Sequence[str], rig: bool) -> list[Path]:
    """The files that are named; with a `rig` they may stand with commas between, one for each lens."""
    if rig:
        words = [part for word in words for part in ([word] if os.path.exists(word) else word.split(","))]
    return [Path(word) for word in words]


def frames_and_queries(words: Sequence[str]) -> tuple[Sequence[str], list[str]]:
    """What names the frames, and the queries after it; none for one word alone.

    The first word that is no file, and has no suffix as a misspelt one would have, is the first query.
    """
    if len(words) < 2:
        return words, []
    first = next(
        (at for at, word in enumerate(words[1:-1], 1) if not (os.path.exists(word) or Path(word).suffix)),
        len(words) - 1,
    )
    return words[:first], checked_queries(words[first:])


def check_outputs(options: object, inputs: Sequence[str | Path | None] = (), **kinds: str) -> None:
    """Raise `UsageError` if an output of the command can hardly be written, or is one of its `inputs`.

    `kinds` of outputs, where they are not those of `OUTPUTS`. Folders above them will be made, not here.
    """
    read = [os.path.realpath(path) for path in inputs if path is not None]
    for name, kind in (OUTPUTS | kinds).items():
        if not isinstance(path := getattr(options, name, None), Path):
            continue
        if os.path.realpath(path) in read:
            raise UsageError(f"--{name} {path} is an input; name another place to write to")
        if path.suffix.lower() not in (endings := ENDINGS.get(kind, (path.suffix.lower(),))):
            raise UsageError(f"--{name} {path}: wanted a file name that ends in {' or '.join(endings)}")
        folder = kind.endswith("folder")
        there = next(place for place in (path.absolute(), *path.absolute().parents) if os.path.exists(place))
        fits = there.is_dir() if folder else there.is_dir() != path.exists()
        if not fits or not os.access(there, os.W_OK):
            what = "a folder" if folder else "a file in a folder"
            raise UsageError(f"--{name} {path} cannot be written ({there} is in the way); name {what} that can")
        if kind == "new folder" and path.exists():
            raise UsageError(f"--{name} {path} is there already; name a new folder")


# --- perceptions and the tracker's settings ------------------------------------------------------------------------


def perception_for(queries: Sequence[str], spec: str | None) -> str:
    """The one perception that answers all `queries`: ``--perception``, or what suits them.

    By default that is the detector ``coco``, whose boxes a colour before the noun weighs. A bare colour ("red",
    "something red", "a red thing") is answered by ``colour``. Raises `QueryError` where ``coco`` cannot run here, or
    there is no one answer for all; of what ``coco`` does not know it says so itself, and what does.
    """
    from eagor.perception.coco import CLASSES, wanted
    from eagor.perception.vocabulary import by_colour_alone, is_bare_colour, match_class

    if spec is not None:
        return spec
    nouns = [query for query in queries if not is_bare_colour(query, CLASSES)]
    if nouns and (steps := wanted()):
        none = f"no detector for {nouns[0]!r} is installed"
        try:
            match_class(nouns[0], CLASSES, described=True)
        except QueryError as error:  # which says what knows it
            raise QueryError(f"{none}, and coco would not do: {error}") from None
        raise QueryError(
            f"{none}. To get a small one for everyday things: {'; then '.join(steps)}. Or a detector of your own is "
            "--perception onnx:MODEL.onnx, my.py:FUNCTION or replay:FILE.jsonl" + by_colour_alone(nouns[0], CLASSES)
        )
    if 0 < len(nouns) < len(queries):
        raise QueryError(
            "coco and colour would each answer some of the queries; name one with --perception. Is it one thing? "
            f'Write a query of several words in quotes: "{" ".join(queries)}"'
        )
    return "coco" if nouns else "colour"


def make_perception(spec: str, busy: bool = False) -> Perception:
    """The perception that ``--perception`` names. `busy`: nothing else runs meanwhile, so it may take all cores."""
    from eagor.perception import load

    name, _, text = spec.partition(":")
    if name == "replay" and not text:
        raise UsageError("--perception replay needs the file that the detector wrote: replay:FILE.jsonl")
    if busy and name in SHARED and not re.search(r"\b(together|threads)=", text):
        usable = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
        return load(spec, together=len(usable))
    return load(spec)


def rows_for(spec: str, rows: int | None = None, least: int | None = None) -> int:
    """Rows of live panoramas: ``--rows``, else what the perception wants, and `least` (default: enough to look nice).

    A model is not loaded for that: it scales its pictures itself.
    """
    from eagor.perception import is_model, rows_of
    from eagor.sources.camera_sources import LEAST_ROWS

    return rows or max(least or LEAST_ROWS, 0 if is_model(spec) else rows_of(make_perception(spec)))


def check_looks(perception: str) -> None:
    """Raise `UsageError` if `perception` is a replay, which knows only its own frames."""
    from eagor.perception import short_name

    if short_name(perception) == "replay":
        raise UsageError(
            f"--perception {perception} belongs to other frames than the ones rendered here; run your detector as a "
            "perception. To fit a replay on looks with known truth: eagor calibrate --replay FILE --truth FILE"
        )


def tracker_config(perception: str, options: Looking) -> TrackerConfig:
    """The tracker's configuration for the options of a command; with --static nothing moves, whatever was fitted."""
    from eagor.tracking.config import MotionModel, TrackerConfig

    given = vars(options)
    config = TrackerConfig(degree=options.degree, floor_height=given.get("floor"))
    if (found := calibrated(perception, options.calibration, options.detector, options.force)) is not None:
        config = config.fitted(found.calibration, found.detector, found.forgetting)
    if (drift := given.get("drift")) is not None:
        config = replace(config, drift=math.radians(drift))
    return replace(config, target_motion=MotionModel.still()) if given.get("static") else config


def calibrated(perception: str, calibration: Path | None, detector: str | None, force: bool) -> Calibrated | None:
    """The content of ``--calibration`` and ``--detector``, or None if neither is given.

    Raises `UsageError` for a calibration of another perception, unless `force`.
    """
    from eagor.evidence.detector import parse_model
    from eagor.perception.calibrated import Calibrated, read_calibrated

    found = None if calibration is None else read_calibrated(calibration)
    if found is not None and not found.fits(perception):
        if not force:
            raise UsageError(
                f"--calibration {calibration} was fitted for the perception {found.perception!r}, not for "
                f"{perception!r}; wanted one for this perception (eagor calibrate), none, or --force"
            )
        warning(f"{calibration} was fitted for {found.perception!r}, not for {perception!r}")
    if detector is None:
        return found
    try:
        model = parse_model(detector, found.detector if found else None)
    except EagorError as error:
        raise UsageError(f"--detector {detector}: {error}") from error
    return replace(found or Calibrated(perception, None), detector=model)


def mask_of(path: Path | None) -> BodyMask | None:
    """``--mask``. Raises `ImageError`."""
    from eagor.perception.partial import read_mask

    return None if path is None else read_mask(path)


def lens_of(options: Lens, info: str | None = None) -> dict[str, Any]:
    """What took the pictures, as `eagor.open_source` takes it; `info`: the topic of a CameraInfo. Raises `EagorError`.

    Only one of the options may tell the lens.
    """
    from eagor.sources.intrinsics import camera_of
    from eagor.sources.rigs import read_rig

    rig, hfov, path, eyes = options.rig, options.hfov, options.camera, options.eyes
    if rig is not None and not (hfov is None and path is None and eyes is None):
        raise UsageError(f"--rig {rig} has the lenses of its pictures; leave out --hfov, --camera and --eyes")
    if info is not None and (others := [each for each in (rig, path, hfov) if each is not None]):
        both = f"--camera-info {info} and {others[0]}"
        raise UsageError(f"{both}: both tell the lens of the pictures; wanted one of them")
    return {"camera": camera_of(hfov, path, eyes), "rig": None if rig is None else read_rig(rig)}


def warn_of_detector(detector: str | None, looks: Sequence[Evidence]) -> None:
    """Warn if ``--detector`` has no effect because all looks are response maps."""
    if detector is not None and looks and all(evidence.detections is None for evidence in looks):
        warning(f"--detector {detector} is for detections, and this perception gives response maps: it has no effect")


def say_of_replay(perception: Perception, query: str, looks: int) -> None:
    """Say, of a replay, at the end, after so many `looks` of it: the lines used, and its labels."""
    from eagor.perception.replay import ReplayPerception

    if isinstance(perception, ReplayPerception) and (said := perception.used(query, looks)) is not None:
        log(said)
