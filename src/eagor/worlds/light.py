"""The baked light of a scene, cached on disk: lamps, glowing surfaces, the sky in the windows, and bounces.

Light is irradiance over pi, so that a white surface has this radiance; linear RGB; 1 is a white surface 1 m in front of
a lamp of power 1. All points of the scene use the same few points of each source, and send their rays along one shared
spiral of directions (Vogel 1979), rotated about the normal from point to point. Neighbours thus complement each other
when the light is smoothed over a surface; independent samples would leave blotches.
"""

from __future__ import annotations

import contextlib
import hashlib
import uuid
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eagor._files import cache_folder
from eagor.worlds.lattice import Lattice
from eagor.worlds.raycast import Raycaster, make_raycaster
from eagor.worlds.scene import Scene
from eagor.worlds.sources import (
    GOLDEN,
    LIFT,
    SKY_GAIN,
    Source,
    glowing,
    lamps,
    leave_through,
    mean_colour,
    portals,
    sky_radiance,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

VERSION = 3  # of the light, part of its file names
DIRECTIONS = 32  # rays per point: their noise is below the detail lost to smoothing
BOUNCES = 4
SMOOTHING = 3  # passes over the indirect light
# Things closer than `NEAR` metres remove up to this share of the light: the lattice is too coarse for fine contact
# shadows between furniture and floor.
CONTACT, NEAR = 0.6, 0.4
_HIGHEST = 6e4  # limit of half precision
_SPARSE = 4  # every fourth direction tests whether a point is shut in


def light_of(scene: Scene, lattice: Lattice, engine: str = "auto", cache: Path | None = None) -> np.ndarray:
    """The light ``(S, 3)`` float32 at the slots of `lattice`, from the cache, or computed and cached.

    `cache`: a folder; None means `cache_folder`. A `UserWarning` says so if it cannot be written.
    """
    folder = cache_folder() if cache is None else Path(cache)
    file = folder / f"light-{VERSION}-{scene.hash}-{_rooms(scene)}.npz"
    found = _read(file, lattice.size)
    if found is None:
        found = np.minimum(bake(scene, lattice, engine), _HIGHEST).astype(np.float16)
        _write(file, found)
    return found.astype(np.float32)


def bake(scene: Scene, lattice: Lattice, engine: str = "auto") -> np.ndarray:
    """The light ``(S, 3)`` at the slots of `lattice`: direct, then `BOUNCES` diffuse reflections."""
    points = lattice.points
    origin = (points.position + LIFT * points.normal).astype(np.float32)
    normal = points.normal.astype(np.float32)
    everything = make_raycaster(scene.vertices, lattice.triangles, engine, watertight=False)
    glows = np.array([m.emission for m in scene.materials])[scene.material] > 0
    # Shades and bulbs do not block the light of the lamps in them.
    solid = lattice.triangles[~glows]
    shadows = everything
    if 0 < len(solid) < len(glows):
        shadows = make_raycaster(scene.vertices, solid, engine, watertight=False)
    windows = portals(scene)
    direct = np.zeros((len(origin), 3), dtype=np.float32)
    sources = [*lamps(scene, shadows), *glowing(scene), *windows]
    for source in sources:
        source.add_to(direct, origin, normal, shadows)
    indirect, close, buried = _gather(scene, lattice, origin, normal, direct, everything, windows, dark=not sources)
    neighbours = _neighbours(lattice)
    direct = _smoothed(_filled(direct, buried, neighbours), neighbours, 2)
    indirect = _smoothed(_filled(indirect, buried, neighbours), neighbours, SMOOTHING)
    contact = 1 - CONTACT * _smoothed(_filled(close[:, None], buried, neighbours), neighbours, 1)
    return ((direct + indirect) * contact)[points.of_slot]


def _gather(
    scene: Scene, lattice: Lattice, origin: np.ndarray, normal: np.ndarray, direct: np.ndarray,
    everything: Raycaster, windows: list[Source], dark: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Indirect light ``(P, 3)``, how close other things are (0 to 1), and which points are shut in.

    The sky counts as indirect light where no window stands for it. A scene without a source (`dark`), such as a scanned
    room, gets even light, less of it in its corners.
    """
    tangent, bitangent = _tangents(normal)
    # Neighbours rotate the set by different angles: one finds what the other misses, and smoothing combines them. The
    # golden angle would not do: it maps each direction of the spiral to the next, so neighbours would look alike.
    turn = (2 * np.pi / np.sqrt(2) * np.arange(len(origin)))[:, None]
    cosine, sine = np.cos(turn).astype(np.float32), np.sin(turn).astype(np.float32)
    facing = lattice.frame[3].astype(np.float32)
    # One more row for rays without a hit: their slot is the one after the last.
    nu, nv = (np.append(column, 0).astype(np.float32) for column in lattice.cells.T)
    base, stride = np.append(lattice.base, lattice.size), nu.astype(np.int32) + 1
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
        if k % _SPARSE == 0:
            back = np.einsum("nk,nk->n", facing[triangle], way) > 0
            back[left] = False
            behind += back
        if dark:
            open_sky += np.where(triangle < 0, 0, np.minimum(hits.distance, 1))[:, None] * daylight
        for window in windows:
            left = left[~leave_through(window, origin[left], way[left])]
        open_sky[left] += sky_radiance(way[left]) * (SKY_GAIN * daylight)
    reflectance = np.array([mean_colour(m) for m in scene.materials], dtype=np.float32)[scene.material]
    reflectance = reflectance[lattice.slots[0]]
    radiance = np.zeros((lattice.size + 1, 3), dtype=np.float32)  # the last: nothing
    indirect = open_sky
    for _ in range(BOUNCES):
        radiance[:-1] = (direct + indirect)[lattice.points.of_slot] * reflectance
        bounced = np.zeros(indirect.shape, dtype=np.float32)
        for row in seen:
            bounced += radiance.take(row, axis=0)
        indirect = open_sky + bounced / DIRECTIONS
    return indirect, close / DIRECTIONS, behind > 0.6 * len(range(0, DIRECTIONS, _SPARSE))


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


def _neighbours(lattice: Lattice) -> csr_array:
    """The number of times that points are neighbours on the same surface, ``(P, P)``."""
    from scipy.sparse import csr_array

    a, b = lattice.links
    count = len(lattice.points.position)
    ones = np.ones(2 * len(a), dtype=np.float32)
    return csr_array((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count))


def _filled(light: np.ndarray, buried: np.ndarray, neighbours: csr_array) -> np.ndarray:
    """`light`, with points that are shut in other things replaced by the mean of their open neighbours."""
    light, missing = np.where(buried[:, None], light.dtype.type(0), light), np.flatnonzero(buried)
    known = (~buried).astype(np.float32)
    for _ in range(4):
        around = neighbours[missing]
        count = around @ known
        reached = count > 0
        light[missing[reached]] = (around @ light)[reached] / count[reached, None]
        known[missing[reached]] = 1
        missing = missing[~reached]
    return light


def _smoothed(light: np.ndarray, neighbours: csr_array, passes: int) -> np.ndarray:
    """`light` ``(P, 3)`` averaged with its neighbours on the same surface, `passes` times."""
    weight = np.maximum(neighbours.sum(axis=1), np.float32(1e-9))[:, None]
    alone = weight < 0.5
    half = np.float32(0.5)
    for _ in range(passes):
        light = np.where(alone, light, half * light + half * (neighbours @ light) / weight)
    return light


def _rooms(scene: Scene) -> str:
    """Six hexadecimal digits for the rooms, which decide which windows lead outdoors and are not in `Scene.hash`."""
    blob = b"".join(np.asarray(room.rectangles, dtype=np.float64).tobytes() + b";" for room in scene.rooms)
    return hashlib.sha256(blob).hexdigest()[:6]


def _read(file: Path, size: int) -> np.ndarray | None:
    """The light in a file, or None if there is none that fits."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            light = stored["light"]
    except Exception:  # missing, damaged, or not an archive: zipfile and NumPy may raise anything
        return None
    return light if light.shape == (size, 3) and light.dtype == np.float16 and np.isfinite(light).all() else None


def _write(file: Path, light: np.ndarray) -> None:
    """Write `file` atomically, so that nobody reads half of it; warn if that fails."""
    # A unique name, so that workers with the same scene do not collide.
    temporary = file.with_name(f"{file.stem}-{uuid.uuid4().hex}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as out:
            np.savez_compressed(out, light=light)
        temporary.replace(file)
    except OSError as error:
        warnings.warn(
            f"the light of the scene could not be kept in {file} ({error}); it will be computed again next time. Set "
            "EAGOR_CACHE to a folder that can be written",
            UserWarning,
            stacklevel=4,
        )
    finally:  # also when interrupted
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
