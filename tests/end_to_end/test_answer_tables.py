"""The file of --out: the same columns from every command, as CSV and JSON lines."""

import csv
import io
import json
import math
from functools import cache

import pytest
from commands import answer, eagor, refused
from PIL import Image

from eagor.cli.answers import COLUMNS, table
from eagor.lab.worlds.painted import EYE, Room, painted_room
from eagor.perception.replay import write_record

FLOOR = -EYE[2]  # in axes of the camera
BALL = math.dist(Room().balls[0].position, EYE)

ENTRY = {
    "frame": "a.png", "stamp": 1.5, "azimuth_deg": None, "elevation_deg": None, "credible_angle_deg": None,
    "presence": 0.25, "distance_m": None, "distance_spread": None, "status": "searching",
    "modes": [{"azimuth_deg": 1.0, "elevation_deg": 2.0, "weight": 0.5}], "looks": 1,
    "methods": {"vmf": {"azimuth_deg": 3.5, "elevation_deg": None}},
}  # fmt: skip


@cache
def png():
    """The file of the painted room, which takes longer to paint than to write."""
    Image.fromarray(painted_room(128, 256)).save(buffer := io.BytesIO(), "PNG")
    return buffer.getvalue()


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.png"
    path.write_bytes(png())
    return path


def test_locate_writes_what_it_prints_in_the_columns_of_track(room, tmp_path):
    found = answer("locate", room, "red", "--out", tmp_path / "a.csv")
    (row,) = csv.DictReader(io.StringIO((tmp_path / "a.csv").read_text()))
    assert [*row] == [*COLUMNS, "modes", "problem"]
    assert float(row["azimuth_deg"]) == found["azimuth_deg"]
    assert (row["frame"], row["modes"], row["distance_m"]) == ("room.png", str(len(found["modes"])), "")
    assert eagor("locate", room, "red", "--out", tmp_path / "a.jsonl").returncode == 0
    assert json.loads((tmp_path / "a.jsonl").read_text()) == found
    (poses := tmp_path / "poses.csv").write_text("stamp,yaw_deg,pitch_deg,roll_deg\n0,0,0,0\n")
    assert eagor("track", room, "red", "--poses", poses, "--out", tmp_path / "b.csv").returncode == 0
    assert (tmp_path / "b.csv").read_text().splitlines()[0].split(",") == [*row]


def test_the_floor_gives_locate_a_distance(room):
    without = answer("locate", room, "red")
    assert (without["distance_m"], without["distance_spread"]) == (None, None)
    found = answer("locate", room, "red", "--floor", FLOOR)
    middle, half = math.log(found["distance_m"]) - found["distance_spread"] ** 2 / 2, 1.645 * found["distance_spread"]
    assert abs(math.log(BALL) - middle) < half
    assert " m (90 %, if it stands on the floor)" in eagor("locate", room, "red", "--floor", FLOOR).stdout


def test_the_floor_works_with_views_of_one_moment(room, tmp_path):
    looks = tmp_path / "looks.jsonl"
    with looks.open("w") as file:
        for stamp in (5.0, 5.01):
            write_record(file, stamp, points=[{"azimuth_deg": 40, "elevation_deg": -30}])
    words = ["locate", room, "ball", "--perception", f"replay:{looks}", "--floor", "-1.3"]
    assert answer(*words)["distance_m"] > 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--out a.txt", "ends in .csv or .jsonl"),
        ("--out no/a.csv", "there is no folder"),
        ("--out room.png", "is an input"),
        ("--out folder.csv", "cannot be written"),
        *((f"--floor {floor}", "wanted a floor below it, such as -1.3") for floor in ("1.3", "0")),
        *((f"--floor {floor}", "wanted a height in metres") for floor in ("nan", "-inf")),
    ],
)
def test_what_cannot_be_is_refused_before_the_look(room, tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    tmp_path.joinpath("folder.csv").mkdir()
    before = room.read_bytes()
    assert says in refused("locate", "room.png", "red", *words.split())
    assert room.read_bytes() == before


def test_lines_are_there_as_soon_as_they_are_written_and_rivals_have_columns_of_their_own(tmp_path):
    path = tmp_path / "a.csv"
    with table(path, ["vmf"]) as write:
        assert not path.exists()
        for count in (1, 2):
            write(ENTRY)
            assert len(path.read_text().splitlines()) == 1 + count
    row, _ = csv.DictReader(io.StringIO(path.read_text()))
    assert [*row][-2:] == ["vmf_azimuth_deg", "vmf_elevation_deg"]
    assert (row["vmf_azimuth_deg"], row["vmf_elevation_deg"]) == ("3.5", "")
    assert (row["modes"], row["problem"]) == ("1", "")
