"""Lines about faults: told when they begin and end, and now and then, however often they come and go."""

import threading

from hypothesis import given
from hypothesis import strategies as st

from eagor.live.events import AGAIN, CALM, Fault, FaultLog
from eagor.live.threads import LatestWorker


def poses(age: float) -> Fault:
    return Fault("poses", f"the last pose holds for {age:.2f} s already", 0.0)


def test_a_fault_that_comes_and_goes_is_told_once_and_its_end_when_it_is_over():
    news, lines = FaultLog(), []
    for tick in range(200):
        now = 0.1 * tick
        flaps = now < 10 and tick % 10 > 3  # poses come once a second
        lines += [(round(now, 1), *line) for line in news.of([poses(now)] if flaps else [], now)]
    assert lines == [
        (0.4, "the last pose holds for 0.40 s already", True),
        (12.9, "poses: all is well again", False),
    ]


def test_other_words_and_other_parts_are_told_apart():
    news = FaultLog()
    gone, back = Fault("camera", "no picture for 1.0 s", 0.0), Fault("camera", "the stream broke off", 0.0)
    assert news.of([gone], 1.0) == [("no picture for 1.0 s", True)]
    assert news.of([back, poses(0.1)], 1.5) == [
        ("the stream broke off", True),
        ("the last pose holds for 0.10 s already", True),
    ]
    assert news.of([poses(0.2)], 1.5 + CALM) == [("camera: all is well again", False)]
    assert news.of([gone, poses(0.2)], 2 + CALM) == [("no picture for 1.0 s", True)]


def told(there, step):
    """The lines about a fault that is there at the times ``step * k`` for which ``there(step * k)``."""
    news = FaultLog()
    return [
        (round(step * k, 3), *line)
        for k in range(round(3600 / step))
        for line in news.of([poses(step * k)] if there(step * k) else [], step * k)
    ]


def test_a_fault_that_lasts_an_hour_is_told_twice_a_minute_not_twenty_times_a_second():
    lines = told(lambda now: now < 3000, 0.05)
    begun = [when for when, _, wrong in lines if wrong]
    assert begun == [AGAIN * k for k in range(100)]
    assert lines[-1] == (3000 - 0.05 + CALM, "poses: all is well again", False)
    assert len(lines) == 101


def test_a_part_that_comes_and_goes_for_an_hour_does_not_fill_the_log():
    for period in (1.0, 5.0, 20.0, 45.0):
        lines = told(lambda now, period=period: now % period < 0.2, 0.05)
        assert len(lines) <= 2 + 2 * 3600 / AGAIN
        assert lines[0] == (0.0, "the last pose holds for 0.00 s already", True)


@given(st.lists(st.booleans(), min_size=1, max_size=100))
def test_no_fault_is_hidden(there):
    """Whenever something is wrong, it has been told since the part was last said to be well."""
    news, open_ = FaultLog(), False
    for tick, wrong in enumerate(there):
        for _, bad in news.of([poses(1.0)] if wrong else [], 0.7 * tick):
            open_ = bad
        assert open_ or not wrong


def test_only_the_newest_item_waits():
    taken, free = [], threading.Semaphore(0)

    def work(item):
        taken.append(item)
        free.acquire()

    worker = LatestWorker("test", work)
    worker.give(1)
    while not taken:
        pass
    for item in (2, 3, 4):
        worker.give(item)
    free.release(2)
    worker.close()
    assert taken == [1, 4]
    assert (worker.skipped, worker.idle) == (2, True)
