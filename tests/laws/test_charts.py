"""What a chart of errors shows, and what it cannot be drawn from."""

import math

import numpy as np
import pytest

from eagor.drawing import still
from eagor.errors import EagorError


@pytest.fixture
def sheets(monkeypatch):
    """The matplotlib figures behind the pictures."""
    found, paint = [], still.image
    monkeypatch.setattr(still, "image", lambda sheet: found.append(sheet) or paint(sheet))
    return found


def drawn(sheets, stamps, errors, **how):
    """The figure, and what is written beside the axes, one text after the other."""
    assert still.draw_errors(stamps, errors, width=600, **how).size == (600, 252)
    return sheets[-1], [text.get_text() for text in sheets[-1].texts]


def test_a_method_without_values_is_listed_last_with_a_dash(sheets):
    sheet, texts = drawn(sheets, [0.0, 0.5, 1.0], {"silent": [], "ours": [30.0, 20.0, 10.0], "short": [50.0]})
    assert texts[-9:] == ["■", "ours", "20.0°", "■", "short", "50.0°", "■", "silent", "–"]
    lengths = {line.get_label(): len(line.get_xdata()) for line in sheet.axes[0].lines}
    assert lengths == {"silent": 0, "ours": 3, "short": 1}


def test_what_is_not_known_is_a_gap_and_in_no_mean(sheets):
    errors = {"ours": [10.0, None, 20.0], "lost": [None, None, None], "other": np.array([math.nan, 5.0, 7.0])}
    _, texts = drawn(sheets, [0.0, 0.5, 1.0], errors)
    assert texts[-9:] == ["■", "other", "6.0°", "■", "ours", "15.0°", "■", "lost", "–"]


def test_axes_and_intervals_are_named(sheets):
    sheet, texts = drawn(sheets, [0.0, 0.5], {"ours": [30.0, 20.0]}, shaded=[(0.0, 0.2, "out of sight")])
    assert "mean direction error over the run" in texts
    assert [text.get_text() for text in sheet.axes[0].texts] == ["out of sight"]
    assert sheet.axes[0].get_ylabel() == "direction error (degrees, log scale)"


@pytest.mark.parametrize("errors", [{}, {"ours": []}, {"ours": [12.0]}])
def test_one_stamp_is_enough(sheets, errors):
    _, texts = drawn(sheets, [2.0], errors, shaded=[(1.5, 2.5, "away")], title="one look")
    assert "one look" in texts


def test_every_error_needs_its_stamp():
    for errors in ({}, {"ours": []}, {"ours": [1.0]}):
        with pytest.raises(EagorError, match="no stamps; wanted"):
            still.draw_errors(np.zeros(0), errors)
    with pytest.raises(EagorError, match="ours has 3 errors, but there are 2 stamps"):
        still.draw_errors([0.0, 0.5], {"ours": [1.0, 2.0, 3.0]})


def test_methods_that_are_nearly_right_can_be_told_apart_beside_one_that_is_lost(sheets):
    """The axis is logarithmic, says so, and holds every error; what is below its least is drawn there."""
    errors = {"ours": [4.0, 2.0, 0.0], "close": [8.0, 6.0, 4.0], "lost": [170.0, 175.0, 180.0]}
    sheet, _ = drawn(sheets, [0.0, 0.5, 1.0], errors)
    (axes,) = sheet.axes
    assert "log scale" in axes.get_ylabel()
    at = {line.get_label(): axes.transAxes.inverted().transform(line.get_transform().transform(line.get_xydata()))
          for line in axes.lines}  # fmt: skip
    assert at["close"][1, 1] - at["ours"][1, 1] > 0.15
    assert all(0 <= height <= 1 for places in at.values() for height in places[:, 1])
    assert [line.get_ydata()[-1] for line in axes.lines if line.get_label() == "ours"] == [still.LEAST]
