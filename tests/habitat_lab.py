"""habitat-lab as an oracle: its reader of ObjectNav episodes, and its measures of a path.

habitat-lab imports Habitat-Sim, so both must be installed. The simulator that its measures ask is replaced by a body
that stands where it is put, and a function for the distance along the floor.
"""

import importlib.util
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from eagor.conventions import from_gltf, to_gltf
from eagor.tasks.episode_files import FileSlot, slot_of
from eagor.tasks.places import load_place

CONFIG = "benchmark/nav/objectnav/objectnav_hm3d.yaml"
NAMES = {"distance_to_goal": "distance_to_goal", "success": "success", "spl": "spl", "soft_spl": "soft_spl"}


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


def geodesic(ground):
    """Distances over a ground of ours, between points of Habitat's: ``(position, points) -> metres``."""
    known = {}

    def distance(position, points):
        ends = from_gltf(np.asarray(points, dtype=np.float64))[:, :2]
        if ends.tobytes() not in known:
            known[ends.tobytes()] = ground.field(ends)
        return float(known[ends.tobytes()].distance(from_gltf(np.asarray(position, dtype=np.float64))[:2]))

    return distance


def measured(episode, path, stopped, distance, success_distance):
    """habitat-lab's measures of a path ``(n, 3)`` in its world frame, which ended with a stop or not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from habitat.core.embodied_task import Measurements
        from habitat.core.registry import registry

    settings = config(f"habitat.task.measurements.success.success_distance={success_distance}")
    body = SimpleNamespace(position=np.asarray(path[0]))
    simulator = SimpleNamespace(
        get_agent_state=lambda: body, geodesic_distance=lambda position, points, episode: distance(position, points)
    )
    made = []
    for name in NAMES:
        chosen = settings.habitat.task.measurements[name]
        made.append(registry.get_measure(chosen.type)(simulator, chosen))
    task = SimpleNamespace(measurements=Measurements(made), is_stop_called=False, add_perf_timing=lambda *_: None)
    task.measurements.reset_measures(episode=episode, task=task)
    start = float(task.measurements.measures["distance_to_goal"].get_metric())
    for index, position in enumerate(path[1:], start=1):
        body.position = np.asarray(position)
        task.is_stop_called = stopped and index == len(path) - 1
        task.measurements.update_measures(episode=episode, action=None, task=task)
    return {name: float(task.measurements.measures[name].get_metric()) for name in NAMES} | {"shortest_m": start}


def differences(settings, records, found):
    """By unit of work: ours and habitat-lab's measures of each recorded path of a run, by name."""
    by_scene = {}
    for episode in found.episodes:
        by_scene.setdefault(Path(episode.scene_id).name, []).append(episode)
    rows = {}
    for record in records:
        slot = slot_of(record["episode"]["slot"])
        assert isinstance(slot, FileSlot)
        theirs = by_scene[Path(slot.scene).name][slot.episode]
        distance = geodesic(load_place(slot.world, slot.seed, settings["camera"]["radius"]).ground)
        for method, entry in record["methods"].items():
            ours = {name: entry["metrics"][name] for name in (*NAMES, "shortest_m")}
            # Ours ends on arrival or never: with a stop at the end theirs must come to the same.
            limit = settings["rules"]["success_distance"]
            said = measured(theirs, to_gltf(np.array(entry["path"])), True, distance, limit)
            rows[f"{slot.id}/{method}"] = ours, said
    return rows
