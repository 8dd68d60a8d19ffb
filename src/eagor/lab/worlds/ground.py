"""The ground that tasks walk on: where a round body can stand, path lengths, and steps with collisions.

A plan of square cells in the world frame (x along columns, y along rows, metres). A cell is *free* if it has a floor
and no obstacle within `radius` of its centre, to the accuracy of a cell; only the largest connected area counts.

Which cells a triangle touches between two heights is exact and conservative (`rasterize`): neither a thin wall nor a
chair leg falls between samples. A face exactly between two cells, as walls on round numbers, counts for the one behind.

In the graph of the free cells, each is joined to 32 neighbours (steps of up to three cells that are not a multiple of a
shorter one) if all cells that the straight step touches are free. Directions are at most 18.4 degrees apart, so a path
over the graph is at most 1.3 % longer than the straight one, 0.6 % on average.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array, vstack
from scipy.sparse.csgraph import dijkstra

from eagor._values import lazy
from eagor.errors import WorldError
from eagor.lab.worlds.navmesh import DistanceField, along, cells_of, length_of, string_pull, walls_below
from eagor.lab.worlds.scene import STRUCTURE, Instance, Room, Scene

_INWARD = 1e-3  # in cells: shift of a face to its back
_TOUCH = 1e-4  # in cells: smaller overlaps do not count, to be safe from rounding
_AT_ONCE = 400_000  # candidate cells tested together; bounds the memory
BESIDE = 0.75  # metres from which one can reach a piece of furniture
_NEAREST = 4000  # points tried if no room tells on which side of the walls a thing is
_LARGEST = 4_000_000  # cells; 100 m x 100 m at 5 cm
_CRACK = 0.2  # metres: gaps in the floor up to this width (a missing sill, a hole in a scan) are closed
_AROUND = np.array([(c, r) for r in (-1, 0, 1) for c in (-1, 0, 1)])
_BESIDE_CORNER = {0: (1, 3), 2: (1, 5), 6: (3, 7), 8: (5, 7)}  # places in _AROUND: no way leads through a closed corner
_REACH = 3  # cells: length of the steps of the graph along an axis


def rasterize(
    corners: np.ndarray, low: float, high: float, origin: np.ndarray, cell: float, shape: tuple[int, int]
) -> np.ndarray:
    """Cells ``(rows, cols)`` bool that the part of the triangles with low < z < high touches.

    `corners` ``(n, 3, 3)`` metres; `origin` ``(2,)``: the low corner of cell (0, 0); rows along y, columns along x.
    """
    mask = np.zeros(shape, dtype=bool)
    z = corners[:, :, 2]
    corners = corners[(z.max(axis=1) > low) & (z.min(axis=1) < high)].astype(np.float64)
    # In cells, shifted a little to their back.
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    corners[:, :, :2] = (corners[:, :, :2] - origin) / cell - (_INWARD * normal[:, :2] / length)[:, None]
    limit = np.array(shape[::-1])
    first, last = np.floor(corners[:, :, :2].min(axis=1) + _TOUCH), np.floor(corners[:, :, :2].max(axis=1) - _TOUCH)
    # What lies along the edge of a cell, nearer than what counts, is in the one of the two where it begins.
    corners[:, :, :2] = np.where((last < first)[:, None], first[:, None] + 0.5, corners[:, :, :2])
    last = np.maximum(first, last)
    near = ((last >= 0) & (first < limit)).all(axis=1)
    corners, first = corners[near], np.clip(first[near], 0, limit - 1).astype(np.int64)
    size = np.clip(last[near], 0, limit - 1).astype(np.int64) - first + 1
    count = size.prod(axis=1)
    for part in np.split(np.arange(len(count)), np.flatnonzero(np.diff(np.cumsum(count) // _AT_ONCE)) + 1):
        number = count[part]
        owner = np.repeat(np.arange(len(part)), number)
        within, wide = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number), size[part][owner, 0]
        col, row = first[part][owner].T + np.stack([within % wide, within // wide])
        centre = np.stack([col + 0.5, row + 0.5, np.full(len(owner), (low + high) / 2)], axis=1)
        met = _meets(corners[part], owner, centre, np.array([0.5 - _TOUCH, 0.5 - _TOUCH, (high - low) / 2]))
        mask[row[met], col[met]] = True
    return mask


def _meets(corners: np.ndarray, owner: np.ndarray, centre: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Whether boxes, `half` their size ``(3,)`` about `centre` ``(k, 3)``, meet the triangles `owner` ``(k,)``.

    No axis separates the two: the normal of the triangle, or one that is normal to an edge of each (Akenine-Moeller,
    JGT 6, 2001). The bounds of the two are known to overlap.
    """
    edges = np.roll(corners, -1, axis=1) - corners
    axes = [np.cross(edges[:, 0], edges[:, 1]), *(np.cross(edges[:, k], side) for k in range(3) for side in np.eye(3))]
    met = np.ones(len(owner), dtype=bool)
    for axis in axes:
        along, reach = np.einsum("nkj,nj->nk", corners, axis), np.abs(axis) @ half
        place = np.einsum("kj,kj->k", centre, axis[owner])
        met &= (place >= (along.min(axis=1) - reach)[owner]) & (place <= (along.max(axis=1) + reach)[owner])
    return met


def level_triangles(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which triangles ``(n, 3, 3)`` are level within 45 degrees, which look up, and their areas."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1)
    return (np.abs(normal[:, 2]) > 0.7071 * double) & (double > 0), normal[:, 2] > 0, double / 2


def floor_height(corners: np.ndarray, level: np.ndarray, upward: np.ndarray, area: np.ndarray) -> float:
    """0 if there is a floor at 0, otherwise the height of the lowest large level surface."""
    chosen = level & upward if (level & upward).any() else level
    if not chosen.any():
        return 0.0
    heights, areas = corners[chosen][:, :, 2].mean(axis=1), area[chosen]
    levels, bins = np.unique(np.round(heights / 0.05), return_inverse=True)
    total = np.bincount(bins, weights=areas)
    large = levels[total >= 0.5 * total.max()]
    if 0 in large:
        return 0.0
    within = levels[bins] == large[0]
    return float(np.average(heights[within], weights=areas[within]))


@dataclass(frozen=True, eq=False)
class Ground:
    """Free cells ``(rows, cols)`` bool and `clearance` ``(rows, cols)``: metres to the nearest obstacle or edge.

    `structure` ``(rows, cols)`` bool: cells with a wall, door or window. `floor`: height of the floor in metres.
    `radius`: of the body. Cell (0, 0) has its low corner at `origin` ``(2,)``. Cells at the border are never free. A
    point is ``(2,)``: x and y. Another simulator's ground is one of these, with what it knows better overridden.
    """

    origin: np.ndarray
    cell: float
    radius: float
    floor: float
    free: np.ndarray
    clearance: np.ndarray
    structure: np.ndarray
    rooms: tuple[Room, ...] = ()

    @classmethod
    def from_scene(
        cls, scene: Scene, *, cell: float = 0.05, radius: float = 0.18,
        height: float = 1.5, climb: float = 0.12, floor: float | None = None,
    ) -> Ground:  # fmt: skip
        """The ground of a scene, for a body of `radius` and `height` that walks over obstacles lower than `climb`.

        Obstacles are all triangles between `climb` and `height` above the floor. The floor is level surfaces within
        `climb` of the height `floor` (default: `floor_height`). Raises `WorldError` if there is no floor, no free cell,
        or too large a floor for such cells.
        """
        if not (0 < cell <= 1 and radius >= 0 and 0 <= climb < height):
            raise WorldError(
                f"cell = {cell}, radius = {radius}, climb = {climb}, height = {height}; wanted a cell above 0 and at "
                "most 1 m, no negative radius, and 0 <= climb < height"
            )
        corners = scene.vertices[scene.triangles].astype(np.float64)
        level, upward, area = level_triangles(corners)
        floor = floor_height(corners, level, upward, area) if floor is None else float(floor)
        slab = floor - max(climb, 0.1), floor + max(climb, 0.1)
        z = corners[:, :, 2]
        floors = corners[level & (z.max(axis=1) > slab[0]) & (z.min(axis=1) < slab[1])]
        if len(floors) == 0:
            raise WorldError(
                f"{scene.source} has no level surface near z = {floor:g} m; pass floor=, the height of its floor"
            )
        low, high = floors[:, :, :2].min(axis=(0, 1)), floors[:, :, :2].max(axis=(0, 1))
        origin = low - 2 * cell
        cols, rows = (int(n) for n in np.ceil((high - origin) / cell) + 2)
        if rows * cols > _LARGEST:
            raise WorldError(
                f"the floor of {scene.source} is {high[0] - low[0]:.0f} m x {high[1] - low[1]:.0f} m: {rows * cols} "
                f"cells of {cell} m, wanted at most {_LARGEST}; raise cell, or leave the terrain out of the scene"
            )
        grid = origin, cell, (rows, cols)
        crack = math.ceil(_CRACK / cell / 2)
        covered = np.pad(rasterize(floors, *slab, *grid), crack)
        has_floor = np.asarray(ndimage.binary_closing(covered, iterations=crack), dtype=bool)
        has_floor = has_floor[crack:-crack, crack:-crack]
        structural = np.array([thing.category in STRUCTURE for thing in scene.instances])[scene.instance]
        body = floor + climb, floor + height
        structure = rasterize(corners[structural], *body, *grid)
        blocked = structure | rasterize(corners[~structural], *body, *grid) | ~has_floor
        blocked[[0, -1]] = blocked[:, [0, -1]] = True
        clearance = np.asarray(ndimage.distance_transform_edt(~blocked)) * cell
        free = largest_area((clearance >= radius) & ~blocked)
        if not free.any():
            raise WorldError(
                f"nowhere in {scene.source} can a body of radius {radius:g} m stand; wanted some floor at z = "
                f"{floor:g} m with nothing above it up to {height:g} m. Lower radius, or pass floor="
            )
        return cls(origin, cell, radius, floor, free, clearance, structure, scene.rooms)

    # --- points ---

    @property
    def points(self) -> np.ndarray:
        """Places to choose from ``(n, 2)``: the centres of the free cells, in reading order."""
        return self.centres(self._nodes)

    def height(self, xy: np.ndarray) -> float:
        """Height of the ground under a point: `floor`, unless there are steps, ramps or stairs."""
        return self.floor

    def is_free(self, xy: np.ndarray) -> np.ndarray:
        """Whether the body can stand at points ``(..., 2)``; False off the ground and for NaN."""
        _, (row, col), known = cells_of(xy, self.origin, self.cell, self.free.shape)
        return known & self.free[row, col]

    def centres(self, cells: np.ndarray) -> np.ndarray:
        """Points ``(..., 2)`` at the centres of cells ``(..., 2)``, which are rows and columns."""
        return self.origin + (np.asarray(cells)[..., ::-1] + 0.5) * self.cell

    def snap(self, xy: np.ndarray, within: float = math.inf) -> np.ndarray | None:
        """The free point nearest to a point; None if there is none `within` this many metres, and for NaN."""
        xy = np.asarray(xy, dtype=np.float64)
        if not np.isfinite(xy).all():
            return None
        if self.is_free(xy):
            return xy.copy()
        low = self.origin + self._nodes[:, ::-1] * self.cell
        margin = 1e-6 * self.cell  # off the edge of the cell, which belongs to its neighbour
        nearest = np.clip(xy, low + margin, low + self.cell - margin)
        away = np.hypot(*(nearest - xy).T)
        best = int(away.argmin())
        return nearest[best] if away[best] <= within else None

    def sample(self, rng: np.random.Generator, clearance: float = 0.0) -> np.ndarray:
        """A random free point of at least this `clearance` (m). Raises `WorldError` if there is none."""
        cells = np.argwhere(self.free & (self.clearance >= clearance))
        if len(cells) == 0:
            raise WorldError(
                f"no free cell has a clearance of {clearance:g} m; the most is {self.clearance[self.free].max():.2f} m"
            )
        place = cells[rng.integers(len(cells))][::-1] + rng.uniform(0.001, 0.999, size=2)
        return self.origin + place * self.cell

    # --- distances ---

    def field(self, points: np.ndarray, offsets: np.ndarray | None = None) -> DistanceField:
        """Distances to the nearest of points ``(n, 2)`` or ``(2,)``; each starts at its offset ``(n,)`` or 0."""
        points, starts = checked_goals(points, offsets)
        stand = self.is_free(points)
        points, starts = points[stand], starts[stand]
        # The cells about each point start at their own distance from it.
        place = (points - self.origin) / self.cell
        around = np.floor(place).astype(np.intp)[:, None] + _AROUND
        away = np.hypot(*np.moveaxis(around + 0.5 - place[:, None], -1, 0)) + starts[:, None] / self.cell
        index = self._index[around[..., 1], around[..., 0]]
        usable = index >= 0
        for corner, (one, other) in _BESIDE_CORNER.items():
            usable[:, corner] &= usable[:, one] & usable[:, other]
        return self._spread(index[usable], away[usable])

    def at_points(self, way: DistanceField) -> np.ndarray:
        """Metres ``(n,)`` of a field of this ground from all `points`."""
        return way.metres[self.free]

    def footprint(self, instance: Instance) -> DistanceField:
        """Distances to the footprint of an instance, via points `beside` it; inf everywhere without any."""
        points, away = self.beside(instance)
        _, own, _ = cells_of(points, self.origin, self.cell, self.free.shape)
        return self._spread(self._index[own], away / self.cell)

    def beside(self, instance: Instance) -> tuple[np.ndarray, np.ndarray]:
        """The free points ``(k, 2)`` beside an instance, and their distances ``(k,)`` to its footprint, metres.

        A point is beside it if it is within 0.75 m and its line to the nearest point of the footprint crosses no wall,
        door or window. A thing against or on a wall shares cells with it, so crossings close to the end do not count,
        unless the point lies outside the room of the thing: walls may be thin. If no point is beside (a vase in the
        middle of a large table), the result is the points of the same room that are at most 0.75 m farther than the
        nearest of them; without rooms, those with a clear line.
        """
        points = self.points
        nearest = np.clip(points, instance.low[:2], instance.high[:2])
        away = np.hypot(*(nearest - points).T)
        room = next((room for room in self.rooms if room.name == instance.room), None)
        close = np.flatnonzero(away <= BESIDE)
        anywhere, early = self._crossings(points[close], nearest[close])
        clear = ~early
        if room is not None:
            clear &= ~anywhere | room.contains(*points[close].T)
        chosen = close[clear]
        if len(chosen) == 0:
            x, y, _ = instance.centre
            room = room or next((other for other in self.rooms if other.contains(x, y)), None)
            if room is not None:
                chosen = np.flatnonzero(room.contains(*points.T))
            else:
                chosen = np.argsort(away, kind="stable")[:_NEAREST]
                chosen = chosen[~self._crossings(points[chosen], nearest[chosen])[1]]
            chosen = chosen[away[chosen] <= away[chosen].min(initial=np.inf) + BESIDE]
        return points[chosen], away[chosen]

    def _crossings(self, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether lines ``(n, 2)`` cross structure: anywhere, and farther than a cell and a half from their ends."""
        gap = np.hypot(*(ends - starts).T)
        count = max(2, math.ceil(float(gap.max(initial=0.0)) / self.cell * 4) + 1)
        share = np.linspace(0.0, 1.0, count)
        line = starts[:, None] + share[:, None] * (ends - starts)[:, None]
        rows, cols = self.structure.shape
        col, row = np.moveaxis(np.floor((line - self.origin) / self.cell).astype(np.intp), -1, 0)
        hit = np.asarray(self.structure)[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)]
        early = (1 - share) * gap[:, None] > 1.5 * self.cell
        return np.any(hit, axis=1), np.any(hit & early, axis=1)

    @lazy
    def _nodes(self) -> np.ndarray:
        """Rows and columns ``(n, 2)`` of the free cells, in reading order: the nodes of the graph."""
        return np.argwhere(self.free)

    @lazy
    def _index(self) -> np.ndarray:
        """Index in `_nodes` of each cell ``(rows, cols)``, -1 for those that are not free."""
        return np.where(self.free, np.cumsum(self.free).reshape(self.free.shape) - 1, -1).astype(np.int32)

    @lazy
    def _edges(self) -> csr_array:
        """Lengths in cells ``(n, n)`` of the steps between free cells."""
        starts, ends, lengths = [], [], []

        def shifted(grid: np.ndarray, cell: tuple[int, int]) -> np.ndarray:
            # It may wrap: a step over the border touches cells of it, which are not free.
            return np.roll(grid, (-cell[0], -cell[1]), axis=(0, 1))

        for r, c in itertools.product(range(_REACH + 1), range(-_REACH, _REACH + 1)):
            if (r, c) > (0, 0) and math.gcd(r, c) == 1:  # one of each opposite pair
                box = itertools.product(range(r + 1), range(min(0, c), max(0, c) + 1))
                touched = [(a, b) for a, b in box if 2 * abs(r * b - c * a) <= r + abs(c)]
                open_ = np.all([shifted(self.free, cell) for cell in touched], axis=0)
                here, there = self._index[open_], shifted(self._index, (r, c))[open_]
                starts += [here, there]
                ends += [there, here]
                lengths.append(np.full(2 * len(here), math.hypot(r, c)))
        entries = np.concatenate(lengths), (np.concatenate(starts), np.concatenate(ends))
        return csr_array(entries, shape=(len(self._nodes), len(self._nodes)))

    @lazy
    def _walls(self) -> np.ndarray:
        return walls_below(self.free)

    def _spread(self, seeds: np.ndarray, offsets: np.ndarray) -> DistanceField:
        """Distances from seeds, indices of `_nodes` ``(k,)`` that start at `offsets` ``(k,)``, in cells."""
        found = np.full(self.free.shape, np.inf)
        if len(seeds):
            # A virtual node joined to every seed by an edge of its offset stands for the goal.
            count = len(self._nodes)
            goal = csr_array((np.maximum(offsets, 1e-9), seeds, [0, len(seeds)]), shape=(1, count))
            joined = vstack([self._edges, goal], format="csr")
            joined.resize((count + 1, count + 1))
            found[self.free] = dijkstra(joined, indices=count)[:count]
        return DistanceField(self.origin, self.cell, found * self.cell)

    def _descend(self, distances: np.ndarray, row: int, col: int) -> np.ndarray:
        """Cells ``(n, 2)`` from (row, col) down to the seed of its path; `distances` ``(rows, cols)`` are in cells."""
        values, edges = distances[self.free], self._edges
        here = int(self._index[row, col])
        way = [here]
        while True:
            part = slice(edges.indptr[here], edges.indptr[here + 1])
            through = values[edges.indices[part]] + edges.data[part]
            # A seed starts below every path through a neighbour, up to rounding.
            if len(through) == 0 or through.min() > values[here] + 1e-7:
                return self._nodes[way]
            here = int(edges.indices[part][through.argmin()])
            way.append(here)

    def path(self, start: np.ndarray, goal: np.ndarray | DistanceField) -> np.ndarray:
        """The shortest path ``(n, 2)`` from a free point to another, or down a field to its goal.

        Taut, over free cells only. With the field of a footprint it ends at the free cell beside it. Raises
        `WorldError` if the start is not free or there is no path.
        """
        field = goal if isinstance(goal, DistanceField) else self.field(goal)
        x, y = (float(value) for value in start)
        row, col = self._cell_of(x, y)
        if not math.isfinite(field.metres[row, col]):
            raise WorldError(
                f"there is no path from ({x:.2f}, {y:.2f}) to the goal; is it free ground? snap() finds some"
            )
        cells = self._descend(field.metres / self.cell, row, col)
        ends = [start] if isinstance(goal, DistanceField) else [start, goal]
        first, *last = (np.asarray(ends, dtype=np.float64) - self.origin) / self.cell
        taut = string_pull(np.array([first, *(cells[:, ::-1] + 0.5), *last]), self._walls)
        return self.origin + taut * self.cell

    def stroll(self, start: np.ndarray, step: float, rng: np.random.Generator) -> Iterator[np.ndarray]:
        """Points ``(2,)`` without end, `step` metres apart, along paths from `start` to random goals one by one."""
        last = np.asarray(start, dtype=np.float64)
        yield last
        while True:
            path = self.path(last, self.sample(rng))
            points = along(path, np.arange(step, max(length_of(path), step) + 1e-9, step))
            yield from points
            last = points[-1]

    # --- steps ---

    def move(self, xy: np.ndarray, step: np.ndarray, slide: bool = True) -> tuple[np.ndarray, bool]:
        """The end of a step ``(2,)`` from a free point ``(2,)``, and whether it collided. Metres.

        A blocked step loses its component into the wall (`slide`), or the body stops. The end is always free, and never
        farther away than the length of the step. Raises `WorldError` if the start is not free or the step not finite.
        """
        x, y, dx, dy = float(xy[0]), float(xy[1]), float(step[0]), float(step[1])
        if not math.isfinite(dx + dy):
            raise WorldError(f"step = ({dx}, {dy}); wanted two finite numbers, metres")
        self._cell_of(x, y)
        (ox, oy), cell = self.origin.tolist(), self.cell
        x, y, dx, dy = (x - ox) / cell, (y - oy) / cell, dx / cell, dy / cell
        parts = math.ceil(math.hypot(dx, dy) * 2)  # of at most half a cell
        collided = False
        for _ in range(parts):
            ways = [(dx / parts, dy / parts)]
            if not self._leads(x, y, *ways[0]):
                collided = True
                ways = [way for way in self._along(x, y, *ways[0]) if slide and self._leads(x, y, *way)]
            if not ways:
                break
            x, y = x + ways[0][0], y + ways[0][1]
        # Away from the edges of the cell, where rounding would lead into its neighbours.
        x, y = (min(max(value, int(value) + 1e-9), int(value) + 1 - 1e-9) for value in (x, y))
        return np.array((ox + x * cell, oy + y * cell)), collided

    def _leads(self, x: float, y: float, dx: float, dy: float) -> bool:
        """Whether a step of at most half a cell, in cells, leads from a free cell to itself or another.

        The two share an edge, or a corner that is not closed from both sides.
        """
        row, col, to_row, to_col = int(y), int(x), int(y + dy), int(x + dx)
        return bool(self.free[to_row, to_col] and (self.free[row, to_col] or self.free[to_row, col]))

    def _along(self, x: float, y: float, dx: float, dy: float) -> list[tuple[float, float]]:
        """A step without its component into the wall, in cells, the best candidate first.

        The wall is normal to the gradient of the clearance; if that leads nowhere, along one of the axes.
        """
        clearance, row, col = self.clearance, int(y), int(x)
        slope_x = float(clearance[row, col + 1] - clearance[row, col - 1])
        slope_y = float(clearance[row + 1, col] - clearance[row - 1, col])
        into = dx * slope_x + dy * slope_y
        found = [(dx, 0.0), (0.0, dy)] if abs(dx) > abs(dy) else [(0.0, dy), (dx, 0.0)]
        if into < 0:
            into /= slope_x * slope_x + slope_y * slope_y
            found.insert(0, (dx - into * slope_x, dy - into * slope_y))
        # In a head-on collision only rounding errors are left; they give no direction along the wall.
        least = 0.01 * math.hypot(dx, dy)
        return [(a, b) for a, b in found if math.hypot(a, b) > least]

    def _cell_of(self, x: float, y: float) -> tuple[int, int]:
        """Row and column of a free point; raises `WorldError` for any other."""
        rows, cols = self.free.shape
        col, row = (x - self.origin[0]) / self.cell, (y - self.origin[1]) / self.cell
        if not (0 <= col < cols and 0 <= row < rows and self.free[int(row), int(col)]):
            raise WorldError(f"({x:.3f}, {y:.3f}) is not free ground; start from a free point, such as snap() gives")
        return int(row), int(col)


def checked_goals(points: np.ndarray, offsets: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Points ``(n, 2)`` and where distances to them start ``(n,)``, by default at 0. Raises `WorldError`."""
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    starts = np.zeros(len(points)) if offsets is None else np.array(np.broadcast_to(offsets, len(points)))
    if points.shape != (len(points), 2) or not (np.isfinite(starts) & (starts >= 0)).all():
        raise WorldError(
            f"points have shape {points.shape}, offsets {starts.tolist()}; wanted (n, 2) and finite metres >= 0"
        )
    return points, starts


def largest_area(free: np.ndarray) -> np.ndarray:
    """The largest set of cells connected along edges."""
    labels = np.zeros(free.shape, dtype=np.int32)
    ndimage.label(free, output=labels)
    sizes = np.bincount(labels.ravel())[1:]
    return labels == sizes.argmax() + 1 if len(sizes) else free
