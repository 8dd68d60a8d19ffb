"""Look once, ask often: `eagor look` keeps what a detector saw, `eagor track LOOKS.jsonl` answers as on the footage."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clips import clip
from commands import answer, eagor, refused
from PIL import Image

from eagor.cameras import Lens, Rig
from eagor.cli import checks
from eagor.evidence import DetectorModel
from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import painted_room
from eagor.perception.calibrated import Calibrated
from eagor.perception.views import Detector
from eagor.sources.panorama import cut, turn
from eagor.sources.rigs import write_rig
from eagor.sphere import world_R_body

ROWS, COUNT, RATE = 192, 8, 4
POSES = [world_R_body(0.3 * k, 0.2 * math.sin(k), 0.1 * math.cos(k)) for k in range(COUNT)]
MODEL = DetectorModel(detection_probability=0.8, spread=0.03)
PAINTS = ("--perception", "paints")


class Paints:
    """Finds the red and the blue ball of the painted room: classes "ball" and "marble"; notes whether it ran."""

    classes = ("ball", "marble", "door")

    def __init__(self):
        self.looks = 0

    def __call__(self, picture, query):
        self.looks += 1
        r, g, b = np.moveaxis(picture.astype(int), -1, 0)
        boxes, labels = [], []
        for label, mask in (("ball", (r > 120) & (g < 70) & (b < 80)), ("marble", (b > 120) & (r < 70) & (g < 110))):
            rows, columns = np.nonzero(mask)
            if len(rows) > 3:
                boxes.append([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
                labels.append(label)
        return np.array(boxes, dtype=float).reshape(-1, 4), np.full(len(boxes), 0.712345678), labels


@pytest.fixture
def paints(monkeypatch):
    """The perception "paints" of the commands."""
    detect = Paints()
    monkeypatch.setattr(checks, "make_perception", lambda spec, busy=False: Detector(detect, size=128, detector=MODEL))
    return detect


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A clip of a camera that turns, nods and rolls, with a tripod's black patch below it."""
    folder = tmp_path_factory.mktemp("film")
    room = painted_room(ROWS, 2 * ROWS)
    pictures = [turn(room, pose.T) for pose in POSES]
    for picture in pictures:
        picture[-ROWS // 8 :] = 0
    path = clip(folder / "clip.mp4", pictures, rate=RATE, options={"crf": "12"})
    lines = ["stamp,qw,qx,qy,qz,x,y,z"]
    from eagor.conventions import wxyz_from_rotation

    for k, pose in enumerate(POSES):
        lines.append(",".join(map(repr, [k / RATE, *wxyz_from_rotation(pose).tolist(), 0.05 * k, 0.0, 1.2])))
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    return path


def numbers(found):
    """All numbers in an answer, in their order; what is not known, and texts, as they are."""
    if isinstance(found, dict):
        return [each for key, value in found.items() for each in (key, *numbers(value))]
    if isinstance(found, list):
        return [each for value in found for each in numbers(value)]
    return [found]


def agree(found, wanted):
    """Whether two answers say the same of each frame, up to rounding."""
    pairs = zip(numbers(found["frames"]), numbers(wanted["frames"]), strict=True)
    return all(a == pytest.approx(b, abs=2e-3) if isinstance(b, float) else a == b for a, b in pairs)


def looked(source, looks, *words, code=0):
    """What `eagor look` says when it writes a file of looks."""
    done = eagor("look", source, "--out", looks, "--perception", "paints", *words)
    assert done.returncode == code, done.stderr
    return done


@pytest.mark.parametrize("poses", ["auto", "csv"])
def test_what_was_seen_once_answers_as_the_footage_does(paints, film, tmp_path, poses):
    looks, csv = tmp_path / "looks.jsonl", film.with_name("poses.csv")
    told = () if poses == "auto" else ("--poses", csv, "--rate", RATE)
    done = looked(film, looks, *told)
    assert f'eagor track {looks} "marble"' in done.stdout
    assert "black around a pole" in done.stderr
    assert '"valid_mask"' in looks.read_text()
    seen = paints.looks
    answers = {query: answer("track", looks, query) for query in ("ball", "marbles", "door")}
    assert paints.looks == seen, "no detector runs"
    for query, found in answers.items():
        wanted = answer("track", film, query, "--perception", "paints", *told)
        assert found["perception"] == "paints"
        assert found["poses"] == wanted["poses"]
        assert agree(found, wanted)
    answer("track", film, "ball", "--perception", f"replay:{looks}", *told)  # on its pictures, too


def test_what_was_seen_is_listed_the_surest_first(paints, film, tmp_path):
    looks = tmp_path / "looks.jsonl"
    looked(film, looks, "--poses", "auto")
    things = answer("track", looks)["things"]
    assert {each["query"] for each in things} == {"ball", "marble"}, "nobody has seen a door"
    sure = [each["within_15_deg"] for each in things]
    assert sure == sorted(sure, reverse=True)
    assert min(sure) > 0.5
    last = answer("track", looks, things[0]["query"])["frames"][-1]
    assert things[0]["azimuth_deg"] == pytest.approx(last["azimuth_deg"], abs=1e-6)
    assert things[0]["presence"] == pytest.approx(last["presence"], abs=1e-6)
    out = eagor("track", looks).stdout
    assert out.index(things[0]["query"]) < out.index(things[1]["query"])


def test_questions_that_a_file_of_looks_cannot_answer_are_refused(paints, film, tmp_path):
    looks, poseless, headless = (tmp_path / f"{name}.jsonl" for name in ("looks", "other", "headless"))
    looked(film, looks, "--end", 0.6)
    lines = [json.loads(line) for line in looks.read_text().splitlines()]
    poseless.write_text("\n".join(json.dumps(line | {"pose": None}) for line in lines) + "\n")
    headless.write_text("\n".join(json.dumps(line) for line in lines[1:]) + "\n")
    for words, says in (
        ((looks, "sofa"), "the query 'sofa' names none of this detector's 3 classes"),
        ((looks, "brown ball"), "names a colour, and .* holds boxes without pictures; ask for 'ball'"),
        ((looks, "ball", "--video", tmp_path / "a.mp4"), "--video needs pictures.*--perception replay:"),
        ((looks, "ball", "--poses", "level"), "--poses is for footage"),
        ((looks, "--compare"), "--compare is for one question"),
        ((poseless, "ball"), "has a look at 0 s without a pose"),
        ((headless, "ball"), "does not begin with a line about its footage"),
    ):
        assert re.search(says, refused("track", *words))
    assert "sees all of its 3 classes at once" in looked(film, looks, "--for", "ball", code=2).stderr


def test_a_detector_of_any_words_is_asked_once_and_knows_only_that(paints, film, tmp_path, monkeypatch):
    monkeypatch.setattr(Paints, "classes", None)
    looks = tmp_path / "looks.jsonl"
    assert "say what to look for: --for" in looked(film, looks, "--end", 0.6, code=2).stderr
    looked(film, looks, "--end", 0.6, "--for", "ball", "marble")
    assert answer("track", looks, "ball")["frames"][-1]["azimuth_deg"] is not None
    assert "That was never looked for, so nobody knows: eagor look" in refused("track", looks, "door")
    assert len(answer("track", looks)["things"]) == 2


@pytest.fixture
def frames(tmp_path):
    """A folder of four pictures."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for k in range(4):
        Image.fromarray(painted_room(64, 128)).save(folder / f"{k}.png")
    return folder


def test_a_frame_that_cannot_be_read_is_left_out_of_both(paints, frames, tmp_path):
    looks = tmp_path / "looks.jsonl"
    (frames / "2.png").write_bytes(b"no picture")
    err = looked(frames, looks, code=3).stderr
    assert "2.png is left out" in err
    assert err.splitlines()[-1] == "eagor: 1 of 4 frames were left out"
    done = eagor("track", looks, "ball", "--json")
    assert done.returncode == 3
    assert "3 looks of paints at frames, orientations from the pictures themselves; 1 more left out" in done.stderr
    assert "2.png is left out" in done.stderr
    assert [each["frame"] for each in json.loads(done.stdout)["frames"]] == ["0.png", "1.png", "2.png", "3.png"]


def test_an_interruption_says_what_is_kept(paints, frames, tmp_path, monkeypatch):
    looks = tmp_path / "looks.jsonl"
    seen, two = Detector.detect, [1, 2]

    def broken_off(self, *of):
        if not two:
            raise KeyboardInterrupt
        two.pop()
        return seen(self, *of)

    monkeypatch.setattr(Detector, "detect", broken_off)
    done = looked(frames, looks, "--rate", 2, code=130)
    assert done.stdout == ""
    assert done.stderr.splitlines()[-2:] == [f"eagor: kept: {looks}, 2 looks to 0.50 s", "eagor: interrupted"]
    assert len(looks.read_text().splitlines()) == 3, "the footage, and two looks"


def test_where_no_picture_can_be_read_the_input_is_wrong(paints, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("text.png", "more.png"):
        (tmp_path / name).write_bytes(b"no picture")
    track = ("track", "text.png", "ball", "--out", "found.csv")
    for words, code, says in (
        (track, 2, "the only frame could not be read; the reason is above"),
        (("look", "text.png", "--out", "looks.jsonl", "--perception", "paints"), 2, "the only frame could not be read"),
        (("track", "text.png", "more.png", "ball"), 2, "none of the 2 frames could be read; the reasons are above"),
        (track, 1, "the only frame could not be used; the reason is above"),
    ):
        if code == 1:  # it can be read, but is black everywhere
            Image.fromarray(np.zeros((64, 128, 3), np.uint8)).save("text.png")
        done = eagor(*words)
        assert done.returncode == code
        assert done.stderr.splitlines()[-1].startswith(f"eagor: error: {says}")
        assert ("eagor: written: found.csv" in done.stderr) == (words == track)


LENS = Lens("phone", (320, 240), (160.0, 158.0), (165.0, 117.0), (-0.2, 0.05, 0.002, -0.001))


@pytest.mark.parametrize(
    ("told", "view"),
    [
        (("--hfov", 90), PerspectiveGrid(240, 320, math.radians(90))),
        (("--camera", "phone.yaml"), PerspectiveGrid.of_lens(LENS)),
    ],
    ids=["hfov", "camera"],
)
def test_an_ordinary_camera_is_looked_with_as_well(paints, tmp_path, monkeypatch, told, view):
    monkeypatch.chdir(tmp_path)
    write_rig(Rig((LENS.size,), (LENS,)), "phone.yaml")
    room = painted_room(256, 512)
    Path("frames").mkdir()
    for k in range(3):
        shown = replace(view, body_R_view=world_R_body(-0.6 + 0.1 * k))
        Image.fromarray(cut(room, shown)[0]).save(f"frames/{k}.png")
    looked("frames", "looks.jsonl", *told)
    found, wanted = answer("track", "looks.jsonl", "ball"), answer("track", "frames", "ball", *told, *PAINTS)
    assert wanted["frames"][-1]["presence"] > 0.9
    assert agree(found, wanted)


def test_things_that_stand_stay_where_they_were_seen(tmp_path):
    """A ball ahead, seen three times; then a minute of looks back, at nothing."""
    ahead, back = ({"projection": "perspective", "width": 320, "height": 240, "hfov_deg": 70, "yaw_left_deg": yaw}
                   for yaw in (0, 180))  # fmt: skip
    ball = {"box": [150, 110, 170, 130], "score": 0.9, "label": "ball"}
    looks = [(k, ahead, [ball]) for k in range(3)] + [(10.0 + 10 * k, back, []) for k in range(6)]
    pose = {"qw": 1, "qx": 0, "qy": 0, "qz": 0}
    lines = [{"footage": {"of": "a.mp4", "perception": "paints", "classes": ["ball"]}}]
    lines += [
        {"stamp": at, "pose": pose, "views": [{"image": image, "boxes": boxes}]} for at, image, boxes in looks
    ]  # fmt: skip
    file, fitted = tmp_path / "looks.jsonl", tmp_path / "fitted.json"
    file.write_text("\n".join(map(json.dumps, lines)))
    Calibrated("paints", None, {"wander": (0.1, 0.3), "start": 0.05}, {}, DetectorModel()).write(fitted)
    grown = []
    for options in ((), ("--static",), ("--static", "--calibration", fitted)):
        frames = answer("track", file, "ball", *options)["frames"]
        grown.append(frames[-1]["credible_angle_deg"] - frames[2]["credible_angle_deg"])
    assert grown[0] > 1
    assert grown[1] <= 0
    assert grown[2] == grown[1], "said, it wins over what was fitted"
