"""Beds: frame and headboard, mattress, duvet with a fold, pillows."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from eagor.sphere import rotation
from eagor.worlds.apartment.curved import pillow, slab
from eagor.worlds.apartment.furniture.model import WOODS, finish, legs, timber
from eagor.worlds.apartment.furniture.seats import throw
from eagor.worlds.apartment.mesh import Mesh, Part, bevelled, box, moved, turned

COLOURS = ("white", "grey", "blue", "green", "beige", "red", "purple", "pink", "yellow", "orange", "brown", "black")
_LENGTH = 2.0  # of the mattress, metres


def bed(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bed for one or two; `colour` is that of the duvet."""
    width = float(rng.choice([0.9, 1.0, 1.4, 1.6, 1.8]))
    rail, height = rng.uniform(0.2, 0.3), rng.uniform(0.44, 0.54)
    wood = colour if colour in WOODS and rng.random() < 0.7 else str(rng.choice(WOODS))
    frame_width, x = width + 0.06, _LENGTH / 2
    y, joiner = frame_width / 2, timber(wood, rng)
    parts = [_headboard(frame_width, height + rng.uniform(0.35, 0.52), colour, joiner, rng)]
    frame = [
        bevelled((-x, -y, rail - 0.1), (x + 0.03, -y + 0.03, rail + 0.05), 0.008, grain=0),
        bevelled((-x, y - 0.03, rail - 0.1), (x + 0.03, y, rail + 0.05), 0.008, grain=0),
        box((-x, -y + 0.02, rail - 0.06), (x, y - 0.02, rail), grain=0),
        legs((-x + 0.1, -y + 0.04, x - 0.01, y - 0.04), rail - 0.05, 0.06, 0.045),
    ]
    board = wood == colour and rng.random() < 0.5  # in another colour it would dominate the cover
    if board:
        frame.append(bevelled((x, -y, rail - 0.1), (x + 0.04, y, height + rng.uniform(0.05, 0.16)), 0.012, 2, grain=1))
    else:
        frame.append(bevelled((x, -y, rail - 0.1), (x + 0.03, y, rail + 0.05), 0.008, grain=1))
    parts.append(joiner(*frame))
    white = finish("fabric", "white", rng)
    mattress = bevelled((-x + 0.005, -width / 2, rail), (x - 0.005, width / 2, height), 0.035, 2)
    # The sides hang over the rails, so that the cover is most of what is visible.
    start, overhang = -x + rng.uniform(0.48, 0.6), min(height - rail + rng.uniform(0.02, 0.1), 0.7 * height)
    cloth = finish("fabric", colour, rng)
    parts.append(cloth(_cover(width, height, start, x, overhang, not board, rng.uniform(-1, 1, (10, 9)))))
    linen = white if (rng.random() < 0.4 and wood != "white") or colour == "white" else cloth
    reverse = finish("fabric", "beige", rng) if colour == "white" else white
    pillows = _pillows(width, height, rng, min(0.7, 0.46 * width + 0.2), rng.uniform(0.8, 1.15))
    parts += [reverse(_fold(width, height, start, overhang)), white(mattress), linen(*pillows)]
    if rng.random() < 0.4:
        other = str(rng.choice([name for name in COLOURS if name not in (colour, "white", "black")]))
        size = rng.uniform(0.34, 0.4)
        soft = throw((start + 0.1, rng.uniform(-0.1, 0.1) * width, height + 0.07), 0.7, 0.0, size, 0.13)
        parts.append(finish("fabric", other, rng)(soft))
    return parts


def _headboard(width: float, top: float, colour: str, wood: Callable[..., Part], rng: np.random.Generator) -> Part:
    """A board, a row of padded fields or slats between posts, its front face at x = -1 and its middle at y = 0."""
    x, y = -_LENGTH / 2, width / 2
    design = rng.integers(3)
    if design == 0:
        return wood(bevelled((x - 0.05, -y, 0), (x, y, top), 0.015, 2, grain=1))
    if design == 1:
        cloth = finish("fabric", colour if rng.random() < 0.8 else "grey", rng)
        count = 2 if width < 1.2 else int(rng.integers(3, 5))
        spans, steps = pairwise(np.linspace(-y, y, count + 1)), 1 if count > 3 else 2
        fields = [bevelled((x - 0.04, a, 0.3), (x + 0.04, b, top), 0.025, steps) for a, b in spans]
        return cloth(box((x - 0.06, -y, 0), (x - 0.02, y, top - 0.02)), *fields)
    rails = [bevelled((x - 0.05, -y, z - h), (x - 0.01, y, z), 0.01, grain=1) for z, h in ((top, 0.09), (0.5, 0.06))]
    posts = [bevelled((x - 0.06, s - 0.03, 0), (x, s + 0.03, top + 0.02), 0.01, grain=2) for s in (-y + 0.03, y - 0.03)]
    places = np.linspace(-y, y, int(width / 0.13) + 2)[1:-1]
    slats = [box((x - 0.035, s - 0.02, 0.47), (x - 0.02, s + 0.02, top - 0.07), grain=2) for s in places]
    return wood(*rails, *posts, *slats)


def _across(width: float, overhang: float) -> tuple[np.ndarray, np.ndarray]:
    """Stations of a cover across the bed: y, and how far below the top of the mattress it hangs there."""
    y = width / 2
    place, drop = np.array([y + 0.05, y + 0.03, y - 0.03, 0.55 * y, 0.2 * y]), np.array([overhang, 0.08, 0.0, 0.0, 0.0])
    return np.concatenate([-place, place[::-1]]), np.concatenate([drop, drop[::-1]])


def _cover(
    width: float, height: float, start: float, end: float, overhang: float, hangs: bool, wave: np.ndarray
) -> Mesh:
    """A duvet from x = `start` to `end`, where it hangs down or is tucked in; `wave` ``(10, 9)`` makes it uneven."""
    y, drop = _across(width, overhang)
    x = np.concatenate([np.linspace(start, end - 0.15, 6), [end - 0.03, end + 0.03, end + 0.05]])
    along = np.zeros(9)
    along[-2:] = (0.08, overhang) if hangs else (0.06, 0.1)
    if not hangs:
        x[-3:] = end - 0.06, end - 0.02, end - 0.005
    points = np.empty((10, 9, 3))
    points[..., 0], points[..., 1] = x, y[:, None]
    # At the corners of the foot, where both sides hang, cloth hangs lower than either.
    both = np.minimum(drop[:, None], along) * (0.35 if hangs else 0.0)
    points[..., 2] = height + 0.045 - np.maximum(drop[:, None], along) - both
    flat = (drop[:, None] == 0) & (along == 0)
    points[..., 2] += np.where(flat, 0.012 * wave, 0.0)
    # One wave for both rows of a hanging side, as otherwise they would cross at the corners.
    points[..., 1] += np.where(drop[:, None] > 0, 0.008 * (1 + wave[3]) * np.sign(y)[:, None], 0.0)
    points[..., 0] += np.where((along > 0) & hangs, 0.012 * (1 + wave[:, 3:4]), 0.0)
    points[..., 2] += np.where((drop[:, None] == overhang) & (along == 0), 0.015 * wave, 0.0)
    return slab(points, 0.012)


def _fold(width: float, height: float, start: float, overhang: float) -> Mesh:
    """The strip at the head of the duvet that is turned back and shows its other side."""
    y, drop = _across(width + 0.045, overhang - 0.03)
    x = np.array([start - 0.03, start - 0.015, start + 0.1, start + 0.26, start + 0.28])
    points = np.empty((len(y), len(x), 3))
    points[..., 0], points[..., 1] = x, y[:, None]
    points[..., 2] = height + 0.08 - drop[:, None] - np.array([0.05, 0.005, 0.0, 0.005, 0.02])
    return slab(points, 0.025)


def _pillows(width: float, height: float, rng: np.random.Generator, size: float, lean: float) -> list[Mesh]:
    """One pillow on a narrow bed, two on a wide one, against the headboard."""
    y, made = width / 4 if width > 1.2 else 0.0, []
    for place in (-y, y) if y else (0.0,):
        soft = turned(moved(pillow(size, 0.46, 0.17), (0, 0, 0.23)), rotation((0, 1, 0), -lean))
        soft = turned(soft, rotation((0, 0, 1), rng.uniform(-0.06, 0.06)))
        made.append(moved(soft, (-_LENGTH / 2 + 0.09 + 0.46 * np.sin(lean), place, height + 0.02)))
    return made
