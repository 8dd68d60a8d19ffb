"""A rig's YAML that is wrong: the error names the file, the line, what is there and what was wanted."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import HOSTILE

from eagor.errors import EagorError, FormatError, ImageError
from eagor.media.rigs import read_rig
from eagor.media.stitching import Stitcher

pytest.importorskip("yaml")
GOOD = """pictures:
  - {width: 400, height: 200}
lenses:
  - name: front
    centre: [100, 100]
    radius: 100
    field_deg: 200
  - name: back
    centre: [300, 100]
    radius: 100
    field_deg: 200
    rotation: {yaw_deg: 180}
"""


def test_the_example_is_read(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(GOOD)
    rig = read_rig(path)
    assert [lens.name for lens in rig.lenses] == ["front", "back"]
    assert rig.lenses[1].body_R_lens[0, 0] == pytest.approx(-1)


def test_a_lens_that_wants_too_large_a_panorama(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(GOOD.replace("radius: 100", "radius: 100000"))
    with pytest.raises(
        ImageError, match=r"rows = \d{6}; wanted 2 to 16384: is a lens' focal length or radius too large"
    ):
        Stitcher(read_rig(path))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("radius: 100", "radus: 100", r"line 6: .*radus is.*radius\?"),
        ("centre: [100, 100]", "centre: [100]", r"line 5: .*centre has 1 members; wanted x and y"),
        ("centre: [100, 100]", "centre: here", r"line 5: .*centre is 'here'; wanted x and y"),
        ("radius: 100", "radius: 1_0", r"line 6: .*radius is '1_0'; wanted pixels"),
        ("radius: 100", "radius: .nan", r"line 6: .*radius is '.nan'"),
        ("field_deg: 200", "field_deg: 2000", r"line 4: .*field of 2000 degrees"),
        ("field_deg: 200", "focal: 50\n    field_deg: 200", r"line 4: .*either field_deg"),
        ("{yaw_deg: 180}", "{yaw: 180}", r"line 12: .*yaw is no key here; did you mean yaw_deg\?"),
        ("{yaw_deg: 180}", "[2, 0, 0, 0]", r"line 12: .*length 2; wanted a unit quaternion"),
        ("name: front", "name: front\n    name: front", r"line 5: .*name is there twice"),
        ("name: front", "name: front\n    kind: mirror", r"line 5: .*kind is 'mirror'; wanted fisheye or pinhole"),
        ("name: front", "name: front\n    picture: 1", r"line 5: .*picture is 1; wanted 0 to 0"),
        ("radius: 100", "radius: 1.0e-320", r"line 4: .*cannot be: the lens 'front' has .* radius above 0"),
        ("width: 400", "width: 40000000", r"a rig has pictures of .*; wanted pixels, 1 to 1e.06 along each side"),
        ("width: 400", "width: 40.5", r"line 2: .*width is '40.5'; wanted a whole number"),
        (", height: 200", "", r"line 2: .*lacks a side"),
        ("lenses:", "lens:", r"line 3: lens is no key here; did you mean lenses\?"),
        ("    radius: 100\n", "", r"line 4: .*needs radius"),
        ("    centre: [100, 100]\n", "", r"line 4: .*has no centre"),
        ("field_deg: 200", "field_deg: 200\n    polynomial: [-0.5]", r"line 4: .*(not above 0|turns back)"),
        ("field_deg: 200", "field_deg: 200\n    distortion: [1]", r"line 8: .*distortion is no key"),
    ],
)  # fmt: skip
def test_mistakes_are_named_with_their_line(tmp_path, old, new, says):
    path = tmp_path / "my rig.yaml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(FormatError, match=f"(?s)my rig.yaml, {says}"):
        read_rig(path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"", "is empty"), (b"- 1", "wanted names with values"), (b"lenses: [", "is not YAML"),
        (b"\xff\xfe\x00", "cannot be read|not YAML"),
        (b"pictures: []\nlenses: []", "line 1: pictures is empty"), (b"a: &a [*a]", "no key|not YAML"),
        (b"lenses: !!python/object/apply:os.system [ls]\npictures: 3", "line 2: pictures is '3'"),
    ],
)  # fmt: skip
def test_what_is_no_rig_is_refused(tmp_path, text, says):
    path = tmp_path / "rig.yaml"
    path.write_bytes(text)
    with pytest.raises(FormatError, match=says):
        read_rig(path)
    with pytest.raises(FormatError, match="cannot be read"):
        read_rig(tmp_path / "nowhere.yaml")
    with pytest.raises(FormatError, match="cannot be read"):
        read_rig(tmp_path)


@HOSTILE
@given(
    st.integers(0, len(GOOD) - 1), st.sampled_from(["", "x", "-", ":", "[", "{", "\n", " ", "9" * 400, "\t", "#", "*a"])
)
def test_any_change_gives_a_rig_or_an_error_in_words(tmp_path_factory, at, put):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    path.write_text(GOOD[:at] + put + GOOD[at + 1 :])
    said = "rig.yaml"
    try:
        read_rig(path)
    except EagorError as error:
        said = str(error)
    assert "rig.yaml" in said
