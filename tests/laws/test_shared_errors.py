"""What all looks share, no number of them averages out: boxes beside the thing, clocks, mounts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import directions

from eagor._values import altered
from eagor.belief.field import Patch, blurred
from eagor.evidence import DetectorModel, Evidence
from eagor.sphere import angular_distance, azimuth_elevation, direction, unit, world_R_body
from eagor.tracking import DirectionTracker, MotionModel, TrackerConfig

STILL = TrackerConfig(target_motion=MotionModel.still(), clock_error=0.0)
CONE = math.sqrt(2 * math.log(10))  # standard deviations that hold 90 % in the plane
SURE = {"detection_probability": 0.9, "false_alarms_per_look": 0.01, "look_alikes": 0}


def model(offset_deg=0.7, spread_deg=2.0, **more):
    return DetectorModel(offset=math.radians(offset_deg), spread=math.radians(spread_deg), **{**SURE, **more})


def after(looks, how, config=STILL, rate=0.0, where=(1.0, 0.0, 0.0), step=0.05):
    """The answer after so many looks at one place of the world, while the camera turns at `rate` radians a second."""
    tracker = DirectionTracker(config)
    for count in range(looks):
        pose = world_R_body(rate * count * step)
        tracker.add_pose(count * step, pose)
        tracker.observe(Evidence.from_points([np.array(where) @ pose], detector=how, stamp=count * step))
    return tracker.estimate((looks - 1) * step)


@given(st.floats(0.3, 4.0), directions())
@settings(max_examples=6)
def test_equal_looks_saturate_at_the_offset(offset, where):
    cones = [after(looks, model(offset), where=where).credible_angle for looks in (30, 100, 300)]
    assert cones == sorted(cones, reverse=True)
    assert math.degrees(cones[-1]) == pytest.approx(CONE * offset, rel=0.12)


def test_without_an_offset_looks_narrow_the_answer_without_end():
    """Those that agree so well are sharper than stated: by half, the least that is considered."""
    cones = [after(looks, model(0.0)).credible_angle for looks in (4, 16, 64)]
    for looks, cone in zip((4, 16, 64), cones, strict=True):
        assert 0.4 < cone / (CONE * math.radians(2) / math.sqrt(looks)) < 1.1


def test_a_late_clock_counts_by_the_turning_rate():
    """At 50 degrees a second 20 ms are one degree; a camera that stands still owes nothing to its clock."""
    late = TrackerConfig(target_motion=MotionModel.still(), clock_error=0.02)
    turning = after(300, model(0.0, 0.5), late, math.radians(50))
    assert math.degrees(turning.credible_angle) == pytest.approx(CONE, rel=0.12)
    standing = after(300, model(0.0, 0.5), late)
    assert math.degrees(standing.credible_angle) < 0.2


def test_the_error_of_the_mount_and_that_of_boxes_add_by_their_squares():
    off = TrackerConfig(target_motion=MotionModel.still(), clock_error=0.0, pose_error=math.radians(0.8))
    assert math.degrees(after(300, model(0.6), off).credible_angle) == pytest.approx(CONE, rel=0.12)


def walked(offset_deg, looks=60, way=2.0, thing=(0.0, 3.0, 0.0)):
    tracker = DirectionTracker(STILL)
    for count in range(looks):
        position = np.array([way * (count / (looks - 1) - 0.5), 0.0, 0.0])
        tracker.add_pose(0.1 * count, np.eye(3), position)
        toward = unit(np.array(thing) - position)
        how = model(offset_deg, 1.0, kept_within=None)
        tracker.observe(Evidence.from_points([toward], detector=how, stamp=0.1 * count))
    return tracker.estimate(0.1 * (looks - 1))


def test_the_distance_has_the_offset_over_the_parallax():
    """Bearings that are all off by one angle meet at another distance: by that angle over how far they were apart."""
    plain, off = walked(0.0), walked(2.0)
    assert off.distance
    assert off.distance_spread
    assert plain.distance_spread
    across = 2.0 / math.sqrt(12) / off.distance  # the deviation of a way of 2 m, as seen from the thing
    assert off.distance_spread**2 == pytest.approx(plain.distance_spread**2 + (math.radians(2) / across) ** 2, rel=0.15)


# --- a second detection that agrees ----------------------------------------------------------------------------------


@given(st.floats(0.0, 8.0))
@settings(max_examples=15)
def test_a_second_point_that_agrees_never_speaks_against_the_thing(apart):
    one = [direction(0.3, 0.1)]
    two = [*one, direction(0.3 + math.radians(apart), 0.1)]
    single, double = (tracked(points).presence for points in (one, two))
    assert double >= single - 1e-9
    assert tracked([*two, two[-1]]).presence >= double - 0.02


def tracked(points):
    tracker = DirectionTracker()
    tracker.observe(Evidence.from_points(points, stamp=0.0))
    return tracker.estimate(0.0)


def test_points_that_disagree_are_signs_of_false_alarms():
    assert tracked([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]]).presence < tracked([[1, 0, 0]]).presence + 0.1


# --- the answer is the highest point ----------------------------------------------------------------------------------


@given(st.integers(0, 1000))
@settings(max_examples=10)
def test_the_direction_is_the_highest_point_of_the_density_about_it(seed):
    rng, tracker = np.random.default_rng(seed), DirectionTracker()
    place, looks = rng.uniform(-1, 1, 2), int(rng.integers(1, 6))
    for stamp in range(looks):
        points = [direction(*(place + 0.05 * rng.standard_normal(2)))]
        tracker.observe(Evidence.from_points(points, stamp=float(stamp)))
    estimate = tracker.estimate(looks - 1.0)
    azimuth, elevation = azimuth_elevation(estimate.direction)
    steps = np.radians(np.linspace(-2, 2, 81))
    around = direction(azimuth + steps[:, None], elevation + steps[None, :])
    best = around.reshape(-1, 3)[int(estimate.log_density(around).argmax())]
    assert math.degrees(angular_distance(best, estimate.direction)) < 0.1


# --- a convolution on a patch -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [1e-5, 0.1, 0.5, 2.0])
@pytest.mark.parametrize("bend", [0.0, 3.0, 5.0])
def test_a_blurred_peak_has_the_sum_of_the_variances(width, bend):
    """Also where the outer nodes of a patch lie farther apart than the blur is wide."""
    width, blur, bend = math.radians(width), math.radians(0.7), np.full(2, max(bend, 1e-6))
    half = np.full(2, max(8 * width, math.radians(10) if bend[0] > 2 else 0.0))
    blank = Patch(np.eye(3), half, np.zeros((23, 23)), bend)
    apart = angular_distance(blank.directions, np.array([1.0, 0.0, 0.0]))
    found = blurred(blank.like(-0.5 * (apart / width) ** 2), blur, 4.0)
    mass = np.exp(found.values - found.values.max()) * found.weights
    apart = angular_distance(found.directions, np.array([1.0, 0.0, 0.0]))
    expected = math.hypot(width, blur)
    near = apart < 6 * expected
    assert math.sqrt(float(np.sum((mass * apart**2)[near]) / mass[near].sum() / 2)) == pytest.approx(expected, rel=0.2)


def test_a_width_that_looks_have_ruled_out_may_come_back_where_the_target_moves():
    """Thousands of looks leave nothing to the wide scale; if the target moves after all, that alone may be left."""
    tracker = DirectionTracker(TrackerConfig())
    for count in range(4):
        seen = Evidence.from_points(np.array([[1.0, 0.0, 0.0]]), scores=np.array([0.8]), stamp=0.05 * count)
        tracker.observe(seen)
    standing = tracker.estimate(0.2).hypotheses.standing.detecting()
    scales = np.arange(len(standing.spread.scales))
    assert len(scales) > 1
    windows = tuple(one.like(one.values + np.where(scales, -1e4, 1e2)[:, None, None, None]) for one in standing.windows)
    gone = replace(standing.spread, weights=np.eye(len(scales))[0])
    found = altered(standing, windows=windows, spread=gone).judged(0.0, np.eye(len(scales))[-1])
    assert found.spread.weights == pytest.approx(1)
