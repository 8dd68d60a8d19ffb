"""What people get wrong in a first program: each is refused where it is made, with what came and what was wanted."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import eagor
from eagor.errors import EagorError
from eagor.perception.colour import ColourPerception
from eagor.perception.views import Detector

GRID, WIDE = eagor.ErpGrid(64, 128), eagor.ErpGrid(512, 1024)
VIEW = eagor.PerspectiveGrid(48, 64, math.radians(70))
BOX = [[10.0, 10.0, 20.0, 20.0]]
HALF = np.zeros((24, 32, 3), np.uint8)
Evidence = eagor.Evidence


def seen(stamp: float = 0.0) -> Evidence:
    return Evidence.from_points([[0, 1, 0]], stamp=stamp)


def posed(pose: np.ndarray) -> None:
    eagor.DirectionTracker().add_pose(0, pose)


def estimate() -> eagor.Estimate:
    tracker = eagor.DirectionTracker()
    tracker.observe(seen())
    return tracker.estimate(0.0)


def found(*box: float) -> Callable[[np.ndarray, str], Any]:
    return lambda picture, query: ([box], [0.9])


MISTAKES: dict[str, tuple[Callable[[], Any], str]] = {
    "no evidence": (
        lambda: eagor.DirectionTracker().observe(np.zeros((4, 8, 3))),  # type: ignore[arg-type]
        r"observe\(\) got an array of shape \(4, 8, 3\); wanted eagor.Evidence",
    ),
    "a stamp in words": (lambda: eagor.DirectionTracker().add_pose("now", np.eye(3)), "wanted the time in seconds"),  # type: ignore[arg-type]
    "a matrix of 4 x 4": (lambda: posed(np.eye(4)), r"M\[:3, :3\], and the position M\[:3, 3\] by itself"),
    "a quaternion": (lambda: posed(np.ones(4)), r"shape \(4,\)\. Quaternions"),
    "several poses": (
        lambda: eagor.DirectionTracker().add_pose(0, np.eye(3)[None]),
        r"\(1, 3, 3\); wanted one rotation",
    ),
    "half precision": (
        lambda: eagor.DirectionTracker().add_pose(0, np.diag([1, -1, 1]).astype(np.float16)),
        "reflection",
    ),
    "a batch": (
        lambda: eagor.DirectionTracker().observe(Evidence.from_response(np.zeros((1, 64, 128)), GRID, stamp=0)),
        "batch of shape",
    ),
    "settings in a dict": (lambda: eagor.DirectionTracker({"degree": 7}), "config is dict"),  # type: ignore[arg-type]
    "fractions": (lambda: Evidence.from_boxes([[0.1, 0.1, 0.3, 0.4]], WIDE), "not 0 to 1"),
    "pixels of a larger picture": (
        lambda: Evidence.from_boxes([[1300, 200, 1400, 250]], WIDE),
        "inside the 1024 x 512",
    ),
    "left of the picture": (lambda: Evidence.from_boxes([[-90, 200, -10, 250]], WIDE), "inside the 1024 x 512"),
    "ragged boxes": (lambda: Evidence.from_boxes([[1, 2], [3]], GRID), "not a table of numbers"),
    "words for scores": (lambda: Evidence.from_boxes(BOX, GRID, scores=["a"]), "scores are no numbers"),
    "no grid": (lambda: Evidence.from_boxes(BOX, None), "grid is None"),  # type: ignore[arg-type]
    "a shape for a grid": (
        lambda: Evidence.from_response(np.zeros((64, 128)), (64, 128)),  # type: ignore[arg-type]
        r"grid is \(64, 128\)",
    ),
    "calibration for a detector": (
        lambda: Evidence.from_boxes(BOX, GRID, detector=eagor.Calibration()),  # type: ignore[arg-type]
        "detector is Calibration; wanted eagor.DetectorModel",
    ),
    "detector for a calibration": (
        lambda: Evidence.from_response(np.zeros((64, 128)), GRID, calibration=eagor.DetectorModel()),  # type: ignore[arg-type]
        "calibration is DetectorModel; wanted eagor.Calibration",
    ),
    "two concentrations": (lambda: Evidence.from_points([[1, 0, 0]], concentration=[1, 2]), "one positive number"),
    "behind the camera": (lambda: Evidence.from_points([[-1, 0, 0]], grid=VIEW), "not in the view of 70 degrees"),
    "a mirrored pose": (lambda: estimate().turned(1.0, np.diag([1, -1, 1.0])), "reflection"),
    "back in time": (lambda: estimate().turned(-1.0, np.eye(3)), "wanted that time or later"),
    "degrees": (lambda: estimate().within(30), "wanted radians"),
    "percent": (lambda: estimate().region(90), "probability"),
    "no unit vector": (lambda: estimate().log_density([3.0, 0, 0]), "not unit vectors"),  # type: ignore[arg-type]
    "NaN": (lambda: estimate().mass_above([math.nan, 0, 0]), "not unit vectors"),  # type: ignore[arg-type]
    "half the picture": (lambda: Detector(found(1, 1, 9, 9)).view(HALF, VIEW, "cup"), "its grid is for 64 x 48"),
    "the same, by colour": (lambda: ColourPerception().view(HALF, VIEW, "red"), "its grid is for 64 x 48"),
    "a view without a grid": (lambda: Detector(found(1, 1, 9, 9)).view(HALF, None, "cup"), "PerspectiveGrid"),  # type: ignore[arg-type]
    "boxes of a larger picture": (
        lambda: Detector(found(90, 60, 120, 90)).view(HALF, VIEW.resized(24, 32), "cup"),
        "scale",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_where_it_is_made(name: str) -> None:
    make, text = MISTAKES[name]
    with pytest.raises(EagorError, match=text):
        make()


def test_rounding_of_a_stamp_is_no_mistake() -> None:
    tracker = eagor.DirectionTracker()
    tracker.observe(seen(3 * 0.1))  # 0.30000000000000004
    assert tracker.estimate(0.3).stamp == 3 * 0.1


def test_a_distance_is_not_surer_than_a_shell() -> None:
    belief = eagor.RangedBelief.uniform(7, eagor.log_ranges())
    assert belief.distance_spread() == pytest.approx(math.log(12 / 0.5) / math.sqrt(12), rel=0.1)
    sharp = eagor.RangedBelief(np.where(np.arange(14)[:, None] == 5, 99.0, 0.0) * np.eye(1, 64), belief.ranges)
    assert sharp.distance_spread() == pytest.approx(math.log(24) / 13 / math.sqrt(12), rel=1e-3)
