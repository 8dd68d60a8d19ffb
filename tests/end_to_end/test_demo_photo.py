"""``eagor demo --photo``: a virtual camera in a photograph, and a report."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from eagor.cli import demo_photo, main
from eagor.cli.terminal import RunError, UsageError
from eagor.lab.worlds.painted import EYE, Room, bearing, painted_room
from eagor.perception import load
from eagor.perception.views import Detector
from eagor.sources.panorama import turn
from eagor.sphere import angular_distance, azimuth_elevation, direction

RED_BALL = bearing(Room().balls[0], EYE, np.eye(3))[0]
LYTHWOOD = Path(__file__).parents[2] / ".." / "shared" / "panoramas" / "lythwood_room_1k.png"


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    path = tmp_path_factory.mktemp("photo") / "room & co.png"
    Image.fromarray(painted_room(128, 256)).save(path)
    return path


@pytest.fixture(scope="module")
def played(photo):
    image = np.asarray(Image.open(photo))
    return demo_photo.play(image, load("colour"), "colour", "red ball")


def test_the_camera_turns_all_around_and_tumbles():
    poses = demo_photo.poses()
    assert len(poses) == demo_photo.LOOKS
    for pose in poses:
        np.testing.assert_allclose(pose @ pose.T, np.eye(3), atol=1e-12)
    tilts = [math.degrees(math.acos(min(1.0, pose[2, 2]))) for pose in poses]
    assert max(tilts[: demo_photo.LEVEL - 1]) < 1e-6
    assert max(tilts) > demo_photo.TILT - 5
    for azimuth in range(-180, 180, 30):  # wherever a thing is, the seam passes it
        there = direction(math.radians(azimuth), 0.0)
        seen = np.unwrap([float(azimuth_elevation(pose.T @ there)[0]) for pose in poses])
        assert abs(seen[-1] - seen[0]) > math.tau


def test_what_is_seen_is_the_photograph_turned(played, photo):
    for index in (0, 5, 15):
        wanted = turn(np.asarray(Image.open(photo)), played.poses[index].T)
        assert np.abs(played.panorama(index).astype(int) - wanted).mean() < 1


def test_it_is_followed_in_the_frame_of_the_photograph(played):
    assert math.degrees(angular_distance(played.answer, RED_BALL)) < 3
    errors = np.degrees(angular_distance(played.directions, RED_BALL))
    assert errors.shape == (demo_photo.LOOKS,)
    assert errors[3:].max() < 6
    assert played.crossings >= 1


def test_the_command_leaves_a_report(photo, played, tmp_path, capsys):
    words = ["demo", "--photo", str(photo), "--query", "red ball", "--out", str(tmp_path), "--perception", "colour"]
    assert main([*words, "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    found = json.loads(out)
    assert (found["perception"], found["query"], found["looks"]) == ("colour", "red ball", demo_photo.LOOKS)
    there = direction(math.radians(found["azimuth_deg"]), math.radians(found["elevation_deg"]))
    assert math.degrees(angular_distance(there, RED_BALL)) < 3
    assert [math.radians(found["places"][0]["azimuth_deg"])] == pytest.approx([played.places[0][0]], abs=1e-6)
    page = Path(found["report"]).read_text(encoding="utf-8")
    assert "<h1>Where is the red ball?</h1>" in page
    assert "room &amp; co.png" in page
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", page), "one file, which needs nothing else"
    assert page.count("data:image/jpeg;base64,") == len(list(tmp_path.glob("look-*.jpg"))) > 1


def test_the_text_says_that_there_is_no_truth(played):
    text = " ".join(demo_photo.summary(played))
    assert "Nobody has measured where it is" in text
    assert "degrees to the right, 2" in text  # where the ball is


def test_several_places_are_named(played, monkeypatch):
    monkeypatch.setitem(vars(played.estimates[-1]), "status", "ambiguous")
    monkeypatch.setattr(demo_photo.Looks, "places", [(-0.5, 0.0, 0.6), (1.0, 0.0, 0.3)])
    said = demo_photo.summary(played)[0]
    assert "in one of 2 places, or in several of them: 29 degrees to the right" in said
    assert "57 degrees to the left" in said
    assert "(30 %)" in said


def test_moments_for_pictures_are_few_and_in_order(played):
    chosen = demo_photo.highlights(played)
    assert [index for index, _ in chosen] == sorted({index for index, _ in chosen})
    assert len(chosen) <= 6
    assert (chosen[0], chosen[-1][0]) == ((0, "the first"), demo_photo.LOOKS - 1)


class Knows:
    """A detector with two classes; it finds what is red, calls it a ball, and sees two cups beside it."""

    classes = ("cup", "ball")

    def __init__(self, score=0.9):
        self.score = score

    def __call__(self, picture, query):
        rows, columns = np.nonzero((picture[..., 0] > 150) & (picture[..., 1:] < 80).all(axis=-1))
        if not len(rows) or not self.score:
            return np.zeros((0, 4)), np.zeros(0), []
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        cups = [4, 4, 24, 24], [480, 480, 500, 500]
        return [*cups, box], [0.3, 0.3, self.score], ["cup", "cup", "ball"]


def test_without_a_query_the_surest_class_in_one_place_is_taken():
    """Cups are found in two places, the ball in one, whatever they score."""
    room = painted_room(128, 256)
    assert demo_photo.best_query(Detector(Knows()), room) == "ball"
    assert demo_photo.best_query(Detector(Knows(0.2)), room) == "ball"
    with pytest.raises(RunError, match="sees nothing that it knows"):
        demo_photo.best_query(Detector(Knows(0)), room)
    with pytest.raises(UsageError, match="say what to look for with --query"):
        demo_photo.best_query(load("colour"), room)


def test_a_thing_that_is_never_seen_ends_the_run():
    with pytest.raises(RunError, match="saw no 'ball' in any of 24 looks"):
        demo_photo.play(painted_room(128, 256), Detector(Knows(0), size=64), "mine", "ball")


def test_a_large_photograph_is_shrunk():
    rows = demo_photo.rows_for(Detector(Knows()), np.zeros((4096, 8192, 3), np.uint8))
    assert rows <= demo_photo.MOST_ROWS
    assert demo_photo.rows_for(Detector(Knows()), np.zeros((200, 400, 3), np.uint8)) == 200


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--query", "chair"], "--query is for --photo PICTURE"),
        (["--photo", "PHOTO", "--seed", "3"], "--seed chooses an apartment; leave it out with --photo"),
        (["--photo", "nowhere.png"], "no file"),
        (["--photo", "NARROW", "--query", "red"], "wanted a whole panorama: pad it to 2:1 first"),
        (["--photo", "PHOTO", "--query", " "], "no words"),
        (["--photo", "PHOTO", "--perception", "colour"], "say what to look for with --query"),
        (["--photo", "PHOTO", "--query", "red", "--perception", "replay:a.jsonl"], "belongs to other frames"),
        (["--photo", "PHOTO"], "the detector coco is not installed"),
        (["--photo", "PHOTO", "--query", "chair"], "no detector for 'chair' is installed"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(photo, tmp_path, monkeypatch, capsys, words, says):
    monkeypatch.setenv("EAGOR_CACHE", str(tmp_path / "empty"))
    narrow = tmp_path / "narrow.png"
    Image.fromarray(painted_room(64, 128)[:, :90]).save(narrow)
    given = {"PHOTO": str(photo), "NARROW": str(narrow)}
    assert main(["demo", *(given.get(word, word) for word in words), "--out", str(tmp_path / "new")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert "--force" not in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "new").exists()


@pytest.mark.registry
@pytest.mark.skipif(not LYTHWOOD.is_file(), reason="the photographs are not beside this repository")
@pytest.mark.slow
def test_a_real_room_with_a_real_detector(coco_model, tmp_path, capsys):
    assert main(["demo", "--photo", str(LYTHWOOD), "--out", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["perception"] == "coco"
    assert found["query"] == "couch", "bed, the surest class, is found at four places"
    assert found["status"] == "tracking"
    assert found["seam_crossings"] >= 1
