"""A base that obeys ``cmd_vel`` over real DDS is driven to a ball, and stands when the node is killed."""

from __future__ import annotations

import json
import subprocess
import sys
import time

import numpy as np
import pytest

from eagor.cli import main
from eagor.robots.dds import free_domain

pytestmark = pytest.mark.xdist_group("real time")

LONG = 180.0
BASE = """
import json, math, sys, time
import numpy as np
from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.media import Pose
from eagor.media import ros_messages as m
from eagor.sphere import world_R_body
from eagor.lab.worlds.painted import Ball, Room, paint

ROOM = Room(balls=(Ball((2.3, -1.0, 0.35), 0.35, "red"),))
told, when = [0.0, 0.0, 0.0], 0.0

def heard(twist, _):
    global when
    told[:], when = (twist.linear.x, twist.linear.y, twist.angular.z), time.time()

mount = world_R_body(math.radians(40), 0, 0), np.array([0.05, 0.0, 0.3])
place, yaw = np.array([-1.0, 0.6, 0.9]), math.radians(120)
with Link(int(sys.argv[1]), "lo") as link:
    fixed = link.publish("/tf_static", m.TRANSFORMS, transient=True)
    fixed.write(m.transforms_message(m.transform_message(time.time(), "base_link", "x3_link", *mount)))
    odometry = link.publish("/odom", m.ODOMETRY)
    pictures = link.publish("/image/compressed", m.COMPRESSED, reliable=False)
    link.subscribe("/cmd_vel", "geometry_msgs/msg/Twist", heard, reliable=True, depth=1)
    last, shown, said = time.time(), 0.0, 0.0
    print(json.dumps({"ready": True}), flush=True)
    while True:
        now = time.time()
        speed = told if now - when < 0.5 else (0.0, 0.0, 0.0)  # a base stops when nothing comes
        gone, last = now - last, now
        yaw += speed[2] * gone
        place = place + world_R_body(yaw) @ [speed[0] * gone, speed[1] * gone, 0.0]
        turn = world_R_body(yaw)
        try:
            odometry.write(m.odometry_message(Pose(now, turn, place)))
            if now - shown > 0.2:
                shown = now
                picture = paint(ROOM, tuple(place + turn @ mount[1]), turn @ mount[0], 64, 128)
                pictures.write(m.compressed_message(picture, now, "x3_link", kind="png"))
        except DeviceError:
            pass
        if now - said > 0.1:
            said = now
            print(json.dumps({"place": place.tolist(), "yaw": yaw, "speed": list(speed)}), flush=True)
        time.sleep(0.02)
"""


@pytest.fixture
def base():
    """A base over DDS; its domain, and a function that waits for something that it says."""
    domain = free_domain()
    process = subprocess.Popen([sys.executable, "-c", BASE, str(domain)], stdout=subprocess.PIPE, text=True)

    def until(what):
        end = time.monotonic() + LONG
        assert process.stdout is not None
        for line in process.stdout:
            said = json.loads(line)
            if what(said):
                return said
            assert time.monotonic() < end, said
        raise AssertionError("the base ended")

    until(lambda said: "ready" in said)
    yield domain, until
    process.kill()
    process.communicate()


def test_a_base_is_driven_to_a_ball_and_stands_when_the_node_is_killed(base):
    domain, until = base
    where = ["--domain", str(domain), "--interface", "lo", "--rate", "10"]
    node = subprocess.Popen(
        [sys.executable, "-m", "eagor", "ros", "red", *where, "--cmd-vel", "/cmd_vel", "--distance", "1.2"],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        ball = np.array([2.3, -1.0])
        begun = until(lambda said: any(said["speed"]))
        assert begun["speed"][0] == 0.0  # it turns in place first
        assert begun["speed"][2] < 0.0  # to the right, where the ball is
        until(lambda said: np.linalg.norm(ball - said["place"][:2]) < 3.0)  # 3.7 at first
        node.kill()
        _, err = node.communicate(timeout=LONG)
        assert "it DRIVES" in err
        until(lambda said: not any(said["speed"]))
    finally:
        node.kill()
        node.communicate()


def test_driving_without_odometry_is_refused(capsys):
    assert main(["ros", "red", "--cmd-vel", "/cmd_vel", "--poses", "auto"]) == 2
    assert "a base is driven only by odometry" in capsys.readouterr().err
