"""What must hold of OSR-Bench's labels, scores, geometry and samples."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from osr_data import direction_label, grid_of
from strategies import at_most

from eagor import sphere
from eagor.errors import FormatError
from eagor.evidence import Evidence
from eagor.evidence.shapes import MIN_SPREAD
from eagor.grids import ErpGrid
from eagor.lab.tasks import osr
from eagor.lab.tasks.osr import COUNTING, MAP, SIZE, geometry, score, score_map, swapped, tags
from eagor.lab.tasks.osr.geometry import MARGIN, Detection, direction_between, layout_from, place

CELLS = st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)).map(list), min_size=1, max_size=3)
LAYOUTS = st.fixed_dictionaries({"a": CELLS.map(lambda cells: cells[:1]), "b": CELLS, "c": CELLS})
HEIGHT = 1.5


# --- labels ---


@given(LAYOUTS)
def test_a_mirrored_layout_exchanges_left_and_right(layout: dict[str, list[list[int]]]) -> None:
    # Among equally near cells the smallest angle decides, and a mirror changes angles.
    assume("tied" not in tags(layout, ("a", "b", "c"), ""))
    other = {name: [[row, SIZE - 1 - column] for row, column in where] for name, where in layout.items()}
    assert direction_label(other, "a", "b", "c") == swapped(direction_label(layout, "a", "b", "c"))


def turned(layout: dict[str, list[list[int]]], quarters: int) -> dict[str, list[list[int]]]:
    """The layout turned clockwise by this many quarters."""
    for _ in range(quarters):
        layout = osr.turned(layout)
    return layout


# --- scores ---


def test_a_skill_or_a_count_that_is_none_is_an_error() -> None:
    with pytest.raises(FormatError, match="known are"):
        score("guessing", "1", "1")
    with pytest.raises(FormatError, match="whole number"):
        score(COUNTING, "many", "1")


@given(LAYOUTS, st.integers(0, 3))
def test_the_true_map_scores_one_however_it_is_turned(layout: dict[str, list[list[int]]], quarters: int) -> None:
    grid = grid_of(layout)
    said = turned(layout, quarters)
    reply = json.dumps({name: [[column, row] for row, column in where] for name, where in said.items()})
    found = score_map(grid, f"Here it is:\n```json\n{reply}\n```")
    assert (found["overall"]["f1"], found["overall"]["chair_i"]) == (1.0, 0.0)
    assert score(MAP, grid, reply) == 1.0


NAMED = st.dictionaries(st.sampled_from("abcde"), CELLS, min_size=1, max_size=4)


@at_most(60)
@given(NAMED, NAMED)
def test_the_published_f1_lies_between_the_least_and_the_most(layout: dict, said: dict) -> None:
    reply = json.dumps({name: [[column, row] for row, column in where] for name, where in said.items()})
    found = score_map(grid_of(layout), reply)
    there, first = osr.layout_of(grid_of(layout)), osr.layout_of(grid_of(said))
    # As published: the totals are those at the last category that both have, in an order that depends on hash seeds.
    by_order = []
    for order in itertools.permutations(sorted({*layout} | {*said})):
        best = 0.0
        for quarters in range(4):
            mine, right, named, true, f1 = turned(first, quarters), 0, 0, 0, 0.0
            for name in order:
                named, true = named + len(mine.get(name, ())), true + len(there.get(name, ()))
                if name in there and name in mine:
                    right += matched(there[name], mine[name])
                    f1 = 2 * right / (named + true)
            best = max(best, f1)
        by_order.append(best)
    overall = found["overall"]
    assert overall["f1"] == pytest.approx(min(by_order))
    assert found["most"] == pytest.approx(max(by_order))
    assert (overall["tp"] + overall["fp"], overall["tp"] + overall["fn"]) in (
        (sum(map(len, said.values())), sum(map(len, layout.values()))),
        (0, 0),  # nothing in common: as published, nothing is counted
    )
    for key in ("tp", "fp", "fn"):
        assert sum(each[key] for each in found["per_class"].values()) == overall[key]


def matched(true: list, named: list) -> int:
    """Pairs at most two cells apart in the pairing with the smallest sum of distances."""
    short, long = sorted((true, named), key=len)
    ways = [list(zip(short, chosen, strict=True)) for chosen in itertools.permutations(long, len(short))]
    away = [[math.dist(a, b) for a, b in way] for way in ways]
    least = min(map(sum, away))
    (found, *others) = {sum(d <= 2 for d in way) for way in away if sum(way) <= least + 1e-12}
    assume(not others)  # of equally short pairings any may be taken
    return found


@pytest.mark.parametrize("reply", ["", "no map", "}{", '{"a": 3}', '{"a": [[1]]}', '{"a": [[0.5, 1]]}', "{]}"])
def test_a_reply_without_a_map_scores_nothing(reply: str) -> None:
    assert osr.read_map(reply) is None
    assert score_map(grid_of({"a": [[1, 1]]}), reply)["overall"]["f1"] == 0


# --- geometry ---


@given(st.floats(0.3, 15), st.floats(0.5, 3))
def test_a_foot_tells_the_range(away: float, height: float) -> None:
    assert geometry.floor_range(-math.atan2(height, away), height) == pytest.approx(away)
    assert geometry.floor_range(0.01, height) is None


@given(st.floats(1, 6), st.floats(-3, 3), st.floats(0.05, 0.4))
def test_the_height_of_the_camera_scales_the_room_and_changes_no_answer(
    away: float, azimuth: float, half: float
) -> None:
    things = [
        Detection("p", azimuth, -0.3, bottom=-math.atan2(HEIGHT, away), half_width=half),
        Detection("o", azimuth + 1, -0.3, bottom=-0.4, half_width=half),
        Detection("q", azimuth - 2, -0.3, bottom=-0.3, half_width=half),
    ]
    answers = {
        direction_between(P.xy, [O.xy], [Q.xy]) for P, O, Q in (place(things, height) for height in (0.01, 0.02))
    }  # so low that nothing is deeper than its outline says
    assert len(answers) == 1


def test_what_hangs_is_put_behind_what_stands() -> None:
    standing = [Detection("x", azimuth, -0.3, bottom=-0.5) for azimuth in (0.785, 2.356, -0.785, -2.356)]
    hanging = Detection("window", 0.4, 0.1, contact=False)
    *others, window = place([*standing, hanging], HEIGHT)
    assert window.range_from == "beyond"
    assert window.xy[0] == pytest.approx(others[0].xy[0] + MARGIN, abs=0.01)
    assert place([hanging], HEIGHT)[0].range_from == "guess"


@given(st.floats(0.5, 4), st.floats(0.5, 4), st.floats(-1, 1), st.floats(-3, 3))
def test_things_in_the_corners_tell_the_walls(x: float, y: float, share: float, turn: float) -> None:
    corners = [(x, y), (-x, y), (-x, -y), (x, -y)]
    known = [(math.atan2(b, a) + turn, math.hypot(a, b)) for a, b in corners]

    def walls_around(known: list[tuple[float, float]]) -> Callable[[float], float] | None:
        return geometry.walls_around([(away * math.cos(azimuth), away * math.sin(azimuth)) for azimuth, away in known])

    found = walls_around(known)
    assert found is not None
    azimuth = share * math.pi
    wanted = min((x + MARGIN) / max(abs(math.cos(azimuth)), 1e-9), (y + MARGIN) / max(abs(math.sin(azimuth)), 1e-9))
    assert found(azimuth + turn) == pytest.approx(wanted)
    assert walls_around(known[:2]) is None
    assert walls_around([(0.1, 2.0), (0.2, 2.5), (0.3, 2.0)]) is None  # all on one side


def test_a_layout_has_square_cells_and_the_side_that_is_asked_for() -> None:
    found = layout_from({"far": [(4.0, 0.0)], "left": [(0.0, 1.0)], "right": [(0.0, -1.0)]})
    assert found == {"far": [[0, 2]], "left": [[SIZE - 1, 0]], "right": [[SIZE - 1, 5]]}
    assert layout_from({}) == {}


# --- what is seen ---


def test_the_box_is_read_back_from_its_evidence() -> None:
    grid = ErpGrid(512, 1024)
    box = np.array([[460.0, 240.0, 560.0, 300.0]])
    evidence = Evidence.from_boxes(box, grid)
    (found,) = geometry.detections_in(evidence, "sofa")
    degrees = 180 / 512
    assert math.degrees(found.azimuth) == pytest.approx((512 - 510) * degrees, abs=1.5)
    assert math.degrees(found.half_width) == pytest.approx(50 * degrees, abs=2)
    assert found.bottom is not None
    assert math.degrees(found.bottom) == pytest.approx((256 - 300) * degrees, abs=2.5)
    assert found.contact
    across = geometry.extent(evidence, sphere.direction(found.azimuth, found.elevation))
    assert across is not None
    assert across[0] > across[1] > MIN_SPREAD


def test_what_is_not_there_is_not_sighted_and_two_are_two() -> None:
    grid = ErpGrid(512, 1024)
    assert geometry.detections_in(Evidence.from_boxes(np.zeros((0, 4)), grid), "sofa") == []
    boxes = np.array([[100.0, 260.0, 160.0, 330.0], [700.0, 260.0, 760.0, 330.0]])
    assert len(geometry.detections_in(Evidence.from_boxes(boxes, grid), "chair")) == 2
