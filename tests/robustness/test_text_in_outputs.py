"""Promised: words that came from outside stay words in what is written: no tag, no link, no formula, no TeX."""

import csv
import io

import numpy as np
import pytest
from PIL import Image

from eagor.cli import main
from eagor.cli.answers import as_csv
from eagor.drawing.still import draw_errors
from eagor.lab.eval.page import Cell, Row, Table, markdown
from eagor.lab.worlds.painted import painted_room

EVIL = "<script>alert(1)</script> ![x](http://e.x/p) | `a` \\"


def test_markdown_shows_names_as_they_are():
    table = Table(
        EVIL, (EVIL, EVIL), (Row(EVIL, (Cell(EVIL, EVIL),), "ours"), Row(EVIL, (Cell(EVIL),))), (EVIL, "a\n# b")
    )
    text = markdown(EVIL, [{EVIL: EVIL}], [table])
    assert "<script" not in text
    assert "](" not in text.replace("\\](", "")
    assert "\n# b" not in text
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert [line.replace("\\|", "").count("|") for line in rows] == [3] * 4
    assert "p < 0.05" in markdown("t", [], [Table("t", ("a",), (), ("p < 0.05",))])


@pytest.mark.parametrize("text", ["=1+1", "+1+1", "-1+1", "@SUM(A1)", "\t=1", "\r=1", "=HYPERLINK(1)"])
def test_no_cell_of_a_csv_file_is_a_formula(text):
    ((cell, *numbers),) = csv.reader(io.StringIO(as_csv([(text, -1.5, "-1.5", None)]), newline=""))
    assert cell == f"'{text}".replace("\r", "\n")
    assert numbers == ["-1.5", "-1.5", ""]


@pytest.fixture
def room(tmp_path):
    Image.fromarray(painted_room(24, 48)).save(tmp_path / "=a.png")
    return tmp_path


@pytest.mark.parametrize("query", ["red $\\frac{$", "red $x^{", "red $$", "red $\\notacommand$"])
def test_a_query_with_dollars_is_drawn_as_it_is(room, query):
    words = ["--perception", "colour", "--picture", str(room / "where.png")]
    assert main(["locate", str(room / "=a.png"), query, *words]) == 0
    assert np.asarray(Image.open(room / "where.png")).ndim == 3


def test_a_name_with_dollars_is_drawn_as_it_is():
    assert draw_errors([0.0, 1.0], {"eagor": [1.0, 2.0], "$\\frac{$": [2.0, 1.0]}, title="$\\frac{$").size[0] > 0


def test_tracks_and_reports_keep_their_cells(room, capsys):
    (room / "poses.csv").write_text("stamp,yaw_deg,pitch_deg,roll_deg\n0,0,0,0\n")
    out = room / "out.csv"
    frames = str(room / "=a.png")
    assert main(["track", frames, "red", "--poses", str(room / "poses.csv"), "--out", str(out)]) == 0
    assert not any(cell.startswith("=") for row in csv.reader(io.StringIO(out.read_text())) for cell in row)
