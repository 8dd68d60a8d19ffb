"""The belief that goes to the page is the one that the answers are read from."""

import math
from dataclasses import replace

import numpy as np
import pytest

import eagor
from eagor.belief.field import SphereField
from eagor.belief.reading import Reading
from eagor.grids import ErpGrid, PatchGrid
from eagor.harmonics import RealHarmonics
from eagor.studio.density import MASS, density_of
from eagor.tracking import DirectionTracker, TrackerConfig

FINE = ErpGrid(256, 512)


def detections(*azimuths, score=0.9):
    found = np.array([[math.cos(a), math.sin(a), 0.2] for a in azimuths])
    return eagor.Evidence.from_points(found, scores=np.full(len(found), score), stamp=0.0)


def response(rows=16):
    grid = PatchGrid(rows, 2 * rows)
    near = grid.directions @ np.array([0.6, -0.8, 0.0])
    return eagor.Evidence.from_response(0.05 + 0.9 * np.exp(20 * (near - 1)), grid, stamp=0.0)


def told(*looks, positions=True):
    """The estimate after these looks, from places a little apart."""
    tracker = DirectionTracker(TrackerConfig(floor_height=0.0 if positions else None))
    for number, look in enumerate(looks):
        place = np.array([0.1 * number, 0.05 * number, 1.2]) if positions else None
        tracker.add_pose(0.2 * number, eagor.sphere.world_R_body(0.3 * number), place)
        tracker.observe(replace(look, stamp=0.2 * number))
    return tracker.estimate(0.2 * (len(looks) - 1))


BELIEFS = {
    "one peak": lambda: told(*[detections(0.4 - 0.3 * k) for k in range(5)]),
    "without positions": lambda: told(*[detections(0.4 - 0.3 * k) for k in range(5)], positions=False),
    "two peaks": lambda: told(detections(0.3, 2.5)),
    "one look": lambda: told(detections(-1.0)),
    "seen nowhere": lambda: told(detections()),
    "response maps": lambda: told(response(), response()),
}


@pytest.fixture(scope="module", params=BELIEFS)
def belief(request):
    estimate = BELIEFS[request.param]()
    return estimate, density_of(estimate.posterior)


def test_the_terms_integrate_to_one(belief):
    _, density = belief
    total = float(np.sum(density(FINE.directions) * FINE.weights))
    assert total == pytest.approx(1, abs=0.01)
    assert sum(term.weight for term in density.terms) == pytest.approx(1, abs=1e-6)
    for term in density.terms:
        own = float(np.sum(term(FINE.directions) * FINE.weights))
        assert own == pytest.approx(term.weight, abs=0.01)


def test_the_highest_point_is_the_heaviest_mode_of_a_belief_that_has_one(belief):
    estimate, density = belief
    heaviest = estimate.modes[0] if estimate.modes else None
    if heaviest is None or heaviest.weight < 0.5:
        return
    top = FINE.directions.reshape(-1, 3)[int(density(FINE.directions).argmax())]
    assert math.degrees(eagor.angular_distance(top, estimate.world_R_body @ heaviest.direction)) < 1.5


def test_the_level_bounds_the_region_that_holds_the_stated_mass(belief):
    estimate, density = belief
    inside = density(estimate.posterior.parts[2]) > density.level
    assert float(estimate.posterior.mass[inside].sum()) == pytest.approx(MASS, abs=0.02)  # of the true belief
    drawn = density(FINE.directions)
    assert float(np.sum((drawn * FINE.weights)[drawn > density.level])) == pytest.approx(MASS, abs=0.02)  # of the drawn


def test_a_border_that_would_run_in_a_flat_background_is_not_drawn():
    once = detections(0.4, score=0.28)  # a peak of less than 90 %; elsewhere all is equally likely
    seen_once = told(once, positions=False)
    assert density_of(seen_once.posterior).undrawn == "over half of the sphere"
    assert density_of(BELIEFS["one peak"]().posterior).undrawn == ""


def test_it_is_close_to_the_belief_everywhere(belief):
    estimate, density = belief
    _, weights, directions = estimate.posterior.parts
    off = 0.5 * float(np.abs(density(directions) * weights - estimate.posterior.mass).sum())
    assert off < 0.08  # total variation


def test_a_narrow_peak_outside_of_all_patches_is_a_term_of_its_own():
    grid = ErpGrid(64, 128)
    top = eagor.sphere.direction(math.radians(-40), math.radians(-18))
    angle = eagor.angular_distance(grid.directions, top)
    reading = Reading(SphereField(grid, np.log(1 + 2000 * np.exp(-0.5 * (angle / math.radians(2.5)) ** 2))))
    density = density_of(reading)
    _, weights, directions = reading.parts
    assert 0.5 * float(np.abs(density(directions) * weights - reading.mass).sum()) < 0.08
    drawn = FINE.directions.reshape(-1, 3)[int(density(FINE.directions).argmax())]
    assert math.degrees(eagor.angular_distance(drawn, top)) < 1


def test_the_blob_holds_the_coefficients_of_all_terms(belief):
    _, density = belief
    numbers = np.frombuffer(density.blob, dtype="<f4")
    assert len(numbers) == sum((term.degree + 1) ** 2 for term in density.terms)
    first, begin = density.terms[0], (density.terms[0].degree + 1) ** 2
    direction = np.array([[0.0, 0.6, 0.8]])
    read = first.weight * np.exp(RealHarmonics(first.degree).synthesise(numbers[:begin].astype(float), direction))
    assert read == pytest.approx(first(direction))
    assert len(density.blob) < 4096  # a few kilobytes at most, however many peaks


def test_the_degree_of_the_ground_is_the_one_asked_for():
    estimate = BELIEFS["seen nowhere"]()
    assert max(term.degree for term in density_of(estimate.posterior, 7).terms) == 7
