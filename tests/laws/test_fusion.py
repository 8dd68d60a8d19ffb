"""Boxes of several pictures as one set of detections."""

import itertools
import math

import numpy as np
import pytest

from eagor.errors import EagorError
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import moments_of
from eagor.grids import ErpGrid, PatchGrid, PerspectiveGrid
from eagor.perception.fusion import blobs
from eagor.perception.vlm.answers import Box
from eagor.perception.vlm.perception import Crop, InferencePlan, ModelPerception, box_detections, fuse_detections
from eagor.sphere import angular_distance, direction, world_R_body

WHOLE = PatchGrid(18, 36)


def box(azimuth, elevation, width=8, height=8, score=0.8):
    """A box in a panorama; degrees."""
    x, y = (180 - azimuth) / 360, (90 - elevation) / 180
    return Box(x - width / 720, y - height / 360, x + width / 720, y + height / 360, score)


@pytest.mark.parametrize("roll", [0.0, 0.25, 0.5])
def test_a_box_means_its_middle_whatever_the_roll(roll):
    seen = box(30, -10)
    rolled = Box((seen.x0 + roll) % 1, seen.y0, (seen.x0 + roll) % 1 + seen.x1 - seen.x0, seen.y1)
    (thing,) = box_detections([rolled], WHOLE, roll)
    assert math.degrees(float(angular_distance(thing.direction, direction(*np.radians((30, -10)))))) < 0.2
    assert math.sqrt(np.trace(thing.covariance) / 2) == pytest.approx(math.radians(8 / math.sqrt(12)), rel=0.02)


def test_a_thing_in_two_looks_counts_once_as_the_deeper_one_has_it():
    straight = box_detections([box(80, 0, score=0.5), box(-150, 20)], WHOLE)
    rolled = box_detections([Box(0.75 + 0.02, 0.48, 0.75 + 0.05, 0.52, 0.9)], WHOLE, 0.5)  # 81 degrees, off the middle
    for pictures in itertools.permutations((straight, rolled)):
        found = fuse_detections(pictures)
        assert len(found) == 2
        assert sorted(thing.score for thing in found) == [0.5, 0.8]


def test_two_things_in_one_picture_are_two():
    assert len(fuse_detections([box_detections([box(10, 0), box(14, 0)], WHOLE)])) == 2
    assert (
        len(fuse_detections([box_detections([box(10, 0), box(40, 0)], WHOLE), box_detections([box(12, 0)], WHOLE)]))
        == 2
    )


def test_a_box_all_around_names_no_direction_and_hides_no_thing():
    whole = Box(0.0, 0.0, 1.0, 1.0, 0.7)
    plan = InferencePlan((Crop(np.zeros((18, 36, 3), np.uint8), WHOLE),), WHOLE)
    evidence = ModelPerception(None)._of_boxes(plan, [[whole]], 1.0)
    assert np.ptp(evidence.log_ratio) < 1e-6
    around = box_detections([whole], WHOLE)
    assert len(fuse_detections([around, box_detections([box(3, 0)], WHOLE)])) == 2
    assert len(fuse_detections([around, around])) == 1


def test_evidence_of_boxes_tells_what_it_is_of():
    view = PerspectiveGrid(60, 80, 1.2, world_R_body(0.4))
    plan = InferencePlan((Crop(np.zeros((60, 80, 3), np.uint8), view),), view, view)
    boxes = [[Box(0.4, 0.4, 0.6, 0.6)]]
    evidence = ModelPerception(None, detector=DetectorModel(0.9))._of_boxes(plan, boxes, 3.0)
    assert evidence.stamp == 3.0
    assert evidence.detections.model.detection_probability == 0.9
    assert evidence.detections.directions[0] @ direction(0.4, 0.0) > math.cos(1e-3)
    assert not evidence.detections.share(np.array([[-1.0, 0.0, 0.0]]))[0]
    with pytest.raises(EagorError, match=r"a calibration came for boxes.*wanted detector="):
        ModelPerception(None, calibration=Calibration())._of_boxes(plan, boxes, None)


# --- blobs -----------------------------------------------------------------------------------------------------------


def test_parts_go_on_across_the_seam_and_over_the_poles():
    grid = ErpGrid(36, 72)
    response = np.zeros(grid.shape)
    response[17:19, [0, 1, 70, 71]] = 1.0  # across the seam
    response[0, :] = 1.0  # around a pole
    response[35, [3, 30]] = 1.0  # two cells that meet in the other
    response[10, 20], response[11, 21] = 0.6, 0.6  # at a corner
    found = blobs(response, grid, 0.5, 0.0)
    assert len(found) == 4
    middles = np.array([centre for centre, _, _ in found])
    assert (middles[:, 0] < -0.99).any()
    assert (middles[:, 2] > 0.999).any()
    assert (middles[:, 2] < -0.99).any()
    assert sorted(round(score, 3) for _, _, score in found) == [0.6, 1.0, 1.0, 1.0]


def test_a_view_does_not_go_on_across_its_border():
    grid = PerspectiveGrid(20, 30, 1.0)
    response = np.zeros(grid.shape)
    response[5, [0, 29]] = 1.0
    assert len(blobs(response, grid, 0.5, 0.0)) == 2
    assert blobs(np.zeros(grid.shape), grid, 0.5, 0.0) == []
    assert blobs(response, grid, 0.5, 1.0) == []


@pytest.mark.parametrize("azimuth", [20, 41, 45, 48])
def test_a_region_that_the_border_cuts_goes_on_beyond_it(azimuth):
    grid, whole = PerspectiveGrid(200, 200, math.radians(90)), direction(math.radians(azimuth), 0.0)
    disc = angular_distance(grid.directions, whole) < math.radians(8)
    ((centre, spread, _),) = blobs(disc.astype(float), grid, 0.5, 0.0)
    shown, narrow = moments_of(grid.directions[disc], grid.weights[disc])
    off, before = (math.degrees(float(angular_distance(each, whole))) for each in (centre, shown))
    if azimuth == 20:
        assert (off, spread[0, 0]) == pytest.approx((before, narrow[0, 0]))
    else:
        assert off < 0.75 * before
        assert spread[0, 0] > narrow[0, 0]
