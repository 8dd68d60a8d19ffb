"""The first lines that a stranger writes: sources, poses, perceptions and a loop, by text or by his own function."""

import numpy as np
import pytest
from PIL import Image

import eagor
from eagor.errors import DeviceError, EagorError
from eagor.sources.odometry import GivenPoses

ROWS, BALL = 64, 40.0  # the ball is so many degrees to the left of the first picture


@pytest.fixture
def film(tmp_path):
    """A folder of panoramas: the camera turns by 10 degrees a second to the left, beside a red ball."""
    azimuth = 180 - (np.arange(2 * ROWS) + 0.5) * 180 / ROWS
    elevation = 90 - (np.arange(ROWS) + 0.5) * 180 / ROWS
    near = np.hypot(azimuth[None] - BALL, elevation[:, None]) < 12
    picture = np.where(near[..., None], (200, 20, 20), 120).astype(np.uint8)
    for number in range(4):
        turned = np.roll(picture, round(10 * number / 360 * 2 * ROWS), axis=1)
        Image.fromarray(turned).save(tmp_path / f"{number}.000.png")
    (tmp_path / "poses.csv").write_text(
        "stamp,yaw_deg,pitch_deg,roll_deg\n" + "".join(f"{number},{10 * number},0,0\n" for number in range(4))
    )
    return tmp_path


def red(picture, query):
    """A detector that somebody wrote: the box about all that is red."""
    y, x = np.nonzero((picture[..., 0] > 150) & (picture[..., 1] < 60))
    return (np.array([[x.min(), y.min(), x.max() + 1, y.max() + 1]]), [0.9]) if len(x) > 20 else (np.zeros((0, 4)), [])


def last(loop):
    *_, answer = loop
    return answer


@pytest.mark.parametrize("poses", ["{film}/poses.csv", "still"])
def test_a_loop_of_texts_and_a_lambda(film, poses):
    loop = eagor.Loop(str(film), poses.format(film=film), lambda picture, query: red(picture, query), "the ball")
    found = last(loop).as_dict()
    turned = 0 if poses == "still" else 30
    if turned:
        assert found["azimuth_deg"] == pytest.approx(BALL - turned, abs=3)
        assert found["status"] == "tracking"
    assert (found["query"], found["stamp"]) == ("the ball", 3.0)
    assert {"direction", "credible_angle_deg", "presence", "modes", "faults"} <= found.keys()


def test_the_answer_at_a_picture_knows_what_was_seen_in_it(film):
    answers = [*eagor.Loop(str(film), f"{film}/poses.csv", red, "ball", rate=1.0)]
    assert [answer.stamp for answer in answers] == [0, 1, 2, 3]
    assert all(answer.look_age == 0 and answer.direction is not None for answer in answers)


def test_a_function_in_a_file_is_a_perception_and_several_queries_are_followed(film, tmp_path):
    (tmp_path / "shades.py").write_text("LEAST = 150\n")
    file = tmp_path / "my_detector.py"
    file.write_text(
        "import numpy as np\nfrom shades import LEAST\n\n\ndef detect(picture, query):\n"
        "    y, x = np.nonzero((picture[..., 0] > LEAST) & (picture[..., 1] < 60))\n"
        "    return ([[x.min(), y.min(), x.max() + 1, y.max() + 1]], [0.9]) if len(x) > 20 else ([], [])\n"
    )
    loop = eagor.Loop(str(film), f"{film}/poses.csv", f"{file}:detect", ["ball", "the red one"])
    answers = [*loop][-2:]
    assert [each.query for each in answers] == ["ball", "the red one"]
    assert all(each.as_dict()["azimuth_deg"] == pytest.approx(BALL - 30, abs=3) for each in answers)
    for spec, said in (
        (f"{file}:find", "no function 'find'; it has detect"),
        ("nowhere.py:detect", "no file nowhere.py"),
    ):
        with pytest.raises(EagorError, match=said):
            eagor.load(spec)


def test_poses_are_opened_by_text(film):
    source = eagor.open_source(str(film))
    assert eagor.open_poses("still", source) is None
    given = eagor.open_poses(f"{film}/poses.csv", source)
    assert isinstance(given, GivenPoses)
    assert [pose.stamp for pose in given] == [0, 1, 2, 3]
    with pytest.raises(DeviceError, match="live, and the pictures are a recording"):
        eagor.open_poses("ros:/odom", source)
    with pytest.raises(EagorError, match="nowhere"):
        eagor.open_poses("nowhere.csv", source)


def test_what_is_no_perception_is_said(film):
    with pytest.raises(EagorError, match="a dict came for a perception"):
        eagor.Loop(str(film), "still", {}, "ball")
