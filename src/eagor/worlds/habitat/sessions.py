"""The simulators that are open in this process: made when they are needed, at most a few at a time, closed at the end.

A session is all that touches Habitat-Sim's simulator. Another session may close its simulator; the next look opens it
again. All simulators of a process draw with the graphics context of the first, and the process ends when one draws
after the first was closed. So the first is one without a scene, which is closed last.
"""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.habitat.configuring import FIRST_ROWS, KINDS, Source, configured, sensor_of
from eagor.worlds.habitat.probe import device_for, import_habitat

__all__ = ["Session", "close_all"]

MOST = 2  # simulators open at a time: each holds the textures of a whole building

_open: list[Session] = []  # least recently used first
_keeper: list[Any] = []  # a simulator without a scene, open as long as any other is


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
            device = device_for(asked.scene_id, asked.dataset, asked.gpu, asked.name)
            if not _keeper:
                _keeper.append(_made(Source("NONE"), device, 8, ("depth",)))
            self._sim = _made(asked, device)
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
                sim.add_sensor(sensor_of(habitat_sim, kind, rows))
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
        if not _open:
            _close_keeper()


def close_all() -> None:
    """Close all simulators of this process."""
    while _open:
        _open[0].close()
    _close_keeper()


def _close_keeper() -> None:
    while _keeper:
        _keeper.pop().close()


atexit.register(close_all)


def _made(source: Source, gpu: int, rows: int = FIRST_ROWS, kinds: Sequence[str] = KINDS) -> Any:
    habitat_sim = import_habitat()
    try:
        return habitat_sim.Simulator(configured(habitat_sim, source, gpu, rows, kinds))
    except Exception as error:  # C++ errors come as RuntimeError, among others
        raise WorldError(
            f"Habitat-Sim cannot open {source.name or source.scene_id!r} on device {gpu} ({type(error).__name__}: "
            f"{str(error).strip()[:300]}); is the scene complete?"
        ) from error
