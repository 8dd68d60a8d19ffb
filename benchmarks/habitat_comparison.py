"""Our world against Habitat-Sim, in the same apartments: pictures, distances, steps, speed.

    python benchmarks/habitat_comparison.py [--parts pictures ground speed] [--seeds 3 17]

Needs Habitat-Sim. Each apartment is exported to GLB with `export_glb(annotated=True)` and opened as ``habitat:FILE``.

- pictures: panoramas of both from 20 poses, half of them tilted. Range: the relative difference of each pixel. Corners:
  where a corner of a thing's box is in sight on the outline of the thing, its direction in both pictures of ids.
- ground: geodesic distances between random pairs of points that are free in both; and two greedy followers, Habitat's
  and ours, with Habitat's actions (0.25 m, 10 degrees) from point to point.
- speed: RGB, range and ids at 256 x 512, CPU seconds per frame of one process each, which take turns.

`habitat_tasks.py` plays the tasks in both.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import common
import numpy as np
from habitat_places import Both, free_in_both, need_habitat, opened

from eagor import worlds
from eagor.grids import ErpGrid
from eagor.sphere import unit, world_R_body
from eagor.tasks.places import APARTMENT
from eagor.worlds import view_of
from eagor.worlds.scene import STRUCTURE
from eagor.worlds.walkable import Walkable

EYE = 1.25  # metres: the camera's height
FINE = 1024  # rows of the pictures in which corners are looked for
WINDOW = math.radians(3.0)  # about a corner
PARTS = ("pictures", "ground", "speed")


# --- pictures ---


def pictures(both: Both, count: int, corners: int, rng: np.random.Generator) -> dict[str, Any]:
    """Differences of ranges (relative) and of the directions of corners (degrees)."""
    ranges, alike, angles = [], [], []
    for number in range(count):
        position = np.array([*free_in_both(both, rng), EYE])
        tilt = rng.uniform(-0.4, 0.4, 2) * (number % 2)
        pose = world_R_body(float(rng.uniform(-math.pi, math.pi)), *tilt.tolist())
        mine, other = (
            view.panorama(position, pose, 256, rgb=False) for view in (both.ours.renderer, both.theirs.renderer)
        )
        hit = np.isfinite(mine.range) & np.isfinite(other.range)
        ranges.append(np.abs(mine.range[hit] - other.range[hit]) / mine.range[hit])
        alike.append(float((mine.ids == other.ids).mean()))
        wanted = math.ceil(corners * (number + 1) / count) - len(angles)
        angles += corner_errors(both, position, pose, wanted, rng)
    ranges = np.concatenate(ranges)
    return {
        "poses": count,
        "range_median_percent": 100 * float(np.median(ranges)),
        "range_p95_percent": 100 * float(np.quantile(ranges, 0.95)),
        "ids_alike_percent": 100 * float(np.mean(alike)),
        "corners": len(angles),
        "corner_median_deg": float(np.median(angles)),
        "corner_p95_deg": float(np.quantile(angles, 0.95)),
        "corner_max_deg": float(np.max(angles)),
    }


def corner_errors(
    both: Both, position: np.ndarray, pose: np.ndarray, count: int, rng: np.random.Generator
) -> list[float]:
    """The angles (degrees) between both pictures of up to `count` corners in sight from this pose."""
    scene, grid = both.ours.scene, ErpGrid(FINE, 2 * FINE)
    mine, other = (
        view.panorama(position, pose, FINE, rgb=False, range=False).ids
        for view in (both.ours.renderer, both.theirs.renderer)
    )
    found: list[float] = []
    things = [k for k, thing in enumerate(scene.instances) if thing.category not in STRUCTURE]
    for thing in rng.permutation(things).tolist():
        box = scene.instances[thing]
        vertices = scene.vertices[np.unique(scene.triangles[scene.instance == thing])]
        for choice in rng.permutation(8).tolist():
            if len(found) >= count:
                return found
            corner = np.where([choice & 1, choice & 2, choice & 4], box.high, box.low)
            if np.abs(vertices - corner).max(axis=1).min() > 0.005:  # the box has it, the thing does not
                continue
            way = pose.T @ (corner - position)
            if not 0.6 < np.linalg.norm(way) < 8.0:
                continue
            places = [tip(ids == thing, grid, unit(way)) for ids in (mine, other)]
            if places[0] is not None and places[1] is not None:
                found.append(math.degrees(2 * math.asin(min(1.0, float(np.linalg.norm(places[0] - places[1])) / 2))))
    return found


def tip(mask: np.ndarray, grid: ErpGrid, corner: np.ndarray) -> np.ndarray | None:
    """The direction ``(3,)`` of a corner in a mask ``(H, W)``: the outermost pixels close to where it should be.

    None if the corner is hidden, or not on the outline.
    """
    x, y, _ = grid.project(corner)
    half = math.ceil(WINDOW / math.pi * FINE)
    if not half < y < FINE - half:
        return None
    rows = np.arange(int(y) - half, int(y) + half + 1)
    cols = np.arange(int(x) - half, int(x) + half + 1) % (2 * FINE)
    part, directions = mask[np.ix_(rows, cols)], grid.directions[np.ix_(rows, cols)]
    near = directions @ corner > math.cos(WINDOW)
    inside = part & near
    share = inside.sum() / near.sum()
    if not 0.02 < share < 0.4:  # of the disc: hidden, or no corner
        return None
    outwards = corner - directions[inside].mean(axis=0)
    along = directions[inside] @ outwards
    best = directions[inside][np.argsort(-along)[:3]].mean(axis=0)
    off = math.acos(min(1.0, float(unit(best) @ corner)))
    return unit(best) if off < WINDOW / 3 else None  # else something hides it


# --- ground ---


def ground(both: Both, pairs: int, followed: int, rng: np.random.Generator) -> dict[str, Any]:
    """Geodesic distances and path lengths of followers in both."""
    metres, mine, theirs = [], both.ours.ground, both.theirs.ground
    while len(metres) < pairs:
        one, other = free_in_both(both, rng), free_in_both(both, rng)
        if np.hypot(*(one - other)) < 1.0:
            continue
        metres.append([float(mine.field(one).distance(other)), float(theirs.field(one).distance(other))])
    ours, habitat = np.array(metres).T
    gaps = 100 * np.abs(ours - habitat) / habitat
    lengths = []
    while len(lengths) < followed:
        one, other, yaw = free_in_both(both, rng), free_in_both(both, rng), float(rng.uniform(-math.pi, math.pi))
        if np.hypot(*(one - other)) < 2.0:
            continue
        both_ways = follow(mine, one, yaw, other), habitat_follower(both, one, yaw, other)
        if None not in both_ways:
            lengths.append(both_ways)
    our_way, their_way = np.array(lengths).sum(axis=0)
    return {
        "pairs": pairs,
        "geodesic_median_percent": float(np.median(gaps)),
        "geodesic_p95_percent": float(np.quantile(gaps, 0.95)),
        "geodesic_max_percent": float(gaps.max()),
        "followed": len(lengths),
        "follower_ours_m": float(our_way),
        "follower_habitat_m": float(their_way),
        "follower_difference_percent": 100 * float(our_way / their_way - 1),
    }


GOAL = 0.25  # metres from the goal at which followers stop
STEP, TURN = 0.25, math.radians(10.0)


def follow(ground: Walkable, start: np.ndarray, yaw: float, goal: np.ndarray) -> float | None:
    """Metres that a greedy follower walks: turn towards the path until half a turn is left, step, and so on."""
    xy, walked, way = start, 0.0, ground.field(goal)
    for _ in range(2000):
        if float(way.distance(xy)) < GOAL:
            return walked
        path = ground.path(xy, goal)
        ahead = path[1] if np.hypot(*(path[1] - xy)) > 1e-3 or len(path) == 2 else path[2]
        left = math.remainder(math.atan2(*(ahead - xy)[::-1]) - yaw, 2 * math.pi)
        if abs(left) > TURN / 2:
            yaw += math.copysign(TURN, left)
            continue
        there, _ = ground.move(xy, STEP * np.array([math.cos(yaw), math.sin(yaw)]), slide=True)
        walked += float(np.hypot(*(there - xy)))
        xy = there
    return None


def habitat_follower(both: Both, start: np.ndarray, yaw: float, goal: np.ndarray) -> float | None:
    """Metres that Habitat's own greedy follower walks over its mesh."""
    import habitat_sim

    scene: Any = both.theirs.scene
    mesh: Any = both.theirs.ground
    sim = scene.session.sim
    if sim.config.sim_cfg.scene_id not in _MESHED:
        sim.recompute_navmesh(sim.pathfinder, mesh.pathfinder.nav_mesh_settings)
        _MESHED.add(sim.config.sim_cfg.scene_id)
    agent = sim.agents[0]
    w, x, y, z = scene.frames.quaternion(world_R_body(yaw))
    agent.set_state(habitat_sim.AgentState(position=mesh.feet(start), rotation=[x, y, z, w]))
    follower = habitat_sim.GreedyGeodesicFollower(sim.pathfinder, agent, goal_radius=GOAL)
    walked, target = 0.0, mesh.feet(goal)
    for _ in range(2000):
        try:
            action = follower.next_action_along(target)
        except habitat_sim.errors.GreedyFollowerError:
            return None
        if action is None:
            return walked
        before = agent.get_state().position
        agent.act(action)
        walked += float(np.linalg.norm((agent.get_state().position - before)[[0, 2]]))
    return None


_MESHED: set[str] = set()

# --- speed ---


def speed(both: Both, rounds: int, frames: int, rng: np.random.Generator) -> dict[str, Any]:
    """CPU milliseconds per frame in both, in processes that take turns."""
    poses = [
        (np.array([*free_in_both(both, rng), EYE]), world_R_body(float(yaw))) for yaw in rng.uniform(-3, 3, frames)
    ]
    context = multiprocessing.get_context("spawn")
    seats = []
    for world, seed in ((APARTMENT, both.seed), (both.world, 0)):
        here, there = context.Pipe()
        process = context.Process(target=_render, args=(there, world, seed, poses), daemon=True)
        process.start()
        seats.append((here, process))
    spent: list[list[float]] = [[], []]
    try:
        for line, _ in seats:
            line.recv()
        for _ in range(rounds):
            for index, (line, _) in enumerate(seats):
                line.send(True)
                spent[index].append(line.recv())
    finally:
        for line, process in seats:
            line.close()
            process.join(20)
            process.kill()
    (ours, habitat) = (1000 * np.array(each) / frames for each in spent)
    ratios = habitat / ours
    return {
        "rounds": rounds,
        "frames": frames,
        "ours_cpu_ms": float(np.median(ours)),
        "habitat_cpu_ms": float(np.median(habitat)),
        "ratio": float(np.median(ratios)),
        "ratio_range": [float(ratios.min()), float(ratios.max())],
    }


def _render(line: Any, world: str, seed: int, poses: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Render all poses whenever the line asks for it; answer with CPU seconds."""
    view = view_of(worlds.load(world)(seed))
    for position, pose in poses[:2]:
        view.panorama(position, pose, 256)
    line.send(None)
    while True:
        try:
            line.recv()
        except EOFError:
            return
        began = time.process_time()
        for position, pose in poses:
            view.panorama(position, pose, 256)
        line.send(time.process_time() - began)


def main() -> int:
    options = common.parser(__doc__)
    options.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    options.add_argument("--seeds", nargs="+", type=int, default=[3, 17])
    options.add_argument("--poses", type=int, default=20, help="of each apartment")
    options.add_argument("--pairs", type=int, default=200)
    options.add_argument("--rounds", type=int, default=10)
    given = options.parse_args()
    need_habitat()
    parts = {
        "pictures": lambda both, rng: pictures(both, given.poses, 200, rng),
        "ground": lambda both, rng: ground(both, given.pairs, 20, rng),
        "speed": lambda both, rng: speed(both, given.rounds, 8, rng),
    }
    with tempfile.TemporaryDirectory() as folder:
        both = [opened(seed, Path(folder)) for seed in given.seeds]
        for part in given.parts:
            found = {each.seed: parts[part](each, np.random.default_rng(each.seed)) for each in both}
            print(json.dumps({part: found}, indent=1), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
