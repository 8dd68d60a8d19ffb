"""A simulated Go2 on DDS in real time: its wire, its camera, and the truth about it beside."""

from __future__ import annotations

import json
import time
import warnings
from typing import Any, Self

from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.go2.plant import Motion
from eagor.robots.go2.sim import SimulatedGo2
from eagor.robots.go2.sim_pictures import CAMERA_TOPIC, Moment, PictureProcess
from eagor.robots.go2.sim_server import TRUTH, Go2Server
from eagor.robots.go2.state import SOURCES

__all__ = ["TRUTH_THINGS", "LiveGo2"]

TRUTH_THINGS = f"{TRUTH}/things"  # std_msgs/String: JSON of all things and where they are; no robot has this topic
LISTENING = 1.0  # seconds to hear whether another robot is there
THINGS_EVERY = 0.2  # seconds


class LiveGo2:
    """`robot` on DDS domain `domain`, in real time; a context manager.

    Raises `DeviceError` if a robot, real or simulated, already speaks there: commands would reach both.
    """

    def __init__(self, robot: SimulatedGo2, domain: int = 0, interface: str | None = "lo") -> None:
        from eagor.media.bags.messages import TEXT

        self.robot = robot
        self.pictures: PictureProcess | None = None
        self._told = 0.0
        self._broken = False
        self.link = Link(domain, interface)
        try:
            self._alone()
            settings = robot.settings
            if settings.world is not None and settings.camera is not None:
                self.pictures = PictureProcess(settings.world, settings.seed, settings.camera, domain, interface)
            self._things = self.link.publish(TRUTH_THINGS, TEXT, transient=True, depth=1)
            self.server = Go2Server(
                robot.plant, self.link, settings.wire, rng=robot._wire_rng, every_step=self._every_step
            )
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        try:
            self.robot.begun = time.time() - self.robot.plant.seconds
            self.server.__enter__()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the robot, its camera and its place on the network. May be called twice."""
        if (server := getattr(self, "server", None)) is not None:
            server.close()
        if self.pictures is not None:
            self.pictures.close()
            self.pictures = None
        self.link.close()

    def wait_for_camera(self) -> None:
        """Wait until pictures come. Raises `DeviceError` if they cannot."""
        if self.pictures is not None:
            self.pictures.wait()

    @property
    def topics(self) -> dict[str, str]:
        """The topics for other programs, in words."""
        found = {
            "rt/sportmodestate": "state, 200 per second",
            "rt/lf/sportmodestate": "state, 20 per second",
            "rt/utlidar/robot_odom": "odometry (nav_msgs/Odometry), 20 per second",
            "rt/lowstate": "battery, remote control, 200 per second",
            "rt/lf/lowstate": "battery, remote control, 20 per second",
            "rt/api/sport/request": "commands",
            "rt/api/obstacles_avoid/request": "commands that heed obstacles",
        }
        camera = self.robot.settings.camera
        if camera is not None and self.robot.house is not None:
            what = "both fisheyes" if camera.kind == "fisheye" else "panorama"
            wide, high = camera.size
            found[CAMERA_TOPIC] = f"camera ({what}, {wide} x {high}, JPEG), {camera.rate:g} per second"
        found[TRUTH] = "the true pose, which no robot has"
        if self.robot.house is not None:
            found[TRUTH_THINGS] = "the true places of things, which no robot has"
        return found

    def _alone(self) -> None:
        taken = self.link.topics(LISTENING)
        if there := sorted({*SOURCES.values()} & {*taken}):
            where = f"domain {self.link.domain} on {self.link.interface or 'an automatic interface'}"
            raise DeviceError(
                f"a robot already speaks on DDS {where} ({', '.join(there)}), and commands would reach both: take "
                "another --domain, or end the other one if it is simulated"
            )

    def _every_step(self, motion: Motion, host: float) -> None:
        """In the server's thread: offer a picture if one is due, tell where things are."""
        if self.pictures is not None and not self._broken and self.robot.picture_due():
            self._offer(motion, host)
        if self.robot.house is not None and host - self._told >= THINGS_EVERY:
            from eagor.media.bags.messages import text_message

            if self._told == 0.0 or self.robot.house.ball is not None:
                self._things.write(text_message(json.dumps(self._truth(host))))
            self._told = host

    def _offer(self, motion: Motion, host: float) -> None:
        camera, house = self.robot.settings.camera, self.robot.house
        assert camera is not None
        assert house is not None
        assert self.pictures is not None
        ball = None if house.ball is None else house.ball.at(motion.pose.stamp)
        try:
            self.pictures.offer(Moment(host, camera.pose(motion.pose), ball))
        except DeviceError as error:
            self._broken = True
            warnings.warn(str(error), stacklevel=2)

    def _truth(self, host: float) -> dict[str, Any]:
        things = [
            {"id": each.id, "category": each.category, "colour": each.colour, "position": each.centre.round(4).tolist()}
            for each in self.robot.things()
        ]
        targets = [thing.id for thing in self.robot.targets]
        return {"stamp": host, "target": self.robot.settings.target, "targets": targets, "things": things}
