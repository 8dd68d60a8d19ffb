"""eagor camera calibrate, view, latency; locate and track with --rig: as typed, on pictures made here."""

import json
import math
from dataclasses import replace

import clips
import numpy as np
import pytest
import rigs
from commands import answer, eagor, refused
from moving_rooms import PatternRoom
from PIL import Image
from rigs import seen_by

from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import EYE, Room, bearing, painted_room
from eagor.sources.panorama import turn, view
from eagor.sources.rigs import read_rig, write_rig
from eagor.sphere import world_R_body

pytest.importorskip("cv2")
pytest.importorskip("av")
TRUE = rigs.distorted_rig(256)
ROOM = painted_room(256, 512)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Pictures of a camera that turned, of one that looks at a room, a video, and the true rig."""
    folder = tmp_path_factory.mktemp("camera")
    patterns = PatternRoom(7, cells=12)
    for k in range(4):
        picture = seen_by(TRUE, patterns.panorama(world_R_body(math.pi / 2 * k + 0.2 * k), rows=384))[0]
        Image.fromarray(picture).save(folder / f"turned{k}.png")
    write_rig(TRUE, folder / "true.yaml")
    circles = seen_by(TRUE, ROOM)[0]
    Image.fromarray(circles).save(folder / "room.png")
    (folder / "frames").mkdir()
    pictures = [seen_by(TRUE, turn(ROOM, world_R_body(-0.2 * k)))[0] for k in range(3)]
    for k, picture in enumerate(pictures):
        Image.fromarray(picture).save(folder / "frames" / f"{k}.png")
    clips.clip(folder / "room.mp4", [circles] * 6, rate=2, options={"crf": "10"})
    return folder


def test_calibrate_writes_a_rig_that_view_finds_better(place):
    rig = place / "fitted.yaml"
    pictures = [place / f"turned{k}.png" for k in range(4)]
    told = answer("camera", "calibrate", *pictures, "--turned", "--out", rig)
    assert told["moments"] == 4
    assert told["gap_deg"] < told["before_deg"]
    assert rigs.off(read_rig(rig), TRUE).max() < 1
    assert rig.read_text().startswith("# ")
    view = ("camera", "view", pictures[0])
    ideal, fitted = (answer(*view, *words, "--out", place / "seam.png") for words in ((), ("--rig", rig)))
    assert fitted["median_deg"] < 0.5 < ideal["median_deg"]
    assert fitted["grey_levels"] < ideal["grey_levels"]
    with Image.open(place / "seam.png") as image:
        assert image.width == image.height
    assert "deg apart (median of" in eagor(*view, "--rig", rig).stdout
    assert "two ideal lenses of 200 degrees" in eagor(*view).stderr


def test_locate_finds_the_ball_in_circles(place):
    said = refused("locate", place / "room.png", "red")
    assert "two circles of a dual fisheye" in said
    assert "--rig" in said
    for picture in ("room.png", "room.mp4"):
        found = answer("locate", place / picture, "red", "--rig", place / "true.yaml")
        assert abs(found["azimuth_deg"] - red_ball(np.eye(3))) < 2


def test_track_follows_it_through_pictures_and_a_video_of_lenses(place):
    rig = ("--rig", place / "true.yaml")
    azimuths = [frame["azimuth_deg"] for frame in answer("track", place / "frames", "red", *rig)["frames"]]
    assert np.diff(azimuths) == pytest.approx([-math.degrees(0.2)] * 2, abs=2)
    assert len(answer("track", place / "room.mp4", "red", *rig)["frames"]) == 6


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    """A folder of panoramas of a camera that swings, whose stamps are 0.2 s late, and its odometry."""
    folder = tmp_path_factory.mktemp("swinging")
    room = PatternRoom(1, cells=10)

    def yaw(t):
        return 0.5 * math.sin(2 * t) + 0.2 * math.sin(4.7 * t + 1)

    (folder / "frames").mkdir()
    for k in range(40):
        stamp = 1.2 + 0.1 * k
        picture = room.panorama(world_R_body(yaw(stamp - 0.2)), rows=128)
        Image.fromarray(picture).save(folder / "frames" / f"{stamp:.3f}.png")
    rows = [f"{t:.3f},{math.degrees(yaw(t)):.5f},0,0" for t in np.arange(0, 6.5, 0.02)]
    (folder / "odometry.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *rows]))
    still = [f"{t:.3f},10,0,0" for t in np.arange(0, 6.5, 0.02)]
    (folder / "still.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *still]))
    return folder


@pytest.mark.slow
def test_latency_is_estimated_from_pictures_and_odometry(swinging):
    told = answer("camera", "latency", swinging / "frames", "--poses", swinging / "odometry.csv")
    assert told["latency_s"] == pytest.approx(0.2, abs=0.02)
    assert told["low_s"] - 0.01 <= 0.2 <= told["high_s"] + 0.01


def test_latency_refuses_what_cannot_tell(swinging):
    said = refused("camera", "latency", swinging / "frames", "--poses", swinging / "still.csv")
    assert "Turn the camera left and right" in said


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["calibrate", "one.png"], "there is no file"),
        (["calibrate", "room.png"], "wanted two or more"),
        (["calibrate", "room.png", "room.png", "--out", "room.png"], "is an input"),
        (["view", "room.png", "--rig", "nowhere.yaml"], "nowhere.yaml cannot be read as a calibration"),
        (["view", "room.png", "--out", "x.txt"], "ends in .png"),
        (["latency", "/dev/video99", "--poses", "poses.csv"], "there is no /dev/video99"),
        (["latency", "frames", "--poses", "nowhere.csv"], "nowhere.csv cannot be read"),
        (["veiw", "room.png"], "veiw"),
        (["latency", "frames"], "--poses"),
    ],
)
def test_mistakes_are_named(place, monkeypatch, words, says):
    monkeypatch.chdir(place)
    assert says in refused("camera", *words)


RIG_OF_TWO = """
pictures: [{width: 240, height: 180}, {width: 240, height: 180}]
lenses:
  - name: front_optical_frame
    kind: pinhole
    focal: 130
    centre: [120, 90]
    rotation: {x: -0.5, y: 0.5, z: -0.5, w: 0.5}
    position: [0.1, 0.0, 0.3]
  - {name: back, kind: pinhole, picture: 1, focal: 130, centre: [120, 90], rotation: {yaw_deg: 180}}
"""


@pytest.fixture
def two_cameras(tmp_path):
    """Writes rig.yaml, front.mp4 and back.mp4 of a body that turns by `step` between pictures; returns its poses."""

    def made(step, count):
        (tmp_path / "rig.yaml").write_text(RIG_OF_TWO)
        with pytest.warns(UserWarning, match=r"lenses\[0\].position is ignored"):
            lenses = read_rig(tmp_path / "rig.yaml").lenses
        assert np.allclose(lenses[0].body_R_lens, np.eye(3), atol=1e-9)
        room, poses = painted_room(256, 512), [world_R_body(step * k) for k in range(count)]
        for lens, name in zip(lenses, ("front", "back"), strict=True):
            grid = PerspectiveGrid.of_lens(lens)
            pictures = [view(room, replace(grid, body_R_view=pose @ lens.body_R_lens)) for pose in poses]
            clips.clip(tmp_path / f"{name}.mp4", pictures, rate=10, options={"crf": "10"})
            Image.fromarray(pictures[0]).save(tmp_path / f"{name}.png")
            (tmp_path / name).mkdir()
            for k, picture in enumerate(pictures[:3]):
                Image.fromarray(picture).save(tmp_path / name / f"{k}.png")
        return poses

    return made


def red_ball(pose):
    """Its azimuth, degrees, from the middle of the room."""
    truth = bearing(Room().balls[0], EYE, pose)[0]
    return math.degrees(math.atan2(truth[1], truth[0]))


@pytest.mark.filterwarnings("ignore:lenses.0..position is ignored")
def test_track_takes_a_folder_for_each_camera_of_a_rig(tmp_path, two_cameras):
    """What belongs together has the same place in both."""
    poses, rig = two_cameras(0.16, 3), ("--rig", tmp_path / "rig.yaml")
    lines = [f"{0.5 * k},{math.degrees(0.16 * k)},0,0" for k in range(3)]
    (tmp_path / "poses.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *lines]))
    both = f"{tmp_path / 'front'},{tmp_path / 'back'}"
    frames = answer("track", both, "red", *rig, "--poses", tmp_path / "poses.csv")["frames"]
    assert [each["frame"] for each in frames] == [f"{k}.png" for k in range(3)]
    for pose, each in zip(poses, frames, strict=True):
        assert abs(math.remainder(each["azimuth_deg"] - red_ball(pose), 360)) < 3
    (tmp_path / "back" / "2.png").unlink()
    assert "hold different numbers of pictures: 3 in " in refused("track", both, "red", *rig)
    assert "give 2 folders with commas between" in refused("track", tmp_path / "front", "red", *rig)


@pytest.mark.filterwarnings("ignore:lenses.0..position is ignored")
def test_locate_and_live_look_at_a_rig_of_ordinary_lenses(tmp_path, two_cameras):
    poses, rig = two_cameras(0.16, 6), ("--rig", tmp_path / "rig.yaml")
    for kind in ("png", "mp4"):
        both = f"{tmp_path / 'front'}.{kind},{tmp_path / 'back'}.{kind}"
        found = answer("locate", both, "red", *rig, "--picture", tmp_path / "drawn.png")
        assert found["frame"] == f"front.{kind}, back.{kind}"
        assert abs(math.remainder(found["azimuth_deg"] - red_ball(poses[0]), 360)) < 3
        with Image.open(tmp_path / "drawn.png") as drawn:
            assert drawn.width > 240
    refused("locate", tmp_path / "front.png", "red", *rig)
    done = eagor("live", both, "red", *rig, "--perception", "colour", "--fast", "--json")
    assert done.returncode == 0, done.stderr
    assert "6 pictures, 6 looks" in done.stderr
    last = json.loads(done.stdout.splitlines()[-1])
    assert abs(math.remainder(last["azimuth_deg"] - red_ball(poses[-1]), 360)) < 3
