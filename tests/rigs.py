"""Cameras with lenses that are not ideal, and what they see, for tests."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.cameras import Lens, Rig
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
