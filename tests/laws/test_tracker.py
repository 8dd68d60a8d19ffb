"""Evidence late, early and out of order; poses at any rate; several targets; honest answers."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import estimate_after, points_look, random_directions, rotations

from eagor.belief import Belief
from eagor.belief.density import NEAR
from eagor.errors import EagorError, PoseError, RotationError, TimeError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, PatchGrid, PerspectiveGrid
from eagor.sphere import angular_distance, direction, rotation, unit, world_R_body
from eagor.tracking.config import PARALLAX, AnswerSettings, MotionModel, TrackerConfig
from eagor.tracking.estimate import RIVAL, SURE
from eagor.tracking.tracker import DirectionTracker

GRID = PatchGrid(12, 24)
STILL = MotionModel.still()
FLAT = {"ranges": None, "target_motion": STILL}  # all that happens is adding
PLAIN, MOVING = TrackerConfig(**FLAT), TrackerConfig(ranges=None)
MODEL = DetectorModel(0.7, 0.2, math.radians(8), look_alikes=0)  # looks are independent
ALIKE = DetectorModel(false_alarms_per_look=0.2, spread=math.radians(8), look_alikes=0.7)  # places have habits
FORWARD = np.array([1.0, 0.0, 0.0])
SOME = random_directions(60, 7)


def look(target, stamp, model=MODEL, **more):
    return Evidence.from_points([target], detector=model, stamp=stamp, **more)


def nothing(stamp, model=MODEL):
    return Evidence.from_points(np.zeros((0, 3)), detector=model, stamp=stamp)


def noise(seed, stamp, calibration=None):
    """A response map, a set of detections, or a view of a part."""
    rng = np.random.default_rng(seed)
    if seed % 3 == 0:
        return Evidence.from_response(rng.random(GRID.shape), GRID, calibration, stamp)
    grid = PerspectiveGrid(40, 60, 1.2) if seed % 3 == 1 else None
    seen, model = unit(FORWARD + 0.3 * rng.normal(size=(2, 3))), MODEL if grid else replace(ALIKE, kept_for=1.0)
    return Evidence.from_points(seen, scores=rng.random(2), grid=grid, detector=model, stamp=stamp)


def degrees(a, b):
    return float(np.degrees(angular_distance(a, b)))


def turning(config, stamps, turns, positions=None):
    tracker = DirectionTracker(config)
    for i, stamp in enumerate(stamps):
        tracker.add_pose(stamp, turns[i], None if positions is None else positions[i])
    return tracker


def said(estimate):
    """All that an estimate says, as numbers."""
    held = [estimate.presence, estimate.credible_angle, estimate.moving or 0.0, estimate.distance or 0.0]
    weights = [mode.weight for mode in estimate.modes]
    return np.concatenate([estimate.direction, held, weights, estimate.log_density(SOME)])


# --- what a look adds -------------------------------------------------------------------------------------------------


@given(st.lists(rotations(), min_size=4, max_size=6))
@settings(max_examples=15)
def test_the_published_profile_is_the_published_recursion_step_for_step(turns):
    """c(1) = b(1); c(t) = D(R_t) c(t - 1) + b(t); the spherical mean of each."""
    tracker, coefficients, before = DirectionTracker(TrackerConfig.paper()), None, None
    for step, world_R_now in enumerate(turns):
        response = np.random.default_rng(step).random(GRID.shape)
        b = Evidence.from_response(response, GRID, Calibration.paper()).coefficients(7)
        belief = Belief(b) if before is None else Belief(coefficients).predict(world_R_now.T @ before)
        coefficients = b if before is None else belief.coefficients + b
        before = world_R_now
        tracker.add_pose(float(step), world_R_now)
        tracker.observe(Evidence.from_response(response, GRID, stamp=float(step)))
        estimate = tracker.estimate(float(step))
        held = Belief(estimate.hypotheses.standing.coarse.coefficients).predict(world_R_now.T)
        assert np.allclose(held.coefficients, coefficients, atol=1e-9)
        assert np.allclose(estimate.direction, Belief(coefficients).mean_direction(), atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_looks_that_repeat_each_other_add_up_in_part(count):
    """Of n looks alike, whose errors persist by p, n (1 - p) + p count."""
    calibration, response = Calibration(persistence=0.6), np.random.default_rng(0).random(GRID.shape)
    looks = [Evidence.from_response(response, GRID, calibration, float(t)) for t in range(count)]
    held = estimate_after(looks, PLAIN).hypotheses.standing.coarse.coefficients
    assert np.allclose(held, (0.4 * count + 0.6) * looks[0].coefficients(15), atol=1e-9)


# --- when and from where it was taken ---------------------------------------------------------------------------------

WORLDS = {
    "still, directions only": (FLAT, False),
    "default, directions only": ({}, False),
    "default, walking": ({}, True),
    "drift": ({"drift": 0.02, "ranges": None}, False),
}


@pytest.mark.parametrize("world", WORLDS)
@given(order=st.permutations(range(6)), turns=st.lists(rotations(), min_size=6, max_size=6))
@settings(max_examples=5)
def test_late_equals_on_time_in_any_order(world, order, turns):
    changes, walking = WORLDS[world]
    stamps, config = [0.1 * i for i in range(6)], TrackerConfig(**changes)
    positions = [np.array([0.2 * i, 0.1, 0.0]) if walking else None for i in range(6)]
    on_time = DirectionTracker(config)
    late = turning(config, stamps, turns, positions if walking else None)
    for i, stamp in enumerate(stamps):
        on_time.add_pose(stamp, turns[i], positions[i])
        on_time.observe(noise(i, stamp))
    for i in order:
        late.observe(noise(i, stamps[i]))
        if i % 2:
            late.estimate(stamps[-1])
    now = stamps[-1] + 0.3
    assert np.array_equal(said(on_time.estimate(now)), said(late.estimate(now)))


@given(rotations(), rotations())
@settings(max_examples=20)
def test_evidence_is_placed_by_its_time_of_capture(first, second):
    """A detection straight ahead at t = 0, delivered after the turn, stands where the turn put it."""
    tracker = turning(PLAIN, [0.0, 1.0], [first, second])
    tracker.observe(look(FORWARD, 0.0))
    assert degrees(tracker.estimate(1.0).direction, second.T @ first @ FORWARD) < 0.1


@given(rotations(), rotations())
@settings(max_examples=8)
def test_turning_away_and_back_changes_nothing(first, away):
    tracker = turning(TrackerConfig(ranges=None), [0.0, 0.02], [first, first])
    for t in range(3):
        tracker.observe(noise(t, 0.01 * t))
    before = said(tracker.estimate(0.05))
    tracker.add_pose(0.03, away)
    tracker.add_pose(0.05, first)
    assert np.allclose(said(tracker.estimate(0.05)), before, atol=1e-9)


@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize("changes", [FLAT, {}])
def test_evidence_that_arrives_before_its_pose_is_placed_by_that_pose_afterwards(changes, asked):
    tracker = turning(TrackerConfig(**changes), [0.0], [np.eye(3)])
    tracker.observe(look(FORWARD, 1.0))
    if asked:
        assert degrees(tracker.estimate(1.0).direction, FORWARD) < 0.1, "held at the last pose for now"
    tracker.add_pose(1.0, world_R_body(math.pi / 2))
    tracker.add_pose(2.0, np.eye(3))
    assert degrees(tracker.estimate(2.0).direction, direction(math.pi / 2, 0)) < 0.1


def test_poses_are_interpolated_and_the_last_is_held():
    """Whether the look comes before the pose behind it, or after."""
    tracker = turning(PLAIN, [0.0], [world_R_body(0.0)])
    tracker.observe(look(FORWARD, 0.25))
    tracker.add_pose(1.0, world_R_body(1.0))
    tracker.observe(look(direction(-0.25, 0.0), 0.5))
    assert tracker.estimate(1.0).azimuth == pytest.approx(-0.75, abs=2e-3)
    assert tracker.estimate(9.0).azimuth == pytest.approx(-0.75, abs=2e-3)


def test_a_corrected_pose_of_the_same_time_replaces_the_first():
    tracker = turning(PLAIN, [0.0, 0.0], [np.eye(3), rotation((0, 0, 1), 0.5)])
    tracker.observe(look(FORWARD, 0.0))
    tracker.add_pose(1.0, np.eye(3))
    assert degrees(tracker.estimate(1.0).direction, direction(0.5, 0)) < 0.1


def test_a_tracker_without_poses_stands_still():
    tracker = DirectionTracker()
    tracker.observe(look(direction(1.2, -0.3), 5.0))
    estimate = tracker.estimate(5.0)
    assert estimate.azimuth == pytest.approx(1.2, abs=2e-3)
    assert estimate.elevation == pytest.approx(-0.3, abs=2e-3)
    assert estimate.distance is None


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 1, 0, 2), (2, 3, 1, 0)])
@pytest.mark.parametrize("apart", [0.0, 1e-9, 1e-4])
def test_views_of_one_moment_are_one_look_in_any_order(order, apart):
    """Six pictures of a panorama are no six looks, whatever their order and the rounding of their stamps."""
    views = [PerspectiveGrid(40, 40, math.pi / 2, world_R_body(azimuth)) for azimuth in (0, 1.57, 3.14, -1.57)]
    place, alarm = direction(0.2, 0.1), direction(-1.5, 0.0)
    seen = [[place], [], [], [alarm]]

    def told(order, apart):
        tracker = DirectionTracker()
        for turn in range(2):
            for place_in_order, index in enumerate(order):
                points = np.array(seen[index]).reshape(-1, 3)
                stamp = turn + apart * place_in_order
                tracker.observe(Evidence.from_points(points, grid=views[index], detector=MODEL, stamp=stamp))
        return tracker.estimate(1.5)

    first, other = told(range(4), 0.0), told(order, apart)
    assert np.allclose(first.direction, other.direction, atol=1e-6)
    assert other.presence == pytest.approx(first.presence, abs=1e-4)
    assert np.allclose(first.log_density(SOME), other.log_density(SOME), atol=1e-3)


def test_views_that_cover_everything_say_what_a_whole_look_says():
    views = [
        PerspectiveGrid(80, 80, math.pi / 2, world_R_body(azimuth)) for azimuth in (0, math.pi / 2, math.pi, -1.5708)
    ]
    views += [PerspectiveGrid(80, 80, math.pi / 2, world_R_body(0.0, pitch)) for pitch in (math.pi / 2, -math.pi / 2)]
    place = direction(0.2, 0.1)
    parts, whole = DirectionTracker(), DirectionTracker()
    for index, view in enumerate(views):
        parts.observe(Evidence.from_points([place] if index == 0 else [], grid=view, detector=MODEL, stamp=0.0))
    whole.observe(look(place, 0.0))
    assert parts.estimate(0.0).presence == pytest.approx(whole.estimate(0.0).presence, abs=0.02)


# --- walking ----------------------------------------------------------------------------------------------------------


def walk(tracker, target, steps=12, pace=0.25, model=MODEL):
    for i in range(steps):
        position, pose = np.array([pace * i, 0, 0]), world_R_body(0.3 * i)
        tracker.add_pose(float(i), pose, position)
        tracker.observe(look(unit(pose.T @ (target - position)), float(i), model))
    return position, pose


def test_with_positions_parallax_gives_distance():
    target, tracker = np.array([2.0, 2.0, 0.2]), DirectionTracker()
    position, pose = walk(tracker, target)
    estimate = tracker.estimate(11.0)
    truth = pose.T @ (target - position)
    assert degrees(estimate.direction, truth) < 1
    assert estimate.distance == pytest.approx(np.linalg.norm(truth), rel=0.05)
    assert 0.01 < estimate.distance_spread < 0.15
    # Moving on without looking: the answer keeps up with the parallax.
    tracker.add_pose(12.0, pose, position + np.array([0.5, 0, 0]))
    truth = pose.T @ (target - position - [0.5, 0, 0])
    assert degrees(tracker.estimate(12.0).direction, truth) < 2


def test_a_look_from_before_the_first_position_does_not_disable_distance():
    """The first pose has a position; a look that was taken a moment before it is placed there."""
    target, tracker = np.array([2.0, 2.0, 0.2]), DirectionTracker()
    tracker.observe(look(unit(target), -0.1))
    position, pose = walk(tracker, target)
    estimate = tracker.estimate(11.0)
    # One more look than in the walk without it: as near as its own spread of a tenth says.
    assert estimate.distance == pytest.approx(np.linalg.norm(target - position), rel=0.1)
    assert degrees(estimate.direction, pose.T @ (target - position)) < 2


def test_a_known_floor_tells_distance_at_once():
    down, found = direction(0.5, math.radians(-15)), {}
    for floor in (None, 0.0, -0.8):
        tracker = DirectionTracker(TrackerConfig(floor_height=floor))
        tracker.add_pose(0.0, np.eye(3), np.array([0.0, 0.0, 1.25]))
        tracker.observe(look(down, 0.0, replace(MODEL, spread=math.radians(4))))
        found[floor] = tracker.estimate(0.0)
    assert found[0.0].distance_spread < 0.85 * found[None].distance_spread
    assert found[0.0].distance < found[-0.8].distance, "from higher up, the same depression is farther away"


def test_a_camera_that_is_not_above_the_floor_is_refused_and_leaves_the_tracker_as_it_was():
    tracker = DirectionTracker(TrackerConfig(floor_height=0.0))
    tracker.add_pose(0.0, np.eye(3), np.array([0.0, 0.0, 1.2]))
    tracker.observe(look(FORWARD, 0.0))
    before = said(tracker.estimate(0.0))
    for height in (-0.1, 0.0, 0.005):
        with pytest.raises(PoseError, match=r"TrackerConfig\.floor"):
            tracker.add_pose(1.0, world_R_body(1.0), np.array([0.0, 0.0, height]))
    assert np.array_equal(said(tracker.estimate(0.0)), before)
    tracker.observe(look(FORWARD, 1.0))
    tracker.add_pose(1.0, np.eye(3), np.array([0.1, 0.0, 1.2]))
    assert tracker.estimate(1.0).presence > tracker.estimate(1.0).hypotheses.weights[0]


# --- targets ----------------------------------------------------------------------------------------------------------


def test_targets_are_followed_apart():
    tracker = DirectionTracker(PLAIN)
    tracker.observe(look(direction(1.0, 0.0), 0.0), target="chair")
    tracker.observe(look(direction(-2.0, 0.3), 0.0), target="plant")
    assert set(tracker.targets) == {"chair", "plant"}
    assert tracker.estimate(0.0, "chair").azimuth == pytest.approx(1.0, abs=0.01)
    assert tracker.estimate(0.0, "plant").azimuth == pytest.approx(-2.0, abs=0.01)


def test_a_target_that_nobody_has_seen_is_a_mistyped_one():
    tracker = DirectionTracker()
    assert tracker.estimate(0.0, "chair").direction is None, "no target has any evidence yet"
    tracker.observe(look(FORWARD, 0.0), target="chair")
    with pytest.raises(EagorError, match="no evidence about 'chiar'; there is about 'chair'"):
        tracker.estimate(0.0, "chiar")


@pytest.mark.parametrize("looks", [1, 5, 30])
def test_two_things_alike_stay_two_however_often_we_look(looks):
    places = [direction(0.5, 0.0), direction(-2.0, 0.1)]
    estimate = estimate_after([points_look(places, t, MODEL) for t in range(looks)], MOVING)
    assert estimate.status == "ambiguous"
    assert len(estimate.modes) == 2
    assert {round(mode.azimuth, 1) for mode in estimate.modes} == {0.5, -2.0}
    assert all(mode.weight > 0.4 for mode in estimate.modes)


def test_what_was_carried_off_is_found_elsewhere():
    """However long a thing was in one place."""
    old, new = direction(0.5, -0.1), direction(-2.0, -0.1)
    for changes in ({}, {"ranges": None}):
        tracker = DirectionTracker(TrackerConfig(**changes))
        for t in range(62):
            tracker.add_pose(float(t), np.eye(3), np.zeros(3))
            tracker.observe(look(old if t < 50 else new, float(t)))
            if t == 49:
                assert tracker.estimate(49.0).moving < 0.2
        assert degrees(tracker.estimate(61.0).direction, new) < 3


def test_a_target_that_walks_out_is_gone_and_one_that_comes_back_is_there():
    motion = MotionModel(birth=0.01, death=0.01)
    tracker, presence = DirectionTracker(TrackerConfig(target_motion=motion)), {}
    for t in range(60):
        there = t < 20 or t >= 40
        tracker.observe(look(FORWARD, float(t)) if there else nothing(float(t)))
        presence[t] = tracker.estimate(float(t)).presence
    assert presence[19] > 0.98
    assert presence[39] < 0.05
    assert tracker.estimate(59.0).status == "tracking"
    assert presence[59] > 0.95
    # Whether it is still there is asked of the rates alone while nobody looks.
    waiting = [tracker.estimate(59.0 + wait).presence for wait in (0, 5, 50, 1000)]
    assert waiting == sorted(waiting, reverse=True)
    assert waiting[-1] == pytest.approx(0.5, abs=0.01), "where birth and death are in balance"


# --- answers ----------------------------------------------------------------------------------------------------------


def seeded(seed, steps=6, **changes):
    """An estimate after a few looks that tell little or much."""
    rng, tracker = np.random.default_rng(seed), DirectionTracker(TrackerConfig(**changes))
    target = unit(rng.normal(size=3))
    for t in range(rng.integers(1, steps + 1)):
        pose = rotation(unit(rng.normal(size=3)), rng.uniform(0, 3))
        tracker.add_pose(float(t), pose, np.array([0.2 * t, 0.0, 0.0]) if seed % 2 else None)
        seen = list(unit(rng.normal(size=(rng.poisson(1.0), 3))))
        if rng.random() < 0.6:
            seen.append(unit(pose.T @ target + 0.1 * rng.normal(size=3)))
        points = np.array(seen).reshape(-1, 3)
        model = DetectorModel(spread=math.radians(rng.uniform(1, 12)), look_alikes=float(rng.choice([0.0, 0.7])))
        tracker.observe(Evidence.from_points(points, scores=rng.random(len(points)), detector=model, stamp=float(t)))
    return tracker.estimate(float(t))


@pytest.mark.parametrize("seed", range(12))
def test_modes_are_sorted_by_mass_and_the_first_is_the_answer(seed):
    estimate = seeded(seed)
    if estimate.direction is None:
        assert estimate.modes == ()
        return
    weights = np.array([mode.weight for mode in estimate.modes])
    assert (np.diff(weights) <= 0).all()
    elsewhere = 1 - weights.sum()
    assert -1e-9 <= elsewhere < 1
    assert np.array_equal(estimate.modes[0].direction, estimate.direction)


@pytest.mark.parametrize("seed", range(6))
def test_the_weight_of_a_mode_is_the_mass_around_it(seed):
    """Of two well separated peaks the cones about them hold what their basins do."""
    rng, places = np.random.default_rng(seed), [FORWARD, direction(2.0, 0.3)]
    seen = [[place for place in places if rng.random() < 0.8] for _ in range(3)]
    estimate = estimate_after([points_look(each, t, MODEL) for t, each in enumerate(seen)], PLAIN)
    for mode in estimate.modes:
        if mode.weight > 0.2:
            inside = estimate.posterior.within(NEAR, estimate.world_R_body @ mode.direction)
            assert inside == pytest.approx(mode.weight, abs=0.03)


@pytest.mark.parametrize("seed", range(6))
def test_the_density_integrates_to_one_and_agrees_with_the_log_density(seed):
    estimate = seeded(seed)
    for grid in (ErpGrid(64, 128), PatchGrid(90, 180)):
        density, log = estimate.density(grid), estimate.log_density(grid.directions)
        assert np.sum(density * grid.weights) == pytest.approx(1, abs=1e-9)
        smooth = np.abs(np.exp(log) - density) < 0.1 * np.exp(log) + 0.01
        assert (density * grid.weights)[smooth].sum() + np.minimum(np.exp(log) * grid.weights, 1)[~smooth].sum() > 0.5
    fine, view = ErpGrid(1024, 2048), PerspectiveGrid(20, 30, 1.2)
    assert np.sum(np.exp(estimate.log_density(fine.directions)) * fine.weights) == pytest.approx(1, abs=0.03)
    assert np.allclose(estimate.density(view), np.exp(estimate.log_density(view.directions)))


def test_regions_hold_the_mass_that_they_say():
    """The smallest region of 50, 90 and 99 %: its border is where `mass_above` reaches that mass, its area fits."""
    for seed in range(4):
        estimate, grid = seeded(seed, steps=3, ranges=None), ErpGrid(512, 1024)
        log = estimate.log_density(grid.directions)
        for mass in (0.5, 0.9, 0.99):
            level, area = estimate.region(mass)
            density = np.exp(log) * grid.weights
            # Where the belief is nearly flat a border may lie anywhere: what is a little higher holds less.
            assert np.sum(density[log > level + 0.1]) < mass + 0.03
            assert np.sum(density[log > level - 0.1]) > mass - 0.03
            assert np.sum(grid.weights[log > level + 0.1]) < 1.1 * area + 0.02
            assert np.sum(grid.weights[log > level - 0.1]) > 0.9 * area - 0.02
        where = SOME[seed]
        above = np.sum((np.exp(log) * grid.weights)[log > float(estimate.log_density(where))])
        assert estimate.mass_above(where) == pytest.approx(above, abs=0.03)


def test_over_many_runs_the_regions_cover_as_often_as_they_say():
    """Targets, looks and false alarms drawn as the model says: the mass above the truth is uniform."""
    found = []
    for seed in range(80):
        rng, looks = np.random.default_rng(seed), []
        target = unit(rng.normal(size=3))
        for t in range(4):
            seen = list(unit(rng.normal(size=(rng.poisson(0.2), 3))))
            if rng.random() < 0.7:
                seen.append(unit(target + math.radians(8) * rng.normal(size=3)))
            looks.append(points_look(seen, t, MODEL))
        found.append(estimate_after(looks, PLAIN).mass_above(target))
    for mass in (0.5, 0.9):
        assert np.mean(np.array(found) < mass) == pytest.approx(mass, abs=3 * math.sqrt(mass * (1 - mass) / 80))


def test_before_any_evidence_the_direction_is_not_known():
    tracker = turning(TrackerConfig(), [0.0], [world_R_body(1.0)], [np.zeros(3)])
    estimate = tracker.estimate(0.0)
    assert (estimate.direction, estimate.azimuth, estimate.elevation, estimate.distance) == (None,) * 4
    assert (estimate.modes, estimate.status, estimate.presence) == ((), "searching", 0.5)
    assert math.isinf(estimate.age)
    assert "not known" in repr(estimate)
    assert np.allclose(estimate.log_density(SOME), -math.log(4 * math.pi))
    assert np.sum(estimate.density(ErpGrid(32, 64)) * ErpGrid(32, 64).weights) == pytest.approx(1)


def test_a_look_all_around_that_sees_nothing_tells_no_direction():
    tracker = DirectionTracker()
    tracker.observe(nothing(0.0))
    estimate = tracker.estimate(0.0)
    assert estimate.direction is None
    assert (estimate.presence < 0.5, estimate.status, estimate.size) == (True, "searching", 0)
    tracker.observe(look(FORWARD, 1.0))
    assert degrees(tracker.estimate(1.0).direction, FORWARD) < 0.1
    assert tracker.estimate(1.0).size == 0, "points have none"


def by_definition(estimate):
    """The status, in the words of `Estimate.status`."""
    if estimate.direction is None or estimate.presence < 0.5:
        return "searching"
    if sum(mode.weight >= RIVAL for mode in estimate.modes) > 1:
        return "ambiguous"
    if estimate.within(max(SURE, estimate.size / 2)) >= 0.5:
        return "tracking"
    told = sum(mode.weight for mode in estimate.modes)
    return "ambiguous" if len(estimate.modes) > 1 and told >= 0.5 else "searching"


@pytest.mark.parametrize("seed", range(16))
def test_the_status_is_what_its_words_say(seed):
    estimate = seeded(seed)
    assert estimate.status == by_definition(estimate)


@pytest.mark.parametrize("across", [10, 100])
def test_a_thing_that_fills_the_view_is_found_though_its_middle_is_not_known(across):
    """`size` is what the boxes have, the mean over the looks; the status counts half of it."""
    grid, half = ErpGrid(180, 360), across / 2
    box = [180 - half, 90 - half, 180 + half, 90 + half]  # a pixel is a degree
    estimate = estimate_after([Evidence.from_boxes([box], grid, stamp=float(stamp)) for stamp in range(3)], MOVING)
    assert np.degrees(estimate.size) == pytest.approx(across, rel=0.1)
    assert estimate.turned(3.0, np.eye(3)).size == estimate.size
    assert estimate.status == "tracking"
    assert (estimate.within(SURE) < 0.5) == (across > 50)


def test_trust_is_presence_times_what_lies_about_the_answer():
    estimate = estimate_after([look(direction(0.5, 0.0), float(t)) for t in range(5)], MOVING)
    assert estimate.status == "tracking"
    assert estimate.within(math.pi) == pytest.approx(estimate.presence)
    assert estimate.within(estimate.credible_angle) == pytest.approx(0.9 * estimate.presence, rel=0.03)
    assert estimate.within(0.1) < estimate.within(0.3) < estimate.presence


def test_an_answer_without_news_is_stale():
    tracker = DirectionTracker(TrackerConfig(ranges=None, answers=AnswerSettings(stale_after=2.0)))
    for t in range(5):
        tracker.observe(look(direction(0.5, 0.0), float(t)))
    assert tracker.estimate(5.9).status == "tracking"
    later = tracker.estimate(6.5)
    assert (later.status, later.age) == ("stale", pytest.approx(2.5))


@pytest.mark.parametrize("model", [MODEL, ALIKE])
def test_the_answer_is_the_heaviest_mode_whatever_was_answered_before(model):
    """Also of a detector that repeats its mistakes."""
    one, other = direction(0.5, 0.0), direction(-2.0, 0.1)
    tracker = DirectionTracker(PLAIN)
    for stamp, scores, answer in ((0.0, [0.9, 0.8], one), (1.0, [0.5, 0.9], other), (2.0, [0.9, 0.3], one)):
        tracker.observe(Evidence.from_points([one, other], scores=scores, detector=model, stamp=stamp))
        estimate = tracker.estimate(stamp)
        assert degrees(estimate.modes[0].direction, answer) < 1
        assert degrees(estimate.direction, answer) < 1


# --- what is refused --------------------------------------------------------------------------------------------------


def test_time_must_not_run_backwards():
    tracker = turning(PLAIN, [0.0, 1.0], [np.eye(3)] * 2)
    with pytest.raises(TimeError, match="backwards"):
        tracker.add_pose(0.5, np.eye(3))
    tracker.observe(look(direction(0, 0), 1.0))
    with pytest.raises(TimeError, match="already in"):
        tracker.estimate(0.5)
    with pytest.raises(TimeError, match="finite"):
        tracker.add_pose(math.nan, np.eye(3))
    with pytest.raises(TimeError, match="capture"):
        tracker.observe(Evidence.from_response(np.zeros(GRID.shape), GRID))


def test_evidence_from_before_the_history_is_refused_and_the_belief_kept():
    tracker = DirectionTracker(TrackerConfig(history=2.0))
    for i in range(60):
        tracker.add_pose(0.1 * i, np.eye(3), np.zeros(3))
    with pytest.raises(PoseError, match="history"):
        tracker.observe(look(direction(0, 0), 1.0))
    tracker.observe(look(direction(0, 0), 5.0))
    before = said(tracker.estimate(6.0))
    resting = DirectionTracker(TrackerConfig(history=2.0))
    for t in (1.0, 3.0, 4.0):
        resting.observe(look(direction(0, 0), t))
        resting.estimate(t)
    resting.observe(look(direction(0, 0), 2.5))  # the state before it is still there to start from
    with pytest.raises(TimeError, match="history"):
        resting.observe(look(direction(0, 0), 0.5))
    assert np.array_equal(said(tracker.estimate(6.0)), before)
    assert len(tracker._poses) < 30, "the memory of poses is bounded"


def test_poses_must_be_poses():
    tracker = DirectionTracker()
    with pytest.raises(RotationError, match="world_R_body"):
        tracker.add_pose(0.0, np.diag([1.0, -1, 1]))
    with pytest.raises(PoseError, match="metres"):
        tracker.add_pose(0.0, np.eye(3), [1.0, math.nan, 0.0])
    tracker.add_pose(0.0, np.eye(3), np.zeros(3))
    with pytest.raises(PoseError, match="no position"):
        tracker.add_pose(1.0, np.eye(3))


MEANINGLESS = {
    TrackerConfig: {
        "degree": [0, 7.5],
        "calibration": ["scout"],
        "detector": ["detection_probability=0.7"],
        "ranges": [(3.0, 1.0), (1.0,), (0.0, 1.0), 5.0],
        "floor_height": [math.nan, "low"],
        "target_motion": [{}],
        "answers": [{}],
        "drift": [-0.1, math.nan],
        "history": [-1.0],
    },
    AnswerSettings: {"decode": ["mod"], "stale_after": [math.nan, -1]},
    MotionModel: {
        "wander": [0.1, (0.1, 0.0), (4.0,), ("fast",)],
        "start": [-0.1],
        "stop": [math.nan],
        "jump": [math.inf],
        "birth": ["often"],
        "death": [1e3],
    },
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in MEANINGLESS.items() for name in names])
def test_settings_without_a_meaning_are_refused(kind, name):
    for value in MEANINGLESS[kind][name]:
        with pytest.raises(EagorError, match=f"{name} = .*; wanted"):
            kind(**{name: value})


def test_a_rotation_of_scipy_is_a_pose():
    turn = Rotation.from_euler("ZYX", [40, 5, -3], degrees=True)
    tracker = DirectionTracker()
    tracker.add_pose(0.0, turn, [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(tracker.pose_at(0.0)[0], turn.as_matrix())
    with pytest.raises(RotationError, match="wanted one rotation"):
        tracker.add_pose(1.0, Rotation.from_rotvec(np.eye(3)))


# --- a camera that walks, nobody knows where ---


def passed(config, told=None, thing=(3.0, 1.0, -0.5), speed=0.6):
    """The tracker, and its estimates after each look at what a camera passes; parallax is told after so many looks."""
    tracker, estimates = DirectionTracker(config), []
    for index in range(12):
        stamp = 1.0 * index
        if index == told:
            tracker.expect_parallax()
        tracker.add_pose(stamp, np.eye(3))
        tracker.observe(look(unit(np.subtract(thing, (speed * stamp, 0, 0))), stamp, ALIKE))
        estimates.append(tracker.estimate(stamp))
    return tracker, estimates


@pytest.mark.parametrize("told", [0, 5, 11])
def test_parallax_that_is_told_late_is_as_if_it_had_been_told_at_first(told):
    first = passed(TrackerConfig(drift=PARALLAX))[1][-1]
    late = passed(TrackerConfig(), told)[1][-1]
    assert late.log_density(SOME) == pytest.approx(first.log_density(SOME), abs=1e-9)
    assert passed(TrackerConfig(drift=0.0), told)[0].config.drift == 0, "who knows the odometry knows better"


def test_what_a_camera_passes_is_where_it_is_said_to_be_if_parallax_is_expected():
    held = {3: [], None: []}
    for told, aside, speed in itertools.product(held, (0.6, 1.0, 1.6, 2.5), (0.3, 0.6, 0.9)):
        thing = np.array([3.0, aside, -0.5])
        for index, each in enumerate(passed(TrackerConfig(), told, thing, speed)[1]):
            off = angular_distance(each.direction, unit(thing - [speed * index, 0, 0]))
            held[told].append(off <= each.credible_angle)
    assert np.mean(held[3]) > 0.9
    assert np.mean(held[None]) < 0.85, "else the thing is left behind, as one that stood"
