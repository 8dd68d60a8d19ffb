"""Evidence late, early and out of order; poses at any rate; several targets; honest answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import rotations

from eagor.belief import Belief
from eagor.calibration import Calibration
from eagor.errors import EagorError, PoseError, RotationError, TimeError
from eagor.estimate import TrackerConfig
from eagor.evidence import Evidence
from eagor.grids import PatchGrid
from eagor.motion import standing
from eagor.posterior import typical
from eagor.ranged import RangedBelief
from eagor.sphere import angular_distance, direction, rotation, world_R_body
from eagor.tracker import DirectionTracker

GRID = PatchGrid(12, 24)
FLAT = {"ranges": None, "degree": 7, "wander": 0.0}  # all that happens commutes with adding


def look(target, stamp, score=0.9, concentration=60.0):
    return Evidence.from_points([target], concentration, [score], stamp=stamp)


def repeating(evidence, persistence):
    return evidence.with_calibration(replace(evidence.calibration, persistence=persistence))


def noise(seed, stamp):
    return Evidence.from_response(np.random.default_rng(seed).random(GRID.shape), GRID, stamp=stamp)


def turning(config, stamps, turns, positions=None):
    tracker = DirectionTracker(config)
    for i, stamp in enumerate(stamps):
        tracker.rotate(stamp, turns[i], None if positions is None else positions[i])
    return tracker


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
        tracker.rotate(float(step), world_R_now)
        tracker.observe(Evidence.from_response(response, GRID, stamp=float(step)))
        assert np.allclose(tracker.belief(float(step)).coefficients, coefficients, atol=1e-9)
        estimate = tracker.estimate(float(step))
        assert np.allclose(estimate.direction, Belief(coefficients).mean_direction(), atol=1e-9)


@given(st.permutations(range(6)), st.lists(rotations(), min_size=6, max_size=6))
@settings(max_examples=25)
def test_with_rotation_only_late_equals_on_time(order, turns):
    stamps = [0.1 * i for i in range(6)]
    config = TrackerConfig(**FLAT, keep_per_second=0.5)
    on_time, late = DirectionTracker(config), turning(config, stamps, turns)
    for i, stamp in enumerate(stamps):
        on_time.rotate(stamp, turns[i])
        on_time.observe(noise(i, stamp))
    for i in order:
        late.observe(noise(i, stamps[i]))
    now = stamps[-1] + 0.3
    assert np.abs(on_time.belief(now).coefficients - late.belief(now).coefficients).max() < 1e-12


@given(st.permutations(range(5)))
@settings(max_examples=8, deadline=None)
@pytest.mark.parametrize("kind", ["translation", "diffusion"])
def test_what_does_not_commute_is_replayed(kind, order):
    stamps = [0.2 * i for i in range(5)]
    turns = [world_R_body(0.2 * i, 0.05 * i) for i in range(5)]
    positions = [np.array([0.2 * i, 0.1, 0.0]) for i in range(5)] if kind == "translation" else None
    config = TrackerConfig(degree=7, diffusion=0.05 if kind == "diffusion" else 0.0)
    results = []
    for sequence in (range(5), order):
        tracker = turning(config, stamps, turns, positions)
        for i in sequence:
            tracker.observe(look(direction(0.5 - 0.1 * i, 0.1), stamps[i]))
        results.append(tracker.belief(1.0).coefficients)
    assert np.allclose(results[0], results[1], atol=1e-9)


@given(rotations(), rotations())
@settings(max_examples=20)
def test_evidence_is_placed_by_its_time_of_capture(first, second):
    """A detection straight ahead at t = 0, delivered after the turn, stands where the turn put it."""
    tracker = turning(TrackerConfig(**FLAT), [0.0, 1.0], [first, second])
    tracker.observe(look(np.array([1.0, 0, 0]), 0.0))
    expected = second.T @ first @ [1, 0, 0]
    estimate = tracker.estimate(1.0)
    assert np.degrees(angular_distance(estimate.direction, expected)) < 0.1
    assert np.degrees(angular_distance(tracker.belief(1.0).mode(), expected)) < 0.2


def test_poses_are_interpolated_and_the_last_is_held():
    tracker = turning(TrackerConfig(**FLAT), [0.0, 1.0], [world_R_body(0.0), world_R_body(1.0)])
    tracker.observe(look(np.array([1.0, 0, 0]), 0.25))
    assert tracker.estimate(1.0).azimuth == pytest.approx(-0.75, abs=2e-3)
    assert tracker.estimate(0.25).azimuth == pytest.approx(0.0, abs=2e-3)
    assert tracker.estimate(9.0).azimuth == pytest.approx(-0.75, abs=2e-3)


def test_a_tracker_without_poses_stands_still():
    tracker = DirectionTracker()
    tracker.observe(look(direction(1.2, -0.3), 5.0))
    estimate = tracker.estimate(5.0)
    assert estimate.azimuth == pytest.approx(1.2, abs=2e-3)
    assert estimate.elevation == pytest.approx(-0.3, abs=2e-3)
    assert estimate.distance is None


def test_with_positions_parallax_gives_distance():
    target, tracker = np.array([2.0, 2.0, 0.2]), DirectionTracker(TrackerConfig(degree=12))
    for i in range(12):
        position, pose = np.array([0.25 * i, 0, 0]), world_R_body(0.3 * i)
        tracker.rotate(float(i), pose, position)
        offset = target - position
        tracker.observe(look(pose.T @ offset / np.linalg.norm(offset), float(i)))
    estimate = tracker.estimate(11.0)
    truth = pose.T @ (target - position)
    assert np.degrees(angular_distance(estimate.direction, truth)) < 5
    assert estimate.distance == pytest.approx(np.linalg.norm(truth), rel=0.2)
    # Moving on without looking: the answer keeps up with the parallax.
    tracker.rotate(12.0, pose, position + np.array([0.5, 0, 0]))
    truth = pose.T @ (target - position - [0.5, 0, 0])
    assert np.degrees(angular_distance(tracker.estimate(12.0).direction, truth)) < 8


def test_targets_are_followed_apart():
    tracker = DirectionTracker(TrackerConfig(**FLAT))
    tracker.observe(look(direction(1.0, 0.0), 0.0), target="chair")
    tracker.observe(look(direction(-2.0, 0.3), 0.0), target="plant")
    assert set(tracker.targets) == {"chair", "plant"}
    assert tracker.estimate(0.0, "chair").azimuth == pytest.approx(1.0, abs=0.01)
    assert tracker.estimate(0.0, "plant").azimuth == pytest.approx(-2.0, abs=0.01)
    assert tracker.estimate(0.0, "door").status == "searching"


def test_a_second_one_stays_a_rival_however_often_the_first_is_seen():
    first, second = direction(0.5, 0.0), direction(-2.0, 0.1)
    tracker = DirectionTracker(TrackerConfig(ranges=None, wander=0.0, keep_per_second=1.0))
    for t in range(40):
        seen = [first, second] if t < 4 else [first]
        tracker.observe(Evidence.from_points(seen, 60.0, [0.9] * len(seen), stamp=float(t)))
    estimate = tracker.estimate(39.0)
    assert np.degrees(angular_distance(estimate.direction, first)) < 2
    assert estimate.modes[0].weight > 0.99, "by weight there is one"
    assert estimate.status == "ambiguous"
    assert np.degrees(angular_distance(estimate.modes[1].direction, second)) < 3


def test_the_status_says_what_is_known():
    tracker = DirectionTracker(TrackerConfig(ranges=None, stale_after=2.0))
    assert tracker.estimate(0.0).status == "searching"
    assert math.isinf(tracker.estimate(0.0).age)
    for t in range(3):
        tracker.observe(Evidence.from_response(np.zeros(GRID.shape), GRID, stamp=float(t)))
    assert tracker.estimate(2.0).status == "searching", "looked and saw nothing"
    assert tracker.estimate(2.0).presence < 0.5
    for t in range(3, 6):
        tracker.observe(look(direction(0.5, 0.0), float(t)))
    found = tracker.estimate(5.0)
    assert found.status == "tracking"
    assert len(found.modes) == 1
    assert found.modes[0].weight > 0.9
    later = tracker.estimate(7.5)
    assert later.status == "stale"
    assert later.age == pytest.approx(2.5)


def test_a_direction_may_stand_out_and_nothing_be_there():
    """Weak responses that keep to one place make a mode; presence says that it is not the thing."""
    weak = {t: look(direction(0.5, 0.0), float(t), score=0.06) for t in range(40)}
    tracker = DirectionTracker(TrackerConfig(ranges=None, keep_per_second=1.0, calibration=Calibration(0.02, 0.2, 1.0)))
    for one in weak.values():
        tracker.observe(one)
    estimate = tracker.estimate(39.0)
    assert estimate.reading.posterior.gain > tracker.config.found_at
    assert estimate.presence < 0.1
    assert estimate.status == "searching"


def test_trust_is_presence_times_what_lies_about_the_answer():
    tracker = DirectionTracker(TrackerConfig(ranges=None))
    for t in range(3):
        tracker.observe(look(direction(0.5, 0.0), float(t)))
    estimate = tracker.estimate(2.0)
    assert estimate.within(math.pi) == pytest.approx(estimate.presence)
    assert estimate.within(estimate.credible_angle) == pytest.approx(0.9 * estimate.presence, rel=0.03)
    assert estimate.within(0.1) < estimate.within(0.3) < estimate.presence


@pytest.mark.parametrize("looks", [1, 5, 40])
def test_two_things_alike_stay_two_however_often_we_look(looks):
    """Repeated looks turn a small difference in score into any odds; that is no reason to stop asking."""
    places = [direction(0.5, 0.0), direction(-2.0, 0.1)]
    tracker = DirectionTracker(TrackerConfig(ranges=None))
    for t in range(looks):
        tracker.observe(Evidence.from_points(places, 60.0, [0.9, 0.85], stamp=float(t)))
    estimate = tracker.estimate(looks - 1.0)
    assert estimate.status == "ambiguous"
    assert len(estimate.modes) == 2
    for place, mode in zip(places, estimate.modes, strict=True):
        assert np.degrees(angular_distance(place, mode.direction)) < 2


def test_the_answer_stays_until_another_is_clearly_higher():
    one, other = direction(0.5, 0.0), direction(-2.0, 0.1)
    config = TrackerConfig(ranges=None, wander=0.0, keep_per_second=1.0)
    calm, restless = DirectionTracker(config), DirectionTracker(replace(config, switch_at=0.0))

    def told(scores, stamp):
        look = Evidence.from_points([one, other], 60.0, scores, stamp=stamp)
        for tracker in (calm, restless):
            tracker.observe(look)
        return [tracker.estimate(stamp).direction for tracker in (calm, restless)]

    assert all(np.degrees(angular_distance(said, one)) < 2 for said in told([0.9, 0.8], 0.0))
    held, highest = told([0.8, 0.95], 1.0)
    assert np.degrees(angular_distance(held, one)) < 2
    assert np.degrees(angular_distance(highest, other)) < 2
    assert calm.estimate(1.0).within(math.pi) == pytest.approx(calm.estimate(1.0).presence)
    for k in range(6):
        held, _ = told([0.2, 0.95], 2.0 + k)
    assert np.degrees(angular_distance(held, other)) < 2, "by now it is clearly higher"


@pytest.mark.parametrize("changes", [{}, {"ranges": None}])
def test_nothing_is_ever_surer_than_the_configuration_allows(changes):
    place = direction(0.5, -0.1)
    for surest in (8.0, 1e6):
        tracker = DirectionTracker(TrackerConfig(**changes, surest=surest, restless=0.0, keep_per_second=1.0))
        for t in range(50):
            tracker.rotate(float(t), np.eye(3), np.zeros(3))
            tracker.observe(repeating(look(place, float(t)), 0.5))
        state = tracker._states["target"]
        still = state.belief.plus(state.newest).still.posterior
        assert (still.coarse.max() - typical(still.coarse, still.grid.weights) <= 8.1) == (surest == 8.0)


def test_certainty_is_capped_and_the_distance_goes_on_getting_better():
    target, distances = np.array([2.0, 3.0, -0.3]), {}
    for surest in (6.0, 1e6):
        tracker = DirectionTracker(TrackerConfig(surest=surest, wander=math.radians(2), doubt=1e-6))
        for t in range(30):
            position = np.array([0.08 * t, 0.0, 0.0])
            tracker.rotate(float(t), np.eye(3), position)
            offset = target - position
            tracker.observe(look(offset / np.linalg.norm(offset), float(t)))
        estimate = tracker.estimate(29.0)
        assert estimate.distance == pytest.approx(np.linalg.norm(offset), rel=0.15)
        distances[surest] = estimate.distance_spread
    assert distances[1e6] < distances[6.0] < 0.3, "with the shells scaled down as well it would be 0.8"


@pytest.mark.parametrize("changes", [{}, {"ranges": None}])
def test_what_was_carried_off_is_found_elsewhere(changes):
    """However long a thing was in one place: of the place where it stood, little is remembered then."""
    old, new, found = direction(0.5, -0.1), direction(-2.0, -0.1), {}
    for settle in (0.8, 1e6):
        tracker = DirectionTracker(TrackerConfig(**changes, settle=settle))
        for t in range(62):
            tracker.rotate(float(t), np.eye(3), np.zeros(3))
            tracker.observe(repeating(look(old if t < 50 else new, float(t)), 0.8))
            if t == 49:
                assert tracker.estimate(49.0).moving < 0.1
        estimate = tracker.estimate(61.0)
        still = estimate.reading.still.posterior
        found[settle] = estimate.direction, float(angular_distance(still.mode, new))
    assert np.degrees(angular_distance(found[0.8][0], new)) < 2
    assert np.degrees(found[0.8][1]) < 2 < np.degrees(found[1e6][1])


def test_asking_does_not_change_the_answer():
    quiet, asked = DirectionTracker(), DirectionTracker()
    for k in range(8):
        for tracker in (quiet, asked):
            tracker.observe(noise(k, float(k)))
        asked.estimate(float(k))
        asked.estimate(k + 0.5)
    assert np.array_equal(quiet.estimate(8.0).direction, asked.estimate(8.0).direction)


def test_what_was_learnt_fades_and_wanders():
    def entropy(**changes):
        tracker = DirectionTracker(TrackerConfig(**FLAT, **changes))
        for t in range(4):
            tracker.observe(look(direction(0.5, 0.0), 0.1 * t))
        return tracker.belief(3.0).entropy()

    assert entropy() < entropy(keep_per_second=0.7) < math.log(4 * math.pi)
    assert entropy() < entropy(diffusion=0.3)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_looks_that_repeat_each_other_add_up_in_part(count):
    """Of n looks alike, whose errors persist by p, n (1 - p) + p count."""
    tracker = DirectionTracker(TrackerConfig(**FLAT, keep_per_second=1.0))
    for t in range(count):
        tracker.observe(repeating(look(direction(0.5, 0.0), float(t)), 0.6))
    one = look(direction(0.5, 0.0), 0.0).coefficients(7)
    assert np.allclose(tracker.belief(count - 1.0).coefficients, (0.4 * count + 0.6) * one, atol=1e-5)


@pytest.mark.parametrize("changes", [FLAT, {"degree": 7}, {"degree": 7, "wander": 0.0}])
def test_late_equals_on_time_where_looks_repeat_each_other(changes):
    config = TrackerConfig(**changes)
    on_time, late = DirectionTracker(config), DirectionTracker(config)
    looks = [repeating(look(direction(0.3 * t, 0.0), float(t)), 0.5) for t in range(4)]
    for one in looks:
        on_time.observe(one)
    for index in (0, 2, 3, 1):
        late.observe(looks[index])
    assert np.allclose(on_time.belief(4.0).coefficients, late.belief(4.0).coefficients, atol=1e-9)


def test_a_known_floor_tells_distance_at_once():
    down, found = direction(0.5, math.radians(-15)), {}
    for floor in (None, 0.0, -0.8):
        tracker = DirectionTracker(TrackerConfig(floor=floor))
        tracker.rotate(0.0, np.eye(3), np.array([0.0, 0.0, 1.25]))
        tracker.observe(look(down, 0.0, concentration=200.0))
        found[floor] = tracker.estimate(0.0)
    assert found[0.0].distance_spread < 0.85 * found[None].distance_spread
    assert found[0.0].distance < found[-0.8].distance, "from higher up, the same depression is farther away"


def test_distance_and_its_spread_are_read_from_one_computation(monkeypatch):
    tracker, asked, of = DirectionTracker(), [], RangedBelief.range_probabilities
    for t in range(3):
        tracker.rotate(float(t), np.eye(3), np.array([0.2 * t, 0.0, 0.0]))
        tracker.observe(look(direction(1.0 + 0.1 * t, 0.0), float(t)))
    estimate = tracker.estimate(2.0)
    still, answer = standing(estimate.reading), estimate.direction
    expected = still.distance(answer), still.distance_spread(answer)
    monkeypatch.setattr(RangedBelief, "range_probabilities", lambda *given: asked.append(given) or of(*given))
    assert (estimate.distance, estimate.distance_spread, estimate.distance) == (*expected, expected[0])
    assert len(asked) == 1
    flat = DirectionTracker(TrackerConfig(**FLAT))
    flat.observe(look(direction(1.0, 0.0), 0.0))
    assert (flat.estimate(0.0).distance, flat.estimate(0.0).distance_spread) == (None, None)


def test_a_camera_below_the_floor_is_refused():
    tracker = DirectionTracker(TrackerConfig(floor=0.0))
    tracker.rotate(0.0, np.eye(3), np.array([0.0, 0.0, -0.1]))
    with pytest.raises(PoseError, match="floor"):
        tracker.observe(look(direction(0, 0), 0.0))


def test_forgetting_depends_on_time_and_not_on_how_often_one_asks():
    config = TrackerConfig(**FLAT, keep_per_second=0.5)
    one, two = DirectionTracker(config), DirectionTracker(config)
    for tracker in (one, two):
        tracker.observe(look(direction(0.5, 0.0), 0.0))
    for t in (0.5, 1.0, 1.5):
        two.estimate(t)
    assert np.allclose(one.belief(2.0).coefficients, two.belief(2.0).coefficients)
    start = look(direction(0.5, 0.0), 0.0).coefficients(7)
    assert np.allclose(one.belief(2.0).coefficients, 0.25 * start)


def test_time_must_not_run_backwards():
    tracker = turning(TrackerConfig(**FLAT), [0.0, 1.0], [np.eye(3)] * 2)
    with pytest.raises(TimeError, match="backwards"):
        tracker.rotate(0.5, np.eye(3))
    tracker.observe(look(direction(0, 0), 1.0))
    with pytest.raises(TimeError, match="already in"):
        tracker.estimate(0.5)
    with pytest.raises(TimeError, match="finite"):
        tracker.rotate(math.nan, np.eye(3))
    with pytest.raises(TimeError, match="capture"):
        tracker.observe(Evidence.from_response(np.zeros(GRID.shape), GRID))


def test_evidence_from_before_the_history_is_refused_and_the_belief_kept():
    tracker = DirectionTracker(TrackerConfig(degree=7, history=2.0))
    for i in range(60):
        tracker.rotate(0.1 * i, np.eye(3), np.zeros(3))
    with pytest.raises(PoseError, match="history"):
        tracker.observe(look(direction(0, 0), 1.0))
    tracker.observe(look(direction(0, 0), 5.0))
    before = tracker.belief(6.0).coefficients
    moving = DirectionTracker(TrackerConfig(degree=7, diffusion=0.1, history=2.0))
    for t in (1.0, 3.0, 4.0):
        moving.observe(look(direction(0, 0), t))
    moving.observe(look(direction(0, 0), 1.5))  # the state of t = 1 is still there to start from
    with pytest.raises(TimeError, match="history"):
        moving.observe(look(direction(0, 0), 0.5))
    assert np.array_equal(tracker.belief(6.0).coefficients, before)
    assert len(tracker._poses) < 30, "the memory of poses is bounded"


def test_poses_must_be_poses():
    tracker = DirectionTracker()
    with pytest.raises(RotationError, match="world_R_body"):
        tracker.rotate(0.0, np.diag([1.0, -1, 1]))
    with pytest.raises(PoseError, match="metres"):
        tracker.rotate(0.0, np.eye(3), [1.0, math.nan, 0.0])
    tracker.rotate(0.0, np.eye(3), np.zeros(3))
    with pytest.raises(PoseError, match="no position"):
        tracker.rotate(1.0, np.eye(3))


def test_a_corrected_pose_of_the_same_time_replaces_the_first():
    tracker = turning(TrackerConfig(**FLAT), [0.0, 0.0], [np.eye(3), rotation((0, 0, 1), 0.5)])
    tracker.observe(look(np.array([1.0, 0, 0]), 0.0))
    assert np.degrees(angular_distance(tracker._states["target"].belief.mode(), direction(0.5, 0))) < 0.2


@pytest.mark.parametrize(
    "changes",
    [
        {"keep_per_second": 0.0},
        {"keep_per_second": 2.0},
        {"diffusion": -1.0},
        {"history": -1},
    ],
)
def test_impossible_settings_are_refused(changes):
    with pytest.raises(EagorError):
        TrackerConfig(**changes)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("degree", 0),
        ("degree", 7.5),
        ("decode", "mod"),
        ("keep_per_second", 0.0),
        ("diffusion", -0.1),
        ("wander", 4.0),
        ("restless", math.nan),
        ("doubt", 0.5),
        ("settle", 0.0),
        ("surest", math.nan),
        ("history", -1.0),
        ("stale_after", math.nan),
        ("found_at", math.nan),
        ("switch_at", -1.0),
        ("present_at", 1.5),
        ("ambiguous_below", -0.1),
    ],
)
def test_a_configuration_without_a_meaning_is_refused(name, value):
    with pytest.raises(EagorError, match=f"{name} = .*; wanted"):
        TrackerConfig(**{name: value})
