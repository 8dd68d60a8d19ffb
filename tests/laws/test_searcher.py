"""The floor that looks show is where it is; a body that searches sees all rooms, and goes to what is believed."""

import math

import numpy as np
import pytest
from box_scenes import scene_of, shell, thing

from eagor.evidence import Calibration, Evidence
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid
from eagor.lab.agents.search_space import (
    CONTACT,
    FLOOR,
    LEAST,
    UNKNOWN,
    Chance,
    FloorMap,
    SteeringInput,
)
from eagor.lab.agents.steering import Searcher, steering_for
from eagor.lab.envs.places import Place
from eagor.lab.envs.rules import Camera, NavigationRules
from eagor.lab.tasks.sim.navigation import backtracking_rate
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.render import Renderer
from eagor.sphere import direction, world_R_body

HEIGHT, STEP = 1.25, 0.25
CAMERA, CHANCE = Camera(), Chance()
WALLS = [thing("wall", (3.9, 0, 0), (4.1, 4.6, 2.5)), thing("wall", (3.9, 5.5, 0), (4.1, 6, 2.5))]
TWO_ROOMS = scene_of([*shell(8.0, 6.0), *WALLS, thing("wardrobe", (6.4, 1.0, 0), (7.0, 1.6, 1.8))])


class World:
    """A body in a scene, and what its camera shows of the floor."""

    def __init__(self, scene, xy, yaw=0.0, tilt=0.0):
        self.ground = Ground.from_scene(scene)
        self.place = Place(scene, self.ground, Renderer(scene))
        self.xy, self.yaw, self.tilt = np.array(xy, dtype=float), yaw, tilt

    @property
    def rotation(self):
        return world_R_body(self.yaw, self.tilt, -self.tilt)

    def situation(self, azimuth=0.0, progress=0.0, distance=None, presence=1.0, chance=CHANCE):
        position = np.array([*self.xy, HEIGHT])
        floor = self.place.floor_in(self.place.ids(position, self.rotation), position, self.rotation)
        return SteeringInput(azimuth, progress, presence, distance, position, self.rotation, floor, chance)

    def towards(self, goal):
        """The situation of a body that knows where the thing is, and whether it is there."""
        to = np.array(goal) - self.xy
        azimuth = math.remainder(math.atan2(to[1], to[0]) - self.yaw, 2 * math.pi)
        return self.situation(azimuth, 1.0, float(np.hypot(*to)))

    def step(self, turn):
        self.yaw = math.remainder(self.yaw + turn, 2 * math.pi)
        ahead = STEP * np.array([math.cos(self.yaw), math.sin(self.yaw)])
        self.xy, collided = self.ground.move(self.xy, ahead)
        return collided


def searching():
    searcher = steering_for(NavigationRules(), CAMERA)
    assert isinstance(searcher, Searcher)
    return searcher


def shown(known, xy):
    row, col = known.cells(np.array(xy))
    return int(known.state[row, col])


@pytest.mark.parametrize(("yaw", "tilt"), [(0.0, 0.0), (2.0, 0.0), (-1.0, 0.05)])
def test_a_look_shows_floor_walls_and_what_is_hidden(yaw, tilt):
    """The camera may be turned and tilted: the floor is where it is."""
    world, known = World(TWO_ROOMS, (2.0, 2.0), yaw, tilt), FloorMap()
    now = world.situation()
    known.observe(now)
    rows, cols = np.nonzero(known.state == FLOOR)
    places = known.centres(np.stack([rows, cols], axis=-1))
    away = np.hypot(*(places - world.xy).T)
    inside = (places > -0.15).all(axis=1) & (places[:, 0] < 4.05) & (places[:, 1] < 6.15)
    through = places[:, 0] > 3.9  # through the door, at most
    assert (inside | through)[away < 3].all()
    for xy in [(1.0, 1.0), (3.5, 2.0), (1.0, 4.0)]:
        assert shown(known, xy) == FLOOR
    assert shown(known, (6.0, 1.0)) == UNKNOWN  # behind the wall
    rows, cols = np.nonzero(known.state == CONTACT)
    stands = known.centres(np.stack([rows, cols], axis=-1))
    stands = stands[np.hypot(*(stands - world.xy).T) < 2.2]
    off = np.abs(np.stack([stands[:, 0], stands[:, 0] - 4.0, stands[:, 1], stands[:, 1] - 6.0])).min(axis=0)
    assert len(stands) > 20
    assert off.max() < 0.45  # at a wall, or one thickness of a thing behind it


@pytest.mark.parametrize(("goal", "goes_on"), [((6.0, 1.0), True), ((1.0, 5.5), False)])
def test_looks_that_miss_a_thing_count_where_it_would_be_in_sight(goal, goes_on):
    """One place is behind the wall, the other in the same room. The body walks there; then the presence sinks."""
    world, searcher = World(TWO_ROOMS, (3.2, 1.0)), searching()
    for step in range(4):
        to = np.array(goal) - world.xy
        azimuth = math.remainder(math.atan2(to[1], to[0]) - world.yaw, 2 * math.pi)
        presence = 1.0 if step < 3 else 0.01
        world.step(searcher.walk(world.situation(azimuth, 1.0, float(np.hypot(*to)), presence)))
        assert searcher.searching == (step == 3 and not goes_on)


def test_a_thing_is_come_to_from_another_side():
    """It is right behind the wall: the nearest place is on this side, and standing there is not enough."""
    goal = np.array([4.5, 1.0])
    world, searcher, places = World(TWO_ROOMS, (3.2, 1.0)), searching(), []
    for _ in range(120):
        if np.hypot(*(goal - world.xy)) < 0.5:
            break
        world.step(searcher.walk(world.towards(goal)))
        places.append(world.xy)
    assert np.hypot(*(goal - world.xy)) < 0.5
    assert backtracking_rate(np.array(places), STEP) < 0.25


def test_what_cannot_be_reached_is_given_up_for_a_while():
    """Behind a wall without a door: the body tries places beside it, searches for as many steps, and tries again."""
    closed = scene_of([*shell(8.0, 6.0), thing("wall", (3.9, 0, 0), (4.1, 6, 2.5))])
    world, searcher, searched = World(closed, (1.0, 3.0)), searching(), []
    for _ in range(260):
        world.step(searcher.walk(world.towards((6.0, 3.0))))
        searched.append(searcher.searching)
    assert not any(searched[:5])
    tries, searches, *_ = np.diff([0, *np.flatnonzero(np.diff(searched)) + 1])
    assert abs(searches - tries) <= 1
    assert not searched[-1]


FADING = Chance(0.5, 0.9, DetectorModel(kept_for=1.0).habits, elapsed=50.0)


@pytest.mark.parametrize(
    ("chance", "first", "again"),
    [(Chance(0.5), 0.5, 0.5), (Chance(0.4, 0.75), 0.6, 0.6**0.25), (FADING, 0.5, 0.5), (None, 1.0, 1.0)],
    ids=["recall", "repeats its mistakes", "mistakes that fade", "could not be read"],
)
def test_looks_count_by_their_recall_and_not_again_for_what_they_repeat(chance, first, again):
    world, ground = World(TWO_ROOMS, (2.0, 3.0)), FloorMap(CAMERA.radius)
    missed = []
    for _ in range(3):
        ground.observe(world.situation(chance=chance))
        row, col = ground.cells(np.array([2.6, 3.0]))
        missed.append(ground.miss_cost[row, col])
    assert missed == pytest.approx([first, first * again, first * again**2])
    assert shown(ground, (2.6, 3.0)) == FLOOR


@pytest.mark.parametrize(("chance", "steps"), [(CHANCE, 60), (None, 100), (Chance(LEAST), 100), (Chance(1.0), 100)])
def test_it_searches_both_rooms_whatever_its_looks_can_find_and_does_not_go_to_and_fro(chance, steps):
    world, searcher, places = World(TWO_ROOMS, (1.0, 1.0), 0.3), searching(), []
    for _ in range(steps):
        world.step(searcher.walk(world.situation(chance=chance)))
        places.append(world.xy)
    assert np.array(places)[:, 0].max() > 4.5
    assert shown(searcher.known, (6.0, 3.0)) == FLOOR
    if chance is CHANCE:
        early = np.array(places)[: int((np.array(places)[:, 0] > 4.5).argmax())]
        gone = np.hypot(*np.diff(early, axis=0).T).sum()
        assert gone < 2.0 * np.hypot(*(early[-1] - early[0])) + 2.0


def test_steps_that_lead_back_count():
    straight = np.column_stack([0.25 * np.arange(11), np.zeros(11)])
    there_and_back = np.concatenate([straight, straight[-2::-1]])
    rates = [backtracking_rate(way, 0.25) for way in (straight, there_and_back, straight[:1])]
    assert rates == pytest.approx([0.0, 0.5, 0.0])


# --- what chance evidence states to find a thing ---

GRID = ErpGrid(16, 32)


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


def test_only_what_was_covered_counts():
    coverage = np.zeros(GRID.shape)
    coverage[:, :4] = 1.0
    found = Evidence.from_response(np.zeros(GRID.shape), GRID, stamp=0.0, coverage=coverage)
    whole = Evidence.from_response(np.zeros(GRID.shape), GRID, stamp=0.0)
    assert Chance.of(whole, 0.5).recall > 0.05
    assert Chance.of(found, 0.5).recall == pytest.approx(Chance.of(whole, 0.5).recall)


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_response_whose_silence_says_nothing_still_finds_things(level):
    read = Calibration(floor=0.5, neutral=0.0)
    chance = Chance.of(Evidence.from_response(np.full(GRID.shape, level), GRID, read, stamp=0.0), 0.5)
    assert chance.recall == LEAST
