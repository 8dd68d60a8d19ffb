"""What the camera never sees: nothing is gained or lost there, and what lies outside stays as it is."""

import math

import numpy as np
import pytest
from PIL import Image
from strategies import random_directions

import eagor
from eagor.errors import ImageError
from eagor.evidence import BodyMask, Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, PatchGrid
from eagor.perception.partial import read_mask
from eagor.sphere import direction, world_R_body
from eagor.tracking.config import MotionModel, TrackerConfig

DOWN = np.array([0.0, 0.0, -1.0])
RADIUS = math.radians(30)


def nadir(rows=90):
    """A mask with a black disc of `RADIUS` about the nadir."""
    return BodyMask(ErpGrid(rows, 2 * rows).directions @ DOWN < math.cos(RADIUS))


def places(hidden, count=200):
    """Directions well inside the disc, or well outside."""
    found = random_directions(4000)
    angles = np.arccos(found @ DOWN)
    return found[angles < RADIUS - 0.05 if hidden else angles > RADIUS + 0.05][:count]


def test_the_mask_is_read_where_it_is():
    mask = nadir()
    assert not mask.at(places(hidden=True)).any()
    assert mask.at(places(hidden=False)).all()
    fine = BodyMask(np.repeat(np.repeat(mask.seen, 20, axis=0), 20, axis=1))
    assert fine.seen.shape == (512, 1024), "a mask of any size, and bounded"
    assert (fine.at(random_directions(500)) == mask.at(random_directions(500))).mean() > 0.99


@pytest.mark.parametrize("model", [DetectorModel(), DetectorModel(0.8, 0.3)])
def test_detections_outside_stay_and_those_under_it_are_gone(model):
    seen, hidden = direction(0.5, 0.1), direction(2.0, math.radians(-75))
    both = Evidence.from_points([seen, hidden], scores=[0.9, 0.8], detector=model, stamp=3.0)
    found = both.covered(nadir())
    assert found.stamp == 3.0
    assert found.detections.directions == pytest.approx(np.array([seen]))
    assert found.detections.axes == pytest.approx(both.detections.axes[:1])
    alone = Evidence.from_points([seen], scores=[0.9], detector=model)
    ratio = found.detections.ratio(places(hidden=False))
    scale = found.detections.area / (4 * math.pi)
    if model.false_alarms_per_look:
        missed = 1 - model.detection_probability
        assert ratio - missed == pytest.approx(scale * (alone.detections.ratio(places(hidden=False)) - missed))
    assert found.detections.ratio(places(hidden=True)) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(("part", "kept"), [(0.2, 0), (0.8, 1)])
def test_a_box_counts_unless_it_lies_mostly_under_the_mask(part, kept):
    grid, height = ErpGrid(512, 1024), 100
    border = 512 * (1 - math.degrees(RADIUS) / 180)
    box = [500, border - part * height, 520, border + (1 - part) * height]
    assert len(Evidence.from_boxes([box], grid).covered(nadir(512)).detections) == kept


@pytest.mark.parametrize("calibration", [Calibration(), Calibration.paper(), Calibration(spread=0.05)])
def test_a_response_map_is_zero_under_it_and_unchanged_outside(calibration):
    grid, rng = PatchGrid(60, 120), np.random.default_rng(0)
    look = Evidence.from_response(0.5 * rng.random((60, 120)).astype(np.float32), grid, calibration, 1.0)
    found = look.covered(nadir())
    hidden = nadir().share(grid) == 0
    outside = nadir().share(grid) == 1
    assert hidden.any()
    assert (np.asarray(found.log_ratio)[hidden] == 0).all()
    if not calibration.scale_to_max:
        assert (np.asarray(found.log_ratio)[outside] == np.asarray(look.log_ratio)[outside]).all()
    again = np.asarray(found.covered(nadir()).log_ratio)[outside]
    assert again == pytest.approx(np.asarray(found.log_ratio)[outside], abs=1e-6)
    assert np.isfinite(np.asarray(found.coefficients(7))).all()


@pytest.mark.parametrize("tilt", [0.0, 0.6, math.pi])
def test_the_mask_goes_with_the_body(tilt):
    """A thing under a tilted camera's own foot is believed as little, and what the camera never saw stays possible."""
    pose = world_R_body(0.4, tilt, 0.2)
    config = TrackerConfig(degree=15, target_motion=MotionModel.still())

    def tracked(*looks):
        tracker = eagor.DirectionTracker(config)
        for number, look in enumerate(looks):
            tracker.add_pose(float(number), pose)
            tracker.observe(look(float(number)))
        return tracker.estimate(float(len(looks) - 1))

    foot = tracked(*[lambda t: Evidence.from_points([DOWN], stamp=t).covered(nadir())] * 3)
    empty = tracked(*[lambda t: Evidence.from_points([], stamp=t).covered(nadir())] * 3)
    assert foot.presence == pytest.approx(empty.presence, abs=1e-6)
    assert empty.log_density(places(hidden=True)).mean() > empty.log_density(places(hidden=False)).mean() + 0.5
    thing = direction(1.0, 0.3)
    assert tracked(*[lambda t: Evidence.from_points([thing], stamp=t).covered(nadir())] * 3).direction @ thing > 0.999


def test_a_mask_from_a_file(tmp_path):
    mask = nadir(64)
    for scale in (255, 1):
        path = tmp_path / f"{scale}.png"
        Image.fromarray((mask.seen * scale).astype(np.uint8)).save(path)
        assert (read_mask(path).seen == mask.seen).all()
    soft = (
        Image.fromarray((mask.seen * 255).astype(np.uint8)).convert("RGB").resize((256, 128), Image.Resampling.BICUBIC)
    )
    soft.save(tmp_path / "soft.jpg", quality=90)
    assert (
        read_mask(tmp_path / "soft.jpg").at(random_directions(500)) == mask.at(random_directions(500))
    ).mean() > 0.97


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (np.full((64, 64), 255), "is 64 x 64; wanted a panorama twice as wide as high"),
        (np.zeros((64, 128)), "black everywhere"),
        (np.tile(np.arange(128) * 2, (64, 1)), "is grey in .* % of its pixels; wanted black and white"),
        (None, "there is no file"),
    ],
)
def test_what_is_no_mask_is_refused(tmp_path, picture, says):
    path = tmp_path / "mask.png"
    if picture is not None:
        Image.fromarray(picture.astype(np.uint8)).save(path)
    with pytest.raises(ImageError, match=rf"mask\.png.*{says}"):
        read_mask(path)


@pytest.mark.parametrize("bad", [np.ones((4, 8, 3)), np.zeros((0, 0)), np.array([["a", "b"]])])
def test_an_array_that_is_no_mask_is_refused(bad):
    with pytest.raises(ImageError, match="the mask"):
        BodyMask(bad)
