"""The detector of known quality: its rates are what it says, and its mistakes behave like a detector's."""

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import at_most, directions, random_directions

from eagor.errors import EagorError, GridError, ImageError, QueryError, RotationError
from eagor.grids import PatchGrid
from eagor.perception.truth import Noise, TruthPerception, ramp
from eagor.sphere import angular_distance, direction, rotation, world_R_body

PERSISTENCES = [0.0, 0.8]
IDEAL, MODERATE = Noise.parse("ideal"), Noise.parse("moderate")


@dataclass(frozen=True)
class Thing:
    category: str
    colour: str | None = None


def discs(centres, radius=0.12, rows=72, background=-1):
    """Ids of discs about `centres` ``(n, 3)`` with an angular `radius`, the first in front."""
    grid = PatchGrid(rows, 2 * rows)
    ids = np.full(grid.shape, background, dtype=np.int32)
    for thing, centre in reversed(list(enumerate(np.asarray(centres)))):
        ids[angular_distance(grid.directions, centre) <= radius] = thing
    return ids


def ring(count, elevation=0.0):
    """Directions all around, none at the seam of a patch."""
    return direction(np.arange(count) * (2 * math.pi / count) + 0.1, np.full(count, elevation))


def episode(labels, noise=IDEAL, seed=0, rows=18):
    return TruthPerception(noise, rows=rows).episode(labels, seed)


def looks(labels, ids, query, noise, frames, seed=0):
    """The reports of so many looks at the same ids."""
    detector = episode(labels, noise, seed)
    return [detector.detect(ids, query) for _ in range(frames)]


def table(reports, kind, things):
    """Whether each of `things` was reported as `kind`, ``(frames, things)``."""
    named = [{r.thing for r in frame if r.kind == kind} for frame in reports]
    return np.array([[thing in frame for thing in things] for frame in named])


def assert_rate(hits, rate, persistence):
    """The mean of `hits` is `rate`, to 4.5 standard deviations of a mean of Markov chains with this persistence."""
    deviation = math.sqrt(rate * (1 - rate) / hits.size * (1 + persistence) / (1 - persistence))
    assert deviation < 0.02, "too few frames to say anything"
    assert abs(hits.mean() - rate) < 4.5 * deviation


def mean_run(hits):
    """Mean length of the runs of True along the first axis, those cut off at either end left out."""
    lengths = []
    for column in hits.T:
        edges = np.flatnonzero(np.diff(column.astype(int)))
        runs = np.diff(edges)
        lengths.extend(runs[int(column[0]) :: 2] if len(edges) > 1 else [])
    return np.mean(lengths), np.std(lengths) / math.sqrt(len(lengths))


SCENE = (
    *[Thing("chair", "red")] * 4,
    *[Thing("chair", colour) for colour in ("blue", "green", None, "grey")],
    *[Thing(category, "red") for category in ("sofa", "lamp", "rug", "bed")],
    Thing("sofa", "blue"),
    Thing("plant"),
)
IDS = discs(np.concatenate([ring(7, -0.3), ring(7, 0.3)]))


# --- rates -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("persistence", PERSISTENCES)
def test_mistakes_are_as_frequent_and_last_as_long_as_they_should(persistence):
    noise = Noise(0.3, 0.25, 0.15, 0.1, persistence=persistence)
    reports = looks(SCENE, IDS, "red chair", noise, 6000 if persistence > 0.5 else 2000)
    alarms = np.array([[sum(r.kind == "false alarm" for r in frame)] for frame in reports])
    assert alarms.max() == 1
    for hits, rate in (
        (~table(reports, "found", range(4)), 0.3),
        (table(reports, "category", range(4, 8)), 0.15),
        (table(reports, "colour", range(8, 12)), 0.1),
        (alarms > 0, 0.25),
    ):
        assert_rate(hits, rate, persistence)
        mean, error = mean_run(hits)
        assert error < 0.1 * mean
        assert mean == pytest.approx(1 / ((1 - persistence) * (1 - rate)), abs=4.5 * error)
    assert {r.kind for frame in reports for r in frame if r.thing in (12, 13)} == {"false alarm"}


@pytest.mark.parametrize("persistence", PERSISTENCES)
def test_displacements_have_the_spread_asked_for_on_both_axes(persistence):
    """Turning about a skew axis does not change that: the error is a direction in the world, not in the image."""
    spread, errors = math.radians(6), []
    detector = episode([Thing("chair")] * 6, Noise(spread=spread, persistence=persistence))
    centres = random_directions(6, seed=3)
    centres[:, 2] *= 0.6  # apart, and off the poles, where two axes by azimuth and elevation make sense
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    ids = discs(centres, radius=0.05)
    true = np.array([r.direction for r in episode([Thing("chair")] * 6).detect(ids, "chair")])
    up = np.array([0, 0, 1.0])
    left = np.cross(up, true) / np.linalg.norm(np.cross(up, true), axis=1, keepdims=True)
    above = np.cross(true, left)
    for step in range(1500):
        found = detector.detect(ids, "chair", rotation((1, 2, 3), 0.7 * step))
        said = np.array([r.direction for r in found])
        angle = angular_distance(said, true)
        flat = said - np.sum(said * true, axis=1, keepdims=True) * true
        flat *= (angle / np.maximum(np.linalg.norm(flat, axis=1), 1e-12))[:, None]
        errors.append(np.stack([np.sum(flat * left, axis=1), np.sum(flat * above, axis=1)], axis=-1))
    errors = np.reshape(errors, (-1, 2))
    effective = len(errors) * (1 - persistence) / (1 + persistence)
    assert np.all(np.abs(errors.std(axis=0) / spread - 1) < 4.5 / math.sqrt(2 * effective))
    assert np.all(np.abs(errors.mean(axis=0)) < 4.5 * spread / math.sqrt(effective))
    assert abs(np.corrcoef(errors.T)[0, 1]) < 4.5 / math.sqrt(effective)


def test_small_things_are_found_as_often_as_their_size_says():
    assert ramp(np.array([0.2, 0.25, 0.625, 1.0, 3.0]), 1.0) == pytest.approx([0, 0, 0.5, 1, 1])
    tiny, enough = (discs([[1, 0, 0]], radius, rows=360) for radius in (0.02, 0.05))  # a patch of 18 rows is 0.17 wide
    assert [len(looks([Thing("chair")], ids, "chair", Noise(smallest=0.2), 1)[0]) for ids in (tiny, enough)] == [0, 1]


# --- what is confused with what --------------------------------------------------------------------------------------


def test_without_a_colour_in_the_query_nothing_is_confused():
    noise = Noise(confuse_category=1, confuse_colour=1)
    (reports,) = looks(SCENE, IDS, "chair", noise, 1)
    assert [(r.kind, r.thing) for r in reports] == [("found", thing) for thing in range(8)]
    (reports,) = looks(SCENE, IDS, "red chair", noise, 1)
    kinds = ["found"] * 4 + ["category"] * 4 + ["colour"] * 4
    assert [(r.kind, r.thing) for r in reports] == list(zip(kinds, range(12), strict=True))


def test_what_surrounds_us_is_mistaken_for_nothing():
    labels = [Thing("floor", "red"), Thing("ceiling", "blue"), Thing("chair", "red")]
    ids = discs(np.array([[0, 0, -1.0], [0, 0, 1], [1, 0, 0]]), radius=1.4)
    (reports,) = looks(labels, ids, "red chair", Noise(false_alarm=1, confuse_colour=1, persistence=1), 1)
    assert [(r.kind, r.thing) for r in reports] == [("found", 2), ("false alarm", None)]


def test_a_false_alarm_stays_with_its_thing_while_that_is_in_view():
    noise = Noise(false_alarm=1, persistence=1)
    for seed in range(20):
        detector = episode(SCENE, noise, seed)
        (first,) = {r.thing for r in detector.detect(IDS, "green chair") if r.kind == "false alarm"}
        assert first != 5
        for turn in (8, 40, 77):
            alarms = [r for r in detector.detect(np.roll(IDS, turn, axis=1), "green chair") if r.kind == "false alarm"]
            assert [r.thing for r in alarms] == [first]
        hidden = np.where(first == IDS, -1, IDS)
        (second,) = {r.thing for r in detector.detect(hidden, "green chair") if r.kind == "false alarm"}
        assert second not in (first, 5)
        (still,) = {r.thing for r in detector.detect(IDS, "green chair") if r.kind == "false alarm"}
        assert still == second  # it does not leap back


def test_a_false_alarm_at_nothing_is_anywhere_in_the_world_and_stays_there():
    empty = np.full((36, 72), -1)
    reports = looks(SCENE, empty, "chair", Noise(false_alarm=1), 1500)
    said = np.array([r.direction for frame in reports for r in frame])
    assert len(said) == 1500
    assert np.abs(said.mean(axis=0)).max() < 4.5 / math.sqrt(3 * 1500)
    assert np.abs(said.T @ said / 1500 - np.eye(3) / 3).max() < 4.5 * math.sqrt(4 / 45 / 1500)
    detector = episode(SCENE, Noise(false_alarm=1, persistence=1, spread=0.1))
    turns = [rotation((1, 1, 1), 0.4 * step) for step in range(6)]
    fixed = [turn @ r.direction for turn in turns for r in detector.detect(empty, "chair", turn)]
    assert np.allclose(fixed, fixed[0], atol=1e-12)


# --- places ----------------------------------------------------------------------------------------------------------


@given(directions(), st.floats(0.01, 0.5))
@at_most(60)
def test_the_ideal_answer_peaks_where_the_thing_is(centre, radius):
    ids = discs([centre], max(radius, 0.05))
    grid = PatchGrid(18, 36)
    evidence = episode([Thing("chair")])(ids, "chair")
    (report,) = episode([Thing("chair")]).detect(ids, "chair")
    pixel, patch = math.pi / 72, math.pi / 18
    assert angular_distance(report.direction, centre) < pixel
    cell = grid.directions.reshape(-1, 3)[int(np.argmax(evidence.response))]
    assert angular_distance(cell, report.direction) < patch * math.sqrt(0.5) + 1e-6
    assert report.score == 1
    response = np.asarray(evidence.response)
    assert response.max() > 0.3
    away = angular_distance(grid.directions, centre) > max(radius, 0.05) + 5 * patch
    assert response[away].max(initial=0) < 1e-3


@given(st.floats(-3, 3), st.floats(-1, 1), st.floats(0, 0.3))
@at_most(40)
def test_the_answer_is_the_gaussian_that_is_reported(azimuth, elevation, spread):
    """A single pixel has no size of its own: what is drawn is round, half a patch and the spread wide."""
    grid = PatchGrid(180, 360)
    ids = np.full(grid.shape, -1)
    x, y, _ = grid.project(direction(azimuth, elevation))
    ids[int(y), int(x)] = 0
    noise = Noise(spread=spread, floor=0.1, weakest=0.5)
    (report,) = episode([Thing("chair")], noise, seed=5).detect(ids, "chair")
    response = np.asarray(episode([Thing("chair")], noise, seed=5)(ids, "chair").response)
    variance = spread**2 + (math.pi / 18 / 2) ** 2
    assert np.allclose(report.covariance @ report.direction, 0, atol=1e-12)
    assert np.allclose(np.linalg.eigvalsh(report.covariance), [0, variance, variance], atol=1e-9)
    away = angular_distance(PatchGrid(18, 36).directions, report.direction)
    assert np.allclose(response, np.maximum(report.score * np.exp(-0.5 * away**2 / variance), 0.1), atol=2e-6)


def test_the_blob_has_the_shape_of_what_is_visible():
    """A rectangle of azimuth a and elevation b on the horizon has the variances a^2 / 12 and b^2 / 12."""
    ids = np.full((180, 360), -1)
    ids[85:95, 160:200] = 0
    (report,) = episode([Thing("sofa")]).detect(ids, "sofa")
    expected = np.diag([0, math.radians(40) ** 2 / 12, math.radians(10) ** 2 / 12])
    assert np.allclose(report.covariance, expected + (math.pi / 36) ** 2 * np.diag([0, 1, 1]), rtol=0.01, atol=1e-9)


# --- turning ---------------------------------------------------------------------------------------------------------


@given(
    st.lists(st.integers(0, 35), min_size=1, max_size=6),
    st.integers(0, 1000),
    st.sampled_from(["ideal", "", "ideal,spread=20,persistence=0.9,miss=0.4", "false_alarm=1,persistence=0.7"]),
)
@at_most(30)
def test_turning_the_camera_turns_the_answer_and_its_mistakes(turns, seed, noise):
    """A turn to the left by k patches moves the image k patches to the right, and every mistake with it."""
    still, turning = (TruthPerception(noise).episode(SCENE, seed) for _ in range(2))
    for patches in turns:
        standing = np.asarray(still(IDS, "red chair").response)
        attitude = world_R_body(yaw=patches * 2 * math.pi / 36)
        turned = turning(np.roll(IDS, 4 * patches, axis=1), "red chair", world_R_body=attitude)
        assert np.allclose(np.roll(standing, patches, axis=1), turned.response, atol=1e-5)


# --- seeing nothing --------------------------------------------------------------------------------------------------


@given(st.integers(0, 1000), st.floats(0, 1))
@at_most(30)
def test_what_is_hidden_is_not_seen(seed, floor):
    labels = [*SCENE, Thing("toilet", "white")]
    noise = replace(MODERATE, false_alarm=0, confuse_colour=0, floor=floor)
    for query in ("toilet", "white toilet"):
        evidence = episode(labels, noise, seed)(IDS, query)
        assert np.allclose(evidence.response, floor, atol=1e-5)
        assert np.ptp(np.asarray(evidence.log_ratio)) == 0
        assert not np.asarray(episode(labels, IDEAL, seed)(IDS, query).response).any()


# --- chance ----------------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_evidence():
    def walk(seed):
        detector = TruthPerception("persistence=0.5").episode(SCENE, seed)
        frames = [detector(np.roll(IDS, step, axis=1), "red chair", stamp=float(step)) for step in range(30)]
        return [np.asarray(frame.log_ratio).tobytes() for frame in frames]

    assert walk(1) == walk(1)
    assert walk(1) != walk(2)


@given(st.lists(st.sampled_from(["red chair", "chair", "blue plant", "rug"]), max_size=8), st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_luck_does_not_depend_on_what_was_asked_for_or_seen_before(queries, seed):
    """So that two methods that walk apart have the same luck at the same step."""
    empty = np.full_like(IDS, -1)
    one, other = (TruthPerception("persistence=0,false_alarm=0.7").episode(SCENE, seed) for _ in range(2))
    for query in queries:
        one.detect(IDS, query)
        other.detect(empty, "sofa")
    assert np.array_equal(one(IDS, "red chair").response, other(IDS, "red chair").response)


# --- settings and errors ---------------------------------------------------------------------------------------------


def test_the_text_form():
    assert TruthPerception().noise == TruthPerception("").noise == TruthPerception("moderate").noise == MODERATE
    assert TruthPerception("ideal").noise == IDEAL
    assert TruthPerception(IDEAL).noise is IDEAL
    assert Noise.parse("miss=0.1, spread=4") == replace(MODERATE, miss=0.1, spread=math.radians(4))
    assert Noise.parse("ideal,miss=0.5") == Noise(miss=0.5)
    assert Noise.parse(",miss=0.5") == Noise.parse("moderate,miss=0.5") == replace(MODERATE, miss=0.5)
    assert all(getattr(IDEAL, field.name) == (field.name == "weakest") for field in fields(Noise))


WHOLE = r"rows = .*; wanted a whole number, 1 or more"
KEYS = r"keys: miss, false_alarm, .*smallest, weakest \(spread in degrees\)"
TEXTS = ["mis=0.1", "miss", "miss=", "miss=much", "miss=0.1,miss=0.2", "miss=0.1,ideal", "ideal=1", "miss=0.1,"]
BEYOND = ["miss=1.1", "floor=-0.1", "spread=91", "spread=nan", "smallest=inf", "persistence=2"]


@pytest.mark.parametrize(
    ("make", "error", "says"),
    [
        *((lambda text=text: TruthPerception(text), EagorError, KEYS) for text in TEXTS),
        *((lambda text=text: Noise.parse(text), EagorError, r"= .*wanted a number from 0") for text in BEYOND),
        *((lambda value=value: Noise(miss=value), EagorError, r"miss = .*wanted a number from 0 to 1")
          for value in ("0.1", None, True, 10**400)),
        *((lambda rows=rows: TruthPerception(rows=rows), GridError, WHOLE)
          for rows in (0, -3, 2.5, math.nan, "18", True)),
        *((lambda ids=ids: episode(SCENE)(ids, "chair"), ImageError, r"instance ids.*bench run")
          for ids in (np.zeros((8, 16, 3), np.uint8), np.zeros((8, 16)), [[1, 2]], np.zeros((0, 0), int), None)),
        (lambda: episode(SCENE)(np.zeros((8, 8), int), "chair"), ImageError, r"instance ids \(H, 2 H\)"),
        *((lambda thing=thing: episode(SCENE)(np.full((8, 16), thing), "chair"), ImageError, r"wanted -1 .*to 13")
          for thing in (14, -2)),
        (lambda: episode(SCENE)(IDS, "chiar"), QueryError, "Did you mean 'chair'"),
        *((lambda query=query: episode(SCENE)(IDS, query), QueryError, ".") for query in (None, ["chair"], 3)),
        (lambda: episode(SCENE)(IDS, "chair", world_R_body=np.eye(3) * 2), RotationError, "world_R_body"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(make, error, says):
    with pytest.raises(error, match=says):
        make()
