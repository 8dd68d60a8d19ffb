"""Light sources: lamps, glowing things, and the sky in the windows, each as a few points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor._srgb import to_linear
from eagor.worlds import sky
from eagor.worlds.raycast import Raycaster
from eagor.worlds.scene import Material, Scene

SKY_GAIN = 5.0  # brightness of the sky over `daylight`, as drawn: eyes and cameras adapt to the room
LIFT = 0.004  # metres from surfaces to the start of rays
GOLDEN = (1 + 5**0.5) / 2
_FAINT = 0.004  # light too faint for a shadow ray
_BALL = 0.1  # metres: radius of a lamp


@dataclass(frozen=True, eq=False)
class Source:
    """Light from a few points ``(K, 3)`` of equal share, which face `normal` ``(3,)``, or all directions if it is None.

    `power` ``(3,)``: the light of a white surface at 1 m that faces it, on its axis. `sky`: multiply the power by the
    radiance of the sky behind the points. `short`: shadow rays end this many metres before the points. `radius`: of the
    disc that each point stands for, which bounds the light close by. The first `probes` points are spread over the
    whole source.
    """

    positions: np.ndarray
    normal: np.ndarray | None
    power: np.ndarray
    sky: bool = False
    short: float = 0.0
    radius: float = 0.2
    probes: int = 6

    def add_to(self, light: np.ndarray, origin: np.ndarray, normal: np.ndarray, shadows: Raycaster) -> None:
        """Add the light of this source to `light` ``(P, 3)`` at points `origin` with the unit normals `normal`.

        If the shadow rays to the first points of the source agree, they decide for the others.
        """
        brightest = float(self.power.max())
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
        gained = np.zeros((len(near), 3 if self.sky else 1), dtype=np.float32)
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
            stop = np.maximum(1 - np.float32(LIFT + self.short) / distance[unsure], 0)
            shaded = shadows.occluded(origin[unsure], way[unsure], stop)
            if k < self.probes:
                asked[unsure] += 1
                passed[unsure] += ~shaded
            lit[unsure[shaded]] = False
            share *= lit
            gained += share[:, None] * sky.radiance(way) if self.sky else share[:, None]
        light[near] += gained * self.power


def lamps(scene: Scene, shadows: Raycaster) -> list[Source]:
    """The lamps, as small balls of points, so that their shadows have soft edges."""
    tetrahedron = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    k = np.arange(12)
    height, angle = (2 * k + 1) / 12 - 1, 2 * np.pi / GOLDEN * k
    ring = np.sqrt(1 - height**2)
    spiral = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    ball = np.concatenate([tetrahedron, spiral]).astype(np.float32)
    found = []
    for lamp in scene.lamps:
        centre = np.asarray(lamp.position, dtype=np.float32)
        # The ball must not extend through the shade.
        free = shadows.cast(np.broadcast_to(centre, ball.shape), ball).distance
        points = centre + np.minimum(0.7 * free, _BALL)[:, None] * ball
        found.append(Source(points, None, np.asarray(lamp.power, dtype=np.float64), probes=4))
    return found


def glowing(scene: Scene) -> list[Source]:
    """Glowing things without a lamp (screens), one source each, as large as its glowing part."""
    emission = np.array([m.emission for m in scene.materials])[scene.material]
    found = []
    for owner in np.unique(scene.instance[emission > 0]):
        thing = scene.instances[owner]
        low, high = thing.low - 0.3, thing.high + 0.3
        if any(((low <= lamp.position) & (lamp.position <= high)).all() for lamp in scene.lamps):
            continue
        mine = np.flatnonzero((scene.instance == owner) & (emission > 0))
        corners = scene.vertices[scene.triangles[mine]].astype(np.float64)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        area = np.linalg.norm(across, axis=1)
        if area.sum() < 1e-6:
            continue
        colour = np.array([mean_colour(scene.materials[k]) * scene.materials[k].emission for k in scene.material[mine]])
        spread = np.searchsorted(np.cumsum(area) / area.sum(), (np.arange(6) + 0.5) / 6)
        facing = across.sum(axis=0)
        flat = np.linalg.norm(facing) > 0.5 * area.sum()
        axis = facing / np.linalg.norm(facing) if flat else None
        points = corners[np.minimum(spread, len(mine) - 1)].mean(axis=1) + (0.02 * axis if axis is not None else 0.0)
        # From any side, a body shows about a quarter of its surface.
        power = (colour * area[:, None]).sum(axis=0) / np.pi * (1.0 if flat else 0.25)
        size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
        found.append(Source(points, axis, power, short=0.0 if flat else size))
    return found


def portals(scene: Scene) -> list[Source]:
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
        inwards = inwards if sides[0] is not None else -inwards
        along = np.eye(3)[1 - axis] * size[1 - axis]
        cells = sorted(range(16), key=lambda cell: (cell not in (0, 3, 5, 10, 12, 15), cell))
        grid = [((cell % 4 + 0.5) / 4 - 0.5, (cell // 4 + 0.5) / 4 - 0.5) for cell in cells]
        points = np.array([thing.centre + a * along + b * np.array([0, 0, size[2]]) for a, b in grid])
        disc = size[1 - axis] * size[2] / np.pi  # squared radius of the disc of equal area
        power = SKY_GAIN * np.asarray(scene.daylight) * disc
        found.append(Source(points, inwards, power, sky=True, short=0.15, radius=np.sqrt(disc / len(points))))
    return found


def leave_through(portal: Source, origin: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Which rays leave through the rectangle that the points of a portal span."""
    assert portal.normal is not None
    along = way @ portal.normal
    middle = portal.positions.mean(axis=0)
    distance = ((middle - origin) @ portal.normal) / np.where(np.abs(along) < 1e-9, 1e-9, along)
    offset = np.abs(origin + distance[:, None] * way - middle)
    half = np.ptp(portal.positions, axis=0) / 2 * (4 / 3) + 0.15  # the points are an eighth of the size off the rim
    return (distance > 0) & (offset <= half).all(axis=1)


def mean_colour(material: Material) -> np.ndarray:
    """The mean reflectance ``(3,)`` of a material, linear."""
    tint = to_linear(np.asarray(material.colour, dtype=np.float64))
    if material.texture is None:
        return tint
    return tint * to_linear(material.texture[::2, ::2, :3] / 255).mean(axis=(0, 1))
