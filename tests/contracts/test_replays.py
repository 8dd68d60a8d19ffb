"""A replay that says what it does not understand: keys, views, scores, labels, and files that never end."""

import json
import math
import os

import numpy as np
import pytest

from eagor.conventions import wxyz_from_rotation
from eagor.errors import FormatError, QueryError
from eagor.perception.records import read_looks
from eagor.perception.replay import ReplayPerception, parse_record
from eagor.perception.vocabulary import fitting
from eagor.sphere import world_R_body

PANORAMA = {"width": 1024, "height": 512}


def line(**changes) -> str:
    """A good line with some keys changed."""
    return json.dumps({"stamp": 1.0, "image": PANORAMA, "boxes": [{"box": [1, 2, 30, 40], "score": 0.5}]} | changes)


VIEW = {"projection": "perspective", "width": 640, "height": 480, "hfov_deg": 60}


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (line(timestamp=3), "'timestamp' is no key of a line; did you mean stamp"),
        (line(lable="chair"), "'lable' is no key of a line"),
        (
            line(image=PANORAMA | {"yaw_deg": 90}),
            "'yaw_deg' is no key of image; did you mean yaw_left_deg",
        ),
        (
            line(image=VIEW | {"pitch_deg": 9}),
            "did you mean pitch_up_deg",
        ),
        (line(image=VIEW | {"roll": 9}), "'roll' is no key of image"),
        (line(image=PANORAMA | {"hfov_deg": 90}), 'hfov_deg is for a perspective image.*"projection": "perspective"'),
        (line(image=PANORAMA | {"roll_right_deg": 0}), "roll_right_deg is for a perspective image"),
        (line(image=PANORAMA | {"focal": [9, 9]}), "focal is for a perspective image"),
        (line(image={"width": 640, "height": 480}), r"image is \(640, 480\); wanted a panorama, 2:1, or .*perspective"),
        (line(image=VIEW | {"hfov_deg": 1.05}), "hfov_deg is 1.05; wanted `float` >= 2"),
        (line(image=VIEW | {"centre": [320, 240]}), "has hfov_deg and centre; wanted one of them"),
        (line(image=VIEW | {"hfov_deg": None, "focal": [9, 9]}), "centre is missing; wanted two numbers"),
        (line(image=VIEW | {"hfov_deg": None, "focal": [-9, 9], "centre": [1, 1]}), r"has focal \(-9.*above 0"),
        (line(image=VIEW | {"distortion": [0.0] * 9}), r"image.distortion is .*; wanted `array` of length <= 8"),
        (line(boxes=[{"bbox": [1, 2, 30, 40]}]), r"'bbox' is no key of boxes\[0\]; did you mean box\?"),
        (line(boxes=[{"box": [1, 2, 30, 40], "confidence": 1}]), r"'confidence' is no key of boxes\[0\]"),
        (line(boxes=None, points=[{"azimuth": 3, "elevation_deg": 5}]), "did you mean azimuth_deg"),
        (line(boxes=None, response={"rows": 1, "columns": 1, "values": [0]}), "'columns' is no key of response"),
        (line(boxes=[{"box": [1, 2, 30, 40], "score": 7.5}]), r"score is 7.5.*exp\(-score.*percentages by 100"),
        (line(look=1), r"'look' is no key of a line"),
        (line(image=VIEW | {"qw": 1}), "qx is missing"),
        (line(image=VIEW | {"qw": 1, "qx": 1, "qy": 0, "qz": 0}), r"length of qw, qx, qy, qz is 1\.4142; wanted 1"),
        (line(image=VIEW | {"qw": 1, "qx": 0, "qy": 0, "qz": 0, "pitch_up_deg": 3}), "not both"),
        (line(boxes=None, views=[{"image": VIEW, "boxes": []}] * 2), "2 views of .* sr in all; wanted one view, or"),
        (line(boxes=None, views=[{"image": PANORAMA, "boxes": []}]), 'wanted "perspective" in views'),
        (line(pose={"qw": 1, "qx": 0, "qy": 0, "qz": 0, "x": 1}), "wanted x, y and z, or none of them"),
        (line(pose={"qw": 1, "qx": 1, "qy": 0, "qz": 0}), r"wanted 1 \(a rotation, world_R_body\)"),
        (line(valid_mask={"rows": 2, "runs": [1, 2]}), r"runs is '3 cells'; wanted rows \* 2 \* rows = 8 in all"),
        (line(boxes=None), "has none of boxes, points, response, views; wanted exactly one, or a pose"),
        ('{"footage": {"of": "a.mp4", "perception": "coco"}}', "has footage; wanted that in the first line alone"),
    ],
)
def test_a_key_that_means_nothing_is_refused_with_the_nearest(tmp_path, bad, says):
    path = tmp_path / "looks.jsonl"
    path.write_text(line() + "\n" + bad + "\n")
    with pytest.raises(FormatError, match=rf"looks\.jsonl, line 2: .*{says}"):
        ReplayPerception(path)


def test_a_note_of_ones_own_is_no_key(tmp_path):
    noted = line(_frame="a.png", image=PANORAMA | {"_camera": 3}, boxes=[{"box": [1, 2, 30, 40], "_id": 7}])
    assert len(parse_record(noted).values) == 1


@pytest.mark.parametrize("angles", [(0, 0, 0), (30, 0, 0), (-120, 35, 0), (10, -70, 100)])
def test_a_quaternion_says_what_the_angles_say(angles):
    yaw, pitch, roll = map(math.radians, angles)
    named = dict(zip(("yaw_left_deg", "pitch_up_deg", "roll_right_deg"), angles, strict=True))
    body_R_view = world_R_body(yaw, -pitch, roll)
    turn = dict(zip(("qw", "qx", "qy", "qz"), wxyz_from_rotation(body_R_view).tolist(), strict=True))
    by_angles, by_turn = (parse_record(line(image=VIEW | told)).grid for told in (named, turn))
    assert by_angles.body_R_view == pytest.approx(body_R_view, abs=1e-12)
    assert by_turn.body_R_view == pytest.approx(body_R_view, abs=1e-9)


def boxes_with(*labels):
    return [{"box": [100 * n + 1, 200, 100 * n + 30, 240], "label": label} for n, label in enumerate(labels)]


@pytest.mark.parametrize(
    ("query", "labels", "fit"),
    [
        ("fridge", ["refrigerator", "chair"], {"refrigerator"}),
        ("chairs", ["chair", "armchair"], {"chair"}),
        ("the red chair", ["red chair", "chair"], {"red chair"}),
        ("the big red chair", ["red chair", "chair", "table"], {"red chair", "chair"}),
        ("the chair by the table", ["chair", "table"], {"chair"}),
        ("television", ["tv", "remote"], {"tv"}),
        ("椅子", ["椅子", "机"], {"椅子"}),
        ("door", ["refrigerator", "chair"], set()),
        ("armchair", ["table"], set()),
    ],
)
def test_a_label_fits_by_its_own_name_first_then_by_others(tmp_path, query, labels, fit):
    assert fitting(query, labels) == fit
    path = tmp_path / "looks.jsonl"
    path.write_text(line(boxes=boxes_with(*labels)) + "\n")
    replay = ReplayPerception(path)
    if fit:
        assert len(replay(None, query, stamp=1.0).detections) == len(fit)
        said = replay.used(query, 1)
        assert "1 of 1 lines" in said
        assert all(repr(label) in said for label in fit)
        return
    with pytest.raises(
        QueryError, match=rf"0 of 1 lines .* labels in the file: {labels[0]} \(1\).*none fits '{query}'"
    ):
        replay(None, query, stamp=1.0)


def test_the_best_label_of_the_file_counts_on_every_line(tmp_path):
    path = tmp_path / "looks.jsonl"
    path.write_text(line(boxes=boxes_with("chair")) + "\n" + line(stamp=2.0, boxes=boxes_with("red chair")) + "\n")
    replay = ReplayPerception(path)
    assert len(replay(None, "red chair", stamp=1.0).detections) == 0
    assert len(replay(None, "red chair", stamp=2.0).detections) == 1


def test_what_was_looked_for_and_never_seen_is_no_fault(tmp_path):
    for boxes in ([], boxes_with(None)):
        (path := tmp_path / "looks.jsonl").write_text(line(boxes=boxes) + "\n")
        assert len(ReplayPerception(path)(None, "fridge", stamp=1.0).detections) == len(boxes)
        assert ReplayPerception(path).used("fridge", 1).endswith("lines of " + str(path) + " used")
    path.write_text(line(boxes=boxes_with("chair")) + "\n" + line(stamp=2.0, query="fridge", boxes=[]) + "\n")
    assert len(ReplayPerception(path)(None, "fridge", stamp=2.0).detections) == 0
    assert "none fits 'fridge'" in ReplayPerception(path).used("fridge", 1)


def test_a_file_that_never_ends_is_refused(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in ("/dev/zero", pipe):
        with pytest.raises(FormatError, match="is a pipe or a device"):
            read_looks(path)[1]
    (path := tmp_path / "looks.jsonl").write_text(line() + "\n")
    (link := tmp_path / "link.jsonl").symlink_to(path)
    assert len(read_looks(link)[1]) == 1


def test_what_the_camera_never_sees_says_nothing():
    """A box under the tripod's patch is none, and not having seen anything there is no sign of absence."""
    seen = {"valid_mask": {"rows": 2, "runs": [4, 4]}}  # the lower half is black
    boxes = [{"box": [500, 100, 540, 140]}, {"box": [500, 400, 540, 440]}]
    evidence = parse_record(line(boxes=boxes, **seen)).evidence("thing")
    assert len(evidence.detections) == 1
    assert evidence.detections.directions[0, 2] > 0
    assert evidence.detections.share(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])).tolist() == [0.0, 1.0]


def test_the_orange_of_recorded_looks_is_a_thing_and_a_green_one_is_not_told(tmp_path):
    path = tmp_path / "looks.jsonl"
    about = {"footage": {"of": "bowl.mp4", "perception": "coco", "classes": ["apple", "orange"]}}
    box = {"box": [10, 10, 20, 20], "score": 0.8, "label": "orange"}
    look = {"stamp": 1.0, "image": {"projection": "equirectangular", "width": 64, "height": 32}, "boxes": [box]}
    path.write_text("\n".join(map(json.dumps, [about, look])))
    replay = ReplayPerception(path)
    for query in ("orange", "the orange", "where are the oranges?"):
        (found,) = replay.looks(query, 1.0)
        assert len(found.detections) == 1
    with pytest.raises(QueryError, match="names a colour"):
        replay.looks("the green orange", 1.0)


@pytest.mark.parametrize(("query", "words"), [("chairs", ""), ("footstool", "chair"), ("couch", "sofa")])
def test_a_replay_names_the_label_that_stands_for_the_query(tmp_path, query, words):
    path = tmp_path / "boxes.jsonl"
    path.write_text(line(boxes=[{"box": [1, 2, 30, 40], "score": 0.5, "label": label} for label in ("chair", "sofa")]))
    assert [look.looked_for for look in ReplayPerception(path).looks(query, 1.0)] == [words]
    path.write_text(line(query=query))
    assert [look.looked_for for look in ReplayPerception(path).looks(query, 1.0)] == [""], "it was asked so"
