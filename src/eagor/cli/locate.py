"""``eagor locate``: one panorama, one look, one answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor.cli import terminal
from eagor.cli.looking import (
    check_not_read,
    checked_frame,
    checked_picture,
    checked_query,
    closing,
    first_stamp,
    keep_picture,
    make_perception,
    perception_for,
    read_frame,
    say_of_video,
    tracker_config,
    warn_of_detector,
)
from eagor.cli.options import Locate
from eagor.cli.steps import LEAST_ROWS, is_video
from eagor.cli.stitched import LensPictures, film_of
from eagor.cli.tables import table
from eagor.cli.unseen import Unseen
from eagor.drawing.words import STATUS, answer_in_words, distance_in_words, in_words, signed
from eagor.evidence import Evidence
from eagor.media.panorama import PanoramaFile
from eagor.perception import Perception, rows_of, short_name
from eagor.perception.replay import look
from eagor.sphere import azimuth_elevation
from eagor.tracking.estimate import Estimate, Mode
from eagor.tracking.tracker import DirectionTracker

NEAR = 15  # degrees: the error that still leads a person to the object


def locate(options: Locate) -> int:
    """Run the command; returns its exit code."""
    query = checked_query(options.query)
    spec = perception_for(query, options.perception)
    if options.modes < 1:
        raise terminal.UsageError(f"--modes {options.modes}; wanted 1 or more")
    check_not_read(options.picture, "--picture", [options.panorama])
    check_not_read(options.out, "--out", [options.panorama])
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force)
    config = replace(config, floor_height=_checked_floor(options.floor))
    if options.picture is not None:
        checked_picture(options.picture)
    with table(options.out) if options.out is not None else nullcontext() as write:
        perception = make_perception(spec)
        stamp = first_stamp(perception, query) if options.stamp is None else options.stamp
        frame = _frame(options, perception)
        tracker = DirectionTracker(config)
        looks = look(perception, frame.panorama, query, stamp, frame.level_R_body)
        looks = Unseen(options.mask).covered(looks, frame)
        warn_of_detector(options.detector, looks)
        if options.floor is not None:  # the camera is where heights are counted from
            for at in sorted({_stamp(evidence) for evidence in looks}):
                tracker.add_pose(at, np.eye(3), np.zeros(3))
        for evidence in looks:
            tracker.observe(evidence)
        now = max(_stamp(evidence) for evidence in looks)
        estimate = tracker.estimate(now)
        if options.picture is not None:
            _draw(options, options.picture, frame.panorama, estimate)
        found = _as_json(options, spec, estimate, now)
        if write is not None:
            write(found)
    if (said := closing(perception, query, len(looks))) is not None:
        terminal.log(said)
    if options.json:
        terminal.emit(found | _sources(looks))
    else:
        _print(options, spec, estimate)
    return terminal.OK


def _frame(options: Locate, perception: Perception) -> PanoramaFile:
    """The photograph, or the frame of a video at ``--stamp`` seconds."""
    start, rows = options.stamp or 0.0, max(rows_of(perception), LEAST_ROWS)
    if not is_video([options.panorama]):
        if options.rig is not None:
            return LensPictures(options.rig).read(options.panorama)
        return read_frame(options.panorama, options.force)
    from eagor.media.video import Video

    if options.rig is None:
        video = Video(options.panorama, start=start, rows=rows)
    else:
        video = film_of([options.panorama], options.rig, start=start, rows=rows)
    say_of_video(options.panorama.name, video.facts, video.duration)
    first = next(iter(video))
    found = PanoramaFile(first.panorama, video.unseen, video.level_R_body)
    return checked_frame(found, first.name, options.force)


def _stamp(evidence: Evidence) -> float:
    return float(evidence.stamp or 0.0)


def _checked_floor(floor: float | None) -> float | None:
    """``--floor``, if it is below the camera; else raises `UsageError`."""
    if floor is not None and not (math.isfinite(floor) and floor < 0):
        raise terminal.UsageError(
            f"--floor {floor:g}: the camera of locate is at height 0; wanted a floor below it, such as -1.3"
        )
    return floor


def _as_json(options: Locate, spec: str, estimate: Estimate, stamp: float) -> dict[str, Any]:
    known = estimate.direction is not None
    distance, spread = _distance(estimate)
    return {
        "query": options.query,
        "perception": spec,
        "frame": options.panorama.name,
        "stamp": stamp,
        "azimuth_deg": degrees(estimate.azimuth),
        "elevation_deg": degrees(estimate.elevation),
        "credible_angle_deg": degrees(estimate.credible_angle) if known else None,
        "presence": round(estimate.presence, 6),
        "distance_m": None if distance is None else round(distance, 4),
        "distance_spread": None if spread is None else round(spread, 4),
        f"within_{NEAR}_deg": round(estimate.within(math.radians(NEAR)), 6) if known else None,
        "status": estimate.status,
        "modes": [mode_as_json(mode) for mode in estimate.modes[: options.modes]],
    }


def _distance(estimate: Estimate) -> tuple[float | None, float | None]:
    """Metres and the standard deviation of its logarithm; None without ``--floor`` or while searching."""
    if estimate.status == "searching":
        return None, None
    return estimate.distance, estimate.distance_spread


def _sources(looks: Sequence[Evidence]) -> dict[str, Any]:
    """The source that the looks name (model, pixels, tokens, milliseconds), if any."""
    source = next((look.source for look in looks if look.source is not None), None)
    return {} if source is None else {"source": dict(source)}


def mode_as_json(mode: Mode) -> dict[str, float | None]:
    """One candidate for ``--json``."""
    return as_angles(mode.direction) | {"weight": round(mode.weight, 6)}


def as_angles(direction: np.ndarray | None) -> dict[str, float | None]:
    """A direction ``(3,)`` for ``--json``; null for None."""
    azimuth, elevation = (None, None) if direction is None else map(float, azimuth_elevation(direction))
    return {"azimuth_deg": degrees(azimuth), "elevation_deg": degrees(elevation)}


def degrees(angle: float | None) -> float | None:
    """An angle (radians) for ``--json``."""
    return None if angle is None else round(math.degrees(angle), 4)


def _print(options: Locate, spec: str, estimate: Estimate) -> None:
    print(f"{options.query}, in {options.panorama.name}, as {short_name(spec)} sees it")
    print(f"  status          {estimate.status}: {STATUS[estimate.status]}")
    print(f"  direction       {answer_in_words(estimate)}")
    if estimate.direction is not None:
        _print_answer(estimate)
    if options.floor is not None:
        print(f"  distance        {distance_in_words(*_distance(estimate))} (90 %, if it stands on the floor)")
    print(f"  presence        {100 * estimate.presence:.0f} %")
    if estimate.direction is not None:
        near = f"{100 * estimate.within(math.radians(NEAR)):.0f} %"
        print(f"  how sure        {near} (that it is here, and within {NEAR} degrees of that direction)")
        _print_modes(estimate, options.modes)


def _print_answer(estimate: Estimate) -> None:
    print(f"  azimuth         {signed(estimate.azimuth)} deg (positive to the left)")
    print(f"  elevation       {signed(estimate.elevation)} deg")
    cone = f"{math.degrees(estimate.credible_angle):.1f} deg"
    print(f"  credible angle  {cone} (a cone about it that holds 90 %; looks that agree narrow it)")


def _print_modes(estimate: Estimate, count: int) -> None:
    """Print the candidates and the remaining probability."""
    shown = estimate.modes[:count]
    print("  candidates      azimuth elevation  weight (probability that it is thereabouts, if it is here)")
    for mode in shown:
        angles, words = f"{signed(mode.azimuth):>7} {signed(mode.elevation):>9}", in_words(mode.azimuth, mode.elevation)
        print(f"                  {angles} {100 * mode.weight:5.0f} %  {words}")
    elsewhere = max(0.0, 1 - sum(mode.weight for mode in shown))
    print(f"                  {'':17} {100 * elsewhere:5.0f} %  elsewhere")


def _draw(options: Locate, path: Path, panorama: np.ndarray, estimate: Estimate) -> None:
    from eagor.drawing import draw_belief

    title = f"“{options.query}”: {answer_in_words(estimate)} ({estimate.status})"
    modes = [mode.direction for mode in estimate.modes[: options.modes]]
    keep_picture(draw_belief(panorama, estimate, modes=modes, title=title), path)
