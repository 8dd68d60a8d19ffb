"""The policy on the body turns first, walks only towards what is ahead, stops where it should, and never at random."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.errors import EagorError
from eagor.robots.safety.walking import Sight, Walk, WalkSettings, walk

RULES = WalkSettings()
STEP = 0.05
angles = st.floats(-math.pi, math.pi)
statuses = st.sampled_from(["searching", "tracking", "ambiguous", "stale"])
sights = st.builds(
    Sight,
    stamp=st.floats(0, 5), status=statuses, azimuth=st.none() | angles, elevation=st.floats(-1.57, 1.57),
    distance=st.none() | st.floats(0.01, 50), spread=st.none() | st.floats(0, 3),
    xy=st.none() | st.tuples(st.floats(-3, 3), st.floats(-3, 3)), yaw=st.none() | angles,
)  # fmt: skip


def played(goal, seconds=60.0, told=None, spread=0.1, start=(0.0, 0.0, 0.0), slide=1.0, goals=None):
    """Walk a Go2 (dead time 0.15 s, lag 0.3 s) to a point; the path (x, y, yaw) and the wishes."""
    x, y, yaw = start
    speed, pipe, state, path, wishes = np.zeros(3), [np.zeros(3)] * 3, Walk(), [], []
    for index in range(int(seconds / STEP)):
        now = index * STEP
        goal = goal if goals is None else goals(now)
        dx, dy = goal[0] - x, goal[1] - y
        azimuth = math.remainder(math.atan2(dy, dx) - yaw, 2 * math.pi)
        far = None if told is False else math.hypot(dx, dy)
        sight = Sight(now, "tracking", azimuth, 0.0, far, None if far is None else spread, (x, y), yaw)
        state, wish = walk(RULES, state, sight)
        pipe.append(np.array(wish.velocity.parts) * (0.8, 0.74, 0.9))
        speed = speed + (1 - math.exp(-STEP / 0.3)) * (pipe.pop(0) - speed)
        yaw += speed[2] * STEP
        x += slide * speed[0] * math.cos(yaw) * STEP
        y += slide * speed[0] * math.sin(yaw) * STEP
        path.append((x, y, yaw))
        wishes.append(wish)
    return np.array(path), wishes


@given(st.lists(sights, min_size=1, max_size=12))
def test_it_walks_only_towards_what_is_tracked_and_ahead(many):
    state = Walk()
    for sight in sorted(many, key=lambda each: each.stamp):
        state, wish = walk(RULES, state, sight)
        velocity = wish.velocity
        assert velocity.finite
        assert velocity.left == 0
        assert 0 <= velocity.forward <= RULES.speed
        assert abs(velocity.turn) <= max(RULES.turn, RULES.search_turn)
        assert wish.words
        if velocity.walks:
            assert sight.status == "tracking"
            assert abs(sight.azimuth) <= RULES.cone
            assert wish.doing == "walking"
        if sight.status in ("ambiguous", "stale") and sight.azimuth is not None:
            assert velocity.still
        if sight.status == "tracking" and sight.azimuth is not None and velocity.turn:
            assert math.copysign(1, velocity.turn) == math.copysign(1, sight.azimuth)


@settings(max_examples=25)
@given(st.floats(1.6, 6), angles)
def test_it_gets_there_and_stops_at_the_distance(far, direction):
    goal = (far * math.cos(direction), far * math.sin(direction))
    path, wishes = played(goal, seconds=40)
    assert wishes[-1].doing == "arrived"
    assert math.dist(path[-1][:2], goal) == pytest.approx(RULES.distance, abs=0.12)
    nearest = np.hypot(*(path[:, :2] - goal).T).min()
    assert nearest > RULES.distance - 0.12
    walked = np.hypot(*np.diff(path[:, :2], axis=0).T).sum()
    assert walked <= 1.15 * far  # it turned before it walked: no wide curve
    assert abs(math.remainder(math.atan2(*(np.array(goal) - path[-1, :2])[::-1]) - path[-1, 2], 2 * math.pi)) < 0.2


@pytest.mark.parametrize(
    ("free", "words"), [(0.0, "it walks"), (0.3, "it walks"), (0.7, "in the way"), (1.0, "in the way")]
)
def test_only_the_time_that_the_gate_lets_it_walk_counts_as_stuck(free, words):
    """Ten seconds on the spot, free in that share of each second. The gate, or a dry run, holds it for the rest."""
    state, said = Walk(), ""
    for index in range(200):
        sight = Sight(index * STEP, "tracking", 0.0, 0.0, 5.0, 0.1, (0.0, 0.0), 0.0)
        state, wish = walk(RULES, state, sight, held=index % 20 >= 20 * free)
        said = wish.words
    assert words in said


def test_it_turns_in_place_first():
    path, wishes = played((0.0, 3.0))
    first = next(index for index, wish in enumerate(wishes) if wish.doing == "walking")
    assert np.hypot(*path[first - 1, :2]) < 1e-9
    assert all(wish.doing == "turning" for wish in wishes[:first])


def test_it_follows_what_goes_away():
    path, wishes = played(None, goals=lambda now: (2.0 if now < 20 else 3.5, 0.0))
    assert wishes[int(19 / STEP)].doing == "arrived"
    assert math.dist(path[-1][:2], (3.5, 0)) == pytest.approx(RULES.distance, abs=0.12)


def test_without_a_distance_it_goes_slowly_and_only_so_far():
    path, wishes = played((100.0, 0.0), told=False)
    assert max(wish.velocity.forward for wish in wishes) <= RULES.blind_speed
    assert RULES.blind <= path[-1][0] < RULES.blind + 0.2
    assert "not known after 3 m" in wishes[-1].words


def test_a_distance_of_large_spread_is_none():
    _, sure = walk(RULES, Walk(), Sight(0.0, "tracking", 0.0, 0.0, 5.0, 0.2))
    _, unsure = walk(RULES, Walk(), Sight(0.0, "tracking", 0.0, 0.0, 5.0, 1.0))
    assert sure.velocity.forward > 0.3
    assert unsure.velocity.forward <= RULES.blind_speed


def test_it_stops_where_the_thing_may_be_very_near():
    _, wish = walk(RULES, Walk(), Sight(0.0, "tracking", 0.0, 0.0, 0.5, 0.3))
    assert not wish.velocity.walks
    rules = replace(RULES, distance=0.3)
    _, wish = walk(rules, Walk(), Sight(0.0, "tracking", 0.0, 0.0, 0.5, 0.3))
    assert not wish.velocity.walks
    assert "may be as near as 0.4 m" in wish.words


def test_held_up_it_stands_and_says_so():
    _, wishes = played((4.0, 0.0), slide=0.0, seconds=10)
    assert wishes[-1].doing == "holding"
    assert "in the way" in wishes[-1].words


def test_it_searches_towards_where_the_thing_was_and_gives_up_after_two_turns():
    state, yaw = Walk(), 0.0
    state, _ = walk(RULES, state, Sight(0.0, "tracking", -0.5, 0.0))
    state, _ = walk(RULES, state, Sight(0.05, "tracking", -0.5, 0.0))
    turned = 0.0
    for index in range(2, 2000):
        state, wish = walk(RULES, state, Sight(index * STEP, "searching", None, xy=(0.0, 0.0), yaw=yaw))
        if wish.doing == "holding":
            break
        assert wish.velocity.turn == -RULES.search_turn
        yaw = math.remainder(yaw + wish.velocity.turn * STEP, 2 * math.pi)
        turned += abs(wish.velocity.turn) * STEP
    assert turned == pytest.approx(4 * math.pi, abs=0.1)
    assert "2 turns" in wish.words
    state, wish = walk(RULES, state, Sight(200.0, "tracking", 1.0, 0.0))
    assert wish.velocity.turn > 0
    _, wish = walk(RULES, state, Sight(200.05, "searching", None))
    assert wish.doing == "searching"


@pytest.mark.parametrize("change", [{"distance": 0}, {"cone": 4}, {"ahead": 1.0}, {"blind": -1}, {"speed": math.nan}])
def test_settings_check_themselves(change):
    with pytest.raises(EagorError, match=next(iter(change))):
        WalkSettings(**change)
