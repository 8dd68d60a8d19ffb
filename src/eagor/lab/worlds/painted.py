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
LAMP = SIZE * [0.06, 0.04, 0.88]  # position of the light, world frame


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
    eye, half = np.asarray(position, dtype=float), SIZE / 2
    inside = eye.shape == (3,) and (np.abs(eye[:2]) < half[:2]).all() and 0 < eye[2] < SIZE[2]
    if not inside:
        raise PoseError(
            f"the camera stands at {position}, outside the room of {tuple(SIZE.tolist())} m; move it inside"
        )
    pose = check_rotation(np.asarray(np.eye(3) if world_R_body is None else world_R_body, dtype=float), "world_R_body")
    rays = ErpGrid(height * samples, width * samples).directions @ pose.T
    image = np.empty((height, width, 3), dtype=np.uint8)
    for top in range(0, height, 8):  # in bands, so that their data fits in the cache
        band = rays[top * samples : (top + 8) * samples]
        linear = np.minimum(_shade(room, eye, band.reshape(-1, 3)), 1.0)  # samples, before they are averaged
        linear = linear.reshape(len(band) // samples, samples, width, samples, 3).mean(axis=(1, 3))
        image[top : top + 8] = np.rint(255 * to_coded(linear))
    return image


def _shade(room: Room, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Linear light ``(n, 3)`` that arrives along `rays` ``(n, 3)``, unit vectors in the world frame."""
    point, normal, colour = _hit_walls(eye, rays)
    gloss = np.zeros(len(rays))
    nearest = np.linalg.norm(point - eye, axis=-1)
    for ball in room.balls:
        entry = _entry(ball, eye, rays)
        hit = entry < nearest
        nearest[hit] = entry[hit]
        point[hit] = eye + rays[hit] * entry[hit, None]
        normal[hit] = (point[hit] - ball.position) / ball.radius
        colour[hit] = _srgb(*ball.rgb)
        gloss[hit] = 0.35
    light, highlight = _light(room, point, normal, rays, gloss)
    return colour * light + highlight


def _hit_walls(eye: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the rays leave the box: points, inward normals and the colours there (linear light), each ``(n, 3)``."""
    low = np.array([-SIZE[0] / 2, -SIZE[1] / 2, 0.0])
    high = low + SIZE
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(rays > 0, high - eye, low - eye) / rays
    axis = np.argmin(np.where(rays == 0, np.inf, reach), axis=-1)
    rows = np.arange(len(rays))
    point = eye + rays * reach[rows, axis][:, None]
    positive = rays[rows, axis] > 0
    normal = np.zeros_like(rays)
    normal[rows, axis] = np.where(positive, -1.0, 1.0)
    colour = np.empty_like(rays)
    for face, texture in enumerate((_back, _front, _right, _left, _floor, _ceiling)):
        on = (axis == face // 2) & (positive == bool(face % 2))
        colour[on] = texture(point[on])
    return point, normal, colour


def _entry(ball: Ball, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Distance along each ray to `ball`, metres ``(n,)``; infinite if the ray misses it."""
    offset = np.asarray(ball.position, dtype=float) - eye
    along = rays @ offset
    square = ball.radius**2 - (offset @ offset - along**2)
    entry = along - np.sqrt(np.maximum(square, 0.0))
    return np.where((square > 0) & (entry > 0), entry, np.inf)


def _light(
    room: Room, point: np.ndarray, normal: np.ndarray, rays: np.ndarray, gloss: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The factor of the colour, and the highlights added to it, each ``(n, 1)``: lamp, daylight, corners."""
    to_lamp = LAMP - point
    distance = np.linalg.norm(to_lamp, axis=-1)
    to_lamp /= distance[:, None]
    facing = np.sum(normal * to_lamp, axis=-1)
    lamp = (0.7 * np.clip(facing, 0, None) + 0.3 * np.clip(0.5 + 0.5 * facing, 0, 1)) / (1 + 0.06 * distance**2)
    # Corners get less indirect light: a product over the three pairs of walls.
    bounce = 0.42 + 0.1 * normal[:, 2]
    for axis, size in enumerate(SIZE):
        gap = size / 2 - np.abs(point[:, axis] - (size / 2 if axis == 2 else 0))
        bounce *= 0.72 + 0.28 * _smooth(np.where(np.abs(normal[:, axis]) > 0.99, 1.0, gap), 0.0, 0.9)
    for ball in room.balls:  # a soft shadow, and the part of the sky that the ball hides
        centre = ball.position - point
        away = np.linalg.norm(centre, axis=-1)
        along = np.clip(np.sum(centre * to_lamp, axis=-1), 0, distance)
        miss = np.linalg.norm(centre - along[:, None] * to_lamp, axis=-1) / ball.radius
        own = away < 1.001 * ball.radius
        lamp *= np.where(own, 1.0, 0.25 + 0.75 * _smooth(miss, 0.7, 1.4))
        hidden = np.clip(np.sum(normal * centre, axis=-1) / away, 0, 1) * np.minimum(ball.radius / away, 1) ** 2
        bounce *= np.where(own, 1.0, 1 - 0.85 * hidden)
    daylight = 0.16 * np.clip(0.4 + 0.6 * normal[:, 1], 0, None) * (0.5 + point[:, 1] / SIZE[1])
    mirrored = rays - 2 * np.sum(rays * normal, axis=-1)[:, None] * normal
    highlight = gloss * np.clip(np.sum(mirrored * to_lamp, axis=-1), 0, None) ** 40
    return (lamp + bounce + daylight)[:, None], highlight[:, None]


def _floor(p: np.ndarray) -> np.ndarray:
    """Boards along x, and an oval rug with rings."""
    board = np.floor(p[:, 1] / 0.18)
    tone = 0.82 + 0.18 * _noise(board + 31 * np.floor((p[:, 0] + 0.7 * board) / 1.3))
    colour = _srgb(190, 172, 150) * (tone * (0.8 + 0.2 * _smooth(_to_line(p[:, 1], 0.18), 0.0, 0.012)))[:, None]
    ring = np.hypot((p[:, 0] - 0.3) / 1.9, (p[:, 1] + 0.2) / 1.25)
    rug = _over(_srgb(150, 152, 158), (np.floor(ring * 7) % 2 == 0, _srgb(196, 190, 180)))
    return _over(colour, (ring < 1, rug))


def _ceiling(p: np.ndarray) -> np.ndarray:
    """Plain, with a bright disc where the lamp hangs."""
    glow = 1 - _smooth(np.hypot(p[:, 0] - LAMP[0], p[:, 1] - LAMP[1]), 0.22, 0.3)
    return _srgb(228, 226, 220) * (1 + 0.9 * glow[:, None])


def _front(p: np.ndarray) -> np.ndarray:
    """A sand-coloured wall with a framed landscape, left of the middle."""
    y, z = p[:, 1] - 0.7, p[:, 2] - 0.57 * SIZE[2]
    near, far = z > 0.06 * np.sin(5 * y + 2) - 0.22, z > 0.1 * np.sin(3 * y) - 0.05
    hills = _over(_srgb(112, 116, 110), (near, _srgb(140, 146, 140)), (near & far, _srgb(205, 208, 210)))
    frame, mount = (_box(y, z, 0.72, 0.48), _srgb(74, 68, 64)), (_box(y, z, 0.66, 0.42), _srgb(232, 230, 224))
    return _over(_wall(p, (206, 197, 184)), frame, mount, (_box(y, z, 0.55, 0.32), hills))


def _left(p: np.ndarray) -> np.ndarray:
    """A grey-green wall with a window of two by three panes."""
    x, z = p[:, 0] + 0.5, p[:, 2] - 0.58 * SIZE[2]
    sky = _srgb(226, 232, 238) * (1.5 - 0.35 * np.clip(z + 0.4, 0, 1))[:, None]
    outside = _over(_srgb(168, 176, 166), (z > -0.38 + 0.08 * np.sin(2.5 * x) + 0.03 * np.sin(9 * x), sky))
    panes = _box(x, z, 1.2, 0.65) & (_to_line(x + 0.4, 0.8) > 0.025) & (_to_line(z, 1.3) > 0.025)
    frame = _box(x, z, 1.28, 0.73), _srgb(236, 235, 230)
    return _over(_wall(p, (184, 192, 182)), frame, (panes, outside))


def _back(p: np.ndarray) -> np.ndarray:
    """A grey wall with a panelled door, right of the middle as one faces it."""
    y, z = p[:, 1] - 1.1, p[:, 2]
    frame = _box(y, z - 1.0, 0.56, 1.12), _srgb(234, 232, 228)
    door = _box(y, z - 1.0, 0.46, 1.02), _srgb(140, 134, 128)
    panels = [(_box(y, z - centre, 0.33, high), _srgb(124, 118, 113)) for centre, high in ((0.55, 0.36), (1.45, 0.42))]
    handle = np.hypot(y + 0.38, z - 1.0) < 0.045, _srgb(200, 196, 186)
    return _over(_wall(p, (190, 188, 196)), frame, door, *panels, handle)


def _right(p: np.ndarray) -> np.ndarray:
    """Broad upright stripes."""
    return _over(_wall(p, (170, 178, 188)), (np.floor(p[:, 0] / 0.35) % 2 == 0, _wall(p, (208, 206, 200))))


def _wall(p: np.ndarray, rgb: tuple[int, int, int]) -> np.ndarray:
    """Paint with a white skirting board below."""
    return _over(_srgb(*rgb), (p[:, 2] < 0.12, _srgb(230, 228, 224)))


def _over(colour: np.ndarray, *layers: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Layers, each where its mask ``(n,)`` holds, over a colour ``(n, 3)`` or ``(3,)``, the last on top."""
    for mask, layer in layers:
        colour = np.where(mask[:, None], layer, colour)
    return colour


def _box(a: np.ndarray, b: np.ndarray, half_a: float, half_b: float) -> np.ndarray:
    return (np.abs(a) < half_a) & (np.abs(b) < half_b)


def _to_line(a: np.ndarray, period: float) -> np.ndarray:
    """Distance to the nearest multiple of `period`."""
    return np.abs(a - period * np.round(a / period))


def _smooth(a: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, a smooth cubic between."""
    t = np.clip((a - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def _noise(index: np.ndarray) -> np.ndarray:
    """A repeatable value in [0, 1) for each whole number."""
    return (np.sin(12.9898 * index) * 43758.5453) % 1.0


def _srgb(r: float, g: float, b: float) -> np.ndarray:
    """sRGB 0 to 255 in linear light."""
    return to_linear(np.array([r, g, b]) / 255)
