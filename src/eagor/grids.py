"""Grids: which direction each cell of an image looks in, and how much of the sphere it covers.

A grid holds no values. All grids have the same interface:

- ``shape`` (rows, columns); ``directions`` (H, W, 3), unit vectors in the body frame; ``weights`` (H, W), steradians;
- ``unproject(x, y)``: directions at continuous pixel coordinates (pixel j spans [j, j + 1], x right, y down);
- ``project(directions)``: the inverse, with a mask of what is inside;
- ``density(x, y)``: steradians per square pixel;
- ``depth_inside()``: angle (radians) from each cell to the nearest direction outside of the grid, None if it covers the
  whole sphere.

`tangent_views`: ordinary views that cover the sphere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from eagor._arrays import frozen
from eagor._values import changed, lazy
from eagor.cameras import Equirectangular, Lens
from eagor.errors import GridError
from eagor.sphere import checked_pose, direction, world_R_body

__all__ = [
    "OVERLAP", "ErpGrid", "ErpWindow", "FisheyeGrid", "Grid", "PatchGrid", "PerspectiveGrid", "ViewKey", "depth_inside",
    "forward_view", "tangent_views", "view_key",
]  # fmt: skip

_EDGE = 1e-12  # radians by which rounding may put what lies on the edge of a view outside


@lru_cache(maxsize=64)
def fejer_weights(count: int) -> np.ndarray:
    """Fejer's first rule on `count` pixel-centre latitudes, for integrals over sin(latitude); they sum to 2.

    Exact for polynomials in sin(latitude) up to degree count - 1, unlike weights of cos(latitude) (L. Fejer 1933;
    Waldvogel, BIT 46, 2006).
    """
    angle = (np.arange(count) + 0.5) * (math.pi / count)
    k = np.arange(1, count // 2 + 1)
    return (2 / count) * (1 - 2 * np.sum(np.cos(2 * np.outer(angle, k)) / (4 * k * k - 1), axis=1))


def _centres(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Pixel-centre coordinates (x, y), broadcastable to (height, width)."""
    return np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None]


@lru_cache(maxsize=32)
def beyond_edges(height: int, width: int, margin: int) -> np.ndarray:
    """The flat index of each cell ``(H + 2 margin, W + 2 margin)`` of a panorama; it goes on across seam and poles."""
    rows, columns = np.arange(-margin, height + margin)[:, None], np.arange(-margin, width + margin)
    over = (rows < 0) | (rows >= height)  # beyond a pole: the opposite meridian
    rows = np.where(rows < 0, -1 - rows, np.where(rows >= height, 2 * height - 1 - rows, rows))
    return rows * width + (columns + over * (width // 2)) % width


class _Cells:
    """What all grids share, beside `unproject` of a camera."""

    height: int
    width: int

    def __post_init__(self) -> None:
        if min(self.shape) < 1:
            raise GridError(f"a grid needs at least one row and one column; got {self.height} x {self.width}")

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.height, self.width

    @lazy
    def directions(self) -> np.ndarray:
        """Unit vectors ``(H, W, 3)`` of the cell centres, body frame; those beyond a fisheye's rim are meaningless."""
        return frozen(self.unproject(*_centres(*self.shape)))  # type: ignore[attr-defined]


class _Whole(_Cells, Equirectangular):
    """What `ErpGrid` and `PatchGrid` share."""

    def density(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Steradians per square pixel: the area of a unit pixel times cos(elevation)."""
        cosine = np.sin(math.pi * np.clip(y, 0, self.height) / self.height)
        return cosine * (2 * math.pi**2 / (self.width * self.height)) + 0.0 * np.asarray(x)

    def depth_inside(self) -> None:
        """None: the grid covers the whole sphere."""
        return None


@dataclass(frozen=True)
class ErpGrid(_Whole):
    """The pixels of an equirectangular image, taken as samples at their centres.

    `weights` are Fejer's, so that analysis is exact for fields band-limited below the number of rows. The image need
    not be 2:1: longitude and latitude are scaled separately.
    """

    height: int
    width: int

    @lazy
    def weights(self) -> np.ndarray:
        """Quadrature weights ``(H, W)`` in steradians; they sum to 4 pi."""
        row = fejer_weights(self.height) * (2 * math.pi / self.width)
        return frozen(np.broadcast_to(row[:, None], self.shape))


@dataclass(frozen=True)
class PatchGrid(_Whole):
    """A model's patch map over a whole equirectangular image: each cell is a region with one constant value."""

    rows: int
    cols: int

    height = property(lambda self: self.rows)  # type: ignore[assignment]
    width = property(lambda self: self.cols)  # type: ignore[assignment]

    @lazy
    def weights(self) -> np.ndarray:
        """Exact solid angles ``(H, W)`` of the cells in steradians; they sum to 4 pi."""
        edges = np.sin(math.pi / 2 - math.pi * np.arange(self.height + 1) / self.height)
        row = (edges[:-1] - edges[1:]) * (2 * math.pi / self.width)
        return frozen(np.broadcast_to(row[:, None], self.shape))


@dataclass(frozen=True)
class ErpWindow:
    """A rectangular part of an `ErpGrid`: `rows` from `top` down, `cols` from `left` on; it may cross the seam."""

    whole: ErpGrid
    top: int
    left: int
    rows: int
    cols: int

    @classmethod
    def around(cls, marked: np.ndarray, times: int = 1) -> ErpWindow:
        """The smallest window with the `marked` cells ``(H, W)`` and their neighbours, each cell cut `times` finer."""
        height, width = marked.shape
        rows = np.flatnonzero(marked.any(axis=1))
        top, bottom = max(rows[0] - 1, 0), min(rows[-1] + 2, height)
        columns = np.flatnonzero(marked.any(axis=0))
        gaps = np.diff(np.append(columns, columns[0] + width))
        widest = int(gaps.argmax())
        left, count = int(columns[(widest + 1) % len(columns)]) - 1, width - int(gaps[widest]) + 3
        if count >= width:
            left, count = 0, width
        whole = ErpGrid(height * times, width * times)
        return cls(whole, int(top) * times, left * times, int(bottom - top) * times, count * times)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows, self.cols

    @property
    def columns(self) -> np.ndarray:
        """The columns of the whole grid, in order."""
        return (self.left + np.arange(self.cols)) % self.whole.width

    @lazy
    def directions(self) -> np.ndarray:
        """Unit vectors ``(rows, cols, 3)`` of the cell centres, body frame."""
        x, y = self.left + np.arange(self.cols) + 0.5, self.top + np.arange(self.rows)[:, None] + 0.5
        return frozen(self.whole.unproject(x, y))

    @lazy
    def weights(self) -> np.ndarray:
        """Quadrature weights ``(rows, cols)`` in steradians."""
        return frozen(self.whole.weights[self.top : self.top + self.rows, self.columns])


class _Sampled(_Cells):
    """The pixels of a lens: what `PerspectiveGrid` and `FisheyeGrid` share."""

    body_R_view: np.ndarray
    lens: Lens

    __repr__ = changed

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "body_R_view", frozen(np.array(checked_pose(self.body_R_view, "body_R_view"))))

    def unproject(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Directions at continuous pixel coordinates."""
        return self.lens.unproject(x, y)

    def project(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixel coordinates (x, y) of directions ``(..., 3)`` and a mask of those that the lens sees."""
        x, y, depth = self.lens.project(directions)
        return x, y, depth >= -_EDGE


@dataclass(frozen=True, eq=False, repr=False)
class PerspectiveGrid(_Sampled):
    """A pinhole view: rows, columns, horizontal field of view (radians, below pi) and its pose in the body.

    The view frame is x forward, y left, z up like the body's, so that the identity looks forward:
    ``body_R_view @ direction_in_view = direction_in_body``. Pixels are square and the axis is in the middle, unless
    `optics` is a calibrated pinhole, with distortion as well: `of_lens` makes the grid of one.
    """

    height: int
    width: int
    hfov: float
    body_R_view: np.ndarray = field(default_factory=lambda: np.eye(3))
    optics: Lens | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.hfov < math.pi:
            raise GridError(
                f"hfov = {self.hfov:g} rad; a perspective view needs 0 < hfov < pi. Given in degrees? Use math.radians"
            )
        if self.optics is not None and (self.optics.size, self.optics.kind) != ((self.width, self.height), "pinhole"):
            raise GridError(
                f"the lens {self.optics.name!r} is a {self.optics.kind} of {self.optics.size[0]} x "
                f"{self.optics.size[1]}, the grid of {self.width} x {self.height}; wanted a pinhole of the same size: "
                "use PerspectiveGrid.of_lens, or resized"
            )

    @classmethod
    def of_lens(cls, lens: Lens) -> PerspectiveGrid:
        """The pixels of a calibrated ordinary lens, at its pose in the body."""
        return cls(lens.size[1], lens.size[0], lens.hfov, lens.body_R_lens, lens)

    def resized(self, height: int, width: int) -> PerspectiveGrid:
        """The grid of the same picture with other numbers of pixels."""
        optics = self.optics
        if optics is not None:
            by = width / self.width, height / self.height
            (fx, fy), (cx, cy) = optics.focal, optics.centre
            focal, centre = (fx * by[0], fy * by[1]), (cx * by[0], cy * by[1])
            optics = replace(optics, size=(width, height), focal=focal, centre=centre)
        return replace(self, height=height, width=width, optics=optics)

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return self.width / 2 / math.tan(self.hfov / 2)

    @lazy
    def lens(self) -> Lens:  # type: ignore[override]
        """The lens whose pixels these are."""
        if self.optics is not None:
            return replace(self.optics, body_R_lens=self.body_R_view)
        size, focal, centre = (self.width, self.height), (self.focal, self.focal), (self.width / 2, self.height / 2)
        return Lens("view", size, focal, centre, (), self.body_R_view)

    @lazy
    def weights(self) -> np.ndarray:
        """Solid angles ``(H, W)`` of the pixels: differences of atan(x y / sqrt(1 + x^2 + y^2)) over corners.

        Exact but for a lens with distortion, where each is that of the pixel's centre.
        """
        if any(self.lens.distortion):
            return frozen(self.density(*_centres(*self.shape)))
        x, y = self.lens.plane(np.arange(self.width + 1), np.arange(self.height + 1)[:, None])
        corner = np.arctan2(x * y, np.sqrt(1 + x * x + y * y))
        return frozen(np.diff(np.diff(corner, axis=0), axis=1))

    def density(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Steradians per square pixel: cos^3 of the angle off the axis, times the pixel's area in the plane."""
        right, down = self.lens.plane(x, y)
        area = 1 / (self.lens.focal[0] * self.lens.focal[1])
        if any(self.lens.distortion):  # central differences over a pixel
            (right_x, down_x), (right_y, down_y) = (
                np.subtract(self.lens.plane(x + dx, y + dy), self.lens.plane(x - dx, y - dy))
                for dx, dy in ((0.5, 0.0), (0.0, 0.5))
            )
            area = np.abs(right_x * down_y - right_y * down_x)
        return (1 + right**2 + down**2) ** -1.5 * area

    def depth_inside(self) -> np.ndarray:
        """Angle (radians, ``(H, W)``) from each pixel to the border: image edges are great circles.

        With distortion edges bend, and it is the angle as `eagor.cameras.Lens.project` has it.
        """
        if any(self.lens.distortion):
            return np.maximum(self.lens.project(self.directions)[2], 0.0)
        right, down = self.lens.plane(*_centres(*self.shape))
        (left, end), (top, bottom) = self.lens.plane(np.array([0.0, self.width]), np.array([0.0, self.height]))
        length = np.sqrt(1 + right**2 + down**2)
        sides = np.minimum((right - left) / math.hypot(1, left), (end - right) / math.hypot(1, end))
        ends = np.minimum((down - top) / math.hypot(1, top), (bottom - down) / math.hypot(1, bottom))
        return np.arcsin(np.minimum(sides, ends) / length)


@dataclass(frozen=True, eq=False, repr=False)
class FisheyeGrid(_Sampled):
    """An equidistant fisheye image: a circle that fills a square of `size` pixels and spans `fov` (up to 2 pi).

    The angle off the axis grows linearly with the distance from the image's centre. The corners see nothing: their
    weight is zero. Frames as in `PerspectiveGrid`.
    """

    size: int
    fov: float
    body_R_view: np.ndarray = field(default_factory=lambda: np.eye(3))

    height = width = property(lambda self: self.size)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.size < 1 or not 0 < self.fov <= 2 * math.pi:
            raise GridError(
                f"fisheye of size {self.size}, fov {self.fov:g} rad; wanted size >= 1 and 0 < fov <= 2 pi (radians)"
            )
        super().__post_init__()

    @lazy
    def lens(self) -> Lens:  # type: ignore[override]
        """The lens whose pixels these are."""
        both, half = (self.size, self.size), self.size / 2
        focal = self.size / self.fov
        return Lens("view", both, (focal, focal), (half, half), (), self.body_R_view, kind="fisheye", radius=half)

    @lazy
    def weights(self) -> np.ndarray:
        """Solid angles ``(H, W)`` of the pixels, zero outside the circle (4 x 4 points each: the rim is shared)."""
        fine = (np.arange(4 * self.size) + 0.5) / 4
        x, y = fine, fine[:, None]
        seen = np.where(self._angle(x, y) <= self.fov / 2, self.density(x, y), 0.0) / 16
        return frozen(seen.reshape(self.size, 4, self.size, 4).sum(axis=(1, 3)))

    def _angle(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Angle off the axis, radians."""
        return np.hypot(*self.lens.plane(x, y))

    def density(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Steradians per square pixel: sin(angle) / angle times the squared angular size of a pixel."""
        return np.sinc(np.minimum(self._angle(x, y), math.pi) / math.pi) / self.lens.focal[0] ** 2

    def depth_inside(self) -> np.ndarray | None:
        """Angle (radians, ``(H, W)``) from each pixel to the rim; None where the lens sees the whole sphere."""
        if self.fov >= 2 * math.pi - 1e-9:
            return None
        return np.maximum(self.fov / 2 - self._angle(*_centres(*self.shape)), 0.0)


Grid = ErpGrid | PatchGrid | PerspectiveGrid | FisheyeGrid
ViewKey = tuple[str, int, int, "float | tuple[float, ...]"]


def view_key(grid: PerspectiveGrid | FisheyeGrid) -> ViewKey:
    """A view without its pose: hashable, so that plans can be cached. The last item is its field, or all of a lens."""
    if isinstance(grid, FisheyeGrid):
        return "fisheye", grid.size, grid.size, grid.fov
    if grid.optics is None:
        return "perspective", grid.height, grid.width, grid.hfov
    return "perspective", grid.height, grid.width, (*grid.optics.focal, *grid.optics.centre, *grid.optics.distortion)


@lru_cache(maxsize=16)
def forward_view(key: ViewKey) -> PerspectiveGrid | FisheyeGrid:
    """The view with this key that looks forward."""
    kind, height, width, optics = key
    if isinstance(optics, tuple):
        fx, fy, cx, cy, *distortion = optics
        return PerspectiveGrid.of_lens(Lens("view", (width, height), (fx, fy), (cx, cy), tuple(distortion)))
    return PerspectiveGrid(height, width, optics) if kind == "perspective" else FisheyeGrid(height, optics)


# --- views that cover the sphere ---


OVERLAP = math.radians(10)
_ROUNDING = 1e-6  # radians, or views: what neighbours that touch exactly may miss by


def tangent_views(
    size: int, hfov: float = math.radians(100), overlap: float = OVERLAP, reach: float = math.pi / 2
) -> tuple[PerspectiveGrid, ...]:
    """Square views of `size` pixels and field `hfov` that cover all directions up to elevation +-`reach` (radians).

    Views narrower by `overlap` would still cover them. The views stand in rings at even elevations (one view at each
    pole), the first of each ring towards azimuth 0; of such layouts the one with the fewest views is taken: 6, as a
    cube, for 100 degrees with 10 of overlap. Raises `GridError` if the views are too narrow for the overlap, or wider
    than a plane can show.
    """
    least = math.radians(30) - 1e-9  # 40 degrees less 10 are 30, whatever is rounded on the way to radians
    if not (0 <= overlap < hfov <= math.radians(150) and hfov - overlap >= least and 0 < reach <= math.pi / 2):
        raise GridError(
            f"views of {math.degrees(hfov):g} degrees with {math.degrees(overlap):g} of overlap up to elevation "
            f"{math.degrees(reach):g}; wanted fields up to 150, at least 30 wider than the overlap, and 0 < reach <= 90"
        )
    poses = _poses(round((hfov - overlap) / 2, 9), round(reach, 9))
    return tuple(PerspectiveGrid(size, size, hfov, world_R_body(yaw, -pitch)) for yaw, pitch in poses)


@lru_cache(maxsize=16)
def _poses(inner: float, reach: float) -> tuple[tuple[float, float], ...]:
    """(yaw left, pitch up) of the fewest views of half-angle `inner` that cover the sphere up to `reach`."""
    # Rings at the poles only where they are to be seen; a single ring may do for a narrow band.
    fewest = math.ceil(math.pi / (2 * inner) - _ROUNDING) + 1
    layouts = [np.linspace(-math.pi / 2, math.pi / 2, rings) for rings in range(max(fewest, 3), fewest + 4)]
    fewest = math.ceil(reach / inner - _ROUNDING)
    layouts += [np.linspace(-1, 1, rings) * max(reach - inner, 0.0) for rings in range(max(fewest, 2), fewest + 4)]
    tests = [_points(reach, inner / per) for per in (4, 12, 40)]  # most layouts fail a coarse one already
    around = math.ceil(math.pi / inner - _ROUNDING)
    best: tuple[tuple[float, float], ...] = ()
    for rings in (*layouts, np.zeros(1)):
        for count in range(around, 4 * around):
            poses = _ring_poses(rings, count)
            if best and len(poses) >= len(best):
                break
            if all(_covered(points, poses, inner) for points in tests):
                best = poses
                break
    return best


def _points(reach: float, spacing: float) -> np.ndarray:
    """Directions ``(n, 3)`` every `spacing` radians from the equator up to `reach`: the layouts are symmetric."""
    elevations = np.linspace(0, reach, math.ceil(reach / spacing) + 1)
    azimuths = np.linspace(0, 2 * math.pi, math.ceil(2 * math.pi / spacing), endpoint=False)
    return direction(*np.meshgrid(azimuths, elevations)).reshape(-1, 3)


def _ring_poses(rings: np.ndarray, around: int) -> tuple[tuple[float, float], ...]:
    poses = []
    for pitch in sorted(rings.tolist(), key=abs):
        count = 1 if math.cos(pitch) < 1e-9 else max(3, math.ceil(around * math.cos(pitch) - 1e-9))
        poses += [(2 * math.pi * index / count, pitch) for index in range(count)]
    return tuple(poses)


def _covered(points: np.ndarray, poses: tuple[tuple[float, float], ...], inner: float) -> bool:
    """Whether each of `points` ``(n, 3)`` lies at least within the inner field of one view."""
    for yaw, pitch in poses:
        points = points[depth_inside(points @ world_R_body(yaw, -pitch), inner, inner) < -_ROUNDING]
    return len(points) == 0


def depth_inside(rays: np.ndarray, half_width: float, half_height: float) -> np.ndarray:
    """How much narrower (radians, on each side) a view could be and still show directions ``(..., 3)``.

    They are in the view's own frame; negative outside.
    """
    x, y, z = rays[..., 0], np.abs(rays[..., 1]), np.abs(rays[..., 2])
    return np.minimum(half_width - np.arctan2(y, x), half_height - np.arctan2(z, x))
