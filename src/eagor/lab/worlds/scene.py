"""A scene: triangles with their instances and materials, and the light sources.

World frame: x and y horizontal, z up, right-handed, metres; the floor is at z = 0. The built-in apartments and any
imported GLB become the same `Scene`, which the renderer (`eagor.lab.worlds.render`), the ground plan
(`eagor.lab.worlds.ground`) and the exporters use. A scene is immutable.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

import numpy as np

from eagor._extras import how_to_install
from eagor._srgb import to_linear
from eagor._values import lazy
from eagor.errors import MissingExtraError, WorldError
from eagor.queries import Query

STRUCTURE = ("wall", "floor", "ceiling", "door", "window")  # categories that are part of the building


@dataclass(frozen=True, eq=False)
class Instance:
    """A named thing. Its index in `Scene.instances` is its id in id images.

    `category` in lower-case words ("coffee table"); `colour`: its main colour as a plain word, or None; `room`: the
    name of its room, or None; `low` and `high` ``(3,)``: its axis-aligned bounds in metres.
    """

    category: str
    colour: str | None
    room: str | None
    low: np.ndarray
    high: np.ndarray

    @property
    def centre(self) -> np.ndarray:
        """Middle of the bounds ``(3,)``."""
        return (self.low + self.high) / 2

    @property
    def name(self) -> str:
        """Colour and category in plain words: "red chair"."""
        return str(Query(self.category, self.colour))


@dataclass(frozen=True, eq=False)
class Material:
    """The appearance of a surface.

    `colour`: sRGB in [0, 1], multiplies the texture; `texture`: ``(h, w, 3)`` uint8 sRGB, periodic, or None;
    `emission`: its own light, 1 being a white surface in full light (lamp shades, screens).
    """

    name: str
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: np.ndarray | None = None
    emission: float = 0.0

    @property
    def reflectance(self) -> np.ndarray:
        """The mean share of light that it reflects ``(3,)``, linear."""
        tint, texture = to_linear(np.asarray(self.colour, dtype=np.float64)), self.texture
        return tint if texture is None else tint * to_linear(texture[::2, ::2, :3] / 255).mean(axis=(0, 1))


@dataclass(frozen=True, eq=False)
class Lamp:
    """A point light for the baked illumination: `position` ``(3,)`` metres, `power` ``(3,)`` linear RGB.

    A white surface facing it from 1 m away has a radiance of `power`, 1 being full white.
    """

    position: np.ndarray
    power: np.ndarray


@dataclass(frozen=True, eq=False)
class Room:
    """A room: `name` ("bedroom 1"), `kind` ("bedroom"), and the rectangles ``(n, 4)`` x0, y0, x1, y1 it consists of."""

    name: str
    kind: str
    rectangles: np.ndarray

    @property
    def area(self) -> float:
        """Square metres (the rectangles do not overlap)."""
        x0, y0, x1, y1 = self.rectangles.T
        return float(((x1 - x0) * (y1 - y0)).sum())

    def contains(self, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        """Whether points lie in the room, bool in the shape of `x` and `y`."""
        x, y = np.asarray(x)[..., None], np.asarray(y)[..., None]
        x0, y0, x1, y1 = self.rectangles.T
        return ((x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1)).any(axis=-1)


@dataclass(frozen=True, eq=False)
class Scene:
    """Triangles and their meaning.

    - `vertices` ``(V, 3)`` float32; `triangles` ``(T, 3)`` int32, counter-clockwise seen from outside; surfaces are
      lit on the side that is seen.
    - `instance` and `material` ``(T,)`` int32: indices of the triangle's instance and material.
    - `uv` ``(T, 3, 2)`` float32: texture coordinates of the corners, in repeats of the texture; u to the right, v up.
    - `lamps`: empty if only daylight and emission light the scene. `daylight`: linear RGB of the sky.
    - `source`: its generator and version ("apartment 1 seed 17", "glb kitchen.glb").
    """

    vertices: np.ndarray
    triangles: np.ndarray
    instance: np.ndarray
    material: np.ndarray
    uv: np.ndarray
    instances: tuple[Instance, ...]
    materials: tuple[Material, ...]
    rooms: tuple[Room, ...] = ()
    lamps: tuple[Lamp, ...] = ()
    daylight: tuple[float, float, float] = (1.0, 1.05, 1.15)
    source: str = "scene"
    facts: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.triangles)
        shapes = [a.shape for a in (self.vertices, self.triangles, self.instance, self.material, self.uv)]
        fits = shapes == [(len(self.vertices), 3), (count, 3), (count,), (count,), (count, 3, 2)]
        if not fits or count == 0 or not np.isfinite(self.vertices).all():
            raise WorldError(
                "a scene needs finite vertices (V, 3), triangles (T, 3), instance and material (T,), uv (T, 3, 2); got "
                f"{', '.join(map(str, shapes))}"
            )
        for name, values, end in (
            ("triangles", self.triangles, len(self.vertices)),
            ("instance", self.instance, len(self.instances)),
            ("material", self.material, len(self.materials)),
        ):
            if values.min() < 0 or values.max() >= end:
                raise WorldError(f"{name} of the scene point outside 0..{end - 1}")

    @lazy
    def hash(self) -> str:
        """Sixteen hexadecimal digits that change with everything that can be hit, seen or named."""
        digest = hashlib.sha256()
        for array in (self.vertices, self.triangles, self.instance, self.material, self.uv):
            digest.update(np.ascontiguousarray(array).tobytes())
        for thing in self.instances:
            digest.update(f"{thing.category}|{thing.colour}|{thing.room};".encode("utf-8", "surrogatepass"))
        for material in self.materials:
            digest.update(f"{material.colour}|{material.emission};".encode())
            if material.texture is not None:
                digest.update(np.ascontiguousarray(material.texture).tobytes())
        for lamp in self.lamps:
            digest.update(np.concatenate([lamp.position, lamp.power]).astype(np.float32).tobytes())
        digest.update(str(self.daylight).encode())
        return digest.hexdigest()[:16]

    def room_at(self, x: float, y: float) -> Room | None:
        """The room at a point, or None."""
        return next((room for room in self.rooms if room.contains(x, y)), None)


# --- rays -------------------------------------------------------------------------------------------------------------

_FAR = np.float32(1e37)  # distance that embreex reports for a miss


@dataclass(frozen=True, eq=False)
class Hits:
    """The first hit of each of n rays.

    `distance` ``(n,)`` float32, in lengths of the ray's direction (metres for unit directions), inf for a miss;
    `triangle` ``(n,)`` int32, -1 for a miss; `u` and `v` ``(n,)`` float32, the barycentric weights of the triangle's
    corners 1 and 2 (corner 0 has 1 - u - v; 0 for a miss).
    """

    distance: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray


class Raycaster:
    """`triangles` ``(T, 3)`` over `vertices` ``(V, 3)``, metres, to cast rays at, one at a time on one thread.

    Rays are float32 arrays ``(n, 3)``, world frame, metres; their directions need not have unit length. Without
    `watertight`, they are one seventh faster, but a rare ray slips through the edge between two triangles. Raises
    `MissingExtraError` without embreex.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, watertight: bool = True) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise MissingExtraError(
                f"a rendered picture needs embreex: {how_to_install('sim')} (for Linux on ARM there is "
                "no wheel of it: use the rooms of eagor.lab.worlds.painted there, or photographs)"
            ) from error
        self._scene = EmbreeScene(robust=watertight)
        self._mesh = TriangleMesh(
            self._scene,
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(triangles, dtype=np.int32),
        )

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """The nearest triangle along each ray."""
        found = self._scene.run(*_rays(origins, directions), output=True)
        missed = found["primID"] < 0
        if missed.any():  # embreex leaves the values of the previous ray in u and v
            for name, value in (("tfar", np.inf), ("u", 0.0), ("v", 0.0)):
                np.copyto(found[name], value, where=missed)
        return Hits(found["tfar"], found["primID"], found["u"], found["v"])

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        """Whether anything lies within `reach` (in lengths of the direction, a number or ``(n,)``), bool ``(n,)``."""
        # embreex writes into the array of limits and does not support infinity.
        limits = np.minimum(np.broadcast_to(np.asarray(reach, dtype=np.float32), len(origins)), _FAR)
        return self._scene.run(*_rays(origins, directions), dists=limits, query="OCCLUDED") >= 0


def _rays(*parts: np.ndarray) -> list[np.ndarray]:
    return [np.asarray(part, dtype=np.float32) for part in parts]
