"""What else is here: every class is followed as if it had been asked for from the first look on."""

from dataclasses import replace

import numpy as np
import pytest

from eagor import DirectionTracker, Evidence, TrackerConfig
from eagor.live.core import LiveCore, LoopSettings
from eagor.live.events import AllCame, Asked, EvidenceCame, Following, FrameCame, PoseCame
from eagor.live.recording import event_from, event_in_bytes
from eagor.media import Pose
from eagor.sphere import world_R_body
from eagor.tracking import Around, Surroundings
from eagor.tracking.surroundings import MOST

CONFIG = TrackerConfig(degree=7)
PLACES = {"chair": (1.0, 0.3, 0.0), "tv": (-1.0, 0.5, 0.2), "dog": (0.1, -1.0, -0.3)}
FIRST = {"chair": 0, "tv": 3, "dog": 7}  # the look that sees each first


def pose(stamp):
    return world_R_body(0.4 * stamp)


def look(stamp, number, names=tuple(PLACES)):
    """What is seen of the things that are in sight at a look, and what is said of all others."""

    def of(places):
        return Evidence.from_points(np.array(places).reshape(-1, 3) @ pose(stamp), stamp=stamp)

    return Around({name: of([PLACES[name]]) for name in names if number >= FIRST[name]}, of([]))


def test_a_thing_that_is_seen_late_was_looked_for_in_every_look_before():
    around, alone = Surroundings(CONFIG), {name: DirectionTracker(CONFIG) for name in PLACES}
    for number in range(12):
        stamp = number / 2
        seen = look(stamp, number)
        around.move(stamp, pose(stamp))
        assert around.look(seen)
        assert not around.look(seen.at(stamp + 0.1)), "the one before is still being taken in"
        while around.behind:
            around.take_in()
        for name, tracker in alone.items():
            tracker.add_pose(stamp, pose(stamp))
            tracker.observe(seen.found.get(name, seen.nothing))
    things = around.things(6.0)
    assert {each.query: (each.looks, each.among, each.last) for each in things} == {
        name: (12 - first, 12, 5.5) for name, first in FIRST.items()
    }
    assert [each.sure for each in things] == sorted((each.sure for each in things), reverse=True)
    for each in things:
        wanted = alone[each.query].estimate(6.0)
        np.testing.assert_allclose(each.estimate.direction, wanted.direction, atol=1e-9)
        assert each.estimate.presence == pytest.approx(wanted.presence, abs=1e-9)
        assert each.estimate.credible_angle == pytest.approx(wanted.credible_angle, abs=1e-9)


def test_what_was_not_seen_for_longest_is_forgotten_beyond_the_most():
    around = Surroundings(CONFIG)
    there = Evidence.from_points([[1.0, 0.0, 0.0]], stamp=0.0)
    nothing = Evidence.from_points(np.zeros((0, 3)), stamp=0.0)
    assert around.look(Around({f"thing {number}": there for number in range(MOST)}, nothing))
    while around.behind:
        around.take_in()
    kept = {f"thing {number}": there for number in range(1, MOST)}
    assert around.look(Around({**kept, "new": there}, nothing).at(1.0))
    assert {*around.names} == {*kept, "new"}


def test_a_new_query_begins_with_what_was_seen_and_the_others_do_not_notice():
    events = []
    for number in range(10):
        stamp = number / 2
        seen = look(stamp, number)
        events += [
            PoseCame(stamp, Pose(stamp, pose(stamp))),
            FrameCame(stamp, stamp, str(number)),
            EvidenceCame(stamp, stamp, stamp, "chair", (seen.found["chair"],)),
            AllCame(stamp, stamp, stamp, seen),
            *(Asked(stamp + 0.11 * tick) for tick in range(5)),
        ]
    asked = [Following(5.0, ("chair", "dog")), Asked(5.0)]
    written = [event if isinstance(event, FrameCame) else event_from(event_in_bytes(event)) for event in events]

    def answers(events, queries=("chair",), **settings):
        core = LiveCore(LoopSettings(queries, CONFIG, **settings))
        return core, [answer for event in events for answer in core.take(event)]

    def exact(answers):
        return [answer.as_dict(exact=True) for answer in answers]

    core, told = answers([*events, *asked], around=0.05)
    _, cold = answers([*events, *asked])
    assert exact(told[:-1]) == exact(cold[:-1]), "of what was asked for before"
    assert exact(answers([*written, *asked], around=0.05)[1]) == exact(told), "a recording gives the same"
    both = []
    for event in events:
        both += [event]
        if isinstance(event, AllCame):
            seen = event.around.found.get("dog", event.around.nothing)
            both += [EvidenceCame(event.arrival, event.stamp, event.told, "dog", (seen,))]
    wanted, dog = answers([*both, *asked], ("chair", "dog"))[1][-1], told[-1]
    np.testing.assert_allclose(dog.direction, wanted.direction, atol=1e-6)
    assert dog.estimate.presence == pytest.approx(wanted.estimate.presence, abs=1e-3)
    assert cold[-1].direction is None, "without, nothing is known of it yet"
    assert {each.query for each in core.around.things(5.0)} == set(PLACES)
    other = replace(CONFIG, degree=8)
    with pytest.raises(Exception, match="TrackerConfig"):
        DirectionTracker(other).begin("dog", "dog", core.around.tracker)
