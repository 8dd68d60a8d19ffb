"""Perceptions that are shown one picture at a time: what was not in it says nothing."""

import math

import numpy as np
import pytest

from eagor.errors import ImageError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.perception import load
from eagor.perception.colour import ColourPerception
from eagor.perception.partial import coverage, infer_view
from eagor.sources.panorama import view
from eagor.sphere import direction, world_R_body

HFOV = math.radians(100)


def red_spot(azimuth, elevation, rows=256):
    grid = ErpGrid(rows, 2 * rows)
    image = np.full((*grid.shape, 3), 128, dtype=np.uint8)
    image[grid.directions @ direction(azimuth, elevation) > math.cos(math.radians(6))] = (220, 30, 30)
    return image


@pytest.mark.parametrize("pitch", [-0.5, 0.0, 1.0])
def test_evidence_is_where_the_thing_is_and_nowhere_beyond_the_view(pitch):
    grid = PerspectiveGrid(180, 320, HFOV, world_R_body(0.0, -pitch))
    picture = view(red_spot(0.2, pitch - 0.1), grid)
    found = infer_view(Painted(Calibration()), picture, grid, "red", stamp=3.0)
    assert found.stamp == 3.0
    shown = coverage(*found.grid.shape, grid)
    log_ratio = np.asarray(found.log_ratio)
    assert (log_ratio[shown < 0.5] == 0).all()
    assert (log_ratio[shown > 0.5] != 0).mean() > 0.99
    peak = found.grid.directions[np.unravel_index(log_ratio.argmax(), log_ratio.shape)]
    assert peak @ direction(0.2, pitch - 0.1) > math.cos(math.radians(8))


class Painted:
    """Colour as a perception that knows nothing of views."""

    def __init__(self, calibration=None):
        self.colour = ColourPerception(calibration=calibration)

    def __call__(self, panorama, query, *, stamp=None):
        return self.colour(panorama, query, stamp=stamp)


@pytest.mark.parametrize("perception", [ColourPerception(), Painted()], ids=["views", "panoramas"])
@pytest.mark.parametrize("pitch", [-0.5, 0.0, 1.0])
def test_detections_in_a_view_say_nothing_beyond_it(perception, pitch):
    grid = PerspectiveGrid(180, 320, HFOV, world_R_body(0.0, -pitch))
    picture = view(red_spot(0.2, pitch - 0.1), grid)
    found = infer_view(perception, picture, grid, "red", stamp=3.0)
    assert found.stamp == 3.0
    assert len(found.detections) == 1
    assert isinstance(found.grid, PerspectiveGrid)
    assert found.detections.directions[0] @ direction(0.2, pitch - 0.1) > math.cos(math.radians(1))
    cells = ErpGrid(60, 120)
    assert (np.asarray(found.detections.share(cells.directions)) == grid.project(cells.directions)[2]).all()
    off = cells.directions @ grid.body_R_view[:, 0] < math.cos(math.radians(55 + 30))
    field = RealHarmonics(15).synthesise(found.coefficients(15), cells)
    assert np.abs(field[off]).max() < 0.1  # of the 4 nats in the view: what a field of degree 15 leaks
    nothing = infer_view(perception, np.full_like(picture, 128), grid, "red", stamp=3.0)
    assert len(nothing.detections) == 0


def test_what_fills_a_panorama_around_a_picture_is_no_detection():
    """The rest is painted with the picture's mean colour, which may be the one that is asked for."""
    picture = np.full((90, 160, 3), (220, 30, 30), dtype=np.uint8)
    picture[:40] = (200, 25, 25)
    found = infer_view(ColourPerception(), picture, PerspectiveGrid(90, 160, HFOV), "red")
    assert (found.detections.directions[:, 0] > 0.5).all()


def test_a_perception_that_takes_pictures_is_given_the_picture():
    class Viewer:
        def __call__(self, panorama, query, *, stamp=None):
            raise AssertionError("it was shown a panorama")

        def view(self, image, grid, query, *, stamp=None):
            self.seen = image, grid, query
            return Evidence.from_response(
                np.zeros((9, 16)), PerspectiveGrid(9, 16, HFOV, grid.body_R_view), stamp=stamp
            )

    viewer, picture = Viewer(), np.zeros((18, 32, 3), dtype=np.uint8)
    posed = PerspectiveGrid(18, 32, HFOV, world_R_body(0.0, -0.4))
    found = infer_view(viewer, picture, posed, "cup", stamp=1.0)
    image, grid, query = viewer.seen
    assert image is picture
    assert query == "cup"
    assert grid is posed
    assert found.grid.shape == (9, 16)


def test_what_is_no_picture_is_refused():
    with pytest.raises(ImageError, match="uint8"):
        infer_view(load("colour"), np.zeros((4, 4)), PerspectiveGrid(4, 4, HFOV), "red")
    with pytest.raises(ImageError, match="resized"):
        infer_view(load("colour"), np.zeros((4, 4, 3), dtype=np.uint8), PerspectiveGrid(8, 8, HFOV), "red")


def test_coverage_is_the_share_of_the_sphere_that_a_view_has():
    grid = PerspectiveGrid(90, 160, HFOV, world_R_body(0.0, -0.7))
    cells = ErpGrid(60, 120)
    share = (coverage(60, 120, grid) * cells.weights).sum() / (4 * math.pi)
    assert share == pytest.approx(float(grid.weights.sum()) / (4 * math.pi), rel=0.02)
