"""The ground plan: where a body can stand, how far it is to walk, what a step comes to."""

import math
from functools import lru_cache

import numpy as np
import pytest
from box_scenes import scene_of, shell, thing
from hypothesis import given
from hypothesis import strategies as st
from strategies import at_most

from eagor.errors import WorldError
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.navmesh import sees, walls_below
from eagor.lab.worlds.scene import Room

CELL, RADIUS = 0.05, 0.18
seeds = st.integers(0, 2**32 - 1)


def plan(*things, width=8.0, depth=6.0, rooms=(), **options):
    return Ground.from_scene(scene_of([*shell(width, depth), *things], rooms), **options)


@lru_cache
def cluttered(number):
    """A room with furniture of any size anywhere, some of it turned."""
    rng = np.random.default_rng(number)
    things = []
    for _ in range(12):
        low, size = rng.uniform(0, 5.5, size=2), rng.uniform(0.02, 1.2, size=2)
        things.append(thing("cabinet", (*low, 0), (*(low + size), rng.uniform(0.2, 2.0))))
    scene = scene_of([*shell(6.0, 6.0), *things])
    vertices = scene.vertices
    for i in range(6):  # the first six of them, about their own centres
        part = slice(8 * (5 + i), 8 * (6 + i))
        angle = rng.uniform(0, np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        middle = vertices[part, :2].mean(axis=0)
        vertices[part, :2] = (vertices[part, :2] - middle) @ turn.T + middle
    return Ground.from_scene(scene)


worlds = st.integers(0, 7).map(cluttered)


def length(path):
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


# --- occupancy ---


def test_what_is_low_or_high_is_no_obstacle_and_the_rest_is():
    ground = plan(
        thing("rug", (1, 1, 0), (2, 2, 0.02)),
        thing("door", (3, 1, 0), (4, 1.1, 0.03)),  # a threshold
        thing("ceiling lamp", (5, 1, 1.8), (6, 2, 2.4)),
        thing("table", (1, 4, 0.7), (2, 5, 0.75)),
        thing("door", (4, 4, 0), (4.04, 4.8, 2.0)),  # an open leaf
    )
    assert ground.is_free(np.array([[1.5, 1.5], [3.5, 1.05], [5.5, 1.5]])).all()
    blocked = np.array([[1.5, 4.5], [0.9, 4.5], [4.02, 4.4], [4.12, 4.4], [0.1, 3.0], [-0.5, 3.0], [np.nan, 1.0]])
    assert not ground.is_free(blocked).any()
    assert ground.is_free([0.75, 4.5])
    assert ground.is_free([4.3, 4.4])
    walls = ground.centres(np.argwhere(ground.structure))
    assert np.hypot(*(walls - (4.02, 4.4)).T).min() < CELL
    assert np.hypot(*(walls - (1.5, 4.5)).T).min() > 1.0


def test_a_floor_is_found_at_any_height_and_holes_are_no_floor():
    boxes = shell(4.0, 4.0)
    table = thing("table", (1, 1, 0.6), (2, 2, 0.7))
    up = np.array([0, 0, 3.3])
    lifted = [
        thing(t.category, t.low + up, t.high + up) for t in [*boxes, table, thing("ceiling", (0, 0, 2.5), (4, 4, 2.6))]
    ]
    level, raised = Ground.from_scene(scene_of([*boxes, table])), Ground.from_scene(scene_of(lifted))
    assert (level.floor, raised.floor) == (0.0, pytest.approx(3.3))
    assert np.array_equal(level.free, raised.free)
    parts = [thing("floor", (0, 0, -0.1), (2, 4, 0)), thing("floor", (2.1, 0, -0.1), (4, 4, 0))]
    crack = Ground.from_scene(scene_of([*parts, *boxes[1:]]))  # a missing sill
    assert crack.is_free([2.05, 2.0])
    parts[1] = thing("floor", (2.5, 0, -0.1), (4, 4, 0))
    pit = Ground.from_scene(scene_of([*parts, *boxes[1:]]))
    assert not pit.is_free([2.25, 2.0])
    assert not pit.is_free([3.0, 2.0])  # the larger side is the island


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: plan(floor=2.0), "no level surface near z = 2"),
        (lambda: plan(width=0.3, depth=0.3), "nowhere"),
        (lambda: Ground.from_scene(scene_of([thing("floor", (0, 0, -1), (500, 500, 0))])), "raise cell"),
        (lambda: plan(climb=2.0), "wanted a cell above 0"),
        (lambda: open_room().field([2.0, 2.0], offsets=np.array([np.nan])), "finite metres"),
        (lambda: open_room().move([-3.0, 0.5], [0.1, 0.0]), "not free ground"),
        (lambda: open_room().move([np.nan, 0.5], [0.1, 0.0]), "not free ground"),
        (lambda: open_room().move([6.0, 0.5], [np.inf, 0.0]), "finite"),
    ],
)
def test_what_is_no_ground_and_no_step_is_refused(make, says):
    with pytest.raises(WorldError, match=says):
        make()


# --- distances ---


@lru_cache
def open_room():
    return plan(width=13.0, depth=13.0)


def closed_corner():
    """Two yards that meet at a corner closed from both sides, and are joined by a way round."""
    free = np.zeros((24, 24), dtype=bool)
    free[2:12, 2:12] = free[12:22, 12:22] = True
    free[2:4, 12:22] = free[4:12, 20:22] = True
    return Ground(np.zeros(2), 0.05, 0.0, 0.0, free, np.where(free, 0.05, 0.0), np.zeros_like(free))


def test_no_way_leads_through_a_closed_corner():
    ground = closed_corner()
    inner, outer = np.array([0.585, 0.585]), np.array([0.615, 0.615])  # on either side of the corner (0.6, 0.6)
    assert ground.is_free([inner, outer]).all()
    around = float(ground.field(outer).distance(inner))
    assert around > 1.0
    assert length(ground.path(inner, outer)) == pytest.approx(around, abs=0.05)
    # Nor does the distance of one side bleed into that of the other.
    assert ground.field(inner).distance(inner) < 0.03
    assert ground.field(inner).distance(outer) > 1.0
    for slide in (True, False):
        end, collided = ground.move([0.56, 0.56], [0.08, 0.08], slide)
        assert collided
        assert (end < 0.6).all()
    walls = walls_below(ground.free)
    assert not sees(walls, np.array([11.5, 11.5]), np.array([[12.5, 12.5]]))
    assert sees(walls, np.array([2.5, 2.5]), np.array([[11.5, 11.5]]))
    # Open from one side, it is a way.
    ground.free[12, 11] = True
    opened = Ground(np.zeros(2), 0.05, 0.0, 0.0, ground.free, ground.clearance, ground.structure)
    assert opened.field(outer).distance(inner) < 0.2
    assert (opened.move([0.585, 0.585], [0.03, 0.03])[0] > 0.6).all()


@at_most(40)
@given(seeds)
def test_round_the_end_of_a_wall_it_is_two_tangents_and_an_arc(seed):
    ground = divided()
    rng = np.random.default_rng(seed)
    a, b = rng.uniform((0.3, 0.3), (3.7, 4.2)), rng.uniform((4.3, 0.3), (7.7, 4.2))
    legs, arcs = 0.1, 0.0  # over the end of the wall, which is 0.1 m thick
    for point, corner, side in ((a, (3.95, 4.5), -1), (b, (4.05, 4.5), 1)):
        across, down = side * (point[0] - corner[0]), corner[1] - point[1]
        reach = math.hypot(across, down)
        legs += math.sqrt(reach**2 - RADIUS**2)
        # From straight above the corner round to where the tangent to the point touches.
        arcs += max(0.0, math.pi / 2 + math.atan2(down, across) - math.acos(RADIUS / reach)) * RADIUS
    truth = legs + arcs
    found = ground.field(b).distance(a)
    assert truth - CELL <= found <= 1.01 * truth + CELL
    assert truth - CELL <= length(ground.path(a, b)) <= found + 0.02


@lru_cache
def divided():
    return plan(thing("wall", (3.95, 0, 0), (4.05, 4.5, 2.5)))


@at_most(40)
@given(worlds, seeds)
def test_distances_are_a_metric(ground, seed):
    rng = np.random.default_rng(seed)
    a, b, c = (ground.sample(rng) for _ in range(3))
    to_a, to_b = ground.field(a), ground.field(b)
    assert to_a.distance(b) == pytest.approx(float(to_b.distance(a)), abs=CELL)
    assert to_a.distance(c) <= to_a.distance(b) + to_b.distance(c) + CELL
    assert to_a.distance(b) >= math.dist(a, b) - 0.6 * CELL
    assert to_a.distance(a) <= CELL
    finite = np.isfinite(to_a.metres)
    assert np.array_equal(finite, ground.free)
    points = rng.uniform(-1, 7, size=(200, 2))
    assert np.array_equal(np.isfinite(to_a.distance(points)), ground.is_free(points))


# --- footprints ---


@pytest.mark.parametrize("thick", [0.1, 0.02])
def test_a_wall_is_no_way_to_what_stands_or_hangs_behind_it(thick):
    wall = thing("wall", (4 - thick, 0, 0), (4, 4.5, 2.5), "right")
    painting = thing("painting", (4, 2, 1.2), (4.03, 2.8, 1.8), "right")
    cabinet = thing("cabinet", (4, 0.5, 0), (4.5, 1.5, 0.9), "right")
    rooms = (
        Room("left", "study", np.array([[0, 0, 4 - thick / 2, 6.0]])),
        Room("right", "study", np.array([[4 - thick / 2, 0, 8, 6.0]])),
    )
    # Without rooms, it takes a wall that is thicker than a cell and a half to tell its sides apart.
    plans = [plan(wall, painting, cabinet, rooms=known) for known in ([rooms, ()] if thick > 0.08 else [rooms])]
    for ground, goal in [(ground, goal) for ground in plans for goal in (painting, cabinet)]:
        field = ground.footprint(goal)
        y = goal.centre[1]
        front = goal.high[0] + 0.5
        assert field.distance([front, y]) == pytest.approx(0.5, abs=0.02)
        behind = math.hypot(1.0, 4.7 - y) + math.hypot(0.5, 4.7 - goal.high[1])
        assert field.distance([3.0, y]) == pytest.approx(behind, abs=0.35)


def test_without_a_free_cell_beside_it_the_nearest_of_the_room_counts_and_none_is_no_way():
    # A vase in the middle of a table two metres deep; and one in a closed room.
    table, vase = thing("table", (4, 2, 0), (6, 4, 0.8)), thing("vase", (4.95, 2.95, 0.8), (5.05, 3.05, 1.0))
    wall = thing("wall", (2, 0, 0), (2.1, 6, 2.5))
    shut = thing("chair", (1, 3, 0), (1.4, 3.4, 0.9), "shut")
    rooms = (
        Room("shut", "study", np.array([[0, 0, 2, 6.0]])),
        Room("open", "study", np.array([[2, 0, 8, 6.0]])),
    )
    for known in ((), rooms):
        ground = plan(table, vase, wall, shut, rooms=known)
        field = ground.footprint(vase)
        assert field.distance([3.5, 3.0]) == pytest.approx(1.45, abs=0.06)
        assert np.isinf(ground.footprint(shut).metres).all()
        assert not np.isnan(field.metres).any()
        assert np.isinf(field.union(ground.footprint(shut)).distance([1.0, 1.0]))


# --- paths and steps ---


@at_most(40)
@given(worlds, seeds)
def test_a_path_is_as_long_as_the_field_says_and_can_be_walked_without_touching_anything(ground, seed):
    rng = np.random.default_rng(seed)
    a, b = ground.sample(rng), ground.sample(rng)
    path = ground.path(a, b)
    assert np.allclose(path[0], a)
    assert np.allclose(path[-1], b)
    told = float(ground.field(b).distance(a))
    assert 0.97 * told - CELL <= length(path) <= told + CELL
    here = path[0]
    for corner in path[1:]:
        while math.dist(here, corner) > 1e-6:
            step = corner - here
            here, collided = ground.move(here, step * min(1.0, 0.25 / math.hypot(*step)), slide=False)
            assert not collided


@at_most(30)
@given(worlds, seeds, st.booleans(), st.sampled_from([0.05, 0.25, 1.0]))
def test_no_walk_goes_through_anything_or_farther_than_its_steps(ground, seed, slide, stride):
    rng = np.random.default_rng(seed)
    here, heading = ground.sample(rng), 0.0
    for _ in range(60):
        heading += rng.normal() * 0.5
        step = stride * np.array([math.cos(heading), math.sin(heading)])
        there, collided = ground.move(here, step, slide)
        assert ground.is_free(there)
        assert math.dist(here, there) <= stride + 1e-9
        # Sliding does not go back: the way has no part against the step beyond that of going round corners.
        assert (there - here) @ step >= -1e-9
        if not collided:
            assert np.allclose(there, here + step)
        if not slide:
            assert abs(np.cross(np.append(there - here, 0), np.append(step, 0))[2]) < 1e-9
        here = there


# --- points ---


@given(worlds, seeds)
def test_snapping_finds_the_nearest_free_point(ground, seed):
    rng = np.random.default_rng(seed)
    point = rng.uniform(-1, 7, size=2)
    found = ground.snap(point)
    assert ground.is_free(found)
    away = math.dist(point, found)
    centres = ground.centres(np.argwhere(ground.free))
    assert away <= np.hypot(*(centres - point).T).min() + 1e-6
    assert away >= np.hypot(*(centres - point).T).min() - CELL
    assert ground.snap(point, within=away * 0.99 - 1e-9) is None or away == 0
    assert np.array_equal(ground.snap(found), found)
