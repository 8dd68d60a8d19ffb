"""habitat-lab as an oracle: its reader of ObjectNav episodes, and walks inside it.

habitat-lab imports Habitat-Sim, so both must be installed. Walks use its own simulator, with the configuration of
ObjectNav as it is: mesh, steps, distances and measures are all its own.
"""

import importlib.util
import json
import os
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

CONFIG = "benchmark/nav/objectnav/objectnav_hm3d.yaml"
NAMES = ("distance_to_goal", "success", "spl", "soft_spl")


def missing():
    """Why habitat-lab cannot be used here; None if it can."""
    for name in ("habitat_sim", "habitat"):
        if importlib.util.find_spec(name) is None:
            return f"{name} is not installed: habitat-lab and Habitat-Sim are needed, which are on no extra of ours"
    return None


def config(*overrides):
    """The configuration of ObjectNav on HM3D, with changes such as ``habitat.dataset.split=val``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of gym and of old interfaces
        from habitat.config.default import get_config

        return get_config(CONFIG, overrides=list(overrides))


def dataset(file, scenes):
    """The episodes of ``<split>.json.gz``, as habitat-lab reads them."""
    settings = config(
        f"habitat.dataset.data_path={Path(file).resolve()}", f"habitat.dataset.scenes_dir={Path(scenes).resolve()}"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from habitat.datasets import make_dataset

        return make_dataset(settings.habitat.dataset.type, config=settings.habitat.dataset)


STOP, FORWARD = 0, 1  # its actions; 2 and 3 are turns to the left and to the right
WITHIN = 0.1  # metres: habitat-lab's success_distance in ObjectNav
APART = 0.3  # metres between a view point that could not be reached and the next one that is tried
PATIENCE = 12  # actions without coming nearer until another view point is tried


def walked(file, out):
    """Every episode of ``<split>.json.gz``, walked by an oracle inside habitat-lab, as dicts; kept in the file `out`.

    Runs in a process of its own, in the folder that holds ``data``, as Habitat's examples do: only the path of the
    episodes is set (and the CPU, where there is no NVIDIA card). A walk has the ``scene_id``,
    the index of its ``episode`` in the scene, ``actions``, ``path`` ``(n, 3)``, ``metrics``, ``start_m`` (habitat-lab's
    distance at the start), and ``off_mesh``: how far the start and the farthest view point lie from habitat-lab's mesh.
    """
    if not Path(out).is_file():
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:  # Habitat may end its process
            pool.submit(_walk_all, str(Path(file).resolve()), str(Path(out).resolve())).result()
    return [json.loads(line) for line in Path(out).read_text().splitlines()]


def _walk_all(file, out):
    warnings.simplefilter("ignore")
    (data,) = (parent for parent in Path(file).parents if parent.name == "data")
    os.chdir(data.parent)
    device = [] if Path("/dev/nvidia0").exists() else ["habitat.simulator.habitat_sim_v0.gpu_device_id=-1"]
    settings = config(f"habitat.dataset.data_path={file}", *device)
    import habitat

    found = []
    with habitat.Env(settings) as env:
        for _ in env.episodes:
            env.reset()
            found.append(
                _walk(env) | {"scene_id": os.path.relpath(env.current_episode.scene_id, "data/scene_datasets")}
            )
    found.sort(key=lambda walk: (walk["scene_id"], walk["episode"]))
    Path(out).write_text("".join(json.dumps(walk) + "\n" for walk in found))


def _walk(env):
    """Follow the shortest path to the nearest view point; stop where habitat-lab says that success is near enough."""
    episode, pathfinder = env.current_episode, env.sim.pathfinder
    body = lambda: np.array(env.sim.get_agent_state().position, dtype=np.float64)  # noqa: E731
    left = lambda: float(env.get_metrics()["distance_to_goal"])  # noqa: E731
    views = np.array([view.agent_state.position for goal in episode.goals for view in goal.view_points])
    places = np.array([episode.start_position, *views], dtype=np.float32)
    away = np.linalg.norm(np.array([pathfinder.snap_point(place) for place in places]) - places, axis=1)
    actions, path, start_m = [], [body()], left()
    goals = _goals(env, path[0], views)
    goal, best, since = next(goals), np.inf, 0
    follower = _follower(env)
    while not env.episode_over and left() >= WITHIN:
        metres = env.sim.geodesic_distance(body(), goal)
        best, since = (metres, 0) if metres < best - 0.01 else (best, since + 1)
        action = None if since > PATIENCE else follower.get_next_action(goal)
        if action in (None, STOP):
            goal, best, since = next(goals, None), np.inf, 0
            if goal is None:
                break
            continue
        env.step(action)
        actions.append(int(action))
        path.append(body())
    if not env.episode_over:
        env.step(STOP)
        actions.append(STOP)
        path.append(body())
    metrics = {name: float(env.get_metrics()[name]) for name in NAMES}
    return {
        "episode": int(episode.episode_id), "category": episode.object_category, "actions": actions,
        "path": np.array(path).tolist(), "metrics": metrics, "start_m": start_m,
        "off_mesh": [float(away[0]), float(away[1:].max())],
    }  # fmt: skip


def _follower(env):
    from habitat.tasks.nav.shortest_path_follower import ShortestPathFollower

    return ShortestPathFollower(env.sim, goal_radius=0.02, return_one_hot=False)


def _goals(env, start, views):
    """View points from near to far along the floor: first some that are apart from each other, then all."""
    metres = np.array([env.sim.geodesic_distance(start, view) for view in views])
    near, tried = [views[index] for index in np.argsort(metres) if np.isfinite(metres[index])], []
    for view in near:
        if all(np.linalg.norm(view - one) >= APART for one in tried):
            tried.append(view)
            yield view.tolist()
    yield from (view.tolist() for view in near)


# --- our policy inside habitat-lab ---


def played(file, out, perception, episodes):
    """habitat-lab's measures of episodes that our agent (`eagor.lab.agents.habitat`) played, in its own process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:  # Habitat may end its process
        pool.submit(_play_all, str(Path(file).resolve()), str(Path(out).resolve()), perception, episodes).result()
    return json.loads(Path(out).read_text())


def _play_all(file, out, perception, episodes):
    warnings.simplefilter("ignore")
    (data,) = (parent for parent in Path(file).parents if parent.name == "data")
    os.chdir(data.parent)
    device = [] if Path("/dev/nvidia0").exists() else ["habitat.simulator.habitat_sim_v0.gpu_device_id=-1"]
    settings = config(f"habitat.dataset.data_path={file}", *device)
    import habitat
    from habitat.config import read_write
    from habitat.config.default_structured_configs import (
        HabitatSimEquirectangularDepthSensorConfig,
        HabitatSimEquirectangularRGBSensorConfig,
    )
    from omegaconf import OmegaConf

    from eagor.lab.agents.habitat import HabitatAgent, categories_of
    from eagor.perception import load

    place = {"height": 256, "width": 512, "position": [0.0, 0.88, 0.0]}
    depth = HabitatSimEquirectangularDepthSensorConfig(**place, max_depth=20.0, normalize_depth=False)
    with read_write(settings):
        sensors = settings.habitat.simulator.agents.main_agent.sim_sensors
        sensors.clear()
        sensors["rgb"] = OmegaConf.structured(HabitatSimEquirectangularRGBSensorConfig(**place))
        sensors["depth"] = OmegaConf.structured(depth)
    found = []
    with habitat.Env(settings) as env:
        agent = HabitatAgent(load(perception), categories_of(env))
        for _ in range(min(episodes, len(env.episodes))):
            observations, actions = env.reset(), []
            agent.reset()
            while not env.episode_over:
                actions.append(agent.act(observations)["action"])
                observations = env.step({"action": actions[-1]})
            metrics = {name: float(env.get_metrics()[name]) for name in NAMES}
            found.append({"category": env.current_episode.object_category, "actions": actions, "metrics": metrics})
    Path(out).write_text(json.dumps(found))
