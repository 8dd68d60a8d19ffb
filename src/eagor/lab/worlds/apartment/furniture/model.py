"""The model of a piece of furniture, and common joinery: wood, legs, drawer fronts and handles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.lab.worlds.apartment.mesh import Mesh, Part, bevelled, box, lathe, merged, moved, part, post, tube
from eagor.lab.worlds.apartment.textures import REPEAT, material
from eagor.lab.worlds.scene import Lamp

WOODS = ("brown", "white", "black", "beige")  # colours of wooden furniture

# Maps one of its kind's colours (str), or None if it has none, to the parts of a piece.
Builder = Callable[[Any, np.random.Generator], Iterable[Part | Lamp]]
Rectangle = tuple[float, float, float, float]  # x0, y0, x1, y1


@dataclass(frozen=True, eq=False)
class Model:
    """A piece of furniture: `parts` and `lamps` in the model frame, metres; its front faces +x, z is up.

    The origin is the centre of the footprint on the floor; for things on a wall, the centre of their back face (parts
    at x >= 0, z about 0); for things on the ceiling, the centre of their top (z <= 0). `colour`: its main colour as a
    plain word, or None; `size` ``(3,)``: extents along x, y, z; `seed`: of its generator.
    """

    category: str
    colour: str | None
    parts: tuple[Part, ...]
    size: np.ndarray
    lamps: tuple[Lamp, ...] = ()
    seed: int = 0

    @property
    def height(self) -> float:
        """Metres from its lowest to its highest point."""
        return float(self.size[2])


@dataclass(frozen=True)
class Kind:
    """A category: its choice of main `colours`, empty if none dominates, and `make`, which builds a piece.

    `placement`: "floor", "top" (stands on another piece), "hung" (on a wall) or "ceiling".
    """

    colours: tuple[str, ...]
    make: Builder
    placement: str = "floor"


def assembled(category: str, colour: str | None, made: Iterable[Part | Lamp], placement: str) -> Model:
    """The model of these parts and lamps, shifted so that its origin fits `placement`."""
    made = tuple(made)
    parts, lamps = [p for p in made if isinstance(p, Part)], [p for p in made if isinstance(p, Lamp)]
    low = np.min([piece.low for piece in parts], axis=0).astype(np.float64)
    high = np.max([piece.high for piece in parts], axis=0).astype(np.float64)
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    if placement == "hung":
        origin[0], origin[2] = low[0], (low[2] + high[2]) / 2
    elif placement == "ceiling":
        origin[2] = high[2]
    shift = origin.astype(np.float32)
    return Model(
        category,
        colour,
        tuple(Part(piece.vertices - shift, piece.triangles, piece.uv, piece.material) for piece in parts),
        high - low,
        tuple(Lamp(np.asarray(lamp.position, dtype=np.float64) - origin, lamp.power) for lamp in lamps),
    )


def finish(kind: str, colour: str | None, rng: np.random.Generator) -> Callable[..., Part]:
    """A function from meshes to one `Part` covered with a material of `kind`; its pieces share the material."""
    cover = material(kind, colour, rng)
    return lambda *meshes: part(merged(*meshes), cover, REPEAT[kind])


def timber(colour: str, rng: np.random.Generator) -> Callable[..., Part]:
    """The finish of wooden furniture: visible grain where it is a colour of wood, else mostly paint."""
    grained = colour in ("brown", "beige") or (colour in ("black", "grey") and rng.random() < 0.5)
    return finish("wood" if grained else "paint", colour, rng)


def fittings(rng: np.random.Generator) -> Callable[..., Part]:
    """The finish of handles and metal legs: steel or black."""
    return finish("metal", None if rng.random() < 0.6 else "black", rng)


def polar(radius: Any, angle: float, z: Any) -> tuple[Any, Any, Any]:
    """A point (or points, for arrays) `radius` from the z axis, `angle` radians from +x, at the height z."""
    return radius * math.cos(angle), radius * math.sin(angle), z


def legs(inset: Rectangle, height: float, size: float, foot: float = 0.0, splay: float = 0.0) -> Mesh:
    """Four square legs under the rectangle `inset` that joins the middles of their tops, metres.

    They measure `size` at the top and `foot` at the floor (0: the same), where they stand `splay` further out.
    """
    x0, y0, x1, y1 = inset
    feet = [(x, y, dx, dy) for x, dx in ((x0, -splay), (x1, splay)) for y, dy in ((y0, -splay), (y1, splay))]
    below = (foot or size, foot or size)
    return merged(*(post((x + dx, y + dy, 0), (x, y, height), below, (size, size)) for x, y, dx, dy in feet))


def apron(inset: Rectangle, low: float, high: float, thickness: float = 0.02) -> Mesh:
    """Four boards on edge that join the legs over the rectangle `inset` from `low` to `high`."""
    x0, y0, x1, y1 = inset
    t = thickness / 2
    return merged(
        *(box((x0, y - t, low), (x1, y + t, high), grain=0) for y in (y0, y1)),
        *(box((x - t, y0, low), (x + t, y1, high), grain=1) for x in (x0, x1)),
    )


def panel(x: float, y0: float, y1: float, z0: float, z1: float) -> Mesh:
    """A drawer front or small door: its back at `x`, facing +x, the grain along its longer side."""
    return bevelled((x, y0, z0), (x + 0.018, y1, z1), 0.004, grain=1 if y1 - y0 > z1 - z0 else 2)


def facing(mesh: Mesh, at: tuple[float, float, float]) -> Mesh:
    """A shape made about the z axis, laid over so that its top faces +x, at a point."""
    return moved(Mesh(mesh.vertices[:, [2, 0, 1]], mesh.triangles, mesh.uv), at)  # a rotation keeps the outside


def knob(x: float, y: float, z: float, size: float = 0.015) -> Mesh:
    """A turned knob of radius `size`, on a front at `x` that faces +x."""
    profile = [(0.45 * size, 0), (size, size), (0.8 * size, 1.6 * size), (0, 1.8 * size)]
    return facing(lathe(profile, 8), (x, y, z))


def pull(x: float, y: float, z: float, length: float, upright: bool = False) -> Mesh:
    """A bar handle of `length`, centred at (y, z) on a front at `x` that faces +x."""
    along = np.array([0, 0, 1.0]) if upright else np.array([0, 1.0, 0])
    start, end = np.array([x, y, z]) - along * length / 2, np.array([x, y, z]) + along * length / 2
    out = np.array([0.028, 0, 0])
    return tube([start, start + out, end + out, end], 0.006, sides=5)
