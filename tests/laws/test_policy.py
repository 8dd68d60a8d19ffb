"""The policy goes straight where it can, feels its way around what it cannot pass, and depends on nothing but touch."""

import math

import numpy as np
import pytest
from box_scenes import scene_of, shell, thing
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.lab.agents.steering import Policy
from eagor.lab.worlds.ground import Ground

STEP = 0.25
angles = st.floats(-math.pi, math.pi)


def room(*boxes, width=8.0, depth=6.0):
    """The ground of a room with boxes (x0, y0, x1, y1) as high as a wardrobe."""
    things = [thing("wardrobe", (x0, y0, 0), (x1, y1, 2)) for x0, y0, x1, y1 in boxes]
    return Ground.from_scene(scene_of([*shell(width, depth), *things]))


WALL = room((3.9, 1.5, 4.1, 4.5))
POCKET = room((4.8, 2.0, 5.0, 4.0), (3.0, 3.8, 5.0, 4.0), (3.0, 2.0, 5.0, 2.2))  # a U, open to the west
DOOR = room((3.9, 0.0, 4.1, 4.6), (3.9, 5.4, 4.1, 6.0))
ZIGZAG = room((2.4, 0.0, 2.6, 4.8), (5.0, 1.2, 5.2, 6.0))


def walk(ground, start, goal, steps, detour=True, slide=True, noise=None):
    """Follow the policy towards a goal until it is near; the last place. `noise()`, radians: added to what is told."""
    policy, xy, goal = Policy(STEP, detour=detour), np.array(start, dtype=float), np.array(goal, dtype=float)
    yaw = 0.0
    for _ in range(steps):
        if np.hypot(*(goal - xy)) < 0.6:
            break
        azimuth = math.remainder(math.atan2(*(goal - xy)[::-1]) - yaw + (noise() if noise else 0.0), 2 * math.pi)
        yaw = math.remainder(yaw + policy.heading(azimuth, xy, yaw), 2 * math.pi)
        xy, _ = ground.move(xy, STEP * np.array([math.cos(yaw), math.sin(yaw)]), slide=slide)
    return xy


def arrived(xy, goal):
    return np.hypot(*(xy - goal)) < 0.6


@given(st.lists(angles, min_size=1, max_size=20), angles)
def test_where_nothing_is_in_the_way_it_goes_where_it_is_told(azimuths, yaw):
    policy, xy = Policy(STEP), np.zeros(2)
    for azimuth in azimuths:
        heading = policy.heading(azimuth, xy, yaw)
        assert math.remainder(heading - azimuth, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)
        yaw = math.remainder(yaw + heading, 2 * math.pi)
        xy = xy + STEP * np.array([math.cos(yaw), math.sin(yaw)])


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_headings_are_angles_whatever_the_body_does(seed):
    """Steps that fail, slide, jump too far; estimates from all directions, pi included."""
    rng = np.random.default_rng(seed)
    policy, xy, yaw = Policy(float(rng.choice([0.05, 0.25, 1.0]))), rng.normal(size=2), float(rng.uniform(-9, 9))
    for _ in range(25):
        azimuth = float(rng.choice([math.pi, -math.pi, 0.0, rng.uniform(-4, 4)]))
        heading = policy.heading(azimuth, xy, yaw)
        assert -math.pi < heading <= math.pi
        yaw += heading
        share = float(rng.choice([0.0, 0.0, rng.uniform(0, 1.1), 1.0]))
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        xy = xy + policy.step * share * ahead + rng.choice([0.0, 0.05]) * rng.normal(size=2)


@pytest.mark.parametrize(
    ("ground", "start", "goal", "budget"),
    [
        (WALL, (2.0, 2.8), (6.0, 3.1), 35),
        (WALL, (6.0, 3.2), (2.0, 3.0), 35),
        (POCKET, (3.6, 3.0), (7.0, 3.0), 80),
        (DOOR, (2.0, 3.0), (6.5, 2.5), 80),
        (ZIGZAG, (1.0, 1.0), (7.0, 5.0), 100),
    ],
    ids=["wall", "wall from behind", "dead end", "door", "two turns"],
)
@pytest.mark.parametrize("slide", [True, False])
def test_it_gets_around_what_is_in_the_way(ground, start, goal, budget, slide):
    assert not arrived(walk(ground, start, goal, 200, detour=False, slide=slide), goal), "nothing is in the way"
    # Without sliding, whoever touches something has lost the rest of the step.
    assert arrived(walk(ground, start, goal, budget if slide else 2 * budget, slide=slide), goal)


@pytest.mark.parametrize("ground", [WALL, POCKET, DOOR], ids=["wall", "dead end", "door"])
@pytest.mark.parametrize("seed", range(3))
def test_an_unsteady_estimate_gets_there_too(ground, seed):
    """Ten degrees of jitter, and one estimate in ten points anywhere."""
    rng = np.random.default_rng(seed)

    def noise():
        return rng.uniform(-math.pi, math.pi) if rng.random() < 0.1 else math.radians(10) * rng.normal()

    assert arrived(walk(ground, (2.5, 3.0), (7.0, 3.0), 120, noise=noise), (7.0, 3.0))
