"""The light of a scene, computed once and kept on disk: lamps, glowing surfaces, the sky in the windows, and bounces.

Light is irradiance over pi, so that a white surface has this radiance; linear RGB; 1 is a white surface 1 m in front of
a lamp of power 1. All points of the scene see the same few points of each source, and send their rays along one shared
low-discrepancy set of directions (R2 sequence, M. Roberts 2018), turned about the normal from point to point: when the
light is smoothed over a surface, neighbours complete each other. Independent samples would leave blotches.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from pathlib import Path

import numpy as np

from eagor.worlds import sky
from eagor.worlds.lattice import Lattice
from eagor.worlds.raycast import Raycaster, make_raycaster
from eagor.worlds.scene import Scene
from eagor.worlds.sources import GOLDEN, LIFT, SKY_GAIN, Source, glowing, lamps, leave_through, mean_colour, portals

VERSION = 2  # of the light: part of the name of its files
DIRECTIONS = 96  # rays per point
BOUNCES = 4
SMOOTHING = 3  # passes over the indirect light
# What is closer than `NEAR` metres takes up to this share of the light: the lattice is too coarse for the fine shadows
# that tie furniture to the floor.
CONTACT, NEAR = 0.6, 0.4
_SPARSE = 4  # every which direction is asked whether a point is shut in


def light_of(scene: Scene, lattice: Lattice, engine: str = "auto", cache: Path | None = None) -> np.ndarray:
    """The light ``(S, 3)`` float32 at the slots of `lattice`, from the cache or else computed and put there.

    `cache` is a folder; None means `cache_folder`. Where it cannot be written, a `UserWarning` says so.
    """
    folder = cache_folder() if cache is None else Path(cache)
    file = folder / f"light-{VERSION}-{scene.hash}.npz"
    found = _read(file, lattice.size)
    if found is None:
        found = bake(scene, lattice, engine).astype(np.float16)
        _write(file, found)
    return found.astype(np.float32)


def cache_folder() -> Path:
    """Where light is kept: $EAGOR_CACHE, else eagor in $XDG_CACHE_HOME, else ~/.cache/eagor; looked up when called."""
    if chosen := os.environ.get("EAGOR_CACHE"):
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "eagor"


def bake(scene: Scene, lattice: Lattice, engine: str = "auto") -> np.ndarray:
    """The light ``(S, 3)`` at the slots of `lattice`: direct, then `BOUNCES` diffuse reflections."""
    points = lattice.points
    origin = (points.position + LIFT * points.normal).astype(np.float32)
    normal = points.normal.astype(np.float32)
    everything = make_raycaster(scene.vertices, lattice.triangles, engine)
    glows = np.array([m.emission for m in scene.materials])[scene.material] > 0
    # Shades and bulbs do not darken the light that the lamps in them stand for.
    solid = lattice.triangles[~glows]
    shadows = make_raycaster(scene.vertices, solid, engine) if 0 < len(solid) < len(glows) else everything
    windows = portals(scene)
    direct = np.zeros((len(origin), 3))
    sources = [*lamps(scene, shadows), *glowing(scene), *windows]
    for source in sources:
        source.add_to(direct, origin, normal, shadows)
    indirect, close, buried = _gather(scene, lattice, origin, normal, direct, everything, windows, dark=not sources)
    direct = _smoothed(_filled(direct, buried, lattice), lattice, 2)
    indirect = _smoothed(_filled(indirect, buried, lattice), lattice, SMOOTHING)
    contact = 1 - CONTACT * _smoothed(_filled(close[:, None], buried, lattice), lattice, 1)
    return ((direct + indirect) * contact)[points.of_slot]


def _gather(
    scene: Scene,
    lattice: Lattice,
    origin: np.ndarray,
    normal: np.ndarray,
    direct: np.ndarray,
    everything: Raycaster,
    windows: list[Source],
    dark: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indirect light ``(P, 3)``, how close other things are (0 to 1), and which points are shut in.

    The sky counts to the indirect light where no window stands for it. A scene without a source (`dark`), such as a
    scanned room, is filled with even light, less of it in its corners.
    """
    tangent, bitangent = _tangents(normal)
    # Neighbours turn the set by different angles: what one of them misses the smoothing finds.
    turn = (2 * np.pi / GOLDEN * np.arange(len(origin)))[:, None]
    cosine, sine = np.cos(turn).astype(np.float32), np.sin(turn).astype(np.float32)
    facing = lattice.frame[3].astype(np.float32)
    # One row more, for rays that hit nothing: their slot is the one after the last.
    nu, nv = (np.append(column, 0).astype(np.float32) for column in lattice.cells.T)
    base, stride = np.append(lattice.base, lattice.size), nu.astype(np.int32) + 1
    seen = np.empty((DIRECTIONS, len(origin)), dtype=np.int32)
    open_sky, behind = np.zeros((len(origin), 3)), np.zeros(len(origin), dtype=np.int32)
    close = np.zeros(len(origin), dtype=np.float32)
    daylight = np.asarray(scene.daylight) / DIRECTIONS
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
            open_sky += np.where(triangle < 0, 0, np.minimum(hits.distance, 1.0))[:, None] * daylight
        for window in windows:
            left = left[~leave_through(window, origin[left], way[left])]
        open_sky[left] += sky.radiance(way[left]) * (SKY_GAIN * daylight)
    reflectance = np.array([mean_colour(m) for m in scene.materials])[scene.material]
    triangle = lattice.slots[0]
    of_slot = lattice.points.of_slot
    radiance = np.zeros((lattice.size + 1, 3), dtype=np.float32)  # the last: nothing
    indirect = open_sky.copy()
    for _ in range(BOUNCES):
        radiance[:-1] = (direct + indirect)[of_slot] * reflectance[triangle]
        bounced = np.zeros(indirect.shape, dtype=np.float32)
        for row in seen:
            bounced += radiance.take(row, axis=0)
        indirect = open_sky + bounced / DIRECTIONS
    return indirect, close / DIRECTIONS, behind > 0.6 * len(range(0, DIRECTIONS, _SPARSE))


def hemisphere(count: int) -> np.ndarray:
    """Directions ``(count, 3)`` about +z, as dense as the cosine of their angle to it."""
    plastic = 1.32471795724474602596
    k = np.arange(1, count + 1)
    first, second = (0.5 + k / plastic) % 1, (0.5 + k / plastic**2) % 1
    radius, angle = np.sqrt(first), 2 * np.pi * second
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - first)], axis=1)


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across each normal ``(P, 3)`` (Duff et al., JCGT 6, 2017)."""
    x, y, z = normal.T
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)


def _filled(light: np.ndarray, buried: np.ndarray, lattice: Lattice) -> np.ndarray:
    """`light` with the points that are shut in other things given the mean of their neighbours in the open."""
    a, b = lattice.links
    light, missing = np.where(buried[:, None], light.dtype.type(0), light), buried.copy()
    for _ in range(4):
        known = np.concatenate([~missing[b], ~missing[a]])
        into, source = np.concatenate([a, b])[known], np.concatenate([b, a])[known]
        count = np.bincount(into, minlength=len(light))
        channels = [np.bincount(into, column[source], minlength=len(light)) for column in light.T]
        total = np.stack(channels, axis=1)
        reached = missing & (count > 0)
        light[reached] = total[reached] / count[reached, None]
        missing &= ~reached
    return light


def _smoothed(light: np.ndarray, lattice: Lattice, passes: int) -> np.ndarray:
    """`light` ``(P, 3)`` averaged with its neighbours on the same surface, `passes` times."""
    from scipy.sparse import csr_array

    a, b = lattice.links
    count = len(light)
    ones = np.ones(2 * len(a), dtype=np.float32)
    neighbours = csr_array((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count))
    weight = np.maximum(neighbours.sum(axis=1), 1e-9)[:, None]
    alone = weight < 0.5
    for _ in range(passes):
        light = np.where(alone, light, 0.5 * light + 0.5 * (neighbours @ light) / weight)
    return light


def _read(file: Path, size: int) -> np.ndarray | None:
    """The light in a file, or None where there is none that fits."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            light = stored["light"]
    except Exception:  # missing, cut short, no archive: zipfile and NumPy raise whatever the damage leads them to
        return None
    return light if light.shape == (size, 3) and light.dtype == np.float16 and np.isfinite(light).all() else None


def _write(file: Path, light: np.ndarray) -> None:
    """Put the light into `file` in one step, so that nobody ever reads half of it; a warning where that fails."""
    temporary = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as out:
            temporary = Path(out.name)
            np.savez_compressed(out, light=light)
        temporary.replace(file)
    except OSError as error:
        warnings.warn(
            f"the light of the scene could not be kept in {file} ({error}); it will be computed again next time. Set "
            "EAGOR_CACHE to a folder that can be written",
            UserWarning,
            stacklevel=4,
        )
        if temporary is not None:
            temporary.unlink(missing_ok=True)
