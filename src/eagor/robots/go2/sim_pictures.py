"""The process that draws a simulated Go2's pictures and sends them: drawing must not hold up 200 states per second."""

from __future__ import annotations

import signal
import time
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from eagor._processes import Worker, WorkerEnded
from eagor.errors import DeviceError, EagorError
from eagor.media import Pose
from eagor.robots.go2.sim import CameraSettings
from eagor.worlds.render import Ball

__all__ = ["CAMERA_FRAME", "CAMERA_TOPIC", "Moment", "PictureProcess"]

CAMERA_TOPIC = "rt/x3/image/compressed"  # /x3/image/compressed in ROS
CAMERA_FRAME = "x3_link"
LOADING = 300.0  # seconds for the scene and its light
ENDING = 5.0  # seconds for the process to leave by itself


class Moment(NamedTuple):
    """When and where a picture is taken: the host's clock, the camera's pose, the ball."""

    stamp: float
    pose: Pose
    ball: Ball | None


class PictureProcess:
    """A process with a renderer of its own, which writes `CAMERA_TOPIC`.

    `offer` gives it a moment if it is idle; moments that come while it draws are `skipped`. It ends with this one.
    """

    def __init__(self, world: str, seed: int, camera: CameraSettings, domain: int, interface: str | None) -> None:
        self.skipped = self.drawn = 0
        self._idle = False
        self._worker = Worker(_draw, world, seed, camera, domain, interface)

    def wait(self, timeout: float = LOADING) -> None:
        """Wait until it can draw. Raises `DeviceError` if it cannot."""
        end = time.monotonic() + timeout
        while not self._heard() and not self._idle:
            if not self.alive and not self._worker.line.poll():
                code = self._worker.process.exitcode
                raise DeviceError(f"the camera's process ended by itself (exit code {code})")
            if time.monotonic() > end:
                raise DeviceError(f"the camera is not ready after {timeout:g} s")
            self._worker.line.poll(0.1)

    def offer(self, moment: Moment) -> bool:
        """Have a picture of this moment drawn; whether it is. Never waits."""
        self._heard()
        if not self._idle:
            self.skipped += 1
            return False
        try:
            self._worker.send(moment)
        except WorkerEnded:
            return False
        self._idle = False
        return True

    @property
    def alive(self) -> bool:
        """Whether it still draws."""
        return self._worker.alive

    def close(self) -> None:
        """End the process."""
        self._worker.close(ENDING)

    def _heard(self) -> bool:
        """Take in what it says; whether it said that it is ready for the next."""
        try:
            while self._worker.line.poll():
                self.drawn += self._worker.receive()
                self._idle = True
        except (WorkerEnded, OSError):
            pass  # nothing more comes
        except EagorError as error:
            raise DeviceError(f"the simulated camera cannot draw: {error}") from error
        return self._idle


def _draw(line: Connection, world: str, seed: int, camera: CameraSettings, domain: int, interface: str | None) -> None:
    """The life of the process."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, which is told as well
    from eagor.media.ros_messages import COMPRESSED, compressed_message
    from eagor.robots.dds import Link
    from eagor.robots.go2.sim import SimulatedCamera
    from eagor.sphere import world_R_body
    from eagor.worlds import load
    from eagor.worlds.scene import Scene

    scene = load(world)(seed)
    assert isinstance(scene, Scene)  # `load_house` takes no other
    drawer = SimulatedCamera(scene, camera)
    drawer.picture(Pose(0.0, world_R_body(0.0), np.zeros(3)))  # the light, and what else comes first
    with Link(domain, interface) as link:
        writer = link.publish(CAMERA_TOPIC, COMPRESSED, reliable=False, depth=5)
        waiting: list[tuple[float, Any]] = []  # pictures on their way: when they arrive
        line.send(0)
        while True:
            pause = max(0.0, waiting[0][0] - time.time()) if waiting else None
            if line.poll(pause):
                moment: Moment = line.recv()
                picture = drawer.picture(moment.pose, moment.ball)
                message = compressed_message(picture, moment.stamp, CAMERA_FRAME, quality=camera.quality)
                waiting.append((moment.stamp + camera.latency, message))
                line.send(1)
            while waiting and waiting[0][0] <= time.time():
                writer.write(waiting.pop(0)[1])
