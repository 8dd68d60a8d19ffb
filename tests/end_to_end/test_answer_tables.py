"""The file of --out: the same columns from every command, as CSV and JSON lines."""

import csv
import io
import json
import math
from functools import cache

import pytest
from PIL import Image

from eagor.cli import main
from eagor.cli.answers import COLUMNS, columns_of, row_of, table
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


def run(capsys, *words, code=0):
    assert main([*map(str, words)]) == code
    out, err = capsys.readouterr()
    return err if code else out


def test_locate_writes_what_it_prints(room, tmp_path, capsys):
    found = json.loads(run(capsys, "locate", room, "red", "--json", "--out", tmp_path / "a.csv"))
    (row,) = csv.DictReader(io.StringIO((tmp_path / "a.csv").read_text()))
    assert [*row] == [*COLUMNS, "modes", "problem"]
    assert float(row["azimuth_deg"]) == found["azimuth_deg"]
    assert (row["frame"], row["modes"], row["distance_m"]) == ("room.png", str(len(found["modes"])), "")
    run(capsys, "locate", room, "red", "--out", tmp_path / "a.jsonl")
    assert json.loads((tmp_path / "a.jsonl").read_text()) == found


def test_locate_and_track_give_the_same_columns(room, tmp_path, capsys):
    poses = tmp_path / "poses.csv"
    poses.write_text("stamp,yaw_deg,pitch_deg,roll_deg\n0,0,0,0\n")
    for name, words in {"locate": [room, "red"], "track": [room, "red", "--poses", poses]}.items():
        run(capsys, name, *words, "--out", tmp_path / f"{name}.csv")
    heads = {(tmp_path / f"{name}.csv").read_text().splitlines()[0] for name in ("locate", "track")}
    assert len(heads) == 1


def test_the_floor_gives_locate_a_distance(room, capsys):
    without = json.loads(run(capsys, "locate", room, "red", "--json"))
    assert (without["distance_m"], without["distance_spread"]) == (None, None)
    found = json.loads(run(capsys, "locate", room, "red", "--json", "--floor", FLOOR))
    middle, half = math.log(found["distance_m"]) - found["distance_spread"] ** 2 / 2, 1.645 * found["distance_spread"]
    assert abs(math.log(BALL) - middle) < half
    assert " m (90 %, if it stands on the floor)" in run(capsys, "locate", room, "red", "--floor", FLOOR)


def test_the_floor_works_with_views_of_one_moment(room, tmp_path, capsys):
    looks = tmp_path / "looks.jsonl"
    with looks.open("w") as file:
        for stamp in (5.0, 5.01):
            write_record(file, stamp, points=[{"azimuth_deg": 40, "elevation_deg": -30}])
    words = ["locate", room, "ball", "--perception", f"replay:{looks}", "--floor", "-1.3", "--json"]
    assert json.loads(run(capsys, *words))["distance_m"] > 0


@pytest.mark.parametrize("floor", ["1.3", "0", "nan", "-inf"])
def test_a_floor_that_is_not_below_the_camera_is_refused(room, capsys, floor):
    assert "wanted a floor below it, such as -1.3" in run(capsys, "locate", room, "red", "--floor", floor, code=2)


@pytest.mark.parametrize(
    ("out", "says"),
    [
        ("a.txt", "ends in .csv or .jsonl"),
        ("no/a.csv", "there is no folder"),
        ("room.png", "is an input"),
        ("folder.csv", "cannot be written"),
    ],
)
def test_a_file_that_cannot_be_is_refused_before_the_look(room, tmp_path, monkeypatch, capsys, out, says):
    monkeypatch.chdir(tmp_path)
    tmp_path.joinpath("folder.csv").mkdir()
    before = room.read_bytes()
    assert says in run(capsys, "locate", "room.png", "red", "--out", out, code=2)
    assert room.read_bytes() == before


def test_rivals_have_columns_of_their_own():
    columns = columns_of(["vmf"])
    assert columns[-2:] == ["vmf_azimuth_deg", "vmf_elevation_deg"]
    row = dict(zip(columns, row_of(ENTRY, columns), strict=True))
    assert (row["vmf_azimuth_deg"], row["vmf_elevation_deg"]) == (3.5, None)
    assert (row["modes"], row["problem"]) == (1, "")


def test_lines_are_there_as_soon_as_they_are_written(tmp_path):
    path = tmp_path / "a.csv"
    with table(path) as write:
        assert not path.exists()
        for count in (1, 2):
            write(ENTRY)
            assert len(path.read_text().splitlines()) == 1 + count
