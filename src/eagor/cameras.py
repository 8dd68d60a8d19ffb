"""Cameras: which pixel of a picture sees which direction, and what pictures show there.

`Equirectangular` is a whole panorama, `Lens` one lens, `Rig` the lenses of one body. `Sampler` reads the pictures of
any of them at directions. `eagor.grids` samples them at the pixels' centres.

The frame of a lens is FLU as everywhere: x along the optical axis, y to the left, z up in its picture. Pixel
coordinates grow to the right and down; the centre of the first pixel is at (0.5, 0.5). OpenCV counts from that centre:
add 0.5 to the centre of a calibration made with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor._arrays import frozen
from eagor._checks import above, shown, within
from eagor._extras import opencv
from eagor._values import lazy
from eagor.errors import GridError, ImageError
from eagor.sphere import azimuth_elevation, checked_pose, direction, world_R_body

__all__ = ["PLANE_WIDEST", "WIDEST", "Equirectangular", "Lens", "Rig", "Sampler", "dual_fisheye"]

WIDEST = math.radians(280)  # full field of a fisheye: beyond, there is no glass; ideal ones may see all around
PLANE_WIDEST = math.radians(140)  # beyond, a plane has hardly any pixels for what is ahead: such lenses are stitched
FLAT = math.radians(89)  # off the axis: what a plane with distortion can show at most
MOST = 1e6  # pixels: no picture is so large
LEAST, LONGEST = 1e-6, 1e9  # pixels: focal lengths of views that are hardly any
AHEAD = 1e-9  # cosine off the axis below which an ideal lens sees nothing
STRONGEST = {"pinhole": 1e3, "fisheye": 10.0, "omni": 1e3}  # kinds of lenses, and their largest coefficients
FINE = 1441  # angles at which it is looked how far a curve rises
NEWTON, SIDEWAYS = 4, 12  # rounds: of inverting a curve, and of undoing what is not radial
SHAPE = 0.01  # by which the ratio of a picture's sides may differ from the rig's: rounding to even numbers
RIM = 1.5  # pixels along the rim that are left out: interpolation would mix them with what lies beyond
PAD = 2  # rows over the poles that are added to a panorama before it is sampled
STRIP = 1024  # width of tables of scattered directions; OpenCV takes sides below 32768
NOWHERE = -9.0  # a pixel outside of every picture


class Equirectangular:
    """A whole panorama of `height` and `width` pixels: longitude and latitude are linear in the pixel."""

    height: int
    width: int

    @property
    def latitudes(self) -> np.ndarray:
        """Elevation (radians) of each row's centre, top to bottom."""
        return math.pi / 2 - math.pi * (np.arange(self.height) + 0.5) / self.height

    @property
    def longitudes(self) -> np.ndarray:
        """Azimuth (radians) of each column's centre, left to right, from pi down to -pi."""
        return math.pi - 2 * math.pi * (np.arange(self.width) + 0.5) / self.width

    def unproject(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Directions at continuous pixel coordinates; x may run past the seam, y stops at the poles."""
        azimuth = math.pi - 2 * math.pi * np.asarray(x, dtype=float) / self.width
        elevation = math.pi / 2 - math.pi * np.clip(np.asarray(y, dtype=float), 0, self.height) / self.height
        return direction(*np.broadcast_arrays(azimuth, elevation))

    def project(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixel coordinates (x, y) of directions ``(..., 3)`` and a mask, which is all True here."""
        azimuth, elevation = azimuth_elevation(directions)
        x = (math.pi - azimuth) * (self.width / (2 * math.pi))
        y = (math.pi / 2 - elevation) * (self.height / math.pi)
        return x, y, np.ones(np.shape(x), dtype=bool)


@dataclass(frozen=True, eq=False)
class Lens:
    """One lens: rays become points of an ideal plane, these are distorted, and `focal` and `centre` make them pixels.

    `kind`, and where a ray at an angle off the axis meets the ideal plane:

    - "pinhole": at the tangent of the angle; `distortion` k1, k2, p1, p2, k3, k4, k5, k6 in OpenCV's order (D. C.
      Brown, Photogrammetric Engineering 32, 1966). Later numbers may be left out.
    - "fisheye": at the angle itself, radians; k1 to k4 are the factors of angle^3, ^5, ^7, ^9 (J. Kannala and S. S.
      Brandt, IEEE TPAMI 28, 2006), then p1, p2 and the thin prism s1, s2. There is a picture up to `radius` pixels (of
      x) from the centre; 0: as far as the picture reaches and the curve rises.
    - "omni": a plane seen from the point that lies `mirror` unit radii behind the unit sphere's centre (C. Mei and P.
      Rives, ICRA 2007); the distortion is the pinhole's.

    `size`: width and height of its picture, pixels. `focal`, `centre`: x and y, pixels. `body_R_lens` ``(3, 3)``.
    `picture`: which of the camera's pictures it is in. Raises `GridError` for values that no lens has, `RotationError`.
    """

    name: str
    size: tuple[int, int]
    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, ...] = ()
    body_R_lens: np.ndarray = field(default_factory=lambda: np.eye(3))
    picture: int = 0
    kind: str = "pinhole"
    radius: float = 0.0
    mirror: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "body_R_lens", frozen(np.array(checked_pose(self.body_R_lens, "body_R_lens"))))
        object.__setattr__(self, "distortion", tuple(float(k) for k in self.distortion))
        most = STRONGEST[self.kind]
        limits = [(side, LEAST, MOST) for side in self.size]
        limits += [(f, LEAST, LONGEST) for f in self.focal] + [(c, -MOST, MOST) for c in self.centre]
        limits += [(self.radius, 0, MOST), (self.mirror, 0, 1e3), *((k, -most, most) for k in self.distortion)]
        if len(self.distortion) > 8 or not all(within(*each) for each in limits):
            raise GridError(
                f"the lens {self.name!r} has focal {shown(self.focal)}, centre {shown(self.centre)}, size "
                f"{shown(self.size)}, radius {self.radius!r}, mirror {self.mirror!r} and distortion "
                f"{shown(list(self.distortion))}; wanted pixels up to {MOST:g}, focal above 0, and up to eight numbers "
                f"of at most {most:g} for the distortion"
            )
        if self.kind == "fisheye" and not self.radius:
            (wide, high), (cx, cy), (fx, fy) = self.size, self.centre, self.focal
            corner = max(math.hypot(x - cx, (y - cy) * fx / fy) for x in (0, wide) for y in (0, high))
            object.__setattr__(self, "radius", min(corner, 0.999 * float(self._curve[1][-1]) * fx))
        if self.kind == "fisheye" and not self.reach > 0:
            raise GridError(
                f"the lens {self.name!r} never reaches the radius of {self.radius:g} pixels within "
                f"{math.degrees(self._widest):g} degrees of its axis: its curve is too flat, or turns back. Give "
                "another polynomial, a larger focal, or a smaller radius"
            )

    @classmethod
    def fisheye(
        cls, name: str, size: tuple[int, int], centre: tuple[float, float], radius: float, fov: float, **other: Any
    ) -> Lens:
        """The fisheye whose circle of `radius` pixels spans `fov` radians, from rim to rim. Raises `GridError`."""
        if not above(fov, 0, WIDEST):
            raise GridError(
                f"the lens {name!r} has a field of {math.degrees(fov):g} degrees; wanted more than 0, and at most "
                f"{math.degrees(WIDEST):g}"
            )
        scale = fov / 2 * float(np.polyval([*other.get("distortion", ())[3::-1], 1.0], (fov / 2) ** 2))
        if not above(scale, 0):
            raise GridError(f"the polynomial of the lens {name!r} is not above 0 at its rim; wanted a curve that rises")
        focal = radius / scale
        return cls(name, size, (focal, focal), centre, kind="fisheye", radius=radius, **other)

    @property
    def _widest(self) -> float:
        """Angle off the axis, radians, that no lens of the kind exceeds."""
        if self.kind == "fisheye":
            return WIDEST / 2 if any(self.distortion) else math.pi
        if self.kind == "omni":
            return math.acos(-min(self.mirror, 1 / max(self.mirror, 1e-9))) - 1e-3
        return FLAT if any(self.distortion) else math.acos(AHEAD)

    @lazy
    def _terms(self) -> tuple[list[float], list[float], tuple[float, float, float, float]]:
        """Polynomials of the squared radius, highest power first: over each other; and p1, p2, s1, s2."""
        k1, k2, a, b, c, d, e, f = (*self.distortion, *[0.0] * (8 - len(self.distortion)))
        if self.kind == "fisheye":
            return [b, a, k2, k1, 1.0], [1.0], (c, d, e, f)
        return [c, k2, k1, 1.0], [f, e, d, 1.0], (a, b, 0.0, 0.0)

    def _radial(self, squared: np.ndarray) -> np.ndarray:
        """By how much points of the ideal plane at this squared radius move outwards."""
        return np.polyval(self._terms[0], squared) / np.polyval(self._terms[1], squared)

    def _sideways(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By how much they move beside that: decentring, and a prism."""
        (p1, p2, s1, s2), q = self._terms[2], u * u + v * v
        return 2 * p1 * u * v + p2 * (q + 2 * u * u) + s1 * q, p1 * (q + 2 * v * v) + 2 * p2 * u * v + s2 * q

    @lazy
    def _curve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Radii in the ideal plane, where they appear, and the slope there; as far as the curve rises."""
        angles = np.linspace(0, self._widest, FINE)
        plain = angles if self.kind == "fisheye" else np.sin(angles) / (np.cos(angles) + self.mirror)
        with np.errstate(all="ignore"):  # numbers that no lens has
            bent = plain * self._radial(plain**2)
        falls = np.flatnonzero(~(np.diff(bent) > 0))
        end = max(2, int(falls[0]) + 1 if len(falls) else FINE)
        plain, bent = plain[:end], np.nan_to_num(bent[:end], posinf=0.0, neginf=0.0)
        return plain, bent, np.maximum(np.gradient(bent, plain), 1e-3)

    def plane(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of the ideal plane (right, down), without distortion, at pixel coordinates."""
        a, b = np.broadcast_arrays((x - self.centre[0]) / self.focal[0], (y - self.centre[1]) / self.focal[1])
        if not any(self.distortion):
            return a, b
        u, v = a, b
        for _ in range(SIDEWAYS if any(self._terms[2]) else 1):
            right, down = (all_ - part for all_, part in zip((a, b), self._sideways(u, v), strict=True))
            radius = np.hypot(right, down)
            scale = self._unbent(radius) / np.maximum(radius, 1e-12)
            u, v = right * scale, down * scale
        return u, v

    def _unbent(self, bent: np.ndarray) -> np.ndarray:
        """Radii in the ideal plane of those that appear: Newton's method; past its curve a fisheye goes on straight."""
        plain, curve, slopes = self._curve
        inside = np.minimum(bent, curve[-1])
        radius = np.interp(inside, curve, plain)
        slope = np.interp(radius, plain, slopes)
        for _ in range(NEWTON):
            radius = np.clip(radius - (radius * self._radial(radius**2) - inside) / slope, 0, plain[-1])
        return np.minimum(radius + (bent - inside) / slopes[-1], math.pi) if self.kind == "fisheye" else radius

    @lazy
    def reach(self) -> float:
        """Angle (radians) off the axis of the rim (0: the curve does not rise so far), or of the farthest corner."""
        if self.kind == "fisheye":
            rim = self.radius / self.focal[0]
            plain, bent, _ = self._curve
            return float(np.interp(rim, bent, plain)) if rim <= bent[-1] * (1 + 1e-9) else 0.0
        t = np.linspace(0, 1, 33)
        edges = np.concatenate([(t, 0 * t), (t, 0 * t + 1), (0 * t, t), (0 * t + 1, t)], axis=1)
        x, y = edges * np.array(self.size)[:, None]
        cosine = float((self.unproject(x, y) @ self.body_R_lens[:, 0]).min())
        return min(math.acos(min(max(cosine, -1.0), 1.0)), self._widest)

    @property
    def hfov(self) -> float:
        """Of a pinhole: the angle, radians, across the row of its principal point."""
        left, right = self.plane(np.array([0.0, self.size[0]]), np.full(2, self.centre[1]))[0]
        return math.atan(float(right)) - math.atan(float(left))

    @property
    def is_ordinary(self) -> bool:
        """Whether its picture can be looked at as it is; others are laid out in panoramas."""
        return self.kind == "pinhole" and self.hfov <= PLANE_WIDEST

    @property
    def pixels_per_radian(self) -> float:
        """Of a fisheye about the mean over its circle, else at the centre."""
        if self.kind == "fisheye":
            return self.radius / self.reach
        return math.sqrt(self.focal[0] * self.focal[1]) / (1 + self.mirror)

    def project(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixel coordinates (x, y) of body directions ``(..., 3)``, and how deep they are in the picture, radians.

        That is the angle to the rim of a fisheye, else to the nearest edge; negative for what the lens does not see.
        """
        rays = np.asarray(directions) @ self.body_R_lens
        side = np.hypot(rays[..., 1], rays[..., 2])
        angle = np.arctan2(side, rays[..., 0])
        fisheye = self.kind == "fisheye"
        # Beyond the rim polynomials may come back into the picture.
        limit = self.reach if fisheye else self._widest
        if not fisheye and any(self.distortion):
            limit = min(limit, self.reach + math.radians(1))
        sees = angle <= limit
        if fisheye:
            depth = np.maximum(side, 1e-12) / np.maximum(np.minimum(angle, limit), 1e-12)
        else:
            depth = np.where(sees, rays[..., 0] + self.mirror * np.hypot(side, rays[..., 0]), 1.0)
        u, v = -rays[..., 1] / depth, -rays[..., 2] / depth
        if any(self.distortion):
            radial, (right, down) = self._radial(u * u + v * v), self._sideways(u, v)
            u, v = u * radial + right, v * radial + down
        x, y = self.centre[0] + self.focal[0] * u, self.centre[1] + self.focal[1] * v
        if fisheye:
            return x, y, limit - angle
        wide, high = self.size
        edges = np.minimum(np.minimum(x, wide - x) / self.focal[0], np.minimum(y, high - y) / self.focal[1])
        return x, y, np.where(sees, np.arctan(edges), -1.0)

    def unproject(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Body directions ``(..., 3)`` at pixel coordinates."""
        u, v = self.plane(np.asarray(x, float), np.asarray(y, float))
        squared = u * u + v * v
        if self.kind == "fisheye":
            angle = np.sqrt(squared)
            ahead, scale = np.cos(angle), np.sinc(angle / math.pi)
        else:  # back from the sphere, or (mirror 0) the plane
            scale = (self.mirror + np.sqrt(np.maximum(1 + (1 - self.mirror**2) * squared, 0.0))) / (1 + squared)
            ahead = scale - self.mirror
        return np.stack([ahead, -u * scale, -v * scale], axis=-1) @ self.body_R_lens.T

    def scaled(self, factor: float) -> Lens:
        """The same lens in a picture that is `factor` times as large."""
        focal, centre = (tuple(v * factor for v in pair) for pair in (self.focal, self.centre))
        size = tuple(max(1, round(n * factor)) for n in self.size)
        return replace(self, size=size, focal=focal, centre=centre, radius=self.radius * factor)

    def turned(self, quarters: int) -> Lens:
        """The pinhole of the same picture turned counterclockwise by so many quarter turns; its pose stays.

        As ``numpy.rot90(picture, quarters)`` turns it: the pose is that of the picture as it is shown.
        """
        lens = self
        for _ in range(quarters % 4):  # x, y becomes y, width - x
            k1, k2, p1, p2, *others = (*lens.distortion, *[0.0] * (4 - len(lens.distortion)))
            (fx, fy), (cx, cy), (wide, high) = lens.focal, lens.centre, lens.size
            lens = replace(
                lens, size=(high, wide), focal=(fy, fx), centre=(cy, wide - cx), distortion=(k1, k2, -p2, p1, *others)
            )
        return lens


@dataclass(frozen=True, eq=False)
class Rig:
    """The `lenses` of a camera, in pixels of pictures of the `sizes` (width, height): one, or one per lens.

    Lenses count as in one place. Raises `GridError` where there is no lens, or one refers to a picture that there is
    not.
    """

    sizes: tuple[tuple[int, int], ...]
    lenses: tuple[Lens, ...]

    def __post_init__(self) -> None:
        if not (self.lenses and self.sizes and all(0 < side <= MOST for size in self.sizes for side in size)):
            raise GridError(
                f"a rig has {len(self.lenses)} lenses in pictures of {shown(self.sizes)}; wanted at least one, and "
                f"pixels, 1 to {MOST:g} along each side"
            )
        for lens in self.lenses:
            if not 0 <= lens.picture < len(self.sizes):
                raise GridError(f"the lens {lens.name!r} is in picture {lens.picture} of {len(self.sizes)}")

    @property
    def rows(self) -> int:
        """Rows of a panorama that is as fine as the sharpest lens, an even number."""
        return max(2, 2 * round(math.pi * max(lens.pixels_per_radian for lens in self.lenses) / 2))

    def scaled(self, factor: float) -> Rig:
        """The same for pictures that are `factor` times as large."""
        sizes = tuple((max(1, round(w * factor)), max(1, round(h * factor))) for w, h in self.sizes)
        return Rig(sizes, tuple(lens.scaled(factor) for lens in self.lenses))

    def factor_of(self, sizes: Sequence[tuple[int, int]], name: str) -> float:
        """How much larger than the rig's own are pictures of these `sizes` (width, height).

        Raises `ImageError`, about `name`, if they are others: another number, or another shape.
        """
        if len(sizes) != len(self.sizes):
            raise ImageError(
                f"{name} gives {len(sizes)} picture{'s' if len(sizes) > 1 else ''} at a time, and the rig is for "
                f"{len(self.sizes)}; give as many files or streams as the rig lists pictures, with commas between"
            )
        factors = [width / own[0] for (width, _), own in zip(sizes, self.sizes, strict=True)]
        for (width, height), own, factor in zip(sizes, self.sizes, factors, strict=True):
            if abs(height / own[1] / factor - 1) > SHAPE or abs(factor / factors[0] - 1) > SHAPE:
                raise ImageError(
                    f"{name} is {width} x {height}, and the rig is for pictures of {own[0]} x {own[1]}, or the same "
                    "shape in another size. Set the camera to that resolution, or calibrate the rig with pictures of "
                    "this one (eagor camera calibrate)"
                )
        return factors[0]


def dual_fisheye(width: int, height: int, fov: float = math.radians(200)) -> Rig:
    """Two ideal lenses back to back, their circles side by side in one picture, the front one on the left.

    Each circle touches the top and the bottom of the picture; `fov`: the angle across it, radians.
    """
    size, radius = (width, height), min(height, width / 2) / 2
    places = (("front", width / 4, 0.0), ("back", 3 * width / 4, math.pi))
    return Rig((size,), tuple(
        Lens.fisheye(name, size, (x, height / 2), radius, fov, body_R_lens=world_R_body(yaw)) for name, x, yaw in places
    ))  # fmt: skip


# --- pictures, read at directions ---


class Sampler:
    """Reads pictures of a `camera` at `directions` ``(..., 3)``, body frame; its tables serve all pictures.

    `camera`: a panorama, a lens, or a rig. Where several lenses of a rig see the same, they are blended: each counts in
    proportion to its depth there, so that no seam is to be seen where they agree. `seen` ``(...)``: where there is
    something to see, elsewhere it is black. `cubic`: bicubic, of uint8 pictures; else bilinear. OpenCV reads uint8
    pictures if it is installed, SciPy all others.
    """

    def __init__(self, camera: Equirectangular | Lens | Rig, directions: np.ndarray, cubic: bool = False) -> None:
        self._shape, self._cubic, self._whole = directions.shape[:-1], cubic, isinstance(camera, Equirectangular)
        self._shared = np.empty(0, np.intp)  # directions that several lenses see
        if isinstance(camera, Equirectangular):
            x, y, self.seen = camera.project(directions)
            self._first = _table(x - 0.5, y + (PAD - 0.5), cubic)
            return
        rig = camera if isinstance(camera, Rig) else Rig((camera.size,), (replace(camera, picture=0),))
        flat, sizes = directions.reshape(-1, 3), rig.sizes
        starts = np.cumsum([0, *(width for width, _ in sizes)])  # of the pictures, side by side
        x, y = (np.empty((len(rig.lenses), len(flat)), np.float32) for _ in range(2))
        depth = np.empty(x.shape)
        for k, lens in enumerate(rig.lenses):
            across, down, deep = lens.project(flat)
            wide, high = sizes[lens.picture]
            beside = (across < 0) | (across > wide) | (down < 0) | (down > high)  # a circle may be larger
            depth[k] = np.where(beside, -1, deep) - RIM / lens.pixels_per_radian
            x[k], y[k] = across + starts[lens.picture] - 0.5, down - 0.5
        order = np.argsort(-depth, axis=0, kind="stable")  # at each direction, the deepest lens first
        x, y, depth = (np.take_along_axis(each, order, axis=0) for each in (x, y, depth))
        x, y = (np.where(depth > 0, each, np.float32(NOWHERE)) for each in (x, y))
        self.seen = (depth[0] > 0).reshape(self._shape)
        self._first = _table(x[0].reshape(self._shape), y[0].reshape(self._shape), cubic)
        if len(rig.lenses) > 1:
            self._shared = np.flatnonzero(depth[1] > 0)
            share = np.maximum(depth[:, self._shared], 0)
            self._weights = np.rint(256 * share / share.sum(axis=0)).astype(np.uint16)[..., None]
            self._weights[0] = 256 - self._weights[1:].sum(axis=0)  # to 256 exactly
            self._others = [_table(x[k, self._shared], y[k, self._shared], cubic) for k in range(1, len(x))]

    def __call__(self, *pictures: np.ndarray) -> np.ndarray:
        """What `pictures` ``(H, W)`` or ``(H, W, C)``, of the camera's sizes, show there: ``(...)`` or ``(..., C)``."""
        if self._whole:
            canvas = np.pad(pictures[0], ((PAD, PAD), *[(0, 0)] * (pictures[0].ndim - 1)), "symmetric")
            for rows in (slice(PAD), slice(-PAD, None)):  # beyond a pole it goes on half a turn away
                canvas[rows] = np.roll(canvas[rows], canvas.shape[1] // 2, axis=1)
        elif len(pictures) == 1:
            canvas = np.ascontiguousarray(pictures[0])
        else:
            height = max(map(len, pictures))
            canvas = np.hstack([np.pad(each, ((0, height - len(each)), (0, 0), (0, 0))) for each in pictures])
        found = self._read(canvas, self._first)[: math.prod(self._shape)].reshape(*self._shape, *canvas.shape[2:])
        if len(self._shared):
            flat, count = found.reshape(-1, *canvas.shape[2:]), len(self._shared)
            read = [flat[self._shared], *(self._read(canvas, table)[:count] for table in self._others)]
            total = sum(np.multiply(each, own, dtype=np.uint16) for each, own in zip(read, self._weights, strict=True))
            flat[self._shared] = (total + 128) >> 8  # 256 * 255 and a half fit into 16 bits
        return found

    def _read(self, canvas: np.ndarray, table: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """The values ``(n, ...)`` of the canvas at the places of a table."""
        if canvas.dtype == np.uint8 and (cv2 := opencv()) is not None:
            order = cv2.INTER_CUBIC if self._cubic else cv2.INTER_LINEAR
            border = cv2.BORDER_WRAP if self._whole else cv2.BORDER_CONSTANT
            places = table if self._cubic else [each.astype(np.float32, copy=False) for each in table]
            return cv2.remap(canvas, *places, order, borderMode=border).reshape(-1, *canvas.shape[2:])
        from scipy.ndimage import map_coordinates

        kind, (x, y) = canvas.dtype, (each.reshape(-1) for each in table)
        exact = np.float32 if kind.itemsize <= 2 or kind == np.float32 else np.float64
        how: dict[str, Any] = {"order": 3 if self._cubic else 1, "mode": "grid-wrap" if self._whole else "constant"}
        bands = np.moveaxis(canvas.reshape(*canvas.shape[:2], -1), -1, 0).astype(exact)
        values = np.stack([map_coordinates(band, (y, x), **how) for band in bands], axis=-1)
        if kind.kind in "ui":
            values = np.clip(np.rint(values), np.iinfo(kind).min, np.iinfo(kind).max)
        return values.astype(kind).reshape(-1, *canvas.shape[2:])


def _table(x: np.ndarray, y: np.ndarray, cubic: bool) -> tuple[np.ndarray, np.ndarray]:
    """Where to read: places on a canvas, the first pixel's centre being 0; of bicubic ones as OpenCV is fastest."""
    if x.ndim != 2:
        left = -x.size % STRIP
        x, y = (np.pad(each.reshape(-1), (0, left), constant_values=NOWHERE).reshape(-1, STRIP) for each in (x, y))
    if not cubic or (cv2 := opencv()) is None:
        return x, y
    return cv2.convertMaps(x.astype(np.float32), y.astype(np.float32), cv2.CV_16SC2)
