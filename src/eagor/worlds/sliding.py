"""Steps of a body that runs into walls. Plain numbers instead of arrays: it is called once for every step taken."""

from __future__ import annotations

import math
from typing import NamedTuple


class Walls(NamedTuple):
    """Cells in reading order, `cols` in a row: `free`, one byte each, nothing free at the border; `clearance`."""

    free: bytes
    clearance: list[float]
    cols: int

    def move(self, x: float, y: float, dx: float, dy: float, slide: bool) -> tuple[float, float, bool]:
        """Where a step (dx, dy) from a free point (x, y) ends, and whether it was hindered; all in cells.

        The step is taken in parts of at most half a cell. Where the next part ends in a cell that is not free, what is
        left of it along the wall is taken (`slide`), or nothing.
        """
        free, _, cols = self
        at = int(y) * cols + int(x)
        parts = math.ceil(math.hypot(dx, dy) * 2)
        if parts:
            dx, dy = dx / parts, dy / parts
        collided = False
        for _ in range(parts):
            to = int(y + dy) * cols + int(x + dx)
            if free[to] and self._joined(at, to):
                x, y, at = x + dx, y + dy, to
                continue
            collided = True
            if not slide:
                break
            for along_x, along_y in self._along(at, dx, dy):
                to = int(y + along_y) * cols + int(x + along_x)
                if free[to] and self._joined(at, to):
                    x, y, at = x + along_x, y + along_y, to
                    break
            else:
                break
        return x, y, collided

    def _along(self, at: int, dx: float, dy: float) -> list[tuple[float, float]]:
        """What is left of a part of a step once its component into the wall is gone, the best first.

        The wall stands against the slope of the clearance; in the corners of the grid, where that leads nowhere, it
        stands along one of the axes.
        """
        clearance, cols = self.clearance, self.cols
        slope_x, slope_y = clearance[at + 1] - clearance[at - 1], clearance[at + cols] - clearance[at - cols]
        into = dx * slope_x + dy * slope_y
        found = [(dx, 0.0), (0.0, dy)] if abs(dx) > abs(dy) else [(0.0, dy), (dx, 0.0)]
        if into < 0:
            into /= slope_x * slope_x + slope_y * slope_y
            found.insert(0, (dx - into * slope_x, dy - into * slope_y))
        # Head-on, what is left is rounding; to take it would be no way along the wall.
        least = 0.01 * math.hypot(dx, dy)
        return [(a, b) for a, b in found if math.hypot(a, b) > least]

    def _joined(self, here: int, there: int) -> bool:
        """Whether two neighbouring free cells share an edge, or a corner that is not closed from both sides."""
        cols = self.cols
        if abs(here - there) in (0, 1, cols):
            return True
        row, col = here // cols, here % cols
        return bool(self.free[row * cols + there % cols] or self.free[there // cols * cols + col])
