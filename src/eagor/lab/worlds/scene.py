"""A scene: triangles with their instances and materials, and the light sources.

World frame: x and y horizontal, z up, right-handed, metres; the floor is at z = 0. The built-in apartments and any
imported GLB become the same `Scene`, which the renderer (`eagor.lab.worlds.render`), the ground plan
(`eagor.lab.worlds.ground`) and the exporters use. A scene is immutable.

Its light (`eagor.lab.worlds.light`) is computed at a `Lattice` of samples on every triangle. A triangle with the edges
e1 and e2 from its corner 0 carries (nu + 1) x (nv + 1) samples at corner + i/nu e1 + j/nv e2. Neighbouring samples are
at most a step apart; small triangles have only their corners. Corner 0 is opposite the longest edge, so that the two
halves of a rectangle have the same samples. The triangles for rays stay whole: there are no cracks, and light can be
finer than the mesh. The cells that straddle the longest edge need the part of the lattice beyond it. That part lies on
the other half if the triangle is half of a parallelogram; otherwise it is moved back to the edge.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace

import numpy as np

from eagor._values import lazy
from eagor.errors import WorldError

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
        return f"{self.colour} {self.category}" if self.colour else self.category


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

    @lazy
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner ``(3,)`` of everything."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    def room_at(self, x: float, y: float) -> Room | None:
        """The room at a point, or None."""
        return next((room for room in self.rooms if room.contains(x, y)), None)


# --- the points at which its light is computed ------------------------------------------------------------------------

STEP = 0.13  # metres between samples
_OUTSIDE = 0.8  # the same on walls that no room can see
_MOST = 1_500_000  # samples; huge scenes get a coarser step
_CREASE = np.cos(np.radians(40.0))  # surfaces that meet at a sharper angle do not share their light
_INSET = 0.02  # metres from samples to the rim of their surface, where walls meet


@dataclass(frozen=True, eq=False)
class Lattice:
    """The samples of a scene, "slots", triangle by triangle.

    `triangles` ``(T, 3)`` int32: those of the scene, each rotated so that its longest edge is opposite corner 0, and
    `turned` ``(T,)``, by how many corners; `cells` ``(T, 2)`` int32, nu and nv; `base` ``(T,)`` int32, the first slot.
    """

    scene: Scene
    triangles: np.ndarray
    turned: np.ndarray
    cells: np.ndarray
    base: np.ndarray

    @classmethod
    def of(cls, scene: Scene, step: float = STEP) -> Lattice:
        """The lattice with samples about `step` metres apart."""
        corners = scene.vertices[scene.triangles]
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        turned = (edges.argmax(axis=1) + 2) % 3  # edge k joins the corners k and k + 1; corner k + 2 is opposite
        places = (turned[:, None] + np.arange(3)) % 3
        lengths = np.take_along_axis(edges, places, axis=1)[:, [0, 2]].astype(np.float64)
        lengths[unseen(scene)] *= STEP / _OUTSIDE
        while True:
            cells = np.maximum(np.ceil(lengths / step - 1e-3), 1).astype(np.int64)
            sizes = (cells + 1).prod(axis=1)
            if sizes.sum() <= _MOST + 5 * len(sizes):
                break
            step *= 1.25
        base = np.cumsum(sizes) - sizes
        triangles = np.take_along_axis(scene.triangles, places, axis=1).astype(np.int32)
        return cls(scene, triangles, turned, cells.astype(np.int32), base.astype(np.int32))

    @property
    def size(self) -> int:
        """The number of slots."""
        return int(self.base[-1] + (self.cells[-1] + 1).prod())

    @lazy
    def slots(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Triangle, i and j of every slot."""
        sizes = (self.cells.astype(np.int64) + 1).prod(axis=1)
        triangle = np.repeat(np.arange(len(sizes)), sizes)
        within = np.arange(len(triangle)) - self.base[triangle]
        j, i = np.divmod(within, self.cells[triangle, 0] + 1)
        return triangle, i, j

    @lazy
    def frame(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Corner 0, e1, e2 and the unit normal of every triangle, ``(T, 3)`` float64 each (the normal may be 0)."""
        corners = self.scene.vertices[self.triangles].astype(np.float64)
        e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normal = np.cross(e1, e2)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return corners[:, 0], e1, e2, normal / np.maximum(length, 1e-20)

    @lazy
    def areas(self) -> np.ndarray:
        """Square metres that each slot stands for, ``(S,)``."""
        _, e1, e2, _ = self.frame
        sizes = (self.cells + 1).prod(axis=1)
        return np.repeat(np.linalg.norm(np.cross(e1, e2), axis=1) / 2 / sizes, sizes)

    @lazy
    def points(self) -> Points:
        """The slots, merged where they are the same point of the same smooth surface."""
        corner, e1, e2, _ = self.frame
        triangle, i, j = self.slots
        u, v = i / self.cells[triangle, 0], j / self.cells[triangle, 1]
        beyond = (u + v > 1) & ~self._is_half()[triangle]
        excess = np.where(beyond, np.maximum(u + v, 1.0), 1.0)
        u, v = u / excess, v / excess
        place = corner[triangle] + u[:, None] * e1[triangle] + v[:, None] * e2[triangle]
        smooth = self._smooth_normals()
        shares = zip((1 - u - v, u, v), (0, 1, 2), strict=True)
        first, second, third = (smooth[triangle, k] * share[:, None] for share, k in shares)
        away = first + second + third
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-20)
        _, first, index = np.unique(_key(place, away), return_index=True, return_inverse=True)
        order = first.argsort()  # neighbours stay neighbours: consecutive rays then hit the same things
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        index = rank[index]
        # Away from the rim, towards the middle of the triangle (of the parallelogram, beyond its diagonal).
        middle = corner + (e1 + e2) / 3
        middle = np.where((u + v > 1 + 1e-9)[:, None], (corner + (e1 + e2) * 2 / 3)[triangle], middle[triangle])
        inwards = middle - place
        distance = np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-9)
        place = place + inwards * np.minimum(_INSET / distance, 0.25)
        count = np.bincount(index).astype(np.float64)
        position = np.stack([np.bincount(index, place[:, k]) for k in range(3)], axis=1) / count[:, None]
        facing = np.stack([np.bincount(index, away[:, k]) for k in range(3)], axis=1)
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-20)
        return Points(position, facing, index)

    @lazy
    def links(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of neighbouring points, as two index arrays."""
        triangle, i, j = self.slots
        nu, nv = self.cells[triangle, 0], self.cells[triangle, 1]
        slot, point = np.arange(len(i)), self.points.of_slot
        inside = i / nu + j / nv <= 1 + 1e-9
        right = slot[(i < nu) & inside]
        down = slot[(j < nv) & inside]
        across = slot[(i < nu) & (j < nv) & inside]
        a = np.concatenate([point[right], point[down], point[across + 1]])
        b = np.concatenate([point[right + 1], point[down + nu[down] + 1], point[across + nu[across] + 1]])
        return a[a != b], b[a != b]

    def _is_half(self) -> np.ndarray:
        """Which triangles are halves of a parallelogram along their longest edge, ``(T,)`` bool."""
        corner, e1, e2, normal = self.frame
        sides = np.stack([np.linalg.norm(e, axis=1) for e in (e1, e2)], axis=1)
        key = _key(corner + (e1 + e2) / 2, normal) ^ _key(np.pad(sides, ((0, 0), (0, 1))), np.zeros_like(normal))
        _, index, count = np.unique(key, return_inverse=True, return_counts=True)
        return count[index] >= 2

    def _smooth_normals(self) -> np.ndarray:
        """Normals at the corners ``(T, 3, 3)``: the mean over the triangles there that meet below the crease angle."""
        corner, e1, e2, normal = self.frame
        place = np.stack([corner, corner + e1, corner + e2], axis=1).reshape(-1, 3)
        weight = np.repeat(np.linalg.norm(np.cross(e1, e2), axis=1), 3)
        owner = np.repeat(np.arange(len(corner)), 3)
        order = np.argsort(_key(place, np.zeros_like(place)), kind="stable")
        key = _key(place, np.zeros_like(place))[order]
        start = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
        size = np.diff(np.append(start, len(key)))
        total = np.zeros((len(place), 3))
        # Every corner is compared with every other one of its group: the k-th neighbour of all corners at once.
        offset = np.arange(len(key)) - np.repeat(start, size)
        length = np.repeat(size, size)
        for k in range(min(int(size.max()), 64)):
            here = np.flatnonzero(k < length)
            other = order[here - offset[here] + (offset[here] + k) % length[here]]
            mine = order[here]
            smooth = np.einsum("nk,nk->n", normal[owner[mine]], normal[owner[other]]) >= _CREASE
            total[mine] += np.where(smooth, weight[other], 0.0)[:, None] * normal[owner[other]]
        lost = np.linalg.norm(total, axis=1) < 1e-12
        total[lost] = normal[owner[lost]]
        return (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)).reshape(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class Points:
    """`position` and unit `normal` ``(P, 3)`` of the points that light is computed at, and `of_slot` ``(S,)``."""

    position: np.ndarray
    normal: np.ndarray
    of_slot: np.ndarray


def unseen(scene: Scene) -> np.ndarray:
    """Which triangles ``(T,)`` lie deep in or beyond the walls around the rooms; none without known rooms."""
    x, y, _ = scene.vertices[scene.triangles].mean(axis=1).T
    outside = np.full(len(x), bool(scene.rooms))
    for room in scene.rooms:
        outside &= ~replace(room, rectangles=room.rectangles - np.array([1, 1, -1, -1]) * 0.2).contains(x, y)
    return outside


def _key(place: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """A hash ``(n,)`` uint64 that is the same for places within a millimetre and normals within a few degrees."""
    # Shifted by a third of a step, since coordinates are often round values.
    steps = np.concatenate([np.floor(place * 1000 + 0.3137), np.floor(normal * 6 + 0.3137)], axis=1).astype(np.int64)
    key = np.zeros(len(steps), dtype=np.uint64)
    for column in steps.T:  # a mixing step of splitmix64 (Steele, Lea, Flood 2014) for every number
        key = (key ^ column.view(np.uint64)) * np.uint64(0xBF58476D1CE4E5B9)
        key ^= key >> np.uint64(29)
    return key
