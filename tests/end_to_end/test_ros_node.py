"""The node over real DDS: another process shows a room and walks in it, ours answers, and the directions are right."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from processes import alive, sessions_of, wait_for

from eagor.cli import main
from eagor.lab.worlds.painted import Room, bearing
from eagor.media import ros_messages as m
from eagor.robots.dds import Link, free_domain
from eagor.robots.ros import publishing as made
from eagor.sphere import angular_distance

pytestmark = pytest.mark.xdist_group("real time")

LONG = 180.0
ROBOT = """
import math, sys, time
import numpy as np
from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.media import Pose
from eagor.media import ros_messages as m
from eagor.sphere import world_R_body
from eagor.lab.worlds.painted import Room, paint

domain, speed = int(sys.argv[1]), float(sys.argv[2])
mount = world_R_body(math.radians(40), 0, 0), np.array([0.05, 0.0, 0.3])
place = np.array([-0.5, 0.2, 1.0])
yaws = np.arange(0, 360, 15)  # painted before: painting takes time
shown = [paint(Room(), tuple(place + world_R_body(math.radians(y), 0, 0) @ mount[1]),
               world_R_body(math.radians(y), 0, 0) @ mount[0], 64, 128) for y in yaws]
with Link(domain, "lo") as link:
    fixed = link.publish("/tf_static", m.TRANSFORMS, transient=True)
    fixed.write(m.transforms_message(m.transform_message(time.time(), "base_link", "x3_link", *mount)))
    odometry = link.publish("/odom", m.ODOMETRY)
    pictures = link.publish("/image/compressed", m.COMPRESSED, reliable=False)
    print("ready", flush=True)
    start, done = time.time(), -1
    while True:
        now = time.time()
        turned = speed * (now - start)
        pose = Pose(now, world_R_body(math.radians(turned), 0, 0), place)
        try:
            odometry.write(m.odometry_message(pose))
            number = int(turned // 15) if speed else int((now - start) / 0.2)
            if number > done:  # the camera shows what it saw when it looked there
                done = number
                stamp = start + 15 * number / speed if speed else now
                shot = shown[number % len(shown)] if speed else shown[0]
                pictures.write(m.compressed_message(shot, stamp, "x3_link", kind="png"))
        except DeviceError:
            pass
        time.sleep(0.02)
"""


@pytest.fixture
def robot():
    """Starts a robot that turns with so many degrees per second; returns its domain."""
    started = []

    def start(speed):
        domain = free_domain()
        process = subprocess.Popen([sys.executable, "-c", ROBOT, str(domain), str(speed)], stdout=subprocess.PIPE)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        return domain

    yield start
    for process in started:
        process.kill()
        process.communicate()


class Heard:
    """What another node hears of ours."""

    def __init__(self, domain):
        self.got = {name: [] for name in TOPICS}
        self.news = threading.Condition()
        self.link = Link(domain, "lo")
        for topic, kind in TOPICS.items():
            self.link.subscribe(topic, kind, lambda message, _, topic=topic: self.take(topic, message), reliable=True)

    def take(self, topic, message):
        with self.news:
            self.got[topic].append(message)
            self.news.notify_all()

    def until(self, what, why):
        with self.news:
            assert self.news.wait_for(lambda: what(self.got), LONG), why


TOPICS = {
    "/odom": m.ODOMETRY,
    "/eagor/direction": m.VECTOR,
    "/eagor/direction_pose": m.POSE,
    "/eagor/markers": made.MARKERS,
    "/eagor/belief_image": m.IMAGE,
    "/eagor/belief": made.NUMBERS,
    "/eagor/yellow/direction": m.VECTOR,
    "/diagnostics": made.DIAGNOSTICS,
}


def node(domain, *words):
    return subprocess.Popen(
        [sys.executable, "-m", "eagor", "ros", *words, "--domain", str(domain), "--interface", "lo", "--rate", "10"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, text=True,
    )  # fmt: skip


def ended(process, how):
    """Send the signal; returns code and stderr, and checks that nothing is left."""
    sessions = sessions_of(process.pid)
    process.send_signal(how)
    out, err = process.communicate(timeout=LONG)
    wait_for(lambda: not alive(sessions))  # the tracker of shared memory ends a moment later
    return process.returncode, out, err


def truth(ball, pose):
    """The true direction of a ball in the axes of the body, seen by its camera."""
    turn = m.rotation_of(pose.pose.pose.orientation)
    place = m.triple(pose.pose.pose.position) + turn @ [0.05, 0.0, 0.3]
    return bearing(Room().balls[ball], place, turn)[0]


def worst(got, topic, ball, count=20):
    """The largest error of the newest directions, degrees: each at the odometry of its time."""
    poses = sorted((m.stamp_of(pose), pose) for pose in got["/odom"])
    stamps = np.array([stamp for stamp, _ in poses])
    errors = []
    for message in got[topic][-count:]:
        nearest = int(np.argmin(np.abs(stamps - m.stamp_of(message))))
        if abs(stamps[nearest] - m.stamp_of(message)) < 0.2:
            found = np.array([message.vector.x, message.vector.y, message.vector.z])
            errors.append(math.degrees(angular_distance(truth(ball, poses[nearest][1]), found)))
    return max(errors) if len(errors) >= count // 2 else math.inf


def test_directions_of_a_turning_robot_and_a_query_on_a_topic(robot):
    domain = robot(10.0)
    heard = Heard(domain)
    process = node(domain, "red")
    try:
        heard.until(lambda got: len(got["/eagor/direction"]) >= 30, "directions come")
        heard.until(lambda got: len(got["/eagor/belief_image"]) >= 2 and got["/eagor/belief"], "beliefs come")
        heard.until(lambda got: worst(got, "/eagor/direction", 0) < 5, "directions are right, while the robot turns")
        with heard.news:
            got = {topic: list(messages) for topic, messages in heard.got.items()}
        direction, pose, markers = (got[f"/eagor/{name}"][-1] for name in ("direction", "direction_pose", "markers"))
        assert direction.header.frame_id == pose.header.frame_id == "base_link"
        assert abs(m.stamp_of(direction) - time.time()) < LONG
        assert [(each.ns, each.id, each.action) for each in markers.markers] == [("red", k, 0) for k in range(3)]
        picture = got["/eagor/belief_image"][-1]
        assert (picture.encoding, picture.height, picture.width) == ("mono8", 64, 128)
        assert picture.header.frame_id == "x3_link"
        assert len(got["/eagor/belief"][-1].data) == 256
        heard.link.publish("/eagor/query", m.TEXT, transient=True).write(m.text_message("blue"))
        heard.until(
            lambda got: (
                {(k.ns, k.action) for each in got["/eagor/markers"] for k in each.markers} >= {("red", 2), ("blue", 0)}
            ),
            "markers of old queries are taken away",
        )
        with heard.news:
            heard.got["/eagor/direction"].clear()
        heard.until(lambda got: worst(got, "/eagor/direction", 1) < 5, "the blue ball is found")
    finally:
        code, _, err = ended(process, signal.SIGTERM)
        heard.link.close()
    assert code == 143, err
    assert "Traceback" not in err


@pytest.mark.slow
def test_queries_come_on_a_topic_and_faults_are_told(robot):
    domain = robot(0.0)
    heard = Heard(domain)
    process = node(domain, "--odom-topic", "/odom", "--image-topic", "/image/compressed")
    try:
        heard.until(
            lambda got: any("waiting for a query" in s.message for d in got["/diagnostics"] for s in d.status),
            "the node says that it waits",
        )
        query = heard.link.publish("/eagor/query", m.TEXT, transient=True)
        query.write(m.text_message("red"))
        heard.until(lambda got: worst(got, "/eagor/direction", 0) < 5, "the red ball is found")
        query.write(m.text_message("+yellow"))
        heard.until(lambda got: worst(got, "/eagor/yellow/direction", 2) < 5, "the yellow ball is found, too")
        query.write(m.text_message("zzz"))  # no perception of ours knows that word
        heard.until(
            lambda got: any("zzz" in s.message for d in got["/diagnostics"] for s in d.status), "a bad query is told"
        )
        query.write(m.text_message("blue"))
        with heard.news:
            heard.got["/eagor/direction"].clear()
        heard.until(lambda got: worst(got, "/eagor/direction", 1) < 5, "the node goes on with the blue ball")
        heard.until(
            lambda got: {
                (k.ns, k.action) for each in got["/eagor/markers"] for k in each.markers
            } >= {("red", 2), ("yellow", 2), ("blue", 0)},
            "markers of old queries are taken away",
        )  # fmt: skip
    finally:
        code, _, err = ended(process, signal.SIGINT)
        heard.link.close()
    assert code == 130, err
    assert "Traceback" not in err


@pytest.mark.slow
def test_a_node_without_a_camera_or_with_a_wrong_topic(robot, capsys):
    domain = robot(0.0)
    where = ["--domain", str(domain), "--interface", "lo"]
    assert main(["ros", "red", "--image-topic", "/odom", *where]) == 2
    assert "/odom is of type nav_msgs/msg/Odometry; wanted sensor_msgs/msg/Image or" in capsys.readouterr().err
    assert main(["ros", "red", "--odom-topic", "/odometry", *where]) == 2
    assert "has no topic /odometry; it has /image/compressed" in capsys.readouterr().err
    assert main(["ros", "red", "--domain", str(domain), "--interface", "wlan77"]) == 2
    assert "there is no network interface 'wlan77'" in capsys.readouterr().err
    assert main(["ros", "red", "--domain", "300"]) == 2
    assert "DDS domain 300; wanted a whole number from 0 to 232" in capsys.readouterr().err
    assert main(["ros", "red", "--name", "a b", *where]) == 2
    assert "--name a b; wanted letters" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_of_some_seconds_is_recorded(robot, tmp_path):
    from eagor.media.bags import Bag

    domain = robot(0.0)
    process = node(domain, "red", "--seconds", "8", "--json", "--record", str(tmp_path / "run"))
    out, err = process.communicate(timeout=LONG)
    assert process.returncode == 0, err
    assert json.loads(out)["answers"] > 10
    assert Bag(tmp_path / "run").counts["/eagor/events"] > 10


def test_ctrl_c_ends_a_node_with_its_object(monkeypatch, capsys):
    node = SimpleNamespace(run=lambda: signal.raise_signal(signal.SIGINT), answers=12, queries=("red",))
    graph = SimpleNamespace(link=SimpleNamespace(domain=7))
    monkeypatch.setattr("eagor.robots.ros.graph.DdsGraph", lambda *_: nullcontext(graph))
    monkeypatch.setattr("eagor.robots.ros.node.Node", lambda *_, **__: node)
    assert main(["ros", "red", "--json"]) == 130
    assert json.loads(capsys.readouterr().out) == {"queries": ["red"], "answers": 12, "ended": "interrupted"}


@pytest.mark.slow
def test_a_killed_node_leaves_nothing_behind(robot):
    domain = robot(0.0)
    heard = Heard(domain)
    process = node(domain, "red")
    try:
        heard.until(lambda got: got["/eagor/direction"], "directions come")
        sessions = sessions_of(process.pid)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.communicate(timeout=LONG)
        heard.link.close()
    end = time.monotonic() + LONG
    while alive(sessions):
        assert time.monotonic() < end, alive(sessions)
        time.sleep(0.05)
