"""Steps over a navigation mesh at a straight wall: where ours end on purpose elsewhere than Habitat's."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eagor.lab.worlds.habitat import Frames
from eagor.lab.worlds.habitat.navmesh import HELD, SHORT, HabitatNavMesh

WALL = 1.0  # our x of the edge of the mesh


def no_sliding(start, end):
    """As in Habitat: the step ends on the edge. Its world has our x, and our -y as z."""
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    if end[0] <= WALL:
        return tuple(np.float32(end))
    return tuple(np.float32(start + (end - start) * (WALL - start[0]) / (end[0] - start[0])))


def sliding(start, end):
    return np.float32(min(end[0], WALL)), np.float32(end[1]), np.float32(end[2])


MESH = SimpleNamespace(
    build_navmesh_vertices=lambda island: [(x, 0.0, z) for x, z in ((-4, -4), (WALL, -4), (WALL, 4), (-4, 4))],
    build_navmesh_vertex_indices=lambda island: [0, 1, 2, 0, 2, 3],
    try_step_no_sliding=no_sliding,
    try_step=sliding,
    is_navigable=lambda feet, most: feet[0] <= WALL + 1e-6,
    get_island=lambda feet: 0,
    snap_point=lambda feet: feet,
    distance_to_closest_obstacle=lambda feet, most: min(most, max(0.0, WALL - float(feet[0]))),
)
GROUND = HabitatNavMesh.of(MESH, (0, 0.0), Frames(), 0.18)


@given(
    gap=st.floats(0.002, 0.2),
    y=st.floats(-2.0, 2.0),
    angle=st.floats(-1.2, 1.2),
    length=st.floats(0.6, 1.0),
)
def test_a_stopped_body_stands_a_millimetre_before_the_edge_on_its_line(gap, y, angle, length):
    start, way = np.array([WALL - gap, y]), length * np.array([math.cos(angle), math.sin(angle)])
    edge = start + way * gap / way[0]
    end, stopped = GROUND.move(start, way, slide=False)
    assert stopped
    assert WALL - end[0] == pytest.approx(SHORT, abs=1.5 * HELD), "a flat way ends well before its edge"
    assert (edge - end) @ way > 0
    assert (end - start) @ way / length == pytest.approx(np.hypot(*(end - start)), abs=1e-9)
    again, stopped = GROUND.move(end, way, slide=False)
    assert stopped
    assert (again - end) @ way > -1e-6, "and is never pushed back"
    np.testing.assert_allclose(again, end, atol=HELD)


def test_free_steps_are_exact_and_sliding_is_habitats_own():
    start = np.array([0.2, 0.1])
    free = np.array([0.1, 0.2])
    end, stopped = GROUND.move(start, free, slide=False)
    assert not stopped
    np.testing.assert_array_equal(end, start + free)
    slid, stopped = GROUND.move(np.array([0.9, 0.0]), np.array([0.3, 0.2]), slide=True)
    assert stopped
    np.testing.assert_allclose(slid, [WALL, 0.2], atol=HELD)
