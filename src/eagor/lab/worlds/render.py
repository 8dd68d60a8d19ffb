"""Colour, range and instance ids of a scene, from any pose and for any grid: one ray per pixel; and photographs.

Frames: positions and rotations are poses in the world frame; images are in the layout of `eagor.sphere`. A moving ball
is not part of a scene, but drawn into rendered frames in closed form (`with_ball`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

from eagor._srgb import to_coded, to_linear
from eagor._values import lazy
from eagor.errors import GridError, PoseError
from eagor.grids import ErpGrid, Grid, PatchGrid
from eagor.lab.worlds.light import HORIZON, ZENITH, Lattice, light_of, unseen
from eagor.lab.worlds.scene import Hits, Material, Raycaster, Scene
from eagor.sources.panorama import checked_picture, turn
from eagor.sphere import check_rotation

BRIGHTEST = 5.0  # light is clipped to this; 1 shows a white surface at the edge of the shoulder's range
_KNEE = 0.4  # display values up to here are linear
_CONTRAST = 1.08
_MEDIAN = 0.48  # display value, before the shoulder, of a white surface in the scene's median light
_OUTDOORS = 1.6  # exposure of the view out of the windows
_LANE = 21
_BLOCK = 1 << 14  # pixels at a time, so that their data fits in the cache
_LEVELS = 12  # of textures: sides up to 2048 texels, halved down to 1


def exposure(scene: Scene, lattice: Lattice, light: np.ndarray) -> float:
    """The factor from `light` ``(S, 3)`` to display values, from the median light in the rooms."""
    brightness, triangle = light.mean(axis=1), lattice.slots[0]
    _, e1, e2, _ = lattice.frame
    area = np.linalg.norm(np.cross(e1, e2), axis=1) / 2 / (lattice.cells + 1).prod(axis=1)  # of each sample
    weight = np.where(unseen(scene), 0.0, area)[triangle]
    order = np.argsort(brightness)
    total = np.cumsum(weight[order])
    median = brightness[order[min(np.searchsorted(total, total[-1] / 2), len(order) - 1)]]
    return _MEDIAN / max(float(median), 1e-6)


def tone(linear: np.ndarray) -> np.ndarray:
    """Linear display values in [0, 1] of scene values: straight up to the knee, then a shoulder that never clips."""
    room = 1 - _KNEE
    excess = (np.maximum(linear, _KNEE) - _KNEE) / room
    return np.where(linear <= _KNEE, linear, _KNEE + room * excess / (1 + excess)) ** _CONTRAST


class Shader:
    """The appearance of a scene, in tables."""

    def __init__(self, scene: Scene, lattice: Lattice, light: np.ndarray) -> None:
        self._texels, self._pyramid_base, self._log_side = texels_of(scene.materials)
        emission = np.array([m.emission for m in scene.materials])[scene.material][lattice.slots[0]]
        shown = light * exposure(scene, lattice, light) + emission[:, None]
        # One number per sample, red, green and blue in lanes of it; a weight of 0 may point beyond the last.
        levels = np.rint(2047 * np.sqrt(np.clip(shown / BRIGHTEST, 0, 1))).astype(np.int64)
        packed = levels[:, 0] | levels[:, 1] << _LANE | levels[:, 2] << 2 * _LANE
        self._slots = np.append(packed, np.zeros(int(lattice.cells.max()) + 3, dtype=np.int64))
        # sRGB of light level and coded reflectance, which runs fastest.
        radiance = BRIGHTEST * ((np.arange(512)[:, None] + 0.5) / 512) ** 2 * to_linear(np.arange(256) / 255)
        self._tone = np.rint(255 * to_coded(tone(radiance))).astype(np.uint8).ravel()
        view = tone(_OUTDOORS * painted_sky(int(scene.hash[:8], 16)))
        self._outdoors = np.rint(255 * to_coded(view)).astype(np.uint8)
        # The tables of the triangles; an additional last row serves rays without a hit.
        _, e1, e2, _ = lattice.frame
        side = (1 << self._log_side[scene.material * _LEVELS].astype(np.int64))[:, None].astype(np.float64)
        uv = np.take_along_axis(scene.uv, ((lattice.turned[:, None] + np.arange(3)) % 3)[..., None], axis=1)
        uv = uv.astype(np.float64)
        uv -= np.floor(uv.min(axis=1, keepdims=True))  # whole repeats do not matter; this makes all values positive
        a, b = (uv[:, 1] - uv[:, 0]) * side, (uv[:, 2] - uv[:, 0]) * side
        # Texels per metre: from the areas of the triangle on the texture and in the world.
        texture_area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        density = np.sqrt(texture_area / np.maximum(np.linalg.norm(np.cross(e1, e2), axis=1), 1e-12))
        columns = (*(uv[:, 0] * side).T, *a.T, *b.T, *lattice.cells.T.astype(np.float64), density)
        self._rows = [np.append(column, 1.0).astype(np.float32) for column in columns]
        self._light_base = np.append(lattice.base, 0).astype(np.int32)
        self._pyramid = np.append(scene.material * _LEVELS, 0).astype(np.int32)

    def shade(self, hits: Hits, directions: np.ndarray, pixel: float) -> np.ndarray:
        """Colours ``(n, 3)`` uint8 sRGB of the hits of rays with `directions` ``(n, 3)``; `pixel`: angle, radians."""
        colours = np.empty((len(directions), 3), dtype=np.uint8)
        for first in range(0, len(directions), _BLOCK):
            part = slice(first, first + _BLOCK)
            row, u, v = hits.triangle[part].astype(np.intp), hits.u[part], hits.v[part]
            x0, y0, ax, ay, bx, by, nu, nv, density = (column[row] for column in self._rows)
            footprint = hits.distance[part] * density * np.float32(pixel)
            texel = self._texel(row, x0 + u * ax + v * bx, y0 + u * ay + v * by, footprint)
            light = self._light(row, u * nu, v * nv, nu)
            for k in range(3):
                level = (light >> (_LANE * k + 12)).astype(np.int32) & 511
                colours[part, k] = self._tone[level << 8 | (texel >> (8 * k)) & 255]
        missed = np.flatnonzero(hits.triangle < 0)
        if len(missed):
            colours[missed] = np.rint(_look_up(self._outdoors, directions[missed]))
        return colours

    def _texel(self, row: np.ndarray, x: np.ndarray, y: np.ndarray, footprint: np.ndarray) -> np.ndarray:
        """The texel at places of the textures, from the level whose texels are about as large as the `footprint`."""
        # The exponent of a float is the whole part of its logarithm; times sqrt(2), to round instead of truncating.
        level = (footprint * np.float32(1.4142135)).view(np.int32) >> 23
        level = np.clip(level - 127, 0, _LEVELS - 1)
        place = self._pyramid[row] + level
        log_side = self._log_side[place]
        mask = (np.int32(1) << log_side) - np.int32(1)
        x, y = x.astype(np.int32) >> level, y.astype(np.int32) >> level
        return self._texels[self._pyramid_base[place] + ((y & mask) << log_side) + (x & mask)]

    def _light(self, row: np.ndarray, x: np.ndarray, y: np.ndarray, nu: np.ndarray) -> np.ndarray:
        """The light at places of the lattice, in lanes: linear on each half of a cell."""
        i, j = x.astype(np.int32), y.astype(np.int32)
        along, across = ((x - i) * 1024).astype(np.int32), ((y - j) * 1024).astype(np.int32)
        stride = nu.astype(np.int32) + 1
        start = self._light_base[row] + i + j * stride
        rest = 1024 - along - across  # negative in the upper half, beyond the diagonal of the cell
        excess = np.minimum(rest, 0)
        slots = self._slots
        total = slots[start - (rest >> 31) * (stride + 1)] * np.abs(rest)
        total += slots[start + 1] * (along + excess)
        total += slots[start + stride] * (across + excess)
        return total


def _look_up(image: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The colours ``(n, 3)`` of an equirectangular image ``(H, W, 3)`` in these directions ``(n, 3)``, bilinear."""
    x, y, _ = ErpGrid(*image.shape[:2]).project(directions)
    round_ = np.pad(image.astype(np.float32), ((0, 0), (1, 1), (0, 0)), mode="wrap")
    at = np.stack([y - 0.5, x + 0.5])
    return np.stack([ndimage.map_coordinates(round_[..., k], at, order=1, mode="nearest") for k in range(3)], axis=-1)


def painted_sky(seed: int) -> np.ndarray:
    """The view outdoors, ``(512, 1024, 3)`` linear RGB, equirectangular: sky, hills and trees, lawn that fades."""
    rng, (v, u) = np.random.default_rng(seed), (np.mgrid[:512, :1024] + 0.5) / 512
    around, elevation = np.pi * (1 - u), 90 - 180 * v  # azimuth in radians, elevation in degrees

    def waves(lowest: int, highest: int, phase: np.ndarray) -> np.ndarray:
        """Periodic noise of unit size, of whole-number frequencies."""
        return np.sum([np.sin(rng.integers(lowest, highest) * phase + rng.uniform(0, 7)) for _ in range(7)], axis=0) / 3

    away = 5 / np.tan(np.radians(np.clip(-elevation, 0.5, 89.5)))  # metres, seen from one storey's height
    grass = np.array([0.20, 0.26, 0.12]) * (1 + 0.2 * waves(3, 20, around) / (1 + away / 20))[..., None]
    haze, up = 1 - np.exp(-away / 60)[..., None], np.sqrt(np.clip(np.sin(np.radians(elevation)), 0, 1))[..., None]
    lawn = grass + (np.array([0.50, 0.57, 0.47]) - grass) * haze
    cloud = np.clip(0.3 * waves(3, 9, around + np.radians(elevation)), 0, 0.4)[..., None] * (1 - up)
    air = HORIZON + (ZENITH - HORIZON) * up
    image = np.where((elevation > 0)[..., None], air + (1 - air) * cloud, lawn)
    hills = (elevation < 1.8 + 1.2 * waves(2, 6, around)) & (elevation > -1)
    image = np.where(hills[..., None], np.array([0.54, 0.63, 0.70]), image)
    crowns = 1.4 + 3.2 * np.maximum(waves(4, 12, around), 0) + 0.8 * waves(30, 80, around)
    shade = 1 + 0.3 * waves(15, 60, 1.7 * around + elevation / 6)
    trees = (elevation < crowns) & (elevation > -1.8 - 0.6 * shade)
    return np.clip(np.where(trees[..., None], np.array([0.26, 0.33, 0.24]) * shade[..., None], image), 0, 1)


def texels_of(materials: tuple[Material, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All textures in one flat array ``(n,)`` int32, each in a pyramid of halved sizes, tinted beforehand.

    A texel is one number: red + green 2^8 + blue 2^16, sRGB-coded reflectance. Pyramids are square with sides that are
    powers of two, so that a place in them is found by shifts and masks alone. For material m at level l (0: full size),
    the second array ``(M * _LEVELS,)`` has at m * _LEVELS + l where its rows begin, and the third the logarithm of its
    side to base 2; levels beyond the last repeat it.
    """
    pyramids: dict[int, list[np.ndarray]] = {}  # textures are shared by materials
    texels, base, log_side, start = [], [], [], 0
    for material in materials:
        key = id(material.texture)
        if key not in pyramids:
            pyramids[key] = _pyramid(material.texture)
        tint = to_linear(np.clip(np.asarray(material.colour, dtype=np.float64), 0, 1))
        table = np.rint(255 * to_coded(to_linear(np.arange(256) / 255)[:, None] * tint)).astype(np.int32)
        for level in pyramids[key]:
            r, g, b = (table[level[:, k], k] for k in range(3))
            texels.append(r | g << 8 | b << 16)
            base.append(start)
            log_side.append(len(level).bit_length() // 2)
            start += len(level)
        repeated = _LEVELS - len(pyramids[key])
        base += base[-1:] * repeated
        log_side += log_side[-1:] * repeated
    return np.concatenate(texels), np.array(base, dtype=np.int32), np.array(log_side, dtype=np.int32)


def _pyramid(texture: np.ndarray | None) -> list[np.ndarray]:
    """The levels of a texture, ``(side^2, 3)`` uint8 each, row 0 at the bottom (v points up)."""
    if texture is None:
        return [np.full((1, 3), 255, dtype=np.uint8)]
    texture = texture[::-1, :, :3]
    side = 1 << min(int(np.ceil(np.log2(max(texture.shape[:2])))), _LEVELS - 1)
    if texture.shape[:2] != (side, side):
        texture = np.asarray(Image.fromarray(np.ascontiguousarray(texture)).resize((side, side)))
    levels = [texture.reshape(-1, 3)]
    decode = to_linear(np.arange(256) / 255).astype(np.float32)
    encode = np.rint(255 * to_coded(np.arange(4096) / 4095)).astype(np.uint8)
    level = decode[texture]
    while len(level) > 1:
        level = (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2]) / 4
        levels.append(encode[np.rint(level * 4095).astype(np.int32)].reshape(-1, 3))
    return levels


# --- pictures ---------------------------------------------------------------------------------------------------------

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


def checked_pose(
    position: Position, world_R_body: np.ndarray, height: int = 1, name: str = "world_R_body"
) -> tuple[np.ndarray, np.ndarray]:
    """Position ``(3,)`` and pose ``(3, 3)`` of a camera whose pictures have so many rows, float64.

    Raises `PoseError`, `RotationError`, `GridError`.
    """
    if height < 1:
        raise GridError(f"a panorama of height {height}; wanted at least one row")
    place = np.asarray(position, dtype=np.float64)
    if place.shape != (3,) or not np.isfinite(place.astype(np.float32)).all():
        raise PoseError(f"the camera stands at {position}; wanted a position (x, y, z), finite, in metres")
    return place, np.asarray(check_rotation(np.asarray(world_R_body, dtype=np.float64), name))


class Renderer:
    """Pictures of `scene`.

    Making one costs nothing: the tree of triangles is built for the first picture, the light (seconds, unless cached)
    for the first one in colour. `cache`: the folder for the light, by default the user's cache ($EAGOR_CACHE). Use one
    renderer per thread.
    """

    def __init__(self, scene: Scene, *, cache: Path | None = None) -> None:
        self.scene = scene
        self.cache = cache

    @lazy
    def raycaster(self) -> Raycaster:
        """The scene's triangles, with corners rotated as in the lattice of light. Raises `MissingExtraError`."""
        return Raycaster(self.scene.vertices, self._lattice.triangles)

    @lazy
    def _lattice(self) -> Lattice:
        return Lattice.of(self.scene)

    @lazy
    def _shader(self) -> Shader:
        return Shader(self.scene, self._lattice, light_of(self.scene, self._lattice, self.cache))

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
        place, rotation = checked_pose(position, world_R_body, height)
        directions = _erp_directions(height, rotation)
        return self._seen(place, directions, math.pi / height, rgb, range, ids)

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
        place, rotation = checked_pose(position, world_R_view, name="world_R_view")
        weights = np.asarray(grid.weights)
        # The angle of a pixel selects the level of textures; cells of a panorama have the same height in elevation.
        separable = isinstance(grid, ErpGrid | PatchGrid)
        pixel = math.pi / grid.shape[0] if separable else math.sqrt(float(np.median(weights[weights > 0])))
        directions = (grid.directions @ rotation.T).astype(np.float32)
        frame = self._seen(place, directions, pixel, rgb, range, ids)
        for part, nothing in ((frame.rgb, 0), (frame.range, np.inf), (frame.ids, -1)):
            if part is not None:
                part[weights <= 0] = nothing
        return frame

    def _seen(
        self, place: np.ndarray, directions: np.ndarray, pixel: float, rgb: bool, range: bool, ids: bool
    ) -> Frame:
        """What rays ``(H, W, 3)`` float32 hit; `pixel`: the angle between neighbours, radians."""
        shape, rays = directions.shape[:2], directions.reshape(-1, 3)
        hits = self.raycaster.cast(np.broadcast_to(place.astype(np.float32), rays.shape), rays)
        return Frame(
            self._shader.shade(hits, rays, pixel).reshape(*shape, 3) if rgb else None,
            hits.distance.reshape(shape) if range else None,
            self._owners.take(hits.triangle).reshape(shape) if ids else None,
        )


_erp_grid = lru_cache(maxsize=4)(ErpGrid)  # keeps the directions


def _erp_directions(height: int, rotation: np.ndarray) -> np.ndarray:
    """The directions of a panorama's pixels in the world ``(H, W, 3)`` float32, at the pose `rotation`."""
    width = 2 * height
    grid = _erp_grid(height, width)
    if max(abs(rotation[[0, 1, 2, 2], [2, 2, 0, 1]])) >= 1e-9 or rotation[2, 2] <= 0:
        return grid.directions.astype(np.float32) @ rotation.T.astype(np.float32)
    # A rotation about the vertical alone: a table that depends only on the remainder, with its columns rolled. The
    # offset keeps common yaws (0, halves and quarters of a column) off the edge of a step, where the last digit of
    # atan2 would decide.
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    columns, remainder = divmod(math.floor(yaw * width / (2 * math.pi) * _QUANTA + 0.37), _QUANTA)
    # Column j looks at azimuth a[j] + yaw = a[j - columns] + remainder.
    azimuth = np.roll(grid.longitudes, columns) + remainder / _QUANTA * (math.pi / height)
    around = np.stack([np.cos(azimuth), np.sin(azimuth)]).astype(np.float32)
    latitude = grid.latitudes[:, None]
    directions = np.empty((height, width, 3), dtype=np.float32)
    directions[..., :2] = np.cos(latitude).astype(np.float32)[..., None] * around.T
    directions[..., 2] = np.sin(latitude)
    return directions


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
    distance = along - np.sqrt(np.maximum(inside, 0.0))
    hit = (inside > 0) & (distance > 0) & (distance < frame.range)
    if not hit.any():
        return frame
    rgb = None
    if frame.rgb is not None:
        normal = (distance[hit][:, None] * grid.directions[hit] - offset) / ball.radius @ world_R_body.T
        shade = 0.35 + 0.65 * np.clip(normal @ _LIGHT, 0.0, None)  # in display values: suggests form, not physical
        rgb = frame.rgb.copy()
        rgb[hit] = np.clip(shade[:, None] * np.array(PAINTS[ball.colour]), 0, 255).astype(np.uint8)
    ids = None if frame.ids is None else np.where(hit, np.int32(id), frame.ids)
    return Frame(rgb=rgb, range=np.where(hit, distance, frame.range).astype(np.float32), ids=ids)


# --- a photograph -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Photograph:
    """A panorama ``(H, W, 3)`` uint8, in the layout of `eagor.sphere`, taken in the identity pose at the origin.

    The camera can turn but not move in it, since a photograph has no depth: there are no ranges and no ids.
    """

    image: np.ndarray

    def panorama(
        self, position: Position, world_R_body: np.ndarray, height: int, *,
        rgb: bool = True, range: bool = True, ids: bool = True,
    ) -> Frame:  # fmt: skip
        """The view in the pose `world_R_body`, ``(height, 2 height, 3)``; range and ids are always None.

        The photograph is averaged to the size first. Raises `PoseError` for a position other than the origin,
        `GridError` for a height below 1, `RotationError`, and `ImageError` for an invalid photograph.
        """
        image = checked_picture(self.image, "the photograph")
        place, pose = checked_pose(position, world_R_body, height)
        if place.any():
            raise PoseError(
                f"the camera stands at {position}; a photograph shows what is seen from (0, 0, 0), where it was taken"
            )
        if not rgb:
            return Frame(None, None, None)
        sized = Image.fromarray(np.ascontiguousarray(image)).resize((2 * height, height), Image.Resampling.BOX)
        return Frame(turn(np.asarray(sized), pose.T), None, None)
