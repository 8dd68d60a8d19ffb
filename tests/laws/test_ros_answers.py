"""What the node says: directions in the axes of the body, markers that leave nothing behind, queries by their words."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor import DirectionTracker, ErpGrid, Evidence, RealHarmonics
from eagor.live.events import Answer, Fault
from eagor.media import ros_messages as m
from eagor.media.ros_messages import store
from eagor.robots.ros import publishing as made
from eagor.robots.ros.node import queries_after
from eagor.sphere import angular_distance, direction, world_R_body

NOW = 1_700_000_000.0
ANGLE = st.floats(-math.pi, math.pi)


def answered(d=None, faults=(), query="red chair"):
    """An answer that was led to the direction `d` of the camera's frame, or to none."""
    tracker = DirectionTracker()
    tracker.add_pose(NOW - 1, np.eye(3))
    tracker.add_pose(NOW, np.eye(3))
    if d is not None:
        for k in range(4):
            tracker.observe(Evidence.from_points(np.array([d]), stamp=NOW - 0.5 + 0.1 * k))
    estimate = tracker.estimate(NOW)
    return Answer(NOW, query, estimate, None, 0.1, 0.1, tuple(faults))


AHEAD = answered(direction(0.3, 0.2))
NOTHING = answered()


def numbers(v):
    return np.array([v.x, v.y, v.z])


@settings(max_examples=30)
@given(yaw=ANGLE, pitch=st.floats(-1, 1), roll=ANGLE)
def test_directions_poses_and_arrows_point_the_same_way(yaw, pitch, roll):
    mount = world_R_body(yaw, pitch, roll)
    truth = mount @ AHEAD.direction
    found = made.direction_message(AHEAD, mount, "base_link")
    assert (m.stamp_of(found), found.header.frame_id) == (NOW, "base_link")
    np.testing.assert_allclose(numbers(found.vector), truth, atol=1e-12)
    pose = made.direction_pose(AHEAD, mount, "base_link")
    np.testing.assert_allclose(m.rotation_of(pose.pose.orientation)[:, 0], truth, atol=1e-7)
    assert abs(m.rotation_of(pose.pose.orientation)[2, 1]) < 1e-7  # y is level
    arrow, cone, text = made.markers(AHEAD, mount, "base_link").markers
    np.testing.assert_allclose(m.rotation_of(arrow.pose.orientation)[:, 0], truth, atol=1e-7)
    place = numbers(text.pose.position)
    np.testing.assert_allclose(place / np.linalg.norm(place), truth, atol=1e-7)
    rim = np.array([numbers(p) for k, p in enumerate(cone.points) if k % 3])
    apart = [angular_distance(truth, p / np.linalg.norm(p)) for p in rim]
    np.testing.assert_allclose(apart, AHEAD.estimate.credible_angle, atol=1e-6)


def test_nothing_known_is_nothing_said_and_markers_go():
    assert made.direction_message(NOTHING, np.eye(3), "base_link") is None
    assert made.direction_pose(NOTHING, np.eye(3), "base_link") is None
    shown = {(each.ns, each.id) for each in made.markers(AHEAD, np.eye(3), "base_link").markers}
    gone = made.markers(NOTHING, np.eye(3), "base_link").markers
    assert {(each.ns, each.id) for each in gone} == shown
    assert {each.action for each in gone} == {2}
    for each in made.markers(AHEAD, np.eye(3), "base_link").markers:
        assert each.lifetime.sec + each.lifetime.nanosec > 0
        assert each.color.a > 0


def test_every_message_can_be_sent():
    """All fields have the types that the definitions want."""
    fault = Fault("camera", "no picture for 3 s", NOW - 3)
    told = {
        made.MARKERS: [made.markers(AHEAD, np.eye(3), "b"), made.gone("x", NOW, "b")],
        m.IMAGE: [made.belief_image(AHEAD, "x3"), made.belief_image(AHEAD, "x3", encoding="32FC1")],
        made.NUMBERS: [made.belief_coefficients(AHEAD)],
        made.DIAGNOSTICS: [
            made.diagnostics(NOW, [answered(faults=[fault]), AHEAD], np.eye(3), ["camera", "poses"], {"looks": "3"}),
            made.trouble(NOW, "no"),
        ],
    }
    for kind, messages in told.items():
        for message in messages:
            back = store().deserialize_cdr(store().serialize_cdr(message, kind), kind)
            assert bytes(store().serialize_cdr(back, kind)) == bytes(store().serialize_cdr(message, kind))


def test_pictures_of_the_belief_are_over_those_of_the_camera():
    image = made.belief_image(AHEAD, "x3_link", rows=64)
    pixels = image.data.reshape(64, 128)
    row, column = np.unravel_index(int(pixels.argmax()), pixels.shape)
    peak = ErpGrid(64, 128).directions[row, column]
    assert math.degrees(angular_distance(peak, AHEAD.direction)) < 4
    assert pixels.max() == 255
    density = np.frombuffer(made.belief_image(AHEAD, "x3_link", encoding="32FC1").data, "<f4").reshape(64, 128)
    assert float(np.sum(density * ErpGrid(64, 128).weights)) == pytest.approx(1, abs=1e-4)


def test_coefficients_are_those_of_the_density():
    found = np.asarray(made.belief_coefficients(AHEAD).data, dtype=float)
    basis, grid = RealHarmonics(15), ErpGrid(64, 128)
    assert found[0] == pytest.approx(1 / math.sqrt(4 * math.pi), rel=1e-4)  # it integrates to 1
    np.testing.assert_allclose(found, basis.analyse(AHEAD.estimate.density(grid), grid), atol=1e-4)


def test_a_fault_is_a_warning_and_then_an_error():
    def level(seconds):
        fault = Fault("poses", "no pose for a while", NOW - seconds)
        found = made.diagnostics(NOW, [answered(faults=[fault])], np.eye(3), ["camera", "poses"], {})
        camera, poses, query = found.status
        assert (camera.level, camera.message, query.message) == (0, "all is well", "not known; searching")
        assert poses.message == "no pose for a while"
        return poses.level

    assert [level(0), level(4), level(6)] == [1, 1, 2]


def test_what_diagnostics_call_left_is_left():
    found = made.diagnostics(NOW, [answered(direction(0.5, -0.3))], np.eye(3), [], {}).status[0]
    assert "degrees to the left" in found.message
    assert "down" in found.message
    turned = made.diagnostics(NOW, [answered(direction(0.5, -0.3))], world_R_body(-1.0), [], {}).status[0]
    assert "degrees to the right" in turned.message


@pytest.mark.parametrize(
    ("now", "text", "then"),
    [
        ((), "red chair", ("red chair",)),
        (("a",), "red chair", ("red chair",)),
        (("a",), "+red chair", ("a", "red chair")),
        (("a", "b"), "-a", ("b",)),
        (("a",), "-b", ("a",)),
        (("a",), "", ()),
        (("a",), "  ", ()),
        (("a",), "b; c", ("b", "c")),
        (("a",), "b\nc;", ("b", "c")),
        (("a",), "+b; +c", ("a", "b", "c")),
        (("a",), "+a", ("a",)),
        (("a",), "?!", ("a",)),
        (("a", "b"), "-a; +c", ("b", "c")),
    ],
)
def test_queries(now, text, then):
    assert queries_after(now, text) == then


@given(st.lists(st.text(max_size=5), max_size=4), st.text(max_size=30))
def test_any_text_is_a_query_or_none(now, text):
    found = queries_after(now, text)
    assert len(found) <= 16
    assert all(isinstance(each, str) for each in found)


@given(st.text(min_size=1, max_size=30))
def test_any_query_is_a_part_of_a_topics_name(query):
    name = made.topic_of(query)
    assert name[0].isalpha()
    assert name.isascii()
    assert all(c.isalnum() or c == "_" for c in name)
    assert "__" not in name
