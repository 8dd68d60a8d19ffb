"""The Habitat world with Habitat-Sim itself. Skipped where it is not installed: it is on no registry."""

from __future__ import annotations

import json
import math
from importlib.util import find_spec

import numpy as np
import pytest
from rooms import two_rooms
from test_habitat_stand_in import (  # noqa: F401 (these with Habitat-Sim itself, too)
    test_a_scene_on_its_side_is_found_and_put_upright,
    test_an_exported_flat_comes_back_in_its_own_coordinates,
    test_our_tasks_keep_their_contract_in_it,
)

from eagor.lab import worlds
from eagor.lab.envs.places import load_place
from eagor.lab.worlds.checking import check_world
from eagor.lab.worlds.glb import export_glb
from eagor.lab.worlds.habitat import HOW_TO_GET, close_all

pytestmark = [
    pytest.mark.habitat,
    pytest.mark.skipif(find_spec("habitat_sim") is None, reason=f"Habitat-Sim is not installed; {HOW_TO_GET}"),
    pytest.mark.filterwarnings("default::DeprecationWarning"),  # its own, and those of its bindings
]


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """The little flat of boxes as an exported GLB file."""
    yield export_glb(two_rooms(), tmp_path_factory.mktemp("flat") / "flat.glb")
    close_all()


@pytest.fixture
def exact():
    """Habitat's depth is coarser; a thing is the smallest box around a point, not its triangle."""
    return 128, 0.01, 0.95


@pytest.fixture(scope="module")
def bare(flat, tmp_path_factory):
    """The same without anything but its axes: names come from nodes, ids from boxes."""
    file = tmp_path_factory.mktemp("bare") / "flat.glb"
    file.write_bytes(flat.read_bytes())
    stage = {"render_asset": file.name, "up": [0, 1, 0], "front": [0, 0, -1], "shader_type": "flat"}
    file.with_suffix(".stage_config.json").write_text(json.dumps(stage))
    return file


@pytest.mark.parametrize("which", ["flat", "bare"])
def test_the_world_keeps_the_contract_of_worlds(which, request):
    check_world(worlds.load(f"habitat:{request.getfixturevalue(which)}"), 1)


def test_a_stopped_body_can_step_away_from_the_wall_where_habitats_cannot(flat):
    """Why `move` ends a millimetre before the edge. If Habitat's body can leave it one day, that can go."""
    ground, rng, trapped = load_place(f"habitat:{flat}", 0, 0.18).ground, np.random.default_rng(7), 0

    def habitats(start, step):
        feet = ground.feet(start)
        end = ground.frames.to_habitat(np.array([*(start + step), 0.0]))
        tried = ground.pathfinder.try_step_no_sliding(feet, np.array([end[0], feet[1], end[2]], dtype=np.float32))
        return ground.frames.from_habitat(np.array(tried, dtype=np.float64))[:2]

    for _ in range(200):
        start, stopped = ground.sample(rng, 0.3), False
        step = 0.25 * np.array([math.cos(angle := rng.uniform(-math.pi, math.pi)), math.sin(angle)])
        while not stopped:  # until a wall
            before = start
            start, stopped = ground.move(before, step, slide=False)
        edge = habitats(before, step)
        if np.hypot(*(edge - before)) < 2e-3:  # it has stood there already
            continue
        assert 0.9e-3 < ground.pathfinder.distance_to_closest_obstacle(ground.feet(start), 1.0) < 1.2e-3
        back = 0.1 * (before - start) / np.hypot(*(before - start))  # the way it came
        end, stopped = ground.move(start, back, slide=False)
        assert not stopped
        np.testing.assert_array_equal(end, start + back)
        trapped += np.hypot(*(habitats(edge, back) - edge)) < 0.05
    assert trapped > 0, "Habitat's own step leads away from the edge: SHORT is no longer needed"
