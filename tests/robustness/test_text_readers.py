"""Readers of text: whatever a file holds, a right value, or an error that names the file, and the line if any."""

import io
import json
import math
import os

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mutations import as_text, damaged, reads, trees
from PIL import Image
from strategies import HOSTILE, at_most

from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.lab.eval import log
from eagor.lab.eval.labelled_looks import read_truth
from eagor.lab.eval.predictions import predicted
from eagor.odometry.axes import AXES, settled
from eagor.odometry.files import read_poses
from eagor.perception.calibrated import labelled_lines, read_calibrated, read_labelled
from eagor.perception.onnx.layouts import read_labels
from eagor.perception.records import read_looks
from eagor.perception.replay import ReplayPerception
from eagor.perception.transformers.heads import read_heads
from eagor.perception.vlm.answers import parse_boxes, parse_presence
from eagor.sources.camera_sources import FrameCheck
from eagor.sources.intrinsics import read_camera
from eagor.sources.rigs import read_rig

POSES = [
    b"stamp,qw,qx,qy,qz,x,y,z,frame\n0,1,0,0,0,0,0,1,a.png\n0.5,0.99,0.1,0.1,0,0.1,0,1,\n1,0,0,0,1,0,0,1,b.png\n",
    b"\xef\xbb\xbf# odometry\r\nstamp,yaw_deg,pitch_deg,roll_deg\r\n0,0,0,0\r\n1.5,-10,\"2\",3\r\n",
    b"# timestamp tx ty tz qx qy qz qw\n0.5 1 2 3 0 0 0.1 0.995\n1.5 1.1 2 3 0 0 0.2 0.98\n",
    b"#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n"
    b"1650000000500000000,1,2,3,1,0,0,0\n1650000001500000000,1,2,3,0.99,0,0.1,0.1\n",
    b"# Image list with two lines of data per image:\n1 0.98 0.1 0.1 0.1 1 2 3 1 0.5.png\n10.5 20.5 -1\n"
    b"2 1 0 0 0 1 2 3 1 1.5.png\n\n",
    b'{"camera_model": "EQUIRECTANGULAR", "frames": [{"file_path": "images/0.5.png", "transform_matrix": '
    b"[[1, 0, 0, 1], [0, 0, -1, 2], [0, 1, 0, 3], [0, 0, 0, 1]]}]}",
]  # fmt: skip
CAMERAS = [
    b"image_width: 64\nimage_height: 48\ncamera_name: narrow\ncamera_matrix: {rows: 3, cols: 3, data: [50, 0, 32, 0, "
    b"51, 24, 0, 0, 1]}\ndistortion_model: plumb_bob\ndistortion_coefficients: {data: [-0.3, 0.1, 0.001, 0, 0]}\n",
    b"cam0:\n  camera_model: pinhole\n  distortion_coeffs: [-0.02, 0.004, 0, 0]\n  distortion_model: equidistant\n"
    b"  intrinsics: [50, 51, 32, 24]\n  resolution: [64, 48]\n",
    b'<?xml version="1.0"?>\n<opencv_storage><image_width>64</image_width><image_height>48</image_height>'
    b'<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>50 0 32 0 51 24 0 0 1</data>'
    b'</camera_matrix><distortion_coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>'
    b"<data>-0.3 0.1 0.001 0 0</data></distortion_coefficients></opencv_storage>",
]
GPANO = [
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><r:RDF xmlns:r="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><r:Description '
    b'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:ProjectionType="equirectangular" '
    b'GPano:PosePitchDegrees="-5" GPano:PoseRollDegrees="8" GPano:FullPanoWidthPixels="64" '
    b'GPano:FullPanoHeightPixels="32" GPano:CroppedAreaLeftPixels="2" GPano:CroppedAreaTopPixels="6"/></r:RDF>'
    b"</x:xmpmeta>",
]
ANSWERS = [
    b'```json\n[{"bbox_2d": [100, 200, 300, 400], "label": "chair", "score": 0.8}]\n```',
    b"<think>Is it [1, 2, 30, 40]?</think>The chair is at (100, 200), (300, 400) in the image.",
    b"<object><name>chair</name><bndbox><xmin>100</xmin><ymin>200</ymin><xmax>300</xmax><ymax>400</ymax></bndbox>",
    b"left: 10%, top: 20 %, right: 30%, bottom: 40%", b"There is no red chair in the image.", b"Answer: yes",
]  # fmt: skip
PANO, VIEW = {"width": 64, "height": 32}, {"projection": "perspective", "width": 32, "height": 24, "hfov_deg": 90}
RECORDS = [
    {"stamp": 1.0, "query": "red chair", "image": PANO, "boxes": [{"box": [3, 4, 9, 12], "score": 0.5, "label": "x"}]},
    {"stamp": 2, "image": VIEW, "boxes": [{"box": [1, 1, 9, 9]}]},
    {"stamp": 3.5, "points": [{"azimuth_deg": 30, "elevation_deg": -5, "spread_deg": 4, "score": 0.9}]},
    {"stamp": 4, "response": {"rows": 2, "cols": 4, "values": [0, 0.1, 0.2, 0.3, 1, 0, 0, 0.5]}},
    {"stamp": 5, "image": VIEW | {"yaw_left_deg": 30, "pitch_up_deg": 10}, "points": []},
    {"stamp": 6, "image": VIEW | {"roll_right_deg": 8}, "boxes": [{"box": [1, 1, 9, 9]}]},
    {"stamp": 6.1, "image": VIEW | {"qw": 1, "qx": 0, "qy": 0, "qz": 0}, "_note": 1, "boxes": []},
]
CALIBRATION = {
    "perception": "scout",
    "calibration": {"floor": 0.3, "neutral": 0.05, "temperature": 2.0, "persistence": 0.1, "spread": 0.05},
    "detector": {"detection_probability": 0.7, "spread": 0.1, "score_ratios": [[0.2, 0.5], [0.9, 4.0]]},
    "forgetting": {"wander": [0.1, 0.3], "start": 0.01, "stop": 0.2, "jump": 0.01},
    "found_by": {"judged by": [1]},
}
HEADS = {"model": "m", "model_type": "qwen2_5_vl", "heads": [[3, 1], [4, 0]], "saturation": 0.7, "found_by": {"of": 8}}
LABELS = [
    {"image": "a.png", "query": "red chair", "azimuth_deg": 30.5, "elevation_deg": -12, "radius_deg": 6},
    {"image": "a.png", "query": "the sofa", "box": [10, 4, 20, 9]},
]
TRUTHS = [
    {"stamp": 1.0, "query": "red chair", "targets": [{"azimuth_deg": 30, "elevation_deg": -5}], "group": "one"},
    {"stamp": 2, "query": "fridge", "targets": []},
]
RIG = b"""pictures:
  - {width: 400, height: 200}
lenses:
  - {name: front, centre: [100, 100], radius: 100, field_deg: 200}
  - {name: back, centre: [300, 100], radius: 100, field_deg: 200, rotation: {yaw_deg: 180}}
"""
KEPT = [
    {"key": "a", "task": "t", "attempt": 1, "status": "ok", "seconds": 0.1, "x": [1]},
    {"key": "a", "task": "t", "attempt": 2, "status": "failed", "error": "no"},
    {"key": "b", "task": "t", "attempt": 1, "status": "ok", "seconds": 0.1},
]
RUN = {"task": "navigation", "seed": 3, "versions": {"eagor": "1", "apartment": 4}, "methods": ["eagor"]}


def lines(entries):
    return "".join(as_text(entry) + "\n" for entry in entries).encode("utf-8", "surrogatepass")


def blobs(*valid):
    """JSON lines of which one is mutated, or the whole as damaged bytes."""
    entries = list(valid)

    @st.composite
    def changed(draw):
        at = draw(st.integers(0, len(entries) - 1))
        return lines([*entries[:at], draw(trees([entries[at]])), *entries[at + 1 :]])

    return st.one_of(changed(), damaged([lines(entries)]))


def objects(valid):
    """One JSON object, mutated, or its text as damaged bytes."""
    return st.one_of(trees([valid]).map(lambda tree: lines([tree])), damaged([json.dumps(valid).encode()]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("texts")


def poses_hold(found, path):
    stamps = [pose.stamp for pose in found]
    assert stamps == sorted(set(stamps))
    assert np.isfinite(stamps).all()
    for pose in found:
        assert np.allclose(pose.world_R_body @ pose.world_R_body.T, np.eye(3), atol=1e-6)
        assert pose.position is None or np.isfinite(pose.position).all()
    for axes in ("auto", *AXES):
        made = reads(lambda axes=axes: settled(found, axes, path.name, None, len))
        assert made is None or np.isfinite([pose.world_R_body for pose in made]).all()


def lenses_hold(found, path):
    for lens in found.lenses:
        assert min(lens.reach, lens.pixels_per_radian) > 0
        assert np.isfinite(lens.unproject(*np.random.default_rng(0).uniform(0, 1, (2, 9)) * [[64], [48]])).all()


def photographs_hold(found, path):
    assert (found.picture.dtype, found.picture.ndim) == (np.uint8, 3)
    assert found.level_R_body is None or np.isfinite(found.level_R_body).all()


def photograph(xmp):
    """The bytes of a JPEG of a part of a panorama with this packet."""
    Image.new("RGB", (60, 20)).save(file := io.BytesIO(), "JPEG", xmp=xmp[:60_000])
    return file.getvalue()


def records_hold(found, path):
    for record in found:
        evidence = reads(lambda record=record: record.evidence("red chair"))
        assert evidence is None or np.isfinite(np.asarray(evidence.log_ratio)).all()
    look = reads(lambda: ReplayPerception(path)(None, "red chair", stamp=found[0].stamp), path.name)
    assert look is None or isinstance(look, Evidence)


def truths_hold(found, path):
    for truth in found:
        assert math.isfinite(truth.stamp)
        assert all(abs(at.azimuth_deg) <= 360 and abs(at.elevation_deg) <= 90 for at in truth.targets)


def labels_hold(found, path):
    for look in found:
        assert abs(np.linalg.norm(look.direction) - 1) < 1e-9
        assert 0 < look.radius <= math.pi


def written_again(read):
    def holds(found, path):
        again = path.with_name(f"again {path.name}")
        found.write(again)
        assert read(again) == found

    return holds


def labelled(path):
    return [*read_labelled(path, lambda _: np.zeros((32, 64, 3), np.uint8))]


LINE = ("line ", "cannot be read", "is empty", "no poses", "no records", "no true", "no labels")
READERS = {  # a file: what it holds, who reads it, which words an error has beside its name, what holds of the result
    "poses.csv": (damaged(POSES), read_poses, LINE, poses_hold),
    "looks.jsonl": (blobs(*RECORDS), lambda path: read_looks(path)[1], LINE, records_hold),
    "truth.jsonl": (blobs(*TRUTHS), read_truth, LINE, truths_hold),
    "calibration.json": (objects(CALIBRATION), read_calibrated, (), written_again(read_calibrated)),
    "heads.json": (objects(HEADS), read_heads, (), written_again(read_heads)),
    "labels.jsonl": (blobs(*LABELS), labelled, LINE, labels_hold),
    "predictions.jsonl": (
        blobs({"case": "a/0/0", "submit": [3, 4]}, {"doc_id": 1, "text": "<answer>x</answer>"}),
        lambda path: predicted(path, ["a/0/0", "b/0/0"]),
        ("line ", "cannot"),
        lambda found, path: set(found) <= {"a/0/0", "b/0/0"},
    ),
    "rig.yaml": (damaged([RIG]), read_rig, (), lambda found, path: len(found.lenses) > 0),
    "camera.yaml": (damaged(CAMERAS), read_camera, (), lenses_hold),
    "cameras.txt": (damaged([b"1 OPENCV 640 480 500 501 320 240 -0.1 0.01 0 0\n"]), read_camera, (), lenses_hold),
    "photo.jpg": (damaged(GPANO).map(photograph), FrameCheck(True).read, (), photographs_hold),
}


@pytest.mark.parametrize("name", READERS)
@HOSTILE
@given(data=st.data())
def test_a_file_holds_a_right_value_or_is_named_in_the_error(folder, name, data):
    content, read, words, holds = READERS[name]
    path = folder / name
    path.write_bytes(data.draw(content))
    found = reads(lambda: read(path), name, also=words)
    if found is not None:
        assert holds(found, path) in (None, True)


@HOSTILE
@given(damaged(ANSWERS), st.sampled_from(["pixels", "thousand", "percent", "unit"]))
def test_answers(blob, frame):
    """Of a model: boxes within the picture, and a presence that is a probability."""
    text = blob.decode("utf-8", "replace")
    for box in reads(lambda: parse_boxes(text, frame, (448, 896))) or ():
        assert 0 <= box.x0 < box.x1 <= 1
        assert 0 <= box.y0 < box.y1 <= 1
        assert 0 <= box.score <= 1
    presence = reads(lambda: parse_presence(text))
    assert presence is None or 0 <= presence <= 1


@HOSTILE
@given(blobs(*KEPT))
@example(lines([KEPT[0]]) + b"[" * 3000)  # a torn last line that json cannot even refuse in the usual way
@example(lines([KEPT[0] | {"attempt": 0}]))
@example(lines([KEPT[0] | {"attempt": True}]))
def test_logs(folder, blob):
    path = folder / "records.jsonl"
    path.write_bytes(blob)
    before = reads(lambda: log.read(folder), "records.jsonl, line ")
    with log.Log(folder) as book:
        assert book.path == path
        book.append({"key": "z", "attempt": 1, "status": "ok"})
    after = reads(lambda: log.read(folder), "records.jsonl, line ")
    assert (before is None) == (after is None)
    if after is not None:
        kept = {record["key"]: record for record in before} | {"z": {"key": "z", "attempt": 1, "status": "ok"}}
        assert {r["key"]: r for r in after if r["key"] != "z"} == {k: r for k, r in kept.items() if k != "z"}
        assert [r["key"] for r in after] == sorted(kept)
        assert all(r["attempt"] >= 1 and r["status"] in ("ok", "failed") for r in after)


@at_most(25)
@given(objects(RUN))
def test_descriptions_of_runs(folder, blob):
    (folder / "run.json").write_bytes(blob)
    found = reads(lambda: log.description(folder), "run.json")
    assert found is None or isinstance(found, dict)
    with log.Log(folder) as book:
        reads(lambda: book.begin(RUN), str(folder))


QUATERNIONS = "stamp,qw,qx,qy,qz\n"


@pytest.mark.parametrize("read", [read_poses, read_calibrated, read_heads, labelled_lines, read_labels, read_truth])
def test_a_pipe_that_nobody_writes_to_is_refused(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(EagorError, match=r"pipe"):
        read(tmp_path / "pipe")


def test_a_link_to_a_file_is_read(tmp_path):
    (tmp_path / "real.csv").write_text(QUATERNIONS + "0,1,0,0,0\n")
    (tmp_path / "link.csv").symlink_to(tmp_path / "real.csv")
    assert len(read_poses(tmp_path / "link.csv")) == 1


def test_an_object_has_each_key_once(tmp_path):
    file = tmp_path / "calibration.json"
    text = json.dumps(CALIBRATION)
    file.write_text(text[:-1] + ', "perception": "colour"}')
    with pytest.raises(EagorError, match="an object has the key 'perception' twice"):
        read_calibrated(file)
    file.write_text(text.replace('"floor": 0.3', '"floor": 0.3, "floor": 0.3'))
    with pytest.raises(EagorError, match="an object has the key 'floor' twice"):
        read_calibrated(file)
