"""A moving ball: not part of the scene, but drawn into rendered frames in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor.grids import ErpGrid
from eagor.worlds.render import Frame

# sRGB of the balls, by the colours' names.
PAINTS = {"red": (196, 34, 38), "blue": (38, 74, 186), "yellow": (226, 190, 40), "green": (40, 140, 66)}
_LIGHT = np.array([0.35, 0.25, 0.9]) / np.linalg.norm([0.35, 0.25, 0.9])


@dataclass(frozen=True, eq=False)
class Ball:
    """`centre` ``(3,)`` and `radius` in metres, world frame; `colour`, one of `PAINTS`."""

    centre: np.ndarray
    radius: float
    colour: str


def with_ball(frame: Frame, position: np.ndarray, world_R_body: np.ndarray, ball: Ball, id: int) -> Frame:
    """`frame`, equirectangular and rendered at this pose with ranges, with the ball added.

    It changes those of range, ids and rgb that the frame has; ids get `id`. The ball occludes and is occluded by range;
    it casts no shadow.
    """
    assert frame.range is not None
    grid = ErpGrid(*frame.range.shape)
    offset = world_R_body.T @ (ball.centre - position)
    # |t d - offset|^2 = radius^2 for the nearer t.
    along = grid.directions @ offset
    inside = along**2 - (offset @ offset - ball.radius**2)
    hit = (inside > 0) & (along > 0)
    distance = np.where(hit, along - np.sqrt(np.maximum(inside, 0.0)), np.inf)
    hit &= (distance > 0) & (distance < frame.range)
    if not hit.any():
        return frame
    rgb = None
    if frame.rgb is not None:
        normal = (distance[hit][:, None] * grid.directions[hit] - offset) / ball.radius @ world_R_body.T
        shade = 0.35 + 0.65 * np.clip(normal @ _LIGHT, 0.0, None)  # in display values: suggests form, not physical
        rgb = frame.rgb.copy()
        rgb[hit] = np.clip(shade[:, None] * np.array(PAINTS[ball.colour]), 0, 255).astype(np.uint8)
    ids = None
    if frame.ids is not None:
        ids = np.where(hit, np.int32(id), frame.ids)
    return Frame(rgb=rgb, range=np.where(hit, distance, frame.range).astype(np.float32), ids=ids)
