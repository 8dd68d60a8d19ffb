"""Places have habits: what looks at one place have in common, and what that leaves for them to prove."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import betaln, logsumexp
from strategies import estimate_after, points_look, random_directions, rotations

from eagor.belief.bank import Bank, Shown
from eagor.evidence.detector import ClutterRate, DetectorModel, Spread
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.sphere import direction, unit, world_R_body
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.tracker import DirectionTracker

STILL = MotionModel.still()
FLAT = TrackerConfig(ranges=None, target_motion=STILL)
HABIT, ALIKE = (0.8, 0.8), (0.5, 2.0)  # beta distributions: of the thing, and of look-alikes
ONES = np.ones(1)
MODEL = DetectorModel(
    false_alarms_per_look=0.2, spread=math.radians(8), look_alikes=0, habit=HABIT, kept_for=None, offset=0.0
)
MANY = replace(MODEL, look_alikes=0.7, look_alike_habit=ALIKE)
HERE, THERE = direction(0.5, 0.1), direction(-1.9, -0.2)
SOME = random_directions(60, 7)


def look(places, stamp, model=MODEL, **more):
    return points_look(places, stamp, model, **more)


def after(looks, config=FLAT):
    return estimate_after(looks, config)


def odds(estimate):
    """log odds of presence, which were 0 before any look."""
    absent, *present = estimate.hypotheses.weights
    return math.log(sum(present) / absent)


def evidence(found, looks, beta):
    """log of the mean of p^found (1 - p)^(looks - found) over a beta distribution."""
    a, b = beta
    return float(betaln(a + found, b + looks - found) - betaln(a, b))


# --- habits -----------------------------------------------------------------------------------------------------------


def told(found, looks, shares, levels):
    """log of the probability of one sequence with so many looks that found the thing, by the levels of a habit."""
    return float(logsumexp(found * np.log(levels) + (looks - found) * np.log(1 - levels), b=shares))


def apart(found, looks, model=MANY):
    """log of the odds that such a place is the thing, and not one of the look-alikes."""
    habits = model.habits
    own, other = ((habits.shares, habits.levels), (habits.alike_shares, habits.alike_levels))
    return told(found, looks, *own) - told(found, looks, *other) - math.log(habits.look_alikes)


@given(st.floats(0.2, 5), st.floats(0.2, 5))
def test_levels_stand_for_the_beta_distribution(a, b):
    """The mean, any outcome of fifteen looks, and how often a thing is found never or always in forty."""
    habits = replace(MODEL, habit=(a, b)).habits
    assert habits.shares.sum() == pytest.approx(1)
    assert habits.mean == pytest.approx(a / (a + b), abs=0.02)
    for found in range(16):
        assert told(found, 15, habits.shares, habits.levels) == pytest.approx(evidence(found, 15, (a, b)), abs=0.5)
    for found in (0, 40):
        if (exact := evidence(found, 40, (a, b))) > math.log(0.02):
            assert told(found, 40, habits.shares, habits.levels) == pytest.approx(exact, abs=0.3)


@given(st.floats(0.1, 5), st.floats(0.1, 5), st.sampled_from([80, 1000, 10000]))
def test_the_share_of_hits_alone_says_only_so_much_of_who_is_there(a, b, looks):
    """However many looks there are, and whatever the habit of things: a tenth of the look-alikes have the same."""
    model = replace(MANY, habit=(a, b))
    most = -math.log(0.1 * model.habits.look_alikes)
    for missed in (0, 1, looks // 2, looks):
        assert apart(looks - missed, looks, model) <= most + 1e-9


def test_one_miss_among_eighty_looks_decides_nothing():
    """Always found and nearly always found are hardly told apart."""
    always = apart(80, 80)
    assert apart(79, 80) == pytest.approx(always, abs=0.05)
    assert apart(77, 80) == pytest.approx(always, abs=0.35)
    assert apart(40, 80) < always - 1, "half of the looks is another matter"


# --- a bank -----------------------------------------------------------------------------------------------------------


def spoken(seed, looks=12, places=40):
    """What looks say at some places: v, and S, which is 0 where nothing was detected."""
    rng = np.random.default_rng(seed)
    share = rng.choice([0.0, 1.0, 1.0, rng.random()], (looks, places))
    return share, rng.choice([0.0, 1.0], (looks, places)) * np.exp(rng.normal(0, 3, (looks, places)))


def by_sum(levels, shares, share, ratio):
    """log of the sum over levels p of w(p) prod_t (1 - p v_t + p v_t S_t)."""
    gains = 1 + np.multiply.outer(levels, share * (ratio - 1))
    return np.log(shares @ gains.prod(axis=1))


def banked(habits, share, ratio, anew=0.0):
    """log T after all looks; before each of them but the first a share `anew` of the places draws its habit anew."""
    bank, total = Bank.blank(habits, share.shape[1:]), 0.0
    for t, (v, s) in enumerate(zip(share, ratio, strict=True)):
        bank, shown = bank.renewed(anew if t else 0.0), Shown(v, s[None])
        total = total + np.log(shown.gains(bank.recall)[0])
        bank = bank.after(shown, ONES)
    return total, bank


@pytest.mark.parametrize("seed", range(5))
def test_a_bank_tells_the_sum_over_all_habits(seed):
    """log T look by look, with what the looks before have taught; so for look-alikes, and for what was missed."""
    habits = replace(MANY, habit=(1.7, 0.9)).habits
    share, ratio = spoken(seed)
    total, bank = banked(habits, share, ratio)
    assert total == pytest.approx(by_sum(habits.levels, habits.shares, share, ratio), rel=1e-10, abs=1e-10)
    alike = by_sum(habits.alike_levels, habits.alike_shares, share, ratio)
    assert bank.lead == pytest.approx(alike - total, rel=1e-9, abs=1e-9)
    assert bank.missed == pytest.approx(by_sum(habits.levels, habits.shares, share, 0 * ratio), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("anew", [0.0, 0.2, 1.0])
def test_a_habit_that_may_be_drawn_anew_is_summed_over_all_times_when_it_was(anew):
    habits = replace(MODEL, habit=(1.7, 0.9)).habits
    share, ratio = spoken(3, looks=5)
    total, _ = banked(habits, share, ratio, anew)
    expected = 0.0
    for drawn in itertools.product([False, True], repeat=4):
        begins = [0, *(t + 1 for t in range(4) if drawn[t]), 5]
        lasting = [slice(a, b) for a, b in itertools.pairwise(begins)]
        logs = sum(by_sum(habits.levels, habits.shares, share[part], ratio[part]) for part in lasting)
        expected = expected + math.prod(anew if new else 1 - anew for new in drawn) * np.exp(logs)
    assert total == pytest.approx(np.log(expected), rel=1e-9, abs=1e-9)


def test_another_detector_draws_its_habits_anew_and_what_was_learnt_of_places_stays():
    _, bank = banked(MANY.habits, *spoken(0))
    other = replace(MANY, habit=(3.0, 1.0)).habits
    found = bank.for_sensor(other)
    assert found.recall == pytest.approx(np.full(40, other.mean))
    assert np.array_equal(found.lead, bank.lead)
    assert np.array_equal(found.missed, bank.missed)


# --- what follows -----------------------------------------------------------------------------------------------------


def turned_looks(model, count=10, seed=2):
    """Looks of a turning camera at a thing with false alarms; their poses."""
    rng = np.random.default_rng(seed)
    poses, looks = [], []
    for t in range(count):
        pose = world_R_body(0.7 * t, 0.3 * math.sin(t))
        places = [unit(HERE + 0.1 * rng.normal(size=3))] if rng.random() < 0.7 else []
        places += list(unit(rng.normal(size=(rng.poisson(0.3), 3))))
        poses.append(pose)
        looks.append(look([pose.T @ place for place in places], t, model))
    return poses, looks


@pytest.mark.parametrize("habit", [{"detection_probability": 0.7}, {"habit": (490.0, 210.0)}])
def test_without_look_alikes_and_with_a_known_habit_each_look_is_independent(habit):
    """Section 8: the product of 1 - P_D + P_D S over looks; the sum of that over widths that the tracker considers."""
    grid, widths = ErpGrid(180, 360), Spread.unsure()
    poses, looks = turned_looks(replace(MODEL, **habit))
    log = np.zeros((len(widths.scales), *grid.shape)) + widths.logs[:, 0]
    tracker = DirectionTracker(FLAT)
    for pose, each in zip(poses, looks, strict=True):
        tracker.add_pose(each.stamp, pose)
        tracker.observe(each)
        said = each.detections.speaks(grid.directions @ pose, widths.scales, ClutterRate.prior(MODEL))[0]
        log += np.log(0.3 + 0.7 * said)
    ratio = np.exp(log).sum(axis=0)
    mean = float(np.sum(ratio * grid.weights)) / (4 * math.pi)
    estimate = tracker.estimate(looks[-1].stamp)
    exact = 0.1 if "detection_probability" in habit else 0.2  # a habit lies between two of the levels
    assert odds(estimate) == pytest.approx(math.log(mean), abs=exact)
    near = grid.directions @ HERE > math.cos(math.radians(12))
    told = estimate.log_density(grid.directions[near] @ estimate.world_R_body)
    expected = np.log(ratio[near] / mean / (4 * math.pi))
    mass = np.exp(expected) * grid.weights[near]
    assert mass @ np.abs(told - expected) / mass.sum() < 0.1


@pytest.mark.parametrize(("found", "looks"), [(2, 4), (5, 10), (20, 40), (10, 10), (30, 40), (4, 20)])
def test_looks_at_one_place_saturate_at_what_habits_tell_apart(found, looks):
    """Of a place that is found in k of n looks the odds are those of its habit for the thing, and for a look-alike."""
    seen = [look([HERE] if found * (t + 1) // looks > found * t // looks else [], t, MANY) for t in range(looks)]
    assert odds(after(seen)) == pytest.approx(apart(found, looks), abs=0.2)
    alone = [replace(each, detections=each.detections.read(MODEL)) for each in seen]
    assert odds(after(alone)) > odds(after(seen)) + 1


def test_two_places_are_weighed_by_their_habits():
    """One that is found in eight of ten looks, one in three: each is the thing or a look-alike by its own share."""
    found = (np.arange(10) * 7 % 10 < 8), (np.arange(10) * 3 % 10 < 3)
    estimate = after([look([p for p, f in zip((HERE, THERE), found, strict=True) if f[t]], t, MANY) for t in range(10)])
    logs = [apart(k, 10) for k in (8, 3)]
    assert odds(estimate) == pytest.approx(np.logaddexp(*logs), abs=0.1)
    weights = [mode.weight for mode in estimate.modes]
    assert weights == pytest.approx(np.exp(logs - np.logaddexp(*logs)), abs=0.03)


@pytest.mark.parametrize("alikes", [0.0, 0.7])
def test_a_score_counts_once_for_each_place(alikes):
    """However often it is told: nine looks with it say as much more than nine without as three looks do."""
    plain = replace(MANY, look_alikes=alikes)
    scored, more = replace(plain, score_ratios=((0.2, 0.2), (0.9, 3.0))), []
    for looks in (3, 9):
        told = [
            odds(after([look([HERE], t, model, scores=[0.9]) for t in range(looks)]))
            for model in (replace(plain, score_ratios=((0.5, 1.0), (0.9, 1.0))), scored)
        ]
        more.append(told[1] - told[0])
    assert more == pytest.approx([math.log(3)] * 2, abs=0.05)


def test_a_miss_costs_what_the_place_has_taught():
    """Three of ten looks found it: one more miss costs log(1 - 0.33), not log(1 - 0.9) nor that of the prior."""
    a, b = HABIT
    seen = [look([HERE] if t % 4 == 1 else [], t) for t in range(10)]
    cost = odds(after([*seen, look([], 10)])) - odds(after(seen))
    assert cost == pytest.approx(math.log(1 - (a + 3) / (a + b + 10)), abs=0.03)
    assert cost == pytest.approx(math.log(1 - 0.3), abs=0.1)
    always = [look([HERE], t) for t in range(10)]
    assert odds(after([*always, look([], 10)])) - odds(after(always)) < -2


@pytest.mark.parametrize("model", [MODEL, MANY])
def test_the_order_of_looks_does_not_matter(model):
    places = [[HERE], [], [HERE, THERE], [THERE], [], [unit(HERE + 0.1)], [HERE]]
    first = after([look(places[k], t, model) for t, k in enumerate(range(7))])
    for order in ((6, 5, 4, 3, 2, 1, 0), (1, 4, 3, 0, 2, 6, 5)):
        other = after([look(places[k], t, model) for t, k in enumerate(order)])
        assert odds(other) == pytest.approx(odds(first), abs=0.1)
        assert other.direction @ first.direction > math.cos(math.radians(0.5))
        told = [each.log_density(SOME) for each in (first, other)]
        assert np.exp(told[0]) == pytest.approx(np.exp(told[1]), abs=0.02)


@given(st.lists(rotations(), min_size=5, max_size=5))
@settings(max_examples=4)
def test_the_same_world_gives_the_same_belief_however_the_body_is_turned(turns):
    """Of whole looks, and of views that cover the same part of the world from cameras mounted otherwise."""
    places = [[HERE], [], [HERE, THERE], [unit(HERE + 0.1)], [THERE]]

    def told(turns):
        tracker = DirectionTracker(FLAT)
        for t, (turn, seen) in enumerate(zip(turns, places, strict=True)):
            tracker.add_pose(float(t), turn)
            grid = PerspectiveGrid(60, 80, 1.5, turn.T @ world_R_body(0.5)) if t % 2 else None
            seen = [place for place in seen if grid is None or place @ HERE > 0.9]
            tracker.observe(look([turn.T @ place for place in seen], t, MANY, grid=grid))
        return tracker.estimate(4.0)

    first, other = told([np.eye(3)] * 5), told(turns)
    assert other.presence == pytest.approx(first.presence, abs=2e-3)
    assert other.world_R_body @ other.direction == pytest.approx(first.direction, abs=2e-3)
    turned = other.log_density(SOME @ other.world_R_body)
    assert np.exp(turned) == pytest.approx(np.exp(first.log_density(SOME)), abs=5e-3)


@pytest.mark.parametrize("model", [MODEL, MANY])
def test_what_was_never_looked_at_gains_nothing(model):
    """However often the front is looked at, with the thing there or not, the likelihood ratio behind stays 1."""
    behind = SOME[SOME[:, 0] < -0.3]
    for seen in ([], [direction(0.1, 0.0)]):
        view = PerspectiveGrid(40, 60, 1.2)
        estimate = after([look(seen, t, model, grid=view) for t in range(8)])
        assert estimate.hypotheses.standing.field(behind) == pytest.approx(np.zeros(len(behind)), abs=0.1)
        bank = estimate.hypotheses.standing.bank.at_cells(estimate.hypotheses.standing.grid, behind)
        assert bank.recall == pytest.approx(np.full(len(behind), model.habits.mean), abs=0.01)


def seen_from(apart, config, looks=10, thing=(40.0, 10.0, 2.0)):
    """log odds after looks that all find the thing, the second half of them from a place `apart` metres beside."""
    tracker = DirectionTracker(config)
    for t in range(looks):
        position = np.array([0.0, apart * (2 * t // looks), 0.0])
        tracker.add_pose(float(t), np.eye(3), position)
        tracker.observe(look([unit(thing - position)], t, replace(MANY, kept_within=1.0)))
    return odds(tracker.estimate(looks - 1.0))


def test_a_camera_that_has_moved_on_gains_new_evidence():
    """Five looks each from two spots prove as much as two places would, and ten from one spot less."""
    stays, near, far = (seen_from(apart, FLAT) for apart in (0.0, 0.5, 5.0))
    assert stays < near < far
    half, whole = (apart(n, n) for n in (5, 10))
    assert stays == pytest.approx(whole, abs=0.1)
    assert far == pytest.approx(2 * half + math.log(MANY.look_alikes), abs=0.2)
    # With ranges as well; those tell nothing of presence from one place.
    walking = TrackerConfig(target_motion=STILL)
    assert seen_from(0.0, walking) == pytest.approx(stays, abs=0.3)
    assert min(seen_from(apart, walking) for apart in (0.5, 1.0, 2.0)) > max(2.5, seen_from(0.0, walking) + 0.2)


def test_time_lets_habits_go_as_distance_does():
    found = {}
    for pause in (0.0, 10.0, 1e4):
        stamps = [0.1 * t + pause * (t // 5) for t in range(10)]
        found[pause] = odds(after([look([HERE], stamp, replace(MANY, kept_for=60.0)) for stamp in stamps]))
    assert found[0.0] < found[10.0] < found[1e4]
    renewed = DetectorModel(kept_for=2.0, kept_within=1.0).habits.renewal_probability(1.0, 3.0)
    assert renewed == pytest.approx(-math.expm1(-3.5))


def test_being_hidden_costs_its_share_once_for_each_view_point():
    """From a share of the view points a thing cannot be seen: all empty looks from one cost no more than that."""
    model = replace(MODEL, detection_probability=0.7, hidden=0.4, kept_within=0.1)
    tracker = DirectionTracker(FLAT)
    for k in range(12):
        tracker.add_pose(k, np.eye(3), [10.0 * (k // 4), 0, 0])  # four looks from each of three view points
        tracker.observe(look([], k, model))
        cost = math.log(0.4 + 0.6 * 0.3 ** (k % 4 + 1)) + k // 4 * math.log(0.4 + 0.6 * 0.3**4)
        assert odds(tracker.estimate(k)) == pytest.approx(cost, abs=1e-6)


# --- drift ------------------------------------------------------------------------------------------------------------


def test_a_drift_that_is_told_does_not_make_a_look_alike_sure():
    """What the drift blurs is learnt anew from each look; that is no new evidence of who is there."""
    looks = [look([HERE], stamp, MANY) for stamp in range(30)]
    exact = odds(after(looks))
    drifting = odds(after(looks, replace(FLAT, drift=math.radians(1))))
    assert drifting == pytest.approx(exact, abs=0.5)
