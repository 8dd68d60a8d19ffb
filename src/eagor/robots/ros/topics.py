"""Cameras and poses on topics of ROS 2, through `rclpy`: what the node reads, and ``ros:/topic`` elsewhere.

A topic is read with the quality of service that its publishers offer: a reliable reader hears nobody who is not, and a
best-effort one loses large pictures.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any
from uuid import uuid4

import numpy as np
import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from eagor.errors import DeviceError, EagorError
from eagor.live.threads import LoopClock
from eagor.media import Frame, Pose
from eagor.media.bags import MOTION, PICTURES, TF, TF_STATIC
from eagor.media.ros_frames import BACK, BODY, IDENTITY, PoseReader, Transform, TransformTree, optical
from eagor.media.ros_messages import CAMERA_INFO, NANO, TRANSFORMS, seconds, store
from eagor.media.topic_pictures import Lenses, LensTold, TopicPictures, beside, lens_told, placed, topics_of

__all__ = ["Ears", "RosCamera", "RosPoses"]

FIRST = 10.0  # seconds in which a publisher, and the first message, have to come
SETTLING = 2.0  # seconds in which a CameraInfo, or a transform that was told before, has to come
BREATH = 0.1  # seconds after which somebody looks whether there is more to hear, or an end
LEASE = 30.0  # seconds that one who has died without a word may still be counted among the publishers
KEPT = 20_000  # poses that wait to be taken, and stamps that are known to the nanosecond


class Ears(LoopClock):
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
        self.node: Node = node
        self.ended, self._closed = ended, False
        self._heard = dict[Any, Callable[[Any], Any]]()  # what to call with the messages of each subscription
        self._group = MutuallyExclusiveCallbackGroup()
        self._group.add_entity(self)
        self._group.beginning_execution(self)  # for ever, so that executors leave the subscriptions of the group alone
        self.stamps, self.tree, self.lock = dict[float, int](), TransformTree(), threading.RLock()
        self.taker: Callable[[Any, bool], Any] = self.tree.add  # of transforms: poses are, while they are read
        self.has_transforms = find_spec("tf2_msgs") is not None  # no wheel has it
        for topic, fixed in ((TF_STATIC, True), (TF, False)) if self.has_transforms else ():
            durability = DurabilityPolicy.TRANSIENT_LOCAL if fixed else DurabilityPolicy.VOLATILE
            qos = QoSProfile(depth=100, durability=durability)
            self.subscribe(TRANSFORMS, topic, lambda told, fixed=fixed: self.taker(told, fixed), qos)
        self._thread = threading.Thread(target=self._hear, name="eagor ears", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Hear nothing more; leave the graph, if the node is its own."""
        self._closed = True
        for each in [*self._heard]:
            self.unsubscribe(each)
        self._thread.join()
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
        how = {"callback_group": self._group, "raw": find_spec("rosbags") is not None}
        found = self.node.create_subscription(getattr(import_module(f"{package}.msg"), name), topic, heard, qos, **how)
        with self.lock:
            self._heard[found] = (lambda data: heard(store().deserialize_cdr(data, kind))) if found.raw else heard
        return found

    def unsubscribe(self, subscription: Any) -> None:
        """Hear no more of it."""
        with self.lock:
            self._heard.pop(subscription, None)
        self.node.destroy_subscription(subscription)

    def _hear(self) -> None:
        """Take messages as they come, in the way of `rclpy.wait_for_message`.

        rclpy's executors look at all that a node has, twice for each message, and its messages are slow to make: that
        takes four times as long.
        """
        context = self.node.context
        while not self._closed:
            heard = self._heard.copy()
            try:
                with ExitStack() as held:  # what is held is not destroyed
                    for handle in [context.handle, *(each.handle for each in heard)]:
                        held.enter_context(handle)
                    waiting = rclpy_implementation.WaitSet(len(heard), 0, 0, 0, 0, 0, context.handle)
                    while heard and heard == self._heard:
                        waiting.clear_entities()
                        for each in heard:
                            waiting.add_subscription(each.handle)
                        waiting.wait(round(BREATH * NANO))
                        self._take(heard)
            except RuntimeError:  # as rclpy has it if one of them, or the context, has just ended
                if context.ok() and heard == self._heard:
                    raise
            time.sleep(BREATH)

    def _take(self, heard: dict[Any, Callable[[Any], Any]]) -> None:
        """Take what has come."""
        for each, take in heard.items():
            while (found := each.handle.take_message(each.msg_type, each.raw)) is not None:
                try:
                    with self.lock:
                        take(found[0])
                except Exception as error:  # one message is no reason to hear no more
                    text = f"{each.topic_name}: a message is left out: {error!r}"
                    self.node.get_logger().error(text, throttle_duration_sec=10.0)

    def offered(self, topic: str, kinds: Collection[str]) -> tuple[str, QoSProfile]:
        """The type of a `topic`, one of `kinds`, and how to read it. Raises `DeviceError` if nobody publishes it."""
        if not self.wait(lambda: self.node.count_publishers(topic)):
            domain = f"ROS_DOMAIN_ID {self.node.context.get_domain_id()}"
            raise DeviceError(f"nobody publishes {topic} ({domain}): start its node, or remap the topic")
        publishers = self.node.get_publishers_info_by_topic(topic)
        found = publishers[0].topic_type if publishers else "that is gone"
        if found not in kinds:
            raise DeviceError(f"{topic} has a type {found}; wanted {' or '.join(kinds)}")
        reliable, latched = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
        all_reliable = all(each.qos_profile.reliability == reliable for each in publishers)
        all_latched = all(each.qos_profile.durability == latched for each in publishers)
        return found, QoSProfile(
            depth=10 if found in PICTURES else 100,
            reliability=reliable if all_reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=latched if all_latched else DurabilityPolicy.VOLATILE,
        )

    def wait(self, what: Callable[[], Any], most: float = FIRST) -> bool:
        """Whether it happens within `most` seconds of real time."""
        end = time.monotonic() + most
        while not what():
            if self.ended() or time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def now(self) -> float:
        """The node's time, which is that of a simulation with ``use_sim_time``."""
        return self.node.get_clock().now().nanoseconds / NANO

    def slip(self) -> float:
        return 0.0

    def remember(self, stamp: float, told: Any, later: float = 0.0) -> None:
        """The seconds `stamp` are those of a message's Time, less `later`: seconds alone are off by up to 120 ns."""
        self.stamps[stamp] = told.sec * NANO + told.nanosec - round(later * NANO)
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
    """What reads topics: through `ears` that are given, or its own."""

    live = True

    def __init__(self, ears: Ears | None) -> None:
        self._ears, self._own = Ears() if ears is None else ears, ears is None
        self._news = threading.Condition(self._ears.lock)
        self._closed, self._readers = False, list[Any]()

    def close(self) -> None:
        with self._news:
            self._closed = True
            self._news.notify()
        while self._readers:
            self._ears.unsubscribe(self._readers.pop())
        if self._own:
            self._ears.close()

    def _read(self, topic: str, kinds: Collection[str], heard: Callable[[Any], Any]) -> None:
        """Read a topic as its publishers offer it. Raises `DeviceError` as `Ears.offered`."""
        kind, qos = self._ears.offered(topic, kinds)
        self._readers.append(self._ears.subscribe(kind, topic, heard, qos))


class RosCamera(TopicSource):
    """A `CameraSource`: a topic of Image or CompressedImage, or several with commas between, of cameras of one body.

    The CameraInfo beside the pictures tells the lens of those that are no panoramas, and ``/tf_static`` where several
    cameras are; or a `rig` does (`lenses`: as of `Lenses`). `latency`: seconds from capture to the headers' stamps.
    `ears`: of a node that runs; `rate`: the most pictures a second. The newest picture is kept, and decoded when it is
    asked for; `dropped` counts the others, and those that were damaged. `frame`: as the pictures name it. Raises
    `DeviceError` if nobody publishes, or no picture comes; otherwise as `TopicPictures`.
    """

    keeps_newest = True

    def __init__(
        self,
        topic: str | None,
        *,
        ears: Ears | None = None,
        latency: float = 0.0,
        rate: float | None = None,
        **lenses: Any,
    ) -> None:
        self.latency, self.dropped, self.problem = latency, 0, None
        self._apart = 0.99 / rate if rate else 0.0  # seconds between two pictures, a little less for rounding
        super().__init__(ears)
        try:
            named = topics_of(topic or None, "topics")
            self.topics = tuple(self._ears.resolved(each or "image") for each in named)
            self._newest: list[Any] = [None for _ in named]
            self._fresh, self._last = False, -math.inf  # of the first topic: with it the newest of the others are taken
            for at, name in enumerate(self.topics):
                self._read(name, PICTURES, partial(self._received, at))
            if not self._ears.wait(lambda: None not in self._newest):
                silent = self.topics[self._newest.index(None)]
                raise DeviceError(f"no picture came on {silent} within {FIRST:g} s; is the camera running?")
            self._pictures = TopicPictures(self._newest, self.topics, Lenses(**lenses), self._told, self._placed)
        except BaseException:
            self.close()
            raise
        self.frame, builder = self._pictures.frame, self._pictures.builder
        self.grid, self.unseen = builder.grid, builder.unseen

    def __iter__(self) -> Iterator[Frame]:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._closed or self._fresh)
                if self._closed:
                    return
                messages, self._fresh = self._newest[:], False
            try:
                frame = self._frame(messages)
            except EagorError as error:
                frame, self.problem = None, f"{self.topics[0]}: a picture is left out: {error}"
            if frame is None:
                self.dropped += 1
            else:
                yield frame

    def _frame(self, messages: list[Any]) -> Frame | None:
        """The next frame; None if it was sent twice, or comes too soon or out of order. Raises as `TopicPictures`."""
        topic, told, last = self.topics[0], messages[0].header.stamp, self._last
        stamp = (seconds(told) or self._ears.now()) - self.latency
        if last - BACK <= stamp <= last or 0 < stamp - last < self._apart:
            return None
        picture = self._pictures.made(messages, ": another camera or mode? Set it back, or start again")
        self._last, self.problem = stamp, None
        if seconds(told):
            self._ears.remember(stamp, told, self.latency)
        else:
            self.problem = f"{topic} tells no times (its headers have the stamp 0): those of arrival are taken"
        return Frame(stamp, picture, f"{topic} at {stamp:.3f} s", self._pictures.builder.view)

    def _received(self, at: int, message: Any) -> None:
        self._newest[at] = message
        if at == 0:
            self.dropped += self._fresh
            self._fresh = True
            self._news.notify()

    def _told(self, topic: str, asked: str | None) -> LensTold | None:
        """What the CameraInfo says; None if nobody publishes it."""
        name, found = self._ears.resolved(asked or beside(topic)), list[Any]()
        if not self._ears.wait(lambda: self._ears.node.count_publishers(name), SETTLING):
            return None
        self._read(name, (CAMERA_INFO,), found.append)
        came = self._ears.wait(lambda: found)
        self._ears.unsubscribe(self._readers.pop())
        if not came:
            raise DeviceError(f"no CameraInfo came on {name} within {FIRST:g} s; drivers send one with each picture")
        return lens_told(found[0], name, topic)

    def _placed(self, frames: Sequence[str]) -> list[np.ndarray]:
        """Where cameras are in the axes of the first."""
        self._ears.wait(lambda: all(self._ears.placed(frames[0], each) for each in frames), SETTLING)
        with self._ears.lock:
            return placed(self._ears.tree, frames)


class RosPoses(TopicSource):
    """A `PoseSource`: the camera's poses from Odometry, poses, an Imu's orientation, or ``/tf`` (`PoseReader`).

    `camera`: its frame; transforms tell where it is on the body. Where they do not, the axes of the messages are taken
    for the camera's, and `problem` says so. `body`, `world`: as for `PoseReader`. Otherwise as `RosCamera`. Raises
    `DeviceError` if nobody publishes the topic, if two do, or if no pose comes.
    """

    def __init__(
        self,
        topic: str | None,
        *,
        ears: Ears | None = None,
        kinds: Collection[str] = MOTION,
        camera: str | None = None,
        body: str = BODY,
        world: str | None = None,
    ) -> None:
        super().__init__(ears)
        self._poses, self._error = deque[Pose](maxlen=KEPT), None
        self._counted = self._alone = time.monotonic()
        try:
            self.topic = self._ears.resolved(topic or "odom")
            self.kind, _ = self._ears.offered(self.topic, kinds)
            if self.kind == TRANSFORMS and not self._ears.has_transforms:
                raise DeviceError(f"{self.topic} needs tf2_msgs, which no wheel has: source a ROS installation")
            how = {"strict": self.kind == TRANSFORMS, "rewinds": True}
            self.reader = PoseReader(self.topic, self.kind, camera=camera, body=body, world=world, **how)
            self.reader.tree = self._ears.tree
            if camera and self._ears.has_transforms:  # poses before those of the camera would be the body's
                self._ears.wait(lambda: self._ears.placed(self.reader.body, camera), SETTLING)
            self._ears.taker = self._moved
            if self.kind != TRANSFORMS:
                self._read(self.topic, (self.kind,), self._received)
            if not self._ears.wait(lambda: self._poses or self._error) and not self._ears.ended():
                told = self.problem or "are its stamps set, and does it run?"
                raise DeviceError(f"no pose came on {self.topic} within {FIRST:g} s: {told}")
        except BaseException:
            self.close()
            raise

    @property
    def problem(self) -> str | None:
        """What is wrong now, in words, or None."""
        return self.reader.problem

    def __iter__(self) -> Iterator[Pose]:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._poses or self._closed or self._error)
                if self._closed:
                    return
                if self._error is not None:
                    raise self._error
                pose = self._poses.popleft()
            yield pose

    def close(self) -> None:
        self._ears.taker = self._ears.tree.add
        super().close()

    def _moved(self, message: Any, fixed: bool) -> None:
        for each in message.transforms:  # the pose will have the stamp of one of them, or of one before
            self._ears.remember(seconds(each.header.stamp), each.header.stamp)
        self._poses.extend(self.reader.transforms(message, fixed))
        self._news.notify()

    def _received(self, message: Any) -> None:
        now = time.monotonic()
        if now > self._counted + 1.0:
            self._counted, writers = now, self._ears.node.count_publishers(self.topic)
            self._alone = now if writers < 2 else self._alone
            if now > self._alone + LEASE:
                self._error = DeviceError(f"{writers} publishers write {self.topic}: stop all but one, or remap it")
        try:
            self._ears.remember(seconds(message.header.stamp), message.header.stamp)
            self._poses.extend(self.reader.take(message))
        except DeviceError as error:
            self._error = error
        except EagorError as error:
            self._ears.node.get_logger().warning(f"{self.topic}: a pose is left out: {error}", once=True)
        self._news.notify()
