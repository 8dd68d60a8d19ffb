"""Colour, range and instance ids of a scene, from any pose and for any grid: one ray per pixel.

Frames: positions and rotations are poses in the world frame; images are in the layout of `eagor.sphere`. A moving ball
is not part of a scene, but drawn into rendered frames in closed form (`with_ball`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from eagor._lazy import lazy
from eagor.errors import GridError, PoseError
from eagor.grids import ErpGrid, Grid, PatchGrid
from eagor.sphere import check_rotation
from eagor.worlds.lattice import Lattice
from eagor.worlds.light import light_of
from eagor.worlds.raycast import Raycaster, make_raycaster
from eagor.worlds.scene import Scene
from eagor.worlds.shading import Shader

Position = np.ndarray | tuple[float, float, float]
_QUANTA = 1 << 20  # steps of yaw per column: 1e-8 rad in a panorama of 512 columns, below the resolution of float32
# sRGB of the balls, by the colours' names.
PAINTS = {"red": (196, 34, 38), "blue": (38, 74, 186), "yellow": (226, 190, 40), "green": (40, 140, 66)}
_LIGHT = np.array([0.35, 0.25, 0.9]) / np.linalg.norm([0.35, 0.25, 0.9])


@dataclass(frozen=True, eq=False)
class Frame:
    """A rendered view; parts that were not requested are None.

    `rgb` ``(H, W, 3)`` uint8 sRGB; `range` ``(H, W)`` float32, metres from the camera along the ray, inf for no hit;
    `ids` ``(H, W)`` int32, indices of `Scene.instances`, -1 for no hit.
    """

    rgb: np.ndarray | None
    range: np.ndarray | None
    ids: np.ndarray | None


class Renderer:
    """Pictures of `scene`.

    Making one costs nothing: the tree of triangles is built for the first picture, the light (seconds, unless cached)
    for the first one in colour. `engine`: see `eagor.worlds.raycast`; `cache`: the folder for the light, by default the
    user's cache ($EAGOR_CACHE). Use one renderer per thread.
    """

    def __init__(self, scene: Scene, *, engine: str = "auto", cache: Path | None = None) -> None:
        self.scene = scene
        self.engine = engine
        self.cache = cache

    @lazy
    def raycaster(self) -> Raycaster:
        """The scene's triangles, with corners rotated as in the lattice of light. Raises `WorldError`."""
        return make_raycaster(self.scene.vertices, self._lattice.triangles, self.engine)

    @lazy
    def _lattice(self) -> Lattice:
        return Lattice.of(self.scene)

    @lazy
    def _shader(self) -> Shader:
        return Shader(self.scene, self._lattice, light_of(self.scene, self._lattice, self.engine, self.cache))

    @lazy
    def _owners(self) -> np.ndarray:
        """Instance of each triangle, and -1 at the end for the index -1."""
        return np.append(self.scene.instance, -1).astype(np.int32)

    def panorama(
        self, position: Position, world_R_body: np.ndarray, height: int, *,
        rgb: bool = True, range: bool = True, ids: bool = True,
    ) -> Frame:  # fmt: skip
        """The panorama ``(height, 2 height)`` from `position` ``(3,)``, metres, in the pose `world_R_body`.

        A rotation about the vertical is split into a whole number of columns and a remainder, so that turning by whole
        columns rolls the image exactly. Raises `PoseError`, `RotationError`, `GridError`, `WorldError`.
        """
        if height < 1:
            raise GridError(f"a panorama of height {height}; wanted at least one row")
        rotation = np.asarray(check_rotation(np.asarray(world_R_body, dtype=np.float64), "world_R_body"))
        yaw = _pure_yaw(rotation)
        if yaw is None:
            directions = _erp_directions(height) @ rotation.T.astype(np.float32)
        else:
            directions = _turned_directions(height, yaw)
        parts = self._seen(position, directions, math.pi / height, rgb, range, ids)
        return _shaped(parts, (height, 2 * height))

    def view(
        self, position: Position, world_R_view: np.ndarray, grid: Grid, *,
        rgb: bool = True, range: bool = True, ids: bool = True,
    ) -> Frame:  # fmt: skip
        """The view of `grid` from `position` ``(3,)``, metres; its body frame has the pose `world_R_view`.

        Cells in which the grid sees nothing (the corners of a fisheye) are black, at range inf, id -1. An `ErpGrid`
        twice as wide as high gives the `panorama`. Errors as there.
        """
        if isinstance(grid, ErpGrid) and grid.width == 2 * grid.height:
            return self.panorama(position, world_R_view, grid.height, rgb=rgb, range=range, ids=ids)
        rotation = np.asarray(check_rotation(np.asarray(world_R_view, dtype=np.float64), "world_R_view"))
        weights = np.asarray(grid.weights)
        seen = weights.ravel() > 0
        directions = (grid.directions.reshape(-1, 3)[seen] @ rotation.T).astype(np.float32)
        # The angle of a pixel selects the level of textures; cells of a panorama have the same height in elevation.
        separable = isinstance(grid, ErpGrid | PatchGrid)
        pixel = math.pi / grid.shape[0] if separable else math.sqrt(float(np.median(weights[weights > 0])))
        whole = []
        for part, nothing in zip(
            self._seen(position, directions, pixel, rgb, range, ids), (0, np.inf, -1), strict=True
        ):
            if part is not None and not seen.all():
                spread = np.full((len(seen), *part.shape[1:]), nothing, dtype=part.dtype)
                spread[seen] = part
                part = spread
            whole.append(part)
        return _shaped(whole, grid.shape)

    def _seen(
        self, position: Position, directions: np.ndarray, pixel: float, rgb: bool, range: bool, ids: bool
    ) -> tuple[np.ndarray | None, ...]:
        """What these rays ``(n, 3)`` hit, ``(n, ...)`` each; `pixel`: the angle between neighbours, radians."""
        origin = np.asarray(position, dtype=np.float32)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise PoseError(f"the camera stands at {position}; wanted a position (x, y, z), finite, in metres")
        hits = self.raycaster.cast(np.broadcast_to(origin, directions.shape), directions)
        return (
            self._shader.shade(hits, directions, pixel) if rgb else None,
            hits.distance if range else None,
            self._owners.take(hits.triangle) if ids else None,
        )


def _shaped(parts: Iterable[np.ndarray | None], shape: tuple[int, ...]) -> Frame:
    return Frame(*(None if part is None else part.reshape(*shape, *part.shape[1:]) for part in parts))


def _pure_yaw(rotation: np.ndarray) -> float | None:
    """The yaw (radians, left) of a rotation about the vertical; None for any other rotation."""
    tilt = max(abs(rotation[0, 2]), abs(rotation[1, 2]), abs(rotation[2, 0]), abs(rotation[2, 1]))
    return math.atan2(rotation[1, 0], rotation[0, 0]) if tilt < 1e-9 and rotation[2, 2] > 0 else None


@lru_cache(maxsize=4)
def _erp_directions(height: int) -> np.ndarray:
    """Directions of a panorama's pixels, body frame, ``(n, 3)`` float32."""
    return _frozen(ErpGrid(height, 2 * height).directions.reshape(-1, 3).astype(np.float32))


def _turned_directions(height: int, yaw: float) -> np.ndarray:
    """The same, turned by `yaw`: a table that depends only on the remainder, with its columns rolled."""
    width = 2 * height
    # The offset keeps common yaws (0, halves and quarters of a column) off the edge of a step, where the last digit of
    # atan2 would decide.
    steps = math.floor(yaw * width / (2 * math.pi) * _QUANTA + 0.37)
    columns, remainder = divmod(steps, _QUANTA)
    azimuth, cosine, sine = _columns(height, remainder)
    directions = np.empty((height, width, 3), dtype=np.float32)
    # Column j looks at azimuth a[j] + yaw = a[j - columns] + remainder.
    around = np.roll(azimuth, columns, axis=1)
    np.multiply(cosine, around[0], out=directions[..., 0])
    np.multiply(cosine, around[1], out=directions[..., 1])
    directions[..., 2] = sine
    return directions.reshape(-1, 3)


@lru_cache(maxsize=64)
def _columns(height: int, remainder: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cosine and sine of the azimuths ``(2, W)``, cosine and sine of the elevations ``(H, 1)``, float32."""
    grid = ErpGrid(height, 2 * height)
    azimuth = grid.longitudes + remainder / _QUANTA * (math.pi / height)
    latitude = grid.latitudes[:, None]
    found = np.stack([np.cos(azimuth), np.sin(azimuth)]), np.cos(latitude), np.sin(latitude)
    first, second, third = (_frozen(array.astype(np.float32)) for array in found)
    return first, second, third


def _frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Ball:
    """`centre` ``(3,)`` and `radius` in metres, world frame; `colour`, one of `PAINTS`."""

    centre: np.ndarray
    radius: float
    colour: str


def with_ball(frame: Frame, position: np.ndarray, world_R_body: np.ndarray, ball: Ball, id: int) -> Frame:
    """`frame`, equirectangular and rendered at this pose with ranges, with the ball added.

    It changes those of range, ids and rgb that the frame has; ids get `id`. The ball occludes and is occluded by range;
    it casts no shadow.
    """
    assert frame.range is not None
    grid = ErpGrid(*frame.range.shape)
    offset = world_R_body.T @ (ball.centre - position)
    # |t d - offset|^2 = radius^2 for the nearer t.
    along = grid.directions @ offset
    inside = along**2 - (offset @ offset - ball.radius**2)
    hit = (inside > 0) & (along > 0)
    distance = np.where(hit, along - np.sqrt(np.maximum(inside, 0.0)), np.inf)
    hit &= (distance > 0) & (distance < frame.range)
    if not hit.any():
        return frame
    rgb = None
    if frame.rgb is not None:
        normal = (distance[hit][:, None] * grid.directions[hit] - offset) / ball.radius @ world_R_body.T
        shade = 0.35 + 0.65 * np.clip(normal @ _LIGHT, 0.0, None)  # in display values: suggests form, not physical
        rgb = frame.rgb.copy()
        rgb[hit] = np.clip(shade[:, None] * np.array(PAINTS[ball.colour]), 0, 255).astype(np.uint8)
    ids = None
    if frame.ids is not None:
        ids = np.where(hit, np.int32(id), frame.ids)
    return Frame(rgb=rgb, range=np.where(hit, distance, frame.range).astype(np.float32), ids=ids)
