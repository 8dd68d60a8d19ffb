"""A small room with coloured balls, painted by ray casting: no files, no graphics library, true perspective.

World frame: the origin is on the floor in the middle of the room, x to the front wall (a picture), y to the left wall
(a window), z up, metres. The right wall is striped and the back wall has a door: no mirror image or quarter turn of the
room looks like the room, so wrong signs show. Walls, floor and ceiling are muted, the balls are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eagor._srgb import to_coded, to_linear
from eagor.errors import EagorError, PoseError
from eagor.grids import ErpGrid
from eagor.sphere import check_rotation

BALL_COLOURS = {
    "red": (200, 30, 35), "orange": (238, 125, 25), "yellow": (238, 205, 40), "green": (35, 140, 60),
    "blue": (35, 75, 190), "purple": (125, 50, 160), "pink": (240, 140, 175), "white": (242, 242, 238),
    "black": (22, 22, 24),
}  # fmt: skip
EYE = (0.0, 0.0, 1.3)  # default position of the camera
SIZE = np.array([7.0, 5.6, 2.7])  # metres: length of the room along x, width along y, height
LOW, HIGH = SIZE * [-0.5, -0.5, 0.0], SIZE * [0.5, 0.5, 1.0]
LAMP = SIZE * [0.06, 0.04, 0.88]  # position of the light, world frame

# The six faces of the room: the colour of each, and the rectangles on it, the last on top. A rectangle is its middle
# and half its size along the two axes of the face, in the order x, y, z, metres, and its colour; colours are sRGB.
_SKIRTING = ((0.0, 0.0), (3.5, 0.12), (230, 228, 224))
_FLOOR = 4  # of the faces
_FACES = (
    ((190, 188, 196), (  # the back wall: a panelled door, right of the middle as one faces it
        _SKIRTING, ((1.1, 1.0), (0.56, 1.12), (234, 232, 228)), ((1.1, 1.0), (0.46, 1.02), (140, 134, 128)),
        ((1.1, 0.55), (0.33, 0.36), (124, 118, 113)), ((1.1, 1.45), (0.33, 0.42), (124, 118, 113)),
        ((0.72, 1.0), (0.04, 0.04), (200, 196, 186)),
    )),
    ((206, 197, 184), (  # the front wall: a framed picture, left of the middle
        _SKIRTING, ((0.7, 1.54), (0.72, 0.48), (74, 68, 64)), ((0.7, 1.54), (0.66, 0.42), (232, 230, 224)),
        ((0.7, 1.54), (0.55, 0.32), (205, 208, 210)), ((0.7, 1.4), (0.55, 0.18), (140, 146, 140)),
        ((0.45, 1.32), (0.3, 0.1), (112, 116, 110)),
    )),
    ((170, 178, 188), (  # the right wall: broad upright stripes
        *(((x, 1.35), (0.175, 1.35), (208, 206, 200)) for x in np.arange(-3.325, 3.5, 0.7)), _SKIRTING,
    )),
    ((184, 192, 182), (  # the left wall: a window of two by three panes
        _SKIRTING, ((-0.5, 1.57), (1.28, 0.73), (236, 235, 230)),
        *(((x, 1.25), (0.37, 0.3), (168, 176, 166)) for x in (-1.3, -0.5, 0.3)),
        *(((x, 1.35), (0.37, 0.2), (255, 255, 255)) for x in (-1.3, -0.5, 0.3)),
        *(((x, 1.9), (0.37, 0.3), (250, 255, 255)) for x in (-1.3, -0.5, 0.3)),
    )),
    ((190, 172, 150), (  # the floor: boards, and a rug with borders
        ((0.3, -0.2), (1.7, 1.15), (150, 152, 158)), ((0.3, -0.2), (1.5, 0.95), (196, 190, 180)),
        ((0.3, -0.2), (1.2, 0.65), (150, 152, 158)), ((0.3, -0.2), (0.6, 0.3), (196, 190, 180)),
    )),
    ((228, 226, 220), ((tuple(LAMP[:2]), (0.25, 0.25), (255, 255, 255)),)),  # the ceiling, bright where the lamp hangs
)  # fmt: skip


@dataclass(frozen=True)
class Ball:
    """A ball at `position` (3,) in metres, world frame; `colour` is a name of `BALL_COLOURS` or sRGB 0 to 255."""

    position: tuple[float, float, float]
    radius: float = 0.3
    colour: str | tuple[int, int, int] = "red"

    def __post_init__(self) -> None:
        if np.shape(self.position) != (3,) or not np.isfinite(self.position).all() or not 0 < self.radius < np.inf:
            raise EagorError(
                f"a ball needs a position (x, y, z) and a radius above 0, metres; got {self.position}, {self.radius}"
            )
        if isinstance(self.colour, str) and self.colour not in BALL_COLOURS:
            raise EagorError(f"no ball colour {self.colour!r}; known are {', '.join(BALL_COLOURS)}, or give (r, g, b)")

    @property
    def rgb(self) -> tuple[int, int, int]:
        """The colour in full light, sRGB, 0 to 255."""
        return BALL_COLOURS[self.colour] if isinstance(self.colour, str) else self.colour


@dataclass(frozen=True)
class Room:
    """The balls in the room."""

    balls: tuple[Ball, ...] = (
        Ball((2.3, -1.0, 0.35), 0.35, "red"),
        Ball((1.2, 2.0, 0.3), 0.3, "blue"),
        Ball((-2.4, 1.0, 0.4), 0.4, "yellow"),
        Ball((-1.5, -1.8, 0.25), 0.25, "green"),
    )


def painted_room(height: int = 256, width: int = 512, balls: Sequence[Ball] | None = None) -> np.ndarray:
    """A ready-made panorama ``(H, W, 3)`` uint8: the room from its middle at eye height, facing the front wall."""
    room = Room() if balls is None else Room(balls=tuple(balls))
    return paint(room, EYE, np.eye(3), height, width)


def bearing(ball: Ball, position: Sequence[float], world_R_body: np.ndarray) -> tuple[np.ndarray, float]:
    """The true direction (3,) of `ball`, body frame, and its distance (metres, centre to centre)."""
    offset = np.asarray(ball.position, dtype=float) - np.asarray(position, dtype=float)
    distance = float(np.linalg.norm(offset))
    return check_rotation(np.asarray(world_R_body, dtype=float), "world_R_body").T @ offset / distance, distance


def paint(
    room: Room, position: Sequence[float] = EYE, world_R_body: np.ndarray | None = None,
    height: int = 256, width: int = 512, samples: int = 2,
) -> np.ndarray:  # fmt: skip
    """The panorama ``(H, W, 3)`` uint8 of `room` seen from `position` (metres, world frame) in pose `world_R_body`.

    Each pixel is the mean of samples x samples rays. A ball around the camera is invisible. Raises `PoseError` if the
    camera is not in the room, `RotationError`, `GridError`.
    """
    eye = np.asarray(position, dtype=float)
    if eye.shape != (3,) or not ((eye > LOW) & (eye < HIGH)).all():
        raise PoseError(
            f"the camera stands at {position}, outside the room of {tuple(SIZE.tolist())} m; move it inside"
        )
    pose = check_rotation(np.asarray(np.eye(3) if world_R_body is None else world_R_body, dtype=float), "world_R_body")
    rays = ErpGrid(height * samples, width * samples).directions @ pose.T
    image = np.empty((height, width, 3), dtype=np.uint8)
    for top in range(0, height, 8):  # in bands, so that their data fits in the cache
        band = rays[top * samples : (top + 8) * samples]
        linear = np.minimum(_seen(room, eye, band.reshape(-1, 3)), 1.0)  # samples, before they are averaged
        linear = linear.reshape(len(band) // samples, samples, width, samples, 3).mean(axis=(1, 3))
        image[top : top + 8] = np.rint(255 * to_coded(linear))
    return image


def _seen(room: Room, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Linear light ``(n, 3)`` that arrives along `rays` ``(n, 3)``, unit vectors in the world frame."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(rays == 0, np.inf, (np.where(rays > 0, HIGH, LOW) - eye) / rays)
    axis, nearest = reach.argmin(axis=1), reach.min(axis=1)
    forward = np.take_along_axis(rays, axis[:, None], axis=1)[:, 0] > 0
    point = eye + nearest[:, None] * rays
    normal = np.eye(3)[axis] * np.where(forward, -1.0, 1.0)[:, None]
    colour = _painted(point, 2 * axis + forward)
    for ball in room.balls:
        offset = np.asarray(ball.position, dtype=float) - eye
        along = rays @ offset
        square = ball.radius**2 - (offset @ offset - along**2)
        entry = along - np.sqrt(np.maximum(square, 0.0))
        hit = (square > 0) & (entry > 0) & (entry < nearest)
        nearest[hit] = entry[hit]
        point[hit] = eye + rays[hit] * entry[hit, None]
        normal[hit] = (point[hit] - ball.position) / ball.radius
        colour[hit] = to_linear(np.array(ball.rgb) / 255)
    return colour * _light(room, point, normal)[:, None]


def _painted(point: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Linear colours ``(n, 3)`` of points ``(n, 3)`` on the faces ``(n,)``, which are indices of `_FACES`."""
    colour = np.empty_like(point)
    for index, (plain, rectangles) in enumerate(_FACES):
        on = np.flatnonzero(face == index)
        place = np.delete(point[on], index // 2, axis=1)
        found = np.full((len(on), 3), plain, dtype=float)
        if index == _FLOOR:
            board = np.floor(place[:, 1] / 0.18)
            piece = np.floor((place[:, 0] + 0.7 * board) / 1.3)
            found *= 0.93 + 0.07 * np.sin(12.9 * board + 78.2 * piece)[:, None]
        for middle, half, paint in rectangles:
            found[(np.abs(place - middle) < half).all(axis=1)] = paint
        colour[on] = to_linear(found / 255)
    return colour


def _light(room: Room, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The factor ``(n,)`` of the colours: the lamp with soft shadows of the balls, and what walls reflect."""
    to_lamp = LAMP - point
    distance = np.linalg.norm(to_lamp, axis=1)
    to_lamp /= distance[:, None]
    lamp = (0.15 + 0.85 * np.clip(np.sum(normal * to_lamp, axis=1), 0, None)) / (1 + 0.06 * distance**2)
    # Corners get less light from the walls: a product over the distances to the three pairs of walls.
    gap = np.minimum(point - LOW, HIGH - point)
    gap[np.abs(normal) > 0.99] = 1.0
    bounce = (0.45 + 0.1 * normal[:, 2]) * np.prod(0.72 + 0.28 * _smooth(gap, 0.0, 0.9), axis=1)
    for ball in room.balls:
        centre = ball.position - point
        away = np.linalg.norm(centre, axis=1)
        along = np.clip(np.sum(centre * to_lamp, axis=1), 0, distance)
        miss = np.linalg.norm(centre - along[:, None] * to_lamp, axis=1) / ball.radius
        own = away < 1.001 * ball.radius
        lamp *= np.where(own, 1.0, 0.25 + 0.75 * _smooth(miss, 0.7, 1.4))
        bounce *= np.where(own, 1.0, 1 - 0.5 * np.minimum(ball.radius / away, 1) ** 2)
    return lamp + bounce


def _smooth(a: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, a smooth cubic between."""
    t = np.clip((a - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
