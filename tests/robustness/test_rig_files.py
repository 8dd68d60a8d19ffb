"""A rig's YAML that is wrong: the error names the file, the line, what is there and what was wanted."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import HOSTILE

from eagor.errors import EagorError, FormatError, ImageError
from eagor.sources.rigs import read_rig
from eagor.sources.stitching import Stitcher

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
        ("radius: 100", "radus: 100", r"unknown field `radus` - at `\$.lenses\[0\]`|missing required field `radius`"),
        ("centre: [100, 100]", "centre: [100]", r"Expected `array` of length 2, got 1 - at `\$.lenses\[0\].centre`"),
        ("centre: [100, 100]", "centre: here", r"Expected `array`, got `str` - at `\$.lenses\[0\].centre`"),
        ("radius: 100", "radius: .nan", r"lenses\[0\]: the lens 'front' has .*nan"),
        ("field_deg: 200", "field_deg: 2000", r"lenses\[0\]: .*field of 2000 degrees"),
        ("field_deg: 200", "focal: 50\n    field_deg: 200", r"lenses\[0\]: wanted either field_deg"),
        ("{yaw_deg: 180}", "{yaw: 180}", r"lenses\[1\]: rotation has yaw; wanted yaw_deg"),
        ("{yaw_deg: 180}", "[2, 0, 0, 0]", r"lenses\[1\]: rotation has length 2; wanted a unit quaternion"),
        ("{yaw_deg: 180}", "{yaw_deg: -.inf}", r"lenses\[1\]: rotation has .*-inf.*; wanted degrees that are finite"),
        ("name: front", "name: front\n    name: front", r"name is there twice.*line 4"),
        ("name: front", "name: front\n    kind: mirror", r"lenses\[0\].kind is 'mirror'; wanted fisheye, pinhole"),
        ("name: front", "name: front\n    picture: 1", r"lenses\[0\].picture is 1; wanted 0 to 0"),
        ("radius: 100", "radius: 1.0e-320", r"lenses\[0\]: the lens 'front' has .*focal above 0"),
        ("width: 400", "width: 40000000", r"wanted pixels up to 1e.06"),
        ("width: 400", "width: 40.5", r"Expected `int`, got `float` - at `\$.pictures\[0\].width`"),
        (", height: 200", "", r"missing required field `height` - at `\$.pictures\[0\]`"),
        ("pictures:", f"a: {'{' * 900}", "it has brackets more than 50 deep"),
        ("lenses:", "lens:", r"unknown field `lens`|missing required field `lenses`"),
        ("field_deg: 200", "field_deg: 200\n    polynomial: [-0.5]", r"(not above 0|turns back)"),
        ("field_deg: 200", "kind: pinhole\n    field_deg: 200", r"lenses\[0\]: wanted either field_deg"),
    ],
)  # fmt: skip
def test_mistakes_are_named_with_their_place(tmp_path, old, new, says):
    path = tmp_path / "my rig.yaml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(FormatError, match=f"(?s)my rig.yaml: .*{says}"):
        read_rig(path)


def test_what_is_no_file_is_refused(tmp_path):
    (tmp_path / "rig.yaml").write_bytes(b"\xff\xfe\x00")
    for name in ("rig.yaml", "nowhere.yaml", "."):
        with pytest.raises(FormatError, match="cannot be read"):
            read_rig(tmp_path / name)


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
