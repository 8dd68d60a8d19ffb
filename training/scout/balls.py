"""Balls in stored views: the tracking task asks for them, and no apartment holds any.

They are painted as the task paints them (`eagor.lab.worlds.render`), standing on the floor. The stored views have no
ranges; what hides a ball is read from the picture: a thing whose lowest visible point in the columns of the ball is
lower than the ball's own foot stands nearer.
"""

from __future__ import annotations

import math

import numpy as np
from data import HEIGHTS, moments

from eagor.lab.tasks.sim.tracking import RADIUS
from eagor.lab.worlds.render import PAINTS, Ball, Frame, with_ball
from eagor.lab.worlds.scene import STRUCTURE
from eagor.queries import COLOURS

SHARE = 0.4  # of the views that get a ball
AWAY = (0.8, 6.0)  # metres from the camera, along the floor
TRIES = 12


def with_balls(stored: dict[str, np.ndarray], names: tuple[str, ...], seed: int, share: float = SHARE) -> None:
    """Put a ball into some views of the arrays of a file of `data.py`, in place, each as a further instance."""
    rng = np.random.default_rng([seed, 23])
    rgb, ids, kind = stored["rgb"], stored["ids"], stored["category"]
    views, count = len(rgb), len(kind)
    structure = np.array([names[k] in STRUCTURE for k in kind])
    floors = np.array([names[k] in ("floor", "rug") for k in kind])
    rows: list[tuple[int, int, np.ndarray, np.ndarray, np.ndarray, float]] = []
    for view in np.flatnonzero(rng.random(views) < share):
        for _ in range(TRIES):
            colour = str(rng.choice(sorted(PAINTS)))
            painted = _painted(rgb[view], ids[view], structure, floors, colour, count + len(rows), rng)
            if painted is not None:
                rgb[view], ids[view] = painted.rgb, painted.ids
                area, mean, moment = moments(np.where(painted.ids == count + len(rows), 0, -1), 1)
                pixels = float((painted.ids == count + len(rows)).sum()) * (64 / ids.shape[1]) ** 2
                rows.append((int(view), COLOURS.index(colour), area[0], mean[0], moment[0], pixels))
                break
    added = len(rows)
    stored["category"] = np.append(kind, np.full(added, names.index("ball"), kind.dtype))
    stored["colour"] = np.append(stored["colour"], np.array([row[1] for row in rows], stored["colour"].dtype))
    stored["nameable"] = np.append(stored["nameable"], np.full(added, 2, stored["nameable"].dtype))
    for place, key in ((5, "pixels"), (2, "area"), (3, "mean"), (4, "moment")):
        old = stored[key]
        new = np.zeros((views, added, *old.shape[2:]), old.dtype)
        for index, row in enumerate(rows):
            new[row[0], index] = row[place]
        stored[key] = np.concatenate([old, new], axis=1)


def _painted(
    rgb: np.ndarray,
    ids: np.ndarray,
    structure: np.ndarray,
    floors: np.ndarray,
    colour: str,
    name: int,
    rng: np.random.Generator,
) -> Frame | None:
    """The view with one ball at a random place; None if it cannot stand or be seen there."""
    height, width = ids.shape
    radius, away, azimuth = rng.uniform(*RADIUS), rng.uniform(*AWAY), rng.uniform(-math.pi, math.pi)
    eye = rng.uniform(*HEIGHTS)
    foot = math.atan2(-eye, away)
    row, column = (math.pi / 2 - foot) * height / math.pi, (math.pi - azimuth) * width / (2 * math.pi)
    row, column = min(int(row), height - 1), int(column) % width
    under = int(ids[row, column])
    known = len(structure)
    if under < 0 or under >= known or (structure[under] and not floors[under]):
        return None  # beyond a wall, or on another ball
    reach = max(1, math.ceil(math.atan2(radius, away) * width / (2 * math.pi)))
    columns = np.arange(column - reach, column + reach + 1) % width
    strip = ids[:, columns]
    nearer = [
        thing
        for thing in np.unique(strip[(strip >= 0) & (strip < known)])
        if not structure[thing] and not floors[thing] and np.flatnonzero((strip == thing).any(axis=1))[-1] > row
    ]
    range_ = np.where(np.isin(ids, nearer), np.float32(0), np.float32(np.inf))
    centre = np.array([away * math.cos(azimuth), away * math.sin(azimuth), radius - eye])
    frame = Frame(rgb=rgb, range=range_, ids=ids.astype(np.int32))
    painted = with_ball(frame, np.zeros(3), np.eye(3), Ball(centre, radius, colour), name)
    return painted if painted.ids is not None and (painted.ids == name).any() else None
