"""What a simulated Go2 lets programs switch: the services ``robot_state`` and ``motion_switcher``.

Programs of Unitree's SDK that command motors release the mode of motion first, or switch off ``sport_mode``; the joints
are limp then, and nobody answers commands to walk until a mode is selected again.
"""

from __future__ import annotations

import json
from typing import Any

from eagor.robots.go2.plant import LIMP, Plant

__all__ = ["SERVICES", "VERSIONS", "ServiceError", "Switches"]

VERSIONS = {
    "sport": "1.0.0.1", "obstacles_avoid": "1.0.0.2", "robot_state": "1.0.0.1", "motion_switcher": "1.0.0.1",
}  # fmt: skip
MODES = ("normal", "ai", "mcf", "advanced")  # of motion; the first is on at the start
# Names of services, and whether they are protected from being switched off.
SERVICES = {"sport_mode": False, "obstacles_avoid": False, "robot_state": True, "motion_switcher": True}
WALKS = {"sport": "sport_mode", "obstacles_avoid": "obstacles_avoid"}  # the service behind a topic
NOT_KNOWN = 3203
SWITCH_FAILED, MODE_NOT_KNOWN = 5201, 7004
PROTECTED = 5  # status of a service that cannot be switched


class ServiceError(Exception):
    """A request that is refused with a code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class Switches:
    """Which services of a robot with this body run, and in which mode of motion it is ("": released)."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.mode, self._silent = MODES[0], False
        self._on = dict.fromkeys(SERVICES, True)

    def answers(self, topic: str) -> bool:
        """Whether somebody answers requests to a service by its topic ("sport")."""
        name = WALKS.get(topic, topic)
        return self._on[name] and (bool(self.mode) or topic not in WALKS)

    def obey(self, topic: str, api_id: int, asked: dict[str, Any]) -> str:
        """The data of the response. Raises `ServiceError`; `KeyError`, `ValueError` for what is not understood."""
        return (self._robot_state if topic == "robot_state" else self._motion)(api_id, asked)

    def _robot_state(self, api_id: int, asked: dict[str, Any]) -> str:
        if api_id == 1001:
            name, on = str(asked["name"]), bool(int(asked["switch"]))
            if name not in SERVICES:
                raise ServiceError(SWITCH_FAILED)
            if not SERVICES[name]:
                self._switch(name, on)
                self.mode = self.mode or (MODES[0] if name == "sport_mode" and on else "")
            return json.dumps({"name": name, "status": PROTECTED if SERVICES[name] else int(on)})
        if api_id == 1003:
            return json.dumps(
                [{"name": name, "status": int(self._on[name]), "protect": int(SERVICES[name])} for name in SERVICES]
            )
        raise ServiceError(NOT_KNOWN)

    def _motion(self, api_id: int, asked: dict[str, Any]) -> str:
        if api_id == 1001:
            return json.dumps({"form": "0", "name": self.mode})
        if api_id == 1002:
            if asked["name"] not in MODES:
                raise ServiceError(MODE_NOT_KNOWN)
            self.mode = asked["name"]
            self._switch("sport_mode", True)
        elif api_id == 1003:
            self.mode = ""
            self._switch("sport_mode", False)
        elif api_id == 1004:
            self._silent = bool(asked["silent"])
        elif api_id == 1005:
            return json.dumps({"silent": self._silent})
        else:
            raise ServiceError(NOT_KNOWN)
        return ""

    def _switch(self, name: str, on: bool) -> None:
        self._on[name] = on
        if name == "sport_mode":
            if not on:
                self._plant.damp()
            elif self._plant.mode == LIMP:  # somebody holds the joints again, where they are
                self._plant.stand_down()
        else:
            self._plant.stop()
