"""What a chart of errors shows, and what it cannot be drawn from."""

import math

import numpy as np
import pytest

from eagor.drawing import charts
from eagor.errors import EagorError


def drawn(monkeypatch, stamps, errors, **how):
    """The matplotlib figure behind the picture, and what is written beside the axes, one text after the other."""
    sheets = []
    paint = charts.image
    monkeypatch.setattr(charts, "image", lambda sheet: sheets.append(sheet) or paint(sheet))
    picture = charts.draw_errors(stamps, errors, width=600, **how)
    assert picture.size == (600, 252)
    (sheet,) = sheets
    return sheet, [text.get_text() for text in sheet.texts]


def test_a_method_without_values_is_listed_last_with_a_dash(monkeypatch):
    sheet, texts = drawn(monkeypatch, [0.0, 0.5, 1.0], {"silent": [], "ours": [30.0, 20.0, 10.0], "short": [50.0]})
    assert texts[-9:] == ["■", "ours", "20.0°", "■", "short", "50.0°", "■", "silent", "–"]
    lengths = {line.get_label(): len(line.get_xdata()) for line in sheet.axes[0].lines}
    assert lengths == {"silent": 0, "ours": 3, "short": 1}


def test_what_is_not_known_is_a_gap_and_in_no_mean(monkeypatch):
    errors = {"ours": [10.0, None, 20.0], "lost": [None, None, None], "other": np.array([math.nan, 5.0, 7.0])}
    _, texts = drawn(monkeypatch, [0.0, 0.5, 1.0], errors)
    assert texts[-9:] == ["■", "other", "6.0°", "■", "ours", "15.0°", "■", "lost", "–"]


@pytest.mark.parametrize("errors", [{}, {"ours": []}, {"ours": [12.0]}])
def test_one_stamp_is_enough(monkeypatch, errors):
    _, texts = drawn(monkeypatch, [2.0], errors, shaded=[(1.5, 2.5, "away")], title="one look")
    assert "one look" in texts


@pytest.mark.parametrize("stamps", [[], np.zeros(0)])
def test_without_stamps_there_is_nothing_to_draw(stamps):
    for errors in ({}, {"ours": []}, {"ours": [1.0]}):
        with pytest.raises(EagorError, match="no stamps; wanted"):
            charts.draw_errors(stamps, errors)


def test_every_error_needs_its_stamp():
    with pytest.raises(EagorError, match="ours has 3 errors, but there are 2 stamps"):
        charts.draw_errors([0.0, 0.5], {"ours": [1.0, 2.0, 3.0]})
