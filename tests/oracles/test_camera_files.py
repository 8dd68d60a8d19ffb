"""Camera files of other programs: each pixel looks where OpenCV says, or where the formula of the format does."""

import math

import cv2
import numpy as np
import pytest
from rosmaking import camera_info

from eagor.cameras import Lens
from eagor.errors import FormatError
from eagor.sources.intrinsics import read_camera, rig_of_info
from eagor.sources.rigs import read_rig

SIZE = 640, 480
FX, FY, CX, CY = 512.5, 515.0, 321.5, 236.25
PLUMB = (-0.31, 0.12, 0.0011, -0.0007, -0.03)
RATIONAL = (0.4, -0.2, 0.0005, -0.0004, 0.02, 0.55, -0.1, 0.01)
ROUND = (-0.02, 0.004, -0.001, 0.0003)
MATRIX = f"[{FX}, 0, {CX}, 0, {FY}, {CY}, 0, 0, 1]"

ROS = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix: {{rows: 3, cols: 3, data: {matrix}}}
distortion_model: {model}
distortion_coefficients: {{rows: 1, cols: {count}, data: {values}}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
"""
ECHO = "height: 480\nwidth: 640\ndistortion_model: {model}\nd: {values}\nk: {matrix}\n"
KALIBR = f"""cam0:
  camera_model: pinhole
  distortion_coeffs: {{values}}
  distortion_model: {{model}}
  intrinsics: [{FX}, {FY}, {CX}, {CY}]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
"""
SENSOR = KALIBR.replace("cam0:\n", "sensor_type: camera\n").replace("\n  ", "\n").replace("coeffs", "coefficients")


def written_by_opencv(path, values):
    """A calibration as OpenCV itself writes it, by the ending of the name."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    told = {"calibration_time": "Thu: 3 Dec <2026>", "image_width": 640, "image_height": 480}
    told |= {"camera_matrix": np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])}
    told |= {"distortion_coefficients": np.array(values)[:, None], "points": np.zeros((2, 3, 2), "f4")}
    for name, value in told.items():
        storage.write(name, value)
    storage.release()
    return path


def read(tmp_path, text, name="camera.yaml", **values):
    """The lens in a file with this text; an ending alone: as OpenCV writes it."""
    path = tmp_path / name
    if text.startswith("."):
        path = written_by_opencv(path.with_suffix(text), values["values"])
    else:
        path.write_text(text.format(matrix=MATRIX, **values) if values else text)
    rig = read_camera(path)
    assert rig.sizes == (SIZE,)
    return rig.lenses[0]


def rays(lens, count=200):
    """Directions that the lens sees, as it and OpenCV (z ahead, x right, y down) have them."""
    rng = np.random.default_rng(3)
    ahead = lens.unproject(rng.uniform(5, SIZE[0] - 5, count), rng.uniform(5, SIZE[1] - 5, count))
    return ahead, np.stack([-ahead[:, 1], -ahead[:, 2], ahead[:, 0]], axis=-1)


@pytest.mark.parametrize(
    ("text", "model", "values"),
    [
        (ROS, "plumb_bob", PLUMB), (ROS, "rational_polynomial", RATIONAL),
        *((each, "", values) for each in (".xml", ".yml", ".json") for values in (PLUMB, RATIONAL)),
        (ECHO, "plumb_bob", PLUMB), (KALIBR, "radtan", PLUMB[:4]), (KALIBR, "none", ()),
        (SENSOR, "radial-tangential", PLUMB[:4]),
    ],
)  # fmt: skip
def test_a_lens_is_opencv_s(tmp_path, text, model, values):
    lens = read(tmp_path, text, model=model, values=list(values), count=len(values))
    own, theirs = rays(lens)
    camera = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    wanted = cv2.projectPoints(theirs, np.zeros(3), np.zeros(3), camera, np.array(values))[0][:, 0] + 0.5
    x, y, depth = lens.project(own)
    assert (depth > 0).all()
    np.testing.assert_allclose(np.stack([x, y], axis=-1), wanted, atol=1e-6)


@pytest.mark.parametrize("text", [ROS, KALIBR])
def test_a_fisheye_is_opencv_s_whatever_its_two_focal_lengths(tmp_path, text):
    lens = read(tmp_path, text, model="equidistant", values=list(ROUND), count=4)
    own, theirs = rays(lens)
    camera = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    wanted = cv2.fisheye.projectPoints(theirs[:, None], np.zeros(3), np.zeros(3), camera, np.array(ROUND))[0][:, 0]
    np.testing.assert_allclose(np.stack(lens.project(own)[:2], axis=-1), wanted + 0.5, atol=1e-6)
    back = lens.unproject(*lens.project(own)[:2])
    assert np.abs(back - own).max() < 1e-9


def test_an_omni_of_kalibr_is_the_unified_model(tmp_path):
    """J. Rehder's and P. Furgale's OmniProjection: a unit sphere, seen from xi behind its centre, then radtan."""
    xi, values = 1.1, (-0.2, 0.05, 0.001, -0.002)
    text = KALIBR.replace("pinhole", "omni").replace(f"[{FX}", f"[{xi}, {FX}")
    lens = read(tmp_path, text, model="radtan", values=list(values))
    own, theirs = rays(lens)
    assert math.degrees(lens.reach) > 65
    u, v = theirs[:, 0] / (theirs[:, 2] + xi), theirs[:, 1] / (theirs[:, 2] + xi)
    k1, k2, p1, p2 = values
    q = u * u + v * v
    x = u * (1 + k1 * q + k2 * q * q) + 2 * p1 * u * v + p2 * (q + 2 * u * u)
    y = v * (1 + k1 * q + k2 * q * q) + p1 * (q + 2 * v * v) + 2 * p2 * u * v
    np.testing.assert_allclose(np.stack(lens.project(own)[:2]), [CX + 0.5 + FX * x, CY + 0.5 + FY * y], atol=1e-6)
    assert np.abs(lens.unproject(*lens.project(own)[:2]) - own).max() < 1e-8


def test_the_cameras_of_a_camchain_are_a_rig_in_the_axes_of_the_first(tmp_path):
    """The second looks to the left: what is ahead of it, z, is at the left of the first, -x."""
    text = KALIBR.format(model="none", values=[])
    second = text.replace("cam0", "cam1").replace("640, 480", "320, 240")
    turn = "[[0, 0, 1, 0.1], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]"
    (tmp_path / "chain.yaml").write_text(text + second + f"  T_cn_cnm1: {turn}\n")
    rig = read_rig(tmp_path / "chain.yaml")
    assert (rig.sizes, [lens.picture for lens in rig.lenses]) == (((640, 480), (320, 240)), [0, 1])
    np.testing.assert_allclose(rig.lenses[0].body_R_lens, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rig.lenses[1].body_R_lens[:, 0], [0, 1, 0], atol=1e-12)
    with pytest.raises(FormatError, match=r"holds 2 lenses.*--rig"):
        read_camera(tmp_path / "chain.yaml")
    for more, said in (
        ("", "has no T_cn_cnm1"),
        ("  T_cn_cnm1: [[1, 0, 0], [0, 2, 0], [0, 0, 1]]\n", "is no rotation"),
    ):
        (tmp_path / "chain.yaml").write_text(text + second + more)
        with pytest.raises(FormatError, match=f"cam1 .*{said}|cam1 {said}"):
            read_rig(tmp_path / "chain.yaml")


@pytest.mark.parametrize(
    ("model", "values"),
    [("plumb_bob", PLUMB), ("rational_polynomial", RATIONAL), ("equidistant", ROUND), ("plumb_bob", ())],
)
def test_a_camera_info_is_the_file_s(tmp_path, model, values):
    """Of the whole sensor; and of a part of it, with two by two pixels in one, where each sees what it did."""
    told = read(tmp_path, ROS, model=model, values=list(values), count=len(values))
    k = FX, FY, CX, CY
    (lens,) = rig_of_info(camera_info(SIZE, k, values, model), False, "/camera_info").lenses
    x, y = np.random.default_rng(0).uniform(150, 400, (2, 50))
    np.testing.assert_allclose(lens.unproject(x, y), told.unproject(x, y), atol=1e-12)
    part = camera_info(SIZE, k, values, model, binning=2, roi=(100, 40, 400, 440))
    rig = rig_of_info(part, False, "/camera_info")
    assert rig.sizes == ((200, 220),)
    np.testing.assert_allclose(rig.lenses[0].unproject((x - 100) / 2, (y - 40) / 2), told.unproject(x, y), atol=1e-9)


def test_rectified_pictures_have_the_lens_of_p():
    info = camera_info(SIZE, (FX, FY, CX, CY), PLUMB, p=(400, 410, 300, 250))
    (lens,) = rig_of_info(info, True, "/camera_info").lenses
    assert (lens.focal, lens.centre, lens.distortion) == ((400, 410), (300.5, 250.5), ())


@pytest.mark.parametrize(
    ("values", "model", "said"),
    [
        ((0, 0, 0, 0), "", "/camera_info has the focal lengths 0 and 0 in K; .* not calibrated"),
        ((500, 500, 320, 240), "fov", "/camera_info tells no lens: the distortion model is 'fov'; wanted one of plumb"),
    ],
)
def test_a_camera_info_without_a_lens_is_refused(values, model, said):
    with pytest.raises(FormatError, match=said):
        rig_of_info(camera_info(SIZE, values, (0.1, 0.1), model), False, "/camera_info")


def colmap(model, theirs, k1=0.0, k2=0.0, p1=0.0, p2=0.0, k3=0.0, k4=0.0, sx1=0.0, sy1=0.0):
    """src/colmap/sensor/models.h: OpenCVCameraModel, ThinPrismFisheyeCameraModel."""
    u, v = theirs[:, 0] / theirs[:, 2], theirs[:, 1] / theirs[:, 2]
    if "FISHEYE" in model:
        radius = np.hypot(u, v)
        u, v = u * np.arctan(radius) / radius, v * np.arctan(radius) / radius
    q = u * u + v * v
    radial = 1 + q * (k1 + q * (k2 + q * (k3 + q * k4)))
    x = u * radial + 2 * p1 * u * v + p2 * (q + 2 * u * u) + sx1 * q
    y = v * radial + p1 * (q + 2 * v * v) + 2 * p2 * u * v + sy1 * q
    return np.stack([CX + FX * x, CY + FY * y])


@pytest.mark.parametrize(
    ("model", "numbers"),
    [
        ("OPENCV", {"k1": -0.3, "k2": 0.1, "p1": 0.001, "p2": -0.002}),
        (
            "THIN_PRISM_FISHEYE",
            {"k1": -0.03, "k2": 0.01, "p1": 0.002, "p2": -0.001, "k3": -0.004, "k4": 1e-3, "sx1": 3e-3, "sy1": -2e-3},
        ),
    ],
)
def test_colmap_counts_from_the_corner(tmp_path, model, numbers):
    line = f"# Camera list\n1 {model} 640 480 {FX} {FY} {CX} {CY} {' '.join(map(str, numbers.values()))}\n"
    lens = read(tmp_path, line, "cameras.txt")
    own, theirs = rays(lens)
    np.testing.assert_allclose(np.stack(lens.project(own)[:2]), colmap(model, theirs, **numbers), atol=1e-6)
    assert np.abs(lens.unproject(*lens.project(own)[:2]) - own).max() < 1e-8
    (tmp_path / "cameras.txt").write_text("7 SIMPLE_RADIAL 640 480 500 320 240 -0.1")
    assert read_camera(tmp_path / "cameras.txt").lenses[0].distortion[:2] == (-0.1, 0.0)


def test_a_turned_picture_has_a_turned_lens():
    rng, lens = np.random.default_rng(0), Lens("a", SIZE, (FX, FY), (CX, CY), PLUMB)
    x, y = rng.uniform(0, 640, 50), rng.uniform(0, 480, 50)
    seen, upright = lens.unproject(x, y), lens.turned(1)
    assert upright.size == (480, 640)
    turned = upright.unproject(y, 640 - x)  # as numpy.rot90 puts pixels
    # What lay to the right in the stored picture is above in the shown one.
    np.testing.assert_allclose(turned, np.stack([seen[:, 0], seen[:, 2], -seen[:, 1]], axis=-1), atol=1e-9)
    np.testing.assert_allclose(lens.turned(4).unproject(x, y), seen, atol=1e-12)


@pytest.mark.parametrize("more", ["", "---\n", "---\n{first}---\n", "---\nheight: 4"])
def test_what_topic_echo_prints_is_read_up_to_its_first_line(tmp_path, more):
    first = ROS.format(matrix=MATRIX, model="plumb_bob", count=5, values=[0] * 5)
    (tmp_path / "camera.yaml").write_text(first + "\n" + more.format(first=first))
    assert read_camera(tmp_path / "camera.yaml").sizes == (SIZE,)


def test_a_region_of_the_sensor_moves_the_centre(tmp_path):
    text = ROS.format(matrix=MATRIX, model="plumb_bob", count=5, values=[0] * 5)
    region = "\nroi: {x_offset: 100, y_offset: 40, height: 240, width: 320, do_rectify: false}\n"
    (tmp_path / "camera.yaml").write_text(text + region)
    (tmp_path / "whole.yaml").write_text(text)
    rig, whole = read_camera(tmp_path / "camera.yaml"), read_camera(tmp_path / "whole.yaml").lenses[0]
    assert rig.sizes == ((320, 240),)
    assert rig.lenses[0].centre == (whole.centre[0] - 100, whole.centre[1] - 40)
    assert rig.lenses[0].focal == whole.focal


FOUR = "image_width: 640\nimage_height: 480\nK: [400, 0, 320, 0, 400, 240, 0, 0, 1]\nD: [0.1, 0.02, 0.003, 0.001]\n"


def test_four_numbers_of_an_unnamed_model_are_asked_about(tmp_path):
    (tmp_path / "camera.yaml").write_text(FOUR)
    with pytest.warns(UserWarning, match="k1, k2, p1, p2 of an ordinary lens; of cv2.fisheye: add distortion_model"):
        assert read_camera(tmp_path / "camera.yaml").lenses[0].kind == "pinhole"


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("distortion_model: equidistant", "fisheye"),
        ("distortion_model: plumb_bob", "pinhole"),
        ("fisheye_model: 1", "fisheye"),
        ("fisheye_model: 0", "pinhole"),
        ("fisheye_model: true", "fisheye"),
    ],
)
def test_a_model_that_is_named_in_any_way_counts(tmp_path, line, kind):
    (tmp_path / "camera.yaml").write_text(FOUR + line)
    assert read_camera(tmp_path / "camera.yaml").lenses[0].kind == kind


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "holds nothing; wanted pictures and lenses"),
        ("a: [1", "is not YAML"),
        ("exposure: 3", "holds exposure, and no camera_matrix"),
        ("camera_matrix: {data: [1, 2]}", "missing required field `image_width`"),
        ("image_width: 6\nimage_height: 4\ncamera_matrix: {data: [1, 2]}", "camera_matrix is [1.0, 2.0]; wanted 9"),
        ("image_width: 6\nimage_height: x\nK: [5, 0, 3, 0, 5, 2, 0, 0, 1]", "Expected `int`, got `str` - at `$.ima"),
        ("image_width: 6\nimage_height: 4\nK: [0, 0, 3, 0, 5, 2, 0, 0, 1]", "focal above 0"),
        ("image_width: 6\nimage_height: 4\nK: [5, 0, 0, 0, 5, 0, 3, 2, 1]", "row by row"),
        ("image_width: 6000\nimage_height: 4000\nK: [0.8, 0, 0.5, 0, 1.2, 0.5, 0, 0, 1]", "lengths are 0.8 and 1.2 in"),
        ("image_width: 640\nimage_height: 480\nK: [400, 0, 236, 0, 400, 322, 0, 0, 1]", "centre is (236.5, 322.5)"),
        ("image_width: 6000000\nimage_height: 4\nK: [5e9, 0, 3, 0, 5e9, 2, 0, 0, 1]", "wanted pixels up to 1e+06"),
        (ROS.format(matrix=MATRIX, model="equidistant", count=4, values=[1e308, -1e308, 0, 0]), "distortion [1e+308"),
        (ROS.format(matrix=MATRIX, model="plumb_bob", count=8, values=list(RATIONAL)), "at most 5"),
        (ROS.format(matrix=MATRIX, model="thin_prism", count=1, values=[0]), "'thin_prism'; wanted one of plumb_bob"),
        (KALIBR.format(model="radtan", values=[0]).replace("pinhole", "ds"),
         "cam0.camera_model is 'ds', which is not read; wanted pinhole or omni"),
        ("pictures: [{width: 4, height: 2}, {width: 4, height: 2}]\nlenses:\n"
         "  - {kind: pinhole, focal: 2, centre: [2, 1]}", "1 lenses in 2 pictures"),
        ("<opencv_storage><image_width>640", "is not XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "is not XML"),
        ("<a>" * 9000 + "</a>" * 9000, "cannot be read as a calibration"),
    ],
)  # fmt: skip
def test_what_is_no_camera_is_refused(tmp_path, text, told):
    (tmp_path / "camera.yaml").write_text(text)
    with pytest.raises(FormatError) as error:
        read_camera(tmp_path / "camera.yaml")
    assert told in str(error.value)
    assert str(tmp_path / "camera.yaml") in str(error.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "holds 0 cameras"), ("1 PINHOLE 4 3 1 1 2 1\n2 PINHOLE 4 3 1 1 2 1\n", "holds 2 cameras"),
        ("1 FOV 4 3 1 1 2 1 1", "wanted CAMERA_ID and one of SIMPLE_PINHOLE"),
        ("1 PINHOLE 4 3 1 1 2", "wanted width, height, fx, fy, cx, cy"), ("1", "the model is ''"),
    ],
)  # fmt: skip
def test_what_is_no_camera_of_colmap_is_refused(tmp_path, text, told):
    (tmp_path / "cameras.txt").write_text(text)
    with pytest.raises(FormatError, match=r"cameras\.txt") as error:
        read_camera(tmp_path / "cameras.txt")
    assert told in str(error.value)
