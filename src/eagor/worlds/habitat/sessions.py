"""The simulators that are open in this process: made when they are needed, at most a few at a time, closed at the end.

A session is all that touches Habitat-Sim's simulator. Another session may close its simulator; the next look opens it
again.
"""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.habitat.probe import device_for, import_habitat

__all__ = ["Session", "Source", "close_all", "configured"]

MOST = 2  # simulators open at a time: each holds the textures of a whole building
FIRST_ROWS = 64  # of the sensors with which a simulator is made; others are added when they are asked for
KINDS = ("color", "depth", "semantic")

_open: list[Session] = []  # least recently used first


@dataclass(frozen=True)
class Source:
    """What Habitat-Sim opens: `scene_id`, the scene dataset's configuration, and the GPU (None: found by the probe).

    `name`: the same in every process, unlike the path of a written stage configuration.
    """

    scene_id: str
    dataset: str = "default"
    gpu: int | None = None
    name: str = ""


class Session:
    """One scene, whose simulator is opened on demand."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self._sim: Any = None
        self._sensors: dict[tuple[str, int], str] = {}

    @property
    def sim(self) -> Any:
        """The simulator (`habitat_sim.Simulator`). Raises `WorldError` if it cannot be made."""
        if self._sim is None:
            while len(_open) >= MOST:
                _open[0].close()
            asked = self.source
            self._sim = _made(asked, device_for(asked.scene_id, asked.dataset, asked.gpu, asked.name))
            self._sensors = {(kind, FIRST_ROWS): f"{kind} {FIRST_ROWS}" for kind in KINDS}
        else:
            _open.remove(self)
        _open.append(self)
        return self._sim

    def look(
        self, kinds: Sequence[str], rows: int, position: np.ndarray, quaternion: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Equirectangular pictures by kind ("color", "depth", "semantic"), of `rows` rows, in Habitat's world.

        `position` ``(3,)`` and `quaternion` ``(4,)``, w first, of the camera.
        """
        import magnum  # pyright: ignore[reportMissingImports]

        sim = self.sim
        for kind in kinds:
            if (kind, rows) not in self._sensors:
                habitat_sim = import_habitat()
                sim.add_sensor(_sensor(habitat_sim, kind, rows))
                self._sensors[kind, rows] = f"{kind} {rows}"
        body = sim.agents[0].scene_node
        w, x, y, z = (float(value) for value in quaternion)
        body.translation = magnum.Vector3(*(float(value) for value in position))
        body.rotation = magnum.Quaternion(magnum.Vector3(x, y, z), w)
        registry = getattr(sim, "sensors", None) or sim._sensors  # 0.3.3 has no public name for it
        sensors = {kind: registry[self._sensors[kind, rows]] for kind in kinds}
        for sensor in sensors.values():
            sensor.draw_observation()
        return {kind: sensor.get_observation() for kind, sensor in sensors.items()}

    def close(self) -> None:
        """Close the simulator, if it is open."""
        if self._sim is not None:
            _open.remove(self)
            sim, self._sim, self._sensors = self._sim, None, {}
            sim.close()


def close_all() -> None:
    """Close all simulators of this process."""
    while _open:
        _open[0].close()


atexit.register(close_all)


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
    agent.sensor_specifications = [_sensor(habitat_sim, kind, rows) for kind in kinds]
    return habitat_sim.Configuration(settings, [agent])


def _sensor(habitat_sim: Any, kind: str, rows: int) -> Any:
    spec = habitat_sim.EquirectangularSensorSpec()
    spec.uuid = f"{kind} {rows}"
    spec.sensor_type = getattr(habitat_sim.SensorType, kind.upper())
    spec.sensor_subtype = habitat_sim.SensorSubType.EQUIRECTANGULAR
    spec.resolution = [rows, 2 * rows]
    spec.position = [0.0, 0.0, 0.0]  # floats: whole numbers are refused
    spec.channels = 4 if kind == "color" else 1
    return spec


def _made(source: Source, gpu: int) -> Any:
    habitat_sim = import_habitat()
    try:
        return habitat_sim.Simulator(configured(habitat_sim, source, gpu))
    except Exception as error:  # C++ errors come as RuntimeError, among others
        raise WorldError(
            f"Habitat-Sim cannot open {source.name or source.scene_id!r} on device {gpu} ({type(error).__name__}: "
            f"{str(error).strip()[:300]}); is the scene complete?"
        ) from error
