"""The list of known look-alikes: what stands and is detected again and again is no news to a target that moves.

And what seems to turn together tells how far the odometry drifts.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from strategies import estimate_after, points_look, random_directions

from eagor._values import altered
from eagor.evidence import Evidence
from eagor.evidence.detector import ClutterRate, DetectorModel, Spread
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.sphere import angular_distance, direction, rotation, unit
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.look_alikes import DRIFT, LEAST, LookAlikes
from eagor.tracking.scan import Scan
from eagor.tracking.tracker import DirectionTracker

FLAT = TrackerConfig(ranges=None, drift=0.0)
LEARNT = TrackerConfig(ranges=None)  # the drift of the odometry is
MODEL = DetectorModel(false_alarms_per_look=0.2, spread=math.radians(5), look_alikes=0.7, kept_for=None)
HERE, THERE = direction(0.5, 0.1), direction(-1.9, -0.2)
SPREAD = Spread.unsure()


def look(places, stamp, model=MODEL, **more):
    return points_look(places, stamp, model, **more)


def after(looks, config=FLAT):
    return estimate_after(looks, config)


def density(known, places, model=MODEL, position=None, **more):
    """The density of detections that known look-alikes cause at `places`, over that of one false alarm a look."""
    scan = Scan.of([look(places, 99, model, **more)], FLAT.degree, 99.0, np.eye(3), position)
    return known.heard(scan, SPREAD).density


def likelihoods(known):
    return 1 / (1 + np.exp(-known.odds))


@pytest.mark.parametrize(("found", "looks"), [(1, 1), (3, 3), (2, 8), (12, 12)])
def test_alone_a_place_is_as_likely_as_the_field_says(found, looks):
    """Its odds are Q, the look-alikes expected there, if no others and nothing that moves may be taken for it."""
    rare, still = replace(MODEL, look_alikes=0.01), replace(FLAT, target_motion=MotionModel.still())
    seen = unit(HERE + math.radians(2) * np.random.default_rng(found).standard_normal((found, 3)))
    hypotheses = after([look(seen[stamp : stamp + 1], stamp, rare) for stamp in range(looks)], still).hypotheses
    known, cell = hypotheses.look_alikes, int((hypotheses.grid.directions @ HERE).argmax())
    field = hypotheses.standing.log_other_intensity[hypotheses.standing.places.cells.reshape(-1)[cell]]
    assert angular_distance(known.directions[0, 0], HERE) < math.radians(12)
    assert float(known.odds.max()) == pytest.approx(math.log(math.expm1(field)), abs=0.25)


def test_one_between_the_cells_is_known():
    """Six places are found again and again, more than there are windows. None of them is news."""
    places = unit(np.concatenate([np.eye(3), -np.eye(3)]) + 0.03 * random_directions(6, 3))
    sharp = replace(MODEL, spread=math.radians(0.7), false_alarms_per_look=0.02)
    known = after([look(places, stamp, sharp) for stamp in range(12)]).hypotheses.look_alikes
    assert density(known, places, sharp).min() > 1  # a false alarm there is much rarer


def test_a_weak_place_beside_a_strong_one_is_no_sign_of_something_that_moves():
    """In the field it lies on the slope of the strong one, 30 degrees away."""
    random, beside = np.random.default_rng(2), rotation([0, 0, 1], math.radians(30)) @ HERE
    narrow = replace(MODEL, spread=math.radians(1.5), false_alarms_per_look=None)
    looks = []
    for stamp in range(40):
        there = [HERE, *([beside] if random.random() < 0.7 else [])]
        looks.append(look(unit(np.array(there) + 0.02 * random.standard_normal((len(there), 3))), stamp, narrow))
    hypotheses = after(looks).hypotheses
    assert likelihoods(hypotheses.look_alikes)[:2].min() > 0.9
    assert density(hypotheses.look_alikes, [beside], narrow).min() > 1
    assert hypotheses.moving < 0.1


def test_what_moves_leaves_no_trail_of_look_alikes():
    """A detection that something moving explains is no sign that something stands there."""
    looks = [look([rotation([0, 0, 1], math.radians(6) * stamp) @ HERE], stamp) for stamp in range(30)]
    hypotheses = after(looks).hypotheses
    assert hypotheses.moving > 0.7
    assert likelihoods(hypotheses.look_alikes).sum() < 1


def test_a_step_of_the_body_shifts_them_and_tells_their_range():
    """Two metres and six away: seen from a walk past them, each look finds them where they were expected."""
    points = np.array([[2.0, 1.0, 0.0], [-3.0, 5.0, 0.5]])
    sharp, tracker = replace(MODEL, spread=math.radians(2), kept_within=None), DirectionTracker(TrackerConfig())
    for stamp in range(14):
        position = np.array([0.2 * stamp, 0.0, 0.0])
        tracker.add_pose(float(stamp), np.eye(3), position)
        tracker.observe(look(unit(points - position), stamp, sharp))
        known = tracker.estimate(float(stamp)).hypotheses.look_alikes
    best = np.argsort(-known.odds)[:2]
    means = np.einsum("mk,mki->mi", known.shares[best], known.points[best])
    for point in points - position:
        nearest = means[np.argmin(np.linalg.norm(means - point, axis=1))]
        assert angular_distance(unit(nearest), unit(point)) < math.radians(2)
        assert np.linalg.norm(nearest) == pytest.approx(np.linalg.norm(point), rel=0.25)
    step = np.array([0.2, 0.0, 0.0])
    on = known.after(1.0, 0.0, step)
    assert density(on, unit(points - position - step), sharp, position + step).min() > 10
    elsewhere = unit(points + np.array([2.0, 0.0, 0.0]))
    assert density(on, elsewhere, sharp, position).max() < 1


def test_where_nobody_looked_they_are_as_many_as_before():
    view = PerspectiveGrid(60, 80, math.radians(70))
    known = after([look([], stamp, grid=view) for stamp in range(12)]).hypotheses.look_alikes
    before = float(density(LookAlikes.prior(MODEL.habits, None), [HERE])[0])
    ahead, behind = density(known, [[1, 0, 0], [-1, 0, 0]])
    assert ahead < before / 3
    assert behind == pytest.approx(before)


def test_another_detector_keeps_the_places_and_expects_as_many_others_as_it_states():
    known = after([look([HERE], stamp) for stamp in range(10)]).hypotheses.look_alikes
    other = known.for_sensor(replace(MODEL, look_alikes=1.4, look_alike_habit=(1.0, 1.0)).habits)
    assert other.odds == pytest.approx(known.odds)
    assert other.hidden.sum() == pytest.approx(2 * known.hidden.sum())


def test_what_is_hardly_there_is_forgotten():
    """A single detection, and then none at all."""
    looks = [look([HERE] if stamp == 0 else [], stamp) for stamp in range(3)]
    assert len(after(looks).hypotheses.look_alikes) == 1
    many = [look([direction(0.1 * stamp, 0.0)], stamp) for stamp in range(60)]
    known = after(many, replace(FLAT, target_motion=MotionModel.still())).hypotheses.look_alikes
    assert len(known) <= 32
    assert likelihoods(known).min() > LEAST / 2


def boxes_look(about, stamp, model):
    """Boxes `about` ``(n, 4)``: azimuth, elevation, width, height, degrees."""
    a, e, width, height = np.reshape(about, (-1, 4)).T
    x, y = 2 * (180 - a), 2 * (90 - e)
    corners = np.stack([x - width, y - height, x + width, y + height], axis=-1)
    return Evidence.from_boxes(corners, ErpGrid(360, 720), detector=model, stamp=float(stamp))


WHOLE, PART = (30, 0, 40, 40), (42, 8, 8, 8)  # a thing, and a box on its corner


def seen_in_parts(parts):
    """What is known after looks at a thing of which each third shows a part, here and there."""
    model = replace(MODEL, spread=math.radians(1), spread_of_size=0.2, parts=parts)
    random, looks = np.random.default_rng(5), []
    for stamp in range(30):
        corner = 30 + 12 * random.uniform(-1, 1), 12 * random.uniform(-1, 1), 8, 8
        looks.append(boxes_look([corner] if stamp % 3 == 2 else [WHOLE], stamp, model))
    return after(looks).hypotheses, model


def test_a_box_on_a_part_of_a_known_thing_is_no_news_to_what_moves():
    (with_parts, model), (without, _) = seen_in_parts(0.15), seen_in_parts(0.0)
    there = boxes_look([PART], 99, model)
    scan = Scan.of([there], FLAT.degree, 99.0, np.eye(3), None)
    heard = with_parts.look_alikes.heard(scan, SPREAD)
    assert float(heard.parts.sum()) > 1  # a false alarm there is rarer
    assert float(heard.parts.sum()) > 3 * float(heard.own.sum())
    beyond = Scan.of([boxes_look([(120, 0, 8, 8)], 99, model)], FLAT.degree, 99.0, np.eye(3), None)
    assert float(with_parts.look_alikes.heard(beyond, SPREAD).parts.sum()) < 1e-6
    assert with_parts.moving < without.moving


def test_the_size_of_a_thing_is_the_mean_of_its_boxes_and_points_have_no_parts():
    hypotheses, _ = seen_in_parts(0.15)
    known = hypotheses.look_alikes
    best = known.boxes[int(known.odds.argmax())]
    assert best[1] / best[0] == pytest.approx(math.radians(20), rel=0.1)
    points = after([look([HERE], stamp) for stamp in range(5)]).hypotheses.look_alikes
    scan = Scan.of([look([HERE], 99)], FLAT.degree, 99.0, np.eye(3), None)
    assert not points.heard(scan, SPREAD).parts.any()


# --- the drift of the odometry ----------------------------------------------------------------------------------------


def drifting(rate, seed=0, model=MODEL, config=LEARNT):
    """The last estimate, and where the place then seems to be, if the heading drifts by `rate` degrees a look."""
    random, looks = np.random.default_rng(seed), []
    for stamp in range(40):
        turned = HERE[None] @ rotation([0, 0, 1], math.radians(rate * stamp)).T
        seen = turned[random.random(1) < 0.8]
        looks.append(look(unit(seen + 0.04 * random.standard_normal(seen.shape)), stamp, model))
    return after(looks, config), turned[0]


@pytest.mark.parametrize("seed", range(3))
def test_poses_that_drift_untold_are_noticed(seed):
    estimate, there = drifting(1.0, seed)
    assert estimate.drift == DRIFT
    assert angular_distance(estimate.direction, there) < math.radians(12)
    assert estimate.mass_above(there) < 0.95
    assert drifting(1.0, seed, config=FLAT)[0].credible_angle < estimate.credible_angle


@pytest.mark.parametrize("seed", range(3))
def test_poses_that_do_not_drift_are_trusted_as_if_that_were_known(seed):
    estimate, there = drifting(0.0, seed)
    assert estimate.drift == 0
    known, _ = drifting(0.0, seed, config=FLAT)
    assert angular_distance(estimate.direction, known.direction) < math.radians(1)
    assert estimate.credible_angle == pytest.approx(known.credible_angle, rel=0.1)
    assert angular_distance(estimate.direction, there) < math.radians(6)


def test_one_thing_that_moves_among_others_that_stand_is_no_drift():
    random, stand, tracker = np.random.default_rng(4), np.array([THERE, -HERE]), DirectionTracker(LEARNT)
    for stamp in range(40):
        seen = np.concatenate([stand, [rotation([0, 0, 1], math.radians(4 * stamp)) @ HERE]])
        seen = unit(seen[random.random(3) < 0.9] + 0.04 * random.standard_normal(3))
        tracker.observe(look(seen, stamp))
    assert tracker.estimate(39.0).drift == 0


def test_a_drift_that_is_told_is_believed():
    """Whatever the looks say; and without look-alikes (looks are independent) nothing tells it."""
    assert drifting(1.0, config=FLAT)[0].drift == 0
    assert drifting(0.0, config=replace(LEARNT, drift=0.02))[0].drift == 0.02
    alone = replace(MODEL, look_alikes=0, detection_probability=0.8)
    assert drifting(1.0, model=alone)[0].drift == 0


def test_what_one_place_explains_is_not_explained_again():
    """The density of a look's detections, for no place, one, and one that is written down twice."""
    known = after([look([HERE], stamp) for stamp in range(12)]).hypotheses.look_alikes
    best = int(known.odds.argmax())
    names = "points", "covariances", "shares", "odds", "levels", "boxes"
    none, once, twice = (
        altered(known, **{name: getattr(known, name)[[best] * count] for name in names}) for count in range(3)
    )
    scan = Scan.of([look([HERE], 99)], FLAT.degree, 99.0, np.eye(3), None)
    alarms = ClutterRate.prior(MODEL)

    def evidence(places):
        return places.evidence(places.heard(scan, SPREAD), alarms, np.zeros(1))

    number, heard = float(alarms.weights @ alarms.numbers), once.heard(scan, SPREAD)
    new, own = float(heard.new.sum()), float(heard.own[0, 0])
    there = float(known.levels[best] @ known.habits.alike_levels / (1 + math.exp(-known.odds[best])))
    assert evidence(none) == pytest.approx(math.log(number + new))
    assert evidence(once) == pytest.approx(math.log((1 - there) * (number + new) + own))
    assert evidence(once) > evidence(none) + 2
    # Either of the two was found, and the other was missed.
    assert evidence(twice) == pytest.approx(math.log((1 - there) ** 2 * (number + new) + 2 * (1 - there) * own))
