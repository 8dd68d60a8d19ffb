"""The 360-degree camera on a simulated Go2: what it sees, and how it hands that over."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eagor._checks import require, whole, within
from eagor._lazy import lazy
from eagor.errors import DeviceError
from eagor.media.frames import Pose
from eagor.worlds.render import Ball, Renderer, with_ball
from eagor.worlds.scene import Scene

__all__ = ["CameraSettings", "SimulatedCamera"]

MOUNT = (0.0, 0.0, 0.40)  # metres from the body's centre to the camera, body frame: a short stick on its back
FIELD = math.radians(200.0)  # of each fisheye of an X3
BALL = 1 << 20  # an id that no instance has


@dataclass(frozen=True)
class CameraSettings:
    """A simulated Insta360 X3.

    `kind`: what its pictures are: "erp" (equirectangular) or "fisheye" (both circles side by side, the front one left).
    `rows`: of its panoramas, and of the circles. `rate`: pictures per second. `latency`: seconds from capture to
    arrival. `mount` ``(3,)``: where it is on the body, metres. `quality`: of the JPEG, 1 to 100.
    """

    kind: Literal["erp", "fisheye"] = "erp"
    rows: int = 128
    rate: float = 5.0
    latency: float = 0.15
    mount: tuple[float, float, float] = MOUNT
    quality: int = 90

    def __post_init__(self) -> None:
        require(
            self,
            {
                "kind": (self.kind in ("erp", "fisheye"), "erp or fisheye"),
                "rows": (whole(self.rows, 16, 4096) and self.rows % 2 == 0, "an even number of rows, 16 to 4096"),
                "rate": (within(self.rate, 0.01, 60), "0.01 to 60 pictures per second"),
                "latency": (within(self.latency, 0, 60), "0 to 60 s"),
                "quality": (whole(self.quality, 1, 100), "1 to 100"),
            },
            DeviceError,
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its pictures."""
        return 2 * self.rows, self.rows

    def pose(self, body: Pose) -> Pose:
        """The camera's pose on a body at this pose."""
        assert body.position is not None
        return Pose(body.stamp, body.world_R_body, body.position + body.world_R_body @ np.asarray(self.mount))


class SimulatedCamera:
    """Pictures of a scene, as the camera sends them."""

    def __init__(self, scene: Scene, settings: CameraSettings) -> None:
        self.settings = settings
        self._renderer = Renderer(scene)
        self._rig = None
        if settings.kind == "fisheye":
            from eagor.media.cameras.rig import dual_fisheye

            self._rig = dual_fisheye(*settings.size, FIELD)

    def panorama(self, camera: Pose, ball: Ball | None = None) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` uint8 from the camera's pose, with the ball where there is one."""
        return self._rendered(camera, ball, self.settings.rows)

    def picture(self, camera: Pose, ball: Ball | None = None) -> np.ndarray:
        """What it sends ``(H, W, 3)`` uint8: the panorama, or both fisheye circles."""
        if self._rig is None:
            return self.panorama(camera, ball)
        from eagor.media.cameras.stitching import seen_by

        (picture,) = seen_by(self._rig, self._rendered(camera, ball, self._rig.rows))
        return picture

    def received(self, picture: np.ndarray) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` that whoever receives such a picture makes of it."""
        return picture if self._rig is None else self._stitcher.stitch(picture)

    @lazy
    def _stitcher(self):
        from eagor.media.cameras.stitching import Stitcher

        assert self._rig is not None
        return Stitcher(self._rig, self.settings.rows)

    def _rendered(self, camera: Pose, ball: Ball | None, rows: int) -> np.ndarray:
        assert camera.position is not None
        seen = self._renderer.panorama(camera.position, camera.world_R_body, rows, range=ball is not None, ids=False)
        if ball is not None:
            seen = with_ball(seen, camera.position, camera.world_R_body, ball, BALL)
        assert seen.rgb is not None
        return seen.rgb
