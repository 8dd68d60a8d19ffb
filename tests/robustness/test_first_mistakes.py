"""What people type first, and get wrong: each mistake is told, with what to change."""

import math
import threading
from itertools import islice

import cv2
import numpy as np
import pytest

import eagor
from eagor.errors import ImageError, RotationError
from eagor.perception.colour import ColourPerception
from eagor.perception.views import Detector
from eagor.sources.odometry import prefetched
from eagor.sources.panorama import read_panorama, read_stored, tone_mapped
from eagor.sphere import world_R_body


def nothing(picture, query):
    return np.zeros((0, 4)), np.zeros(0)


def test_degrees_for_radians():
    with pytest.warns(UserWarning, match=r"yaw = 90 radians is 14\.3 turns; of degrees pass math\.radians\(90\)"):
        world_R_body(90.0)
    with pytest.raises(RotationError, match=r"pitch = -45; wanted radians: math\.radians\(-45\)"):
        world_R_body(0.0, -45.0)
    np.testing.assert_allclose(world_R_body(0.3 + 20 * math.tau), world_R_body(0.3), atol=1e-12)  # it turns and turns


@pytest.mark.parametrize(
    ("name", "meant"),
    [("Tracker", "did you mean DirectionTracker"), ("Estimat", "did you mean Estimate"), ("belief2", "mean belief")],
)
def test_names_that_are_nearly_right(name, meant):
    with pytest.raises(AttributeError, match=f"no attribute '{name}'.*{meant}"):
        getattr(eagor, name)
    assert not hasattr(eagor, "__wrapped__")


@pytest.mark.parametrize("perception", [ColourPerception(), Detector(nothing, size=32)])
def test_an_ordinary_picture_for_a_panorama(perception):
    with pytest.warns(UserWarning, match=r"640 x 480 came for a panorama, which is 2:1.*eagor\.PerspectiveGrid"):
        perception(np.zeros((480, 640, 3), np.uint8), "red", stamp=0.0)


def test_a_picture_with_radiance_is_tone_mapped_and_says_so(tmp_path):
    rng = np.random.default_rng(3)
    radiance = (rng.random((32, 64, 3)) * np.geomspace(1e-3, 1e3, 64)[:, None]).astype(np.float32)
    path = tmp_path / "room.hdr"
    cv2.imwrite(str(path), radiance[..., ::-1])
    with pytest.warns(UserWarning, match="holds radiance"):
        shown = read_panorama(path)
    assert np.abs(shown.astype(int) - tone_mapped(radiance)).mean() < 2  # RGBE has eight bits for the brightest
    light = tone_mapped(np.repeat(np.geomspace(1e-3, 1e3, 64)[None, :, None], 3, axis=2))[0, :, 0].astype(int)
    assert (np.diff(light) >= 0).all()
    assert light[0] < 20
    assert light[-1] == 255
    assert "tone-mapped" in read_stored(path).facts[0]
    assert tone_mapped(np.zeros((2, 4, 3))).max() == 0
    for content, says in ((path.read_bytes()[:300], "corrupt or truncated"), (b"nonsense", "no Radiance picture")):
        (broken := tmp_path / "broken.hdr").write_bytes(content)
        with pytest.raises(ImageError, match=says):
            read_panorama(broken)
    broken.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999 +X 199998\n")
    with pytest.raises(ImageError, match="claims 199998 x 99999 pixels"):
        read_panorama(broken)


def test_frames_that_are_made_ahead_come_in_order_with_their_error_and_end_with_the_caller():
    made = []

    def frames(count, wrong=None):
        for number in range(count):
            if number == wrong:
                raise ImageError("frame 3 is wrong")
            made.append(number)
            yield number

    assert [*prefetched(frames(5))] == [0, 1, 2, 3, 4]
    found = []
    with pytest.raises(ImageError, match="frame 3 is wrong"):
        found.extend(prefetched(frames(5, wrong=3)))
    assert found == [0, 1, 2]
    made.clear()
    coming = prefetched(frames(1000))
    assert len([*islice(coming, 2)]) == 2
    coming.close()
    assert len(made) <= 6
    assert not [each for each in threading.enumerate() if each.name.startswith("eagor-frames")]
