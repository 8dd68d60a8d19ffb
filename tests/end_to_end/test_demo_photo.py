"""``eagor demo --photo``: a virtual camera in a photograph, and a report."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from commands import ENVIRONMENT, answer, refused
from PIL import Image

from eagor.cli import demo_photo
from eagor.cli.terminal import RunError, UsageError
from eagor.lab.worlds.painted import EYE, Room, bearing, painted_room
from eagor.perception import load
from eagor.perception.views import Detector
from eagor.sphere import angular_distance, direction

RED_BALL = bearing(Room().balls[0], EYE, np.eye(3))[0]


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    path = tmp_path_factory.mktemp("photo") / "room & co.png"
    Image.fromarray(painted_room(128, 256)).save(path)
    return path


def test_it_is_followed_in_the_frame_of_the_photograph_and_leaves_a_report(photo, tmp_path):
    found = answer("demo", "--photo", photo, "--query", "red ball", "--out", tmp_path, "--perception", "colour")
    assert (found["perception"], found["query"], found["looks"]) == ("colour", "red ball", demo_photo.LOOKS)
    for place in (found, found["places"][0]):
        there = direction(math.radians(place["azimuth_deg"]), math.radians(place["elevation_deg"]))
        assert math.degrees(angular_distance(there, RED_BALL)) < 3
    assert found["seam_crossings"] >= 1
    said = " ".join(found["summary"])
    assert "degrees to the right, 2" in said
    assert "Nobody has measured where it is" in said
    page = Path(found["report"]).read_text(encoding="utf-8")
    for text in ("red ball", "room &amp; co.png", "Nobody has measured where it is"):
        assert text in page
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", page), "one file, which needs nothing else"
    assert page.count("data:image/jpeg;base64,") > demo_photo.LOOKS


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


class Pages:
    """Takes what a page takes."""

    def add(self, *_, **__):
        pass


def test_without_a_query_the_surest_class_in_one_place_is_taken():
    """Cups are found in two places, the ball in one, whatever they score."""
    room = painted_room(128, 256)
    assert demo_photo.best_query(Detector(Knows()), room) == "ball"
    assert demo_photo.best_query(Detector(Knows(0.2)), room) == "ball"
    with pytest.raises(RunError, match="sees nothing that it knows"):
        demo_photo.best_query(Detector(Knows(0)), room)
    with pytest.raises(UsageError, match="say what to look for with --query"):
        demo_photo.best_query(load("colour"), room)


def test_several_places_are_named():
    twice = painted_room(128, 256)
    twice[58:70, 60:72] = twice[58:70, 180:192] = (220, 20, 20)
    found = demo_photo.play(twice, load("colour"), "red", Pages(), lambda: None)
    said = demo_photo.as_json(found, "mine", "a.png")["summary"][0]
    assert re.search(r"the red is in one of 3 places, or in several of them: .*degrees to the right \(\d+ %\); ", said)


def test_a_thing_that_is_never_seen_ends_the_run():
    with pytest.raises(RunError, match="no 'ball' to see in any of 24 looks"):
        demo_photo.play(painted_room(128, 256), Detector(Knows(0), size=64), "ball", Pages(), lambda: None)


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
def test_what_cannot_be_shown_is_refused_in_one_line(photo, tmp_path, monkeypatch, words, says):
    monkeypatch.setitem(ENVIRONMENT, "EAGOR_CACHE", str(tmp_path / "empty"))
    narrow = tmp_path / "narrow.png"
    Image.fromarray(painted_room(64, 128)[:, :90]).save(narrow)
    given = {"PHOTO": photo, "NARROW": narrow}
    line = refused("demo", *(given.get(word, word) for word in words), "--out", tmp_path / "new")
    assert says in line
    assert "--force" not in line
    assert not (tmp_path / "new").exists()
