"""Two clocks are related by their messages, whatever the network does; a clock that is set is noticed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eagor.errors import TimeError
from eagor.odometry.clocks import ClockOffset, ClockSync, LatencyFilter

RATE = 50.0


def sent(seconds, offset, drift=0.0, delay=0.002, jitter=0.0, seed=0, start=1000.0):
    """Stamps and arrivals: a robot's clock that is `offset` behind ours and loses `drift` seconds per second."""
    draw = np.random.default_rng(seed)
    times = start + np.arange(int(seconds * RATE)) / RATE
    late = delay + (draw.exponential(jitter, times.size) if jitter else 0.0)
    return times - offset - drift * (times - start), times + late


@given(st.floats(-1e6, 1e6), st.floats(-5e-5, 5e-5), st.floats(0.0, 0.05), st.floats(0.0, 0.05), st.integers(0, 1999))
def test_the_offset_is_known_up_to_the_quickest_delay(offset, drift, delay, jitter, seed):
    clock = ClockOffset()
    stamps, arrivals = sent(20, offset, drift, delay, jitter, seed)
    jumps = [clock.add(stamp, arrival) for stamp, arrival in zip(stamps, arrivals, strict=True)]
    assert jumps == [None] * len(jumps)
    truth = offset + drift * 20
    # The quickest of 1000 messages is as late as the delay and a thousandth of the jitter; clocks part by 1 ms in 20 s.
    assert -1e-4 <= clock.offset - truth <= delay + 0.02 * jitter + 0.004


@given(st.lists(st.sampled_from([-3600.0, -5.0, -0.5, 0.5, 5.0, 3600.0]), max_size=2), st.integers(100, 400))
def test_single_wrong_stamps_change_nothing(errors, place):
    clock = ClockOffset()
    stamps, arrivals = sent(10, 3.0)
    stamps = stamps.copy()
    for number, error in enumerate(errors):
        stamps[place + 10 * number] += error
    for stamp, arrival in zip(stamps, arrivals, strict=True):
        assert clock.add(stamp, arrival) is None
    assert clock.offset == pytest.approx(3.002, abs=1e-3)


@given(st.floats(0.2, 1e5), st.booleans(), st.floats(0.0, 0.02))
def test_a_clock_that_is_set_is_noticed_within_a_second_and_followed(size, forward, jitter):
    clock = ClockOffset()
    stamps, arrivals = sent(20, 3.0, jitter=jitter)
    step = size if forward else -size
    after = stamps.size // 2
    stamps = stamps + step * (np.arange(stamps.size) >= after)
    found = {}
    for number, (stamp, arrival) in enumerate(zip(stamps, arrivals, strict=True)):
        if (jump := clock.add(stamp, arrival)) is not None:
            found[number] = jump
    (place,) = found
    assert after <= place <= after + RATE
    assert found[place].seconds == pytest.approx(step, abs=0.11)
    assert found[place].stamp >= stamps[after] - 1e-9
    assert clock.offset == pytest.approx(3.002 - step, abs=0.01)


@given(st.floats(0.3, 4.0))
def test_a_stall_is_no_jump(pause):
    """Messages that were held up come all at once: their stamps are still right."""
    clock = ClockSync("robot", latest=10.0)
    stamps, arrivals = sent(20, 0.0)
    held = (arrivals > arrivals[500]) & (arrivals < arrivals[500] + pause)
    arrivals = np.where(held, arrivals[500] + pause, arrivals)
    for stamp, arrival in zip(stamps, arrivals, strict=True):
        ours, said = clock.take(stamp, arrival)
        assert said is None
        assert ours == stamp


@given(st.floats(-0.04, 0.2))
def test_stamps_of_our_own_clock_stay_as_they_are(delay):
    clock = ClockSync("robot")
    for number in range(100):
        assert clock.take(number / RATE, number / RATE + delay) == (number / RATE, None)


@given(st.one_of(st.floats(-1e5, -0.06), st.floats(0.3, 1e5)), st.floats(0.0, 0.01))
def test_stamps_of_another_clock_are_shifted_and_it_is_said_once(offset, jitter):
    clock = ClockSync("robot")
    stamps, arrivals = sent(4, offset, delay=0.0, jitter=jitter)
    found = [clock.take(stamp, arrival) for stamp, arrival in zip(stamps, arrivals, strict=True)]
    said = [text for _, text in found if text]
    assert len(said) == 1
    assert ("behind" if offset > 0 else "ahead") in said[0]
    ours = np.array([stamp for stamp, _ in found[-50:]])
    assert np.abs(ours - (stamps + offset)[-50:]).max() <= 0.011 + jitter


def test_first_messages_that_come_late_are_no_clock_that_jumped():
    clock = ClockSync("camera")
    for number in range(100):
        stamp = number / RATE
        assert clock.take(stamp, stamp + (0.2 if number < 3 else 0.02))[1] is None


def test_a_clock_that_jumps_and_jumps_back_is_followed_in_words():
    clock = ClockSync("camera", latency=0.1)
    stamps, arrivals = sent(30, 0.0, delay=0.1)
    wrong = 3600.0 * ((np.arange(stamps.size) >= 500) & (np.arange(stamps.size) < 1000))
    found = [clock.take(stamp, arrival) for stamp, arrival in zip(stamps + wrong, arrivals, strict=True)]
    said = [text for _, text in found if text]
    assert said == [
        "the clock of the camera jumped forward by 3600.00 s; its stamps are shifted",
        "the clock of the camera jumped back by 3600.00 s, to this machine's time",
    ]
    unknown = [number for number, (ours, _) in enumerate(found) if ours is None]
    assert unknown == [500, 501, 1000, 1001]  # until three agree
    for number, (ours, _) in enumerate(found):
        assert ours is None or ours == pytest.approx(stamps[number], abs=2e-3)


@given(st.floats(-1e6, 1e6), st.floats(0, 0.05), st.floats(3e-4, 1.0), st.integers(0, 999))
def test_a_delay_that_grows_is_noticed_however_slowly_unless_clocks_drift_like_that(offset, jitter, growth, seed):
    """The other clock is `offset` behind, the delay grows without end: no growth hides the delay for good."""
    late, rng, most = LatencyFilter(), np.random.default_rng(seed), 0.0
    for arrival in np.arange(0.0, 0.4 / growth, max(0.005, 0.005 / growth)):
        delay = growth * arrival + jitter * rng.random()
        said = late.of(1e7 + arrival - delay - offset, arrival)
        assert said <= delay + 1e-6
        most = max(most, said)
    assert most > 0.1  # the limit of the gate


def test_states_that_come_late_for_good_stay_late_and_a_clock_that_is_set_does_not():
    late, arrival, said = LatencyFilter(), 0.0, []
    for index, delay in enumerate([0.001] * 400 + [0.3] * 4000):  # 2 s, then 20 s
        arrival += 0.005 if index != 400 else 0.304  # nothing comes meanwhile
        said.append(late.of(1e7 + arrival - delay, arrival))
    assert said[399] < 1e-3
    assert min(said[400:]) > 0.29
    for ahead in (5.0, -7.0):  # the other clock is set
        said = []
        for _ in range(40):
            arrival += 0.005
            said.append(late.of(1e7 + ahead + arrival - 0.001, arrival))
        assert said[-1] < 0.01
    assert late.of(0.0, arrival) == 0.0  # it tells no time


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), 1.7e18])
def test_what_is_no_time_is_refused(wrong):
    with pytest.raises(TimeError):
        ClockOffset().add(wrong, 1.0)
    with pytest.raises(TimeError):
        ClockOffset().add(1.0, wrong)
