"""The node of ROS 2: pictures, poses and queries in; directions, goals, markers, answers and diagnostics out.

It is a lifecycle node that configures and activates itself, and runs the live loop (`eagor.live`) in a thread of its
own, so it answers at a steady rate however slow the perception is. Topics and parameters: docs/how-to/ros2.md.
"""

from __future__ import annotations

import json
import math
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, count, pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    PointStamped,
    Pose,
    PoseStamped,
    Quaternion,
    TransformStamped,
    Vector3,
    Vector3Stamped,
)
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rclpy.utilities import ok, try_shutdown
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from eagor.conventions import xyzw_from_rotation
from eagor.errors import DeviceError, EagorError, FormatError, QueryError
from eagor.live.core import deviation
from eagor.live.events import Answer, Event, Fault, FaultLog, ImageReceived, PoseReceived
from eagor.live.loop import Loop
from eagor.live.threads import already_open
from eagor.media.ros_frames import optical
from eagor.media.ros_messages import NANO
from eagor.robots.ros import PARAMETERS, SOURCES, Setup
from eagor.robots.ros.topics import Ears, RosCamera, RosPoses
from eagor.sphere import azimuth_elevation, world_R_body

__all__ = ["EagorNode", "queries_after", "run", "spaces"]

MOST = 16  # queries at a time
AGAIN, FIRST_TIME = 2.0, 10.0  # seconds before sources are opened again; in which a simulation has to tell the time
GRAVE = 5.0  # seconds after which a fault is an error rather than a warning
LASTING = Duration(nanoseconds=NANO // 2)  # of markers
TURNS = [math.tau * each / 24 for each in range(25)]  # about the axis of the cone


def queries_after(now: Sequence[str], text: str) -> list[str]:
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
    """The node, and a sink of its loop.

    `setup`: from the values of the parameters, and the queries; it may raise `EagorError`.
    """

    def __init__(self, setup: Callable[[Mapping[str, Any], Sequence[str]], Setup]) -> None:
        super().__init__("eagor")
        for name, (value, words) in PARAMETERS.items():  # of any type: rate:=10 is a number as well
            self.declare_parameter(name, value, ParameterDescriptor(description=words, dynamic_typing=True))
        self.setup, self.queries, self.spec = setup, list[str](), None
        self.stopping, self.thread, self.loop, self.trouble, self.log = threading.Event(), None, None, "", FaultLog()
        self.tick, self.told = dict[str, dict[str, Any]](), list[dict[str, Any]]()  # answers, being made and made
        self.outputs, self.askers, self.before = dict[str, Any](), set[bytes](), None
        self.faults: Sequence[Fault] = ()

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
        self.ears = Ears(self, ended=self.stopping.is_set)
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
        return TransitionCallbackReturn.SUCCESS

    def halt(self) -> None:
        """End the loop and its thread."""
        self.stopping.set()
        self.begin_anew()
        if self.thread is not None:
            self.thread.join()
            self.ears.close()

    def begin_anew(self) -> None:
        """End this run of the loop; the next one knows nothing of it."""
        if self.loop is not None:
            self.loop.stop()

    # --- queries ---

    def asked(self, message: String) -> None:
        """A message on ~/query."""
        queries = queries_after(self.queries, message.data) or [""]
        self.set_parameters([Parameter("queries", Parameter.Type.STRING_ARRAY, queries)])

    def ask_who_asked_before(self) -> None:
        """Hear once what new latched publishers of ~/query have said; who keeps nothing would warn of such a reader."""
        if self.before is not None:
            self.destroy_subscription(self.before)
            self.before = None
        latched = DurabilityPolicy.TRANSIENT_LOCAL
        publishers = self.get_publishers_info_by_topic(self.resolve_topic_name("~/query"))
        now = {bytes(each.endpoint_gid) for each in publishers if each.qos_profile.durability == latched}
        if now - self.askers:
            self.before = self.create_subscription(
                String, "~/query", self.asked, QoSProfile(depth=1, durability=latched)
            )
        self.askers = now

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
        queries = queries_after((), queries if isinstance(queries, str) else ";".join(queries))
        spec = self.setup(self.values(), queries) if queries else None
        same = spec is not None and self.spec is not None and spec.perception == self.spec.perception
        self.queries, self.spec, self.trouble, loop = queries, spec, "", self.loop
        if loop is not None:
            loop.follow(queries) if same else loop.stop()

    # --- the loop, in a thread of its own ---

    def serve(self) -> None:
        """Run loops, one after the other."""
        begun = time.monotonic()
        while not self.stopping.wait(0.1):
            if self.get_clock().now().nanoseconds == 0:
                if time.monotonic() - begun > FIRST_TIME:
                    self.say("nothing comes on /clock, and use_sim_time is set: start the simulation, or do not set it")
                continue
            try:
                if self.spec is not None:
                    self.run_loop(self.values(), self.spec, self.queries)
            except QueryError as error:  # until somebody asks for something else
                self.say(str(error))
                self.spec = None
            except Exception as error:  # the node goes on, whatever happens
                if not self.stopping.is_set():
                    known = isinstance(error, EagorError | OSError)
                    self.say(f"{error if known else repr(error) + ' (a bug)'}; tried again")
                    self.stopping.wait(AGAIN)
            finally:
                self.loop = None

    def say(self, text: str) -> None:
        """What is wrong while no loop runs."""
        if text != self.trouble:
            self.get_logger().error(text)
        self.trouble = text

    def run_loop(self, values: Mapping[str, Any], spec: Setup, queries: Sequence[str]) -> None:
        """Follow the queries until somebody stops it. Raises as `RosCamera` and `Loop`."""
        transport = "/compressed" if values["image_transport"] == "compressed" else ""
        topics = ",".join(self.ears.resolved(each) + transport for each in values["image_topics"])

        def camera() -> RosCamera:
            return RosCamera(topics, ears=self.ears, latency=values["image_delay"], **spec.camera)

        def poses() -> RosPoses:
            world = values["world_frame"] or None
            how = {"kinds": (source[1],), "camera": named, "body": self.base, "world": world}
            found = RosPoses(source[0], ears=self.ears, **how)
            self.reader = found.reader
            return found

        first, source = camera(), SOURCES[values["pose_source"]]
        try:
            self.pose, self.picture, self.reader = None, 0.0, None
            named = self.place_camera(values, first.frame)
            self.placed = self.ears.placed(self.base, self.frame)
            self.loop = Loop(
                already_open(first, camera), poses if isinstance(source, tuple) else source, spec.perception, queries,
                sinks=[self], config=spec.config, rate=values["rate"], patience=values["patience"],
                extrapolate=False, clock=self.ears,
            )  # fmt: skip
        except BaseException:
            first.close()
            raise
        self.trouble = ""
        if self.queries != queries or self.stopping.is_set():
            self.loop.stop()
        self.loop.run(self.answered)

    def place_camera(self, values: Mapping[str, Any], frame: str | None) -> str | None:
        """The camera's frame as its poses are to have it; the mount of the parameters is put among the transforms."""
        mounted = not np.isnan(values["mount_xyz"]).any()
        named = frame if frame is None else frame.lstrip("/") or ("camera" if mounted else "")
        self.frame = named or self.base
        if mounted:
            roll, pitch, yaw = np.radians(values["mount_rpy_deg"])
            told = TransformStamped(header=Header(frame_id=self.base), child_frame_id=self.frame)
            told.transform.translation = numbers(Vector3, values["mount_xyz"])
            told.transform.rotation = quaternion(world_R_body(yaw, pitch, roll) @ optical(self.frame).T)
            with self.ears.lock:
                self.ears.tree.add(SimpleNamespace(transforms=[told]), True)
        return named

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """As a sink of the loop."""
        if isinstance(event, PoseReceived):
            self.pose = event.pose
        elif isinstance(event, ImageReceived):
            self.picture = event.stamp

    def close(self) -> None:
        """As a sink of the loop."""

    # --- answers ---

    def answered(self, answer: Answer) -> None:
        """Publish it as of the newest pose, so that who has the transforms of the inputs has the one for it."""
        assert self.loop is not None
        queries, pose, estimate = list(self.loop.core.queries), self.pose, answer.estimate
        stamp = self.picture if pose is None else pose.stamp
        nanoseconds = self.ears.stamps.get(stamp, round(stamp * NANO)) or round(answer.stamp * NANO)
        if self.ears.placed(self.base, self.frame) != self.placed:  # all before was told in other axes
            self.begin_anew()
            return
        turn, place = self.ears.mount(self.base, self.frame, stamp)
        camera = estimate.world_R_body if pose is None else pose.world_R_body
        between = 0.0 if self.reader is None else self.reader.turning.midway
        estimate = estimate.turned(estimate.stamp, camera @ turn.T, deviation(between**2 / 2))
        header, d = Header(stamp=Time(nanoseconds=nanoseconds).to_msg(), frame_id=self.base), estimate.direction
        if d is not None:
            space = spaces(queries)[queries.index(answer.query)]
            self.publish(f"{space}/direction", Vector3Stamped, header=header, vector=numbers(Vector3, d))
            self.publish(f"{space}/pose", PoseStamped, header=header, pose=lambda: posed(place, d))
            if estimate.status == "tracking" and estimate.distance is not None:
                there = numbers(Point, place + estimate.distance * d)
                self.publish(f"{space}/point", PointStamped, header=header, point=there)
            self.publish("~/markers", MarkerArray, markers=lambda: markers(header, answer.query, estimate, place))
        self.tick[answer.query] = replace(answer, estimate=estimate).as_dict() | {
            "stamp": nanoseconds / NANO, "stamp_ns": nanoseconds, "frame": self.base,
            "faults": [fault.text for fault in answer.faults],
        }  # fmt: skip
        if answer.query == queries[-1]:
            self.told, self.tick, self.faults = [*self.tick.values()], {}, answer.faults
            self.publish("~/answers", String, data=lambda: json.dumps(self.told))
            for text, wrong in self.log.of(self.wrong(), time.monotonic()):
                if wrong:  # rclpy knows a call by its line, whose severity must stay
                    self.get_logger().warning(text)
                else:
                    self.get_logger().info(text)

    def wrong(self) -> list[Fault]:
        """What is wrong now."""
        problem = None if self.reader is None else self.reader.problem
        if not self.placed:
            needs = "" if self.ears.has_transforms else ", for which tf2_msgs is missing"
            problem = (
                f"nothing tells where {self.frame} is on {self.base}, so it is taken to look ahead along it: publish "
                f"/tf_static{needs}, or set mount_xyz"
            )
        return [*self.faults, *([] if problem is None else [Fault("poses", problem, self.ears.now())])]

    def publish(self, topic: str, kind: Any, **fields: Any) -> None:
        """A message of a `kind`, if anybody listens; only then is called what makes a field."""
        try:
            if topic not in self.outputs:
                self.outputs[topic] = self.create_publisher(kind, topic, 10)
            if self.outputs[topic].get_subscription_count():
                made = {name: value() if callable(value) else value for name, value in fields.items()}
                self.outputs[topic].publish(kind(**made))
        except Exception:  # the context may end at any time
            if self.context.ok():
                raise

    def diagnose(self) -> None:
        """Once a second: a status of the node, and one of each query."""
        self.ask_who_asked_before()
        loop, now, level = self.loop, self.get_clock().now(), DiagnosticStatus
        faults, told = (self.wrong(), self.told) if loop is not None else ([], [])
        waits = "starting" if self.queries else "waiting for a query on ~/query (std_msgs/String), or in queries"
        words = self.trouble or "; ".join(fault.text for fault in faults) or ("all is well" if told else waits)
        lasting = any(now.nanoseconds / NANO - fault.since > GRAVE for fault in faults)
        grade = level.ERROR if self.trouble or lasting else level.WARN if faults else level.OK
        counts = [KeyValue(key=key, value=str(value)) for key, value in vars(loop.counts).items()] if loop else []
        found = [DiagnosticStatus(name="eagor", message=words, level=grade, hardware_id="eagor", values=counts)]
        for each in told:
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
    tip, words, beyond = Point(), f"{query}: {estimate.status}", Pose(position=numbers(Point, place + 1.1 * d))
    return [
        marker(0, Marker.ARROW, 1.0, toward, scale=Vector3(x=1.0, y=0.03, z=0.06)),
        marker(
            1, Marker.TRIANGLE_LIST, 0.25, toward, scale=Vector3(x=1.0, y=1.0, z=1.0),
            points=[each for a, b in pairwise(rim) for each in (tip, a, b)],
        ),
        marker(2, Marker.TEXT_VIEW_FACING, 1.0, beyond, scale=Vector3(z=0.1), text=words),
    ]  # fmt: skip


def numbers(kind: Any, values: Any) -> Any:
    """A Vector3 or Point."""
    return kind(**dict(zip("xyz", map(float, values), strict=True)))


def quaternion(turn: np.ndarray) -> Quaternion:
    return Quaternion(**dict(zip("xyzw", map(float, xyzw_from_rotation(turn)), strict=True)))


def posed(place: np.ndarray, d: np.ndarray) -> Pose:
    """At a place; the x axis is `d`, and y level."""
    azimuth, elevation = azimuth_elevation(d)
    turn = world_R_body(float(azimuth), -float(elevation))  # pitch is positive with the nose down
    return Pose(position=numbers(Point, place), orientation=quaternion(turn))


def run(setup: Callable[[Mapping[str, Any], Sequence[str]], Setup], args: Sequence[str]) -> bool:
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
        if ok():
            raise
    finally:
        node.halt()
        node.destroy_node()
        try_shutdown()
    return True
