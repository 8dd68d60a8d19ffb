"""The test that every world has to pass: for authors of plugins, and for ours.

Most worlds that are wrong are wrong in their frames: Y up, the picture mirrored, a pose taken for its transpose, ranges
measured along the axis of a camera. Each rule here finds one such mistake, and says what to change.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import cast

import numpy as np

from eagor.errors import WorldError
from eagor.grids import ErpGrid
from eagor.queries import COLOURS
from eagor.sphere import direction
from eagor.sphere import world_R_body as pose_of
from eagor.worlds import View, World
from eagor.worlds.ground import Ground
from eagor.worlds.panorama import turn
from eagor.worlds.render import Frame, Renderer
from eagor.worlds.scene import STRUCTURE, Scene

EYE = 1.25  # metres above the floor: where the camera looks from
FREE = 1.0  # square metres on which a body has to be able to stand
NEAR = 0.05  # metres between the floor and z = 0, and between an instance's bounds and its triangles
ALIKE = 0.02  # share of pixels that may differ between two pictures that should be the same
STEP = 0.25  # share of the way to what is seen that the camera goes, to see whether it comes nearer by that
AZIMUTHS = np.radians([-135.0, -75.0, -45.0, 45.0, 105.0, 135.0])  # looked along, most between the axes


def check_world(
    world: World | View, seed: int = 0, *, position: tuple[float, float, float] = (0.0, 0.0, 0.0), rows: int = 32
) -> None:
    """Raise `AssertionError` unless `world` keeps the contract for this `seed`.

    A world that makes a `Scene` must make the same one again; have a floor at z = 0 on which one can stand, names that
    can be asked for, at least one thing that a query singles out, and bounds that fit their triangles. What is seen of
    it from a free place, and what a `View` (a photograph, a renderer of one's own) shows from `position`, metres, in
    panoramas of so many `rows` (an even number), must come in the right shapes and types, be the same when looked at
    twice, turn and tilt with the camera, and come nearer by the metres that the camera goes.
    """
    if isinstance(world, View):
        _check_view(world, position, rows)
        return
    scene = cast(World, world)(seed)
    _require(
        isinstance(scene, Scene), f"made a {type(scene).__name__} of seed {seed}; wanted a Scene (eagor.worlds.scene)"
    )
    again = cast(World, world)(seed)
    _require(
        scene.hash == again.hash,
        f"made scene {scene.hash} of seed {seed}, then {again.hash}; wanted the same each time: draw everything from "
        "np.random.default_rng(seed), and nothing from what was made before",
    )
    _check_names(scene)
    _check_bounds(scene)
    ground = _check_floor(scene)
    xy = ground.sample(np.random.default_rng(seed), float(ground.clearance[ground.free].max()) / 2)
    _check_view(Renderer(scene), (float(xy[0]), float(xy[1]), ground.floor + EYE), rows)


def _check_names(scene: Scene) -> None:
    """Categories and colours are words that queries are made of, and something can be asked for."""
    for index, thing in enumerate(scene.instances):
        _require(
            bool(thing.category) and thing.category == " ".join(thing.category.lower().split()),
            f"calls instance {index} {thing.category!r}; wanted lower-case words with single spaces, such as "
            "'coffee table': queries are compared with them",
        )
        _require(
            thing.colour is None or thing.colour in COLOURS,
            f"gives instance {index} ({thing.category}) the colour {thing.colour!r}; wanted None or one of "
            f"{', '.join(COLOURS)}: choose the nearest",
        )
    things = [thing for thing in scene.instances if thing.category not in STRUCTURE]
    names = Counter((thing.category, thing.colour) for thing in things)
    _require(
        1 in names.values(),
        f"has {len(things)} things besides {', '.join(STRUCTURE)}, and no category and colour that only one of them "
        "has; wanted one at least: tasks have to be able to ask for something. Add a thing, or a colour",
    )


def _check_bounds(scene: Scene) -> None:
    """The bounds of each instance are those of its triangles."""
    for index, thing in enumerate(scene.instances):
        mine = scene.vertices[scene.triangles[scene.instance == index]].reshape(-1, 3)
        _require(
            len(mine) > 0,
            f"has no triangle for instance {index} ({thing.name}); wanted one at least: leave out what cannot be seen",
        )
        low, high = mine.min(axis=0), mine.max(axis=0)
        off = float(max(np.abs(low - thing.low).max(), np.abs(high - thing.high).max()))
        _require(
            off <= NEAR,
            f"bounds instance {index} ({thing.name}) by {_point(thing.low)} and {_point(thing.high)}, {off:.2f} m off "
            f"its triangles, which reach from {_point(low)} to {_point(high)}; wanted theirs, metres, world frame",
        )


def _check_floor(scene: Scene) -> Ground:
    """There is a floor at z = 0, and room to stand on it."""
    try:
        ground = Ground.from_scene(scene)
    except WorldError as error:
        raise AssertionError(
            f"the world has no ground: {error}. Wanted level triangles at z = 0, metres, z up (not Y up)"
        ) from error
    _require(
        abs(ground.floor) <= NEAR,
        f"has its floor at z = {ground.floor:.2f} m; wanted 0, which is where cameras and trackers take it to be: move "
        "the scene",
    )
    area = float(ground.free.sum()) * ground.cell**2
    _require(
        area >= FREE,
        f"lets a body of radius {ground.radius:g} m stand on {area:.2f} square metres; wanted {FREE:g} at least. Are "
        "the lengths metres? Is something below 1.5 m in the way everywhere?",
    )
    return ground


def _check_view(view: View, position: tuple[float, float, float], rows: int) -> None:
    """What is seen from `position` is a true panorama."""
    ahead = np.eye(3)
    frame = view.panorama(position, ahead, rows)
    _check_frame(frame, rows)
    again = _image(view.panorama(position, ahead, rows))
    here = _image(frame)
    worst = _unlike(here, again)
    _require(
        worst <= ALIKE,
        f"shows {100 * worst:.0f} % of the pixels differently when it is looked at again; wanted the same picture: no "
        "noise, and no state that a look changes",
    )
    # A quarter to the left: everything moves a quarter of the image to the right.
    left = _image(view.panorama(position, pose_of(math.pi / 2), rows))
    right, wrong = (_unlike(left, np.roll(here, columns, axis=1)) for columns in (rows // 2, -(rows // 2)))
    hint = "; it turns the wrong way: is the picture mirrored, or world_R_body transposed?" if wrong <= ALIKE else ""
    _require(
        right <= ALIKE,
        f"shows {100 * right:.0f} % of the pixels elsewhere than a quarter of the image to the right after the camera "
        f"has turned to the left by 90 degrees; wanted at most {100 * ALIKE:.0f} %{hint}. The middle of the image "
        "looks along +x of the body, its left half to +y",
    )
    _check_tilt(view, position, rows, here)
    if frame.range is not None:
        _check_ranges(view, position, rows, frame.range)


def _check_frame(frame: Frame, rows: int) -> None:
    """Shapes, types and values of one panorama."""
    _require(isinstance(frame, Frame), f"shows a {type(frame).__name__}; wanted an eagor.worlds.render.Frame")
    _require(
        frame.rgb is not None or frame.ids is not None,
        "shows neither rgb nor ids, though both were asked for; wanted one of them at least",
    )
    for name, part, shape, kinds in (
        ("rgb", frame.rgb, (rows, 2 * rows, 3), "u"),
        ("range", frame.range, (rows, 2 * rows), "f"),
        ("ids", frame.ids, (rows, 2 * rows), "i"),
    ):
        if part is not None:
            fits = part.shape == shape and part.dtype.kind in kinds and (name != "rgb" or part.dtype == np.uint8)
            kind = {"u": "uint8 (sRGB)", "f": "floating point (metres)", "i": "signed integers"}[kinds]
            _require(fits, f"shows {name} of shape {part.shape}, type {part.dtype}; wanted {shape}, {kind}")
    if frame.range is not None:
        _require(
            bool((frame.range > 0).all()),
            f"shows ranges down to {np.min(frame.range):g} m; wanted all above 0, inf where nothing is, no NaN",
        )
    if frame.ids is not None:
        lowest = int(frame.ids.min())
        _require(
            lowest >= -1, f"shows ids down to {lowest}; wanted places in the list of instances, and -1 for nothing"
        )


def _check_tilt(view: View, position: tuple[float, float, float], rows: int, here: np.ndarray) -> None:
    """The picture tilts as the camera does: it is nearer to what it should be than to any other tilt of it."""
    pose = pose_of(0.0, math.radians(35.0), math.radians(25.0))
    tilted = _image(view.panorama(position, pose, rows)).astype(np.float64)
    others = {
        "the camera does not tilt": np.eye(3),
        "it tilts the wrong way: is world_R_body taken for its transpose?": pose,
        "nose up is taken for nose down": pose_of(0.0, -math.radians(35.0), math.radians(25.0)).T,
        "it rolls the wrong way": pose_of(0.0, math.radians(35.0), -math.radians(25.0)).T,
    }
    still = here.astype(np.float64)
    weights = ErpGrid(rows, 2 * rows).weights

    def off(new_R_old: np.ndarray) -> float:
        gap = np.abs(turn(still, new_R_old) - tilted)
        return float((gap.mean(axis=-1) * weights).sum() if gap.ndim == 3 else (np.minimum(gap, 1) * weights).sum())

    wanted, rivals = off(pose.T), {why: off(matrix) for why, matrix in others.items()}
    why = min(rivals, key=lambda name: rivals[name])
    _require(
        wanted <= rivals[why],
        f"does not show what a camera sees whose nose is 35 degrees down and whose right side is 25 degrees down "
        f"({why}); wanted the panorama turned by world_R_body.T: direction_body = world_R_body.T @ direction_world",
    )


def _check_ranges(view: View, position: tuple[float, float, float], rows: int, range: np.ndarray) -> None:
    """Going some way towards what is seen brings it nearer by that way: metres, along the ray, in the world frame."""
    grid = ErpGrid(rows, 2 * rows)
    x, y, _ = grid.project(direction(AZIMUTHS, np.full(len(AZIMUTHS), -0.1)))
    found = []
    for row, column in zip(y.astype(int), x.astype(int), strict=True):
        before = float(range[row, column])
        if not math.isfinite(before):
            continue
        there = np.asarray(position) + STEP * before * grid.directions[row, column]
        after = view.panorama((float(there[0]), float(there[1]), float(there[2])), np.eye(3), rows, rgb=False).range
        found.append(math.nan if after is None else float(after[row, column]) / before)
    if found:
        left = float(np.median(found))
        _require(
            abs(left - (1 - STEP)) <= 0.02,
            f"shows things at {100 * left:.0f} % of their range after the camera has gone {100 * STEP:.0f} % of the "
            f"way to them; wanted {100 * (1 - STEP):.0f} %: ranges are metres from the camera along the ray (not depth "
            "along an axis), and position is in metres of the world frame, x and y level, z up",
        )


def _image(frame: Frame) -> np.ndarray:
    """What pictures are compared by: colour where there is one, else ids."""
    return frame.rgb if frame.rgb is not None else cast(np.ndarray, frame.ids)


def _unlike(a: np.ndarray, b: np.ndarray) -> float:
    """The share of pixels that differ by more than rounding."""
    gap = np.abs(a.astype(np.int64) - b.astype(np.int64))
    return float(((gap.max(axis=-1) if gap.ndim == 3 else gap) > (2 if gap.ndim == 3 else 0)).mean())


def _point(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in values) + ")"


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(f"the world {text}")
