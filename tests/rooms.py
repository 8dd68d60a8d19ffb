"""A small flat of boxes for tests: two rooms joined by a doorway, a dozen things, some of them twice."""

from __future__ import annotations

import numpy as np
from box_scenes import scene_of, thing

from eagor.lab.worlds.scene import Lamp, Material, Room, Scene

HEIGHT = 2.6
THINGS = [  # category, colour, low, high
    ("sofa", "blue", (0.2, 0.3, 0), (1.1, 2.3, 0.8)),
    ("tv", "black", (3.6, 1.0, 0.5), (3.75, 2.0, 1.1)),
    ("chair", "red", (1.2, 3.9, 0), (1.65, 4.35, 0.9)),
    ("chair", "green", (2.6, 3.9, 0), (3.05, 4.35, 0.9)),
    ("table", "brown", (1.8, 3.4, 0), (2.5, 4.4, 0.75)),
    ("plant", "green", (0.1, 4.4, 0), (0.5, 4.8, 1.2)),
    ("bed", "white", (6.2, 0.2, 0), (7.7, 2.2, 0.55)),
    ("wardrobe", "brown", (4.3, 4.3, 0), (5.9, 4.85, 2.0)),
    ("lamp", "yellow", (7.3, 2.4, 0), (7.7, 2.8, 1.6)),
    ("chair", "blue", (6.0, 4.2, 0), (6.45, 4.65, 0.9)),
]
# Outer walls, and one between the rooms with a doorway from y = 2.4 to 3.4.
_WALLS = [
    ("living room", (-0.2, -0.2, 0), (4.0, 0, HEIGHT)),
    ("bedroom", (4.0, -0.2, 0), (8.2, 0, HEIGHT)),
    ("living room", (-0.2, 5.0, 0), (4.0, 5.2, HEIGHT)),
    ("bedroom", (4.0, 5.0, 0), (8.2, 5.2, HEIGHT)),
    ("living room", (-0.2, 0, 0), (0, 5.0, HEIGHT)),
    ("bedroom", (8.0, 0, 0), (8.2, 5.0, HEIGHT)),
    ("living room", (3.95, 0, 0), (4.05, 2.4, HEIGHT)),
    ("living room", (3.95, 3.4, 0), (4.05, 5.0, HEIGHT)),
    ("living room", (3.95, 2.4, 2.1), (4.05, 3.4, HEIGHT)),
]
_SHADES = {"red": (0.7, 0.1, 0.1), "green": (0.1, 0.5, 0.2), "blue": (0.1, 0.2, 0.7), "brown": (0.4, 0.25, 0.1),
           "white": (0.9, 0.9, 0.9), "black": (0.05, 0.05, 0.05), "yellow": (0.8, 0.7, 0.1),
           None: (0.8, 0.78, 0.74)}  # fmt: skip


def two_rooms() -> Scene:
    """The flat: x from 0 to 8, y from 0 to 5 metres."""
    things = [
        *(thing("wall", low, high, room) for room, low, high in _WALLS),
        thing("floor", (0, 0, -0.1), (8, 5, 0)),
        thing("ceiling", (0, 0, HEIGHT), (8, 5, HEIGHT + 0.1)),
        *(thing(c, low, high, "living room" if low[0] < 4 else "bedroom", colour) for c, colour, low, high in THINGS),
    ]
    return scene_of(
        things,
        rooms=[
            Room("living room", "living room", np.array([[0.0, 0, 4, 5]])),
            Room("bedroom", "bedroom", np.array([[4.0, 0, 8, 5]])),
        ],
        materials=[Material(str(each.colour), _SHADES[each.colour]) for each in things],
        lamps=(Lamp(np.array([2.0, 2.5, 2.4]), np.full(3, 1.5)), Lamp(np.array([6.0, 2.5, 2.4]), np.full(3, 1.5))),
        source="two rooms",
    )
