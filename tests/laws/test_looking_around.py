"""A searcher faces the look that tells most, until it is sure; what it looks at keeps to what it expects of a space."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.lab.agents.search_space import RAYS, Chance, SearchedGround, Space, SteeringInput, turn_angle
from eagor.lab.agents.steering import Searcher
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.hstar.agents import LENS, PITCHES, YAWS, EagorAgent, Search, SimulatedDetector, ViewEvidence
from eagor.lab.tasks.hstar.rules import View
from eagor.perception.truth import Noise
from eagor.sphere import world_R_body

TURN = math.radians(30)
ROWS, HEIGHT = 64, 1.25
UNSURE, SURE = 0.1, 0.9


@dataclass
class Told:
    """A space that tells what the test says."""

    headings: np.ndarray
    told: np.ndarray

    def tells(self):
        return self.told


def circle(told):
    """As many level headings, evenly around."""
    azimuths = np.arange(len(told)) * 2 * math.pi / len(told)
    return Told(np.column_stack([azimuths, np.zeros(len(told))]), np.array(told, dtype=float))


def towards(degrees, elevation=0.0):
    return np.radians([degrees, elevation])


def faced(searcher, facing, sure=UNSURE):
    """Degrees that it wants to face; None: it acts."""
    found = searcher.face(facing, sure)
    return None if found is None else np.degrees(found).round(6).tolist()


@given(
    st.lists(st.floats(0, 1), min_size=2, max_size=12),
    st.floats(-180, 180),
    st.one_of(st.just(math.inf), st.floats(5, 180)),
)
def test_it_faces_what_tells_most_for_what_it_costs(told, facing, turn):
    space, now = circle(told), towards(facing)
    chosen = Searcher(space, turn=math.radians(turn)).face(now, UNSURE)
    angles = [abs(math.degrees(math.remainder(azimuth - now[0], 2 * math.pi))) for azimuth in space.headings[:, 0]]
    if math.isinf(turn):
        worth = [nats - 1e-5 * angle for nats, angle in zip(told, angles, strict=True)]
    else:  # 0.25 m for each step of a turn that stands, and 0.8 m for every goal
        steps = [math.ceil(angle / turn - 1e-9) for angle in angles]
        worth = [nats / (0.25 * count + 0.8) for nats, count in zip(told, steps, strict=True)]
        worth = [0.0 if angle < 1e-4 else value for value, angle in zip(worth, angles, strict=True)]
    best = next(index for index, heading in enumerate(space.headings) if (heading == chosen).all())
    assert worth[best] == pytest.approx(max(worth), abs=1e-8)


def test_a_heading_is_kept_until_it_is_faced():
    searcher = Searcher(circle([0.1, 0.1, 1.0, 0.1]), turn=TURN)
    for degrees in (0, 30, 60, 90, 120, 150):
        assert faced(searcher, towards(degrees)) == [180, 0]
        searcher.space.told = np.array([0.1, 2.0, 0.2, 0.1])  # another look would tell more now
    assert faced(searcher, towards(180)) == [90, 0]


def test_it_hands_over_when_it_is_sure_and_comes_back_with_a_fresh_choice():
    searcher = Searcher(circle([0.1, 0.1, 1.0, 0.1]), commit_threshold=0.5, turn=TURN)
    assert faced(searcher, towards(0)) == [180, 0]
    assert searcher.searching
    for sure in (0.5, SURE):
        assert faced(searcher, towards(30), sure) is None
        assert not searcher.searching
    searcher.space.told = np.array([0.1, 1.0, 0.1, 0.1])
    assert faced(searcher, towards(30)) == [90, 0]
    assert searcher.searching


def situation(yaw=0.0, chance=None):
    """A level body on an endless floor."""
    below = np.broadcast_to(np.arange(ROWS)[:, None] >= ROWS // 2, (ROWS, 2 * ROWS))
    position = np.array([0.0, 0.0, HEIGHT])
    return SteeringInput(0.0, UNSURE, 1.0, None, position, world_R_body(yaw), below, chance)


def hstar_space(looked):
    view = View(0.0, 0.0)
    search = Search.begin("hos")
    nothing = Evidence.from_response(np.full(LENS.shape, 0.02), LENS, Calibration(0.2, 0.05, 3.0))
    return (search.update(nothing, view.world_R_view, view) if looked else search), view.heading


def ground_space(looked, hfov):
    ground = SearchedGround(Camera(hfov=math.degrees(hfov)))
    ground.look(situation(chance=Chance() if looked else None))
    return ground, np.zeros(2)


SPACES = {
    "views": (hstar_space, len(YAWS) * len(PITCHES)),
    "ground, all around": (lambda looked: ground_space(looked, 2 * math.pi), 1),
    "ground, 100 degrees": (lambda looked: ground_space(looked, math.radians(100)), RAYS),
}


@pytest.mark.parametrize("name", SPACES)
def test_a_space_says_in_nats_what_each_of_its_headings_tells(name):
    make, count = SPACES[name]
    space: Space = make(looked=True)[0]
    assert space.headings.shape == (count, 2)
    assert (np.abs(space.headings[:, 1]) <= math.pi / 2).all()
    told = space.tells()
    assert told.shape == (count,)
    assert np.isfinite(told).all()
    assert (told >= -1e-12).all()
    assert told.max() > 0
    np.testing.assert_array_equal(space.tells(), told, "to ask changes nothing")


@pytest.mark.parametrize("name", SPACES)
def test_a_look_that_was_just_taken_tells_less(name):
    make, _ = SPACES[name]
    (before, facing), (after, _) = make(looked=False), make(looked=True)
    there = int(turn_angle(before.headings, facing).argmin())
    assert after.tells()[there] < 0.9 * before.tells()[there]


def test_our_agent_goes_on_from_any_start_and_submits_at_its_last_turn():
    """Its rotations are whole degrees: what it meant to look at counts as looked at where it starts between them."""
    nothing = Evidence.from_response(np.full(LENS.shape, 0.02), LENS, Calibration(0.2, 0.05, 3.0))
    agent = EagorAgent(Search.begin("hos"), lambda view: ViewEvidence(nothing, view.world_R_view))
    view, seen = View(17.4, 3.0), set()
    for _ in range(6):
        view = view.after(agent(view, False).action)
        seen.add((round(view.yaw), round(view.pitch)))
    assert len(seen) >= 5
    assert agent(view, True).action.kind == "submit"


@given(st.integers(0, 2**16), st.sampled_from([0.0, 45.0, 17.4, 359.5]), st.sampled_from(["hos", "hps"]))
@settings(max_examples=8)
def test_our_agent_rotates_to_the_view_that_tells_most_and_of_equal_ones_to_the_nearest(seed, start, kind):
    """In H*Bench's degrees, yaw to the right: a degree less to turn is worth 1e-5 nats."""
    detector = SimulatedDetector((200.0, 208.0), (-20.0, -12.0), Noise.parse("ideal,miss=0.4,false_alarm=0.3"), seed)
    agent = EagorAgent(Search.begin(kind), detector, sure=1.0)
    view = View(start, 0.0)
    for _ in range(6):
        now, view = view, view.after(agent(view, False).action)

        def off(view):
            return np.abs((YAWS - view.yaw + 180) % 360 - 180) + np.abs(np.array(PITCHES)[:, None] - view.pitch)

        taken = off(view)
        assert taken.min() <= 0.5 + 1e-9, "rotations are whole degrees"
        worth = agent.searcher.space.tells() - 1e-5 * off(now).reshape(-1)
        assert worth[taken.argmin()] >= worth.max() - 1e-9


def test_a_robot_that_stands_turns_to_what_the_searcher_faces():
    """The steps of `walk` with the step 0 lead to the headings of `face`, by at most `turn` each."""
    one, other = (Searcher(SearchedGround(Camera(hfov=100.0)), turn=TURN) for _ in range(2))
    yaw = 0.0
    for _ in range(30):
        now = situation(yaw, chance=Chance())
        turn, metres = one.walk(now)
        other.space.look(now)
        wanted = math.remainder(float(other.face(np.array([now.yaw, 0.0]), now.progress)[0]) - now.yaw, 2 * math.pi)
        assert metres == 0
        assert one.searching
        assert turn == pytest.approx(math.copysign(min(abs(wanted), TURN), wanted), abs=1e-9)
        yaw += turn


def test_elevation_costs_as_azimuth_does():
    space = Told(np.array([towards(40, 0), towards(0, 30)]), np.array([1.0, 1.0]))
    assert faced(Searcher(space), towards(0)) == [0, 30]
    assert faced(Searcher(space, turn=TURN), towards(0)) == [0, 30]
