"""A stand-in for the module habitat_sim, for machines without it.

It keeps Habitat-Sim's documented conventions, written down here once more and by other formulas than in the adapter: Y
up, the camera looks along -z with x to the right, depth along the axis of the face of a cube map, 0 where nothing is
hit, a bare GLB file taken for z up, quaternions. Its pictures and its ground are those of our own renderer and ground
plan. So it shows that the adapter fits these conventions; that they are Habitat-Sim's is shown with Habitat-Sim itself
(tests/contracts/test_habitat.py).
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from eagor.errors import WorldError
from eagor.lab.envs.places import load_place
from eagor.lab.worlds import habitat, objectnav
from eagor.lab.worlds.glb import import_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.habitat import world
from eagor.lab.worlds.render import Renderer

LIFT = 0.05  # metres: the mesh floats above the floor


class Vector3(tuple):
    def __new__(cls, *values):
        return super().__new__(cls, values)


class Quaternion:
    def __init__(self, vector, scalar):
        (self.x, self.y, self.z), self.w = vector, scalar


class Spec:
    pass


class Plan(Ground):
    """Ground whose fields are kept: paths are asked for to the same goals again and again."""

    def field(self, points, offsets=None):
        kept, key = self.__dict__.setdefault("fields", {}), np.asarray(points).tobytes()
        if offsets is not None:
            return super().field(points, offsets)
        if key not in kept:
            kept[key] = super().field(points)
        return kept[key]


class PathFinder:
    """One island on level ground, from our plan of the scene."""

    def __init__(self):
        self.is_loaded, self.ground = False, None

    def build(self, scene, settings):
        try:
            self.ground = Plan.from_scene(
                scene, cell=settings.cell_size, radius=settings.agent_radius, height=settings.agent_height,
                climb=settings.agent_max_climb,
            )  # fmt: skip
        except WorldError:
            return False
        self.nav_mesh_settings, self.is_loaded = settings, True
        return True

    num_islands = 1

    def island_area(self, island):
        return float(self.ground.free.sum()) * self.ground.cell**2

    def _corners(self):
        """Two triangles for each run of free cells along x, in Habitat's world."""
        ground = self.ground
        edges = np.diff(np.pad(ground.free, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        (rows, first), (_, last) = np.nonzero(edges == 1), np.nonzero(edges == -1)
        low = ground.origin + np.stack([first, rows], axis=-1) * ground.cell
        size = np.stack([last - first, np.ones_like(rows)], axis=-1) * ground.cell
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)])
        xy = (low[:, None] + square * size[:, None]).reshape(-1, 2)
        return [Vector3(x, self.ground.floor + LIFT, -y) for x, y in xy.tolist()]

    def build_navmesh_vertices(self, island):
        return self._corners()

    def build_navmesh_vertex_indices(self, island):
        return list(range(len(self._corners())))

    def _free(self, point):
        return bool(self.ground.is_free(np.array([point[0], -point[2]])))

    def is_navigable(self, point, most=0.5):
        return abs(point[1] - self.ground.floor - LIFT) <= most and self._free(point)

    def get_island(self, point):
        return 0

    def snap_point(self, point):
        """The nearest place on the mesh, from up to 2 m away in plan and 4 m in height."""
        found = self.ground.snap(np.array([point[0], -point[2]], dtype=float), within=2.0)
        if found is None or abs(point[1] - self.ground.floor - LIFT) > 4.0:
            return Vector3(math.nan, math.nan, math.nan)
        return Vector3(found[0], self.ground.floor + LIFT, -found[1])

    def try_step(self, start, end, slide=True):
        here = np.array([start[0], -start[2]], dtype=float)
        there = np.array([end[0], -end[2]], dtype=float)
        x, y = self.ground.move(here, there - here, slide=slide)[0]
        return Vector3(x, self.ground.floor + LIFT, -y)

    def try_step_no_sliding(self, start, end):
        return self.try_step(start, end, slide=False)

    def distance_to_closest_obstacle(self, point, most=2.0):
        """To the nearest square of a cell that is not free; the border of the plan is none."""
        ground = self.ground
        centres = ground.origin + (np.argwhere(~ground.free)[:, ::-1] + 0.5) * ground.cell
        off = np.maximum(np.abs(centres - [point[0], -point[2]]) - ground.cell / 2, 0)
        return min(most, float(np.hypot(*off.T).min()))

    def find_path(self, path):
        """Ends beside the mesh are moved onto it in plan, and keep their own heights, which count."""
        start, end = (self.snap_point(place) for place in (path.requested_start, path.requested_end))
        if math.isnan(start[0] + end[0]):
            return False
        way = self.ground.path(np.array([start[0], -start[2]]), np.array([end[0], -end[2]]))
        heights = np.full(len(way), self.ground.floor + LIFT)
        heights[0], heights[-1] = path.requested_start[1], path.requested_end[1]
        path.points = [Vector3(x, z, -y) for (x, y), z in zip(way.tolist(), heights.tolist(), strict=True)]
        path.geodesic_distance = float(np.linalg.norm(np.diff(path.points, axis=0), axis=1).sum())
        return True


class Sensor:
    def __init__(self, sim, spec):
        self.sim, self.spec = sim, spec

    def draw_observation(self):
        self.seen = self.sim.drawn(self.spec)

    def get_observation(self):
        return self.seen


class Simulator:
    """Simulators share the graphics context of the first: none may be used or closed once that one is closed."""

    opened = 0  # simulators that are open
    first = None  # the one that holds the context

    def __init__(self, configuration):
        self.configuration = configuration
        asked = configuration.sim_cfg
        assert not asked.allow_sliding
        assert asked.gpu_device_id == -1
        if asked.scene_id != "NONE":
            self.scene = _scene(Path(asked.scene_id), getattr(asked, "scene_dataset_config_file", "default"))
            self.renderer = Renderer(self.scene)
        self.pathfinder, self.semantic_scene = PathFinder(), None
        self.agents = [SimpleNamespace(scene_node=SimpleNamespace(translation=Vector3(0, 0, 0), rotation=None))]
        (agent,) = configuration.agents
        self.sensors = {spec.uuid: Sensor(self, spec) for spec in agent.sensor_specifications}
        Simulator.opened += 1
        Simulator.first = Simulator.first or self

    def close(self):
        Simulator.opened -= 1
        if Simulator.first is self:
            assert Simulator.opened == 0, "Habitat-Sim would end the process: the context of others is gone"
            Simulator.first = None

    def add_sensor(self, spec):
        assert spec.uuid not in self.sensors
        self.sensors[spec.uuid] = Sensor(self, spec)

    def recompute_navmesh(self, pathfinder, settings):
        return pathfinder.build(self.scene, settings)

    def get_stage_initialization_template(self):
        return SimpleNamespace(render_asset_handle="")

    def get_active_scene_graph(self):
        low, high = self.scene.vertices.min(axis=0), self.scene.vertices.max(axis=0)
        box = SimpleNamespace(min=(low[0], low[2], -high[1]), max=(high[0], high[2], -low[1]))
        return SimpleNamespace(get_root_node=lambda: SimpleNamespace(cumulative_bb=box))

    def drawn(self, spec):
        """What an equirectangular sensor shows: the pixels' rays turned by the quaternion, then looked up."""
        rows, columns = spec.resolution
        node = self.agents[0].scene_node
        longitude = ((np.arange(columns) + 0.5) / columns - 0.5) * 2 * math.pi  # to the right of the middle
        latitude = (0.5 - (np.arange(rows) + 0.5) / rows) * math.pi
        across, up = np.meshgrid(longitude, latitude)
        rays = np.stack([np.cos(up) * np.sin(across), np.sin(up), -np.cos(up) * np.cos(across)], axis=-1)
        turned = _rotated(node.rotation, rays)
        x, y, z = node.translation
        world = np.stack([turned[..., 0], -turned[..., 2], turned[..., 1]], axis=-1).reshape(-1, 3)
        origins = np.broadcast_to(np.array([x, -z, y], dtype=np.float32), world.shape)
        hits = self.renderer.raycaster.cast(origins, world.astype(np.float32))
        triangle = hits.triangle.reshape(rows, columns)
        if spec.sensor_type == "DEPTH":
            metres = hits.distance.reshape(rows, columns)
            return np.where(triangle >= 0, metres * np.abs(rays).max(axis=-1), 0).astype(np.float32)
        owners = np.append(self.scene.instance, -1)[triangle]
        if spec.sensor_type == "SEMANTIC":
            return (owners + 1).astype(np.uint32)
        shades = np.random.default_rng(0).integers(0, 256, (len(self.scene.instances) + 1, 4), dtype=np.uint8)
        return shades[owners]


def _rotated(quaternion, vectors):
    """Vectors turned by a quaternion: v + 2 w (q x v) + 2 q x (q x v)."""
    axis = np.array([quaternion.x, quaternion.y, quaternion.z])
    once = np.cross(axis, vectors)
    return vectors + 2 * (quaternion.w * once + np.cross(axis, once))


def _scene(file, dataset):
    """The scene of a file in our axes, laid on its side where Habitat takes z for up."""
    up = [0, 0, 1]
    if dataset != "default":  # its default attributes are for all scenes that it lists
        stages = json.loads(Path(dataset).read_text())["stages"]
        assert file in [Path(dataset).parent / each for each in stages["paths"][".glb"]]
        up = stages["default_attributes"]["up"]
    if file.name.endswith(".stage_config.json"):
        stage = json.loads(file.read_text())
        file, up = file.parent / stage["render_asset"], stage["up"]
    scene = import_glb(file)
    if up == [0, 1, 0]:
        return scene
    # The file's z is up, its y is ahead: our x, y, z become x, -z, y.
    vertices = np.stack([scene.vertices[:, 0], scene.vertices[:, 2], -scene.vertices[:, 1]], axis=1)
    return replace(scene, vertices=vertices)


class NavMeshSettings(SimpleNamespace):  # equal if all settings are
    def set_defaults(self):
        self.cell_size, self.cell_height, self.agent_height, self.agent_radius = 0.05, 0.2, 1.5, 0.1
        self.agent_max_climb, self.agent_max_slope, self.include_static_objects = 0.2, 45.0, False


def stand_in():
    kinds = SimpleNamespace(COLOR="COLOR", DEPTH="DEPTH", SEMANTIC="SEMANTIC")
    return SimpleNamespace(
        __spec__=None,
        EquirectangularSensorSpec=Spec,
        SensorType=kinds,
        SensorSubType=SimpleNamespace(EQUIRECTANGULAR="EQUIRECTANGULAR"),
        SimulatorConfiguration=Spec,
        Configuration=lambda sim_cfg, agents: SimpleNamespace(sim_cfg=sim_cfg, agents=agents),
        agent=SimpleNamespace(AgentConfiguration=Spec),
        Simulator=Simulator,
        PathFinder=PathFinder,
        NavMeshSettings=NavMeshSettings,
        ShortestPath=Spec,
    )


def installed(monkeypatch):
    """The life of a fixture in which this is Habitat-Sim; at its end no simulator is open."""
    monkeypatch.setitem(sys.modules, "habitat_sim", stand_in())
    monkeypatch.setitem(sys.modules, "magnum", SimpleNamespace(Vector3=Vector3, Quaternion=Quaternion, __spec__=None))
    monkeypatch.setattr(habitat, "device_for", lambda source: -1)
    monkeypatch.setattr(objectnav, "has_meshes", lambda: False)  # they are made in a process of its own
    yield
    habitat.close_all()
    world.open_scene.cache_clear()
    load_place.cache_clear()
    assert Simulator.opened == 0
