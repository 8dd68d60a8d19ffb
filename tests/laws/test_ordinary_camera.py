"""An ordinary camera: what it did not look at gains and loses nothing, and what it saw is where it is."""

import math

import numpy as np
import pytest
from clips import clip
from PIL import Image

from eagor.cameras import Lens, Rig
from eagor.errors import ImageError
from eagor.evidence.calibration import Calibration
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.lab.worlds.painted import EYE, Room, bearing, painted_room
from eagor.live.core import LiveCore, LoopSettings
from eagor.live.in_turn import ByFrame, answers_in_turn
from eagor.live.inference import InferenceWorker
from eagor.perception.colour import ColourPerception
from eagor.perception.fusion import ViewBox, fuse_views
from eagor.sources import Frame, Pose
from eagor.sources.camera_sources import FrameCheck, ShapeError, open_source
from eagor.sources.intrinsics import (
    Camera,
    IntrinsicsHint,
    camera_of,
    intrinsics_from_exif,
    intrinsics_from_tags,
    ordinary_grid,
)
from eagor.sources.odometry import PosedFrame
from eagor.sources.panorama import cut, turn
from eagor.sphere import angular_distance, world_R_body
from eagor.tracking.checkpoint import packed, unpacked

RED = bearing(Room().balls[0], EYE, np.eye(3))[0]
ROOM = painted_room(256, 512)
AHEAD = math.atan2(RED[1], RED[0])
LENS = Lens("phone", (320, 240), (240.0, 238.0), (165.0, 117.0), (-0.2, 0.05, 0.002, -0.001))
GRIDS = [PerspectiveGrid(240, 320, math.radians(70)), PerspectiveGrid.of_lens(LENS)]


def shown(grid, pose):
    """What a camera shows from the middle of the painted room."""
    return cut(turn(ROOM, pose.T), grid)[0]


def journey(yaws, grid, looks=math.inf):
    """Frames a second apart, of which the first are looked at; without a grid, panoramas."""
    for k, yaw in enumerate(yaws):
        pose = world_R_body(yaw)
        picture = turn(ROOM, pose.T) if grid is None else shown(grid, pose)
        yield PosedFrame(Frame(float(k), picture, f"{k}", grid), Pose(float(k), pose), looked=k < looks)


def follow(frames, perception, query):
    """The answer at each frame."""
    found, core = [], LiveCore(LoopSettings((query,), exact=True))
    by_frame = ByFrame(found.append)

    def take(event):
        answers = core.take(event)
        by_frame.take(event, answers)
        return answers

    list(answers_in_turn(frames, core, InferenceWorker(perception), take))
    return found


@pytest.mark.parametrize(
    ("grid", "calibration"), [(GRIDS[0], None), (GRIDS[1], None), (GRIDS[1], Calibration())],
    ids=["ideal", "calibrated", "responses"],
)  # fmt: skip
def test_what_a_camera_does_not_look_at_changes_nothing(grid, calibration):
    """Looks away from what was seen are as good as none, but for the places that they rule out."""
    yaws = [AHEAD + 0.1 * k for k in range(-2, 3)] + [AHEAD + math.pi + 0.05 * k for k in range(6)]
    perception = ColourPerception(calibration=calibration)
    away, none = (follow(journey(yaws, grid, looks), perception, "red") for looks in (99, 5))
    assert all(each.problem is None and each.grid is grid for each in away)
    for yaw, one, other in zip(yaws[5:], away[5:], none[5:], strict=True):
        assert angular_distance(world_R_body(yaw) @ one.estimate.direction, RED) < math.radians(3)
        assert one.estimate.presence > other.estimate.presence - 0.02


def test_the_unseen_keeps_its_proportions():
    """Looks at one side say nothing of how what is on the other side compares with itself."""
    yaws, cells = [0.05 * k for k in range(4)], ErpGrid(18, 36).directions.reshape(-1, 3)
    behind = cells[cells[:, 0] < -0.5]
    for calibration in (None, Calibration()):
        frames = journey(yaws, GRIDS[1])
        found = follow(frames, ColourPerception(calibration=calibration), "purple")
        last = found[-1].estimate.log_density(behind @ world_R_body(yaws[-1]))
        assert np.ptp(last) < (0.01 if calibration is None else 0.1)  # a field of degree 15 leaks a little


@pytest.mark.parametrize("grid", GRIDS, ids=["ideal", "calibrated"])
def test_the_direction_is_that_of_panoramas(grid):
    yaws = [AHEAD + 0.1 * k for k in range(-1, 2)]
    both = [follow(journey(yaws, each), ColourPerception(), "red") for each in (grid, None)]
    for ordinary, panorama in zip(*both, strict=True):
        off = angular_distance(ordinary.estimate.direction, panorama.estimate.direction)
        assert off < math.radians(3.2)  # the lower edge of the picture cuts the ball


def test_a_thing_that_a_distorted_picture_cuts_goes_on_as_in_an_ideal_one():
    """The same thing, cut by the same direction, through a lens with distortion and one without."""
    ideal, pose = Lens("ideal", (320, 240), (240.0, 240.0), (160.0, 120.0)), np.eye(3)
    bent = Lens("bent", (320, 240), (240.0, 240.0), (160.0, 120.0), (-0.25, 0.06))
    edge = bent.plane(np.array(320.0), np.array(120.0))[0]  # so wide sees the bent one
    wide = Lens("wide", (round(2 * 240 * float(edge)), 240), (240.0, 240.0), (240 * float(edge), 120.0))
    x0, y0, y1 = bent.plane(np.array(250.0), np.array(120.0))[0], -0.2, 0.2
    plain = np.array([240 * (float(edge) + float(x0)), 120 + 240 * y0, wide.size[0], 120 + 240 * y1])
    mid = (float(x0) + float(edge)) / 2
    rows = bent.project(np.array([[1.0, -mid, -y0], [1.0, -mid, -y1]]) @ pose)[1]
    box = np.array([250.0, rows[0], 320.0, rows[1]])
    found = [
        fuse_views([ViewBox(0, PerspectiveGrid.of_lens(lens), each, 0.9)])[0]
        for lens, each in ((wide, plain), (bent, box))
    ]
    assert angular_distance(found[0].direction, found[1].direction) < math.radians(1)
    inside = bent.unproject(np.array(285.0), np.array(120.0))
    assert found[1].direction[1] < inside[1] - math.radians(3)  # beyond the border, to the right
    assert ideal.unproject(np.array(320.0), np.array(120.0))[1] > found[1].direction[1] - math.radians(15)


# --- where the lens comes from ---


def test_exif_tells_the_lens(tmp_path):
    picture = Image.fromarray(ROOM[:240, :320])
    film = math.degrees(2 * math.atan(320 / (2 * 28 * 400 / math.hypot(36, 24))))
    for tags, hfov in (
        ({0xA405: 28}, film),
        ({0x920A: 4.2, 0xA20E: 640.0, 0xA210: 3, 0xA002: 640, 0xA003: 480}, math.degrees(2 * math.atan(320 / 268.8))),
        ({0xA405: 28, 0xA002: 640, 0xA003: 360}, None),  # it was cropped
        ({0xA405: 0, 0x920A: 4.2}, None),
        ({0xA405: 60000}, None),
        ({}, None),
    ):
        exif = Image.Exif()
        exif._ifds[0x8769] = tags
        picture.save(tmp_path / "a.jpg", exif=exif)
        check = FrameCheck(camera=Camera())
        if hfov is None:
            with pytest.raises(ShapeError, match="--hfov DEGREES"):
                check.read(tmp_path / "a.jpg")
            continue
        grid = check.read(tmp_path / "a.jpg").grid
        assert math.degrees(grid.hfov) == pytest.approx(hfov, abs=0.1)
    assert intrinsics_from_exif(tmp_path / "nothing.jpg") == IntrinsicsHint()
    with pytest.raises(ShapeError, match="not 2:1"):  # where only panoramas will do
        FrameCheck().read(tmp_path / "a.jpg")


def test_a_calibration_fits_its_pictures_in_any_size(tmp_path):
    camera = Camera(Rig((LENS.size,), (LENS,)), name="phone.yaml")
    grid = ordinary_grid(camera, IntrinsicsHint(), (640, 480), "a.jpg")
    np.testing.assert_allclose(grid.unproject(2 * 50.0, 2 * 60.0), LENS.unproject(50.0, 60.0))
    upright = ordinary_grid(camera, IntrinsicsHint(turns=3), (240, 320), "a.jpg")
    assert upright.lens.size == (240, 320)
    as_shown = Camera(Rig(((240, 320),), (LENS.turned(3),)), name="phone.yaml")
    assert ordinary_grid(as_shown, IntrinsicsHint(turns=3), (240, 320), "a.jpg").optics.focal == upright.optics.focal
    for told, size in ((IntrinsicsHint(), (640, 360)), (IntrinsicsHint(), (240, 320))):
        with pytest.raises(ImageError, match=r"a.jpg is .*phone.yaml is for pictures of 320 x 240"):
            ordinary_grid(camera, told, size, "a.jpg")


def test_what_phones_write_into_videos():
    key = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
    told = intrinsics_from_tags({key: "26"}, (1080, 1920), 1)
    assert told.focal == pytest.approx(26 * math.hypot(1080, 1920) / math.hypot(36, 24))
    assert told.turns == 1
    for tags in ({key: "0"}, {key: "wide"}, {key: "1e9"}, {"make": "Apple"}):
        assert intrinsics_from_tags(tags, (1920, 1080), 0).focal is None


def test_a_video_that_changes_its_size(tmp_path):
    """The lens scales with the picture; a picture of another shape shows another part of the world."""
    parts = [(240, 320), (120, 160), (120, 240)]
    pictures = [[ROOM[:high, :wide]] * 4 for high, wide in parts]
    files = [
        clip(tmp_path / f"{k}.mjpeg", each, rate=10, codec="mjpeg", pix_fmt="yuvj420p")
        for k, each in enumerate(pictures)
    ]
    for chosen, ends in (((0, 1), False), ((0, 2), True)):
        whole = tmp_path / "whole.mjpeg"
        whole.write_bytes(b"".join(files[k].read_bytes() for k in chosen))
        read = (frame.grid.shape for frame in open_source(str(whole), camera=Camera(hfov=1.2)))
        if not ends:
            assert [*read] == [(240, 320)] * 8
            continue
        with pytest.raises(ImageError, match="change from 320 x 240 to 240 x 120"):
            list(read)


def test_a_fisheye_s_calibration_makes_a_part_of_a_panorama(tmp_path):
    (tmp_path / "round.yaml").write_text(
        "image_width: 320\nimage_height: 240\ndistortion_model: equidistant\n"
        "camera_matrix: {data: [110, 0, 159.5, 0, 110, 119.5, 0, 0, 1]}\ndistortion_coefficients: {data: [0, 0, 0, 0]}"
    )
    said = []
    check = FrameCheck(camera=camera_of(None, tmp_path / "round.yaml"), say=said.append)
    Image.fromarray(np.full((240, 320, 3), 200, np.uint8)).save(tmp_path / "a.png")
    found = check.read(tmp_path / "a.png")
    assert found.grid is None
    assert any("fisheye" in text for text in said)
    grid = ErpGrid(*found.picture.shape[:2])
    share = (grid.weights * ~found.unseen).sum() / (4 * math.pi)
    angle = np.hypot(np.arange(320)[:, None] - 159.5, np.arange(240) - 119.5) / 110
    assert share == pytest.approx(np.sinc(angle / math.pi).sum() / 110**2 / (4 * math.pi), rel=0.03)
    assert (found.picture[~found.unseen] > 100).mean() > 0.99


def test_a_calibrated_grid_comes_back_from_its_bytes():
    """As looks go from the detector's process to the live loop, and trackers into files."""
    again = unpacked(packed(GRIDS[1]))
    np.testing.assert_array_equal(again.directions, GRIDS[1].directions)
