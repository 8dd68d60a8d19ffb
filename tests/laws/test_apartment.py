"""What every generated apartment has to be, whatever its seed."""

from collections import Counter
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import at_most

from eagor.lab.envs.places import UNTARGETED
from eagor.lab.worlds.apartment import CATEGORIES, REQUIRED, VERSION, build, generate
from eagor.lab.worlds.apartment.building import carve
from eagor.lab.worlds.apartment.furniture import KINDS
from eagor.lab.worlds.apartment.placement import corners, distances, from_rectangle, overlaps
from eagor.lab.worlds.apartment.plans import FAMILIES, LINING, OUTSIDE, draw_plan
from eagor.lab.worlds.ground import BESIDE, Ground
from eagor.lab.worlds.scene import STRUCTURE

SEEDS = (0, 3, 5, 1007)
seeds = pytest.mark.parametrize("seed", SEEDS)
scene = cache(lambda seed: apartment(seed)[2])
apartment = cache(build)  # the plan, the pieces, and the scene


def furniture(seed):
    """Each piece with its instance, which the scene lists last."""
    _, pieces, made = apartment(seed)
    return list(zip(pieces, made.instances[-len(pieces) :], strict=True))


@given(st.integers(0, 10**6))
@at_most(40)
def test_a_plan_divides_a_rectangle_into_rooms_that_doors_join(seed):
    plan = draw_plan(np.random.default_rng(seed))
    kinds = {space.kind for space in plan.spaces}
    assert {"living room", "bedroom", "bathroom", "kitchen"} <= kinds
    assert 3 <= len(plan.spaces) <= 7
    parts = np.array([part for space in plan.spaces for part in space.rectangles])
    area = (parts[:, 2] - parts[:, 0]) * (parts[:, 3] - parts[:, 1])
    width, depth = plan.extent
    assert area.sum() == pytest.approx(width * depth, rel=1e-9)
    boxes = np.array([from_rectangle(part) for part in parts]) - [0, 0, 1e-6, 1e-6, 0]
    assert (overlaps(boxes, boxes) == np.eye(len(parts), dtype=bool)).all()
    joined = [*plan.open_to, *(tuple(d.boundary.rooms) for d in plan.doorways if OUTSIDE not in d.boundary.rooms)]
    reached = {0}
    for _ in plan.spaces:
        reached |= {other for pair in joined if reached & set(pair) for other in pair}
    assert reached == set(range(len(plan.spaces)))
    assert sum(OUTSIDE in d.boundary.rooms for d in plan.doorways) == 1
    for doorway in plan.doorways:
        assert 0.8 - 1e-6 <= doorway.end - doorway.start - 2 * LINING <= 1.0 + 1e-6
    assert 45 - 1e-6 <= sum(room.area for room in carve(plan).rooms) <= 111
    for window in plan.windows:
        assert sum(room == OUTSIDE for room in window.boundary.rooms) == 1


def test_the_same_seed_gives_the_same_scene():
    again = generate(0)
    assert again.hash == scene(0).hash
    assert again.source == f"apartment {VERSION} seed 0"
    assert again.facts["family"] in FAMILIES
    assert again.hash != scene(SEEDS[3]).hash


@seeds
def test_required_categories_and_structure(seed):
    made = scene(seed)
    count = Counter(thing.category for thing in made.instances)
    assert set(REQUIRED) <= set(count)
    assert set(count) <= set(CATEGORIES)
    for category in ("wall", "floor", "ceiling"):
        owners = Counter(thing.room for thing in made.instances if thing.category == category)
        assert owners == Counter(room.name for room in made.rooms)
    assert count["window"] >= 2
    assert count["chair"] >= 3
    assert len(made.triangles) < 60_000
    assert set(np.unique(made.instance)) == set(range(len(made.instances)))
    for room in made.rooms:  # a lamp in each, below the ceiling
        lit = [lamp for lamp in made.lamps if room.contains(*lamp.position[:2])]
        assert lit
        assert all(0 < lamp.position[2] < made.vertices[:, 2].max() for lamp in lit)


@seeds
def test_names_can_be_told_apart_and_confused(seed):
    things = [piece for piece, _ in furniture(seed) if piece.solid]
    names, categories = Counter(piece.name for piece in things), Counter(piece.category for piece in things)
    assert sum(names[p.name] == 1 and categories[p.category] > 1 for p in things) >= 3
    assert any(count > 1 for count in names.values())
    seen = Counter(thing.name for thing in scene(seed).instances if thing.category not in STRUCTURE)
    assert all(seen[each] == count for each, count in names.items())


@seeds
def test_no_two_solid_pieces_share_space(seed):
    things = [
        (piece, thing)
        for piece, thing in furniture(seed)
        if piece.solid or piece.category in ("painting", "ceiling lamp")
    ]  # but rugs and what stands on others
    boxes = np.array([piece.box for piece, _ in things])
    heights = np.array([(thing.low[2], thing.high[2]) for _, thing in things])
    hit = overlaps(boxes, boxes)
    hit &= (heights[:, None, 0] < heights[None, :, 1] - 1e-3) & (heights[None, :, 0] < heights[:, None, 1] - 1e-3)
    np.fill_diagonal(hit, False)
    assert [(things[i][1].name, things[j][1].name) for i, j in np.argwhere(hit)] == []


@seeds
def test_pieces_keep_to_their_footprints_rooms_and_heights(seed):
    plan, _, made = apartment(seed)
    for place, (piece, thing) in enumerate(furniture(seed), len(made.instances) - len(furniture(seed))):
        assert (thing.category, thing.colour) == (piece.category, piece.model.colour)
        room = made.rooms[piece.room]
        assert thing.room == room.name
        points = made.vertices[np.unique(made.triangles[made.instance == place])]
        assert distances(piece.box, points[:, :2].astype(float)).max() < 2e-3
        assert points[:, 2].min() >= -1e-4
        assert points[:, 2].max() <= plan.height + 1e-3
        if KINDS[piece.category].placement in ("floor", "top"):
            assert points[:, 2].min() == pytest.approx(piece.z, abs=1e-3)
        grown = room.rectangles + np.array([-2e-3, -2e-3, 2e-3, 2e-3])
        x, y = corners(piece.box, 4)[0].T[:, :, None]
        inside = (grown[:, 0] <= x) & (x <= grown[:, 2]) & (grown[:, 1] <= y) & (y <= grown[:, 3])
        assert inside.any(axis=1).all(), (piece.category, room.name)


@pytest.mark.parametrize("seed", [*SEEDS, 1016, 1864, 4406])
def test_whatever_can_be_a_target_has_free_ground_beside_it(seed):
    made = scene(seed)
    ground = Ground.from_scene(made)
    targets = [thing for thing in made.instances if thing.category not in UNTARGETED]
    assert len(targets) >= 12
    for thing in targets:
        assert ground.beside(thing)[1].min() <= BESIDE, thing.name
