"""Lenses: which pixel of a picture sees which direction. `eagor.grids` samples them at the pixels' centres.

The frame of a lens is FLU as everywhere: x along the optical axis, y to the left, z up in its picture. Pixel
coordinates grow to the right and down; the centre of the first pixel is at (0.5, 0.5), as in `eagor.grids`. OpenCV
counts from that centre: add 0.5 to the centre of a calibration made with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eagor._arrays import frozen
from eagor._checks import above, shown, within
from eagor._values import lazy
from eagor.errors import GridError
from eagor.sphere import checked_pose

__all__ = ["FisheyeLens", "Lens", "PinholeLens", "inverted"]

WIDEST = math.radians(280)  # full field of a fisheye: beyond, there is no glass; ideal ones may see all around
MOST = 1e6  # pixels: no picture is so large
LEAST, LONGEST = 1e-6, 1e9  # pixels: focal lengths of views that are hardly any
NEWTON = 12  # rounds; each doubles the digits, and the start is within a few degrees
FLAT = 89.0  # degrees off the axis that a plane with distortion can show at most
AHEAD = 1e-9  # cosine off the axis below which an ideal pinhole sees nothing
FINE = 1441  # angles at which it is looked whether a curve rises


@dataclass(frozen=True, eq=False)
class FisheyeLens:
    """A fisheye: ``radius(angle) = focal * (angle + k1 angle^3 + k2 angle^5 + k3 angle^7 + k4 angle^9)``.

    The polynomial is that of J. Kannala and S. S. Brandt (IEEE TPAMI 28, 2006), in OpenCV's order; without it the lens
    is equidistant. `centre`: x and y of the optical axis, pixels. `focal`: pixels per radian at the centre. `radius`:
    pixels from the centre up to which there is a picture. `polynomial`: up to four numbers. `body_R_lens` ``(3, 3)``.
    `picture`: which of the camera's pictures it is in.

    Raises `GridError` for values that no lens has, `RotationError`.
    """

    name: str
    centre: tuple[float, float]
    focal: float
    radius: float
    polynomial: tuple[float, ...] = ()
    body_R_lens: np.ndarray = field(default_factory=lambda: np.eye(3))
    picture: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "body_R_lens", frozen(np.array(checked_pose(self.body_R_lens, "body_R_lens"))))
        object.__setattr__(self, "polynomial", tuple(float(k) for k in self.polynomial))
        if not (
            within(self.focal, LEAST, LONGEST)
            and above(self.radius, 0, MOST)
            and all(within(v, -MOST, MOST) for v in self.centre)
        ):
            raise GridError(
                f"the lens {self.name!r} has centre {self.centre}, focal {self.focal!r} and radius {self.radius!r}; "
                f"wanted pixels up to {MOST:g}, focal (pixels per radian, up to {LONGEST:g}) and radius above 0"
            )
        if len(self.polynomial) > 4 or not all(within(k, -10, 10) for k in self.polynomial):
            raise GridError(
                f"the lens {self.name!r} has the polynomial {list(self.polynomial)}; wanted up to four numbers, the "
                "factors of angle^3, angle^5, angle^7, angle^9 (radians)"
            )
        if not self.reach > 0:
            widest = WIDEST if any(self.polynomial) else 2 * math.pi
            raise GridError(
                f"the lens {self.name!r} never reaches the radius of {self.radius:g} pixels within "
                f"{math.degrees(widest) / 2:g} degrees of its axis: its curve is too flat, or turns back. Give "
                "another polynomial, a larger focal, or a smaller radius"
            )

    @lazy
    def reach(self) -> float:
        """Angle (radians) off the axis at the rim; 0 if the curve does not rise up to there."""
        if not any(self.polynomial):
            angle = self.radius / self.focal
            return angle if angle <= math.pi * (1 + 1e-9) else 0.0
        angles = np.linspace(0, WIDEST / 2, FINE)
        radii = self.focal * _odd(self.polynomial, angles)
        beyond = radii >= self.radius * (1 - 1e-9)
        if not beyond.any() or (np.diff(radii[: int(beyond.argmax()) + 1]) <= 0).any():
            return 0.0
        return float(np.interp(self.radius, radii[: int(beyond.argmax()) + 1], angles[: int(beyond.argmax()) + 1]))

    @classmethod
    def of_field(cls, name: str, centre: tuple[float, float], radius: float, fov: float, **other) -> FisheyeLens:
        """The lens whose circle of `radius` pixels spans `fov` radians, from rim to rim."""
        if not above(fov, 0, WIDEST):
            raise GridError(
                f"the lens {name!r} has a field of {math.degrees(fov):g} degrees; wanted more than 0, and at most "
                f"{math.degrees(WIDEST):g}"
            )
        scale = float(_odd(other.get("polynomial", ()), np.array(fov / 2)))
        if not above(scale, 0):
            raise GridError(f"the polynomial of the lens {name!r} is not above 0 at its rim; wanted a curve that rises")
        return cls(name, centre, radius / scale, radius, **other)

    def project(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixel coordinates (x, y) of body directions ``(..., 3)``, and how deep they are inside the rim, radians.

        The depth is negative for what the lens does not see.
        """
        rays = np.asarray(directions) @ self.body_R_lens
        off_axis = np.hypot(rays[..., 1], rays[..., 2])
        angle = np.arctan2(off_axis, rays[..., 0])
        # Beyond the rim a polynomial may turn back.
        shown = np.minimum(angle, self.reach) if any(self.polynomial) else angle
        scale = self.focal * _odd(self.polynomial, shown) / np.maximum(off_axis, 1e-12)
        return self.centre[0] - rays[..., 1] * scale, self.centre[1] - rays[..., 2] * scale, self.reach - angle

    def unproject(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Body directions ``(..., 3)`` at pixel coordinates."""
        right, down = np.broadcast_arrays(np.asarray(x, float) - self.centre[0], np.asarray(y, float) - self.centre[1])
        radius = np.hypot(right, down)
        angle = self.angle_at(radius)
        scale = np.where(radius > 0, np.sin(angle) / np.maximum(radius, 1e-12), 1 / self.focal)
        return np.stack([np.cos(angle), -right * scale, -down * scale], axis=-1) @ self.body_R_lens.T

    def angle_at(self, radius: np.ndarray) -> np.ndarray:
        """Angle off the axis (radians) at radii (pixels), by Newton's method; beyond the rim it goes on straight."""
        if not any(self.polynomial):
            return radius / self.focal
        angle = inverted(self.polynomial, np.minimum(radius, self.radius) / self.focal, self.reach * 1.001)
        slope = max(float(_slope(self.polynomial, np.array(self.reach))), 1e-3)
        return angle + np.maximum(radius - self.radius, 0) / (self.focal * slope)

    @property
    def pixels_per_radian(self) -> float:
        """About the mean over the picture."""
        return self.radius / self.reach

    def scaled(self, factor: float) -> FisheyeLens:
        """The same lens in a picture that is `factor` times as large."""
        x, y = (c * factor for c in self.centre)
        return replace(self, centre=(x, y), focal=self.focal * factor, radius=self.radius * factor)


@dataclass(frozen=True, eq=False)
class PinholeLens:
    """An ordinary lens with the distortion of Brown and Conrady, as OpenCV has it.

    `size`: width and height of its picture in pixels, from the left upper corner. `focal`: x and y, pixels. `centre`:
    the principal point. `distortion`: k1, k2, p1, p2, k3, k4, k5, k6 in OpenCV's order; later ones may be left out.
    `body_R_lens` ``(3, 3)``; `picture`: which of the camera's pictures it is in.

    Raises `GridError` for values that no lens has, `RotationError`.
    """

    name: str
    size: tuple[int, int]
    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, ...] = ()
    body_R_lens: np.ndarray = field(default_factory=lambda: np.eye(3))
    picture: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "body_R_lens", frozen(np.array(checked_pose(self.body_R_lens, "body_R_lens"))))
        object.__setattr__(self, "distortion", tuple(float(k) for k in self.distortion))
        sides = all(above(side, 0, MOST) for side in self.size) and all(within(f, LEAST, LONGEST) for f in self.focal)
        if not (sides and all(within(c, -MOST, MOST) for c in self.centre)):
            raise GridError(
                f"the lens {self.name!r} has focal {self.focal}, centre {self.centre} and size {shown(self.size)}; "
                f"wanted pixels up to {MOST:g}, focal above 0, up to {LONGEST:g}"
            )
        if len(self.distortion) > 8 or not all(within(k, -1e3, 1e3) for k in self.distortion):
            raise GridError(
                f"the lens {self.name!r} has the distortion {list(self.distortion)}; wanted up to eight numbers: k1, "
                "k2, p1, p2, k3, k4, k5, k6, as OpenCV orders them"
            )

    @lazy
    def reach(self) -> float:
        """Angle (radians) off the axis of the point of the border that is farthest off."""
        wide, high = self.size
        t = np.linspace(0, 1, 33)
        x = np.concatenate([t * wide, t * wide, 0 * t, 0 * t + wide])
        y = np.concatenate([0 * t, 0 * t + high, t * high, t * high])
        off = float(np.hypot(*self.plane(x, y)).max())
        return math.atan(min(off, math.tan(math.radians(FLAT))) if any(self.distortion) else off)

    def project(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `FisheyeLens.project`; the depth is that to the nearest edge of the picture."""
        rays = np.asarray(directions) @ self.body_R_lens
        distorted = any(self.distortion)
        ahead = rays[..., 0] > (math.cos(math.radians(FLAT)) if distorted else AHEAD)
        depth = np.where(ahead, rays[..., 0], 1.0)
        a, b = -rays[..., 1] / depth, -rays[..., 2] / depth
        if distorted:
            # Beyond the corners the polynomials may come back into the picture: what is far outside is not distorted.
            ahead &= np.hypot(a, b) <= math.tan(min(self.reach + math.radians(1), math.radians(FLAT)))
            a, b = self._distorted(np.where(ahead, a, 0.0), np.where(ahead, b, 0.0))
        x, y = self.centre[0] + self.focal[0] * a, self.centre[1] + self.focal[1] * b
        wide, high = self.size
        sides = np.minimum(np.minimum(x, wide - x) / self.focal[0], np.minimum(y, high - y) / self.focal[1])
        return x, y, np.where(ahead, np.arctan(sides), -1.0)

    def unproject(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Body directions ``(..., 3)`` at pixel coordinates; the distortion is undone by fixed-point rounds."""
        u, v = self.plane(np.asarray(x, float), np.asarray(y, float))
        rays = np.stack([np.ones_like(u), -u, -v], axis=-1)
        return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ self.body_R_lens.T

    @property
    def pixels_per_radian(self) -> float:
        """At the centre."""
        return math.sqrt(self.focal[0] * self.focal[1])

    def scaled(self, factor: float) -> PinholeLens:
        """The same lens in a picture that is `factor` times as large."""
        wide, high = (max(1, round(n * factor)) for n in self.size)
        focal, centre = (tuple(v * factor for v in pair) for pair in (self.focal, self.centre))
        return replace(self, size=(wide, high), focal=focal, centre=centre)

    def turned(self, quarters: int) -> PinholeLens:
        """The lens of the same picture turned counterclockwise by so many quarter turns; its pose stays.

        As ``numpy.rot90(picture, quarters)`` turns it: the pose is that of the picture as it is shown.
        """
        lens = self
        for _ in range(quarters % 4):  # x, y becomes y, width - x
            (fx, fy), (cx, cy), (wide, high) = lens.focal, lens.centre, lens.size
            distortion = lens.distortion
            if len(distortion) > 2:
                k1, k2, p1, p2, *others = (*distortion, 0.0)[: max(4, len(distortion))]
                distortion = (k1, k2, -p2, p1, *others)
            lens = replace(lens, size=(high, wide), focal=(fy, fx), centre=(cy, wide - cx), distortion=distortion)
        return lens

    def plane(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The plane at distance 1 (right, down), without distortion, at pixel coordinates."""
        a, b = np.broadcast_arrays((x - self.centre[0]) / self.focal[0], (y - self.centre[1]) / self.focal[1])
        u, v = a, b
        for _ in range(40 if any(self.distortion) else 0):
            c, d = self._distorted(u, v)
            u, v = np.clip(u + a - c, -60.0, 60.0), np.clip(v + b - d, -60.0, 60.0)
        return u, v

    def _distorted(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where points of the plane appear (D. C. Brown, Photogrammetric Engineering 32, 1966; OpenCV, calib3d)."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *([0.0] * (8 - len(self.distortion))))
        q = u * u + v * v
        radial = (1 + q * (k1 + q * (k2 + q * k3))) / (1 + q * (k4 + q * (k5 + q * k6)))
        x = u * radial + 2 * p1 * u * v + p2 * (q + 2 * u * u)
        y = v * radial + p1 * (q + 2 * v * v) + 2 * p2 * u * v
        return x, y


Lens = FisheyeLens | PinholeLens


def inverted(polynomial: Sequence[float], values: np.ndarray, highest: float) -> np.ndarray:
    """The angles, 0 to `highest`, at which ``angle + k1 angle^3 + ...`` has these `values`: Newton's method."""
    angle = np.minimum(values, highest)
    for _ in range(NEWTON):
        angle = angle - (_odd(polynomial, angle) - values) / np.maximum(_slope(polynomial, angle), 1e-3)
        angle = np.clip(angle, 0, highest)
    return angle


def _odd(polynomial: Sequence[float], angle: np.ndarray) -> np.ndarray:
    """angle + k1 angle^3 + k2 angle^5 + ..."""
    squared, total = angle * angle, np.zeros_like(angle)
    for k in reversed(polynomial):
        total = (total + k) * squared
    return angle * (1 + total)


def _slope(polynomial: Sequence[float], angle: np.ndarray) -> np.ndarray:
    """The derivative of `_odd`."""
    squared, total = angle * angle, np.zeros_like(angle)
    for power in range(len(polynomial), 0, -1):
        total = (total + (2 * power + 1) * polynomial[power - 1]) * squared
    return 1 + total
