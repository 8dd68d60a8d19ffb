"""What nodes of ROS learn of ours over DDS: its name, its topics and their types, as older and newer ones read it."""

from __future__ import annotations

import time

import pytest
from rosbags.typesys import Stores, get_typestore

from eagor.media import ros_messages as m
from eagor.media.ros_messages import encoded_type, hash_of
from eagor.robots.dds import Link, free_domain
from eagor.robots.ros.graph import DISCOVERY, DdsGraph, announced
from eagor.robots.ros.graph import DISCOVERY_TYPE as INFO

pytestmark = pytest.mark.xdist_group("real time")

LONG = 30.0
OLDER, NEWER = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_JAZZY)


def until(what, why):
    end = time.monotonic() + LONG
    while not what():
        assert time.monotonic() < end, why
        time.sleep(0.02)


def seen(link):
    """Participants' user data by id; endpoints by id: topic and user data. As any other participant finds them."""
    from cyclonedds import builtin as b

    def samples(topic):
        return [each for each in b.BuiltinDataReader(link.participant, topic).read(N=100) if each.qos is not None]

    said = lambda sample: b"".join(getattr(policy, "data", b"") for policy in sample.qos)  # noqa: E731
    people = {each.key.bytes: said(each) for each in samples(b.BuiltinTopicDcpsParticipant)}
    ends = {}
    for topic in (b.BuiltinTopicDcpsPublication, b.BuiltinTopicDcpsSubscription):
        ends |= {each.key.bytes: (each.topic_name, said(each)) for each in samples(topic)}
    return people, ends


def test_a_node_is_announced_with_its_name_and_endpoints_as_older_and_newer_nodes_read_it():
    domain, got = free_domain(), []
    with Link(domain, "lo") as other, DdsGraph(domain, "lo", "/robot1/eagor") as graph:
        for kind in (
            encoded_type(INFO),
            encoded_type(INFO, newer=True),
        ):  # a node of ROS takes both for the same type
            other.subscribe(DISCOVERY, kind, lambda sample, _: got.append(sample.data), reliable=True, transient=True)
        graph.publish("~/direction", m.VECTOR)
        graph.subscribe("/odom", m.ODOMETRY, print)
        kinds = {"rt/robot1/eagor/direction": m.VECTOR, "rt/odom": m.ODOMETRY}

        def newest(store):
            """The nodes of the newest message, with the topics of its endpoints; None where it is of the other form."""
            people, ends = seen(other)
            try:
                found = store.deserialize_cdr(got[-1], INFO)
            except Exception:
                return None
            names = lambda gids: [ends.get(bytes(gid.data)[:16], ("?", b""))[0] for gid in gids]  # noqa: E731
            return bytes(found.gid.data)[:16] in people, [
                (each.node_namespace, each.node_name, names(each.reader_gid_seq), names(each.writer_gid_seq))
                for each in found.node_entities_info_seq
            ]

        node = True, [("/robot1", "eagor", ["rt/odom"], ["rt/robot1/eagor/direction"])]
        until(lambda: got and newest(OLDER) == node, "while nobody tells hashes, as older nodes read it")
        assert newest(NEWER) is None or newest(NEWER)[1] == []  # no node, rather than a wrong one
        people, ends = seen(other)
        (participant,) = [
            data for key, data in people.items() if key == bytes(OLDER.deserialize_cdr(got[-1], INFO).gid.data)[:16]
        ]
        assert participant == b"enclave=/;"
        for topic, told in ends.values():
            if topic in kinds:
                assert told == b"typehash=" + NEWER.hash_rihs01(kinds[topic]).encode() + b";"
        newer = other.publish(DISCOVERY, encoded_type(INFO, True), transient=True, user_data=hash_of(INFO))
        until(lambda: newest(NEWER) == node, "a newer node has come")
        graph.publish("/diagnostics", m.TEXT)
        until(lambda: newest(NEWER) and newest(NEWER)[1][0][3][-1] == "rt/diagnostics", "a new endpoint is told")
        newer.close()
        del newer
        other._parts.pop()  # the last one that refers to the writer
        until(lambda: newest(OLDER) is not None and newest(OLDER)[1] != [], "the newer node has gone")


def test_hashes_are_those_that_ros_publishes():
    """The hash of std_msgs/msg/String is in ROS's own documentation of ros2 topic info."""
    assert hash_of(m.TEXT) == (b"typehash=RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18;")


def test_the_root_is_a_namespace():
    data = announced(bytes(range(16)), "/eagor", [], [b"r" * 16], True)
    (node,) = NEWER.deserialize_cdr(data, INFO).node_entities_info_seq
    assert (node.node_namespace, node.node_name, bytes(node.writer_gid_seq[0].data)) == ("/", "eagor", b"r" * 16)
