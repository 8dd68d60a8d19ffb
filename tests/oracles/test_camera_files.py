"""Camera files of other programs: each pixel looks where OpenCV says, or where the formula of the format does."""

import math

import cv2
import numpy as np
import pytest
from rosmaking import camera_info

from eagor.errors import FormatError
from eagor.grids import PerspectiveGrid
from eagor.lenses import PinholeLens
from eagor.media.intrinsics import read_camera, rig_of_info

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
OPENCV = """%YAML:1.0
---
calibration_time: "Thu"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {matrix}
distortion_coefficients: !!opencv-matrix
   rows: {count}
   cols: 1
   dt: d
   data: {values}
"""
XML = """<?xml version="1.0"?>
<opencv_storage>
<calibration_time>"Thu 03 Dec"</calibration_time>
<image_width>640</image_width>
<image_height>480</image_height>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows> <cols>3</cols> <dt>d</dt> <data>{matrix}</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>{count}</rows> <cols>1</cols> <dt>d</dt> <data>
    {values}</data></distortion_coefficients>
</opencv_storage>
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


def read(tmp_path, text, name="camera.yaml", **values):
    path = tmp_path / name
    text = text.format(matrix=MATRIX, **values) if values else text
    path.write_text(text.translate(str.maketrans("[],", "   ")) if text.startswith("<") else text)
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
        (ROS, "plumb_bob", PLUMB), (ROS, "rational_polynomial", RATIONAL), (OPENCV, "", PLUMB), (OPENCV, "", RATIONAL),
        (XML, "", PLUMB), (XML, "", RATIONAL),
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


@pytest.mark.parametrize(("text", "model"), [(ROS, "equidistant"), (KALIBR, "equidistant")])
def test_a_fisheye_is_opencv_s(tmp_path, text, model):
    lens = read(tmp_path, text, model=model, values=list(ROUND), count=4)
    own, theirs = rays(lens)
    camera = np.array([[lens.focal, 0, CX], [0, lens.focal, CY], [0, 0, 1]])  # one focal length: the mean
    wanted = cv2.fisheye.projectPoints(theirs[:, None], np.zeros(3), np.zeros(3), camera, np.array(ROUND))[0][:, 0]
    np.testing.assert_allclose(np.stack(lens.project(own)[:2], axis=-1), wanted + 0.5, atol=1e-6)


def test_a_fisheye_without_distortion_is_equidistant(tmp_path):
    lens = read(tmp_path, ROS, model="equidistant", values=[], count=0)
    assert lens.reach == pytest.approx(lens.radius / lens.focal)


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
        ((500, 500, 320, 240), "fov", "/camera_info belongs to the distortion model 'fov'; wanted one of plumb_bob"),
        (
            (500, 700, 320, 240),
            "equidistant",
            "/camera_info tells no lens: the fisheye's focal lengths are 500 and 700",
        ),
    ],
)
def test_a_camera_info_without_a_lens_is_refused(values, model, said):
    with pytest.raises(FormatError, match=said):
        rig_of_info(camera_info(SIZE, values, (0.1, 0.1), model), False, "/camera_info")


def test_colmap_counts_from_the_corner(tmp_path):
    line = "# Camera list\n1 OPENCV 640 480 {fx} {fy} {cx} {cy} -0.3 0.1 0.001 -0.002\n"
    lens = read(tmp_path, line.format(fx=FX, fy=FY, cx=CX, cy=CY), "cameras.txt")
    own, theirs = rays(lens)
    u, v = theirs[:, 0] / theirs[:, 2], theirs[:, 1] / theirs[:, 2]
    q = u * u + v * v  # src/colmap/sensor/models.h, OpenCVCameraModel
    radial = 1 - 0.3 * q + 0.1 * q * q
    x = u * radial + 2 * 0.001 * u * v - 0.002 * (q + 2 * u * u)
    y = v * radial + 0.001 * (q + 2 * v * v) - 2 * 0.002 * u * v
    np.testing.assert_allclose(np.stack(lens.project(own)[:2]), [CX + FX * x, CY + FY * y], atol=1e-6)
    (tmp_path / "cameras.txt").write_text("7 SIMPLE_RADIAL 640 480 500 320 240 -0.1")
    assert read_camera(tmp_path / "cameras.txt").lenses[0].distortion[:2] == (-0.1, 0.0)


def test_a_turned_picture_has_a_turned_lens():
    rng, lens = np.random.default_rng(0), PinholeLens("a", SIZE, (FX, FY), (CX, CY), PLUMB)
    x, y = rng.uniform(0, 640, 50), rng.uniform(0, 480, 50)
    seen, upright = lens.unproject(x, y), lens.turned(1)
    assert upright.size == (480, 640)
    turned = upright.unproject(y, 640 - x)  # as numpy.rot90 puts pixels
    # What lay to the right in the stored picture is above in the shown one.
    np.testing.assert_allclose(turned, np.stack([seen[:, 0], seen[:, 2], -seen[:, 1]], axis=-1), atol=1e-9)
    again = lens.turned(4)
    np.testing.assert_allclose(again.unproject(x, y), seen, atol=1e-12)


def test_a_field_of_view_is_that_of_the_picture_s_middle_row(tmp_path):
    lens = read(tmp_path, KALIBR, model="none", values=[])
    grid = PerspectiveGrid.of_lens(lens)
    assert grid.hfov == pytest.approx(math.atan((CX + 0.5) / FX) + math.atan((640 - CX - 0.5) / FX))


@pytest.mark.parametrize("more", ["", "---\n", "---\n{first}---\n", "---\nheight: 4"])
def test_what_topic_echo_prints_is_read_up_to_its_first_line(tmp_path, more):
    first = ROS.format(matrix=MATRIX, model="plumb_bob", count=5, values=[0] * 5)
    (tmp_path / "camera.yaml").write_text(first + "\n" + more.format(first=first))
    assert read_camera(tmp_path / "camera.yaml").sizes == (SIZE,)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty; wanted a camera"),
        ("a: [1", "is not YAML"),
        ("exposure: 3", "holds exposure, and no camera_matrix"),
        ("camera_matrix: {data: [1, 2]}", "has no image_width and image_height"),
        ("image_width: 6\nimage_height: 4\ncamera_matrix: {data: [1, 2]}", "line 3: camera_matrix.data has 2 numbers"),
        ("image_width: 6\nimage_height: x\nK: [5, 0, 3, 0, 5, 2, 0, 0, 1]", "line 2: image_height is 'x'; wanted"),
        ("image_width: 6\nimage_height: 4\nK: [0, 0, 3, 0, 5, 2, 0, 0, 1]", "focal above 0"),
        ("image_width: 6\nimage_height: 4\nK: [5, 0, 0, 0, 5, 0, 3, 2, 1]", "column by column"),
        ("image_width: 6000\nimage_height: 4000\nK: [0.8, 0, 0.5, 0, 1.2, 0.5, 0, 0, 1]", "lengths 0.8 and 1.2 in"),
        ("image_width: 6e300\nimage_height: 4\nK: [5e299, 0, 3, 0, 5e299, 2, 0, 0, 1]", "wanted pixels up to 1e+06"),
        ("image_width: 6\nimage_height: 4\nK: [5, 0, 3, 0, 0, 2, 0, 0, 1]\nfisheye_model: 1", "lengths are 5 and 0"),
        (ROS.format(matrix=MATRIX, model="equidistant", count=4, values=[1e308, -1e308, 0, 0]), "has the polynomial"),
        (ROS.format(matrix=MATRIX, model="plumb_bob", count=8, values=list(RATIONAL)), "at most 5"),
        (ROS.format(matrix=MATRIX, model="thin_prism", count=1, values=[0]), "'thin_prism'; wanted one of plumb_bob"),
        (KALIBR.format(model="fov", values=[1]), "distortion model 'fov'"),
        (KALIBR.format(model="radtan", values=[0]).replace("pinhole", "omni"), "is 'omni'; wanted pinhole"),
        (KALIBR.format(model="none", values=[]) + "cam1: {}\n", "holds 2 cameras, cam0, cam1"),
        ("pictures: [{width: 4, height: 2}, {width: 4, height: 2}]\nlenses:\n"
         "  - {kind: pinhole, focal: 2, centre: [2, 1]}", "1 lenses in 2 pictures"),
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
        ("1 PINHOLE 4 3 1 1 2", "wanted width, height, fx, fy, cx, cy"), ("1 PINHOLE", "the model is"),
    ],
)  # fmt: skip
def test_what_is_no_camera_of_colmap_is_refused(tmp_path, text, told):
    (tmp_path / "cameras.txt").write_text(text)
    with pytest.raises(FormatError, match=r"cameras\.txt") as error:
        read_camera(tmp_path / "cameras.txt")
    assert told in str(error.value)


@pytest.mark.parametrize("suffix", [".xml", ".yml", ".json"])
def test_what_opencv_itself_writes_is_read(tmp_path, suffix):
    path, matrix = tmp_path / f"camera{suffix}", np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Thu: 3 Dec <2026>")
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", matrix)
    storage.write("distortion_coefficients", np.array(PLUMB)[:, None])
    storage.write("img_points", np.zeros((2, 3, 2), np.float32))
    storage.release()
    lens = read_camera(path).lenses[0]
    assert (lens.focal, lens.distortion) == (pytest.approx((FX, FY)), pytest.approx(PLUMB))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<opencv_storage><image_width>640", "is not XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "is not XML"),
        ("<a>" * 200 + "</a>" * 200, "is not XML"),
        ("<a>\n<image_width>640</image_width>\n<image_height>no</image_height>\n<K>1 2</K></a>", "image_height is"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_an_xml_is_said(tmp_path, text, words):
    (tmp_path / "camera.xml").write_text(text)
    with pytest.raises(FormatError, match=words):
        read_camera(tmp_path / "camera.xml")
