"""The test that every world has to pass: for plugins, and for ours.

Most faulty worlds have faulty frames: Y up, a mirrored picture, a transposed pose, ranges along the camera's axis. Each
check finds one such mistake, and says what to change.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import cast

import numpy as np

from eagor.errors import WorldError
from eagor.grids import ErpGrid
from eagor.lab.worlds import SimulatedScene, View, World, ground_of, view_of
from eagor.lab.worlds.navmesh import NavMesh
from eagor.lab.worlds.render import Frame
from eagor.lab.worlds.scene import STRUCTURE, Scene
from eagor.media.panorama import turn
from eagor.queries import COLOURS
from eagor.sphere import direction
from eagor.sphere import world_R_body as pose_of

EYE = 1.25  # metres above the floor: height of the camera
NEAR = 0.05  # metres: tolerance of the floor at z = 0, and of an instance's bounds
LOOSE = 0.1  # metres, and a fiftieth of the range: tolerance of points in a picture
OUTSIDE = 0.05  # share of the pixels of an instance that may show points outside its bounds
SPOTS = 9  # places from which the floor is looked at
ALIKE = 0.02  # share of pixels that may differ between two pictures that should be the same
AZIMUTHS = np.radians([-135.0, -75.0, -45.0, 45.0, 105.0, 135.0])  # in which the camera moves, mostly off the axes
Position = tuple[float, float, float]


def check_world(world: World | View, seed: int = 0, *, position: Position = (0.0, 0.0, 0.0), rows: int = 32) -> None:
    """Raise `AssertionError` unless `world` keeps the contract for this `seed`.

    A world that makes a `Scene` or a `SimulatedScene` must make the same one again. It must have a floor at z = 0 to
    stand on, names that can be asked for, at least one thing with a unique name, and bounds that fit the triangles or,
    without triangles, what is seen. Panoramas of `rows` rows (an even number) from a free place, or of a `View` (a
    photograph, another renderer) from `position`, metres, must have the right shapes and types, be reproducible, turn
    and tilt with the camera, and have ranges that shrink by the distance that the camera moves.
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
    ground, view = _check_floor(scene), view_of(scene)
    rng, roomy = np.random.default_rng(seed), float(ground.clearance[ground.free].max()) / 2
    spots = [ground.sample(rng, roomy) for _ in range(1 + SPOTS)]
    places = [(float(xy[0]), float(xy[1]), ground.height(xy) + EYE) for xy in spots]
    _check_view(view, places[0], rows)
    if not isinstance(scene, Scene):
        _check_pixels(scene, view, places[1:], rows)


def _check_things(scene: Scene | SimulatedScene) -> None:
    """Check categories, colours and bounds, if there are triangles, and that something can be asked for."""
    for index, thing in enumerate(scene.instances):
        _require(
            bool(thing.category) and thing.category == " ".join(thing.category.lower().split()),
            f"calls instance {index} {thing.category!r}; wanted lower-case words with single spaces",
        )
        _require(
            thing.colour is None or thing.colour in COLOURS,
            f"gives instance {index} the colour {thing.colour!r}; wanted None or one of {', '.join(COLOURS)}",
        )
        if isinstance(scene, Scene):
            mine = scene.vertices[scene.triangles[scene.instance == index]].reshape(-1, 3)
            _require(len(mine) > 0, f"has no triangle for instance {index} ({thing.name}); wanted at least one")
            low, high = mine.min(axis=0), mine.max(axis=0)
            _require(
                float(np.abs([low - thing.low, high - thing.high]).max()) <= NEAR,
                f"bounds instance {index} ({thing.name}) by {thing.low.round(2)} and {thing.high.round(2)}; wanted "
                f"{low.round(2)} to {high.round(2)}, as its triangles: metres, world frame",
            )
    names = Counter((thing.category, thing.colour) for thing in scene.instances if thing.category not in STRUCTURE)
    _require(
        1 in names.values(),
        f"has {names.total()} things besides {', '.join(STRUCTURE)}, but none with a unique category and colour; "
        "wanted at least one, to be asked for",
    )


def _check_pixels(scene: SimulatedScene, view: View, positions: list[Position], rows: int) -> None:
    """Check, in panoramas from these places, that the floor is below, and things within their bounds."""
    directions = ErpGrid(rows, 2 * rows).directions
    low, high = (np.array([getattr(thing, end) for thing in scene.instances]) for end in ("low", "high"))
    below, pixels, outside = [], *np.zeros((2, len(scene.instances)))
    for position in positions:
        frame = view.panorama(position, np.eye(3), rows, rgb=False)
        if frame.range is None:
            return
        below.append(float(np.median(frame.range[-1])) * abs(float(directions[-1, 0, 2])))
        if frame.ids is None:
            continue
        hit = np.isfinite(frame.range) & (frame.ids >= 0)
        ids, metres = frame.ids[hit], frame.range[hit][:, None].astype(np.float64)
        most = ids.max(initial=-1)
        _require(most < len(low), f"shows the id {most}; wanted indices of its {len(low)} instances")
        points, loose = np.array(position) + metres * directions[hit], LOOSE + 0.02 * metres
        strange = ((points < low[ids] - loose) | (points > high[ids] + loose)).any(axis=1)
        pixels += np.bincount(ids, minlength=len(pixels))
        outside += np.bincount(ids[strange], minlength=len(pixels))
    depth = float(np.median(below))
    _require(
        abs(depth - EYE) <= NEAR,
        f"shows the floor {depth:.2f} m below the camera, {EYE:g} m above the ground; wanted it at z = 0",
    )
    share = outside / np.maximum(pixels, 1)
    worst = int(share.argmax())
    _require(
        share[worst] <= OUTSIDE,
        f"shows {100 * share[worst]:.0f} % of the pixels of instance {worst} ({scene.instances[worst].name}) outside "
        f"its bounds; wanted at most {100 * OUTSIDE:.0f} %: bounds in metres of the world frame, ids are indices",
    )


def _check_floor(scene: Scene | SimulatedScene) -> NavMesh:
    """Check that there is a floor at z = 0, and room to stand on it."""
    try:
        ground = ground_of(scene, 0.18)
    except WorldError as error:
        raise AssertionError(
            f"the world has no ground: {error}. Wanted level triangles at z = 0, metres, z up (not Y up)"
        ) from error
    _require(abs(ground.floor) <= NEAR, f"has its floor at z = {ground.floor:.2f} m; wanted 0: move the scene")
    area = float(ground.free.sum()) * ground.cell**2
    _require(
        area >= 1.0,
        f"lets a body of radius {ground.radius:g} m stand on {area:.2f} square metres; wanted at least 1. Are the "
        "lengths metres? Is everything blocked below 1.5 m?",
    )
    return ground


def _check_view(view: View, position: Position, rows: int) -> None:
    """Check that the view from `position` is a correct panorama."""
    frame = view.panorama(position, np.eye(3), rows)
    _check_frame(frame, rows)
    here, again = _image(frame), _image(view.panorama(position, np.eye(3), rows))
    worst = _unlike(here, again)
    _require(worst <= ALIKE, f"shows {100 * worst:.0f} % of the pixels differently in a second look; wanted no noise")
    # A quarter turn to the left: everything moves a quarter of the image to the right.
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
    """Check shapes, types and values of one panorama."""
    _require(isinstance(frame, Frame), f"shows a {type(frame).__name__}; wanted an eagor.lab.worlds.render.Frame")
    _require(frame.rgb is not None or frame.ids is not None, "shows neither rgb nor ids; wanted at least one of them")
    for name, shape, types, kind in (
        ("rgb", (rows, 2 * rows, 3), np.uint8, "uint8 (sRGB)"),
        ("range", (rows, 2 * rows), np.floating, "floating point (metres)"),
        ("ids", (rows, 2 * rows), np.signedinteger, "signed integers"),
    ):
        part: np.ndarray | None = getattr(frame, name)
        if part is not None:
            fits = part.shape == shape and np.issubdtype(part.dtype, types)
            _require(fits, f"shows {name} of shape {part.shape}, type {part.dtype}; wanted {shape}, {kind}")
    nearest = np.inf if frame.range is None else frame.range.min()  # NaN if there is one
    _require(nearest > 0, f"shows ranges down to {nearest:g} m; wanted all above 0, inf for no hit, no NaN")
    lowest = 0 if frame.ids is None else int(frame.ids.min())
    _require(lowest >= -1, f"shows ids down to {lowest}; wanted indices of the list of instances, and -1 for none")


def _check_tilt(view: View, position: Position, rows: int, here: np.ndarray) -> None:
    """Check that the picture tilts with the camera: it has to be closer to the true tilt than to any other."""
    pose = pose_of(0.0, math.radians(35.0), math.radians(25.0))
    tilted = _image(view.panorama(position, pose, rows)).astype(np.float64)
    tilts = {
        "": pose.T,
        "the camera does not tilt": np.eye(3),
        "it tilts the wrong way: is world_R_body taken for its transpose?": pose,
        "nose up is taken for nose down": pose_of(0.0, -math.radians(35.0), math.radians(25.0)).T,
        "it rolls the wrong way": pose_of(0.0, math.radians(35.0), -math.radians(25.0)).T,
    }
    weights, off = ErpGrid(rows, 2 * rows).weights, {}
    for why, new_R_old in tilts.items():
        gap = np.abs(turn(here.astype(np.float64), new_R_old) - tilted)
        off[why] = float(((gap.mean(axis=-1) if gap.ndim == 3 else np.minimum(gap, 1)) * weights).sum())
    why = min(off, key=lambda name: off[name])
    _require(
        why == "",
        f"does not show the view of a camera with its nose 35 degrees down and its right side 25 degrees down "
        f"({why}); wanted the panorama turned by world_R_body.T: direction_body = world_R_body.T @ direction_world",
    )


def _check_ranges(view: View, position: Position, rows: int, range: np.ndarray) -> None:
    """Check that ranges shrink by the distance moved towards a thing: metres, along the ray, in the world frame."""
    grid = ErpGrid(rows, 2 * rows)
    x, y, _ = grid.project(direction(AZIMUTHS, np.full(len(AZIMUTHS), -0.1)))
    shares = []
    for cell in zip(y.astype(int), x.astype(int), strict=True):
        if math.isfinite(before := float(range[cell])):
            there = (np.asarray(position) + 0.25 * before * grid.directions[cell]).tolist()
            after = view.panorama((there[0], there[1], there[2]), np.eye(3), rows, rgb=False).range
            shares.append(math.nan if after is None else float(after[cell]) / before)
    left = float(np.median(shares or [0.75]))
    _require(
        abs(left - 0.75) <= 0.02,
        f"shows things at {100 * left:.0f} % of their range after the camera has moved 25 % of the way to them; wanted "
        "75 %: ranges are metres along the ray (not depth along an axis), and position is in metres, z up",
    )


def _image(frame: Frame) -> np.ndarray:
    """The part of pictures that is compared: colour if there is one, otherwise ids."""
    return frame.rgb if frame.rgb is not None else cast(np.ndarray, frame.ids)


def _unlike(a: np.ndarray, b: np.ndarray) -> float:
    """The share of pixels that differ by more than rounding."""
    gap = np.abs(a.astype(np.int64) - b.astype(np.int64))
    return float((gap.max(axis=-1) > 2 if gap.ndim == 3 else gap > 0).mean())


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(f"the world {text}")
