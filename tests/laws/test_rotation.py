"""How a camera turned, from matched directions and from pictures alone."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_rooms import PatternRoom
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from eagor.cameras import Lens
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.odometry.two_views import estimate_relative_rotation
from eagor.odometry.visual import VisualOdometer
from eagor.sphere import angular_distance, world_R_body

cv2 = pytest.importorskip("cv2")
NOISE = math.radians(0.2)
SEEDS = st.integers(0, 1999)
BLACK = np.zeros((256, 512, 3), np.uint8)


@pytest.fixture
def without_pycolmap(monkeypatch):
    """As on Linux on ARM."""
    monkeypatch.setattr("eagor.odometry.two_views.find_spec", lambda name: None)


def scattered(random, count):
    vectors = random.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def noisy(random, vectors, noise=NOISE):
    vectors = vectors + random.normal(size=vectors.shape) * noise / math.sqrt(2)  # both views err
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def pairs(seed, count=400, good=0.7, step=0.0, level=False):
    """Directions seen before and after a random turn and a step (metres), things at 1 to 5 m: old, new, truth, way."""
    random = np.random.default_rng(seed)
    truth = world_R_body(random.uniform(-3, 3)) if level else Rotation.random(rng=random).as_matrix()
    way = scattered(random, 1)[0]
    things = scattered(random, count) * random.uniform(1, 5, (count, 1))
    after = things - step * way
    new = noisy(random, after / np.linalg.norm(after, axis=1, keepdims=True)) @ truth
    wrong = random.random(count) > good
    new[wrong] = scattered(random, int(wrong.sum()))
    return noisy(random, things / np.linalg.norm(things, axis=1, keepdims=True)), new, truth, way


def gap(a, b):
    """Angle between two rotations, degrees."""
    return math.degrees(Rotation.from_matrix(a @ b.T).magnitude())


def off(found, truth):
    """The error, and its deviation as it is said, of the angle in degrees."""
    std = math.hypot(found.model_std, math.sqrt(np.trace(found.covariance)))
    return gap(found.old_R_new, truth), math.degrees(std)


@given(SEEDS, st.floats(0.3, 1.0))
@settings(max_examples=6, deadline=None)
def test_a_turn_is_found_among_mistakes(seed, good):
    old, new, truth, _ = pairs(seed, good=good)
    found = estimate_relative_rotation(old, new)
    assert found is not None
    assert gap(found.old_R_new, truth) < 0.15
    assert abs(found.inliers.mean() - good) < 0.15


@given(SEEDS, st.sampled_from([0.05, 0.2, 0.5, 1.0]))
@settings(max_examples=6, deadline=None)
def test_a_camera_that_moves_as_well(seed, step):
    pytest.importorskip("pycolmap")
    old, new, truth, way = pairs(seed, step=step)
    found = estimate_relative_rotation(old, new)
    assert found is not None
    assert gap(found.old_R_new, truth) < 0.3
    assert found.direction is not None, "parallax is seen"
    assert angular_distance(found.direction, way) < math.radians(6)


@pytest.mark.parametrize("step", [0.0, 0.3])
def test_without_pycolmap_a_turn_is_found_and_parallax_makes_it_unsure(without_pycolmap, step):
    for seed in range(5):
        old, new, truth, _ = pairs(seed, step=step)
        found = estimate_relative_rotation(old, new)
        assert found.direction is None
        error, std = off(found, truth)
        assert error < min(2.5 * std, 0.15 if not step else 20)


@pytest.mark.parametrize("step", [0.0, 0.3])
def test_the_uncertainty_is_honest(step):
    distances = []
    for seed in range(25):
        old, new, truth, _ = pairs(seed, count=200, step=step)
        found = estimate_relative_rotation(old, new)
        assert found is not None
        error = Rotation.from_matrix(found.old_R_new @ truth.T).as_rotvec()
        distances.append(error @ np.linalg.solve(found.covariance, error))
    inside = np.mean(np.array(distances) < chi2.ppf(0.9, 3))
    assert 0.8 <= inside <= 1.0
    assert 0.4 < np.mean(distances) / 3 < 1.5


@given(SEEDS, st.integers(0, 60))
@settings(max_examples=5, deadline=None)
def test_unrelated_directions_do_not_agree(seed, count):
    random = np.random.default_rng(seed)
    assert estimate_relative_rotation(scattered(random, count), scattered(random, count)) is None
    grid = PerspectiveGrid(30, 40, math.radians(40))  # where everything is near
    old, new = (grid.unproject(*random.uniform(0, (40, 30), (count, 2)).T) for _ in range(2))
    assert estimate_relative_rotation(old, new, area=float(grid.weights.sum())) is None


@given(st.integers(0, 20))
@settings(max_examples=6, deadline=None)
def test_one_thing_seen_in_two_rooms_is_no_agreement(seed):
    random = np.random.default_rng(seed)
    thing = noisy(random, np.tile(scattered(random, 1), (40, 1)), 0.1)
    old = np.concatenate([scattered(random, 20), thing])
    new = np.concatenate([scattered(random, 20), thing @ Rotation.random(rng=random).as_matrix()])
    assert estimate_relative_rotation(old, new) is None


@pytest.mark.parametrize("share", [0.1, 0.25])
def test_what_is_fixed_to_the_camera_does_not_stop_it(share):
    """A tripod over a share of the sphere, with five times as many points as the room has there."""
    for seed in range(2):
        random = np.random.default_rng(seed)
        old, new, truth, _ = pairs(seed, good=0.8)
        tripod = scattered(random, 1500)
        tripod = tripod[tripod[:, 2] < 2 * share - 1]
        room = (old[:, 2] > 2 * share - 1) & (new[:, 2] > 2 * share - 1)
        found = estimate_relative_rotation(np.concatenate([old[room], tripod]), np.concatenate([new[room], tripod]))
        assert found is not None
        assert gap(found.old_R_new, truth) < 0.3


@given(SEEDS, st.sampled_from([0.0, 0.3]))
@settings(max_examples=5, deadline=None)
def test_a_level_camera_turns_about_the_vertical_only(seed, step):
    old, new, truth, _ = pairs(seed, step=step, level=True)
    found = estimate_relative_rotation(old, new, level=True)
    assert found is not None
    assert gap(found.old_R_new, truth) < 0.2
    assert np.allclose(found.old_R_new[2], [0, 0, 1])
    assert np.count_nonzero(found.covariance) == 1


def test_the_same_pairs_give_the_same_turn_whatever_was_drawn_before():
    old, new, _, _ = pairs(3, step=0.2)
    first = estimate_relative_rotation(old, new)
    before = np.random.get_state()[1].copy()  # noqa: NPY002 - that it is left alone
    assert np.array_equal(first.old_R_new, estimate_relative_rotation(old, new).old_R_new)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


@pytest.mark.parametrize(("step", "moving"), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.45)])
def test_a_narrow_field_says_how_far_it_may_be_off(step, moving):
    """A step, and things that move, may look like a turn there."""
    within = []
    for seed in range(6):
        random = np.random.default_rng(seed)
        grid = PerspectiveGrid(36, 64, math.radians(60))
        rays = grid.directions.reshape(-1, 3)[random.permutation(36 * 64)[:300]]
        things = rays * random.uniform(2, 4, (300, 1))
        truth = world_R_body(math.radians(5))
        after = things - step * np.array([0.6, 0.8, 0.0])
        along = rays[:, 1] > np.quantile(rays[:, 1], 1 - moving)
        after[along] = after[along] @ world_R_body(math.radians(4)).T
        new = noisy(random, after / np.linalg.norm(after, axis=1, keepdims=True), NOISE / 8) @ truth
        error, std = off(estimate_relative_rotation(rays, new, area=float(grid.weights.sum())), truth)
        within.append(error <= 2 * std)
        assert std < 0.3 or step or moving
    assert np.mean(within) >= 5 / 6


# --- points and corners ---


# --- picture after picture ---


def test_a_tumbling_camera_hardly_drifts():
    room, odometer = PatternRoom(2), VisualOdometer()
    for index in range(6):
        pose = Rotation.from_rotvec(np.array([0.5, 0.6, -0.4]) * index).as_matrix()
        turned = odometer.add(room.panorama(pose))
        assert not turned.lost
        assert gap(turned.world_R_body, pose) < 0.1
        assert math.radians(gap(turned.world_R_body, pose)) <= 5 * turned.std
    assert turned.matches > 100
    assert not odometer.walks


def test_a_camera_that_walks_and_comes_back_loses_its_drift():
    pytest.importorskip("pycolmap")
    room, odometer, walked = PatternRoom(3), VisualOdometer(), False
    deviations = []
    for index in range(7):
        along = 0.5 * min(index, 6 - index)
        pose = Rotation.from_rotvec(np.array([0.02, 0.03, 0.2]) * index).as_matrix()
        turned = odometer.add(room.panorama(pose, (along - 1, 0.3 * along, 0.1)))
        assert not turned.lost
        assert gap(turned.world_R_body, pose) < 0.5
        deviations.append(turned.std)
        walked = walked or odometer.walks
    assert deviations[-1] < max(deviations)
    assert walked
    assert gap(turned.world_R_body, pose) < 0.1


def test_another_room_is_a_new_world():
    first, second, odometer = PatternRoom(4), PatternRoom(5), VisualOdometer()
    start, later = world_R_body(0.5, 0.2), world_R_body(1.0, 0.1, 0.3)
    assert not odometer.add(first.panorama(np.eye(3))).lost
    assert not odometer.add(first.panorama(start)).lost
    cut = odometer.add(second.panorama(start))
    assert cut.lost
    assert np.array_equal(cut.world_R_body, np.eye(3))
    after = odometer.add(second.panorama(later))
    assert not after.lost
    assert gap(after.world_R_body, start.T @ later) < 0.1


def test_a_black_picture_is_waited_out():
    room, odometer = PatternRoom(6), VisualOdometer()
    odometer.add(room.panorama(np.eye(3)))
    known = odometer.add(room.panorama(world_R_body(0.2)))
    held = [odometer.add(BLACK) for _ in range(3)]
    assert not any(each.lost for each in held)
    assert all(np.array_equal(each.world_R_body, known.world_R_body) and each.matches == 0 for each in held)
    assert np.all(np.diff([known.std, *(each.std for each in held)]) > 0), "the camera may have turned on"
    again = odometer.add(room.panorama(world_R_body(0.9)))
    assert not again.lost
    assert gap(again.world_R_body, world_R_body(0.9)) < 0.1
    assert again.std < 0.01


def test_a_world_that_begins_black_begins_with_the_first_thing_seen():
    odometer = VisualOdometer()
    assert not odometer.add(BLACK).lost
    assert odometer.add(BLACK).std > 1, "nothing at all is known"
    assert odometer.add(PatternRoom(6).panorama(np.eye(3))).lost


def test_a_level_odometer_gives_headings():
    room, odometer = PatternRoom(7), VisualOdometer(level=True)
    for index in range(4):
        turned = odometer.add(room.panorama(world_R_body(0.7 * index), (0.2 * index, 0, 0)))
        assert np.allclose(turned.world_R_body[2], [0, 0, 1])
        assert gap(turned.world_R_body, world_R_body(0.7 * index)) < 0.3


# --- ordinary cameras ---

LENS = Lens("phone", (256, 192), (200.0, 202.0), (130.0, 94.0), (-0.25, 0.08, 0.001, -0.002, 0.0))


class Ordinary:
    """What an ordinary lens shows of a room."""

    grid = PerspectiveGrid.of_lens(LENS)

    def __init__(self, seed):
        self.room = PatternRoom(seed).panorama(np.eye(3), rows=384)

    def picture(self, pose):
        x, y, _ = ErpGrid(*self.room.shape[:2]).project(self.grid.directions @ pose.T)
        return cv2.remap(self.room, (x - 0.5).astype(np.float32), (y - 0.5).astype(np.float32), cv2.INTER_LINEAR,
                         borderMode=cv2.BORDER_WRAP)  # fmt: skip


def test_an_ordinary_camera_with_distortion_turns_all_around_and_closes_the_circle():
    camera, odometer = Ordinary(2), VisualOdometer()
    poses = [world_R_body(2 * math.pi * k / 24, 0.2 * math.sin(k), 0.1 * math.cos(k) - 0.1) for k in range(25)]
    errors, deviations = [], []
    for k, pose in enumerate(poses):
        turned = odometer.add(camera.picture(pose), k / 4, camera.grid)
        assert not turned.lost
        assert turned.matches > 0 or k == 0
        errors.append(gap(turned.world_R_body, pose))
        deviations.append(turned.std)
    assert max(errors) < 1
    assert errors[-1] < 0.1, "the first picture is recognised"
    assert deviations[-1] < max(deviations) / 2


def test_an_ordinary_camera_waits_where_a_picture_fits_to_none_and_knows_the_place_again():
    camera, odometer = Ordinary(3), VisualOdometer()
    for k in range(3):
        odometer.add(camera.picture(world_R_body(0.1 * k)), k / 10, camera.grid)
    away = [odometer.add(camera.picture(world_R_body(2.5 + 0.1 * k)), 0.3 + k / 10, camera.grid) for k in range(3)]
    assert not any(each.lost or each.matches for each in away)
    assert np.all(np.diff([each.std for each in away]) > 0)
    back = odometer.add(camera.picture(world_R_body(0.3, 0.05)), 0.7, camera.grid)
    assert not back.lost
    assert gap(back.world_R_body, world_R_body(0.3, 0.05)) < 0.2
    other = Ordinary(4)
    turned = [odometer.add(other.picture(np.eye(3)), 0.8 + k, other.grid) for k in range(4)]
    assert [each.lost for each in turned].count(True) == 1, "a new world, after a while"
