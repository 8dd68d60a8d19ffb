"""The light of a scene: its sources, and what reaches each surface, baked and cached on disk.

Sources are lamps and the sky in the windows, each as a few points; what glows is bright, but lights nothing. The sky is
infinitely far away: it depends on the direction alone, world frame.

Light is irradiance over pi, so that a white surface has this radiance; linear RGB; 1 is a white surface 1 m in front of
a lamp of power 1. All points of the scene use the same few points of each source, and send their rays along one shared
spiral of directions (Vogel 1979), rotated about the normal from point to point: neighbours complement each other when
the light is smoothed over a surface.

It is computed at a `Lattice` of samples on every triangle. A triangle with the edges e1 and e2 from its corner 0 has
(nu + 1) x (nv + 1) samples at corner + i/nu e1 + j/nv e2, some beyond its longest edge, which is opposite corner
0, for the cells that straddle it. So the two halves of a rectangle have the same samples. Neighbouring ones are at most
a step apart; small triangles have only their corners. The triangles for rays stay whole: there are no cracks, and light
can be finer than the mesh.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import math
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from eagor._files import cache_folder, written
from eagor._values import lazy
from eagor.errors import StorageError
from eagor.lab.worlds.scene import Raycaster, Scene

HORIZON, ZENITH = np.array([0.93, 0.95, 0.97]), np.array([0.38, 0.57, 0.88])  # linear colours of the sky
_GROUND = np.array([0.24, 0.25, 0.21])
SKY_GAIN = 5.0  # brightness of the sky over `daylight`, as drawn: eyes and cameras adapt to the room
LIFT = 0.004  # metres from surfaces to the start of rays
GOLDEN = (1 + 5**0.5) / 2
_FAINT = 0.004  # light too faint for a shadow ray
_BALL = 0.1  # metres: radius of a lamp
_FRAME = 0.15  # metres before a window at which shadow rays end
VERSION = 4  # of the light, part of its file names
DIRECTIONS = 32  # rays per point: their noise is below the detail lost to smoothing
BOUNCES = 4
SMOOTHING = 3  # passes over the indirect light
CONTACT, NEAR = 0.6, 0.4  # share of the light that things closer than so many metres remove: for contact shadows
_HIGHEST = 6e4  # limit of half precision


def sky_radiance(directions: np.ndarray) -> np.ndarray:
    """Light ``(n, 3)``, linear RGB, from the directions ``(n, 3)``: about 1 near the horizon, a quarter below it."""
    height = _unit(directions)[:, 2:3]
    sky = HORIZON + (ZENITH - HORIZON) * np.sqrt(np.clip(height, 0, 1))
    blend = np.clip(height / 0.1 + 0.5, 0, 1)
    return blend * sky + (1 - blend) * _GROUND


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
        return corners[:, 0], e1, e2, _unit(np.cross(e1, e2))

    @lazy
    def points(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions and unit normals ``(P, 3)`` of the points that light is computed at, and the point of every slot.

        Slots are merged where they are the same point of the same smooth surface.
        """
        corner, e1, e2, _ = self.frame
        triangle, i, j = self.slots
        u, v = i / self.cells[triangle, 0], j / self.cells[triangle, 1]
        place = corner[triangle] + u[:, None] * e1[triangle] + v[:, None] * e2[triangle]
        smooth = self._smooth_normals()
        away = _unit(np.sum([smooth[triangle, k] * w[:, None] for k, w in enumerate((1 - u - v, u, v))], axis=0))
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
        return position, _unit(facing), index

    def neighbours(self) -> csr_array:
        """The number of times that points are neighbours on the same surface, ``(P, P)``."""
        triangle, i, j = self.slots
        nu, nv = self.cells[triangle, 0], self.cells[triangle, 1]
        slot, (position, _, point) = np.arange(len(i)), self.points
        inside = i / nu + j / nv <= 1 + 1e-9
        right = slot[(i < nu) & inside]
        down = slot[(j < nv) & inside]
        across = slot[(i < nu) & (j < nv) & inside]
        a = np.concatenate([point[right], point[down], point[across + 1]])
        b = np.concatenate([point[right + 1], point[down + nu[down] + 1], point[across + nu[across] + 1]])
        a, b = a[a != b], b[a != b]
        count = len(position)
        ones = np.ones(2 * len(a), dtype=np.float32)
        return csr_array((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count))

    def _smooth_normals(self) -> np.ndarray:
        """Normals at the corners ``(T, 3, 3)``: the mean over the triangles there that meet below the crease angle."""
        corner, e1, e2, normal = self.frame
        place = np.stack([corner, corner + e1, corner + e2], axis=1).reshape(-1, 3)
        weight = np.repeat(np.linalg.norm(np.cross(e1, e2), axis=1), 3)
        owner = np.repeat(np.arange(len(corner)), 3)
        key = _key(place, np.zeros_like(place))
        order = np.argsort(key, kind="stable")
        start, size = np.unique(key[order], return_index=True, return_counts=True)[1:]
        offset = np.arange(len(key)) - np.repeat(start, size)
        length = np.repeat(size, size)
        total = np.zeros((len(place), 3))
        # Every corner is compared with every other one of its group: the k-th neighbour of all corners at once.
        for k in range(min(int(size.max()), 64)):
            here = np.flatnonzero(k < length)
            other = order[here - offset[here] + (offset[here] + k) % length[here]]
            mine = order[here]
            smooth = np.einsum("nk,nk->n", normal[owner[mine]], normal[owner[other]]) >= _CREASE
            total[mine] += np.where(smooth, weight[other], 0.0)[:, None] * normal[owner[other]]
        lost = np.linalg.norm(total, axis=1) < 1e-12
        total[lost] = normal[owner[lost]]
        return _unit(total).reshape(-1, 3, 3)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors ``(n, 3)`` of length 1, or 0."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-20)


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


# --- sources ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Source:
    """Light from a few points ``(K, 3)`` of equal share: a lamp, or a window, which faces the room along `normal`.

    `power` ``(3,)``: the light of a white surface at 1 m that faces it, on its axis; of a window, times the radiance of
    the sky behind the points. `radius`: of the disc that each point stands for, which bounds the light close by. The
    first `probes` points are spread over the whole source.
    """

    positions: np.ndarray
    normal: np.ndarray | None
    power: np.ndarray
    radius: float
    probes: int

    def add_to(self, light: np.ndarray, origin: np.ndarray, normal: np.ndarray, shadows: Raycaster) -> None:
        """Add the light of this source to `light` ``(P, 3)`` at points `origin` with the unit normals `normal`.

        If the shadow rays to the first points of the source agree, they decide for the others.
        """
        brightest, sky = float(self.power.max()), self.normal is not None
        axis = None if self.normal is None else self.normal.astype(np.float32)
        centre = self.positions.mean(axis=0)
        spread = float(np.linalg.norm(self.positions - centre, axis=1).max())
        way = centre.astype(np.float32) - origin
        reached = np.einsum("nk,nk->n", way, way) < brightest / _FAINT
        reached &= np.einsum("nk,nk->n", way, normal) > -spread
        if axis is not None:
            reached &= way @ axis < spread
        near = np.flatnonzero(reached)
        origin, normal = origin[near], normal[near]
        asked, passed = np.zeros(len(near), dtype=np.int32), np.zeros(len(near), dtype=np.int32)
        gained = np.zeros((len(near), 3 if sky else 1), dtype=np.float32)
        for k, place in enumerate(self.positions.astype(np.float32)):
            if k == self.probes:  # points that no probe reaches stay dark
                left = np.flatnonzero(passed)
                light[near] += gained * self.power
                near, origin, normal, asked, passed = (a[left] for a in (near, origin, normal, asked, passed))
                gained = np.zeros((len(near), gained.shape[1]), dtype=np.float32)
            way = place - origin
            square = np.einsum("nk,nk->n", way, way)
            distance = np.maximum(np.sqrt(square), np.float32(1e-6))
            share = np.einsum("nk,nk->n", way, normal) / distance
            if axis is not None:
                share *= np.maximum(-(way @ axis), 0) / distance
            share /= (square + np.float32(self.radius**2)) * np.float32(len(self.positions))
            lit = share * np.float32(brightest) > _FAINT / len(self.positions)
            unsure = np.flatnonzero(lit if k < self.probes else lit & (passed < asked))
            stop = np.maximum(1 - np.float32(LIFT + (_FRAME if sky else 0.0)) / distance[unsure], 0)
            shaded = shadows.occluded(origin[unsure], way[unsure], stop)
            if k < self.probes:
                asked[unsure] += 1
                passed[unsure] += ~shaded
            lit[unsure[shaded]] = False
            share *= lit
            gained += share[:, None] * sky_radiance(way) if sky else share[:, None]
        light[near] += gained * self.power


def lamps(scene: Scene, shadows: Raycaster) -> list[Source]:
    """The lamps, as small balls of points, so that their shadows have soft edges."""
    height = (np.arange(12) * 5 % 12 + 0.5) / 6 - 1  # of a spiral, in an order in which the first are far apart
    angle, ring = 2 * np.pi / GOLDEN * np.arange(12), np.sqrt(1 - height**2)
    ball = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1).astype(np.float32)
    found = []
    for lamp in scene.lamps:
        centre = np.asarray(lamp.position, dtype=np.float32)
        # The ball must not extend through the shade.
        free = shadows.cast(np.broadcast_to(centre, ball.shape), ball).distance
        points = centre + np.minimum(0.7 * free, _BALL)[:, None] * ball
        found.append(Source(points, None, np.asarray(lamp.power, dtype=np.float64), 0.2, 4))
    return found


def windows_of(scene: Scene) -> list[Source]:
    """Windows between a room and the outdoors, through which the sky shines in."""
    found = []
    for thing in scene.instances:
        if thing.category != "window" or not scene.rooms:
            continue
        size = thing.high - thing.low
        axis = int(size[:2].argmin())
        inwards = np.eye(3)[axis]
        sides = [scene.room_at(*(thing.centre + sign * (0.35 + size[axis] / 2) * inwards)[:2]) for sign in (1, -1)]
        if (sides[0] is None) == (sides[1] is None):
            continue
        along, up = np.eye(3)[1 - axis] * size[1 - axis], np.array([0, 0, size[2]])
        cells = np.array([0, 3, 5, 10, 12, 15, 1, 2, 4, 6, 7, 8, 9, 11, 13, 14])[:, None]  # the first are far apart
        points = thing.centre + ((cells % 4 + 0.5) / 4 - 0.5) * along + ((cells // 4 + 0.5) / 4 - 0.5) * up
        disc = size[1 - axis] * size[2] / np.pi  # squared radius of the disc of equal area
        power = SKY_GAIN * np.asarray(scene.daylight) * disc
        found.append(Source(points, inwards if sides[0] is not None else -inwards, power, math.sqrt(disc / 16), 6))
    return found


def leave_through(window: Source, origin: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Which rays leave through the rectangle that the points of a window span."""
    assert window.normal is not None
    along = way @ window.normal
    middle = window.positions.mean(axis=0)
    distance = ((middle - origin) @ window.normal) / np.where(np.abs(along) < 1e-9, 1e-9, along)
    offset = np.abs(origin + distance[:, None] * way - middle)
    half = np.ptp(window.positions, axis=0) / 2 * (4 / 3) + 0.15  # the points are an eighth of the size off the rim
    return (distance > 0) & (offset <= half).all(axis=1)


def light_of(scene: Scene, lattice: Lattice, cache: Path | None = None) -> np.ndarray:
    """The light ``(S, 3)`` float32 at the slots of `lattice`, from the cache, or computed and cached.

    `cache`: a folder; None means `cache_folder`. A `UserWarning` says so if it cannot be written.
    """
    folder = cache_folder() if cache is None else Path(cache)
    # Rooms are not in the hash of a scene, but decide which windows lead outdoors.
    rooms = b"".join(np.asarray(room.rectangles, dtype=np.float64).tobytes() + b";" for room in scene.rooms)
    file = folder / f"light-{VERSION}-{scene.hash}-{hashlib.sha256(rooms).hexdigest()[:6]}.npz"
    with contextlib.suppress(Exception):  # missing, damaged, or not an archive: zipfile and NumPy may raise anything
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            light = stored["light"]
        if light.shape == (len(lattice.slots[0]), 3) and light.dtype == np.float16 and np.isfinite(light).all():
            return light.astype(np.float32)
    light = np.minimum(bake(scene, lattice), _HIGHEST).astype(np.float16)
    packed = io.BytesIO()
    np.savez_compressed(packed, light=light)
    try:
        written(file, packed.getvalue())
    except StorageError as error:
        warnings.warn(
            f"the light of the scene could not be kept and will be computed again next time: {error}, or set "
            "EAGOR_CACHE to a folder that can be written",
            UserWarning,
            stacklevel=3,
        )
    return light.astype(np.float32)


def bake(scene: Scene, lattice: Lattice) -> np.ndarray:
    """The light ``(S, 3)`` at the slots of `lattice`: direct, then `BOUNCES` diffuse reflections."""
    position, normal, of_slot = lattice.points
    origin, normal = (position + LIFT * normal).astype(np.float32), normal.astype(np.float32)
    everything = Raycaster(scene.vertices, lattice.triangles, watertight=False)
    glows = np.array([m.emission for m in scene.materials])[scene.material] > 0
    # Shades and bulbs do not block the light of the lamps in them.
    mixed = 0 < glows.sum() < len(glows)
    shadows = Raycaster(scene.vertices, lattice.triangles[~glows], watertight=False) if mixed else everything
    windows = windows_of(scene)
    direct = np.zeros((len(origin), 3), dtype=np.float32)
    sources = [*lamps(scene, shadows), *windows]
    for source in sources:
        source.add_to(direct, origin, normal, shadows)
    indirect, close, buried = _gather(scene, lattice, origin, normal, direct, everything, windows, dark=not sources)
    neighbours = lattice.neighbours()
    total = _smoothed(direct, buried, neighbours, 2) + _smoothed(indirect, buried, neighbours, SMOOTHING)
    contact = 1 - CONTACT * _smoothed(close[:, None], buried, neighbours, 1)
    return (total * contact)[of_slot]


def _gather(
    scene: Scene, lattice: Lattice, origin: np.ndarray, normal: np.ndarray, direct: np.ndarray,
    everything: Raycaster, windows: list[Source], dark: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Indirect light ``(P, 3)``, how close other things are (0 to 1), and which points are shut in.

    The sky counts as indirect light where no window stands for it. A scene without a source (`dark`), such as a scanned
    room, gets even light, less of it in its corners.
    """
    tangent, bitangent = _tangents(normal)
    # Neighbours rotate the set by different angles, not by the golden one, which maps the spiral onto itself.
    turn = (2 * np.pi / np.sqrt(2) * np.arange(len(origin)))[:, None]
    cosine, sine = np.cos(turn).astype(np.float32), np.sin(turn).astype(np.float32)
    facing = lattice.frame[3].astype(np.float32)
    # One more row for rays without a hit: their slot is the one after the last.
    nu, nv = (np.append(column, 0).astype(np.float32) for column in lattice.cells.T)
    base, stride = np.append(lattice.base, len(lattice.slots[0])), nu.astype(np.int32) + 1
    seen = np.empty((DIRECTIONS, len(origin)), dtype=np.int32)
    open_sky, behind = np.zeros((len(origin), 3), dtype=np.float32), np.zeros(len(origin), dtype=np.int32)
    close = np.zeros(len(origin), dtype=np.float32)
    daylight = np.asarray(scene.daylight, dtype=np.float32) / DIRECTIONS
    for k, (x, y, z) in enumerate(hemisphere(DIRECTIONS).astype(np.float32)):
        way = (x * cosine - y * sine) * tangent
        way += (x * sine + y * cosine) * bitangent
        way += z * normal
        hits = everything.cast(origin, way)
        triangle = hits.triangle.astype(np.intp)
        i, j = (w * n[triangle] + np.float32(0.5) for w, n in ((hits.u, nu), (hits.v, nv)))
        seen[k] = base[triangle] + i.astype(np.int32) + j.astype(np.int32) * stride[triangle]
        close += np.maximum(1 - hits.distance / np.float32(NEAR), 0)
        left = np.flatnonzero(triangle < 0)
        behind += (np.einsum("nk,nk->n", facing[triangle], way) > 0) & (triangle >= 0)
        if dark:
            open_sky += np.where(triangle < 0, 0, np.minimum(hits.distance, 1))[:, None] * daylight
        for window in windows:
            left = left[~leave_through(window, origin[left], way[left])]
        open_sky[left] += sky_radiance(way[left]) * (SKY_GAIN * daylight)
    reflectance = np.array([look.reflectance for look in scene.materials], dtype=np.float32)[scene.material]
    reflectance = reflectance[lattice.slots[0]]
    radiance = np.zeros((len(lattice.slots[0]) + 1, 3), dtype=np.float32)  # the last: nothing
    indirect = open_sky
    for _ in range(BOUNCES):
        radiance[:-1] = (direct + indirect)[lattice.points[2]] * reflectance
        bounced = np.zeros(indirect.shape, dtype=np.float32)
        for row in seen:
            bounced += radiance.take(row, axis=0)
        indirect = open_sky + bounced / DIRECTIONS
    return indirect, close / DIRECTIONS, behind > 0.6 * DIRECTIONS


def hemisphere(count: int) -> np.ndarray:
    """Directions ``(count, 3)`` about +z with cosine-weighted density."""
    share, angle = (np.arange(count) + 0.5) / count, 2 * np.pi / GOLDEN * np.arange(count)
    radius = np.sqrt(share)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - share)], axis=1)


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors normal to each normal ``(P, 3)`` (Duff et al., JCGT 6, 2017)."""
    x, y, z = normal.T
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)


def _smoothed(light: np.ndarray, buried: np.ndarray, neighbours: csr_array, passes: int) -> np.ndarray:
    """`light` ``(P, n)`` averaged with its neighbours on the same surface, `passes` times.

    Before that, points that are shut in other things (`buried`) take the mean of their open neighbours.
    """
    light, missing = np.where(buried[:, None], light.dtype.type(0), light), np.flatnonzero(buried)
    known = (~buried).astype(np.float32)
    for _ in range(4):
        around = neighbours[missing]
        count = around @ known
        reached = count > 0
        light[missing[reached]] = (around @ light)[reached] / count[reached, None]
        known[missing[reached]] = 1
        missing = missing[~reached]
    weight = np.maximum(neighbours.sum(axis=1), np.float32(1e-9))[:, None]
    half = np.float32(0.5)
    for _ in range(passes):
        light = np.where(weight < 0.5, light, half * light + half * (neighbours @ light) / weight)
    return light
