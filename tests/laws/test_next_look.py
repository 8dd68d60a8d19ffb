"""Where to look next: where a look is expected to tell most about presence and direction."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import eagor
from eagor import Evidence
from eagor.errors import GridError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.live.events import Answer, ImageReceived, NextLooks
from eagor.sphere import angular_distance, world_R_body
from eagor.tracking import Heights, TurningCamera, TurningRig
from eagor.tracking.next_view import information, tell, views_of

GRID = PerspectiveGrid(48, 64, math.radians(90))
CAMERA = TurningCamera(math.radians(90))
CELLS = ErpGrid(64, 128)
NOTHING = np.zeros((0, 3))


def looked(*poses, found=NOTHING):
    """The estimate after looks with these poses; the last one reports `found` ``(n, 3)``, body frame."""
    tracker = eagor.DirectionTracker()
    for index, pose in enumerate(poses):
        tracker.add_pose(float(index), pose)
        last = index == len(poses) - 1
        tracker.observe(Evidence.from_points(found if last else NOTHING, grid=GRID, stamp=float(index)))
    return tracker.estimate(max(len(poses) - 1.0, 0.0))


def told_by(estimate, camera):
    """The axes ``(n, 3)`` of the views that are weighed, and what a look at each tells ``(n,)``."""
    views = views_of(camera, estimate.world_R_body, np.array([1.0, 0.0, 0.0]))
    return views.axes, tell(estimate._known, views, None)


def shows(estimate, toward, where):
    """Whether a level view with its axis `toward` shows directions ``(..., 3)``, all in the body frame."""
    axis = estimate.world_R_body @ toward
    pose = world_R_body(math.atan2(axis[1], axis[0]), -math.asin(axis[2]))
    return GRID.project(where @ estimate.world_R_body.T @ pose)[2]


def test_before_any_look_all_directions_are_alike_and_the_nearest_is_taken():
    estimate = eagor.DirectionTracker().estimate(0.0)
    _, told = told_by(estimate, CAMERA)
    assert told.min() > 0.95 * told.max()
    assert estimate.next_look(CAMERA).turn < 1e-6
    assert estimate.next_look(CAMERA, body_R_view=world_R_body(math.pi / 2)).direction[1] == pytest.approx(1.0)


@given(st.lists(st.tuples(st.integers(-180, 180), st.integers(-40, 40)), min_size=1, max_size=4))
@settings(max_examples=8)
def test_what_was_looked_at_in_vain_is_not_looked_at_again(turns):
    """The next look tells as much as any, and more than the same look again; it shows mostly what none has shown."""
    estimate = looked(*(world_R_body(*np.radians(turn)) for turn in turns))
    next_look = estimate.next_look(CAMERA)
    axes, told = told_by(estimate, CAMERA)
    again = told[np.argmax(axes @ estimate.world_R_body[:, 0])]
    assert 0.97 * told.max() <= next_look.tells <= told.max()
    assert next_look.tells > again
    new = np.ones(CELLS.shape, dtype=bool)
    for turn in turns:
        new &= ~GRID.project(CELLS.directions @ world_R_body(*np.radians(turn)))[2]
    seen = shows(estimate, next_look.direction, CELLS.directions @ estimate.world_R_body)
    assert np.sum((seen & new) * CELLS.weights) > 0.6 * np.sum(seen * CELLS.weights)


@given(st.integers(-180, 180), st.integers(-50, 50), st.integers(60, 300))
@settings(max_examples=8)
def test_a_likely_place_out_of_view_is_looked_at(azimuth, elevation, turn):
    """It was seen once, then the camera turned away: whether it is there is what a look tells most about."""
    pose = world_R_body(math.radians(azimuth), -math.radians(elevation))
    tracker = eagor.DirectionTracker()
    tracker.add_pose(0.0, pose)
    tracker.observe(Evidence.from_points([[1.0, 0.05, 0.0]], grid=GRID, stamp=0.0))
    tracker.add_pose(0.5, world_R_body(math.radians(azimuth + turn)))
    estimate = tracker.estimate(0.5)
    assert shows(estimate, tracker.next_look(math.radians(90), 0.5).direction, estimate.direction)


def test_time_counts_where_turning_takes_time():
    away = np.array([-1.0, 0.2, 0.0])
    tracker = eagor.DirectionTracker()
    tracker.observe(Evidence.from_points([away], stamp=0.0))
    estimate = tracker.estimate(0.0)
    free, slow = (TurningCamera(math.radians(60), turn_rate=rate) for rate in (None, math.radians(0.5)))
    assert angular_distance(estimate.next_look(free).direction, away) < math.radians(30)
    assert estimate.next_look(slow).turn < 0.5 * estimate.next_look(free).turn
    level = TurningCamera(math.radians(60), reach=0.0)
    assert estimate.next_look(level).elevation == pytest.approx(0.0, abs=1e-9)


def test_things_are_looked_for_where_they_usually_are():
    estimate = looked(np.eye(3))
    heights = Heights(height=math.radians(50), tilt=math.radians(10), elsewhere=0.05)
    assert estimate.next_look(CAMERA, heights).elevation > math.radians(20)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda: TurningCamera(90), "hfov = 90; wanted radians, from 20 to 170 degrees"),
        (lambda: TurningCamera(1.5, reach=-1), "reach"),
        (lambda: TurningCamera(1.5, turn_rate=0), "turn_rate"),
        (lambda: Heights(elsewhere=0), "elsewhere"),
        (lambda: looked(np.eye(3)).next_look(0.1), "hfov"),
        (lambda: TurningRig([]), "at least one view"),
        (lambda: TurningRig([PerspectiveGrid(4, 4, 3.0)]), "hfov"),
    ],
)
def test_numbers_out_of_range_are_refused(wrong, says):
    with pytest.raises(GridError, match=says):
        wrong()


def side(*yaws, fov=60):
    """Views of cameras at these azimuths of the body, degrees."""
    return [PerspectiveGrid(48, 64, math.radians(fov), world_R_body(math.radians(yaw))) for yaw in yaws]


def test_a_rig_of_one_camera_ahead_turns_to_where_the_camera_does():
    """A body that turns can tilt nothing, so the camera has no reach either."""
    tracker = eagor.DirectionTracker()
    tracker.observe(Evidence.from_points([[0.4, 1.0, 0.1]], grid=PerspectiveGrid(48, 64, 2.6), stamp=0.0))
    estimate = tracker.estimate(0.0)
    level = TurningCamera.of_view(side(0)[0])
    one, rig = estimate.next_look(TurningCamera(level.hfov, level.vfov, reach=0.0)), TurningRig(side(0))
    for found in (estimate.next_look(rig), tracker.next_look(rig, 0.0)):
        np.testing.assert_allclose(found.direction, one.direction, atol=1e-9)
        assert (found.tells, found.turn) == (pytest.approx(one.tells), pytest.approx(one.turn, abs=1e-6))


@pytest.mark.parametrize("tilt", [0.0, 20.0])
def test_a_rig_turns_the_way_on_which_any_of_its_cameras_sees_more(tilt):
    """Front and back have looked in vain: a quarter turn shows both sides at once; left and back need no more."""
    body = world_R_body(math.radians(40), math.radians(tilt))
    for yaws, quarters in (((0, 180), (1, 3)), ((0, 90), (2,))):
        tracker = eagor.DirectionTracker()
        tracker.add_pose(0.0, body)
        for view in side(*yaws, fov=90):
            tracker.observe(Evidence.from_points(NOTHING, grid=view, stamp=0.0))
        found = tracker.estimate(0.0).next_look(TurningRig(side(*yaws, fov=90)))
        turn = math.degrees(found.turn)
        assert min(abs(turn - 90 * each if each < 3 else turn - 90) for each in quarters) < 31
        assert found.elevation != 0 or tilt == 0


def test_a_rig_that_sees_all_around_need_not_turn():
    estimate = looked(np.eye(3), found=np.array([[0.8, 1.0, 0.1]]))
    assert estimate.next_look(TurningRig(side(0, 60, 120, 180, 240, 300, fov=80))).turn < math.radians(61)
    nothing = eagor.DirectionTracker().estimate(0.0)
    assert nothing.next_look(TurningRig(side(0, 90, 180, 270, fov=100))).turn == 0.0


def test_a_live_loop_tells_where_an_ordinary_camera_should_turn():
    looks, estimate, (view,) = NextLooks(), looked(np.eye(3)), side(0)
    answer = Answer(0.0, "ball", estimate, 0.0, 0.0, 0.0)
    looks.take(ImageReceived(0.0, 0.0, "", None, view), [])
    wanted = estimate.next_look(TurningCamera.of_view(view)).direction
    np.testing.assert_allclose(looks.of(answer), wanted, atol=1e-9)
    looks.take(ImageReceived(0.1, 0.1, "", None, None), [])
    assert looks.of(answer) is None, "a panorama sees all"


# --- what a look tells: the mutual information of its outcome and the place ---


def entropy(p):
    p = p[p > 0]
    return -float((p * np.log(p)).sum())


def by_definition(here, share, alarm, falls):
    """I(outcome; cell) of one look, by the table of all places (its cells, elsewhere) and outcomes (cells, none)."""
    k = len(here)
    joint = np.zeros((k + 1, k + 1))
    for place, p in enumerate([*here, 1 - here.sum()]):
        found = share[place] if place < k else 0.0
        joint[place, :k] = p * (1 - found) * alarm * falls
        joint[place, k] = p * (1 - found) * (1 - alarm)
        if place < k:
            joint[place, place] += p * found
    return entropy(joint.sum(axis=0)) + entropy(joint.sum(axis=1)) - entropy(joint.ravel())


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.booleans())
def test_information_is_what_its_definition_says(seed, k, alarms):
    """Each look may have false reports of its own, and cells that it does not show."""
    rng = np.random.default_rng(seed)
    here = rng.dirichlet(np.ones(k + 1), size=3)[:, :k]
    share, alarm, falls = rng.uniform(0.01, 0.99, size=(3, k)), rng.uniform(0.01, 0.9, size=3), np.zeros((3, k))
    if alarms:
        falls = rng.dirichlet(np.ones(k), size=3)
        falls[1, 1:2], share[1, 1:2] = 0.0, 0.0
        falls[1] /= falls[1].sum()
    alarm = alarm * alarms
    wanted = [by_definition(*four) for four in zip(here, share, alarm, falls, strict=True)]
    assert information(here, share, alarm, falls if alarms else None) == pytest.approx(wanted, abs=1e-9)
