"""habitat-lab as an oracle: its reader of ObjectNav episodes, and our policy inside it.

habitat-lab imports Habitat-Sim, so both must be installed. The policy plays in its own simulator, with the
configuration of ObjectNav but for the sensors: mesh, steps, distances and measures are all its own.
"""

import importlib.util
import json
import os
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

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
            start_m = float(env.get_metrics()["distance_to_goal"])
            agent.reset()
            while not env.episode_over:
                actions.append(agent.act(observations)["action"])
                observations = env.step({"action": actions[-1]})
            metrics = {name: float(env.get_metrics()[name]) for name in NAMES}
            found.append({"actions": actions, "metrics": metrics, "start_m": start_m})
    Path(out).write_text(json.dumps(found))
