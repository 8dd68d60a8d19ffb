"""From command line arguments to panoramas and evidence."""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from eagor._files import written
from eagor.cli.terminal import UsageError, log, warning
from eagor.errors import EagorError, ImageError, QueryError
from eagor.evidence import Evidence
from eagor.evidence.detector import parse_model
from eagor.perception import Perception, load, short_name
from eagor.perception.calibrated import Calibrated, read_calibrated
from eagor.perception.colour import colour_in
from eagor.perception.replay import ReplayPerception
from eagor.tracking.config import TrackerConfig

if TYPE_CHECKING:
    from eagor.media.panorama import PanoramaFile

MAX_DEGREE = 63
LEAST_ROWS = 8


def checked_degree(degree: int) -> int:
    """`degree`, if it is valid; else raises `UsageError`, as do the other checks here."""
    if not 1 <= degree <= MAX_DEGREE:
        raise UsageError(f"--degree {degree}; wanted 1 to {MAX_DEGREE} (15 resolves about 12 degrees)")
    return degree


def checked_rows(rows: int | None) -> int | None:
    """`rows` of rendered panoramas, if they are enough; None is the perception's own number."""
    if rows is not None and rows < LEAST_ROWS:
        raise UsageError(f"--rows {rows}; wanted {LEAST_ROWS} or more")
    return rows


def check_looks(perception: str) -> None:
    """Raise `UsageError` if `perception` is a replay, which knows only its own frames."""
    if short_name(perception) == "replay":
        raise UsageError(
            f"--perception {perception} belongs to other frames than the ones rendered here; run your detector as a "
            "perception. To fit a replay on looks with known truth: eagor calibrate --replay FILE --truth FILE"
        )


def checked_query(query: str) -> str:
    """`query`, if it contains a word; else raises `QueryError`."""
    if not re.search(r"\w", query):
        raise QueryError(f"the query {query!r} has no words; say what to look for, such as 'red chair'")
    return query


def checked_picture(path: Path) -> Path:
    """`path`, if it has a picture's suffix and its folder can be written to."""
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg", ".webp"):
        raise UsageError(f"--picture {path}: wanted a file name that ends in .png, .jpg or .webp")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"--picture {path}: there is no folder {path.absolute().parent}; make it first")
    return checked_out(path, "--picture")


def checked_out(path: Path, option: str = "--out") -> Path:
    """`path` of an output file, if it can probably be written; checked before long work."""
    there = _nearest(path)
    if path.is_dir() or not (there.is_dir() or there == path.absolute()) or not os.access(there, os.W_OK):
        raise UsageError(f"{option} {path} cannot be written; name a file in a folder that can be written to")
    return path


def checked_folder(path: Path, option: str = "--out") -> Path:
    """`path` of an output folder, if it can probably be written to; checked before long work, creates nothing."""
    there = _nearest(path)
    if not there.is_dir() or not os.access(there, os.W_OK):
        why = "cannot be written to" if there.is_dir() else "is not a folder"
        raise UsageError(f"{option} {path}: cannot be made a folder to write to ({there} {why}); name another")
    return path


def check_not_read(path: Path | None, option: str, inputs: Sequence[Path]) -> None:
    """Raise `UsageError` if the output `path` is one of the `inputs`, which would be overwritten."""
    if path is not None and os.path.realpath(path) in map(os.path.realpath, inputs):
        raise UsageError(f"{option} {path} is an input; name another place to write to")


def _nearest(path: Path) -> Path:
    """`path` itself, or its nearest parent that exists."""
    place = path.absolute()
    return next(place for place in (place, *place.parents) if os.path.exists(place))


def keep_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture atomically, in the format of its name. Raises `StorageError`."""
    buffer = io.BytesIO()
    picture.save(buffer, Image.registered_extensions()[path.suffix.lower()])
    written(path, buffer.getvalue())


def perception_for(query: str, spec: str | None) -> str:
    """The perception to use: ``--perception``, or the one that suits the query.

    By default a query that names a colour is answered by ``colour``, any other by the detector ``coco``. Raises
    `QueryError` if that is not installed.
    """
    if spec is not None:
        return spec
    if colour_in(query) is not None:
        return "colour"
    from eagor.perception.coco import COCO

    if COCO.path.is_file():
        return "coco"
    from eagor.cli.models import how_to_find

    raise QueryError(how_to_find(query))


def make_perception(spec: str) -> Perception:
    """The perception that ``--perception`` names."""
    if spec.partition(":")[0] == "replay" and not spec.partition(":")[2]:
        raise UsageError("--perception replay needs the file that the detector wrote: replay:FILE.jsonl")
    return load(spec)


def tracker_config(
    degree: int, perception: str, calibration: Path | None = None, detector: str | None = None, force: bool = False
) -> TrackerConfig:
    """The tracker's configuration for ``--degree`` and the result of `calibrated`."""
    config = TrackerConfig(degree=checked_degree(degree))
    found = calibrated(perception, calibration, detector, force)
    return config if found is None else config.fitted(found.calibration, found.detector, found.forgetting)


def calibrated(perception: str, calibration: Path | None, detector: str | None, force: bool) -> Calibrated | None:
    """The content of ``--calibration`` and ``--detector``, or None if neither is given.

    Raises `UsageError` for a calibration of another perception, unless `force`.
    """
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


def warn_of_detector(detector: str | None, looks: Sequence[Evidence]) -> None:
    """Warn if ``--detector`` has no effect because all looks are response maps."""
    if detector is not None and looks and all(evidence.detections is None for evidence in looks):
        warning(f"--detector {detector} is for detections, and this perception gives response maps: it has no effect")


def find_frames(places: Sequence[Path]) -> tuple[Path, ...]:
    """The images in `places` (one folder, or image files), sorted by name; numbers in names sort by value."""
    from eagor.media.panorama import in_order, pictures_in

    if len(places) == 1 and os.path.isdir(places[0]):
        return pictures_in(places[0])
    for place in places:  # os.path returns False where Path would raise: a name too long, a closed folder
        if os.path.isdir(place):
            raise UsageError(f"{place} is a folder; give one folder, or only image files")
        if not os.path.exists(place):
            raise ImageError(f"there is no file {place}; give a folder of panoramas, or image files")
    return in_order(places)


def say_of_video(name: str, facts: Sequence[str], duration: float | None) -> None:
    """Say on stderr what a video tells of itself: `facts` (of which the first is its format), seconds."""
    lasting = "" if duration is None else f", {duration:.1f} s"
    log(f"{name}: {facts[0]}{lasting}")
    for fact in facts[1:]:
        log(f"{name}: {fact}")


class ShapeError(ImageError):
    """A picture is not a whole panorama: its aspect ratio is not 2:1."""


def read_frame(path: Path, force: bool = False, said: set[str] | None = None) -> PanoramaFile:
    """The panorama in a file, and what the file says of it; `force` and `said` as for `checked_frame`."""
    from eagor.media.panorama import read_photograph

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = read_photograph(path)
    return checked_frame(found, str(path), force, said)


def checked_frame(frame: PanoramaFile, name: str, force: bool = False, said: set[str] | None = None) -> PanoramaFile:
    """`frame`, if it is a whole panorama; facts about it, and a seam that does not fit, are said.

    `said` remembers, from frame to frame, what has been said: only the first whole frame is judged by its pixels, and
    a wrong shape is mentioned once. Raises `ShapeError` if it is not 2:1, or shows the circles of fisheye lenses; with
    `force` it only warns.
    """
    said = set() if said is None else said
    checked_shape(frame.panorama, name, force, said)
    if "pixels" in said:
        return frame
    from eagor.media.defects import fisheye_circles, problems

    found = problems(frame.panorama)
    if not force and fisheye_circles(frame.panorama):
        raise ShapeError(f"{name}: {found[0]}. To look at it all the same, add --force")
    said.add("pixels")  # not before: who reads a frame again that was refused is told again
    for fact in frame.facts:
        log(f"{name}: {fact}")
    for problem in found:
        warning(f"{name}: {problem}")
    return frame


def checked_shape(panorama: np.ndarray, name: str, force: bool, said: set[str]) -> np.ndarray:
    """`panorama`, if it is 2:1; else raises `ShapeError`, or with `force` warns (unless it is in `said`)."""
    from eagor.media.panorama import is_whole

    if is_whole(panorama):
        return panorama
    height, width = panorama.shape[:2]
    what = f"{name} is {width} x {height}, not 2:1"
    if not force:
        raise ShapeError(
            f"{what}; wanted a whole panorama, twice as wide as high ({2 * height} x {height}). Pad an image that "
            "covers less than the sphere, or accept it with --force (all columns for 360 degrees, all rows for 180)"
        )
    if "shape" not in said:
        said.add("shape")
        warning(f"{what}; accepted, with all columns for 360 degrees and all rows for 180")
    return panorama


def first_stamp(perception: Perception, query: str) -> float:
    """The time of a replay's first record for `query`; 0 for other perceptions."""
    if isinstance(perception, ReplayPerception):
        return next((record.stamp for record in perception.records if record.answers(query)), 0.0)
    return 0.0


def closing(perception: Perception, query: str, looks: int) -> str | None:
    """What to say of a replay at the end, after so many `looks` of it: the lines used, and its labels; else None."""
    return perception.used(query, looks) if isinstance(perception, ReplayPerception) else None


def is_input_fault(error: EagorError) -> bool:
    """Whether every other frame would fail in the same way."""
    return isinstance(error, QueryError)
