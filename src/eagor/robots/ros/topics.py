"""Cameras and poses on topics of ROS 2, through `rclpy`: what the node reads, and ``ros:/topic`` elsewhere.

A topic is read with the quality of service that its publishers offer: a reliable reader hears nobody who is not, and a
best-effort one loses large pictures.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from queue import SimpleQueue
from typing import Any
from uuid import uuid4

import numpy as np
import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

from eagor.errors import DeviceError, EagorError
from eagor.live.threads import LoopClock
from eagor.sources import Frame, Pose
from eagor.sources.bags import MOTION, PICTURES, TF, TF_STATIC
from eagor.sources.ros_frames import BACK, BODY, IDENTITY, PoseReader, Transform, TransformTree, optical
from eagor.sources.ros_messages import CAMERA_INFO, NANO, TRANSFORMS, seconds, store
from eagor.sources.ros_sources import ImageTopics, Info, beside, lens_of_info, placed, topics_of

__all__ = ["RosCamera", "RosPoses", "TopicListener"]

FIRST = 10.0  # seconds in which a publisher, and the first message, have to come
SETTLING = 2.0  # seconds in which a CameraInfo, or a transform that was told before, has to come
BREATH = 0.1  # seconds after which somebody looks whether there is more to hear, or an end
KEPT = 20_000  # stamps that are known to the nanosecond


class TopicListener(LoopClock):
    """What an rclpy `node` hears in a thread of its own; with the transforms of /tf where tf2_msgs is installed.

    Without a node it makes one, where the environment says (ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE). `ended`:
    whether nobody waits any more. `stamps`: those of messages in whole nanoseconds, by seconds. `lock` is held while a
    message is taken in.
    """

    def __init__(self, node: Node | None = None, ended: Callable[[], bool] = lambda: False) -> None:
        self._own = node is None
        if node is None:
            context = Context()
            rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
            node = Node(f"eagor_{uuid4().hex}", context=context, start_parameter_services=False)
        self.node, self.ended, self._closed = node, ended, False
        self._subscriptions: tuple[Any, ...] = ()
        self._group = MutuallyExclusiveCallbackGroup()
        self._group.add_entity(self)
        self._group.beginning_execution(self)  # for ever, so that executors leave the subscriptions of the group alone
        self.stamps, self.tree, self.lock = dict[float, int](), TransformTree(), threading.RLock()
        self.taker: Callable[[Any, bool], Any] = self.tree.add  # of transforms: poses are, while they are read
        self.has_transforms = find_spec("tf2_msgs") is not None  # no wheel has it
        for topic, fixed in ((TF_STATIC, True), (TF, False)) if self.has_transforms else ():
            durability = DurabilityPolicy.TRANSIENT_LOCAL if fixed else DurabilityPolicy.VOLATILE
            qos = QoSProfile(depth=100, durability=durability)
            self.subscribe(TRANSFORMS, topic, lambda message, fixed=fixed: self.taker(message, fixed), qos)
        self._thread = threading.Thread(target=self._hear, name="eagor listener", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Hear nothing more; leave the graph, if the node is its own."""
        self._closed = True
        self._thread.join()
        for each in self._subscriptions:
            self.unsubscribe(each)
        if self._own:
            self.node.destroy_node()
            self.node.context.try_shutdown()

    def resolved(self, topic: str) -> str:
        """The full name of a topic, after remapping. Raises `DeviceError` for what is no name."""
        try:
            return self.node.resolve_topic_name(topic)
        except NameValidationException as error:
            raise DeviceError(f"{topic!r} is no name of a topic: {error}") from error

    def subscribe(self, kind: str, topic: str, heard: Callable[[Any], Any], qos: QoSProfile) -> Any:
        """Call `heard` with each message of a `kind` such as "sensor_msgs/msg/Image", while `lock` is held."""
        package, _, name = kind.partition("/msg/")
        how = {"callback_group": self._group, "raw": find_spec("rosbags") is not None}  # it is quicker than rclpy
        take = (lambda data: heard(store().deserialize_cdr(data, kind))) if how["raw"] else heard
        found = self.node.create_subscription(getattr(import_module(f"{package}.msg"), name), topic, take, qos, **how)
        with self.lock:
            self._subscriptions += (found,)
        return found

    def unsubscribe(self, subscription: Any) -> None:
        """Hear no more of it."""
        with self.lock:
            self._subscriptions = tuple(each for each in self._subscriptions if each is not subscription)
        self.node.destroy_subscription(subscription)

    def _hear(self) -> None:
        """Take messages as they come, in the way of `rclpy.wait_for_message`; executors take four times as long."""
        context = self.node.context
        while not self._closed:
            heard = self._subscriptions
            try:
                with ExitStack() as held:  # what is held is not destroyed
                    for handle in [context.handle, *(each.handle for each in heard)]:
                        held.enter_context(handle)
                    waiting = rclpy_implementation.WaitSet(len(heard), 0, 0, 0, 0, 0, context.handle)
                    while heard and heard == self._subscriptions and not self._closed:
                        waiting.clear_entities()
                        for each in heard:
                            waiting.add_subscription(each.handle)
                        waiting.wait(round(BREATH * NANO))
                        for each in heard:
                            self._take(each)
            except RuntimeError:  # as rclpy has it if one of them, or the context, has just ended
                if context.ok() and heard == self._subscriptions:
                    raise
            time.sleep(BREATH)

    def _take(self, subscription: Any) -> None:
        """Take what has come."""
        while (found := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            try:
                with self.lock:
                    subscription.callback(found[0])
            except Exception as error:  # one message is no reason to hear no more
                text = f"{subscription.topic_name}: a message is left out: {error!r}"
                self.node.get_logger().error(text, throttle_duration_sec=10.0)

    def offered(self, topic: str, kinds: Collection[str]) -> tuple[str, QoSProfile]:
        """The type of a `topic`, one of `kinds`, and how to read it. Raises `DeviceError` if nobody publishes it."""
        publishers = self.wait(lambda: self.node.get_publishers_info_by_topic(topic))
        if not publishers:
            domain = f"ROS_DOMAIN_ID {self.node.context.get_domain_id()}"
            raise DeviceError(f"nobody publishes {topic} ({domain}): start its node, or remap the topic")
        if (found := publishers[0].topic_type) not in kinds:
            raise DeviceError(f"{topic} has a type {found}; wanted {' or '.join(kinds)}")
        profiles = [each.qos_profile for each in publishers]  # what all of them offer: in these enumerations, the last
        return found, QoSProfile(
            depth=10 if found in PICTURES else 100,
            reliability=max(each.reliability for each in profiles),
            durability=max(each.durability for each in profiles),
        )

    def wait(self, what: Callable[[], Any], most: float = FIRST) -> Any:
        """What it gives as soon as that is true, or after `most` seconds of real time."""
        end = time.monotonic() + most
        while not (found := what()) and not self.ended() and time.monotonic() < end:
            time.sleep(0.02)
        return found

    def now(self) -> float:
        """The node's time, which is that of a simulation with ``use_sim_time``."""
        return self.node.get_clock().now().nanoseconds / NANO

    def remember(self, stamp: float, time: Any, later: float = 0.0) -> None:
        """The seconds `stamp` are those of a message's Time, less `later`: seconds alone are off by up to 120 ns."""
        self.stamps[stamp] = time.sec * NANO + time.nanosec - round(later * NANO)
        while len(self.stamps) > KEPT:
            del self.stamps[next(iter(self.stamps))]

    def placed(self, body: str, camera: str) -> bool:
        """Whether anything tells where the camera is on the body."""
        with self.lock:
            return camera == body or self.tree.between(body, camera) is not None

    def mount(self, body: str, camera: str, stamp: float) -> Transform:
        """Where the camera's axes (x ahead) are on the body; those of the body if nothing tells."""
        with self.lock:
            found = None if camera == body else self.tree.at(body, camera, stamp)
        return IDENTITY if found is None else (found[0] @ optical(camera), found[1])


class TopicSource:
    """What reads topics: through a `listener` that is given, or its own. `_open` may raise."""

    live = True

    def __init__(self, listener: TopicListener | None) -> None:
        self._listener, self._own = listener or TopicListener(), listener is None
        self._closed, self._readers = False, list[Any]()
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        raise NotImplementedError

    def close(self) -> None:
        self._closed = True
        while self._readers:
            self._listener.unsubscribe(self._readers.pop())
        if self._own:
            self._own = False
            self._listener.close()

    def _read(self, topic: str, kinds: Collection[str], heard: Callable[[Any], Any]) -> None:
        """Read a topic as its publishers offer it. Raises `DeviceError` as `TopicListener.offered`."""
        kind, qos = self._listener.offered(topic, kinds)
        self._readers.append(self._listener.subscribe(kind, topic, heard, qos))


class RosCamera(TopicSource):
    """A `CameraSource`: a topic of Image or CompressedImage, or several with commas between, of cameras of one body.

    The CameraInfo beside the pictures tells the lens of those that are no panoramas, and ``/tf_static`` where several
    cameras are; or a `rig` does (`lenses`: as `ImageTopics` has it). `latency`: seconds from capture to the stamps.
    `listener`: of a node that runs; `rate`: the most pictures a second. The newest picture is kept, and decoded when it
    is asked for; `dropped` counts the others, and those that were damaged. `frame`: as the pictures name it. Raises
    `DeviceError` if nobody publishes, or no picture comes; otherwise as `ImageTopics`.
    """

    keeps_newest = True

    def __init__(
        self,
        topic: str | None,
        *,
        listener: TopicListener | None = None,
        latency: float = 0.0,
        rate: float | None = None,
        **lenses: Any,
    ) -> None:
        self.latency, self.dropped, self.problem = latency, 0, None
        self._apart = 0.99 / rate if rate else 0.0  # seconds between two pictures, a little less for rounding
        self._named, self._lenses = topics_of(topic or None, "topics"), lenses
        self._newest: list[Any] = [None for _ in self._named]
        self._fresh, self._last = threading.Event(), -math.inf  # of the first topic: the newest of others go with it
        super().__init__(listener)

    def _open(self) -> None:
        self.topics = tuple(self._listener.resolved(each or "image") for each in self._named)
        for at, name in enumerate(self.topics):
            self._read(name, PICTURES, partial(self._received, at))
        if not self._listener.wait(lambda: None not in self._newest):
            silent = self.topics[self._newest.index(None)]
            raise DeviceError(f"no picture came on {silent} within {FIRST:g} s; is the camera running?")
        self._pictures = ImageTopics(self._newest, self.topics, self._camera_info, self._turns, **self._lenses)
        self.frame, builder = self._pictures.frame, self._pictures.builder
        self.grid, self.unseen = builder.grid, builder.unseen

    def close(self) -> None:
        super().close()
        self._fresh.set()

    def __iter__(self) -> Iterator[Frame]:
        while self._fresh.wait() and not self._closed:
            with self._listener.lock:
                messages, _ = self._newest[:], self._fresh.clear()
            try:
                frame = self._frame(messages)
            except EagorError as error:
                frame, self.problem = None, f"{self.topics[0]}: a picture is left out: {error}"
            if frame is None:
                self.dropped += 1
            else:
                yield frame

    def _frame(self, messages: list[Any]) -> Frame | None:
        """The next frame; None if it was sent twice, or comes too soon or out of order. Raises as `ImageTopics`."""
        topic, time, last = self.topics[0], messages[0].header.stamp, self._last
        stamp = (seconds(time) or self._listener.now()) - self.latency
        if last - BACK <= stamp <= last or 0 < stamp - last < self._apart:
            return None
        picture = self._pictures.made(messages, ": another camera or mode? Set it back, or start again")
        self._last, self.problem = stamp, None
        if seconds(time):
            self._listener.remember(stamp, time, self.latency)
        else:
            self.problem = f"{topic} tells no times (its headers have the stamp 0): those of arrival are taken"
        return Frame(stamp, picture, f"{topic} at {stamp:.3f} s", self._pictures.builder.view)

    def _received(self, at: int, message: Any) -> None:
        self._newest[at] = message
        if at == 0:
            self.dropped += self._fresh.is_set()
            self._fresh.set()

    def _camera_info(self, topic: str, asked: str | None) -> Info | None:
        """What the CameraInfo says; None if nobody publishes it."""
        name, found = self._listener.resolved(asked or beside(topic)), list[Any]()
        if not self._listener.wait(lambda: self._listener.node.count_publishers(name), SETTLING):
            return None
        self._read(name, (CAMERA_INFO,), found.append)
        if not self._listener.wait(lambda: found):
            raise DeviceError(f"no CameraInfo came on {name} within {FIRST:g} s; drivers send one with each picture")
        self._listener.unsubscribe(self._readers.pop())
        return lens_of_info(found[0], name, topic)

    def _turns(self, frames: Sequence[str]) -> list[np.ndarray]:
        """The rotations of cameras in the axes of the first."""
        self._listener.wait(lambda: all(self._listener.placed(frames[0], each) for each in frames), SETTLING)
        with self._listener.lock:
            return placed(self._listener.tree, frames)


class RosPoses(TopicSource):
    """A `PoseSource`: the camera's poses from Odometry, poses, an Imu's orientation, or ``/tf`` (`PoseReader`).

    `camera`: its frame; transforms tell where it is on the body. Where they do not, the axes of the messages are taken
    for the camera's, and `problem` says so, as it does of several publishers. `body`, `world`: as for `PoseReader`.
    Otherwise as `RosCamera`. Raises `DeviceError` if nobody publishes the topic, or if no pose comes.
    """

    def __init__(
        self,
        topic: str | None,
        *,
        listener: TopicListener | None = None,
        kinds: Collection[str] = MOTION,
        camera: str | None = None,
        body: str = BODY,
        world: str | None = None,
    ) -> None:
        self._poses = SimpleQueue[Pose | EagorError | None]()
        self._named, self._kinds, self._frames = topic, kinds, {"camera": camera, "body": body, "world": world}
        super().__init__(listener)

    def _open(self) -> None:
        listener, camera = self._listener, self._frames["camera"]
        self.topic = listener.resolved(self._named or "odom")
        self.kind, _ = listener.offered(self.topic, self._kinds)
        of_tree = self.kind == TRANSFORMS
        if of_tree and not listener.has_transforms:
            raise DeviceError(f"{self.topic} needs tf2_msgs, which no wheel has: source a ROS installation")
        self.reader = PoseReader(self.topic, self.kind, **self._frames, strict=of_tree, rewinds=True)
        self.reader.tree = listener.tree
        if camera and listener.has_transforms:  # poses before those of the camera would be the body's
            listener.wait(lambda: listener.placed(self.reader.body, camera), SETTLING)
        listener.taker = self._moved
        if not of_tree:
            self._read(self.topic, (self.kind,), self._received)
        if not listener.wait(lambda: not self._poses.empty()) and not listener.ended():
            why = self.problem or "are its stamps set, and does it run?"
            raise DeviceError(f"no pose came on {self.topic} within {FIRST:g} s: {why}")

    @property
    def problem(self) -> str | None:
        """What is wrong now, in words, or None."""
        writers = 1 if self.kind == TRANSFORMS else self._listener.node.count_publishers(self.topic)
        if writers > 1:  # one that died without a word is counted for some seconds more
            return f"{writers} publishers write {self.topic}: stop all but one, or remap it"
        with self._listener.lock:
            return self.reader.problem

    def __iter__(self) -> Iterator[Pose]:
        while (item := self._poses.get()) is not None:
            if isinstance(item, EagorError):
                raise item
            yield item

    def close(self) -> None:
        self._listener.taker = self._listener.tree.add
        super().close()
        self._poses.put(None)

    def _moved(self, message: Any, fixed: bool) -> None:
        for each in message.transforms:  # the pose will have the stamp of one of them, or of one before
            self._listener.remember(seconds(each.header.stamp), each.header.stamp)
        self._give(self.reader.transforms(message, fixed))

    def _received(self, message: Any) -> None:
        try:
            self._listener.remember(seconds(message.header.stamp), message.header.stamp)
            self._give(self.reader.take(message))
        except DeviceError as error:
            self._poses.put(error)
        except EagorError as error:
            self._listener.node.get_logger().warning(f"{self.topic}: a pose is left out: {error}", once=True)

    def _give(self, poses: Sequence[Pose]) -> None:
        for each in poses:
            self._poses.put(each)
