"""The picture of an ordinary camera: marks are where it sees them, arrows lead there, and what it showed is kept."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import at_most

import eagor
from eagor import Evidence
from eagor.cameras import Lens
from eagor.drawing import BeliefPage, BeliefVideo, Mosaic, draw_belief, page
from eagor.drawing.heat import heat_of, reader_of_heat
from eagor.drawing.marks import OURS, UNSEEN, edge, outline_of, places
from eagor.drawing.step import StepPainter
from eagor.errors import EagorError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.sphere import angular_distance, direction, unit, world_R_body

AHEAD = np.eye(3)
CYAN = np.array([int(OURS[at : at + 2], 16) for at in (1, 3, 5)])
WIDE = PerspectiveGrid(90, 160, math.radians(70))
TALL = PerspectiveGrid(160, 90, math.radians(40), world_R_body(0.2, 0.1, 0.05))
LENS = Lens("lens", (160, 120), (110.0, 112.0), (84.0, 57.0), (-0.2, 0.05, 0.001, -0.001))
BENT = PerspectiveGrid.of_lens(LENS)


def seen(toward, pose=AHEAD, looks=4):
    """The estimate of something seen again and again in one direction of the body, which then takes a pose."""
    tracker = eagor.DirectionTracker()
    tracker.add_pose(0.0, np.eye(3))
    for index in range(looks):
        tracker.add_pose(0.1 * index, np.eye(3))
        tracker.observe(Evidence.from_points([toward], stamp=0.1 * index))
    tracker.add_pose(1.0, pose)
    return tracker.estimate(1.0)


def picture(grid, colour=(90, 90, 90)):
    return np.full((*grid.shape, 3), colour, dtype=np.uint8)


@pytest.mark.parametrize("grid", [WIDE, TALL, BENT], ids=["wide", "tall and tilted", "distorted"])
def test_the_mark_is_where_the_camera_sees_the_answer(grid):
    toward = grid.unproject(np.array(0.7 * grid.width), np.array(0.4 * grid.height))
    estimate = seen(toward)
    painter = StepPainter(1280)
    drawn = painter.paint(picture(grid), estimate, grid=grid)
    (left, top, width, height), _ = painter.boxes(grid)
    x, y, inside = grid.project(estimate.direction)
    assert inside
    at = np.array([left + x / grid.width * width, top + y / grid.height * height]) - 0.5
    cyan = np.argwhere(np.abs(drawn.astype(int) - CYAN).max(axis=-1) < 12)[:, ::-1]
    disc = cyan[np.hypot(*(cyan - at).T) < 7]
    assert len(disc) > 40
    assert np.abs(disc.mean(axis=0) - at).max() < 1
    assert f"{100 * estimate.confidence:.0f} % sure" in [text.get_text() for text in painter._seen.texts]


@pytest.mark.parametrize(("width", "height"), [(640, 480), (1280, 720), (1260, 540), (360, 640), (2000, 500)])
def test_the_picture_fills_its_place_and_nothing_overlaps(width, height):
    """It is at the top, as large as leaves a legible panorama beside it; both keep their shape."""
    grid, painter = PerspectiveGrid(height, width, math.radians(80)), StepPainter(1280)
    (left, top, wide, high), (x, y, small, low) = painter.boxes(grid)
    assert top == painter.head
    assert wide / high == pytest.approx(width / height, rel=0.01)
    assert wide > 0.8 * painter.width or high == painter.rows
    assert small // 2 == low
    assert small >= 0.16 * painter.width
    assert x >= left + wide
    assert x + small <= painter.width
    assert max(y + low, top + high) <= painter.head + painter.rows


@given(st.floats(-math.pi, math.pi), st.floats(-1.4, 1.4))
@at_most(60)
def test_the_arrow_at_the_edge_leads_along_the_great_circle(azimuth, elevation):
    where, grid = direction(np.array(azimuth), np.array(elevation)), TALL
    axis = grid.body_R_view[:, 0]
    tip, way, angle = edge(where, grid, grid.width, grid.height)
    assert angle == pytest.approx(math.degrees(angular_distance(where, axis)), abs=1e-6)
    assert 0 < tip[0] < grid.width
    assert 0 < tip[1] < grid.height
    if 1 < angle < 179:
        x, y, _ = grid.project(unit(axis + 1e-3 * unit(where - (where @ axis) * axis)))
        moved = np.array([float(x) - grid.width / 2, float(y) - grid.height / 2])
        np.testing.assert_allclose(moved / np.linalg.norm(moved), way, atol=1e-4)


def test_out_of_view_the_picture_says_how_far_and_how_sure():
    estimate = seen([1.0, 0.0, 0.0], world_R_body(math.radians(-130)))
    painter = StepPainter(1280)
    painter.paint(picture(WIDE), estimate, grid=WIDE)
    assert f"130°\n{100 * estimate.confidence:.0f} % sure" in [text.get_text() for text in painter._seen.texts]
    words = [" ".join(text.get_text().split()) for text in painter._figure.texts]
    assert words.count("behind you, to the left (130 degrees)") == 2, "above, and beside the picture"
    painter.paint(None, seen([1.0, 0.0, 0.0]).turned(1.5, np.eye(3)), problem="it is no picture")
    assert "left out: it is no picture" in [text.get_text() for text in painter._seen.texts]
    painter.paint(np.zeros((32, 64, 3), dtype=np.uint8), estimate, stamp=2.0)
    assert not painter._around.texts, "a panorama is drawn as ever"


@pytest.mark.parametrize("grid", [WIDE, TALL, BENT], ids=["wide", "tall and tilted", "distorted"])
def test_heat_and_border_are_those_of_the_panorama(grid):
    estimate = seen(grid.unproject(np.array(0.6 * grid.width), np.array(0.5 * grid.height)))
    heat = heat_of(estimate)
    x, y, _ = ErpGrid(*heat.rgba.shape[:2]).project(grid.directions)
    there = heat.rgba[y.astype(int), x.astype(int)]
    drawn = reader_of_heat(grid, *grid.shape)(heat.rgba).astype(int)
    assert np.abs(drawn - there).mean() < 2
    assert (drawn[..., 3] > 180).any()
    at = np.concatenate([places(direction(*np.radians(line).T), grid) for line in heat.border])
    at = at[np.isfinite(at[:, 0])]
    on = estimate.log_density(grid.unproject(at[:, 0] * grid.width, at[:, 1] * grid.height))
    assert np.abs(on - estimate.region(0.9)[0]).max() < 0.3
    outline = outline_of(grid)
    corners = direction(*np.radians(outline[np.isfinite(outline[:, 0])]).T)
    assert np.abs(grid.lens.project(corners)[2]).max() < 1e-6


def test_a_mosaic_keeps_what_was_shown_where_it_is_in_the_world():
    mosaic, left = Mosaic(), world_R_body(math.radians(80))
    mosaic.add(picture(WIDE, (200, 0, 0)), WIDE, np.eye(3))
    mosaic.add(picture(BENT, (0, 0, 200)), BENT, left)
    now = world_R_body(1.0, 0.3, -0.2)
    around = mosaic.seen_from(now)
    world = ErpGrid(*around.shape[:2]).directions @ now.T
    inside = (WIDE.lens.project(world)[2], BENT.lens.project(world @ left)[2])
    deep, none = 0.03, np.maximum(*inside) < -0.03
    assert (around[(inside[0] > deep) & (inside[1] < -deep)] == (200, 0, 0)).all()
    assert (around[inside[1] > deep] == (0, 0, 200)).all(), "the newer picture covers the older one"
    assert (around[none & (world[..., 0] < -0.5)] == UNSEEN).all()


def test_videos_pages_and_still_pictures_take_it(tmp_path, monkeypatch):
    """A page that leaves out pictures still remembers what they showed."""
    monkeypatch.setattr(page, "PICTURES", 2)
    poses = [world_R_body(math.radians(70 * index)) for index in range(6)]
    estimate = seen([1.0, 0.0, 0.0])
    with (
        BeliefVideo(tmp_path / "a.webp", size=320) as video,
        BeliefPage(tmp_path / "a.html", query="door") as written,
    ):
        for index, pose in enumerate(poses):
            now = estimate.turned(2.0 + index, pose)
            video.add(picture(WIDE), now, grid=WIDE)
            written.add(picture(WIDE), now, grid=WIDE)
    assert (tmp_path / "a.webp").stat().st_size > 1000
    assert np.array_equal(video.painter.mosaic.colours, written.painter.mosaic.colours)
    assert (video.painter.mosaic.colours == 90).mean() > 0.2
    mosaic = Mosaic()
    assert draw_belief(picture(WIDE), estimate, title="door", grid=WIDE, mosaic=mosaic, width=640).size == (640, 352)
    assert (mosaic.colours == 90).any()
    for wrong in (np.zeros((9, 16, 3), np.uint8), np.zeros(WIDE.shape, np.uint8)):
        with pytest.raises(EagorError, match="wanted \\(H, W, 3\\) of the grid's size"):
            draw_belief(wrong, estimate, grid=WIDE)
    with pytest.raises(EagorError, match="wanted an Estimate"):
        draw_belief(picture(WIDE), eagor.Belief.uniform(15), grid=WIDE)
