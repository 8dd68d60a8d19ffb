"""The node among real ROS 2 nodes: how often, how late and how far off its answers are, and what it costs.

A robot turns beside a red ball, and publishes pictures and odometry (``tests/ros_peer.py``); node and listener are
processes of their own on this machine. ``python benchmarks/ros2.py`` takes five minutes; it needs rclpy.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from std_msgs.msg import String

PEER = Path(__file__).parents[1] / "tests" / "ros_peer.py"
BALL = 0.6  # radians: where it is in the room of the peer
SETTINGS = {
    "jpeg, 10 a second": {"transport": "compressed", "rows": 256},
    "raw, 0.4 MB, 10 a second": {"rows": 256},
    "raw, 4.8 MB, 5 a second": {"rows": 895, "rate": 5.0},
    "jpeg, 10 a second, two robots": {"transport": "compressed", "rows": 256, "robots": 2},
    "raw, 0.4 MB, 10 a second, two robots": {"rows": 256, "robots": 2},
    "small jpeg, 5 a second, two robots": {"transport": "compressed", "rate": 5.0, "robots": 2},
}
TICKS = os.sysconf("SC_CLK_TCK")


def cpu(pid: int) -> float:
    """Seconds of CPU of a process and of those that it has started."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / TICKS + sum(cpu(int(child)) for child in children)


def run(robots: int = 1, seconds: float = 40.0, **settings: object) -> list[str]:
    """One row of the table; figures are those of all robots together, after the detector has been loaded."""
    names = [f"/robot{number + 1}" for number in range(robots)]
    compressed = ("-p", "image_transport:=compressed") if settings.get("transport") == "compressed" else ()
    answers: list[list[tuple[float, dict]]] = [[] for _ in names]
    yaws: list[dict[int, float]] = [{} for _ in names]
    rclpy.init()
    node = rclpy.create_node("benchmark")
    started, nodes = [], []
    for number, space in enumerate(names):

        def moved(told: Odometry, number: int = number) -> None:
            stamp, turn = told.header.stamp, told.pose.pose.orientation
            yaws[number][stamp.sec * 10**9 + stamp.nanosec] = 2 * math.atan2(turn.z, turn.w)

        def answered(told: String, number: int = number) -> None:
            answers[number].append((time.time(), json.loads(told.data)[0]))

        node.create_subscription(Odometry, f"{space}/wheels", moved, 100)
        node.create_subscription(String, f"{space}/eagor/answers", answered, 100)
        peer = json.dumps({"seconds": 600.0, "namespace": space, **settings})
        started.append(subprocess.Popen([sys.executable, str(PEER), peer]))
        words = ["-r", f"__ns:={space}", "-r", "image:=x3/image", "-r", "odom:=wheels", *compressed]
        words += ["-p", "perception:=colour", "-p", "queries:=['red ball']"]
        nodes.append(
            subprocess.Popen([sys.executable, "-m", "eagor", "ros", "--ros-args", *words], stderr=subprocess.DEVNULL)
        )
    try:
        while not all(each and each[-1][1]["status"] == "tracking" for each in answers):
            rclpy.spin_once(node, timeout_sec=0.1)
        for each in answers:
            each.clear()
        begun, used = time.time(), sum(cpu(each.pid) for each in nodes)
        while time.time() < begun + seconds:
            rclpy.spin_once(node, timeout_sec=0.1)
        used = (sum(cpu(each.pid) for each in nodes) - used) / seconds / robots
    finally:
        node.destroy_node()  # first: it crashes now and then once those that it hears were killed
        rclpy.shutdown()
        for each in [*nodes, *started]:
            each.kill()
            each.wait()
    errors, cones, ages = [], [], []
    for told, turned in zip(answers, yaws, strict=True):
        for arrived, answer in told:
            ages.append(arrived - answer["stamp"])
            if answer["direction"] is not None and answer["stamp_ns"] in turned:
                azimuth = BALL - turned[answer["stamp_ns"]]
                cosine = float(np.dot([math.cos(azimuth), math.sin(azimuth), 0.0], answer["direction"]))
                errors.append(math.degrees(math.acos(min(1.0, cosine))))
                cones.append(answer["credible_angle_deg"])
    held = np.mean(np.array(errors) <= np.array(cones))
    rate = sum(map(len, answers)) / seconds / robots
    return [
        f"{rate:.1f}", f"{np.median(ages):.3f}", f"{np.median(errors):.2f}", f"{np.quantile(errors, 0.95):.2f}",
        f"{held:.2f} of {len(errors)}", f"{np.median(cones):.1f}", f"{used:.2f}",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=40.0, help="of each row")
    seconds = parser.parse_args().seconds
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(100 + os.getpid() % 100)}
    head = (
        "pictures",
        "answers a second",
        "age, s",
        "error, median",
        "95 %",
        "cones of 90 % hold it",
        "cone",
        "CPU, s a second",
    )
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for name, settings in SETTINGS.items():
        print(f"| {name} | {' | '.join(run(seconds=seconds, **settings))} |", flush=True)


if __name__ == "__main__":
    main()
