"""``eagor locate``: one panorama, one look, one answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eagor.cli import terminal
from eagor.cli.looking import (
    check_not_read,
    checked_picture,
    checked_query,
    first_stamp,
    keep_picture,
    look,
    make_perception,
    perception_for,
    read_frame,
    tracker_config,
    warn_of_detector,
)
from eagor.cli.options import Locate
from eagor.cli.words import STATUS, answer_in_words, in_words, signed
from eagor.evidence import Evidence
from eagor.perception import short_name
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
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force)
    if options.picture is not None:
        checked_picture(options.picture)
    perception = make_perception(spec)
    stamp = first_stamp(perception, query) if options.stamp is None else options.stamp
    panorama = read_frame(options.panorama, options.force)
    tracker = DirectionTracker(config)
    looks = look(perception, panorama, query, stamp)
    warn_of_detector(options.detector, looks)
    for evidence in looks:
        tracker.observe(evidence)
    now = max(float(evidence.stamp or 0.0) for evidence in looks)
    estimate = tracker.estimate(now)
    if options.picture is not None:
        _draw(options, options.picture, panorama, estimate)
    if options.json:
        terminal.emit(_as_json(options, spec, estimate) | _sources(looks))
    else:
        _print(options, spec, estimate)
    return terminal.OK


def _as_json(options: Locate, spec: str, estimate: Estimate) -> dict[str, Any]:
    known = estimate.direction is not None
    return {
        "query": options.query,
        "perception": spec,
        "azimuth_deg": degrees(estimate.azimuth),
        "elevation_deg": degrees(estimate.elevation),
        "credible_angle_deg": degrees(estimate.credible_angle) if known else None,
        "presence": round(estimate.presence, 6),
        f"within_{NEAR}_deg": round(estimate.within(math.radians(NEAR)), 6) if known else None,
        "status": estimate.status,
        "held": estimate.held,
        "modes": [mode_as_json(mode) for mode in estimate.modes[: options.modes]],
    }


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
    print(f"  presence        {100 * estimate.presence:.0f} %")
    if estimate.direction is not None:
        near = f"{100 * estimate.within(math.radians(NEAR)):.0f} %"
        print(f"  how sure        {near} (that it is here, and within {NEAR} degrees of that direction)")
        _print_modes(estimate, options.modes)


def _print_answer(estimate: Estimate) -> None:
    if estimate.held:
        print("  held            an older answer, although another candidate is likelier now")
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
