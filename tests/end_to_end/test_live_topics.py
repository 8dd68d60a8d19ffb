"""``eagor live`` on the topics of a ROS 2 system, and of a Go2, over real DDS."""

import json
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from eagor.cli import main
from eagor.lab.worlds.painted import painted_room
from eagor.robots.dds import free_domain

pytestmark = pytest.mark.xdist_group("real time")

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")
TURN = 0.5  # radians per second
ROBOT = -40.0  # seconds by which the robot's clock is off


@pytest.fixture
def robot():
    """A robot that turns in the painted room, on a domain of its own: pictures at 10 Hz, odometry at 50 Hz."""
    from eagor.media import Pose
    from eagor.media import ros_messages as m
    from eagor.robots.dds import Link
    from eagor.sphere import world_R_body

    room, ended, domain = painted_room(64, 128), threading.Event(), free_domain()
    with Link(domain, "lo") as link:
        pictures, odometry = link.publish("/image", m.IMAGE), link.publish("/odom", m.ODOMETRY)

        def speak():
            number = 0
            while not ended.wait(0.02):
                now = time.time()
                odometry.write(m.odometry_message(Pose(now + ROBOT, world_R_body(TURN * now, 0, 0))))
                if number % 5 == 0:
                    columns = round(TURN * now / (2 * np.pi) * 128)
                    pictures.write(m.image_message(np.roll(room, columns, axis=1), now + ROBOT, "base_link"))
                number += 1

        thread = threading.Thread(target=speak)
        thread.start()
        try:
            yield domain
        finally:
            ended.set()
            thread.join()


def spread(answers):
    """Degrees by which directions in the world differ, but for a tenth of them on either side.

    In the world the chair stands still, while it turns with half a radian per second in the robot's frame.
    """
    world = [answer["azimuth_deg"] + np.degrees(TURN * answer["stamp"]) for answer in answers]
    return np.ptp(np.percentile(np.degrees(np.unwrap(np.radians(world))), [10, 90]))


def test_a_turning_robots_topics_are_followed_although_its_clock_is_off(robot):
    words = ["ros:/image", "red", "--poses", "ros:/odom", "--domain", str(robot), "--interface", "lo", "--json"]
    command = [sys.executable, "-m", "eagor", "live", *words, "--seconds", "120"]
    known, followed = [], False
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            answer = json.loads(line)
            # On a busy machine the robot falls silent at times.
            if answer["status"] == "tracking" and answer["pose_age"] is not None and answer["pose_age"] < 0.1:
                known.append(answer)
            # The clocks are compared by the quickest messages: while all are slow, directions lag, and then they leap.
            known = [each for each in known if each["stamp"] > answer["stamp"] - 2]
            if len(known) > 15 and known[-1]["stamp"] - known[0]["stamp"] > 1 and spread(known) < 12:
                followed = True
                break
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=300)
    assert followed, said
    assert "s behind this machine's; its stamps are shifted" in said


@pytest.mark.slow
def test_a_topic_that_is_not_there_is_an_error_that_names_those_there_are(robot, capsys):
    words = ["ros:/nowhere", "red", "--poses", "still", "--domain", str(robot), "--interface", "lo"]
    assert main(["live", *words]) == 2
    assert "/image" in capsys.readouterr().err
