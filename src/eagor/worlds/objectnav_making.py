"""Object-goal episodes for a scene: goals with the places from which they are seen, and starts with distances.

The rules are those of HM3D's ObjectNav episodes (Yadav et al., Habitat-Matterport 3D Semantics Dataset, 2023): view
points are free places near the thing from which it is in sight; the start is 1 to 30 m from the nearest of them along
the floor; where the scene has such starts, this way is at least 5 % longer than the straight line.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.ground import Ground
from eagor.worlds.habitat_mesh import ON_MESH, roomy_radius
from eagor.worlds.objectnav import HM3D_CATEGORIES, Episode, Goal, Origin, goal_of, spelt
from eagor.worlds.objectnav_json import read_category
from eagor.worlds.render import Renderer
from eagor.worlds.scene import STRUCTURE, Scene
from eagor.worlds.semantic_glb import FIRST_ID

__all__ = ["make_episodes", "make_goals"]

SPACING = 0.1  # metres between view points: no place among them is farther than 0.1 m, the usual threshold, from one
EYE = 0.88  # metres above the floor: height of the camera of the ObjectNav challenges
ROWS = 64  # of the panoramas that decide whether a thing is in sight
PIXELS = 2  # of them that show a thing in sight
NEAREST, FARTHEST = 1.0, 30.0  # metres from the start to the nearest view point, along the floor
RATIO = 1.05  # least ratio of that way to the straight line


def roomy_ground(scene: Scene, ground: Ground) -> Ground:
    """The part of the ground that is also on habitat-lab's mesh, and connected there, whatever Recast rounds."""
    return Ground.from_scene(scene, cell=ground.cell, radius=roomy_radius(ground.radius), floor=ground.floor)


def make_goals(scene: Scene, ground: Ground, categories: Sequence[str] = ()) -> dict[str, tuple[Goal, ...]]:
    """The things of these categories with their view points, by category. `instance` is the id in Habitat.

    View points lie on the mesh that habitat-lab makes of the exported scene, in one piece of it (`roomy_ground`). By
    default those of HM3D's six categories that the scene has. Things that are in sight from nowhere near are left
    out. Raises `WorldError` if nothing is left of a category that was asked for, or of all.
    """
    present = {thing.category for thing in scene.instances if thing.category not in STRUCTURE}
    asked = [read_category(category) for category in categories]
    wanted = asked or [name for name in map(read_category, HM3D_CATEGORIES) if name in present]
    lacking = [name for name in wanted if name not in present]
    if lacking or not wanted:
        what = ", ".join(lacking) if lacking else f"none of {', '.join(HM3D_CATEGORIES)}"
        raise WorldError(f"{scene.source} has {'no ' * bool(lacking)}{what}; it has {', '.join(sorted(present))}")
    renderer = Renderer(scene)
    roomy = roomy_ground(scene, ground)
    seen: dict[tuple[float, float], np.ndarray] = {}
    goals = {}
    for category in dict.fromkeys(wanted):
        found = []
        for index, thing in enumerate(scene.instances):
            if thing.category == category:
                goal = _in_sight(goal_of(scene, roomy, index, SPACING), index, renderer, seen)
                found += [goal] if len(goal.view_positions) else []
        if found:
            goals[category] = tuple(found)
        elif asked:
            raise WorldError(f"no {category} of {scene.source} is in sight from a free place beside it; ask for others")
    if not goals:
        raise WorldError(f"none of the {', '.join(wanted)} of {scene.source} is in sight from a free place beside it")
    return goals


def _in_sight(goal: Goal, index: int, renderer: Renderer, seen: dict[tuple[float, float], np.ndarray]) -> Goal:
    """The goal with its id in Habitat, and those view points from which it is seen; `seen`: the ids by place.

    Its places are on the floor, those of the result on habitat-lab's mesh.
    """
    shown = np.zeros(len(goal.view_positions), dtype=bool)
    for row, (x, y, z) in enumerate(goal.view_positions.tolist()):
        if (x, y) not in seen:
            ids = renderer.panorama((x, y, z + EYE), np.eye(3), ROWS, rgb=False, range=False).ids
            assert ids is not None
            seen[x, y] = np.bincount(ids.ravel() + 1, minlength=len(renderer.scene.instances) + 1)[1:]
        shown[row] = seen[x, y][index] >= PIXELS
    return Goal(
        goal.category, index + FIRST_ID, goal.position, f"{spelt(goal.category)}_{index + FIRST_ID}", goal.room,
        goal.view_positions[shown] + [0.0, 0.0, ON_MESH], goal.view_rotations[shown], goal.view_overlap[shown],
    )  # fmt: skip


def make_episodes(
    scene: Scene,
    ground: Ground,
    goals: Mapping[str, Sequence[Goal]],
    count: int,
    file: str,
    dataset_config: str,
    seed: int = 0,
) -> tuple[Episode, ...]:
    """So many episodes, one category after the other; `file` is the scene_id. The same arguments give the same ones.

    Raises `WorldError` if no start is far enough from a category's view points.
    """
    rng = np.random.default_rng([zlib.crc32(scene.hash.encode()), seed])
    points = roomy_ground(scene, ground).points
    starts, ways = {}, {}
    for category, things in goals.items():
        ways[category] = [ground.field(thing.view_positions[:, :2]) for thing in things]
        nearest = ways[category][0].union(*ways[category][1:]).distance(points)
        views = np.concatenate([thing.view_positions[:, :2] for thing in things])
        straight = np.array([np.hypot(*(views - point).T).min() for point in points])
        fits = np.flatnonzero((nearest >= NEAREST) & (nearest <= FARTHEST))
        if len(fits) == 0:
            raise WorldError(
                f"every place in {scene.source} is nearer than {NEAREST:g} m to a {category}, or has no way to one; "
                "ask for other categories"
            )
        bent = fits[nearest[fits] >= RATIO * straight[fits]]
        starts[category] = (bent if len(bent) else fits), nearest, straight
    episodes = []
    for number in range(count):
        category = list(goals)[number % len(goals)]
        fits, nearest, straight = starts[category]
        index = int(rng.choice(fits))
        yaw, (x, y) = float(rng.uniform(-np.pi, np.pi)), points[index]
        cos, sin = np.cos(yaw), np.sin(yaw)
        closest = int(np.argmin([way.distance(points[index]) for way in ways[category]]))
        room = scene.room_at(float(x), float(y))
        episodes.append(
            Episode(
                scene=file,
                category=category,
                position=np.array([x, y, ground.floor + ON_MESH]),
                world_R_body=np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]]),
                identifier=str(number),
                geodesic=float(nearest[index]),
                euclidean=float(straight[index]),
                nearest=goals[category][closest].instance,
                room=room.name if room else None,
                origin=Origin(scene.hash, scene.source, ground.radius, ground.cell),
                dataset_config=dataset_config,
            )
        )
    return tuple(episodes)
