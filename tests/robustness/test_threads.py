"""Trackers in threads: eight that share nothing never wait for each other, and one that is shared loses nothing."""

import sys
import threading

import numpy as np
import pytest

from eagor._values import lazy
from eagor.evidence import Evidence
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.tracker import DirectionTracker

THREADS = 8
PATIENCE = 120  # seconds: threads that have not ended by then wait for each other


@pytest.fixture
def fast_switching():
    """Threads take turns as often as the interpreter lets them."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def run(work):
    """Call ``work(number)`` in eight threads; errors are raised here, and threads that hang are named."""
    errors = []

    def guarded(number):
        try:
            work(number)
        except Exception as error:
            errors.append(error)

    # Daemons: threads that hang shall not keep the test run from ending.
    threads = [threading.Thread(target=guarded, args=(number,), daemon=True) for number in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert not [thread.name for thread in threads if thread.is_alive()]
    if errors:
        raise errors[0]


def test_trackers_that_share_nothing_do_not_wait_for_each_other(fast_switching):
    said = [None] * THREADS

    def work(number):
        tracker = DirectionTracker(TrackerConfig(degree=7))
        for step in range(6):
            stamp = 0.5 * step
            tracker.add_pose(stamp, np.eye(3), np.array([0.2 * step, 0.0, 1.0]))
            tracker.observe(Evidence.from_points([[1.0, 0.2, 0.0]], stamp=stamp))
            estimate = tracker.estimate(stamp)
            said[number] = estimate.status, estimate.distance, estimate.credible_angle

    run(work)
    assert len(set(said)) == 1


def test_a_shared_tracker_keeps_every_look(fast_switching):
    config = TrackerConfig(degree=3, ranges=None, target_motion=MotionModel.still())
    shared, alone, steps = DirectionTracker(config), DirectionTracker(config), 40
    meet = threading.Barrier(THREADS)

    def look(number):
        return Evidence.from_points([[1.0, 0.2, 0.0]], stamp=0.1 * number)

    def work(number):
        for step in range(steps):
            meet.wait(PATIENCE)  # all begin with a new target at once
            shared.observe(look(number), target=f"thing {step}")

    run(work)
    for number in range(THREADS):
        alone.observe(look(number))
    wanted = alone.estimate(1.0).presence
    found = [shared.estimate(1.0, f"thing {step}").presence for step in range(steps)]
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_lazy_values_of_two_objects_are_computed_at_the_same_time():
    meet = threading.Barrier(THREADS)

    class Thing:
        @lazy
        def value(self):
            return meet.wait(PATIENCE)  # all of them are in here, or none gets out

    run(lambda number: Thing().value)
