"""``eagor live`` from the shell: lines of JSON, ends as it should, errors in a sentence; and a recording again."""

import io
import json
import math
import os
import re
import signal
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from commands import answer, eagor, refused
from livemaking import Film, LoadedSlowly, Seeing
from moving_rooms import PatternRoom
from PIL import Image
from processes import alive, begun, sessions_of, wait_for

from eagor.errors import FormatError
from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import EYE, Room, bearing, painted_room
from eagor.live.loop import Loop
from eagor.live.recording import Replay
from eagor.sources.panorama import view
from eagor.sphere import world_R_body
from eagor.studio.replays import recorded

pytestmark = pytest.mark.xdist_group("real time")

pytest.importorskip("cv2")
WIDTH, STEP = 256, 4  # pixels, and columns by which each picture of the film is turned to the left


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A folder of pictures of a camera that turns, 10 per second by their names."""
    folder = tmp_path_factory.mktemp("film")
    room = painted_room(WIDTH // 2, WIDTH)
    for number in range(12):
        Image.fromarray(np.roll(room, number * STEP, axis=1)).save(folder / f"{number / 10:.2f}.png")
    return folder


def live(*words):
    """The answers of ``eagor live WORDS --json``, one a line."""
    done = eagor("live", *words, "--json")
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_a_folder_is_followed_fast_with_several_queries(film):
    found = live(film, "red", "blue", "--fast", "--poses", "level")
    assert {line["query"] for line in found} == {"red", "blue"}
    chair = [line for line in found if line["query"] == "red"]
    assert [round(line["stamp"], 2) for line in chair[:3]] == [0.0, 0.1, 0.2]
    last = chair[-1]
    assert last["status"] == "tracking"
    assert last["faults"] == []
    # Pictures are turned to the left, so the chair is ever further to the right; between pictures the last pose holds.
    first = next(line for line in chair if line["azimuth_deg"] is not None)
    turned = first["azimuth_deg"] - last["azimuth_deg"]
    steps = int(last["stamp"] * 10 + 1e-6) - int(first["stamp"] * 10 + 1e-6)
    assert turned % 360 == pytest.approx(steps * STEP * 360 / WIDTH, abs=3)


def test_poses_of_a_file_are_those_of_its_clock_unless_they_contradict_the_film(tmp_path):
    (tmp_path / "film").mkdir()
    room, poses = PatternRoom(4).panorama(np.eye(3), rows=128), tmp_path / "poses.csv"
    room[60:70, 100:112] = (220, 20, 20)
    for number in range(12):
        Image.fromarray(np.roll(room, 6 * number, axis=1)).save(tmp_path / "film" / f"{number / 10:.2f}.png")
    for sign, code in ((-1, 2), (1, 0)):
        rows = [f"{k / 20},{sign * k / 2 * 6 * 360 / 256},0,0" for k in range(24)]
        poses.write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *rows]))
        done = eagor("live", tmp_path / "film", "red", "--fast", "--json", "--poses", poses)
        assert done.returncode == code
        assert ("contradicts the pictures" in done.stderr) == (code == 2)
    last = json.loads(done.stdout.splitlines()[-1])
    assert last["status"] == "tracking"
    assert last["credible_angle_deg"] < 5


def test_a_run_is_recorded_and_played_again(film, tmp_path):
    pytest.importorskip("rosbags")
    first = live(film, "red", "--record", tmp_path / "run", "--poses", "still")
    assert first[-1]["azimuth_deg"] is not None  # how sure it is depends on how many pictures were looked at in time
    assert live("replay", tmp_path / "run") == first
    assert "eagor track" in refused("live", "replay", tmp_path / "run", "--perception", "colour")
    found = answer("track", tmp_path / "run", "red", "--perception", "colour")
    assert found["frames"], "it is a source as any bag"


@pytest.mark.slow
def test_a_recording_is_a_run_of_the_studio(film, tmp_path):
    """Each query is an episode; its last step is the last answer of the recording, with its picture and its belief."""
    pytest.importorskip("rosbags")
    runs = pytest.importorskip("eagor.studio.runs")
    folder = tmp_path / "runs" / "film"
    told = live(film, "red", "blue", "--record", folder, "--poses", "level")
    (line,) = runs.listed(tmp_path / "runs")
    assert (line["name"], line["kind"], line["problem"]) == ("film", "live", "")
    for episode, query in zip(runs.opened(folder)["episodes"], ("red", "blue"), strict=True):
        drawn = runs.again(folder, episode["key"])
        assert drawn.scene["query"] == query
        assert drawn.pictures
        answers = [one for one in told if one["query"] == query]
        last = drawn.steps[-1]
        end = answers[0]["stamp"] + last["stamp"]
        wanted = min(answers, key=lambda one: abs(one["stamp"] - end))
        assert last["estimate"]["azimuth_deg"] == pytest.approx(wanted["azimuth_deg"], abs=0.1)
        assert last["belief"]["url"].startswith("data:image/png")
    with pytest.raises(FormatError, match="has no query 'green cup'"):
        runs.again(folder, "green cup")


def test_without_a_terminal_a_line_a_second_and_the_last_answers_are_said(film):
    done = eagor("live", film, "red", "blue", "--fast", "--poses", "level")
    assert done.returncode == 0, done.stderr
    first, last = done.stdout.splitlines()
    assert re.match(r"0\.00 s  red: .* to the right, .* \| blue: .* to the left, ", first)
    assert re.match(
        r"1\.00 s  red: .* to the right, 21 degrees down, 90 % within \d+°, tracking \| blue: .*, tracking$", last
    )
    *_, red, blue, counted = done.stderr.splitlines()
    assert re.match("eagor: at 1.10 s “red”: .* to the right, 21 degrees down .tracking: ", red)
    assert re.match("eagor: at 1.10 s “blue”: .* degrees down .tracking: ", blue)
    assert "12 pictures, 24 looks, 12 poses" in counted


def test_the_answers_end_with_the_file_however_long_the_detector_needs():
    loop = Loop(Film(count=6), None, Seeing(seconds=1.5), "chair", True)
    answers = list(loop)
    seen = [answer for answer in answers if math.isfinite(answer.image_age)]
    assert seen[-1].direction is not None
    assert seen[-1].image_age < 0.3, "as of the last picture, not of the time when it had been looked at"
    assert all(a.stamp <= b.stamp for a, b in pairwise(answers))


def test_seconds_count_from_when_the_detector_is_loaded(film, monkeypatch):
    def opened(*words, **more):
        return Loop(Film(count=50), None, LoadedSlowly(), "red", True, words[-1])

    monkeypatch.setattr("eagor.live.loop.Loop", opened)
    found = live(film, "red", "--perception", "colour", "--seconds", "0.6")
    assert found[-1]["stamp"] - found[0]["stamp"] > 2.0
    assert found[-1]["azimuth_deg"] is not None


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds processes as Linux shows them")
@pytest.mark.parametrize(
    ("number", "code", "said"),
    [
        (signal.SIGINT, 130, b"interrupted"),
        pytest.param(signal.SIGTERM, 143, b"terminated", marks=pytest.mark.slow),
    ],
)
def test_it_ends_cleanly_when_it_is_told_to(tmp_path, number, code, said):
    """Also in the middle of a recording, which is whole then; nobody is left behind."""
    pytest.importorskip("rosbags")
    words = ["pipe:rgb24:64x32", "red", "--json", "--record", tmp_path / "run", "--poses", "still"]
    run = begun("live", *words, stdin=subprocess.PIPE)
    picture = bytes(64 * 32 * 3)
    heard = []

    def speaks():
        run.stdin.write(picture)
        run.stdin.flush()
        return run.poll() is not None or len(heard) > 0 or (heard.append(run.stdout.readline()) or False)

    wait_for(speaks)
    assert json.loads(heard[0])["query"] == "red"
    sessions = sessions_of(run.pid)
    os.killpg(run.pid, number)  # as a terminal does
    _, err = run.communicate(timeout=300)
    wait_for(lambda: not alive(sessions))
    assert run.returncode == code, err
    assert err.splitlines()[-1] == b"eagor: " + said
    assert b"Traceback" not in err, err.decode()
    assert eagor("live", "replay", tmp_path / "run").returncode == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["{film}"], "wanted SOURCE, then one or more QUERY"),
        (["/nowhere", "red"], "there is no file or folder '/nowhere'"),
        (["/dev/video77", "red"], "/dev/video77"),
        (["{film}", "red", "--rate", "0"], "--rate 0"),
        (["{film}", "red", "--patience", "-1"], "--patience -1"),
        (["{film}", "red", "red"], "a query comes twice"),
        (["{film}", "red", "--poses", "go2"], "wanted a file of poses"),
        (["{film}", "red", "--poses", "nowhere.csv"], "nowhere.csv"),
        (["{film}", "red", "--record", "{film}"], "name a new folder"),
        (["{film}", "red", "--perception", "nonesuch"], "there is no perception 'nonesuch'"),
        (["{film}", "pet snail", "--perception", "colour"], "pet snail"),
        (["{film}", "red", "--mask", "nowhere.png"], "nowhere.png"),
        (["replay"], "the folder of one recording"),
        (["replay", "/nowhere"], "/nowhere"),
        (["replay", "{film}"], "holds no bag"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_sentence_with_exit_code_2(words, says, film):
    pytest.importorskip("rosbags")
    done = eagor("live", *(word.format(film=film) for word in words))
    assert (done.returncode, done.stdout) == (2, "")
    (error,) = (line for line in done.stderr.splitlines() if line.startswith("eagor: error: "))
    assert says in error


def test_an_ordinary_camera_live_and_looked_at_again(tmp_path):
    (tmp_path / "film").mkdir()
    room, hfov = painted_room(256, 512), math.radians(80)
    for number in range(8):
        seen = view(room, PerspectiveGrid(180, 240, hfov, world_R_body(-0.09 * number)))
        Image.fromarray(seen).save(tmp_path / "film" / f"{number / 10:.2f}.png")
    words = (tmp_path / "film", "the red ball", "--perception", "colour", "--fast")
    last = live(*words, "--hfov", "80", "--record", tmp_path / "run", "--pictures", "png")[-1]
    assert {"azimuth_deg", "elevation_deg"} <= {*last["next_look"]}
    truth = bearing(Room().balls[0], EYE, world_R_body(-0.63))[0]  # whole in the picture
    azimuth = math.degrees(math.atan2(truth[1], truth[0]))
    assert abs(last["azimuth_deg"] - azimuth) < 3
    drawn = recorded(Replay(tmp_path / "run"))  # as the studio shows it
    assert drawn.scene["lens"]["plane"] == pytest.approx([math.tan(hfov / 2), 0.75 * math.tan(hfov / 2)], abs=1e-5)
    assert {Image.open(io.BytesIO(jpeg)).size for jpeg in drawn.pictures.values()} == {(240, 180)}
    assert "--hfov DEGREES" in refused("live", *words)
