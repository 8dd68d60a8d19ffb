"""The table of ``eagor track``: its width, its columns, and distances that say how little is known."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eagor.cli.answers import SHORT, header, line
from eagor.drawing.style import distance_in_words, status_in_words
from eagor.lab.agents.methods import NAMES
from eagor.sphere import direction

RIVALS = [name for name in NAMES if name != "eagor"]


@dataclass
class Frame:
    """As wide as an answer can be: azimuth and elevation with signs, an ambiguous answer."""

    azimuth: float | None = math.radians(-179.9)
    elevation: float | None = math.radians(-89.9)
    credible_angle: float = math.radians(179.9)
    status: str = "ambiguous"
    modes: tuple = (1, 2, 3)
    stamp: float = 12345.678
    distance: float | None = 4.0
    distance_spread: float | None = 0.69
    others: dict = field(default_factory=dict)

    @property
    def estimate(self):
        return self

    @property
    def direction(self):
        return None if self.azimuth is None else direction(self.azimuth, self.elevation)


def everyone(azimuth=-179.6, elevation=-89.6):
    found = direction(math.radians(azimuth), math.radians(elevation))
    return dict.fromkeys(RIVALS, found)


def ends(text):
    """Where the words of a line end."""
    return [at for at, letter in enumerate(text) if letter != " " and text[at + 1 : at + 2] in ("", " ")]


def test_the_columns_fit_on_a_terminal_and_end_where_their_names_end():
    widest, shown = line(Frame(others=everyone())), line(Frame(others=everyone(12, 3)))
    assert len(header(RIVALS)) == len(widest) <= 120
    assert ends(header(RIVALS))[-len(RIVALS) :] == ends(shown)[-len(RIVALS) :]
    assert ends(header(RIVALS))[:4] == ends(shown)[:4]
    assert max(len(header()), len(line(Frame()))) <= 80, "alone it is narrow"


def test_short_names_differ_and_unknown_ones_are_cut():
    assert len(set(header(RIVALS).split()[-len(RIVALS) :])) == len(RIVALS)
    assert set(SHORT) <= set(RIVALS)
    assert header(["a_method_of_your_own"]).endswith(" a_method")


def test_what_is_not_known_is_a_dash():
    nothing = Frame(azimuth=None, elevation=None, status="searching", modes=(), distance=None)
    assert line(nothing).split() == ["12345.678", "-", "-", "-", "-", "0", "searching"]
    nothing.others = dict.fromkeys(RIVALS)
    assert line(nothing).split() == ["12345.678", "-", "-", "-", "searching", *["-"] * len(RIVALS)]
    rival = line(Frame(others={"vmf": direction(math.radians(62.9), math.radians(-3.2))}))
    assert rival.endswith(" +63/-3"), "whole degrees"


@pytest.mark.parametrize(
    ("distance", "spread", "words"),
    [
        (3.76, 0.963, ""),  # "give or take 162 %"
        (3.02, 0.544, "1.1 to 6.4 m"),
        (3.76, 0.05, "3.5 to 4.1 m"),
        (3.76, 0.001, "3.8 m"),
        (3.76, 0.0, "3.8 m"),
        (0.6, 0.3, "0.4 to 0.9 m"),
        (120.0, 0.5, "47 to 240 m"),
        (0.02, 0.2, "0.014 to 0.027 m"),
        (None, 0.1, ""),
        (3.0, None, ""),
        (math.inf, 0.1, ""),
        (3.0, math.nan, ""),
    ],
)
def test_distances_are_intervals(distance, spread, words):
    assert distance_in_words(distance, spread) == words


@given(median=st.floats(0.5, 200), spread=st.floats(0.05, 0.69))
def test_nine_of_ten_log_normal_distances_are_inside(median, spread):
    """Quantiles of the log-normal: the interval holds what it says, up to the rounding to two digits."""
    mean = median * math.exp(spread**2 / 2)
    words = distance_in_words(mean, spread).removesuffix(" m").split(" to ")
    lowest, highest = (median * math.exp(spread * z) for z in (-1.645, 1.645))
    assert float(words[0]) == pytest.approx(lowest, rel=0.06, abs=0.051)
    assert float(words[-1]) == pytest.approx(highest, rel=0.06, abs=0.051)


def test_the_interval_is_a_decade_at_most():
    known = [spread for spread in np.linspace(0.01, 1.5, 150) if distance_in_words(4.0, float(spread)) != ""]
    assert math.exp(2 * 1.645 * max(known)) == pytest.approx(10, rel=0.05)


def test_what_searching_means_agrees_with_the_probability_of_presence():
    assert status_in_words("searching", 0.99).startswith("it is likely here")
    assert status_in_words("searching", 0.3).startswith("it may not be here")
    assert status_in_words("tracking", 0.99).startswith("more likely than not")
