"""DDS: what one process writes, another reads; and nothing that is sent can end an older peer."""

from __future__ import annotations

import subprocess
import sys
import time
import warnings

import numpy as np
import pytest

from eagor.errors import DeviceError, FormatError
from eagor.media.ros_messages import _struct, encoded_type, store, topic_name
from eagor.robots.dds import Link, free_domain

pytestmark = pytest.mark.xdist_group("real time")

LONG = 20.0  # seconds to wait for what comes at once


def until(happened, what: str) -> None:
    end = time.monotonic() + LONG
    while not happened():
        assert time.monotonic() < end, what
        time.sleep(0.01)


def message(kind: str, **fields):
    return store().types[kind](**fields)


def header(seconds: int = 5):
    return message(
        "std_msgs/msg/Header", stamp=message("builtin_interfaces/msg/Time", sec=seconds, nanosec=7), frame_id="x3"
    )


def test_another_process_gets_every_message_unchanged():
    other = """
import sys, time
from eagor.robots.dds import Link
with Link(int(sys.argv[1]), "lo") as link:
    writer = link.publish("back", "sensor_msgs/msg/CompressedImage", depth=100)
    back = lambda m, when: writer.write(m)
    link.subscribe("/there", "sensor_msgs/msg/CompressedImage", back, reliable=True, depth=100)
    while not writer.readers: time.sleep(0.01)
    print("ready", flush=True)
    sys.stdin.read()
"""
    domain, got = free_domain(), []
    rng = np.random.default_rng(0)
    with Link(domain, "lo") as link:
        kind = "sensor_msgs/msg/CompressedImage"
        writer = link.publish("/there", kind, depth=100)
        link.subscribe("/back", kind, lambda m, when: got.append((m, when)), reliable=True, depth=100)
        with subprocess.Popen(
            [sys.executable, "-c", other, str(domain)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as peer:
            assert peer.stdout is not None
            assert peer.stdout.readline() == b"ready\n"
            until(lambda: writer.readers == 1, "the other process reads")
            sent = [
                message(kind, header=header(i), format="jpeg", data=rng.integers(0, 256, 1000 * i, dtype=np.uint8))
                for i in range(20)
            ]
            for each in sent:
                writer.write(each)
            until(lambda: len(got) == len(sent), "all come back")
            peer.communicate(timeout=LONG)
    for one, (two, when) in zip(sent, got, strict=True):
        assert (one.header.stamp.sec, one.format) == (two.header.stamp.sec, two.format)
        np.testing.assert_array_equal(one.data, two.data)
        assert abs(when - time.time()) < 10 * LONG


def test_who_comes_late_gets_what_was_said_before_if_it_is_transient():
    domain, got = free_domain(), []
    with Link(domain, "lo") as link:
        writer = link.publish("/query", "std_msgs/msg/String", transient=True)
        writer.write(message("std_msgs/msg/String", data="red chair"))
        link.subscribe("/query", "std_msgs/msg/String", lambda m, _: got.append(m.data), reliable=True, transient=True)
        until(lambda: got == ["red chair"], "the message comes")


def test_a_callback_that_raises_is_told_once_and_counted():
    domain, got = free_domain(), []

    def received(m, when):
        got.append(m.data)
        raise RuntimeError("no")

    with warnings.catch_warnings(record=True) as said, Link(domain, "lo") as link:
        warnings.simplefilter("always")
        reader = link.subscribe("/a", "std_msgs/msg/String", received, reliable=True)
        writer = link.publish("/a", "std_msgs/msg/String")
        until(lambda: writer.readers == 1 and reader.writers == 1, "they meet")
        for word in "abc":
            writer.write(message("std_msgs/msg/String", data=word))
        until(lambda: reader.damaged == 3, "all three come")
    assert got == ["a", "b", "c"]
    assert [str(warning.message) for warning in said] == [
        "/a: a message cannot be used (RuntimeError: no); it is left out, and others like it"
    ]


def test_topics_are_listed_with_their_types():
    domain = free_domain()
    with Link(domain, "lo") as link:
        link.publish("/odom", "nav_msgs/msg/Odometry")
        assert link.topics(0.3) == {"rt/odom": "nav_msgs::msg::dds_::Odometry_"}


@pytest.mark.parametrize(
    ("domain", "interface", "said"),
    [
        (233, "lo", "DDS domain 233; wanted a whole number from 0 to 232"),
        (-1, "lo", "DDS domain -1"),
        (True, "lo", "DDS domain True"),
        (3, "wlan77", "there is no network interface 'wlan77'; this machine has .*lo"),
    ],
)
def test_domains_and_interfaces_that_cannot_be(domain, interface, said):
    with pytest.raises(DeviceError, match=said):
        Link(domain, interface)


def test_a_domain_keeps_its_interface_in_one_process():
    domain = free_domain()
    with Link(domain, "lo"), pytest.raises(DeviceError, match="is already used on lo in this process"):
        Link(domain)


def test_a_closed_link_says_so():
    link = Link(free_domain(), "lo")
    link.close()
    link.close()
    with pytest.raises(DeviceError, match="this link is closed"):
        link.publish("/a", "std_msgs/msg/String")


def test_unknown_types_are_refused():
    with pytest.raises(FormatError, match="'some_msgs/msg/Thing' is no known ROS 2 type"):
        encoded_type("some_msgs/msg/Thing")


def test_topics_are_named_as_ros_names_them():
    assert {topic_name(name) for name in ("odom", "/odom", "rt/odom")} == {"rt/odom"}


def test_no_type_says_uint8_or_int8():
    """cyclonedds 11's type information of these ends every process with Cyclone 0.10 that it reaches."""
    seen: set[type] = set()

    def look(kind) -> None:
        if kind in seen:
            return
        seen.add(kind)
        for about in kind.__annotations__.values():
            said = repr(about)
            assert "uint8" not in said, (kind, said)
            assert "'int8'" not in said, (kind, said)
            assert about is not int

    for name in store().fielddefs:
        if "/msg/" in name:
            look(_struct(name))
    assert len(seen) >= 150
