"""What must hold of the search: evidence where one looked, honest information, answers that get better."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.lab.tasks.hstar import View, agents, submit_succeeds
from eagor.lab.tasks.hstar.agents import (
    ALARM,
    CELLS,
    HIT,
    LENS,
    PITCHES,
    YAWS,
    EagorAgent,
    SimulatedDetector,
    ViewEvidence,
    _shown_by,
)
from eagor.perception.truth import Noise
from eagor.tracking.next_view import information

poses = st.tuples(st.integers(0, 359), st.sampled_from(PITCHES))


def empty(view):
    """A detector that reports nothing."""
    evidence = Evidence.from_response(np.full(LENS.shape, 0.02), LENS, Calibration(0.2, 0.05, 3.0))
    return ViewEvidence(evidence, view.world_R_view)


def after(detector, *views, kind="hos"):
    """Our agent after looks at these views."""
    agent = EagorAgent(kind, detector)
    for view in views:
        agent.update(detector(view), view)
    return agent


@given(st.lists(poses, min_size=1, max_size=5))
@settings(max_examples=10)
def test_what_was_not_looked_at_keeps_its_odds_and_what_was_loses(views):
    state = after(empty, *(View(float(yaw), float(pitch)) for yaw, pitch in views))
    ratio = state.probability() / state.prior
    unseen = state.shown == 0
    assert unseen.any()
    np.testing.assert_allclose(ratio[unseen], ratio[unseen].max(), rtol=1e-9)
    # Well inside every view there is less left than outside.
    for yaw, pitch in views:
        view = View(float(yaw), float(pitch))
        middle = view.shows(CELLS.directions.reshape(-1, 3)).reshape(CELLS.shape)
        well = middle & (CELLS.directions @ view.world_R_view[:, 0] > math.cos(0.3))
        assert (ratio[well] < ratio[unseen].max()).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from(PITCHES), st.integers(0, len(YAWS) - 1))
@settings(max_examples=12)
def test_information_is_that_of_the_cells_that_the_view_shows(seed, pitch, turn):
    """Where the view has turned to; what a look tells is tested by its definition in test_next_look."""
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.full(CELLS.height * CELLS.width, 0.05)).reshape(CELLS.shape)
    new = rng.uniform(0.2, 1.0, CELLS.shape)
    shown = np.roll(_shown_by(View(0.0, float(pitch)))[1], int(YAWS[turn]) // 5, axis=1)
    seen = shown > 0
    falls = CELLS.weights[seen] / CELLS.weights[seen].sum()
    wanted = information(p[seen][None], (HIT * shown * new)[seen][None], ALARM, falls)
    assert agents._information(p, new, pitch)[turn] == pytest.approx(wanted[0], abs=1e-9)


@pytest.mark.parametrize("pitch", [-60, -30, 0, 30, 50])
@pytest.mark.parametrize("size", [4, 10, 24])
def test_one_clear_look_outweighs_what_was_not_looked_at(pitch, size):
    """However small the thing is in the picture: a sharp report must not say less than a broad one."""
    half = size / 2 / math.cos(math.radians(pitch))
    item = {"yaw": [(200 - half) % 360, (200 + half) % 360], "pitch": [pitch - size / 2, pitch + size / 2]}
    detector = SimulatedDetector((item["yaw"][0], item["yaw"][1]), (item["pitch"][0], item["pitch"][1]), Noise(), 0)
    view = View(210.0, float(pitch))
    answer = after(detector, view).answer()
    assert submit_succeeds(item, answer.yaw, answer.pitch, "strict")


def test_a_repeated_look_counts_for_less_and_one_that_comes_back_later_for_more(monkeypatch):
    monkeypatch.setattr(agents, "REPEATS", 0.5)
    here, away = View(0.0, 0.0), View(180.0, 0.0)

    def fall(*views):
        return -float(after(empty, *views).belief.log_ratio(CELLS)[18, 36])  # straight ahead

    once = fall(here)
    assert fall(here, here) == pytest.approx(1.5 * once, rel=0.05)
    assert fall(here, away, here) == pytest.approx(1.75 * once, rel=0.05)
    assert fall(here, here, here) == pytest.approx(2.0 * once, rel=0.05)


# The next view


@given(st.integers(0, 2**16), st.sampled_from([0.0, 45.0, 17.4, 359.5]), st.sampled_from(["hos", "hps"]))
@settings(max_examples=8)
def test_our_agent_rotates_to_the_view_that_tells_most_and_of_equal_ones_to_the_nearest(seed, start, kind):
    """In H*Bench's degrees, yaw to the right: a degree less to turn is worth 1e-5 nats."""
    detector = SimulatedDetector((200.0, 208.0), (-20.0, -12.0), Noise.parse("ideal,miss=0.4,false_alarm=0.3"), seed)
    agent = EagorAgent(kind, detector, sure=1.0)
    view = View(start, 0.0)
    for _ in range(6):
        now, view = view, view.after(agent(view, False)[0])

        def off(view):
            return np.abs((YAWS - view.yaw + 180) % 360 - 180) + np.abs(np.array(PITCHES)[:, None] - view.pitch)

        taken = off(view)
        assert taken.min() <= 0.5 + 1e-9, "rotations are whole degrees"
        worth = agent.tells() - 1e-5 * off(now).reshape(-1)
        assert worth[taken.argmin()] >= worth.max() - 1e-9
    assert agent(view, True)[0].kind == "submit", "at its last turn"
    assert kind == "hos" or agent.answer().pitch == 0, "paths are answered by yaw alone"
