"""Lines between the guard and its parent: whatever happens to the bytes, only whole messages come out."""

import math
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import HOSTILE

from eagor.robots.safety.gate import Mode, Output, Stop
from eagor.robots.safety.limits import Body, Fault, Limits, Velocity
from eagor.robots.safety.messages import (
    LONGEST,
    GuardSettings,
    GuardState,
    LineReader,
    as_line,
    cut,
    read_now,
    write_now,
)

values = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20)
messages = st.dictionaries(st.text(max_size=8), values | st.lists(values, max_size=3), max_size=6)


@HOSTILE
@given(st.lists(messages, max_size=6), st.lists(st.integers(1, 40), min_size=1))
def test_messages_come_whole_however_the_bytes_are_cut(sent, cuts):
    data, reader, got = b"".join(map(as_line, sent)), LineReader(), []
    while data:
        for size in cuts:
            got += reader.feed(data[:size])
            data = data[size:]
    assert got == sent
    assert reader.damaged == 0


@HOSTILE
@given(messages, messages, st.data())
def test_a_damaged_line_is_dropped_and_the_next_one_is_read(first, second, data):
    line = bytearray(as_line(first))
    kind = data.draw(st.sampled_from(["cut", "flip", "joined", "noise"]))
    at = data.draw(st.integers(0, len(line) - 2))
    if kind == "cut":
        line = line[:at] + b"\n"
    elif kind == "flip":
        line[at] ^= data.draw(st.integers(1, 255))
    elif kind == "joined":
        line = line[: at + 1]  # no line break: the next line is lost with it
    else:
        line = bytearray(data.draw(st.binary(max_size=100))) + b"\n"
    reader = LineReader()
    got = reader.feed(bytes(line) + as_line(second) + as_line({"last": 1}))
    assert got[-1] == {"last": 1}
    assert all(message in (first, second, {"last": 1}) for message in got)


@HOSTILE
@given(st.text(max_size=400), st.integers(1, 150))
def test_words_are_cut_to_bytes_and_ten_of_them_fit_into_a_line(text, most):
    short = cut(text, most)
    assert len(short.encode()) <= most
    assert short.isprintable()
    assert LineReader().feed(as_line({"words": [short] * 10, "numbers": [0.123456789012345] * 20}))


def test_the_worst_words_fit():
    worst = cut('"' * 400, 150)
    (message,) = LineReader().feed(as_line({"faults": [("parent", worst)] * 5, "remarks": [worst] * 5}))
    assert message["remarks"] == [worst] * 5


@pytest.mark.parametrize("send", [None, Velocity(0.3, 0.0, -0.1), Stop(7)])
def test_what_the_guard_did_comes_back_from_its_line(send):
    output = Output(send, Mode.STOPPING, (Fault("tilt", "the robot is tilted"),), ("a remark",), would=send)
    state = GuardState.of(1.5, output, Body(1.4, 0.1, 0.2, 0.3, 0.4), stops=7, posture=3, problem="Move: no answer")
    (message,) = LineReader().feed(as_line(state.as_message()))
    assert GuardState.from_message(message) == state
    assert state.sent == (send if isinstance(send, Velocity) else None)
    assert state.reasons == ("the robot is tilted", "a remark", "Move: no answer")
    assert math.isnan(GuardState.of(1.5, output, None, stops=7).roll)


def test_settings_come_back_from_their_text():
    settings = GuardSettings(True, "remote", 3, "eth0", True, 2.0, Limits(calm_codes=(0, 7)))
    assert GuardSettings.from_json(settings.to_json()) == settings


def test_not_a_number_and_infinity_pass():
    (message,) = LineReader().feed(as_line({"a": math.nan, "b": -math.inf}))
    assert math.isnan(message["a"])
    assert message["b"] == -math.inf


def test_what_a_pipe_does_not_take_at_once_is_refused():
    with pytest.raises(ValueError, match="at once"):
        as_line({"a": "x" * LONGEST})


def test_noise_without_an_end_takes_no_memory():
    reader = LineReader()
    for _ in range(100):
        assert reader.feed(b"x" * 10000) == []
    assert reader.damaged
    assert len(reader._rest) <= LONGEST
    assert reader.feed(b"\n" + as_line({"a": 1})) == [{"a": 1}]


def test_a_pipe_that_is_full_or_closed_holds_nobody_up():
    there, here = os.pipe()
    os.set_blocking(there, False)
    os.set_blocking(here, False)
    assert read_now(there) == b""
    line = as_line({"a": "x" * 1000})
    sent = 0
    while write_now(here, line):
        sent += 1
    assert not write_now(here, line)
    reader = LineReader()
    data = read_now(there)
    assert len(reader.feed(data)) == sent
    assert reader.damaged == 0
    os.close(here)
    assert read_now(there) is None
    os.close(there)
