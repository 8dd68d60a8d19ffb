"""A report's map of a search shows where looks had shown the floor, and where the body searched; others stay as is."""

import base64
import io
import re

import numpy as np
import pytest
import synthetic_runs as runs
from box_scenes import scene_of, shell, thing
from PIL import Image

from eagor.conventions import wxyz_from_rotation
from eagor.lab.agents import search_space
from eagor.lab.agents.search_space import CONTACT, FLOOR, UNKNOWN
from eagor.lab.envs.places import Place
from eagor.lab.envs.rules import Camera
from eagor.lab.eval import replay
from eagor.lab.eval.report import write_report
from eagor.lab.worlds import ground_of, view_of
from eagor.sphere import world_R_body

CAMERA = Camera()
WALL = thing("wall", (5.0, 0, 0), (5.1, 6, 2.5))  # without a door: nobody sees the room behind it
STEPS = 8


def place_of(things):
    scene = scene_of(things)
    return Place(scene, ground_of(scene, CAMERA.radius), view_of(scene))


@pytest.fixture(scope="module")
def rooms():
    return place_of([*shell(9.0, 6.0), WALL, thing("chair", (1.0, 1.0, 0), (1.5, 1.5, 0.9))])


def poses(height=CAMERA.height):
    """A straight way through the first room."""
    turn = wxyz_from_rotation(world_R_body(0.4))
    return [[1.0 + 0.25 * k, 3.0, height, *turn] for k in range(STEPS)]


def record_of(searching=None):
    trace = {"pose": poses()} | ({} if searching is None else {"searching": searching})
    return {"episode": {"id": "1-0", "query": "chair", "targets": [6]}, "methods": {"eagor": {"trace": trace}}}


HALF = [True] * 4 + [False] * 4


def drawn(place, record):
    return replay.floor_map(place, record, [], CAMERA)[0]


def pixels(svg):
    data = re.search(r'href="data:image/png;base64,([^"]+)"', svg)[1]
    return np.array(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA"))[::-1].astype(int)


def at(place, xy):
    """The pixel of a map where a point is: a map shows what is free or structure."""
    ground = place.ground
    rows, cols = np.nonzero(ground.free | ground.structure)
    col, row = ((np.array(xy) - ground.origin) / ground.cell).astype(int)
    return row - rows.min(), col - cols.min()


def cell(known, xy):
    return tuple(known.cells(np.array(xy)))


def test_the_looks_of_a_record_show_the_floor_again(rooms):
    known = search_space.explored_floor(rooms, np.array(poses()), CAMERA)
    for xy in [(1.0, 3.0), (4.0, 4.0), (2.0, 5.0)]:
        assert known.state[cell(known, xy)] == FLOOR
        assert known.miss_cost[cell(known, xy)] < 0.1
    assert CONTACT in known.state
    row, col = cell(known, (7.5, 3.0))
    assert not known.inside(np.array([row, col])) or known.state[row, col] == UNKNOWN


def test_heights_are_above_the_floor_wherever_that_is():
    """The same rooms two metres higher show the same."""

    def lifted(up):
        lift = np.array([0, 0, up])
        things = [*shell(5.0, 6.0), thing("chair", (1.0, 1.0, 0), (1.5, 1.5, 0.9))]
        place = place_of([thing(each.category, each.low + lift, each.high + lift) for each in things])
        return search_space.explored_floor(place, np.array(poses(CAMERA.height + up)), CAMERA)

    low, high = lifted(0.0), lifted(2.0)
    assert (low.state == high.state).mean() > 0.99
    assert (high.state == FLOOR).sum() > 500


def test_a_search_is_shaded_where_it_looked_and_nowhere_else(rooms):
    plain, svg = drawn(rooms, record_of()), drawn(rooms, record_of(HALF))
    before, after = pixels(plain), pixels(svg)
    assert before.shape == after.shape
    red, _, blue, cover = after[at(rooms, (1.0, 3.0))]
    assert before[at(rooms, (1.0, 3.0))][3] == 0
    assert cover > 60
    assert blue > red
    unseen = after[:, at(rooms, (5.3, 3.0))[1] :]
    assert (unseen == before[:, -unseen.shape[1] :]).all()
    walls = rooms.ground.structure
    rows, cols = np.nonzero(rooms.ground.free | walls)
    walls = walls[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    assert (after[walls] == before[walls]).all()


def test_the_way_is_dashed_where_the_body_searched(rooms):
    plain, svg = drawn(rooms, record_of()), drawn(rooms, record_of(HALF))
    assert "dasharray" not in plain
    assert svg.count("dasharray") == 1
    assert drawn(rooms, record_of([False] * STEPS)).count("dasharray") == 0
    to_and_fro = drawn(rooms, record_of([True, False] * (STEPS // 2)))
    assert to_and_fro.count("dasharray") == STEPS // 2


def test_what_is_shaded_and_dashed_is_said(rooms):
    said = re.search('aria-label="([^"]*)"', drawn(rooms, record_of(HALF)))[1]
    assert "eagor searched in 4 of its steps, whose line is dashed" in said
    share = int(re.search(r"its looks showed (\d+) % of the free floor", said)[1])
    assert 80 < share <= 100  # only this room is free ground
    caption = replay.floor_map(rooms, record_of(HALF), [], CAMERA)[1]
    assert "Dashed: eagor searched; solid: it went to where it believed the thing." in caption
    assert "stronger where they would have found it" in caption


def test_what_nobody_calls_a_floor_is_shown_as_well(rooms):
    things = [thing("parquet" if t.category == "floor" else t.category, t.low, t.high) for t in shell(9.0, 6.0)]
    bare = place_of([*things, WALL, thing("chair", (1.0, 1.0, 0), (1.5, 1.5, 0.9))])
    ways = [search_space.explored_floor(place, np.array(poses()), CAMERA) for place in (rooms, bare)]
    assert np.mean(ways[0].state != ways[1].state) < 0.02  # the lowest of a wall lies as high as the floor, too


@pytest.mark.parametrize("policy", ["follow", "search"])
def test_a_report_says_what_each_map_of_a_search_shows(rooms, tmp_path, policy):
    records = [r for r in runs.navigation(apartments=3, each=1, methods=("vmf", "eagor")) if r["status"] == "ok"]
    for record in records:
        record["episode"]["scene_hash"] = rooms.scene.hash
        for entry in record["methods"].values():
            trace = entry["trace"]
            trace["pose"] = (poses() * 10)[: len(trace["pose"])]
            if policy == "search":
                trace["searching"] = [k % 3 > 0 for k in range(len(trace["pose"]))]
    folder = runs.write_run(tmp_path, records)
    text = write_report(folder, lambda *which: rooms).read_text()
    assert "No pictures" not in text
    maps = text.count("From above; numbers")
    assert maps >= 2
    assert text.count("Dashed: eagor searched") == maps * (policy == "search")
