"""The package for those who have ROS: its files as text, and its node against a stub of rclpy that feeds it."""

from __future__ import annotations

import ast
import configparser
import math
import sys
import threading
import time
import types
import xml.etree.ElementTree as ET
from array import array
from pathlib import Path

import numpy as np
import pytest
import yaml

from eagor.lab.worlds.painted import Room, bearing, paint
from eagor.media import Pose
from eagor.media import ros_messages as m
from eagor.media.ros_messages import store
from eagor.robots.ros import publishing as made
from eagor.sphere import angular_distance, world_R_body

PACKAGE = Path(__file__).parents[2] / "ros2" / "eagor_ros"
LONG = 180.0


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    monkeypatch.syspath_prepend(PACKAGE)
    yield
    for name in [name for name in sys.modules if name.split(".")[0] == "eagor_ros"]:
        del sys.modules[name]


# --- the files ---


def test_package_xml_follows_format_3():
    """REP-149: the order and number of the elements, as its schema has them."""
    root = ET.parse(PACKAGE / "package.xml").getroot()
    assert (root.tag, root.attrib) == ("package", {"format": "3"})
    once = [child.tag for child in root]
    for tag in ("name", "version", "description"):
        assert once.count(tag) == 1
    assert once.count("maintainer") >= 1
    assert once.count("license") >= 1
    assert once.count("export") == 1
    allowed = {"name", "version", "description", "maintainer", "license", "exec_depend", "test_depend", "export"}
    assert {*once} <= allowed
    text = {child.tag: (child.text or "").strip() for child in root}
    assert text["name"] == "eagor_ros"
    assert all(part.isdigit() for part in text["version"].split("."))
    assert len(text["version"].split(".")) == 3
    assert text["license"] == "Apache-2.0"
    maintainer = root.find("maintainer")
    assert maintainer is not None
    assert "@" in maintainer.attrib["email"]
    assert root.findtext("export/build_type") == "ament_python"


def test_every_package_that_is_used_is_a_dependency():
    root = ET.parse(PACKAGE / "package.xml").getroot()
    depends = {each.text for each in root.findall("exec_depend")}
    kinds = {m.IMAGE, m.IMU, m.ODOMETRY, m.POSE, m.TRANSFORMS, m.TEXT, made.MARKERS, made.DIAGNOSTICS, made.NUMBERS}
    wanted = {kind.split("/")[0] for kind in kinds} | {"rclpy", "rosidl_runtime_py", "launch", "launch_ros"}
    assert wanted <= depends
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                name = node.module.split(".")[0]
                known = {"eagor", "eagor_ros", "numpy", "setuptools", "glob"} | sys.stdlib_module_names | depends
                assert name in known, (file, name)


def test_setup_installs_all_that_ament_looks_for(monkeypatch):
    import setuptools

    told = {}
    monkeypatch.setattr(setuptools, "setup", told.update)
    monkeypatch.chdir(PACKAGE)
    exec(compile((PACKAGE / "setup.py").read_text(), "setup.py", "exec"), {})
    files = {folder: sorted(names) for folder, names in told["data_files"]}
    assert files == {
        "share/ament_index/resource_index/packages": ["resource/eagor_ros"],
        "share/eagor_ros": ["package.xml"],
        "share/eagor_ros/launch": ["launch/eagor.launch.py"],
        "share/eagor_ros/config": ["config/params.yaml"],
    }
    assert all((PACKAGE / name).is_file() for names in files.values() for name in names)
    root = ET.parse(PACKAGE / "package.xml").getroot()
    assert (told["name"], told["version"]) == (root.findtext("name"), root.findtext("version"))
    assert told["entry_points"] == {"console_scripts": ["node = eagor_ros.node:main"]}
    config = configparser.ConfigParser()
    config.read(PACKAGE / "setup.cfg")
    assert config["develop"]["script_dir"] == config["install"]["install_scripts"] == "$base/lib/eagor_ros"


def test_the_parameters_are_those_of_the_node():
    from eagor_ros.node import DEFAULTS

    told = yaml.safe_load((PACKAGE / "config" / "params.yaml").read_text())
    assert told == {"/**": {"ros__parameters": DEFAULTS}}  # of a node with another name or namespace, too


def test_rclpy_is_imported_late():
    import eagor_ros.graph
    import eagor_ros.node

    assert "rclpy" not in sys.modules
    assert eagor_ros.node.main.__module__ == "eagor_ros.node"


def test_the_launch_file_starts_the_node_with_its_parameters(monkeypatch):
    class Made:
        def __init__(self, *given, **named):
            self.given, self.named = given, named

    for name, things in {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.substitutions": ["LaunchConfiguration", "PathJoinSubstitution"],
        "launch_ros.actions": ["Node"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
        "launch_ros.substitutions": ["FindPackageShare"],
        "launch_ros": [],
    }.items():
        module = types.ModuleType(name)
        for thing in things:
            setattr(module, thing, type(thing, (Made,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    space: dict = {}
    exec(compile((PACKAGE / "launch" / "eagor.launch.py").read_text(), "eagor.launch.py", "exec"), space)
    (actions,) = space["generate_launch_description"]().given
    arguments = {each.given[0] for each in actions if type(each).__name__ == "DeclareLaunchArgument"}
    (node,) = [each.named for each in actions if type(each).__name__ == "Node"]
    assert (node["package"], node["executable"], node["name"]) == ("eagor_ros", "node", "eagor")
    used = {"params_file", "query", "image_topic", "odom_topic", "perception", "namespace", "use_sim_time"}
    assert arguments == used
    from eagor_ros.node import DEFAULTS, SIM_TIME

    assert {name for name in node["parameters"][1]} <= {*DEFAULTS, SIM_TIME}


# --- the node, against a stub ---


def ros_class(kind):
    """A class as rclpy makes it of a message's definition: keyword arguments, and checks of the values."""

    def told(about):
        node, value = about
        if node.name == "NAME":
            return value.replace("/msg/", "/")
        if node.name == "BASE":
            return {"byte": "octet", "float64": "double", "float32": "float", "bool": "boolean"}.get(value[0], value[0])
        inner = told(value[0])
        return f"{inner}[{value[1]}]" if node.name == "ARRAY" else f"sequence<{inner}>"

    names = {name: told(about) for name, about in store().fielddefs[kind][1]}

    class Message:
        __msgtype__ = kind

        def __init__(self, **given):
            assert {*given} == {*names}, (kind, given)
            for name, value in given.items():
                about = names[name]
                if about == "octet":
                    assert isinstance(value, bytes), (kind, name, value)
                elif about.startswith("sequence"):
                    assert isinstance(value, array | list), (kind, name, type(value))
                elif "/" in about and "[" not in about:
                    assert type(value).__name__ == "Message", (kind, name, value)
                setattr(self, name, value)

        @classmethod
        def get_fields_and_field_types(cls):
            return names

    return Message


class Ros:
    """A stub of rclpy: it records publishers and subscriptions with their quality, and hands messages over."""

    def __init__(self, topics, parameters):
        self.kinds, self.topics, self.parameters = {}, topics, {"use_sim_time": False} | parameters
        self.published, self.subscribed, self.gone = {}, {}, []
        self.sent, self.said = [], []
        self.news = threading.Condition()
        self.spinning, self.down = threading.Event(), threading.Event()

    def get_message(self, kind):
        return self.kinds.setdefault(kind, ros_class(kind))

    def install(self, monkeypatch):
        ros = self

        class Quality:
            def __init__(self, **told):
                self.told = told

        class Publisher:
            def __init__(self, topic):
                self.topic = topic

            def publish(self, message):
                with ros.news:
                    ros.sent.append((self.topic, message))
                    ros.news.notify_all()

        class Node:
            def create_publisher(self, kind, topic, quality):
                ros.published[topic] = (kind.__msgtype__, quality.told)
                return Publisher(topic)

            def create_subscription(self, kind, topic, callback, quality):
                ros.subscribed[topic] = (kind.__msgtype__, quality.told, callback)
                return types.SimpleNamespace(topic_name=topic)

            def destroy_publisher(self, publisher):
                ros.gone.append(publisher.topic)

            def destroy_subscription(self, subscription):
                ros.subscribed.pop(subscription.topic_name, None)

            def destroy_node(self):
                ros.gone.append("node")

            def get_name(self):
                return "eagor"

            def get_namespace(self):
                return "/"

            def get_publisher_names_and_types_by_node(self, name, space):
                assert (name, space) == ("eagor", "/")
                return [(topic.replace("~", "/eagor"), [kind]) for topic, (kind, _) in ros.published.items()]

            def get_topic_names_and_types(self):
                own = {topic.replace("~", "/eagor"): [kind] for topic, (kind, _) in ros.published.items()}
                return [*({name: [kind] for name, kind in ros.topics.items()} | own).items()]

            def count_publishers(self, topic):
                return (topic in ros.topics) + (topic in {t.replace("~", "/eagor") for t in ros.published})

            def declare_parameter(self, name, default):
                assert name != "use_sim_time"  # rclpy raises: it is declared already
                ros.parameters.setdefault(name, default)

            def get_parameter(self, name):
                return types.SimpleNamespace(value=ros.parameters[name])

            def get_logger(self):
                return types.SimpleNamespace(warning=ros.said.append, error=ros.said.append)

        class Executor:
            def add_node(self, node):
                pass

            def spin(self):
                ros.spinning.set()
                ros.down.wait()

            def shutdown(self):
                ros.down.set()

        modules = {
            "rclpy": {
                "init": lambda args=None: None,
                "create_node": lambda name: Node(),
                "ok": lambda: True,
                "shutdown": lambda: ros.gone.append("rclpy"),
            },
            "rclpy.executors": {
                "SingleThreadedExecutor": Executor,
                "ExternalShutdownException": type("ExternalShutdownException", (Exception,), {}),
            },
            "rclpy.qos": {
                "QoSProfile": Quality,
                "DurabilityPolicy": types.SimpleNamespace(TRANSIENT_LOCAL="transient", VOLATILE="volatile"),
                "HistoryPolicy": types.SimpleNamespace(KEEP_LAST="last"),
                "ReliabilityPolicy": types.SimpleNamespace(RELIABLE="reliable", BEST_EFFORT="best effort"),
            },
            "rosidl_runtime_py": {},
            "rosidl_runtime_py.utilities": {"get_message": self.get_message},
        }
        for name, members in modules.items():
            module = types.ModuleType(name)
            for member, value in members.items():
                setattr(module, member, value)
            monkeypatch.setitem(sys.modules, name, module)

    def feed(self, topic, message):
        """Hand a message over, as rclpy does: in its own class, octets as an array."""
        from eagor_ros.graph import as_ros

        if topic in self.subscribed:
            self.subscribed[topic][2](as_ros(message))


def test_the_node_answers_what_rclpy_feeds_it(monkeypatch):
    from eagor_ros.node import main

    ros = Ros({"/image": m.IMAGE, "/odom": m.ODOMETRY}, {"queries": ["red ball", ""], "rate": 10.0})
    ros.install(monkeypatch)
    room, place, turn = Room(), np.array([-0.5, 0.2, 1.0]), world_R_body(0.4, 0, 0)
    panorama = paint(room, tuple(place), turn, 64, 128)
    ended = threading.Event()

    def speak():
        while not ended.wait(0.05):
            now = time.time()
            ros.feed("/odom", m.odometry_message(Pose(now, turn, place)))
            ros.feed("/image", m.image_message(panorama, now, "base_link"))

    speaking = threading.Thread(target=speak)
    speaking.start()
    codes = []
    running = threading.Thread(target=lambda: codes.append(main([])))
    running.start()
    truth = bearing(room.balls[0], place, turn)[0]

    def right():
        found = [message for topic, message in ros.sent if topic == "~/direction"][-3:]
        errors = [math.degrees(angular_distance(truth, np.array([e.vector.x, e.vector.y, e.vector.z]))) for e in found]
        return len(errors) == 3 and max(errors) < 3 and any(topic == "~/belief" for topic, _ in ros.sent)

    try:
        with ros.news:
            assert ros.news.wait_for(right, LONG), (codes, ros.said)
            assert ros.news.wait_for(lambda: any(topic == "/diagnostics" for topic, _ in ros.sent), LONG)
        subscribed = {topic: (kind, quality) for topic, (kind, quality, _) in ros.subscribed.items()}
        published = dict(ros.published)
    finally:
        ros.down.set()  # as Ctrl-C: rclpy shuts down, and the executor returns
        running.join(LONG)
        ended.set()
        speaking.join(LONG)
    assert codes == [0]
    keep = {"history": "last", "reliability": "reliable", "durability": "volatile", "depth": 10}
    assert published == {
        "~/direction": (m.VECTOR, keep),
        "~/direction_pose": (m.POSE, keep),
        "~/markers": (made.MARKERS, keep),
        "~/belief_image": (m.IMAGE, keep),
        "~/belief": (made.NUMBERS, keep),
        "/diagnostics": (made.DIAGNOSTICS, keep),
    }
    assert subscribed == {
        "/image": (m.IMAGE, keep | {"reliability": "best effort", "depth": 5}),
        "/odom": (m.ODOMETRY, keep | {"reliability": "best effort", "depth": 100}),
        "/tf": (m.TRANSFORMS, keep | {"reliability": "best effort", "depth": 100}),
        "/tf_static": (m.TRANSFORMS, keep | {"durability": "transient", "depth": 100}),
        "~/query": (m.TEXT, keep | {"durability": "transient"}),
    }
    assert {"node", "rclpy"} <= {*ros.gone}
    assert not ros.subscribed
    status = next(message for topic, message in ros.sent if topic == "/diagnostics").status
    assert {each.level for each in status} <= {b"\0", b"\1", b"\2"}


def test_wrong_parameters_are_said(monkeypatch):
    from eagor_ros.node import main

    ros = Ros({}, {"queries": ["red ball"], "poses": "walk"})
    ros.install(monkeypatch)
    assert main([]) == 2
    assert "NodeSettings: poses = 'walk'; wanted odom, auto, level or still" in ros.said[0]
    ros = Ros({}, {"queries": ["red ball"], "use_sim_time": True})
    ros.install(monkeypatch)
    monkeypatch.setattr("eagor.robots.ros.node.FIRST", 0.1)
    assert main([]) == 2
    assert "nothing came on /clock within 0.1 s" in ros.said[0]
    ros = Ros({"/odom": m.ODOMETRY}, {"queries": ["red ball"]})
    ros.install(monkeypatch)
    assert main([]) == 2
    assert "the ROS 2 graph has no topic of type sensor_msgs/msg/Image" in ros.said[0]
