"""Lenses that are fitted, and latencies that are estimated, agree with those that made the pictures and the turns."""

import math

import numpy as np
import pytest
import rigs
from moving_rooms import PatternRoom
from scipy.spatial.transform import Rotation

from eagor.errors import ImageError, PoseError
from eagor.media import Pose
from eagor.media.latency import Steps, latency_between
from eagor.media.lens_calibration import calibrate, first_rig, overlap_of, with_seam
from eagor.media.lens_fitting import Pairs, solve
from eagor.media.rigs import dual_fisheye
from eagor.media.stitching import seen_by
from eagor.sphere import world_R_body

cv2 = pytest.importorskip("cv2")
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
    steps = []
    found = calibrate(turned, turned=True, on_step=lambda: steps.append(1))
    assert rigs.off(first_rig(turned, math.radians(200)), TRUE).max() > 2
    assert rigs.off(found.rig, TRUE).max() < 0.3
    assert found.used == HEADINGS
    assert found.worst < math.radians(0.5)
    assert found.gap < found.before / 3
    assert len(steps) == 2 * HEADINGS
    before, after = (overlap_of(rig, turned[0]) for rig in (first_rig(turned, math.radians(200)), found.rig))
    assert np.median(after.gaps) < np.radians(0.25) < np.median(before.gaps)
    assert after.grey < before.grey
    assert 0.1 < after.share < 0.2


@pytest.mark.slow
def test_the_overlap_alone_fits_there_and_owns_up_to_the_rest(turned):
    found = calibrate(turned[:3])
    assert found.pairs[1] == 0
    assert found.gap < found.before / 3
    assert found.worst > math.radians(0.7), "nothing tells the inside of the circles"
    assert overlap_of(found.rig, turned[0]).grey < overlap_of(dual_fisheye(768, 384), turned[0]).grey


def test_lenses_that_are_mounted_askew_are_found(turned):
    """The second circle is turned by a quarter, as sensors that are mounted upright make it."""
    half = TRUE.sizes[0][1]
    moments = []
    for (picture,) in turned[:3]:
        moments.append((np.hstack([picture[:, :half], np.rot90(picture[:, half:])]),))
    found = calibrate(moments)
    assert found.gap < math.radians(0.2)
    front, back = (lens.body_R_lens for lens in found.rig.lenses)
    roll = Rotation.from_matrix(front.T @ back).as_euler("ZYX", degrees=True)[2]
    assert abs(abs(roll) - 90) < 5


def test_pictures_that_tell_nothing_are_refused():
    black = (np.zeros((128, 256, 3), np.uint8),)
    with pytest.raises(ImageError, match="1 picture; wanted two or more"):
        calibrate([black])
    with pytest.raises(ImageError, match="only 0 points were found again in the overlap"):
        calibrate([black, black])
    with pytest.raises(ImageError, match="two circles side by side"):
        calibrate([(np.zeros((128, 128, 3), np.uint8),)] * 2)
    with pytest.raises(ImageError, match="2 different sizes"):
        calibrate([black, (np.zeros((64, 128, 3), np.uint8),)])


def test_circles_are_found_where_they_are(turned):
    for lens, wanted in zip(first_rig(turned, 3.4).lenses, TRUE.lenses, strict=True):
        assert np.abs(np.subtract(lens.centre, wanted.centre)).max() < 1
        assert lens.radius == pytest.approx(wanted.radius, abs=1.5)


@pytest.mark.parametrize("seed", range(2))
def test_exact_pairs_give_the_lenses_and_outliers_do_not_hurt(seed):
    """Without pictures: pixels of the same directions at different headings, a tenth of them wrong."""
    random = np.random.default_rng(seed)
    poses = np.stack([world_R_body(k * 0.8, 0.05 * k, 0.0) for k in range(6)])
    moments, lenses, pixels = [], [], []
    while len(moments) < 1200:
        d = random.normal(size=3)
        i, j = random.integers(0, 6, 2)
        a, b = random.integers(0, 2, 2)
        sides = []
        for moment, lens in ((i, a), (j, b)):
            x, y, depth = TRUE.lenses[lens].project(poses[moment].T @ (d / np.linalg.norm(d)))
            if depth > 0:
                sides.append((float(x), float(y)))
        if len(sides) == 2 and (i, a) != (j, b):
            if random.random() < 0.1:
                sides[1] = (sides[1][0] + random.normal() * 3, sides[1][1] + random.normal() * 3)
            moments.append((i, j))
            lenses.append((a, b))
            pixels.append(sides)
    pairs = Pairs(np.array(moments), np.array(lenses), np.array(pixels))
    guess = np.stack([pose @ world_R_body(0.02 * k, 0.01) for k, pose in enumerate(poses)])
    found = solve(dual_fisheye(768, 384), pairs, guess)
    errors = rigs.off(found.rig, TRUE)
    assert errors.max() < 0.1
    sure = [found.spread(k, np.radians([20.0, 50.0, 80.0])) for k in (0, 1)]
    assert math.sqrt((errors**2).mean()) < 3 * np.degrees(np.mean(sure))
    assert np.degrees(np.max(sure)) < 0.3


def test_the_picture_of_the_seam_shows_rims_and_differences():
    rig = dual_fisheye(256, 128)
    picture = np.full((128, 256, 3), 100, np.uint8)
    picture[:, 128:] = 130
    shown = with_seam(rig, [picture], 64)
    assert shown.shape == (128, 128, 3)
    sky, below = shown[:64], shown[64:]
    coloured = np.ptp(sky.astype(int), axis=2) > 60
    assert 0.01 < coloured.mean() < 0.2
    assert (below[32, 32] == 120).all(), "where both see: four times the difference"
    assert tuple(below[32, 64]) == (12, 16, 40), "straight ahead only one sees"


# --- latency ---------------------------------------------------------------------------------------------------------


def wobble(times, scale=1.0):
    return scale * (0.8 * np.sin(1.3 * times) + 0.4 * np.sin(3.1 * times + 1) + 0.1 * times)


def odometry(scale=1.0, end=30.0, rate=50.0):
    times = np.arange(0, end, 1 / rate)
    yaw = wobble(times, scale)
    return [Pose(float(t), world_R_body(float(a), 0.03 * math.sin(9 * t))) for t, a in zip(times, yaw, strict=True)]


def camera_steps(latency, noise=0.002, rate=10.0, sign=1.0, scale=1.0, seed=0):
    stamps = np.arange(2, 28, 1 / rate)
    yaw = sign * wobble(stamps - latency, scale)
    turned = np.diff(yaw) + np.random.default_rng(seed).normal(0, noise, len(stamps) - 1)
    return Steps(stamps[:-1], stamps[1:], turned)


@pytest.mark.parametrize("latency", [0.0, 0.037, 0.212, 0.5, -0.1])
def test_the_latency_comes_out_finer_than_the_pictures_interval(latency):
    found = latency_between(camera_steps(latency), odometry())
    assert found.seconds == pytest.approx(latency, abs=0.006)
    low, high = found.interval
    assert low - 0.004 <= latency <= high + 0.004
    assert high - low < 0.05
    assert found.correlation > 0.98
    assert not found.mirrored


def test_more_noise_gives_a_wider_interval():
    widths = [np.ptp(latency_between(camera_steps(0.2, noise), odometry()).interval) for noise in (0.001, 0.03)]
    assert widths[1] > 3 * widths[0]


def test_pictures_that_turn_the_other_way_are_told():
    found = latency_between(camera_steps(0.2, sign=-1.0), odometry())
    assert found.mirrored
    assert found.seconds == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize(
    ("steps", "poses", "says"),
    [
        (camera_steps(0.2, scale=0.0), odometry(0.0), "turning rate varies by 0.0 degrees per second.*Turn the camera"),
        (camera_steps(0.2, noise=3.0), odometry(), "do not agree at any shift up to 1 s"),
        (camera_steps(0.2), odometry(end=5.0), "steps between pictures lie within the odometry"),
        (camera_steps(0.2), odometry()[:1], "1 poses"),
        (Steps(*np.empty((3, 0))), odometry(), "none that could be compared"),
    ],
)
def test_a_motion_that_does_not_tell_is_refused(steps, poses, says):
    with pytest.raises(PoseError, match=says):
        latency_between(steps, poses)


def test_a_latency_beyond_what_is_searched_is_said():
    with pytest.raises(PoseError, match=r"(search farther|do not agree)"):
        latency_between(camera_steps(0.8), odometry(), most=0.5)
