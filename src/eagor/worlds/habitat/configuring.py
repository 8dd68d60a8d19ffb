"""What a simulator of Habitat-Sim is made of: the scene, the device, equirectangular sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["FIRST_ROWS", "KINDS", "Source", "configured", "sensor_of"]

FIRST_ROWS = 64  # of the sensors with which a simulator is made; others are added when they are asked for
KINDS = ("color", "depth", "semantic")


@dataclass(frozen=True)
class Source:
    """What Habitat-Sim opens: `scene_id`, the scene dataset's configuration, and the GPU (None: found by the probe).

    `name`: the same in every process, unlike the path of a written stage configuration.
    """

    scene_id: str
    dataset: str = "default"
    gpu: int | None = None
    name: str = ""


def configured(habitat_sim: Any, source: Source, gpu: int, rows: int = FIRST_ROWS, kinds: Sequence[str] = KINDS) -> Any:
    """The configuration of a simulator with equirectangular sensors at the agent's origin, without sliding.

    With a sensor of colour, each simulator prepares lights: on the CPU, that takes most of the time that it starts.
    """
    settings = habitat_sim.SimulatorConfiguration()
    settings.scene_id = source.scene_id
    settings.scene_dataset_config_file = source.dataset
    settings.gpu_device_id = gpu
    settings.allow_sliding = False
    settings.enable_physics = False
    settings.random_seed = 0
    agent = habitat_sim.agent.AgentConfiguration()
    agent.sensor_specifications = [sensor_of(habitat_sim, kind, rows) for kind in kinds]
    return habitat_sim.Configuration(settings, [agent])


def sensor_of(habitat_sim: Any, kind: str, rows: int) -> Any:
    """An equirectangular sensor of this kind at the agent's origin."""
    spec = habitat_sim.EquirectangularSensorSpec()
    spec.uuid = f"{kind} {rows}"
    spec.sensor_type = getattr(habitat_sim.SensorType, kind.upper())
    spec.sensor_subtype = habitat_sim.SensorSubType.EQUIRECTANGULAR
    spec.resolution = [rows, 2 * rows]
    spec.position = [0.0, 0.0, 0.0]  # floats: whole numbers are refused
    spec.channels = 4 if kind == "color" else 1
    return spec
