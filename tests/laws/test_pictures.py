"""Pictures and texts of what is believed show that, and nothing else."""

import base64
import io
import math
import re

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

import eagor
from eagor import baselines
from eagor._values import where, wide
from eagor.drawing import draw_belief, draw_strip, still
from eagor.drawing.heat import heat_of
from eagor.drawing.marks import backdrop
from eagor.evidence import Evidence
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.sphere import angular_distance, direction, world_R_body
from eagor.tracking.config import TrackerConfig
from eagor.tracking.tracker import DirectionTracker

PANORAMA = np.full((32, 64, 3), 90, dtype=np.uint8)
AHEAD = ((40, 10),)


def followed(*looks, model=None, pose=None):
    """The estimate after looks, each a list of places (azimuth, elevation in degrees, world axes)."""
    tracker = DirectionTracker()
    turned = np.eye(3) if pose is None else pose
    tracker.add_pose(0.0, turned)
    for step, places in enumerate(looks):
        points = np.reshape([direction(*np.radians(place)) @ turned for place in places], (-1, 3))
        tracker.observe(Evidence.from_points(points, detector=model, stamp=0.5 * step))
    return tracker.estimate(0.5 * max(len(looks) - 1, 0))


def painted(belief, **how):
    """The axes on which a belief is painted."""
    axes = Figure(figsize=(12, 6)).add_axes((0, 0, 1, 1))
    still.paint_belief(axes, PANORAMA, belief, **how)
    return axes


def heat(axes):
    """How far the heat changes the picture ``(H, W)``; None where it does not."""
    (shown,) = (np.asarray(image.get_array()).astype(int) for image in axes.get_images())
    changed = np.abs(shown - backdrop(PANORAMA, None, *shown.shape[1::-1])).sum(axis=-1)
    return changed if changed.any() else None


def labels(axes):
    return axes.get_legend_handles_labels()[1]


def notes(axes):
    return [text.get_text() for text in axes.texts if text.get_text()]


def borders(axes):
    return [found for found in axes.collections if isinstance(found, LineCollection)]


@pytest.mark.parametrize("pose", [np.eye(3), world_R_body(2.0, 0.3, -0.4)], ids=["upright", "turned"])
def test_the_heat_is_strongest_where_the_answer_is(pose):
    estimate = followed(AHEAD, AHEAD, AHEAD, ((-100, -30),), AHEAD, pose=pose)
    axes = painted(estimate)
    strength = heat(axes)
    hottest = PatchGrid(*strength.shape).directions[strength >= 0.99 * strength.max()]
    assert np.degrees(angular_distance(hottest, estimate.direction)).max() < 5
    assert np.degrees(angular_distance(hottest, estimate.direction)).min() < 0.5
    assert {"estimate", "90 % region", "candidate directions"} <= set(labels(axes))


def test_the_border_is_that_of_the_region_of_the_estimate():
    estimate = followed(*[AHEAD] * 4)
    border, area = estimate.region(0.9)
    below, above = borders(painted(estimate))
    assert len(below.get_segments()) == len(above.get_segments()) == 1
    points = np.concatenate(above.get_segments())
    places = direction(np.radians(points[:, 0]), np.radians(points[:, 1]))
    assert np.abs(estimate.log_density(places) - border).max() < 0.3
    assert np.array_equal(points, np.concatenate(heat_of(estimate).border))
    cells = PatchGrid(360, 720)
    assert float(cells.weights[estimate.log_density(cells.directions) >= border].sum()) == pytest.approx(area, rel=0.1)


def test_a_region_over_half_of_the_sphere_is_not_drawn_and_a_note_says_so():
    estimate = followed(AHEAD, model=eagor.DetectorModel(0.3, 5.0))
    assert estimate.region(0.9)[1] > 2 * math.pi
    axes = painted(estimate)
    assert not borders(axes)
    assert notes(axes) == ["90 % region not drawn: over half of the sphere"]
    assert "90 % region" not in labels(axes)
    assert heat(axes) is not None


def test_a_border_that_only_ripples_decide_is_not_drawn():
    """One look: 85 % lie about it, and the rest of the 90 % are anywhere, where all directions are alike."""
    estimate = followed(AHEAD, model=eagor.DetectorModel(0.7, 0.35))
    assert estimate.region(0.9)[1] < 2 * math.pi
    axes = painted(estimate)
    assert not borders(axes)
    assert notes(axes) == ["90 % region not drawn: its border runs where all is alike"]


def test_the_legend_of_several_panels_contradicts_none_of_them(monkeypatch):
    """Only what is drawn somewhere is in it; what is missing stands in its own panel."""
    sheets = []
    monkeypatch.setattr(still, "image", lambda sheet: sheets.append(sheet) or sheet)
    sharp, wide = followed(*[AHEAD] * 4), followed(AHEAD, model=eagor.DetectorModel(0.3, 5.0))
    draw_strip([{"panorama": PANORAMA, "belief": one} for one in (sharp, wide, followed())])
    (sheet,) = sheets
    (legend,) = sheet.legends
    assert {text.get_text() for text in legend.get_texts()} == {"estimate", "90 % region", "candidate directions"}
    said = [notes(axes) for axes in sheet.axes]
    assert said == [[], ["90 % region not drawn: over half of the sphere"], ["direction not known"]]


@pytest.mark.parametrize("looks", [(), ((),)], ids=["no look", "an empty look"])
def test_nothing_known_is_no_arrow_and_no_heat(looks):
    estimate = followed(*looks)
    assert estimate.direction is None
    axes = painted(estimate)
    assert heat(axes) is None
    assert labels(axes) == []
    assert [text.get_text() for text in axes.texts] == ["direction not known"]  # and no arrow
    assert draw_belief(PANORAMA, estimate, title="nothing").size == (1200, 714)


def test_no_arrow_where_the_cone_is_wider_than_half_of_the_sphere():
    sharp, wide = followed(*[AHEAD] * 4), followed(AHEAD, model=eagor.DetectorModel(0.3, 5.0))
    assert sharp.credible_angle < math.pi / 2 < wide.credible_angle
    arrows = [sum(not text.get_text() for text in painted(one).texts) for one in (sharp, wide)]
    assert (arrows[0] > 0, arrows[1]) == (True, 0)
    assert "estimate" in labels(painted(wide)), "the answer itself is marked"


def test_others_truth_and_beliefs_are_drawn_too():
    estimate, belief = followed(AHEAD, AHEAD), eagor.Belief.uniform(15)
    ahead = np.array([1.0, 0.0, 0.0])
    axes = painted(estimate, truth=ahead, others={"centroid": ahead, "silent": None}, modes=())
    assert {"truth", "centroid"} <= set(labels(axes))
    assert not {"silent", "candidate directions"} & set(labels(axes))
    assert heat(painted(belief)) is None
    sharp = belief.update(Evidence.from_points([[0.0, 1.0, 0.0]]))
    assert heat(painted(sharp)) is not None
    assert "estimate" not in labels(painted(sharp))
    strip = draw_strip([{"panorama": PANORAMA, "belief": one, "title": "x"} for one in (estimate, sharp, belief)])
    assert strip.size[0] == 1400


# --- texts and thumbnails --------------------------------------------------------------------------------------------


def things():
    rng = np.random.default_rng(0)
    look = Evidence.from_points([[0.0, 1.0, 0.0]], stamp=1.0)
    view = PerspectiveGrid(60, 80, 1.5)
    yield "belief", eagor.Belief.uniform(15)
    yield "sharp", eagor.Belief.uniform(15).update(look)
    yield "batch", eagor.Belief.uniform(15, (4, 2))
    yield "ranged", eagor.RangedBelief.uniform(15, eagor.log_ranges()).update(look)
    yield "detections", look
    yield "map", Evidence.from_response(rng.random((180, 360)), PatchGrid(180, 360))
    yield "maps", Evidence.from_response(rng.random((3, 18, 36)), PatchGrid(18, 36))
    yield "view", Evidence.from_points([[1.0, 0.0, 0.0]], grid=view)
    covered = np.ones((60, 80), dtype=bool)
    covered[:20] = False
    yield "part", Evidence.from_response(rng.random((60, 80)), view, coverage=covered)
    yield "estimate", followed(AHEAD, AHEAD, ((-100, -30),))
    yield "not known", followed()
    yield "broken", eagor.Belief(np.full(16, np.nan))


def plain():
    rng = np.random.default_rng(0)
    for made in (baselines.Centroid(), baselines.CircularCentroid(), baselines.GridFilter(),
                 baselines.HistogramFilter(), baselines.ParticleFilter.uniform(2000, rng),
                 baselines.VonMisesFisherFilter(), baselines.BestDetection(), baselines.LastDetection()):  # fmt: skip
        yield type(made).__name__, made
        yield f"{type(made).__name__} used", made.update(Evidence.from_points([[0.0, 1.0, 0.0]]))
    yield "config", TrackerConfig()
    yield "paper", TrackerConfig.paper()
    yield "told", TrackerConfig(floor_height=0.0, detector=eagor.DetectorModel(0.7, 0.2), ranges=tuple(range(1, 31)))
    yield "calibration", eagor.Calibration()
    yield "detector", eagor.DetectorModel(clutter=np.ones((64, 128)))
    yield "motion", eagor.MotionModel()
    yield "tracker", DirectionTracker()
    yield "mode", followed(AHEAD, AHEAD).modes[0]
    yield "region", eagor.Belief.uniform(7).credible_region(0.9)
    for grid in (eagor.ErpGrid(8, 16), PatchGrid(8, 16), PerspectiveGrid(8, 8, 1.0, world_R_body(0.3))):
        yield type(grid).__name__, grid
    yield "FisheyeGrid", eagor.FisheyeGrid(8, 1.0, world_R_body(0.3))
    yield "harmonics", eagor.RealHarmonics(15)


@pytest.mark.parametrize(("name", "made"), [*things(), *plain()], ids=lambda one: one if isinstance(one, str) else "")
def test_texts_are_a_line_or_two(name, made):
    text = repr(made)
    assert text.startswith(type(made).__name__)
    assert len(text) < 300
    assert text.count("\n") < 2


def test_texts_say_what_is_not_the_default():
    assert repr(TrackerConfig()) == "TrackerConfig()"
    assert repr(TrackerConfig(degree=31, floor_height=0.5)) == "TrackerConfig(degree=31, floor_height=0.5)"
    assert "ranges=(1, 2, ..., 30)" in repr(TrackerConfig(ranges=tuple(range(1, 31))))
    assert repr(eagor.Belief.uniform(7)) == "Belief(degree 7, nothing known)"
    estimate = followed(AHEAD, AHEAD)
    assert "40° left, 10° up" in repr(estimate)
    assert repr(followed(())).startswith("Estimate(t=0 s, direction not known, presence 0.")


@pytest.mark.parametrize(("name", "made"), [*things()], ids=lambda one: one if isinstance(one, str) else "")
def test_pictures_in_notebooks_are_small_and_can_be_read(name, made):
    page = made._repr_html_()
    assert len(page) < 30_000
    assert re.sub(r"[<>&'\"]", "", repr(made)[:20]) in page
    data = re.search(r"data:image/png;base64,([^\"]+)", page)
    if data is None:
        assert name in ("batch", "broken")
        return
    with Image.open(io.BytesIO(base64.b64decode(data[1]))) as image:
        assert image.size == (240, 120)


def test_what_was_not_looked_at_is_grey_and_what_speaks_for_it_red():
    from eagor import thumbnail

    look = dict(things())["view"]
    data = re.search(r"base64,([^\"]+)", look._repr_html_())
    with Image.open(io.BytesIO(base64.b64decode(data[1]))) as image:
        shown = np.asarray(image.convert("RGB")).astype(int)
    assert np.abs(shown[60, 10] - np.array(thumbnail.UNSEEN)).max() < 8
    red, green, blue = shown[58, 118]  # beside the lines
    assert red > green + 60
    assert red > blue + 60


def test_words_of_an_answer_say_up_or_down_small_cones_and_several_candidates():
    assert (where(0.7, -0.37), where(-0.7, 0.1)) == ("40° left, 21° down", "40° right, 6° up")
    assert [wide(math.radians(angle)) for angle in (137.2, 5.4, 0.42, 1e-6)] == ["137°", "5°", "0.4°", "0.1°"]
    tracker = DirectionTracker()
    for k in range(4):
        tracker.observe(Evidence.from_points([[1, 0, 0], [0, 1, -0.4]], stamp=float(k)))
    two = tracker.estimate(3.0)
    assert two.status == "ambiguous"
    assert math.degrees(two.credible_angle) > 60
    assert re.search(r"2 candidates hold 9\d %", repr(two))
    assert "within 1" not in repr(two).split("candidates")[0]
    one = Evidence.from_boxes([[500, 240, 540, 280]], PerspectiveGrid(512, 1024, 1.0), scores=[0.9])
    assert repr(one.detections) == "Detections(1 in 1 view)"
