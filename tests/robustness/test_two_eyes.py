"""Pictures of two eyes that nothing tells of: seen by their likeness, and read as --eyes says."""

import numpy as np
import pytest
from clips import clip
from commands import answer, refused
from PIL import Image

from eagor.errors import ImageError
from eagor.lab.worlds.painted import EYE, Room, bearing, paint
from eagor.sources.camera_sources import open_source
from eagor.sources.defects import TWICE, two_eyes
from eagor.sources.intrinsics import Camera
from eagor.sources.metadata import LAYOUTS
from eagor.sources.panorama import resized, turn
from eagor.sphere import azimuth_elevation, world_R_body

TURN = world_R_body(np.radians(-20))
LEFT, RIGHT = (paint(Room(), tuple(np.array(EYE) + TURN @ [0, side, 0]), TURN, 256, 512) for side in (0.03, -0.03))
RED = np.degrees(azimuth_elevation(bearing(Room().balls[0], EYE, TURN)[0]))
HALF = slice(128, 384)
PICTURES = {
    "left-right": np.hstack([LEFT, RIGHT]),
    "right-left": np.hstack([RIGHT, LEFT]),
    "top-bottom": np.vstack([LEFT, RIGHT]),
    "bottom-top": np.vstack([RIGHT, LEFT]),
    "vr180": np.hstack([LEFT[:, HALF], RIGHT[:, HALF]]),
    "vr180-top-bottom": np.vstack([LEFT[:, HALF], RIGHT[:, HALF]]),
    "left-right, squeezed": resized(np.hstack([LEFT, RIGHT]), (256, 512)),
    "top-bottom, squeezed": resized(np.vstack([LEFT, RIGHT]), (256, 512)),
}


def test_every_layout_is_told_by_the_command_line_too():
    from typing import get_args

    from eagor.cli.options import Eyes

    assert get_args(get_args(get_args(Eyes)[0])[0]) == tuple(LAYOUTS)


@pytest.mark.parametrize(
    ("name", "kind"), [*((name, "png") for name in PICTURES), ("right-left", "mp4"), ("vr180-top-bottom", "mp4")]
)
def test_two_eyes_are_refused_until_the_layout_is_told(tmp_path, name, kind):
    path, layout = tmp_path / f"pair.{kind}", name.partition(",")[0]
    if kind == "png":
        Image.fromarray(PICTURES[name]).save(path)
    else:
        clip(path, [PICTURES[name]] * 4, options={"crf": "12"})
    words = ("locate", path, "the red ball", "--perception", "colour")
    assert "--eyes mono" in refused(*words)
    found = answer(*words, "--eyes", layout)
    assert (found["azimuth_deg"], found["elevation_deg"]) == pytest.approx(RED, abs=2.0)
    if kind == "mp4":
        with pytest.raises(ImageError, match=r"--eyes|not 2:1"):
            next(iter(open_source(str(path))))
        camera = open_source(str(path), camera=Camera(eyes=layout))
        frame = next(iter(camera))
        assert frame.picture.shape[:2] == camera.grid.shape
        assert (frame.unseen is None) == ("vr180" not in layout)
        shown = resized(frame.picture, (256, 512)).astype(int)
        assert np.abs(shown - LEFT)[:, HALF].mean() < 12


def test_rooms_that_turn_are_no_eyes():
    for k in range(12):
        picture = turn(LEFT, world_R_body(0.5 * k, 0.3 * k, 0.2 * k))
        assert two_eyes(picture) == ""
    plain = np.full((256, 512, 3), 150, np.uint8)
    assert two_eyes(plain) == ""
    plain[150:] = (120, 105, 90)  # a wall and a floor: their border is the same all around
    plain[120:140, 60:90] = (205, 25, 25)
    assert two_eyes(plain) == ""
    assert two_eyes(PICTURES["vr180"]) in TWICE


def test_a_panorama_that_repeats_itself_is_taken_where_that_is_said(tmp_path):
    Image.fromarray(np.hstack([LEFT[:, HALF], LEFT[:, HALF]])).save(tmp_path / "twice.png")
    words = ("locate", tmp_path / "twice.png", "the red ball", "--perception", "colour")
    assert "two eyes" in refused(*words)
    for settled in (("--eyes", "mono"), ("--force",)):
        assert answer(*words, *settled)["status"]
    assert "--eyes vr180 is for panoramas" in refused(*words, "--eyes", "vr180", "--hfov", 60)


def test_one_panorama_of_another_shape_is_not_asked_for_its_eyes_again(tmp_path):
    Image.fromarray(np.hstack([LEFT, LEFT])).save(tmp_path / "four.png")
    words = ("locate", tmp_path / "four.png", "the red ball", "--perception", "colour", "--eyes", "mono")
    said = refused(*words)
    assert "not 2:1" in said
    assert "--force" in said
    assert "--eyes" not in said
    assert answer(*words, "--force")["status"]
