"""`eagor calibrate` for detectors: what one wrote, and the truth, make its error model."""

import json
import math

import numpy as np
import pytest
from commands import answer, eagor, refused
from PIL import Image

from eagor.errors import FormatError
from eagor.lab.eval.labelled_looks import read_truth, replayed_looks
from eagor.lab.worlds.painted import painted_room
from eagor.perception.calibrated import read_calibrated
from eagor.perception.replay import ReplayPerception, write_record
from eagor.sphere import azimuth_elevation, unit, world_R_body

SPREAD = 0.06


def angles(directions):
    azimuths, elevations = (np.degrees(part) for part in azimuth_elevation(np.reshape(directions, (-1, 3))))
    pairs = zip(azimuths.tolist(), elevations.tolist(), strict=True)
    return [{"azimuth_deg": azimuth, "elevation_deg": elevation} for azimuth, elevation in pairs]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Four recordings of 30 looks: two fridges, or none. Found in four looks of five, among 0.5 false alarms.

    In each a picture of a fridge, taken for one every other time; the camera turns and rolls.
    """
    folder, rng = tmp_path_factory.mktemp("files"), np.random.default_rng(0)
    with (folder / "looks.jsonl").open("w") as looks, (folder / "truth.jsonl").open("w") as truths:
        for walk in range(4):
            *things, poster = unit(rng.normal(size=(3, 3)))
            there = np.array(things if walk % 2 == 0 else []).reshape(-1, 3)
            for step in range(30):
                stamp, yaw, roll = 100.0 * walk + 0.5 * step, 9.0 * step, 30 * math.sin(step)
                body = world_R_body(math.radians(yaw), 0.0, math.radians(roll))
                targets, fooled = there @ body, poster @ body
                seen = [unit(at + SPREAD * rng.normal(size=3)) for at in targets if rng.random() < 0.8]
                wrong = list(unit(rng.normal(size=(rng.poisson(0.5), 3))))
                wrong += [unit(fooled + SPREAD * rng.normal(size=3))] if rng.random() < 0.5 else []
                points = angles(seen + wrong)
                for point, right in zip(points, [True] * len(seen) + [False] * len(wrong), strict=True):
                    point |= {"label": "refrigerator", "score": rng.beta(*((4, 2) if right else (2, 4)))}
                write_record(looks, stamp, points=points)
                truth = {"stamp": stamp + 0.01, "query": "fridge", "targets": angles(targets), "group": f"walk {walk}"}
                truths.write(json.dumps(truth) + "\n")
    return folder


def test_a_detector_that_was_replayed_is_fitted_and_used(files, tmp_path):
    out = tmp_path / "mine.json"
    words = ("calibrate", "--replay", files / "looks.jsonl", "--truth", files / "truth.jsonl", "--out", out)
    said = eagor(*words)
    assert said.returncode == 0, said.stderr
    found = json.loads(out.read_text())
    model = found["detector"]
    assert model["detection_probability"] is None
    assert model["habit"][0] / sum(model["habit"]) == pytest.approx(0.75, abs=0.1)
    assert model["false_alarms_per_look"] == pytest.approx(1.0, abs=0.2), "with those of the picture"
    assert model["spread"] == pytest.approx(SPREAD, rel=0.2)
    counts, judged = found["found_by"]["counts"], found["found_by"]["held_out"]
    assert (counts["looks"], counts["groups"], counts["targets"]) == (120, 4, 120)
    assert judged["difference"] > 0
    low, high = found["found_by"]["intervals"]["spread"]
    assert low < model["spread"] < high
    assert read_calibrated(out).detector.spread == model["spread"]
    assert "looks 120, groups 4, targets 120" in said.stdout
    assert "Without poses" in said.stdout
    assert "that the fit had not seen" in said.stdout
    assert f"--calibration {out}" in said.stdout
    Image.fromarray(painted_room(64, 128)).save(room := tmp_path / "room.png")
    replay = f"replay:{files / 'looks.jsonl'}"
    looked = ("locate", room, "fridge", "--perception", replay, "--stamp", "0")
    plain, fitted = (answer(*looked, *more) for more in ((), ("--calibration", out)))
    assert fitted != plain


def test_a_truth_is_for_one_look_and_a_look_for_one_truth(files, tmp_path):
    replay = ReplayPerception(files / "looks.jsonl")
    truths = read_truth(files / "truth.jsonl")
    looks, left_out = replayed_looks(replay, truths)
    assert (len(looks), left_out) == (120, [])
    assert {look.group for look in looks} == {f"walk {n}: fridge" for n in range(4)}
    lines = [{"stamp": stamp, "query": "fridge", "targets": []} for stamp in (0.0, 0.03, 77.0)]
    (path := tmp_path / "truth.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    looks, left_out = replayed_looks(replay, read_truth(path))
    assert [look.stamp for look in looks] == [0.0]
    assert [truth.stamp for truth in left_out] == [0.03, 77.0]


def test_views_of_a_moment_are_one_look(tmp_path):
    with (path := tmp_path / "looks.jsonl").open("w") as file:
        for yaw in (0, 90, 180, 270):
            image = {"projection": "perspective", "width": 64, "height": 64, "hfov_deg": 90, "yaw_left_deg": yaw}
            write_record(file, 5.0, image=image, boxes=[{"box": [28, 28, 36, 36]}], query="x")
    truth = {"stamp": 5.0, "query": "x", "targets": [{"azimuth_deg": 90, "elevation_deg": 0}]}
    (tmp_path / "truth.jsonl").write_text(json.dumps(truth) + "\n")
    (look,), _ = replayed_looks(ReplayPerception(path), read_truth(tmp_path / "truth.jsonl"))
    assert len(look.detections) == 4
    assert len(look.in_view) == 1


GOOD = {"stamp": 1.0, "query": "chair", "targets": [{"azimuth_deg": 1, "elevation_deg": 2}]}


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (GOOD | {"targets": None}, "targets is missing in a line of true directions"),
        (GOOD | {"targets": [{"azimuth_deg": 1}]}, r"elevation_deg is missing in targets\[0\]"),
        (
            GOOD | {"targets": [{"azimuth": 1, "elevation_deg": 2}]},
            r"'azimuth' is no key of targets\[0\]; did you mean azimuth_deg",
        ),
        (GOOD, r"is a second line for 'chair' at 1 s"),
    ],
)
def test_a_bad_line_of_truth_is_named_with_its_number(tmp_path, bad, says):
    (path := tmp_path / "truth.jsonl").write_text(json.dumps(GOOD) + "\n\n" + json.dumps(bad) + "\n")
    with pytest.raises(FormatError, match=rf"truth\.jsonl, line 3: .*{says}"):
        read_truth(path)


def test_wrong_usage_is_said(files, tmp_path):
    looks, truth, path = files / "looks.jsonl", files / "truth.jsonl", tmp_path / "truth.jsonl"
    both = ("--replay", looks, "--truth", truth)
    for words, says in (
        (("--replay", looks), "belong together"),
        (("heads", *both), "belong together"),
        ((*both, "--trials", "5"), "is for eagor calibrate responses"),
        ((*both, "--out", truth), "is an input"),
    ):
        assert says in refused("calibrate", *words)
    with (mapped := tmp_path / "maps.jsonl").open("w") as file:
        write_record(file, 1.0, response=np.zeros((2, 4)))
    for replay, text, says in (
        (looks, json.dumps(GOOD | {"stamp": 50.0, "query": "fridge"}), "wanted one clock"),
        (looks, "", "holds no true directions"),
        (mapped, json.dumps(GOOD), "Response maps are read by a Calibration"),
    ):
        path.write_text(text)
        assert says in refused("calibrate", "--replay", replay, "--truth", path, "--out", tmp_path / "a")
