"""A look tells the mutual information of its outcome and the place, as expected; evidence states its chance to find."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eagor import Calibration, DetectorModel, Evidence
from eagor.grids import ErpGrid
from eagor.lab.agents.search_space import Chance
from eagor.sphere import direction
from eagor.tracking.next_view import information

GRID = ErpGrid(16, 32)


def entropy(p):
    p = p[p > 0]
    return -float((p * np.log(p)).sum())


def by_definition(here, share, alarm, falls):
    """I(outcome; cell) of one look, by the table of all places (its cells, elsewhere) and outcomes (cells, none)."""
    k = len(here)
    joint = np.zeros((k + 1, k + 1))
    for place, p in enumerate([*here, 1 - here.sum()]):
        found = share[place] if place < k else 0.0
        joint[place, :k] = p * (1 - found) * alarm * falls
        joint[place, k] = p * (1 - found) * (1 - alarm)
        if place < k:
            joint[place, place] += p * found
    return entropy(joint.sum(axis=0)) + entropy(joint.sum(axis=1)) - entropy(joint.ravel())


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.booleans())
def test_information_is_what_its_definition_says(seed, k, alarms):
    """Each look may have false reports of its own, and cells that it does not show."""
    rng = np.random.default_rng(seed)
    here = rng.dirichlet(np.ones(k + 1), size=3)[:, :k]
    share, alarm, falls = rng.uniform(0.01, 0.99, size=(3, k)), rng.uniform(0.01, 0.9, size=3), np.zeros((3, k))
    if alarms:
        falls = rng.dirichlet(np.ones(k), size=3)
        falls[1, 1:2], share[1, 1:2] = 0.0, 0.0
        falls[1] /= falls[1].sum()
    alarm = alarm * alarms
    wanted = [by_definition(*four) for four in zip(here, share, alarm, falls, strict=True)]
    assert information(here, share, alarm, falls if alarms else None) == pytest.approx(wanted, abs=1e-9)


def test_a_response_has_the_chance_that_its_calibration_states():
    response = np.zeros(GRID.shape)
    response[8, 16] = 1.0
    read = Calibration(floor=0.2, neutral=0.1, temperature=2, persistence=0.6)
    chance = Chance.of(Evidence.from_response(response, GRID, read, stamp=0.0), 0.5)
    silent = float(np.asarray(Evidence.from_response(np.zeros(GRID.shape), GRID, read, stamp=0.0).log_ratio)[0, 0])
    assert chance.recall == pytest.approx(1 - math.exp(silent), rel=1e-5)
    assert (chance.repeats, chance.elapsed) == (0.6, 0.5)
    assert chance.left(3.0) == 1, "what a response map repeats does not fade"


# Of a beta distribution (a, b): its mean, and the correlation 1 / (a + b + 1) of two draws with one share.
@pytest.mark.parametrize(("stated", "recall", "repeats"), [(0.8, 0.8, 0.0), (None, 2 / 3.5, 1 / 4.5)])
def test_a_detector_has_the_chance_that_its_model_states(stated, recall, repeats):
    model = DetectorModel(detection_probability=stated, habit=(2.0, 1.5), kept_for=10.0, kept_within=2.0)
    found = Evidence.from_points(direction(0.3, 0.1)[None], scores=np.array([0.9]), detector=model, stamp=0.0)
    chance = Chance.of(found, 0.5)
    assert chance.recall == pytest.approx(recall, abs=0.001)  # eight levels stand for the beta distribution
    assert chance.repeats == pytest.approx(repeats, abs=0.02)
    assert chance.left(0.4) == pytest.approx(math.exp(-0.5 / 10 - 0.4 / 2))
