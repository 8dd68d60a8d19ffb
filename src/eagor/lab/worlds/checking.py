"""The test that every world has to pass: for plugins, and for ours.

Most faulty worlds have faulty frames: Y up, a mirrored picture, a transposed pose, ranges along the camera's axis. Five
laws find them: the same seed makes the same scene; its things can be asked for and lie where their bounds say; there is
a floor at z = 0 to stand on; pictures turn with the camera; ranges shrink as it comes closer.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import cast

import numpy as np

from eagor.grids import ErpGrid
from eagor.lab.worlds import SimulatedScene, View, World, ground_of, view_of
from eagor.lab.worlds.render import Frame
from eagor.lab.worlds.scene import STRUCTURE, Scene
from eagor.queries import COLOURS
from eagor.sources.panorama import turn
from eagor.sphere import direction, world_R_body

EYE = 1.25  # metres above the floor: height of the camera
NEAR = 0.05  # metres: tolerance of the floor at z = 0, and of an instance's bounds
LOOSE = 0.1  # metres, and a fiftieth of the range: tolerance of points in a picture
OUTSIDE = 0.05  # share of the pixels of an instance that may show points outside its bounds
SPOTS = 9  # places from which the things of another simulator are looked at
NOISE = 0.02  # share of pixels that may differ between two pictures that should be the same
AZIMUTHS = np.radians([-135.0, -75.0, -45.0, 45.0, 105.0, 135.0])  # in which the camera moves, mostly off the axes
Position = tuple[float, float, float]


def check_world(world: World | View, seed: int = 0, *, position: Position = (0.0, 0.0, 0.0), rows: int = 32) -> None:
    """Raise `AssertionError` unless `world` keeps the contract for this `seed`.

    A world that makes a `Scene` or a `SimulatedScene` is looked at from free places, a `View` (a photograph, another
    renderer) from `position`, metres, in panoramas of `rows` rows (an even number).
    """
    if isinstance(world, View):
        _check_view(world, position, rows)
        return
    scene, again = (cast(World, world)(seed) for _ in range(2))
    _require(isinstance(scene, Scene | SimulatedScene), f"made a {type(scene).__name__} of seed {seed}; wanted a Scene")
    _require(
        scene.hash == again.hash,
        f"made scene {scene.hash} of seed {seed}, then {again.hash}; wanted the same each time: draw everything from "
        "np.random.default_rng(seed)",
    )
    _check_things(scene)
    ground, view = ground_of(scene, 0.18), view_of(scene)
    area = float(ground.free.sum()) * ground.cell**2
    _require(
        abs(ground.floor) <= NEAR and area >= 1.0,
        f"has its floor at z = {ground.floor:.2f} m, and {area:.2f} square metres where a body of radius 0.18 m can "
        "stand; wanted level triangles at z = 0 (metres, z up, not Y up), and at least 1",
    )
    rng, roomy = np.random.default_rng(seed), float(ground.clearance[ground.free].max()) / 2
    spots = [ground.sample(rng, roomy) for _ in range(1 + SPOTS)]
    places = [(float(xy[0]), float(xy[1]), ground.height(xy) + EYE) for xy in spots]
    _check_view(view, places[0], rows)
    if not isinstance(scene, Scene):
        _check_bounds(scene, view, places[1:], rows)


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(f"the world {text}")


def _check_things(scene: Scene | SimulatedScene) -> None:
    """Names that can be asked for, one of them unique; bounds as of the triangles, if there are any."""
    for index, thing in enumerate(scene.instances):
        _require(
            bool(thing.category) and thing.category == " ".join(thing.category.lower().split())
            and thing.colour in (None, *COLOURS),
            f"calls instance {index} {thing.category!r}, colour {thing.colour!r}; wanted lower-case words with single "
            f"spaces, and None or one of {', '.join(COLOURS)}",
        )  # fmt: skip
        if isinstance(scene, Scene):
            mine = scene.vertices[scene.triangles[scene.instance == index]].reshape(-1, 3)
            low, high = mine.min(axis=0, initial=np.inf), mine.max(axis=0, initial=-np.inf)
            _require(
                float(np.abs([low - thing.low, high - thing.high]).max()) <= NEAR,
                f"bounds instance {index} ({thing.name}) by {thing.low.round(2)} and {thing.high.round(2)}; its "
                f"{len(mine) // 3} triangles lie in {low.round(2)} to {high.round(2)}; wanted the same: metres, world "
                "frame",
            )
    names = Counter((thing.category, thing.colour) for thing in scene.instances if thing.category not in STRUCTURE)
    _require(
        1 in names.values(),
        f"has {names.total()} things besides {', '.join(STRUCTURE)}, but none with a unique category and colour; "
        "wanted at least one, to be asked for",
    )


def _check_bounds(scene: SimulatedScene, view: View, places: list[Position], rows: int) -> None:
    """The floor is where the ground is, and what is seen of things lies within their bounds."""
    directions = ErpGrid(rows, 2 * rows).directions
    low, high = (np.array([getattr(thing, end) for thing in scene.instances]) for end in ("low", "high"))
    frames = [view.panorama(place, np.eye(3), rows, rgb=False) for place in places]
    if any(frame.range is None or frame.ids is None for frame in frames):
        return
    metres, ids = (np.array([getattr(frame, part) for frame in frames]) for part in ("range", "ids"))
    depth = float(np.median(metres[:, -1])) * abs(float(directions[-1, 0, 2]))
    _require(
        abs(depth - EYE) <= NEAR,
        f"shows the floor {depth:.2f} m below the camera, {EYE:g} m above the ground; wanted it at z = 0",
    )
    hit = np.isfinite(metres) & (ids >= 0)
    points = (np.array(places)[:, None, None] + metres[..., None] * directions)[hit]
    ids, loose = np.minimum(ids[hit], len(low) - 1), LOOSE + 0.02 * metres[hit][:, None]
    strange = ((points < low[ids] - loose) | (points > high[ids] + loose)).any(axis=1)
    outside, pixels = np.bincount(ids[strange], minlength=len(low)), np.bincount(ids, minlength=len(low))
    share = outside / np.maximum(pixels, 1)
    worst = int(share.argmax())
    _require(
        share[worst] <= OUTSIDE,
        f"shows {100 * share[worst]:.0f} % of the pixels of instance {worst} ({scene.instances[worst].name}) outside "
        f"its bounds; wanted at most {100 * OUTSIDE:.0f} %: bounds in metres of the world frame, ids are indices",
    )


def _check_view(view: View, position: Position, rows: int) -> None:
    """A panorama from `position` has the right shapes, stays the same, turns with the camera, and has true ranges."""
    frame = view.panorama(position, np.eye(3), rows)
    _require(isinstance(frame, Frame), f"shows a {type(frame).__name__}; wanted an eagor.lab.worlds.render.Frame")
    _require(frame.rgb is not None or frame.ids is not None, "shows neither rgb nor ids; wanted at least one of them")
    for name, shape, types, least, kind in (
        ("rgb", (rows, 2 * rows, 3), np.uint8, 0, "uint8 (sRGB)"),
        ("range", (rows, 2 * rows), np.floating, 1e-9, "floating point: metres above 0, inf for no hit, no NaN"),
        ("ids", (rows, 2 * rows), np.signedinteger, -1, "signed integers: indices of instances, -1 for none"),
    ):
        part: np.ndarray | None = getattr(frame, name)
        _require(
            part is None or (part.shape == shape and np.issubdtype(part.dtype, types) and part.min() >= least),
            f"shows {name} of {part if part is None else (part.shape, part.dtype, part.min())}; wanted {shape}, {kind}",
        )

    def seen(pose: np.ndarray) -> np.ndarray:
        """The part of the picture that is compared, ``(rows, 2 rows, n)``: colour if there is one, otherwise ids."""
        found = view.panorama(position, pose, rows)
        return np.asarray(found.ids if found.rgb is None else found.rgb, dtype=np.float64).reshape(rows, 2 * rows, -1)

    def unlike(one: np.ndarray, other: np.ndarray) -> float:
        """How different two pictures are: colours by how much, ids in which share of the sphere."""
        gap = np.abs(one - other) if frame.rgb is not None else one != other
        return float((gap.mean(axis=-1) * ErpGrid(rows, 2 * rows).weights).sum())

    here = seen(np.eye(3))
    noise = float((np.abs(seen(np.eye(3)) - here) > (0 if frame.rgb is None else 2)).any(axis=-1).mean())
    _require(noise <= NOISE, f"shows {100 * noise:.0f} % of the pixels differently in a second look; wanted no noise")
    for yaw, pitch, roll in ((90, 0, 0), (0, 35, 25)):
        angles = np.radians([yaw, pitch, roll])
        pose = world_R_body(*angles)
        turns = {
            "": pose.T,
            "the camera does not turn or tilt": np.eye(3),
            "it turns the wrong way: is the picture mirrored, or world_R_body taken for its transpose?": pose,
            "nose up is taken for nose down": world_R_body(*angles * [1, -1, 1]).T,
            "it rolls the wrong way": world_R_body(*angles * [1, 1, -1]).T,
        }
        picture = seen(pose)
        why = min(turns, key=lambda name: unlike(turn(here, turns[name]), picture))
        _require(
            why == "",
            f"does not show what a camera sees {yaw} degrees to the left, with its nose {pitch} and its right side "
            f"{roll} degrees down ({why}); wanted the panorama turned by world_R_body.T: direction_body = "
            "world_R_body.T @ direction_world. The middle of the image looks along +x of the body, its left to +y",
        )
    if frame.range is None:
        return
    grid, shares = ErpGrid(rows, 2 * rows), []
    x, y, _ = grid.project(direction(AZIMUTHS, np.full(len(AZIMUTHS), -0.1)))
    for cell in zip(y.astype(int), x.astype(int), strict=True):
        if math.isfinite(before := float(frame.range[cell])):
            there = np.asarray(position) + 0.25 * before * grid.directions[cell]
            after = view.panorama(there, np.eye(3), rows, rgb=False).range
            shares.append(math.nan if after is None else float(after[cell]) / before)
    left = float(np.median(shares or [0.75]))
    _require(
        abs(left - 0.75) <= 0.02,
        f"shows things at {100 * left:.0f} % of their range after the camera has moved 25 % of the way to them; wanted "
        "75 %: ranges are metres along the ray (not depth along an axis), and position is in metres, z up",
    )
