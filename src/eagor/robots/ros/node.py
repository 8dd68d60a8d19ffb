"""The node of ROS 2: pictures, poses and queries in; directions, goals, markers, answers and diagnostics out.

It is a lifecycle node that configures and activates itself: a source and a sink of `eagor.Loop`, which runs in a thread
of its own, so it answers at a steady rate however slow the perception is. Topics and parameters: docs/how-to/ros2.md.
"""

from __future__ import annotations

import json
import math
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, count, pairwise
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PointStamped, Pose, PoseStamped, Quaternion, Vector3, Vector3Stamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rclpy.utilities import try_shutdown
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from eagor.conventions import xyzw_from_rotation
from eagor.errors import DeviceError, EagorError, FormatError, QueryError
from eagor.live.core import deviation
from eagor.live.events import Answer, Event, Fault, FaultLog, ImageReceived, PoseReceived
from eagor.live.loop import Loop
from eagor.robots.ros import PARAMETERS, SOURCES
from eagor.robots.ros.topics import RosCamera, RosPoses, TopicListener
from eagor.sources.ros_frames import optical
from eagor.sources.ros_messages import NANO
from eagor.sphere import azimuth_elevation, world_R_body
from eagor.tracking import TrackerConfig

__all__ = ["EagorNode", "apply_query_command", "run", "spaces"]

MOST = 16  # queries at a time
AGAIN, GRAVE = 2.0, 5.0  # seconds before sources are opened again; after which a fault is more than a warning
LASTING = Duration(nanoseconds=NANO // 2)  # of markers
# From the parameters and the queries: the perception, the tracker's configuration, and how `RosCamera` reads pictures.
Setup = Callable[[Mapping[str, Any], Sequence[str]], tuple[str, TrackerConfig, Mapping[str, Any]]]
TURNS = [math.tau * each / 24 for each in range(25)]  # about the axis of the cone


def apply_query_command(now: Sequence[str], text: str) -> list[str]:
    """The queries that are followed after a message.

    "red chair" replaces all by one; "red chair; blue ball" by two. "+blue ball" is followed as well, "-blue ball" no
    longer. An empty text ends them all. At most `MOST` are followed; further ones are left out.
    """
    parts = [part.strip() for part in re.split(r"[;\n]", text)]
    relative = text.strip() and all(part[:1] in ("+", "-") for part in parts if part)
    found = list(now) if relative else []
    for part in parts:
        word = part.lstrip("+-").strip()
        if part.startswith("-"):
            found = [each for each in found if each != word]
        elif re.search(r"\w", word) and word not in found:
            found.append(word)
    return found[:MOST]


def spaces(queries: Sequence[str]) -> list[str]:
    """Where the topics of each query are: "~" for the first, "~/blue_ball" for a further one; no two share one."""
    found = ["~"]
    for number, query in enumerate(queries[1:], 2):
        name = re.sub(r"[^a-z0-9]+", "_", query.lower()).strip("_")
        usable = [f"~/{name}"] if name[:1].isalpha() else []  # names of ROS begin with a letter
        numbered = (f"~/query_{each}" for each in count(number))
        found.append(next(each for each in chain(usable, numbered) if each not in found))
    return found


class EagorNode(LifecycleNode):
    """The node, and a sink of its loop. `setup` may raise `EagorError`."""

    def __init__(self, setup: Setup) -> None:
        super().__init__("eagor")
        for name, (value, words) in PARAMETERS.items():  # of any type: rate:=10 is a number as well
            self.declare_parameter(name, value, ParameterDescriptor(description=words, dynamic_typing=True))
        self.setup, self.queries, self.spec = setup, list[str](), None
        self.stopping, self.thread, self.loop, self.trouble, self.log = threading.Event(), None, None, "", FaultLog()
        self.answers, self.faults, self.outputs = list[dict[str, Any]](), list[Fault](), dict[str, Any]()
        self.latched: Any = None  # the subscription to what was asked before

    def values(self) -> dict[str, Any]:
        """The parameters, as they are now; numbers as floats."""
        found = {name: self.get_parameter(name).value for name in PARAMETERS}
        return {name: float(value) if type(value) is int else value for name, value in found.items()}

    # --- lifecycle ---

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        values = self.values()
        try:
            for name, wanted in (("pose_source", SOURCES), ("image_transport", ("raw", "compressed"))):
                if values[name] not in wanted:
                    raise FormatError(f"{name} is {values[name]!r}; wanted one of {', '.join(wanted)}")
            self.follow(values["queries"])
        except EagorError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self.base = values["base_frame"].lstrip("/")
        self.create_subscription(String, "~/query", self.asked, 10)
        self.add_on_set_parameters_callback(self.on_set)
        back = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self.jumps = self.get_clock().create_jump_callback(back, post_callback=lambda _: self.begin_anew())
        self.create_timer(1.0, self.diagnose)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        self.stopping.clear()
        self.listener = TopicListener(self, ended=self.stopping.is_set)
        self.thread = threading.Thread(target=self.serve, name="eagor", daemon=True)
        self.thread.start()
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        self.halt()
        return super().on_deactivate(state)

    def on_cleanup(self, state: Any) -> TransitionCallbackReturn:
        self.remove_on_set_parameters_callback(self.on_set)
        self.jumps.unregister()
        for each in [each for each in self.subscriptions if each.topic_name != "/clock"]:  # that is rclpy's own
            self.destroy_subscription(each)
        for each in [*self.timers]:
            self.destroy_timer(each)
        self.latched = None
        return TransitionCallbackReturn.SUCCESS

    def halt(self) -> None:
        """End the loop and its thread."""
        self.stopping.set()
        self.begin_anew()
        if self.thread is not None:
            self.thread.join()
            self.listener.close()

    def begin_anew(self) -> None:
        """End this run of the loop; the next one knows nothing of it."""
        if self.loop is not None:
            self.loop.stop()

    # --- queries ---

    def asked(self, message: String) -> None:
        """A message on ~/query."""
        queries = apply_query_command(self.queries, message.data) or [""]
        self.set_parameters([Parameter("queries", Parameter.Type.STRING_ARRAY, queries)])

    def ask_who_asked_before(self) -> None:
        """Hear latched publishers of ~/query, too, while there are any: others would warn of such a reader."""
        latched, name = DurabilityPolicy.TRANSIENT_LOCAL, self.resolve_topic_name("~/query")
        wanted = any(each.qos_profile.durability == latched for each in self.get_publishers_info_by_topic(name))
        if wanted and self.latched is None:
            qos = QoSProfile(depth=1, durability=latched)
            self.latched = self.create_subscription(String, name, self.asked, qos)
        elif not wanted and self.latched is not None:
            self.destroy_subscription(self.latched)
            self.latched = None

    def on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            for each in parameters:
                if each.name == "queries":
                    self.follow(each.value or "")
                elif each.name in PARAMETERS and self.thread is not None and self.thread.is_alive():
                    raise DeviceError(f"{each.name} is read when the node is activated: deactivate it first")
        except EagorError as error:
            self.get_logger().error(str(error))
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def follow(self, queries: str | Sequence[str]) -> None:
        """Look for these from now on."""
        queries = apply_query_command((), queries if isinstance(queries, str) else ";".join(queries))
        spec = self.setup(self.values(), queries) if queries else None
        same = spec is not None and self.spec is not None and spec[0] == self.spec[0]
        self.queries, self.spec, self.trouble, loop = queries, spec, "", self.loop
        if loop is not None:
            loop.follow(queries) if same else loop.stop()

    # --- the loop, in a thread of its own ---

    def serve(self) -> None:
        """Run loops, one after the other."""
        while not self.stopping.wait(0.1):
            try:
                if not self.listener.wait(self.listener.now):
                    self.say("nothing comes on /clock, and use_sim_time is set: start the simulation, or do not set it")
                elif self.spec is not None:
                    self.run_loop(self.values(), self.spec, self.queries)
            except QueryError as error:  # until somebody asks for something else
                self.say(str(error))
                self.spec = None
            except Exception as error:  # the node goes on, whatever happens
                if not self.stopping.is_set() and self.context.ok():
                    known = isinstance(error, EagorError | OSError)
                    self.say(f"{error if known else repr(error) + ' (a bug)'}; tried again")
                    self.stopping.wait(AGAIN)
            finally:
                self.loop, self.answers, self.faults = None, [], []

    def say(self, text: str) -> None:
        """What is wrong while no loop runs."""
        if text != self.trouble and not self.stopping.is_set():
            self.get_logger().error(text)
        self.trouble = text

    def run_loop(self, values: Mapping[str, Any], spec: tuple[Any, ...], queries: Sequence[str]) -> None:
        """Follow the queries until somebody stops it. Raises as `RosCamera` and `Loop`."""
        perception, config, lenses = spec
        transport = "/compressed" if values["image_transport"] == "compressed" else ""
        topics = ",".join(self.listener.resolved(each) + transport for each in values["image_topics"])
        source = SOURCES[values["pose_source"]]

        def camera() -> RosCamera:
            found = RosCamera(topics, listener=self.listener, latency=values["image_delay"], **lenses)
            self.place_camera(values, found.frame)
            return found

        def poses() -> RosPoses:
            frames = {"camera": self.named, "body": self.base, "world": values["world_frame"] or None}
            found = RosPoses(source[0], listener=self.listener, kinds=(source[1],), **frames)
            self.turning = found.reader.turning
            return found

        self.pose, self.picture, self.turning = None, 0.0, None
        self.loop = Loop(
            camera, poses if isinstance(source, tuple) else source, perception, queries, sinks=[self], config=config,
            rate=values["rate"], patience=values["patience"], extrapolate=False, clock=self.listener,
        )  # fmt: skip
        self.placed, self.trouble = self.listener.placed(self.base, self.frame), ""
        if self.queries != queries or self.stopping.is_set():
            self.loop.stop()
        for _ in self.loop:
            pass  # `take` has them all at once

    def place_camera(self, values: Mapping[str, Any], frame: str | None) -> None:
        """Name the camera's frame; a mount of the parameters is put among the transforms."""
        mounted = not np.isnan(values["mount_xyz"]).any()
        self.named = frame if frame is None else frame.lstrip("/") or ("camera" if mounted else "")  # as for its poses
        self.frame = self.named or self.base
        if mounted and self.frame != self.base:
            roll, pitch, yaw = np.radians(values["mount_rpy_deg"])
            turn = world_R_body(yaw, pitch, roll) @ optical(self.frame).T
            with self.listener.lock:
                self.listener.tree.fix(self.base, self.frame, (turn, np.array(values["mount_xyz"])))

    # --- answers ---

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """As a sink of the loop."""
        if isinstance(event, PoseReceived):
            self.pose = event.pose
        elif isinstance(event, ImageReceived):
            self.picture = event.stamp
        elif answers and self.listener.placed(self.base, self.frame) != self.placed:
            self.begin_anew()  # all before was told in other axes
        elif answers:
            self.publish_answers(answers)

    def close(self) -> None:
        """As a sink of the loop."""

    def publish_answers(self, answers: Sequence[Answer]) -> None:
        """All as of the newest pose, so that who has the transforms of the inputs has the one for them."""
        pose, stamp = self.pose, self.picture if self.pose is None else self.pose.stamp
        nanoseconds = self.listener.stamps.get(stamp, round(stamp * NANO)) or round(answers[0].stamp * NANO)
        turn, place = self.listener.mount(self.base, self.frame, stamp)
        spread = 0.0 if self.turning is None else deviation(self.turning.midway**2 / 2)
        header = Header(stamp=Time(nanoseconds=nanoseconds).to_msg(), frame_id=self.base)
        found, self.faults = [], self.wrong(answers[0].faults)
        for answer, space in zip(answers, spaces([each.query for each in answers]), strict=True):
            camera = answer.estimate.world_R_body if pose is None else pose.world_R_body
            estimate = answer.estimate.turned(answer.estimate.stamp, camera @ turn.T, spread)
            if (d := estimate.direction) is not None:
                self.publish(f"{space}/direction", Vector3Stamped, header=header, vector=partial(numbers, Vector3, d))
                self.publish(f"{space}/pose", PoseStamped, header=header, pose=partial(posed, place, d))
                if estimate.status == "tracking" and estimate.distance is not None:
                    there = partial(numbers, Point, place + estimate.distance * d)
                    self.publish(f"{space}/point", PointStamped, header=header, point=there)
                made = partial(markers, header, answer.query, estimate, place)
                self.publish("~/markers", MarkerArray, markers=made)
            found.append(
                replace(answer, estimate=estimate).as_dict()
                | {"stamp": nanoseconds / NANO, "stamp_ns": nanoseconds, "frame": self.base}
                | {"faults": [fault.text for fault in self.faults]}
            )
        self.answers = found
        self.publish("~/answers", String, data=lambda: json.dumps(found))
        for text, wrong in self.log.of(self.faults, time.monotonic()):
            if wrong:  # rclpy knows a call by its line, whose severity must stay
                self.get_logger().warning(text)
            else:
                self.get_logger().info(text)

    def wrong(self, faults: Sequence[Fault]) -> list[Fault]:
        """What is wrong: with the loop, and with where the camera is."""
        if self.placed:
            return [*faults]
        needs = "" if self.listener.has_transforms else ", for which tf2_msgs is missing"
        text = (
            f"nothing tells where {self.frame} is on {self.base}, so it is taken to look ahead along it: publish "
            f"/tf_static{needs}, or set mount_xyz"
        )
        return [*faults, Fault("poses", text, self.listener.now())]

    def publish(self, topic: str, kind: Any, **fields: Any) -> None:
        """A message of a `kind`, if anybody listens; only then is called what makes a field."""
        if topic not in self.outputs:
            self.outputs[topic] = self.create_publisher(kind, topic, 10)
        if self.outputs[topic].get_subscription_count():
            made = {name: value() if callable(value) else value for name, value in fields.items()}
            self.outputs[topic].publish(kind(**made))

    def diagnose(self) -> None:
        """Once a second: a status of the node, and one of each query."""
        self.ask_who_asked_before()
        loop, faults, now, level = self.loop, self.faults, self.get_clock().now(), DiagnosticStatus
        waits = "starting" if self.queries else "waiting for a query on ~/query (std_msgs/String), or in queries"
        healthy = "all is well" if self.answers else waits
        words = self.trouble or "; ".join(fault.text for fault in faults) or healthy
        lasting = any(now.nanoseconds / NANO - fault.since > GRAVE for fault in faults)
        grade = level.ERROR if self.trouble or lasting else level.WARN if faults else level.OK
        counts = [KeyValue(key=key, value=str(value)) for key, value in vars(loop.counts).items()] if loop else []
        found = [DiagnosticStatus(name="eagor", message=words, level=grade, hardware_id="eagor", values=counts)]
        for each in self.answers:
            where = "" if each["direction"] is None else f", {each['azimuth_deg']:.0f} degrees to the left"
            where += f" (looked for {each['looked_for']})" if "looked_for" in each else ""
            found.append(DiagnosticStatus(name=f"eagor: {each['query']}", message=f"{each['status']}{where}"))
        self.publish("/diagnostics", DiagnosticArray, header=Header(stamp=now.to_msg()), status=found)


def markers(header: Header, query: str, estimate: Any, place: np.ndarray) -> list[Marker]:
    """An arrow, the cone that holds 90 % of the belief, and words, from the camera's `place`."""
    d, toward = estimate.direction, posed(place, estimate.direction)

    def marker(number: int, kind: int, alpha: float, pose: Pose, **more: Any) -> Marker:
        colour, lifetime = ColorRGBA(r=0.9, g=0.1, b=0.1, a=alpha), LASTING.to_msg()
        return Marker(header=header, ns=query, id=number, type=kind, lifetime=lifetime, color=colour, pose=pose, **more)

    ahead, beside = math.cos(estimate.credible_angle), math.sin(estimate.credible_angle)
    rim = [Point(x=ahead, y=beside * math.cos(turn), z=beside * math.sin(turn)) for turn in TURNS]
    cone = [each for a, b in pairwise(rim) for each in (Point(), a, b)]
    words, beyond = f"{query}: {estimate.status}", Pose(position=numbers(Point, place + 1.1 * d))
    return [
        marker(0, Marker.ARROW, 1.0, toward, scale=Vector3(x=1.0, y=0.03, z=0.06)),
        marker(1, Marker.TRIANGLE_LIST, 0.25, toward, scale=Vector3(x=1.0, y=1.0, z=1.0), points=cone),
        marker(2, Marker.TEXT_VIEW_FACING, 1.0, beyond, scale=Vector3(z=0.1), text=words),
    ]


def numbers(kind: Any, values: Any) -> Any:
    """A Vector3 or Point."""
    return kind(**dict(zip("xyz", map(float, values), strict=True)))


def posed(place: np.ndarray, d: np.ndarray) -> Pose:
    """At a place; the x axis is `d`, and y level."""
    azimuth, elevation = azimuth_elevation(d)
    turn = world_R_body(float(azimuth), -float(elevation))  # pitch is positive with the nose down
    turned = Quaternion(**dict(zip("xyzw", map(float, xyzw_from_rotation(turn)), strict=True)))
    return Pose(position=numbers(Point, place), orientation=turned)


def run(setup: Setup, args: Sequence[str]) -> bool:
    """Run the node until it is shut down, with `args` such as ``--ros-args -p rate:=10``; whether it could be set up.

    Raises `DeviceError` for arguments that ROS refuses.
    """
    try:
        rclpy.init(args=["eagor", *args])
        node = EagorNode(setup)
    except Exception as error:  # rclpy has no common class for what it refuses
        try_shutdown()
        raise DeviceError(f"{' '.join(args)}: {error}") from error
    try:
        if node.values()["autostart"]:
            if node.trigger_configure() != TransitionCallbackReturn.SUCCESS:
                return False
            node.trigger_activate()
        rclpy.spin(node)
    except (ExternalShutdownException, RuntimeError):  # rclpy may be in the midst of waiting when it is shut down
        if node.context.ok():
            raise
    finally:
        node.halt()
        node.destroy_node()
        try_shutdown()
    return True
