"""Cameras with lenses that are not ideal, and what they see, for tests."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.cameras import Lens, Rig, Sampler
from eagor.grids import ErpGrid
from eagor.sphere import world_R_body


def distorted_rig(height=256):
    """Two fisheyes side by side whose fields, curves, centres and tilts differ from the ideal and from each other."""
    radius = height / 2 * 0.97
    size = (2 * height, height)
    front = Lens.fisheye(
        "front", size, (height * 0.512, height * 0.492), radius, math.radians(197),
        distortion=(-0.03, 0.006, -0.0008), body_R_lens=world_R_body(0.01, 0.015, -0.02),
    )  # fmt: skip
    back = Lens.fisheye(
        "back", size, (height * 1.49, height * 0.51), radius * 0.99, math.radians(203),
        distortion=(0.02, -0.008, 0.001), body_R_lens=world_R_body(math.pi - 0.02, -0.01, 0.025),
    )  # fmt: skip
    return Rig((size,), (front, back))


def seen_by(rig, panorama):
    """What the rig's camera shows of a panorama ``(H, W, 3)`` uint8: its pictures ``(H, W, 3)``, black beyond the rims.

    Bicubic, without a low-pass filter: give a panorama that is about as fine as the pictures.
    """
    grid = ErpGrid(*panorama.shape[:2])
    pictures = tuple(np.zeros((height, width, 3), np.uint8) for width, height in rig.sizes)
    for lens in rig.lenses:
        width, height = rig.sizes[lens.picture]
        x, y = np.arange(width) + 0.5, np.arange(height)[:, None] + 0.5
        directions = lens.unproject(x, y)
        back_x, back_y, depth = lens.project(directions)
        shown = (np.hypot(back_x - x, back_y - y) < 1) & (depth >= 0)
        pictures[lens.picture][shown] = Sampler(grid, directions[shown], cubic=True)(panorama)
    return pictures


def off(rig, true):
    """By how much the directions of all pixels differ, degrees, when the rig as a whole is turned to fit best."""
    found, wanted = [], []
    width, height = true.sizes[0]
    y, x = np.mgrid[0.5:height:5, 0.5:width:5]
    for lens, other in zip(rig.lenses, true.lenses, strict=True):
        inside = np.hypot(x - other.centre[0], y - other.centre[1]) < other.radius
        found.append(lens.unproject(x[inside], y[inside]))
        wanted.append(other.unproject(x[inside], y[inside]))
    found, wanted = np.concatenate(found), np.concatenate(wanted)
    turn, _ = Rotation.align_vectors(wanted, found)
    return np.degrees(np.linalg.norm(turn.apply(found) - wanted, axis=1))
