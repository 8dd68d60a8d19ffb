"""Laws of the methods that play the tasks: late evidence, names, and what they do not know."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor import Calibration, Evidence, PatchGrid, angular_distance
from eagor.errors import EagorError, TimeError
from eagor.evidence.detector import DetectorModel
from eagor.lab.agents.methods import (
    EVERY,
    make_estimator,
)
from eagor.sphere import world_R_body
from eagor.tracking.config import TrackerConfig

GRID = PatchGrid(18, 36)
TARGET = np.array([3.0, 1.0, 0.5])
WITHOUT = ("plain", "centroid", "cent_circ", "best_detection", "last_detection")  # a distribution


def pose(step):
    return world_R_body(0.3 * step), np.array([0.15 * step, -0.05 * step, 0.0])


def look(step, rng):
    turned, place = pose(step)
    direction = turned.T @ (TARGET - place) + 0.2 * rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    response = np.exp(-(angular_distance(GRID.directions, direction) ** 2) / (2 * 0.15**2)) * (rng.random() > 0.2)
    return Evidence.from_response(response.astype(np.float32), GRID, stamp=step * 0.5)


def run(name, steps, latency, seed=0, filled=True):
    """The method after so many steps; responses come late, and what is still under way at the end comes then."""
    method, rng = make_estimator(name, np.random.default_rng(seed)), np.random.default_rng(seed)
    waiting = []
    for step in range(steps):
        method.move(step * 0.5, *pose(step))
        waiting.append(look(step, rng))
        if len(waiting) > latency:
            method.see(waiting.pop(0))
    for evidence in waiting if filled else ():
        method.see(evidence)
    return method


@pytest.mark.parametrize("name", EVERY)
@settings(max_examples=5)
@given(st.integers(1, 6), st.integers(0, 1000))
def test_late_evidence_ends_where_timely_evidence_does(name, latency, seed):
    timely, late = run(name, 9, 0, seed), run(name, 9, latency, seed)
    assert angular_distance(timely.direction(), late.direction()) < 1e-6
    if timely.mass_above(np.array([1.0, 0, 0])) is not None:
        somewhere = np.array([0.6, 0.0, 0.8])
        assert late.mass_above(somewhere) == pytest.approx(timely.mass_above(somewhere), abs=1e-6)


@pytest.mark.parametrize("name", EVERY)
def test_the_mass_above_the_answer_is_small_and_behind_it_is_large(name):
    method = run(name, 12, 0)
    answer = method.direction()
    mass = method.mass_above(answer)
    if name in WITHOUT:
        assert mass is None
    elif name != "eagor_paper":  # whose answer is not the maximum of its field
        assert mass < 0.5
        assert method.mass_above(-answer) > 0.7


def test_evidence_of_no_known_step_is_refused():
    method = run("vmf", 3, 0)
    with pytest.raises(TimeError, match="fits none"):
        method.see(Evidence.from_response(np.zeros(GRID.shape, np.float32), GRID, stamp=17.25))


def test_names_with_settings():
    """Angles in degrees; what is not named stays."""
    rng, motion = np.random.default_rng(0), TrackerConfig().target_motion
    config = make_estimator("eagor:degree=7,decode=mean,shells=0,jump=0.5,wander=3+12,turn=0,drift=0.5", rng).config
    assert (config.degree, config.answers.decode, config.ranges) == (7, "mean", None)
    wander = math.radians(3), math.radians(12)
    assert config.target_motion == replace(motion, jump=0.5, wander=wander, turn=())
    assert config.drift == pytest.approx(math.radians(0.5))
    assert (config.calibration, config.detector) == (None, None)
    read = make_estimator("eagor_paper:floor=0.2", rng).config.calibration
    assert (read.floor, read.scale_to_max) == (0.2, False)
    varied = make_estimator("eagor:temperature=4", rng, "truth", Calibration(0.3, 0.07, 1.5))
    assert varied.config.calibration == Calibration(0.3, 0.07, 4.0)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("wat", "no method 'wat'"),
        ("eagor:degre=7", "no setting 'degre'"),
        ("eagor:degree=7,degree=9", "each key once"),
        ("eagor:decode=best", "'eagor:decode=best'.* decode = 'best'; wanted mode or mean"),
        ("eagor:degree=7.5", r"degree = 7\.5; wanted a whole number, 0 or more"),
        ("eagor:death=-3", r"'eagor:death=-3': MotionModel: death = -3\.0; wanted a rate"),
        ("vmf:noise=nan", "noise = nan"),
        ("vmf:degree=7", "no setting 'degree'; known: floor"),
    ],
)
def test_names_that_are_none(name, message):
    with pytest.raises(EagorError, match=message):
        make_estimator(name, np.random.default_rng(0))


def test_fitted_settings_are_where_a_rival_starts_and_what_is_asked_for_comes_on_top():
    rng = np.random.default_rng(0)
    plain, fitted, varied = (
        make_estimator("vmf", rng),
        make_estimator("vmf", rng, "truth:miss=0.5"),
        make_estimator("vmf:noise=3", rng, "truth"),
    )
    assert fitted.filter.calibration != plain.filter.calibration
    assert varied.filter.calibration == fitted.filter.calibration
    assert varied.filter.noise == pytest.approx(math.radians(3))
    assert fitted.filter.noise != varied.filter.noise


def test_a_variant_varies_the_detector_of_the_perception():
    own = DetectorModel(0.6, 0.3, math.radians(4), look_alikes=0.2)

    def varied(text):
        return make_estimator(f"eagor:{text}", np.random.default_rng(0), detector=own).config.detector

    unknown = DetectorModel(None, 0.3, math.radians(7), look_alikes=0)
    assert varied("detection_probability=?,detector.spread=7,look_alikes=0") == unknown
    assert varied("false_alarms_per_look=?,offset=2") == replace(
        own, false_alarms_per_look=None, offset=math.radians(2)
    )
    assert varied("kept_for=2.5,kept_within=?") == replace(own, kept_for=2.5, kept_within=None)
    habits = varied("habit=2+1.5,look_alike_habit=0.5+3")
    assert habits == replace(own, habit=(2.0, 1.5), look_alike_habit=(0.5, 3.0))
    assert make_estimator("eagor:degree=7", np.random.default_rng(0), detector=own).config.detector is None
