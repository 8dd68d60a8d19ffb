"""Lenses that are fitted, and latencies that are estimated, agree with those that made the pictures and the turns."""

import math

import numpy as np
import pytest
import rigs
from moving_rooms import PatternRoom
from rigs import seen_by
from scipy.spatial.transform import Rotation

from eagor.cameras import dual_fisheye
from eagor.errors import ImageError, PoseError
from eagor.sources import Pose
from eagor.sources.calibration import calibrate, first_rig, latency_between, overlap_of
from eagor.sphere import world_R_body

pytest.importorskip("cv2")
TRUE = rigs.distorted_rig(384)
HEADINGS = 6


@pytest.fixture(scope="module")
def turned():
    """What the distorted camera sees of a room with patterns while it turns in place."""
    room, moments = PatternRoom(3, cells=12), []
    for k in range(HEADINGS):
        pose = world_R_body(2 * math.pi * k / HEADINGS + 0.1 * k, 0.03 * math.sin(k), 0.02 * math.cos(k))
        moments.append(seen_by(TRUE, room.panorama(pose, rows=512)))
    return moments


@pytest.mark.slow
def test_pictures_of_a_camera_that_turns_give_its_lenses_everywhere(turned):
    """The bar: within 0.3 degrees everywhere, from pictures alone; the start is off by several degrees."""
    steps, start = [], first_rig(turned)
    found = calibrate(turned, turned=True, on_step=lambda: steps.append(1))
    assert rigs.off(start, TRUE).max() > 2
    assert rigs.off(found.rig, TRUE).max() < 0.3
    assert found.gap < found.before / 3
    assert len(steps) == 2 * HEADINGS
    (share, before, grey, _), (_, after, less, _) = (overlap_of(rig, turned[0]) for rig in (start, found.rig))
    assert np.median(after) < np.radians(0.25) < np.median(before)
    assert less < grey
    assert 0.1 < share < 0.2


def test_the_overlap_alone_fits_there(turned):
    """The second circle is turned by a quarter, as sensors that are mounted upright make it."""
    half = TRUE.sizes[0][1]
    found = calibrate([(np.hstack([p[:, :half], np.rot90(p[:, half:])]),) for (p,) in turned[:3]])
    assert found.pairs[1] == 0
    assert found.gap < min(found.before / 3, math.radians(0.2))
    front, back = (lens.body_R_lens for lens in found.rig.lenses)
    roll = Rotation.from_matrix(front.T @ back).as_euler("ZYX", degrees=True)[2]
    assert abs(abs(roll) - 90) < 5


def test_pictures_that_tell_nothing_are_refused():
    black = (np.zeros((128, 256, 3), np.uint8),)
    with pytest.raises(ImageError, match="1 picture; wanted two or more"):
        calibrate([black])
    with pytest.raises(ImageError, match="only 0 points were found again in the overlap"):
        calibrate([black, black])
    with pytest.raises(ImageError, match="picture 2 cannot be related to the one before"):
        calibrate([black, black], turned=True)
    with pytest.raises(ImageError, match="two circles side by side"):
        calibrate([(np.zeros((128, 128, 3), np.uint8),)] * 2)
    with pytest.raises(ImageError, match="2 different sizes"):
        calibrate([black, (np.zeros((64, 128, 3), np.uint8),)])


def test_circles_are_found_where_they_are(turned):
    for lens, wanted in zip(first_rig(turned).lenses, TRUE.lenses, strict=True):
        assert np.abs(np.subtract(lens.centre, wanted.centre)).max() < 1
        assert lens.radius == pytest.approx(wanted.radius, abs=1.5)


def test_the_difference_of_the_lenses_is_drawn():
    picture = np.full((128, 256, 3), 100, np.uint8)
    picture[:, 128:] = 130
    rig = dual_fisheye(256, 128)
    _, gaps, grey, drawn = overlap_of(rig, [picture])
    assert len(gaps) == 0
    assert grey == pytest.approx(30, abs=0.5)
    below = drawn[rig.rows :]
    assert (below[rig.rows // 2, rig.rows // 2] == 120).all(), "where both see: four times the difference"
    assert tuple(below[rig.rows // 2, rig.rows]) == (12, 16, 40), "straight ahead only one sees"


# --- latency ---------------------------------------------------------------------------------------------------------


def wobble(times, scale=1.0):
    return scale * (0.8 * np.sin(1.3 * times) + 0.4 * np.sin(3.1 * times + 1) + 0.1 * times)


def odometry(scale=1.0, end=30.0, rate=50.0):
    times = np.arange(0, end, 1 / rate)
    yaw = wobble(times, scale)
    return [Pose(float(t), world_R_body(float(a), 0.03 * math.sin(9 * t))) for t, a in zip(times, yaw, strict=True)]


def camera_steps(latency, noise=0.002, rate=10.0, sign=1.0, scale=1.0):
    stamps = np.arange(2, 28, 1 / rate)
    yaw = sign * wobble(stamps - latency, scale)
    turned = np.diff(yaw) + np.random.default_rng(0).normal(0, noise, len(stamps) - 1)
    return np.stack([stamps[:-1], stamps[1:], turned], axis=1)


@pytest.mark.parametrize("latency", [0.0, 0.037, 0.5, -0.1])
def test_the_latency_comes_out_finer_than_the_pictures_interval(latency):
    found = latency_between(camera_steps(latency), odometry())
    assert found.seconds == pytest.approx(latency, abs=0.006)
    low, high = found.interval
    assert low - 0.004 <= latency <= high + 0.004
    assert high - low < 0.05
    assert found.correlation > 0.98


def test_more_noise_gives_a_wider_interval():
    widths = [np.ptp(latency_between(camera_steps(0.2, noise), odometry()).interval) for noise in (0.001, 0.03)]
    assert widths[1] > 3 * widths[0]


@pytest.mark.parametrize(
    ("steps", "poses", "says"),
    [
        (camera_steps(0.2, scale=0.0), odometry(0.0), "turning rate varies by 0.0 degrees per second.*Turn the camera"),
        (camera_steps(0.2, noise=3.0), odometry(), "do not agree at any shift up to 0.5 s"),
        (camera_steps(0.2, sign=-1.0), odometry(), "turn the other way at any shift up to 0.5 s"),
        (camera_steps(0.8), odometry(), "search farther|do not agree"),
        (camera_steps(0.2), odometry(end=3.0), "steps between pictures lie within the odometry"),
        (camera_steps(0.2), odometry()[:1], "1 poses"),
        (np.empty((0, 3)), odometry(), "none that could be compared"),
    ],
)
def test_a_motion_that_does_not_tell_is_refused(steps, poses, says):
    with pytest.raises(PoseError, match=says):
        latency_between(steps, poses, most=0.5)
