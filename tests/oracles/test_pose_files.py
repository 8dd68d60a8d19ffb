"""Poses as other programs write them: one walk in every form, unit and axes gives the same poses, or a clear word."""

import json
import re

import numpy as np
import pytest
from commands import answer, eagor, refused
from moving_rooms import PatternRoom
from PIL import Image
from scipy.spatial.transform import Rotation

from eagor.conventions import wxyz_from_rotation
from eagor.errors import EagorError, PoseError
from eagor.grids import PerspectiveGrid
from eagor.lab.worlds.painted import Room, paint
from eagor.odometry import Pose
from eagor.odometry.axes import AXES, settled, with_axes
from eagor.odometry.files import GivenPoses, read_poses, times_of
from eagor.sources.camera_sources import open_footage
from eagor.sources.odometry import PosedFrames, open_poses
from eagor.sources.panorama import Picture, cut
from eagor.sources.panorama import turn as turned
from eagor.sphere import world_R_body

BEGIN = 1_650_000_000.0
STAMPS = [BEGIN + 0.4 * k for k in range(5)]
TURNS = [world_R_body(np.radians(20 - 11 * k), np.radians(4 * np.sin(k)), np.radians(3 * np.cos(k))) for k in range(5)]
PLACES = [np.array([0.3 * k, 0.05 * k, 1.2]) for k in range(5)]


def xyzw(turn):
    return Rotation.from_matrix(turn).as_quat()


def in_axes(axes, first_camera=False):
    """The walk as a program with other axes writes it; in a world that is its first camera, or ours."""
    body_R_pose = AXES[axes][0]
    world = body_R_pose.T @ TURNS[0].T if first_camera else np.eye(3)
    return [(at, world @ turn @ body_R_pose, world @ (place - PLACES[0] * first_camera))
            for at, turn, place in zip(STAMPS, TURNS, PLACES, strict=True)]  # fmt: skip


def rows(poses, order, unit=1.0, digits=9):
    """Lines of numbers: of the stamp (s), the place (p) and the quaternion (q, w first; Q, w last)."""
    for at, turn, place in poses:
        x, y, z, w = xyzw(turn)
        parts = {"s": [at * unit], "p": place, "q": [w, x, y, z], "Q": [x, y, z, w]}
        yield [
            f"{value:.0f}" if key == "s" and unit > 1 else f"{value:.{digits}f}"
            for key in order
            for value in parts[key]
        ]


def text(head, mark, poses=None, order="spQ", unit=1.0, end="\n"):
    lines = [head, *(mark.join(row) for row in rows(poses or in_axes("body"), order, unit))]
    return end.join(line for line in lines if line) + end


EUROC = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
FORMS = {
    "ours": text("stamp,x,y,z,qx,qy,qz,qw", ","),
    "TUM without names": text("", " "),
    "TUM with a comment": text("# ground truth\n# timestamp tx ty tz qx qy qz qw", " "),
    "TUM with names": text("timestamp tx ty tz qx qy qz qw", "  "),
    "tabs": text("time\tpos_x\tpos_y\tpos_z\tq_x\tq_y\tq_z\tq_w", "\t"),
    "semicolons": text("t;x;y;z;qx;qy;qz;qw", ";"),
    "EuRoC": text(EUROC, ",", order="spq", unit=1e9),
    "EuRoC without names": text("", ",", order="spq", unit=1e9).replace("\n", ",0" * 9 + "\n"),
    "ORB-SLAM3 in nanoseconds": text("", " ", unit=1e9),
    "microseconds": text("stamp,x,y,z,qx,qy,qz,qw", ",", unit=1e6),
    "milliseconds, named": text("timestamp_ms,x,y,z,qx,qy,qz,qw", ",", unit=1e3),
    "a topic's": text("stamp,pose.pose.position.x,pose.pose.position.y,pose.pose.position.z,"
                      + ",".join(f"pose.pose.orientation.{axis}" for axis in "xyzw"), ","),
    "PlotJuggler": text("__time," + ",".join(f"/odom/pose/pose/{name}" for name in (
        *(f"position/{axis}" for axis in "xyz"), *(f"orientation/{axis}" for axis in "xyzw"))), ","),
    "rostopic echo -p": text("%time," + ",".join(f"field.pose.{name}" for name in (
        *(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))), ",", unit=1e9),
    "Windows": "\ufeff" + text("stamp,x,y,z,qx,qy,qz,qw", ",", end="\r\n"),
    "TUM with tabs": text("", "\t"),
    "Matlab": text("% t x y z qx qy qz qw", " "),
    "slashes": text("// t x y z qx qy qz qw", " "),
    "decimal commas": text("stamp;x;y;z;qx;qy;qz;qw", ";").replace(".", ","),
    "of a rotation": text("time,px,py,pz,rotation.x,rotation.y,rotation.z,rotation.w", ","),
    "metres in brackets": text("time [s],x [m],y [m],z [m],qx [],qy [],qz [],qw []", ","),
}  # fmt: skip


def transforms(poses, name="images/{:.6f}.png"):
    frames = []
    for at, turn, place in poses:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn, place
        frames.append({"file_path": name.format(at), "transform_matrix": matrix.tolist()})
    return json.dumps({"camera_model": "EQUIRECTANGULAR", "frames": frames[::-1]})


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_poses(tmp_path, form):
    (tmp_path / "poses.txt").write_text(FORMS[form], encoding="utf-8", newline="")
    found = read_poses(tmp_path / "poses.txt")
    assert [pose.stamp for pose in found] == pytest.approx(STAMPS, abs=2e-3 if "milli" in form else 2e-6)
    np.testing.assert_allclose([pose.world_R_body for pose in found], TURNS, atol=1e-7)
    np.testing.assert_allclose([pose.position for pose in found], PLACES, atol=1e-7)


def test_radians_by_name_and_powershells_encoding(tmp_path):
    lines = [f"{at},{0.1 * k},0,0.02" for k, at in enumerate(STAMPS)]
    (tmp_path / "a.csv").write_text("\n".join(["stamp,yaw_rad,pitch_rad,roll_rad", *lines]), encoding="utf-16")
    for k, pose in enumerate(read_poses(tmp_path / "a.csv")):
        np.testing.assert_allclose(pose.world_R_body, world_R_body(0.1 * k, 0, 0.02), atol=1e-12)


@pytest.mark.parametrize(
    ("names", "many"),
    [
        ("x_mm,y_mm,z_mm,yaw_deg,pitch_rad,roll [rad]", (1000, 1, np.pi / 180, np.pi / 180)),
        ("x (cm),y (cm),z (cm),yaw [deg],pitch [degrees],roll_deg", (100, 1, 1, 1)),
    ],
)
def test_each_column_has_the_unit_that_it_names(tmp_path, names, many):
    numbers = [*(many[0] * np.array([0.5, 0.2, 1.4])), *(np.array(many[1:]) * [30, -4, 7])]
    (tmp_path / "p.csv").write_text(f"stamp,{names}\n0,{','.join(map(str, numbers))}\n")
    (pose,) = read_poses(tmp_path / "p.csv")
    np.testing.assert_allclose(pose.world_R_body, world_R_body(*np.radians([30, -4, 7])), atol=1e-12)
    np.testing.assert_allclose(pose.position, [0.5, 0.2, 1.4])


def test_positions_that_are_hardly_metres_are_asked_about(tmp_path):
    lines = [f"{0.1 * k},{40 * k},0,900,0,0,0" for k in range(9)]  # 0.4 m/s
    (tmp_path / "p.csv").write_text("\n".join(["stamp,x,y,z,yaw_deg,pitch_deg,roll_deg", *lines]))
    with pytest.warns(UserWarning, match="it moves at 400 m/s. Are the positions millimetres?"):
        read_poses(tmp_path / "p.csv")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("0,0,0,0,0,0,0,1\n", "8 numbers a line, and no names"),  # w first or last?
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "KITTI"),
        ("0.5,1,0,0,0,0,1,0,0,0,0,1,0,2,0,1,1\n", "17 numbers a line"),  # a matrix, as ARKit has it: by columns
        ("stamp,yaw,pitch,roll\n0,1,2,3\n", "yaw_deg or yaw_rad"),
        ('{"frames": [{"file_path": "a.png"}]}', "no transforms.json"),
        (
            '{"frames": [{"file_path": "a", "transform_matrix": [[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,1]]}]}',
            "no rotation",
        ),
        ("1 0 0 0 0 0 0 0 1 a.png\n\n", "images.txt has a line that cannot be"),
        ("1 1e308 1e308 0 0 0 0 0 1 a.png\n", "cannot be: a number without end"),
        ("1 1 0 0 0 0 0 0 1 a.png\n2 1 0 0 " + "[" * 900 + " 0 0 0 1 b.png\n", "cannot be: could not .{0,300}$"),
        (transforms([(0, np.full((3, 3), 1e308), np.zeros(3))]), "a number without end"),  # LAPACK would not end
        ("stamp,qx,qy,qz,qw\n0,1e308,1e308,0,1\n", "line 2: .* its length is "),
        (
            "timestamp_s,yaw_deg,pitch_deg,roll_deg\n1,0,0,0\n1e13,0,0,0\n",
            "line 3: stamp = 10{13}.0; .* not milliseconds",
        ),
    ],
)
def test_what_is_in_no_form_is_said(tmp_path, content, words):
    (tmp_path / "p.txt").write_text(content)
    with pytest.raises(EagorError, match=words):
        read_poses(tmp_path / "p.txt")


@pytest.mark.parametrize(
    ("begin", "step", "count", "unit"),
    [(5e12, 3e8, 5, "ns"), (5e9, 3e5, 5, "us"), (0, 5, 150, "ms")],  # since a phone was switched on; at 200 Hz
)
def test_counts_since_a_start_are_asked_about_as_what_they_are(tmp_path, begin, step, count, unit):
    lines = [f"{begin + step * k:.0f},{k},0,0" for k in range(count)]
    (tmp_path / "p.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *lines]))
    with pytest.warns(UserWarning, match=f"call that column stamp_{unit}"):
        read_poses(tmp_path / "p.csv")


@pytest.mark.parametrize(("scale", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_counts_that_are_hardly_seconds_are_asked_about(tmp_path, scale, unit):
    lines = [f"{0.25 * k * scale:.0f},{5 * k},0,0" for k in range(5)]
    (tmp_path / "p.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *lines]))
    with pytest.warns(UserWarning, match=f"s apart. Are the stamps .*call that column stamp_{unit}"):
        read_poses(tmp_path / "p.csv")
    (tmp_path / "p.csv").write_text("\n".join([f"stamp_{unit},yaw_deg,pitch_deg,roll_deg", *lines]))
    assert [pose.stamp for pose in read_poses(tmp_path / "p.csv")] == pytest.approx([0, 0.25, 0.5, 0.75, 1])


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["0.5", "10.25"], [0.5, 10.25]),
        (["left_1650000000.5", "left_1650000000.75"], [1650000000.5, 1650000000.75]),
        (["1403715524907143168"], [1403715524.907143168]),
        (["1650000000123", "1650000000456"], [1650000000.123, 1650000000.456]),
        (["1650000000_250000", "1650000000_500000"], [1650000000.25, 1650000000.5]),
        (["frame-1650000000-000000250"], [1650000000.00000025]),
        (["000", "001"], None),
        (["IMG_20240101_120000"], None),
        (["0.5", "last"], None),
        (["2024-01-01T12-00-59.500", "2024-01-01T12-01-00.250"], None),  # whose seconds begin anew
        (["9" * 400 + ".5"], None),
    ],
)
def test_names_that_are_times(names, times):
    assert times_of(names) == (None if times is None else pytest.approx(times, abs=1e-6))


# --- axes ---


@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("first_camera", [False, True])
def test_poses_with_other_axes_become_ours(tmp_path, axes, first_camera):
    (tmp_path / "p.txt").write_text(text("", " ", in_axes(axes, first_camera)))
    found = with_axes(read_poses(tmp_path / "p.txt"), axes)
    turns = np.array([pose.world_R_body for pose in found])
    np.testing.assert_allclose(turns[0].T @ turns, TURNS[0].T @ np.array(TURNS), atol=1e-7)
    gone = np.array([pose.position for pose in found]) - found[0].position
    np.testing.assert_allclose(gone @ turns[0], (np.array(PLACES) - PLACES[0]) @ TURNS[0], atol=1e-6)
    if axes != "body":
        assert turns[:, 2, 2].min() > 0.97  # the world's z is up


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shots")
    for at, turn, place in zip(STAMPS, TURNS, PLACES, strict=True):
        Image.fromarray(paint(Room(), tuple(place), turn, 128, 256)).save(folder / f"{at:.6f}.png")
    return folder


def found_in(shots, poses, *more):
    done = answer("track", shots, "the red ball", "--poses", poses, "--perception", "colour", *more)["frames"]
    return np.array([[frame["azimuth_deg"], frame["elevation_deg"], frame["credible_angle_deg"]] for frame in done])


@pytest.fixture(scope="module")
def right(shots, tmp_path_factory):
    path = tmp_path_factory.mktemp("right") / "ours.csv"
    path.write_text(FORMS["ours"])
    return found_in(shots, path)


def images_txt(poses):
    lines = ["# Image list with two lines of data per image:"]
    for k, (at, turn, place) in enumerate(poses):
        x, y, z, w = xyzw(turn.T)
        row = [k + 1, w, x, y, z, *(-turn.T @ place), 1, f"{at:.6f}.png"]
        lines += [" ".join(map(str, row)), "" if k else "10.5 20.5 -1 30.5 40.5 7"]
    return "\n".join(lines) + "\n"


WRITTEN = {
    **{f"{axes}, first camera": text("", " ", in_axes(axes, True)) for axes in ("optical", "opengl", "euroc")},
    "optical, names of ours": text("stamp,x,y,z,qx,qy,qz,qw", ",", in_axes("optical", True)),
    "optical, z up": text("# timestamp tx ty tz qx qy qz qw", " ", in_axes("optical")),
    "EuRoC": text(EUROC, ",", in_axes("euroc"), "spq", 1e9),
    "COLMAP": images_txt(in_axes("optical", True)),
    "nerfstudio": transforms(in_axes("opengl")),
    "nerfstudio without endings": transforms(in_axes("opengl"), "./train/{:.6f}"),
}


@pytest.mark.parametrize("form", WRITTEN)
def test_the_ball_is_where_it_is_whatever_the_axes(tmp_path, shots, right, form):
    (tmp_path / "p.txt").write_text(WRITTEN[form])
    np.testing.assert_allclose(found_in(shots, tmp_path / "p.txt"), right, atol=1.5)


def test_axes_that_nothing_tells_are_asked_for(tmp_path, right, shots):
    grey = tmp_path / "grey"
    grey.mkdir()
    for at in STAMPS:
        Image.new("RGB", (256, 128), (90, 90, 90)).save(grey / f"{at:.6f}.png")
    (tmp_path / "p.txt").write_text(text("", " ", in_axes("optical", True)))
    said = refused("track", grey, "red", "--poses", tmp_path / "p.txt", "--perception", "colour")
    assert re.search("wanted --axes .*optical .x right, y down, z ahead", said)
    np.testing.assert_allclose(found_in(shots, tmp_path / "p.txt", "--axes", "optical"), right, atol=1.5)
    with pytest.raises(PoseError, match="--axes"):
        open_poses(str(tmp_path / "p.txt"))
    assert len([*open_poses(str(tmp_path / "p.txt"), axes="optical")]) == 5
    (tmp_path / "q.csv").write_text(text("stamp,x,y,z,qx,qy,qz,qw", ",", in_axes("optical", True)))
    done = eagor("track", grey, "red", "--poses", tmp_path / "q.csv", "--perception", "colour")
    assert "--axes optical reads them so" in done.stderr
    assert "--axes optical is for a file of poses" in refused("track", grey, "red", "--axes", "optical")


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_quaternions_in_another_order_are_asked_about(tmp_path, order):
    said, lines = [], ["stamp,qw,qx,qy,qz"]
    for k, yaw in enumerate(np.linspace(-3, 3, 60)):
        numbers = dict(zip("wxyz", wxyz_from_rotation(world_R_body(yaw, 0.03)), strict=True))
        lines.append(",".join(map(str, [k, *(numbers[name] for name in order)])))
    (tmp_path / "p.csv").write_text("\n".join(lines))
    open_poses(str(tmp_path / "p.csv"), say=said.append)
    assert [("xyzw?" in text) for text in said] == [True] * (order == "xyzw")


def test_a_camera_that_tumbles_with_our_axes_is_read_as_it_stands(tmp_path):
    said = []
    turns = [Rotation.from_rotvec([0.0, 0.3 * k, 0.1 * k]).as_matrix() for k in range(6)]
    poses = [(0.5 * k, turn, np.zeros(3)) for k, turn in enumerate(turns)]
    (tmp_path / "p.csv").write_text(text("stamp,x,y,z,qx,qy,qz,qw", ",", poses))
    for k, turn in enumerate(turns):
        Image.fromarray(paint(Room(), (0.0, 0.0, 1.3), turn, 128, 256)).save(tmp_path / f"{k}.png")
    read = read_poses(tmp_path / "p.csv")
    found = open_poses(str(tmp_path / "p.csv"), open_footage([tmp_path]), say=said.append)
    assert isinstance(found, GivenPoses)
    np.testing.assert_array_equal([pose.world_R_body for pose in found], [pose.world_R_body for pose in read])
    assert not said


# --- poses against the pictures ---

SWEEP = [world_R_body(0.9 * np.sin(0.5 * k), 0.06 * np.sin(k), 0.05 * np.cos(k)) for k in range(14)]
VIEW = PerspectiveGrid(160, 208, np.radians(80))
CAMERAS = ["panorama", "ordinary"]


@pytest.fixture(scope="module")
def sweep():
    """What a camera shows that looks to and fro in a room with patterns: whole panoramas, and an ordinary picture."""
    room = PatternRoom(3).panorama(np.eye(3), rows=256)
    panoramas = [turned(room, pose.T) for pose in SWEEP]
    return {"panorama": [Picture(each) for each in panoramas],
            "ordinary": [Picture(cut(each, VIEW)[0], grid=VIEW) for each in panoramas]}  # fmt: skip


def settled_with(poses, pictures, said, axes="auto", form=""):
    read = GivenPoses(Pose(0.5 * k, pose) for k, pose in enumerate(poses))
    read.axes = form
    return settled(read, axes, "p.csv", lambda: zip(read, pictures, strict=True), said.append), read


def yawed(poses, times):
    return [world_R_body(*times(np.array(Rotation.from_matrix(pose).as_euler("ZYX")))) for pose in poses]


WRONG = {
    "inverted": ([pose.T for pose in SWEEP], "the other way round"),
    "yaw to the right": (yawed(SWEEP, lambda angles: angles * [-1, 1, -1]), "change the sign of the yaw"),
    "radians": (yawed(SWEEP, np.radians), "its angles are radians"),
    "optical": ([pose @ AXES["optical"][0] for pose in SWEEP], "--axes optical"),
}


def in_order(turns, by):
    """The same quaternions, read with the scalar at the other end."""
    return Rotation.from_quat(np.roll(Rotation.from_matrix(turns).as_quat(), by, axis=1)).as_matrix()


@pytest.mark.parametrize(
    ("poses", "form", "says"),
    [
        (in_order(SWEEP, 1), "body?", "its quaternions have another order"),
        (in_order(SWEEP, -1), "", "its quaternions have another order"),
        ([(pose @ AXES["optical"][0]).T for pose in SWEEP], "", "the other way round.* --axes"),
    ],
)
def test_what_fits_no_axes_is_refused_with_what_is_wrong(sweep, poses, form, says):
    with pytest.raises(PoseError, match=says):
        settled_with(poses, sweep["panorama"], [], form=form)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("wrong", WRONG)
def test_poses_that_contradict_the_pictures_are_refused_with_what_settles_it(sweep, camera, wrong):
    poses, says = WRONG[wrong]
    with pytest.raises(PoseError, match=rf"contradicts the pictures: from .* by what it shows.*{says}.*--axes body"):
        settled_with(poses, sweep[camera], [], form="body")
    said = []
    found, read = settled_with(poses, sweep[camera], said, axes="body")
    assert found is read
    assert not said, "who says that nothing is wrong is taken at his word"


@pytest.mark.parametrize("wrong", [[SWEEP[0]] * 14, [*SWEEP[5:], *SWEEP[:5]]], ids=["they do not turn", "another time"])
def test_poses_of_another_camera_or_time_are_warned_of(sweep, wrong):
    said = []
    settled_with(wrong, sweep["panorama"], said, form="body")
    assert re.search("warning: p.csv contradicts the pictures: .*stamps of the pictures' clock", said[0])


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("noise", [0, 1.5])
def test_right_poses_pass_in_silence_though_they_are_noisy(sweep, camera, noise):
    random = np.random.default_rng(5)
    shaken = [pose @ Rotation.from_rotvec(np.radians(noise) * random.normal(size=3)).as_matrix() for pose in SWEEP]
    for form in ("body", ""):
        said = []
        found, read = settled_with(shaken, sweep[camera], said, form=form)
        assert found is read
        assert not said


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_camera_that_stands_or_sees_nothing_contradicts_nothing(sweep, camera):
    random, shape = np.random.default_rng(6), sweep[camera][0].picture.shape
    grey = [Picture(np.clip(random.normal(90, 3, shape), 0, 255).astype(np.uint8), grid=sweep[camera][0].grid)] * 14
    still = [
        pose @ Rotation.from_rotvec(np.radians(1) * random.normal(size=3)).as_matrix() for pose in [np.eye(3)] * 14
    ]
    for poses, pictures in ((SWEEP, grey), (WRONG["inverted"][0], grey), (still, [sweep[camera][3]] * 14)):
        said = []
        settled_with(poses, pictures, said, form="body")
        assert not said


# --- pairs of pictures and poses ---


def test_pictures_named_by_time_take_poses_between_others(tmp_path, shots):
    dense = [f"{BEGIN + 0.05 * i - 0.01},{20 - 11 * (0.05 * i - 0.01) / 0.4},0,0" for i in range(34)]
    (tmp_path / "p.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *dense]))
    seen = [each.pose for each in posed(shots, tmp_path / "p.csv")]
    assert [pose.stamp for pose in seen] == pytest.approx(STAMPS)
    for k, pose in enumerate(seen):
        np.testing.assert_allclose(pose.world_R_body, world_R_body(np.radians(20 - 11 * k)), atol=1e-6)
    (tmp_path / "p.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg", *dense[8:]]))
    with pytest.warns(UserWarning, match="1 of 5 pictures are left out"):
        posed(shots, tmp_path / "p.csv")


def posed(folder, path):
    source = open_footage([folder])
    return [*PosedFrames(source, open_poses(str(path), source))]


@pytest.mark.parametrize("frame", ["C:\\log\\{}", "\\\\host\\share\\{}", "shots/{}", "..\\shots/{}"])
def test_frames_are_found_by_the_last_part_of_any_path(tmp_path, shots, frame):
    lines = [f"{k},{20 - 11 * k},0,0,{frame.format(path.name)}" for k, path in enumerate(sorted(shots.iterdir()))]
    (tmp_path / "p.csv").write_text("\r\n".join(["stamp,yaw_deg,pitch_deg,roll_deg,frame", *lines]))
    assert [each.frame.name for each in posed(shots, tmp_path / "p.csv")] == [p.name for p in sorted(shots.iterdir())]


@pytest.mark.parametrize(("name", "turned"), [("rgb/{}", True), ("left_{}", False)])
def test_a_column_of_any_name_may_name_the_pictures(tmp_path, shots, name, turned):
    """Of this camera; else they are paired as without it."""
    names = sorted((path.name for path in shots.iterdir()), reverse=True)
    lines = [f"{k},{20 - 11 * (4 - k if turned else k)},0,0,{name.format(each)}" for k, each in enumerate(names)]
    (tmp_path / "p.csv").write_text("\n".join(["stamp,yaw_deg,pitch_deg,roll_deg,image_path", *lines]))
    assert [each.frame.name for each in posed(shots, tmp_path / "p.csv")] == (names if turned else names[::-1])


def test_pictures_that_colmap_could_not_place_are_left_out(tmp_path, shots):
    (tmp_path / "images.txt").write_text(images_txt(in_axes("optical")[1:]))
    with pytest.warns(UserWarning, match="has no pose for 1650000000.000000.png, 1 of 5 pictures: left out"):
        assert len(posed(shots, tmp_path / "images.txt")) == 4
