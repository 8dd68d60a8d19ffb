"""The node: parameters from ROS, all else from `eagor.robots.ros.node`. rclpy is imported when it runs."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

DEFAULTS: dict[str, Any] = {
    "queries": [""],
    "image_topic": "",
    "camera_info": "",
    "odom_topic": "",
    "poses": "odom",
    "body": "base_link",
    "camera": "",
    "world": "",
    "rate": 20.0,
    "belief_rate": 2.0,
    "belief_encoding": "mono8",
    "latency": 0.0,
    "patience": 60.0,
    "perception": "",
    "degree": 15,
    "cmd_vel": "",
    "speed": 0.3,
    "distance": 1.0,
}
SIM_TIME = "use_sim_time"  # rclpy declares it for every node


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is interrupted; returns the exit code."""
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    from eagor.errors import EagorError

    rclpy.init(args=args)
    ros_node = rclpy.create_node("eagor")
    executor = SingleThreadedExecutor()
    executor.add_node(ros_node)

    def spin() -> None:
        with suppress(KeyboardInterrupt, ExternalShutdownException):
            executor.spin()
        node.stop()

    code = 0
    spinning = None
    try:
        node = made(ros_node)
        spinning = threading.Thread(target=spin, daemon=True)
        spinning.start()
        node.run()
    except KeyboardInterrupt:
        pass
    except EagorError as error:
        ros_node.get_logger().error(str(error))
        code = 2
    finally:
        executor.shutdown()
        if spinning is not None:
            spinning.join(5.0)
        ros_node.destroy_node()
        if rclpy.ok():
            rclpy.shutdown()
    return code


def made(ros_node: Any) -> Any:
    """The node of eagor for an rclpy node, with its parameters. Raises `EagorError` for wrong ones."""
    from eagor.cli.checks import perception_for_all, tracker_config
    from eagor.robots.ros.node import Node, NodeSettings
    from eagor.robots.safety.walking import WalkSettings
    from eagor_ros.graph import RclpyGraph

    for name, default in DEFAULTS.items():
        ros_node.declare_parameter(name, default)
    told = {name: ros_node.get_parameter(name).value for name in (*DEFAULTS, SIM_TIME)}
    queries = tuple(query for query in told["queries"] if query.strip())
    perception = told["perception"] or None
    names = ("poses", "body", "rate", "belief_rate", "belief_encoding", "latency", "patience", SIM_TIME)
    settings = NodeSettings(
        **{name: told[name] for name in names},
        **{
            name: told[name] or None
            for name in ("image_topic", "camera_info", "odom_topic", "camera", "world", "cmd_vel")
        },
        walking=WalkSettings(speed=told["speed"], distance=told["distance"]),
        config=tracker_config(told["degree"], perception or "colour"),
    )
    return Node(
        RclpyGraph(ros_node),
        queries=queries,
        settings=settings,
        choose=lambda words: perception_for_all(words, perception),
        said=ros_node.get_logger().warning,
    )
