"""What a picture of one step shows is what is answered, and a still picture shows the same."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from tracks_drawn import PANORAMA, turning

import eagor
from eagor.drawing import panorama, step, still, timeline
from eagor.drawing.panorama import OURS
from eagor.drawing.step import ScenePainter, StepPainter, draw_step
from eagor.errors import EagorError, TimeError
from eagor.sphere import azimuth_elevation, direction

CYAN = np.array([int(OURS[at : at + 2], 16) for at in (1, 3, 5)])


def place_of(where, painter):
    """Column and row of a direction in a step's picture."""
    azimuth, elevation = azimuth_elevation(where)
    x = (0.5 - float(azimuth) / math.tau) * painter.width
    return x, painter.head + (0.5 - float(elevation) / math.pi) * painter.rows


def cyan(picture):
    """Columns and rows of the pixels in the colour of the answer ``(n, 2)``."""
    return np.argwhere(np.abs(picture.astype(int) - CYAN).max(axis=-1) < 12)[:, ::-1]


@pytest.mark.parametrize("width", [640, 1280])
@pytest.mark.parametrize(("azimuth", "elevation"), [(40, 10), (-130, -50), (100, 75)])
def test_the_marker_is_where_the_answer_is(width, azimuth, elevation):
    (estimate,) = turning(1, azimuth, elevation)
    painter = StepPainter(width)
    picture = painter.paint(PANORAMA, estimate, query="door")
    assert picture.shape == (painter.height, painter.width, 3)
    x, y = place_of(estimate.direction, painter)
    found = cyan(picture)
    disc = found[np.hypot(*(found - (x - 0.5, y - 0.5)).T) < 0.0055 * width]
    assert len(disc) > 2e-5 * width**2
    assert np.abs(disc.mean(axis=0) - (x - 0.5, y - 0.5)).max() < 1


def test_on_the_seam_the_marker_and_the_heat_are_on_both_edges():
    estimate = turning(2, azimuth=179.5, elevation=0, turn=0)[-1]
    painter = StepPainter(1280)
    picture = painter.paint(PANORAMA, estimate)
    rows = picture[painter.head : painter.head + painter.rows]
    middle = painter.rows // 2 + 1
    assert (np.abs(rows[middle, [0, -1]].astype(int) - CYAN).max(axis=-1) < 40).all()
    heat = panorama.heat_of(estimate)
    strength = heat.rgba[len(heat.rgba) // 2, :, 3].astype(int)
    assert min(strength[0], strength[-1]) > 200
    assert strength[len(strength) // 2] < 40
    alone = panorama.backdrop(PANORAMA, None, 640, 320).astype(int)
    changed = np.abs(panorama.backdrop(PANORAMA, heat, 640, 320) - alone).sum(axis=-1)[160]
    assert min(changed[0], changed[-1]) > 100


def test_the_border_is_that_of_the_still_picture():
    estimate = turning(3)[-1]
    painter = StepPainter(640)
    painter.paint(PANORAMA, estimate)
    drawn = Figure(figsize=(12, 6)).add_axes((0, 0, 1, 1))
    still.paint_belief(drawn, PANORAMA, estimate)
    lines = [
        [line for found in axes.collections if isinstance(found, LineCollection) for line in found.get_segments()]
        for axes in (drawn, painter._scene.axes)
    ]
    assert len(lines[0]) == 2
    assert all(np.array_equal(a, b) for a, b in zip(*lines, strict=True))


@pytest.mark.parametrize("looks", [1, 2, 6, 30])
def test_the_quick_density_is_the_exact_one_near_and_above_the_border(looks):
    estimate = turning(looks, azimuth=175)[-1]
    level, area = estimate.region(0.9)
    grid = panorama._cells(area)
    exact = estimate.log_density(grid.directions)
    quick = panorama._density(estimate, grid, level)
    near = exact > level - 2
    assert near.any()
    assert np.abs(quick - exact)[near].max() < 1e-3
    assert np.exp(quick - exact.max())[~near].max(initial=0) < math.exp(level - 1 - exact.max())


def test_a_picture_of_nothing_known_has_no_arrow_and_says_so():
    estimate = eagor.DirectionTracker().estimate(0.0)
    painter = StepPainter(640)
    picture = painter.paint(PANORAMA, estimate, query="door")
    assert not len(cyan(picture[painter.head : painter.head + painter.rows]))
    assert painter._words["answer"].get_text() == "direction not known"
    assert painter._words["status"].get_text() == "searching"


def test_the_words_are_those_of_the_answer():
    estimate = turning(2)[-1]
    painter = StepPainter(640)
    painter.paint(PANORAMA, estimate, query="a door with $x$ and <b>", stamp=12.5)
    said = {name: text.get_text() for name, text in painter._words.items()}
    assert said["query"] == "“a door with $x$ and <b>”"
    assert said["answer"] == "20 degrees to the left, 10 degrees up"
    assert said["status"] == estimate.status
    assert f"presence {estimate.presence:.2f}" in said["rest"]
    assert "12.50 s" in said["rest"]
    painter.paint(PANORAMA, estimate, query="word " * 30, stamp=13)
    assert len(painter._words["query"].get_text()) <= step.LONGEST_QUERY + 2


def test_a_frame_that_cannot_be_read_shows_the_belief_and_the_reason():
    first, second = turning(2)
    painter = StepPainter(640)
    painter.paint(PANORAMA, first)
    picture = painter.paint(None, second, problem="0001.png is not a picture")
    assert "left out: 0001.png is not a picture" in [text.get_text() for text in painter._scene.axes.texts]
    assert len(cyan(picture)) > 20
    assert painter.line.last.problem == "0001.png is not a picture"


def test_the_cursor_is_at_now_and_the_future_is_empty():
    painter = StepPainter(1280, span=10)
    for moment in turning(9):
        picture = painter.paint(PANORAMA, moment)
    x0, y0, wide, high = painter._places[2]
    row = round((1 - y0 - 0.93 * high) * painter.height)
    x = painter.width * (x0 + wide * painter.line.now / 10)
    white = np.flatnonzero((picture[row] > 240).all(axis=-1))
    assert abs(white.mean() + 0.5 - x) < 1
    x0, y0, wide, high = painter._places[0]
    status = picture[round((1 - y0 - high / 2) * painter.height)].astype(int)
    colour = np.array([int(timeline.COLOURS["tracking"][at : at + 2], 16) for at in (1, 3, 5)])
    shown = np.flatnonzero(np.abs(status - colour).max(axis=-1) < 8)
    assert shown.max() < painter.width * (x0 + wide * painter.line.end / 10) + 1
    assert shown.max() > x + 3


@pytest.mark.parametrize("query", ["$\\frac{$", "ドア", "باب", "a\nb", "\x00"])
def test_any_query_can_be_drawn(query):
    draw_step(PANORAMA, turning(1)[0], query=query, width=320, before=())


def test_a_still_picture_has_the_time_line_of_the_steps_before():
    estimates = turning(5)
    painter = StepPainter(640, span=4)
    for estimate in estimates:
        picture = painter.paint(PANORAMA, estimate, query="door")
    before = [timeline.Moment.of(estimate) for estimate in estimates[:-1]]
    still = draw_step(PANORAMA, estimates[-1], query="door", before=before, span=4, width=640)
    assert np.array_equal(np.asarray(still), picture)


def test_what_cannot_be_drawn_is_refused():
    estimate = turning(1)[0]
    with pytest.raises(EagorError, match=r"shape \(4, 4\); wanted \(H, W, 3\)"):
        StepPainter(320).paint(np.zeros((4, 4)), estimate)
    for width in (0, 319, 100_000, 640.5, True):
        with pytest.raises(EagorError, match="wanted a whole number from 320 to 3840"):
            StepPainter(width)
    with pytest.raises(EagorError, match="wanted a whole number"):
        ScenePainter(5)
    painter = StepPainter(320)
    painter.paint(PANORAMA, estimate, stamp=1.0)
    with pytest.raises(TimeError, match="wanted frames in order of time"):
        painter.paint(PANORAMA, estimate, stamp=1.0)
    with pytest.raises(TimeError, match="wanted a finite time"):
        painter.paint(PANORAMA, estimate, stamp=math.nan)
    with pytest.raises(TimeError, match="wanted the length of the clip"):
        StepPainter(320, span=-1)


# --- the time line ---------------------------------------------------------------------------------------------------


def moment(stamp, azimuth=0.0, cone=0.2, elevation=0.0, status="tracking", presence=0.9):
    return timeline.Moment(stamp, status, presence, azimuth, elevation, cone)


@given(st.floats(-1.5, 1.5), st.floats(0.01, 1.5))
def test_the_band_is_the_range_of_azimuths_of_the_cone(elevation, cone):
    around = np.linspace(0, math.tau, 2001)
    ahead = np.array(direction(0.0, elevation))
    up = np.array([-math.sin(elevation), 0, math.cos(elevation)])
    side = np.array([0.0, 1.0, 0.0])
    rim = math.cos(cone) * ahead + math.sin(cone) * (np.cos(around)[:, None] * up + np.sin(around)[:, None] * side)
    widest = np.abs(azimuth_elevation(rim)[0]).max()
    half = moment(0, elevation=elevation, cone=cone).half_width
    if cone + abs(elevation) >= math.pi / 2:
        assert half == math.pi
    elif cone + abs(elevation) < 1.5:
        assert half == pytest.approx(widest, abs=0.01)


def test_bands_are_cut_at_the_seam():
    line = timeline.TimeLine()
    line.add(moment(10.0, azimuth=math.radians(175), cone=math.radians(10)))
    line.add(moment(11.0, azimuth=math.radians(-90), cone=math.radians(10)))
    line.add(moment(12.0, azimuth=None, cone=None))
    bands = np.round(line.bands(), 6)
    assert bands.tolist() == [[0, 1, 165, 180], [0, 1, -180, -175], [1, 2, -100, -80]]


def test_stretches_hold_all_changes_however_many_moments_there_are():
    line = timeline.TimeLine()
    for index in range(3 * timeline.MOST):
        line.add(moment(0.1 * index, status="ambiguous" if index == 4001 else "tracking"))
    assert [(round(b, 3), round(e, 3), s) for b, e, s in line.stretches()[:2]] == [
        (0, 400.1, "tracking"), (400.1, 400.2, "ambiguous"),
    ]  # fmt: skip
    answers = line.answers()
    assert len(answers) <= timeline.MOST
    assert np.all(answers[1:, 0] == answers[:-1, 1])
    assert answers[-1, 1] == line.end


def test_a_time_line_grows_in_round_steps_and_ticks_are_round():
    line = timeline.TimeLine()
    spans = []
    for index in range(70):
        line.add(moment(float(index)))
        spans.append(line.span)
    assert sorted(set(spans)) == [1, 2, 5, 10, 20, 50, 100]
    assert list(timeline.ticks(10)) == [0, 2, 4, 6, 8, 10]
    assert list(timeline.ticks(0.3)) == [0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3]
