"""Scenes of boxes, for tests of what reads scenes."""

import numpy as np

from eagor.lab.worlds.scene import Instance, Material, Scene

# Corners of a box are numbered by the bits x, y, z; faces counter-clockwise from outside.
_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
BOX = np.array([(a, *pair) for a, b, c, d in _FACES for pair in ((b, c), (c, d))])


def thing(category, low, high, room=None, colour=None):
    return Instance(category, colour, room, np.array(low, dtype=float), np.array(high, dtype=float))


def scene_of(things, rooms=(), materials=None, **more):
    """A scene with a box for each thing, from its low to its high corner; the materials take turns."""
    vertices = [[[t.low, t.high][(i >> (2 - axis)) & 1][axis] for axis in range(3)] for t in things for i in range(8)]
    triangles = np.concatenate([BOX + 8 * i for i in range(len(things))])
    materials = materials or (Material("plain"),)
    owner = np.repeat(np.arange(len(things)), len(BOX))
    return Scene(
        np.array(vertices, dtype=np.float32),
        triangles.astype(np.int32),
        owner.astype(np.int32),
        (owner % len(materials)).astype(np.int32),
        np.zeros((len(triangles), 3, 2), dtype=np.float32),
        tuple(things),
        tuple(materials),
        tuple(rooms),
        **more,
    )


def shell(width, depth, room=None, thick=0.1, height=2.5):
    """Floor and four walls of a room [0, width] x [0, depth]."""
    outer = (-thick, width + thick, -thick, depth + thick)
    return [
        thing("floor", (outer[0], outer[2], -0.1), (outer[1], outer[3], 0), room),
        thing("wall", (outer[0], outer[2], 0), (outer[1], 0, height), room),
        thing("wall", (outer[0], depth, 0), (outer[1], outer[3], height), room),
        thing("wall", (outer[0], 0, 0), (0, depth, height), room),
        thing("wall", (width, 0, 0), (outer[1], depth, height), room),
    ]
