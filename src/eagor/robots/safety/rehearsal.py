"""A simulated Go2 in a process of its own, to walk with before a real one: its wire, its camera, the truth beside."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any, Self

import numpy as np

from eagor._processes import Worker, WorkerEnded, WorkerSilent
from eagor.conventions import rotation_from_wxyz
from eagor.errors import DeviceError
from eagor.media.ros_messages import TEXT
from eagor.robots.dds import Link, free_domain
from eagor.robots.go2.house import House, Thing
from eagor.robots.go2.sim import SimSettings
from eagor.robots.go2.sim_live import TRUTH, TRUTH_THINGS
from eagor.robots.go2.sim_pictures import CAMERA_TOPIC

__all__ = ["CAMERA", "INTERFACE", "Rehearsal", "clear_start"]

INTERFACE = "lo"
CAMERA = "ros:" + CAMERA_TOPIC.removeprefix("rt")
STARTING = 300.0  # seconds for the house and its light, on a busy machine
ENDING = 10.0
TRIES, ROOM, NEAR, FAR = 2000, 0.35, 2.5, 5.0  # draws; metres around the start; metres to the target
BEFORE = 0.8  # metres before the target's centre at which the way may end: things fill some floor


class Rehearsal:
    """A simulated Go2 on a free DDS domain of this machine; a context manager. It ends with this process.

    `truth()` is the camera's true place ``(3,)`` and orientation ``(3, 3)``, None before the first message;
    `targets()` the true places ``(n, 3)`` of the things that were asked for. Raises what the simulation raises.
    """

    def __init__(self, settings: SimSettings, domain: int | None = None) -> None:
        self.settings = settings
        self.domain = free_domain() if domain is None else domain
        self._pose: tuple[np.ndarray, np.ndarray] | None = None
        self._things: dict[str, Any] = {"targets": [], "things": []}
        self._worker: Worker | None = None

    def __enter__(self) -> Self:
        self._worker = Worker(_robot, self.settings, self.domain, name="simulated Go2", parent=True)
        try:
            self._worker.receive(STARTING)
        except WorkerSilent:
            self.close()
            raise DeviceError("the simulated robot does not start: it is not ready in time") from None
        except WorkerEnded:
            how = f"its process ended by itself (exit code {self._worker.close(ENDING)})"
            raise DeviceError(f"the simulated robot does not start: {how}") from None
        except BaseException:
            self.close()
            raise
        self._link = Link(self.domain, INTERFACE)
        self._link.subscribe(TRUTH, "nav_msgs/msg/Odometry", self._told_pose)
        self._link.subscribe(TRUTH_THINGS, TEXT, self._told_things, reliable=True, transient=True)
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()
        self.close()

    def close(self) -> None:
        """End the robot."""
        if self._worker is not None:
            self._worker.close(ENDING)

    def truth(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Where the camera really is, and how it is turned."""
        return self._pose

    def targets(self) -> np.ndarray:
        """Where the things that were asked for really are."""
        asked = {*self._things["targets"]}
        places = [thing["position"] for thing in self._things["things"] if thing["id"] in asked]
        return np.array(places, dtype=np.float64).reshape(-1, 3)

    def _told_pose(self, message: Any, _: float) -> None:
        pose = message.pose.pose
        turned = pose.orientation
        world_R_body = rotation_from_wxyz(np.array([turned.w, turned.x, turned.y, turned.z]))
        place = np.array([pose.position.x, pose.position.y, pose.position.z])
        mount = (0.0, 0.0, 0.0) if self.settings.camera is None else self.settings.camera.mount
        self._pose = place + world_R_body @ np.asarray(mount), world_R_body

    def _told_things(self, message: Any, _: float) -> None:
        self._things = json.loads(message.data)


def clear_start(house: House, targets: Sequence[Thing], rng: np.random.Generator) -> tuple[float, float, float] | None:
    """A place (x, y in metres) and a heading (radians) some metres from a target, with a straight way there.

    The policy goes straight, and around nothing. None if no such place was found.
    """
    ground = house.ground
    for _ in range(TRIES):
        spot = ground.sample(rng, min(ROOM, float(ground.clearance[ground.free].max())))
        for thing in targets:
            way = thing.centre[:2] - spot
            far = float(np.hypot(*way))
            if not NEAR <= far <= FAR:
                continue
            steps = np.arange(0.0, far - BEFORE, ground.cell / 2)[:, None] * way / far
            if bool(ground.is_free(spot + steps).all()):
                return float(spot[0]), float(spot[1]), float(rng.uniform(-math.pi, math.pi))
    return None


def _robot(line: Connection, settings: SimSettings, domain: int) -> None:
    """The life of the process."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, which is told as well
    from eagor.robots.go2.sim import SimulatedGo2
    from eagor.robots.go2.sim_live import LiveGo2

    with LiveGo2(SimulatedGo2(settings), domain, INTERFACE) as robot:
        robot.wait_for_camera()
        line.send(None)
        line.recv()  # until the parent closes it
