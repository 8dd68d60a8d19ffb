"""``eagor locate``: one panorama, one look, one answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eagor.belief import Belief
from eagor.cli import terminal
from eagor.cli.looking import (
    check_not_read,
    checked_picture,
    checked_query,
    first_stamp,
    keep_picture,
    look,
    make_perception,
    read_frame,
    tracker_config,
)
from eagor.cli.options import Locate
from eagor.cli.words import STATUS, in_words, signed
from eagor.estimate import Estimate
from eagor.evidence import Evidence
from eagor.perception import short_name
from eagor.sphere import azimuth_elevation
from eagor.tracker import DirectionTracker

NEAR = 15  # degrees: how far beside it the answer may lie for somebody who is to find the thing


def locate(options: Locate) -> int:
    """Run the command; returns its exit code."""
    query = checked_query(options.query)
    if options.modes < 1:
        raise terminal.UsageError(f"--modes {options.modes}; wanted 1 or more")
    check_not_read(options.picture, "--picture", [options.panorama])
    config = tracker_config(options.degree, options.calibration)
    if options.picture is not None:
        checked_picture(options.picture)
    perception = make_perception(options.perception)
    stamp = first_stamp(perception, query) if options.stamp is None else options.stamp
    panorama = read_frame(options.panorama, options.force)
    tracker = DirectionTracker(config)
    looks = look(perception, panorama, query, stamp)
    for evidence in looks:
        tracker.observe(evidence)
    now = max(float(evidence.stamp or 0.0) for evidence in looks)
    estimate, belief = tracker.estimate(now), tracker.belief(now)
    modes = _modes(belief, options.modes)
    if options.picture is not None:
        _draw(options, options.picture, panorama, belief, estimate, [d for d, _ in modes])
    if options.json:
        terminal.emit(_as_json(options, estimate, modes) | _sources(looks))
    else:
        _print(options, estimate, modes)
    return terminal.OK


def _modes(belief: Belief, count: int) -> list[tuple[np.ndarray, float]]:
    directions, weights = belief.modes(count)
    return [(d, float(w)) for d, w in zip(directions, weights, strict=True)]


def _as_json(options: Locate, estimate: Estimate, modes: list[tuple[np.ndarray, float]]) -> dict[str, Any]:
    return {
        "query": options.query,
        "perception": options.perception,
        "azimuth_deg": degrees(estimate.azimuth),
        "elevation_deg": degrees(estimate.elevation),
        "credible_angle_deg": degrees(estimate.credible_angle),
        "presence": round(estimate.presence, 6),
        f"within_{NEAR}_deg": round(estimate.within(math.radians(NEAR)), 6),
        "status": estimate.status,
        "modes": [mode_as_json(direction, weight) for direction, weight in modes],
    }


def _sources(looks: Sequence[Evidence]) -> dict[str, Any]:
    """What the looks say about what produced them (model, pixels, tokens, milliseconds), where they do."""
    source = next((look.source for look in looks if look.source is not None), None)
    return {} if source is None else {"source": dict(source)}


def mode_as_json(direction: np.ndarray, weight: float) -> dict[str, float]:
    """One mode for ``--json``."""
    return as_angles(direction) | {"weight": round(weight, 6)}


def as_angles(direction: np.ndarray) -> dict[str, float]:
    """A direction ``(3,)`` for ``--json``."""
    azimuth, elevation = azimuth_elevation(direction)
    return {"azimuth_deg": degrees(float(azimuth)), "elevation_deg": degrees(float(elevation))}


def degrees(angle: float) -> float:
    """An angle (radians) for ``--json``."""
    return round(math.degrees(angle), 4)


def _print(options: Locate, estimate: Estimate, modes: list[tuple[np.ndarray, float]]) -> None:
    print(f"{options.query}, in {options.panorama.name}, as {short_name(options.perception)} sees it")
    print(f"  status          {estimate.status}: {STATUS[estimate.status]}")
    print(f"  direction       {in_words(estimate.azimuth, estimate.elevation)}")
    print(f"  azimuth         {signed(estimate.azimuth)} deg (positive to the left)")
    print(f"  elevation       {signed(estimate.elevation)} deg")
    cone = f"{math.degrees(estimate.credible_angle):.1f} deg"
    print(f"  credible angle  {cone} (a cone about it that holds 90 %; looks that agree narrow it)")
    print(f"  presence        {100 * estimate.presence:.0f} %")
    near = f"{100 * estimate.within(math.radians(NEAR)):.0f} %"
    print(f"  how sure        {near} (that it is here, and within {NEAR} degrees of that direction)")
    print("  modes           azimuth elevation  weight (a share of what stands out)")
    for direction, weight in modes:
        azimuth, elevation = (float(a) for a in azimuth_elevation(direction))
        words = in_words(azimuth, elevation)
        print(f"                  {signed(azimuth):>7} {signed(elevation):>9} {100 * weight:5.0f} %  {words}")


def _draw(
    options: Locate, path: Path, panorama: np.ndarray, belief: Belief, estimate: Estimate, modes: list[np.ndarray]
) -> None:
    from eagor.drawing import draw_belief

    title = f"“{options.query}”: {in_words(estimate.azimuth, estimate.elevation)} ({estimate.status})"
    picture = draw_belief(panorama, belief, estimate, modes=modes, title=title)
    keep_picture(picture, path)
