"""Lines about faults: each is told once, however often it comes and goes."""

from hypothesis import given
from hypothesis import strategies as st

from eagor.robots.live.answers import Fault
from eagor.robots.live.news import CALM, News


def poses(age: float) -> Fault:
    return Fault("poses", f"the last pose holds for {age:.2f} s already", 0.0)


def test_a_fault_that_comes_and_goes_is_told_once_and_its_end_when_it_is_over():
    news, lines = News(), []
    for tick in range(200):
        now = 0.1 * tick
        flaps = now < 10 and tick % 10 > 3  # poses come once a second
        lines += [(round(now, 1), *line) for line in news.of([poses(now)] if flaps else [], now)]
    assert lines == [
        (0.4, "the last pose holds for 0.40 s already", True),
        (12.9, "poses: all is well again", False),
    ]


def test_other_words_and_other_parts_are_told_apart():
    news = News()
    gone, back = Fault("camera", "no picture for 1.0 s", 0.0), Fault("camera", "the stream broke off", 0.0)
    assert news.of([gone], 1.0) == [("no picture for 1.0 s", True)]
    assert news.of([back, poses(0.1)], 1.5) == [
        ("the stream broke off", True),
        ("the last pose holds for 0.10 s already", True),
    ]
    assert news.of([poses(0.2)], 1.5 + CALM) == [("camera: all is well again", False)]
    assert news.of([gone, poses(0.2)], 2 + CALM) == [("no picture for 1.0 s", True)]


@given(st.lists(st.booleans(), min_size=1, max_size=100))
def test_no_fault_is_hidden(there):
    """Whenever something is wrong, it has been told since the part was last said to be well."""
    news, open_ = News(), False
    for tick, wrong in enumerate(there):
        for _, bad in news.of([poses(1.0)] if wrong else [], 0.7 * tick):
            open_ = bad
        assert open_ or not wrong
