"""The Habitat world against a stand-in for Habitat-Sim: frames, depth, names, errors. It runs everywhere."""

from __future__ import annotations

import json
import math
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from habitat_stand_in import PathFinder, Simulator, installed
from rooms import two_rooms

from eagor.errors import EagorError, WorldError
from eagor.lab import worlds
from eagor.lab.envs.places import load_place
from eagor.lab.tasks.sim.rollout import check_simulation
from eagor.lab.tasks.task import load as load_task
from eagor.lab.worlds import habitat as adapter
from eagor.lab.worlds.checking import check_world
from eagor.lab.worlds.glb import export_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.habitat import (
    Frames,
    Source,
    device_for,  # itself: the stand-in puts another one into the module
    world,
)
from eagor.lab.worlds.habitat.navmesh import main_storey
from eagor.lab.worlds.habitat.world import parse
from eagor.lab.worlds.render import Renderer
from eagor.sphere import world_R_body


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """The little flat of boxes as a GLB file with its companions."""
    return export_glb(two_rooms(), tmp_path_factory.mktemp("flat") / "flat.glb")


@pytest.fixture
def exact():
    """Rows of a picture; most that the median range may be off from our renderer's; least share of equal ids."""
    return 32, 5e-5, 0.97  # boxes touch each other, and edges differ by rounding


@pytest.fixture(autouse=True)
def habitat(monkeypatch):
    yield from installed(monkeypatch)


def test_an_exported_flat_comes_back_in_its_own_coordinates(flat, exact):
    scene, ours = worlds.load(f"habitat:{flat}")(0), two_rooms()
    assert isinstance(scene, worlds.SimulatedScene)
    assert scene.frames.floor == 0.0
    for mine, thing in zip(scene.instances, ours.instances, strict=True):
        assert (mine.category, mine.colour, mine.room) == (thing.category, thing.colour, thing.room)
        np.testing.assert_allclose([mine.low, mine.high], [thing.low, thing.high], atol=1e-5)
    view, renderer, (rows, off, share) = scene.view(), Renderer(ours), exact
    for pose in (world_R_body(0.0), world_R_body(0.7), world_R_body(-2.0, 0.4, 0.3)):
        mine, truth = (each.panorama((2.0, 2.9, 1.25), pose, rows, rgb=False) for each in (view, renderer))
        assert np.median(np.abs(mine.range - truth.range) / truth.range) < off
        assert (mine.ids == truth.ids).mean() > share


def test_the_world_keeps_the_contract_of_worlds(flat):
    check_world(worlds.load(f"habitat:{flat}"), 1)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        pytest.param("waypoint", {"leg_steps": 5}, marks=pytest.mark.slow),  # its ground is the same
        ("navigation", {"max_steps": 80}),
        ("tracking", {"steps": 12}),
    ],
)
def test_our_tasks_keep_their_contract_in_it(flat, name, settings):
    found = check_simulation(load_task(name), f"habitat:{flat}", seed=2, settings=settings)
    assert found["success" if name == "navigation" else load_task(name).headline] == (
        1.0 if name == "navigation" else 0
    )


def test_its_ground_is_that_of_the_navigation_mesh(flat):
    mesh, plan = load_place(f"habitat:{flat}", 0, 0.18).ground, Ground.from_scene(two_rooms(), radius=0.18)
    rng = np.random.default_rng(4)
    for _ in range(20):
        one, other = mesh.sample(rng), mesh.sample(rng)
        assert mesh.is_free(one)
        way = float(mesh.field(one).distance(other))
        assert way == pytest.approx(float(plan.field(one).distance(other)), rel=0.03, abs=0.03)
        path = mesh.path(one, other)
        np.testing.assert_array_equal([path[0], path[-1]], [one, other])
    assert mesh.is_free(np.array([[np.nan, 0.0], [-5.0, 2.0], [4.0, 1.0]])).tolist() == [False] * 3
    assert float(mesh.field([2.0, 2.9]).distance([-5.0, 2.0])) == math.inf
    assert mesh.snap(np.array([np.nan, 0.0])) is None
    assert mesh.is_free(mesh.snap(np.array([-1.0, 2.0])))
    with pytest.raises(WorldError, match="not on the navigation mesh"):
        mesh.move(np.array([-5.0, 2.0]), np.array([0.1, 0.0]))
    with pytest.raises(WorldError, match="no path from"):
        mesh.path(np.array([2.0, 2.9]), np.array([-5.0, 2.0]))
    near, stopped = mesh.move(np.array([3.0, 2.9]), np.array([0.25, 0.0]), slide=False)
    assert not stopped
    np.testing.assert_array_equal(near, [3.25, 2.9])
    assert mesh.move(np.array([0.3, 2.9]), np.array([-0.25, 0.0]), slide=False)[1]


def test_things_are_named_by_a_semantic_json_or_by_nodes(flat, tmp_path):
    bare = tmp_path / "flat.glb"
    bare.write_bytes(flat.read_bytes())
    stage = json.loads(flat.with_suffix(".stage_config.json").read_text())
    bare.with_suffix(".stage_config.json").write_text(json.dumps(stage))
    named = worlds.load(f"habitat:{bare}")(0)
    assert {thing.room for thing in named.instances} == {None}
    assert "chair" in {thing.category for thing in named.instances}
    names = tmp_path / "mine.semantic.json"
    box = {"category": "chair", "low": [1.2, 3.9, 3.0], "high": [1.65, 4.35, 3.9]}
    for change, says in (({}, None), ({"high": [0, 0, 0]}, "a box from"), ({"colour": "mauve"}, "none of black")):
        names.write_text(json.dumps({"format": "eagor semantic 1", "instances": [box | change]}))
        if says is None:
            ((thing,), _, _) = world.things_of(None, None, names, Frames(3.0), dict)
            assert (thing.category, thing.colour) == ("chair", None)
            np.testing.assert_allclose([thing.low, thing.high], [[1.2, 3.9, 0.0], [1.65, 4.35, 0.9]])
        else:
            with pytest.raises(WorldError, match=f"cannot be used .*{says}"):
                world.things_of(None, None, names, Frames(3.0), dict)


def test_sides_of_boxes_that_habitat_puts_at_the_origin_are_those_of_what_is_seen():
    """As Habitat-Sim 0.3.4 does with all boxes of HM3D; what is seen nowhere is left out."""
    boxes = [("chair", (0, 0, -3), (2, 1, 0)), ("tv_monitor", (-1, 0, 0), (0, 2, 4)), ("bed", (0, 0, 0), (1, 1, 1))]
    objects = [
        SimpleNamespace(
            semantic_id=3 * k, category=SimpleNamespace(name=lambda word=word: word),
            aabb=SimpleNamespace(min=low, max=high),
        )
        for k, (word, low, high) in enumerate(boxes)
    ]  # fmt: skip
    seen = {0: np.array([[1.2, 0.3, -3.5], [1.9, 0.9, -2.0]]), 3: np.array([[-0.9, 0.1, 0.3], [-0.2, 1.9, 3.9]])}
    semantic = SimpleNamespace(objects=objects)
    (chair, tv), _, index = world.things_of(semantic, None, None, Frames(0.5), lambda: seen)
    assert (chair.category, tv.category, index.tolist()) == ("chair", "tv", [0, -1, -1, 1, -1])
    np.testing.assert_allclose([chair.low, chair.high], [[1.2, 2.0, -0.2], [2.0, 3.0, 0.5]])
    np.testing.assert_allclose([tv.low, tv.high], [[-1.0, -4.0, -0.4], [-0.2, -0.3, 1.5]])


def test_a_scene_on_its_side_is_found_and_put_upright(flat, tmp_path):
    bare = tmp_path / "flat.glb"
    bare.write_bytes(flat.read_bytes())
    bare.with_suffix(".semantic.json").write_bytes(flat.with_suffix(".semantic.json").read_bytes())
    with pytest.raises(WorldError, match=r"lie on its side|right way up"):
        worlds.load(f"habitat:{bare}")(0)
    check_world(worlds.load(f"habitat:{bare}?up=y"), 0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "wants habitat:SCENE"),
        ("nowhere.glb", "the scene 'nowhere.glb' is missing"),
        ("nowhere.glb?dataset=none.json", "configuration 'none.json' is missing"),
        ("x.glb?colour=red", r"unknown field `colour`; wanted dataset=FILE, storey"),
        ("x.glb?up=x", r"up`; wanted .*up=y or z"),
    ],
)
def test_what_cannot_be_opened_is_said_in_one_sentence(text, says):
    with pytest.raises(WorldError, match=says) as raised:
        worlds.load(f"habitat:{text}")(0)
    assert "\n" not in str(raised.value)


def test_the_scenes_own_mesh_is_taken_for_its_own_body_and_a_new_one_for_another(flat):
    for radius, used in ((0.18, True), (0.25, False)):
        own = PathFinder()
        own.is_loaded, own.nav_mesh_settings = True, SimpleNamespace(agent_radius=0.18)
        sim = SimpleNamespace(pathfinder=own, recompute_navmesh=lambda found, it: found.build(two_rooms(), it))
        found = world.mesh_for(parse(str(flat)), flat, sim, radius)
        assert (found is own) == used
        assert used or found.nav_mesh_settings.agent_radius == radius


class Levels:
    """A mesh with a square island for each (side, height), metres."""

    def __init__(self, *levels):
        self.levels, self.num_islands = levels, len(levels)

    def island_area(self, island):
        return self.levels[island][0] ** 2

    def build_navmesh_vertices(self, island):
        side, height = self.levels[island]
        return [(x, height, z) for x, z in ((0, 0), (side, 0), (side, side), (0, side))]

    def build_navmesh_vertex_indices(self, island):
        return [0, 1, 2, 0, 2, 3]


@pytest.mark.parametrize(
    ("height", "island"),
    [(3.0, 1), (2.8, 0), (2.95, 1), (0.1, 2), (0.3, 2)],
    ids=["the floor, not the larger roof", "the roof", "the floor's main part", "downstairs", "not the table"],
)
def test_the_storey_is_the_nearest_one(height, island):
    roof, floor, ground, closet, table = (12.0, 2.8), (9.0, 3.05), (10.0, 0.05), (1.5, 3.0), (0.8, 0.3)
    found, _ = main_storey(Levels(roof, floor, ground, closet, table), lambda feet: 1.0, height)
    assert found == island


def test_the_simulator_with_the_graphics_context_is_closed_before_the_next_opens(flat, tmp_path):
    scenes = [worlds.load(f"habitat:{file}")(0) for file in (flat, *(_copy(flat, tmp_path / name) for name in "ab"))]
    for scene in (*scenes, *scenes):
        scene.view().panorama((2.0, 2.9, 1.25), np.eye(3), 16)
        assert Simulator.opened == 1
    for scene in scenes:
        scene.close()
    assert Simulator.opened == 0


def _copy(file, folder):
    """A scene with its companions, in another folder."""
    shutil.copytree(file.parent, folder)
    return folder / file.name


# --- the probe ---


@pytest.mark.parametrize(
    ("module", "device", "says"),
    [
        (None, -1, r"needs Habitat-Sim .* aihabitat .* from the sources"),
        ("raise ImportError('numpy is too old')", -1, r"cannot be imported \(ImportError: numpy is too old\)"),
        ("import os, sys; print('no EGL devices', file=sys.stderr)\ndef __getattr__(name): os._exit(1)", -1,
         r"cannot draw on the CPU \(no EGL devices\): it needs EGL"),
        ("import os, sys; print('unable to find CUDA device', file=sys.stderr)\ndef __getattr__(name): os._exit(1)", 3,
         r"cannot draw on GPU 3 \(unable to find CUDA device\)"),
    ],
)  # fmt: skip
def test_the_probe_tells_why_a_process_ended(monkeypatch, tmp_path, module, device, says):
    if module is None:
        monkeypatch.delitem(sys.modules, "habitat_sim")
        monkeypatch.setattr(adapter, "find_spec", lambda name: None)
    else:
        (tmp_path / "habitat_sim.py").write_text(module)
        monkeypatch.syspath_prepend(tmp_path)
    device_for.cache_clear()
    with pytest.raises(EagorError, match=says) as raised:
        device_for(Source("scene.glb", gpu=device))
    assert "\n" not in str(raised.value)
