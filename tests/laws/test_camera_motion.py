"""Motion tracks of videos: the rotations that were written into them come out, in degrees."""

import clips
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from eagor.errors import PoseError
from eagor.odometry.imu import MotionTrack, read_insta360
from eagor.sources.video import Video
from eagor.sphere import world_R_body

G = 9.80665
TIMES = np.arange(0, 20, 0.005)


def off(a, b):
    """The angle (degrees) between two rotations."""
    return float(np.degrees(Rotation.from_matrix(a.T @ b).magnitude()))


def tilt_off(a, b):
    """The angle (degrees) between the directions up, in the body."""
    return float(np.degrees(np.arccos(np.clip(a[2] @ b[2], -1, 1))))


def tumbling(times, seed=0):
    """Smooth orientations of a camera that is carried: heading all around, tilts of up to 40 degrees."""
    rng = np.random.default_rng(seed)
    size, speed, phase = np.array([[3.0], [0.5], [0.4]]), rng.uniform(0.2, 0.6, (3, 1)), rng.uniform(0, 6, (3, 1))
    yaw, pitch, roll = size * np.sin(2 * np.pi * speed * times + phase)
    yaw -= yaw[0]
    return Rotation.from_matrix([world_R_body(*angles) for angles in zip(yaw, pitch, roll, strict=True)])


def imu(truth, times, bias=(0.0, 0.0, 0.0), shake=0.0, seed=0):
    """What a gyroscope (radians per second) and an accelerometer (m/s^2) feel at `times`, body frame."""
    step = 1e-4
    slerp = Slerp(times, truth)
    inside = np.clip(times, times[0] + step, times[-1] - step)
    rates = (slerp(inside - step).inv() * slerp(inside + step)).as_rotvec() / (2 * step) + bias
    pushed = shake * np.random.default_rng(seed).normal(size=(len(times), 3))
    return rates, truth.inv().apply(np.array([0, 0, G]) + pushed)


def track_of(times, rates, felt=None):
    rows = [None if values is None else np.concatenate([times[:, None], values], axis=1) for values in (rates, felt)]
    return MotionTrack.of_imu(*rows, "test")


@pytest.mark.parametrize("seed", range(2))
def test_gravity_levels_what_the_gyroscope_tells(seed):
    truth = tumbling(TIMES, seed)
    rates, felt = imu(truth, TIMES, bias=np.radians([0.4, -0.5, 0.0]), shake=2.0, seed=seed)
    track, alone = track_of(TIMES, rates, felt), track_of(TIMES, rates)
    at = np.arange(0.5, 19.5, 0.5)
    true = Slerp(TIMES, truth)(at).as_matrix()
    tilts = [tilt_off(track.world_R_body(t), m) for t, m in zip(at, true, strict=True)]
    assert max(tilts) < 3.0
    assert np.mean(tilts) < 1.5
    assert max(tilt_off(alone.world_R_body(t), m) for t, m in zip(at, true, strict=True)) > 5.0
    assert track.world_R_body(0.0)[:, 0] @ [0, 1, 0] == pytest.approx(0, abs=1e-9), "the heading is 0 at first"


def test_turns_without_a_bias_are_followed_also_by_a_camera_that_is_upside_down():
    for truth in (
        Rotation.from_rotvec(np.outer(TIMES, [0.0, 0, 1.2])),
        Rotation.from_rotvec([[np.pi, 0, 0]] * len(TIMES)),
    ):
        track = track_of(TIMES, *imu(truth, TIMES))
        for k in (0, 999, len(TIMES) - 1):
            assert off(track.world_R_body(TIMES[k]), truth[k].as_matrix()) < 0.01


def test_between_samples_and_beyond_the_ends():
    track = MotionTrack(np.array([0.0, 1.0]), Rotation.from_rotvec([[0, 0, 0], [0, 0, 1.0]]), "test")
    assert off(track.world_R_body(0.25), world_R_body(0.25)) < 1e-6
    assert off(track.world_R_body(1.05), world_R_body(1.0)) < 1e-6
    for stamp in (-0.2, 1.2, float("nan")):
        with pytest.raises(PoseError, match=r"tells no orientation at .* it goes from 0.000 to 1.000 s"):
            track.world_R_body(stamp)


# --- Insta360 ---

# The IMU sits somehow in the camera: its axes in the body's.
BODY_R_IMU = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def written(tmp_path, truth, times, **how):
    rates, felt = imu(truth, times)
    path = clips.clip(tmp_path / "a.mp4")
    samples = list(zip(times, felt / G @ BODY_R_IMU, rates @ BODY_R_IMU, strict=True))
    path.write_bytes(path.read_bytes() + clips.trailer(samples, **how))
    return path, rates, felt


@pytest.mark.parametrize("raw", [False, True])
def test_the_trailer_of_insta360(tmp_path, raw):
    times = np.arange(0, 3, 0.01)
    truth = tumbling(times, seed=3)
    path, rates, felt = written(tmp_path, truth, times, camera="Insta360 X9", first=5000, raw=raw)
    with path.open("rb") as file:
        read = read_insta360(file)
    assert read.camera == "Insta360 X9"
    assert read.gyro[:, 0] == pytest.approx(times, abs=2e-3)
    assert np.degrees(np.abs(read.gyro[:, 1:] - rates @ BODY_R_IMU)).max() < 0.1
    assert np.abs(read.acceleration[:, 1:] - felt @ BODY_R_IMU).max() < 0.01
    video = Video(path)
    assert len(list(video)) == 30
    assert any("the camera is Insta360 X9" in fact for fact in video.facts)
    assert any("axes that are not documented" in fact for fact in video.facts)
    # Up is found, forward is not: how far it is tilted and turned is right, but not to which side it is tilted.
    for stamp in (0.5, 1.0, 2.0):
        start, now = Slerp(times, truth)([0.0, stamp]).as_matrix()
        then, found = video.motion.world_R_body(0.0), video.motion.world_R_body(stamp)
        assert off(found, then) == pytest.approx(off(now, start), abs=2.0)
        assert np.degrees(np.arccos(found[2, 2])) == pytest.approx(np.degrees(np.arccos(now[2, 2])), abs=2.0)


def test_a_trailer_without_samples(tmp_path):
    path = clips.clip(tmp_path / "a.mp4")
    path.write_bytes(path.read_bytes() + clips.trailer([]))
    assert Video(path).motion is None
