"""The Habitat world with Habitat-Sim itself. Skipped where it is not installed: it is on no registry."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from rooms import two_rooms
from test_habitat_stand_in import (  # noqa: F401 (these with Habitat-Sim itself, too)
    test_an_exported_flat_comes_back_in_its_own_coordinates,
    test_our_tasks_keep_their_contract_in_it,
)

from eagor.errors import WorldError
from eagor.lab import worlds
from eagor.lab.envs.places import load_place
from eagor.lab.worlds.checking import check_world
from eagor.lab.worlds.glb import export_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.habitat import HOW_TO_GET, close_all

pytestmark = [
    pytest.mark.habitat,
    pytest.mark.skipif(find_spec("habitat_sim") is None, reason=f"Habitat-Sim is not installed; {HOW_TO_GET}"),
    pytest.mark.filterwarnings("default::DeprecationWarning"),  # its own, and those of its bindings
]
HERE = (2.0, 2.9, 1.25)


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


def test_the_red_chair_is_red(flat):
    frame = worlds.load(f"habitat:{flat}")(0).view().panorama(HERE, np.eye(3), 128)
    red = [index for index, thing in enumerate(two_rooms().instances) if thing.name == "red chair"]
    shown = frame.rgb[np.isin(frame.ids, red)].mean(axis=0)
    assert shown[0] > 2 * shown[1]


def test_its_ground_agrees_with_our_plan(flat):
    mesh, plan = load_place(f"habitat:{flat}", 0, 0.18).ground, Ground.from_scene(two_rooms(), radius=0.18)
    rng, gaps = np.random.default_rng(4), []
    for _ in range(40):
        one, other = mesh.sample(rng, 0.3), mesh.sample(rng, 0.3)
        assert mesh.is_free(one)
        assert mesh.height(one) == 0.0
        near, way = plan.snap(one, 0.1), float(mesh.field(one).distance(other))
        if near is not None and plan.is_free(other):
            gaps.append(float(plan.field(near).distance(other)) - way)
        path = mesh.path(one, other)
        np.testing.assert_array_equal([path[0], path[-1]], [one, other])
        assert float(np.hypot(*np.diff(path, axis=0).T).sum()) == pytest.approx(way, abs=0.02)
    assert np.abs(gaps).mean() < 0.05
    assert mesh.is_free(np.array([[np.nan, 0.0], [-5.0, 2.0], [4.0, 1.0]])).tolist() == [False] * 3
    assert float(mesh.field([2.0, 2.9]).distance([-5.0, 2.0])) == math.inf
    assert mesh.snap(np.array([np.nan, 0.0])) is None
    area = float(mesh.free.sum()) * mesh.cell**2
    ours = float(plan.free.sum()) * plan.cell**2
    assert 0.8 * ours < area < ours, "not the roof, which is larger; radii are rounded up to voxels"


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


def test_an_island_out_of_reach_has_no_path(tmp_path):
    """The doorway is bricked up: the larger room is the ground, and nothing leads to the other."""
    scene = two_rooms()
    vertices = scene.vertices.copy()
    lintel = (vertices[:, 0] > 3.9) & (vertices[:, 0] < 4.1) & (np.abs(vertices[:, 2] - 2.1) < 0.01)
    vertices[lintel, 2] = 0.0
    file = export_glb(replace(scene, vertices=vertices), tmp_path / "shut.glb")
    ground = load_place(f"habitat:{file}", 0, 0.18).ground
    inside, outside = (np.array([x, 2.9]) for x in ((2.0, 6.0) if ground.is_free([2.0, 2.9]) else (6.0, 2.0)))
    assert ground.is_free(inside)
    assert not ground.is_free(outside)
    assert float(ground.field(inside).distance(outside)) == math.inf


def test_a_bare_glb_on_its_side_is_told_and_put_upright(flat, tmp_path):
    bare = tmp_path / "flat.glb"
    bare.write_bytes(flat.read_bytes())
    with pytest.raises(WorldError, match=r"lie on its side|right way up"):
        worlds.load(f"habitat:{bare}")(0)
    check_world(worlds.load(f"habitat:{bare}?up=y"), 0)
    with pytest.warns(UserWarning, match="lie on its side .* say up=y"):
        worlds.load(f"habitat:{bare}?up=z")(0)


def lifted(metres):
    """The flat, this much higher."""
    scene, up = two_rooms(), np.array([0.0, 0.0, metres])
    instances = tuple(replace(thing, low=thing.low + up, high=thing.high + up) for thing in scene.instances)
    return replace(scene, vertices=scene.vertices + up.astype(np.float32), instances=instances)


def test_a_mesh_of_another_scene_is_told(flat, tmp_path):
    upstairs = load_place(f"habitat:{export_glb(lifted(1.5), tmp_path / 'upstairs.glb')}", 0, 0.18)
    upstairs.ground.pathfinder.save_nav_mesh(str(flat.with_suffix(".navmesh")))
    with pytest.raises(WorldError, match="no floor within"):
        worlds.load(f"habitat:{flat}")(0)


def test_scenes_take_turns_in_one_process(flat, bare, tmp_path):
    """More of them than may be open: Habitat-Sim ends a process that closes the one with the graphics context."""
    files = [flat, bare, export_glb(two_rooms(), tmp_path / "flat.glb")]
    scenes = [worlds.load(f"habitat:{file}")(0) for file in files]
    once, again = ([scene.view().panorama(HERE, np.eye(3), 32) for scene in scenes] for _ in range(2))
    for one, other in zip(once, again, strict=True):
        np.testing.assert_array_equal(one.rgb, other.rgb)
        np.testing.assert_array_equal(one.ids, other.ids)
    scenes[2].close()
    np.testing.assert_array_equal(scenes[1].view().panorama(HERE, np.eye(3), 32).range, once[1].range)


@pytest.mark.parametrize(
    ("content", "says"), [(b"glTF" + bytes(40), "cannot open the scene"), (b"no scene", "cannot open the scene")]
)
def test_a_damaged_scene_is_told_in_one_sentence(tmp_path, content, says):
    file = tmp_path / "broken.glb"
    file.write_bytes(content)
    with pytest.raises(WorldError, match=says) as raised:
        worlds.load(f"habitat:{file}")(0)
    assert "\n" not in str(raised.value)
