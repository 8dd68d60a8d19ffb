"""What the node says: answers of the live loop as ROS 2 messages, their stamps, and the thread that sends them.

Directions are in the frame of the body (REP-103: x forward, y left, z up); `body_R_camera` leads there from the
camera's axes, in which the answer is. Pictures of the belief are in the camera's own axes: pixel by pixel over its own.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal, Self, get_args

import numpy as np

from eagor.errors import EagorError
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.live.core import deviation
from eagor.live.events import Answer, Event, FrameCame, NextLooks, Part, PoseCame
from eagor.media import Pose
from eagor.media.ros_messages import (
    IMAGE,
    POSE,
    VECTOR,
    header,
    image_message,
    message,
    point,
    pose_part,
    time_message,
    vector,
    vector_message,
)
from eagor.robots.ros.graph import Graph, GraphWriter
from eagor.sphere import azimuth_elevation, world_R_body

__all__ = [
    "DIAGNOSTICS", "MARKERS", "NUMBERS", "Outbox", "OutgoingAnswer", "Stamps", "belief_coefficients", "belief_image",
    "diagnostics", "direction_message", "direction_pose", "gone", "markers", "topic_of", "trouble",
]  # fmt: skip

MARKERS, MARKER = "visualization_msgs/msg/MarkerArray", "visualization_msgs/msg/Marker"
DIAGNOSTICS, NUMBERS = "diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/Float32MultiArray"
OK, WARN, ERROR = 0, 1, 2  # diagnostic_msgs/DiagnosticStatus
ARROW, TRIANGLES, TEXT = 0, 11, 9  # visualization_msgs/Marker
ADD, DELETE = 0, 2
IDS = 3  # markers of a query: arrow, cone, text
REACH = 1.0  # metres: length of the arrow and of the cone
LASTING = 0.5  # seconds that a marker stays if no other follows
SIDES = 36  # triangles of a cone
GRAVE = 5.0  # seconds after which a fault is an error rather than a warning
PALETTE = ((0.90, 0.12, 0.15), (0.12, 0.47, 0.90), (0.20, 0.63, 0.17), (0.95, 0.55, 0.10), (0.55, 0.25, 0.75))

DIAGNOSED = 1.0  # seconds between two diagnostics
PARTS: tuple[str, ...] = get_args(Part)


def topic_of(query: str) -> str:
    """A query as part of a topic's name: "the red chair!" is "the_red_chair". Names of ROS begin with a letter."""
    name = re.sub(r"[^a-z0-9]+", "_", query.lower()).strip("_")
    return name if name[:1].isalpha() else f"query_{name}".rstrip("_")


def direction_message(answer: Answer, body_R_camera: np.ndarray, body: str) -> Any | None:
    """The direction, a unit vector, as Vector3Stamped in the frame `body`; None while nothing is known."""
    if answer.direction is None:
        return None
    return vector_message(body_R_camera @ answer.direction, answer.stamp, body)


def direction_pose(answer: Answer, body_R_camera: np.ndarray, body: str) -> Any | None:
    """A PoseStamped at the body's origin whose x axis points at the thing, y level; None while nothing is known."""
    if answer.direction is None:
        return None
    turn = _pointing(body_R_camera @ answer.direction)
    return message("geometry_msgs/msg/PoseStamped", header=header(answer.stamp, body), pose=pose_part(turn))


def markers(answer: Answer, body_R_camera: np.ndarray, body: str, number: int = 0) -> Any:
    """A MarkerArray in the namespace of the query: arrow (0), cone of the 90 % credible angle (1), text (2).

    Each message replaces the one before; while nothing is known the markers are deleted. `number` chooses the colour.
    """
    if answer.direction is None:
        return gone(answer.query, answer.stamp, body)
    d = body_R_camera @ answer.direction
    rgb = PALETTE[number % len(PALETTE)]
    angle = answer.estimate.credible_angle
    told = f"{answer.query}: {_said(d)}, {answer.estimate.status}"
    about = answer.query, answer.stamp, body
    made = [
        _marker(*about, 0, ARROW, turn=_pointing(d), scale=(REACH, 0.03, 0.06), colour=(*rgb, 1.0)),
        _marker(*about, 1, TRIANGLES, scale=(1, 1, 1), colour=(*rgb, 0.25), points=_cone(d, angle)),
        _marker(*about, 2, TEXT, scale=(0, 0, 0.1), colour=(1, 1, 1, 1), place=1.1 * REACH * d, text=told),
    ]
    return message(MARKERS, markers=made)


def gone(query: str, stamp: float, body: str) -> Any:
    """A MarkerArray that deletes the markers of a query."""
    made = [_marker(query, stamp, body, number, ARROW, action=DELETE) for number in range(IDS)]
    return message(MARKERS, markers=made)


def belief_image(answer: Answer, camera: str, rows: int = 64, encoding: Literal["mono8", "32FC1"] = "mono8") -> Any:
    """The belief on an equirectangular picture in the frame `camera`: density per steradian, or 255 at its peak."""
    density = answer.estimate.density(ErpGrid(rows, 2 * rows)).astype(np.float32)
    if encoding == "mono8":
        peak = float(density.max())
        density = np.rint(255 * density / peak if peak > 0 else density).astype(np.uint8)
    return image_message(density, answer.stamp, camera)


def belief_coefficients(answer: Answer, rows: int = 64) -> Any:
    """The belief's real spherical harmonics, as a Float32MultiArray: index l*l + l + m, in the camera's axes."""
    degree = answer.estimate.config.degree
    basis, grid = RealHarmonics(degree), ErpGrid(max(rows, 2 * (degree + 1)), 2 * max(rows, 2 * (degree + 1)))
    values = np.asarray(basis.analyse(answer.estimate.density(grid), grid), dtype=np.float32)
    dim = message(
        "std_msgs/msg/MultiArrayDimension", label="l*l + l + m, camera axes", size=len(values), stride=len(values)
    )
    layout = message("std_msgs/msg/MultiArrayLayout", dim=[dim], data_offset=0)
    return message(NUMBERS, layout=layout, data=values)


def diagnostics(
    stamp: float,
    answers: Sequence[Answer],
    body_R_camera: np.ndarray,
    parts: Sequence[str],
    told: Mapping[str, str],
    name: str = "eagor",
) -> Any:
    """A DiagnosticArray: one status for each of the `parts`, in words, one for each query; `told`: further values.

    A fault is a warning, and after `GRAVE` seconds an error.
    """
    found = []
    faults = answers[0].faults if answers else ()
    for part in parts:
        here = [fault for fault in faults if fault.part == part]
        since = min((fault.since for fault in here), default=stamp)
        level = OK if not here else WARN if stamp - since < GRAVE else ERROR
        text = "; ".join(fault.text for fault in here) or "all is well"
        found.append(_status(level, f"{name}: {part}", text, {}))
    for answer in answers:
        e = answer.estimate
        values = {
            "presence": f"{e.presence:.3f}",
            "status": e.status,
            "cone_deg": "" if answer.direction is None else f"{math.degrees(e.credible_angle):.1f}",
            "look_age_s": f"{answer.look_age:.2f}",
            "image_age_s": f"{answer.image_age:.2f}",
        }
        d = None if answer.direction is None else body_R_camera @ answer.direction
        found.append(_status(OK, f"{name}: {answer.query}", f"{_said(d)}; {e.status}", values))
    if told:
        found.append(_status(OK, f"{name}: counts", "", told))
    return message(DIAGNOSTICS, header=header(stamp, ""), status=found)


def trouble(stamp: float, text: str, level: int = ERROR, name: str = "eagor") -> Any:
    """A DiagnosticArray with one sentence."""
    return message(DIAGNOSTICS, header=header(stamp, ""), status=[_status(level, name, text, {})])


def _said(d: np.ndarray | None) -> str:
    """A direction of the body frame in degrees."""
    if d is None:
        return "not known"
    azimuth, elevation = (math.degrees(float(angle)) for angle in azimuth_elevation(d))
    side, height = "left" if azimuth >= 0 else "right", "up" if elevation >= 0 else "down"
    return f"{abs(azimuth):.0f} degrees to the {side}, {abs(elevation):.0f} {height}"


def _status(level: int, name: str, text: str, values: Mapping[str, str]) -> Any:
    pairs = [message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
    return message(
        "diagnostic_msgs/msg/DiagnosticStatus", level=level, name=name, message=text, hardware_id="eagor", values=pairs
    )


def _pointing(d: np.ndarray) -> np.ndarray:
    """The rotation whose x axis is `d` and whose y axis is level."""
    azimuth, elevation = (float(angle) for angle in azimuth_elevation(d))
    return world_R_body(azimuth, -elevation, 0.0)  # pitch is positive with the nose down


def _cone(d: np.ndarray, angle: float) -> list[Any]:
    """The triangles of a cone from the origin about `d`, its half-angle `angle` radians, its side `REACH` long."""
    _, y, z = _pointing(d).T
    turns = np.linspace(0, 2 * np.pi, SIDES + 1)
    rim = REACH * (math.cos(angle) * d + math.sin(angle) * (np.cos(turns)[:, None] * y + np.sin(turns)[:, None] * z))
    origin = point((0, 0, 0))
    return [each for a, b in pairwise(rim) for each in (origin, point(a), point(b))]


def _marker(
    query: str,
    stamp: float,
    body: str,
    number: int,
    kind: int,
    *,
    action: int = ADD,
    turn: np.ndarray | None = None,
    place: Any = (0, 0, 0),
    scale: Sequence[float] = (0, 0, 0),
    colour: Sequence[float] = (0, 0, 0, 0),
    points: Sequence[Any] = (),
    text: str = "",
) -> Any:
    nothing, lasting = np.zeros(0, np.uint8), time_message(LASTING)
    return message(
        MARKER, header=header(stamp, body), ns=query, id=number, type=kind, action=action,
        pose=pose_part(np.eye(3) if turn is None else turn, place), scale=vector(scale),
        color=message("std_msgs/msg/ColorRGBA", **dict(zip("rgba", map(float, colour), strict=True))),
        lifetime=message("builtin_interfaces/msg/Duration", sec=lasting.sec, nanosec=lasting.nanosec),
        frame_locked=False, points=list(points), colors=[], texture_resource="",
        texture=message("sensor_msgs/msg/CompressedImage", header=header(0.0, ""), format="", data=nothing),
        uv_coordinates=[], text=text, mesh_resource="",
        mesh_file=message("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )  # fmt: skip


class Stamps:
    """A watcher of the loop: an answer as of the inputs that it rests on.

    That is the newest pose: the answer is told in the axes that the camera had there, with the stamp of that pose. So
    whoever has the transforms of the inputs has the one for it, whatever clock the robot uses, and nothing is told of a
    turn that nobody has measured yet. Without poses it is the newest picture.
    """

    def __init__(self) -> None:
        self._pose: Pose | None = None
        self._picture = 0.0

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        if isinstance(event, PoseCame):
            self._pose = event.pose
        elif isinstance(event, FrameCame):
            self._picture = event.stamp

    def close(self) -> None:
        """Nothing is held."""

    def of(self, answer: Answer, otherwise: float, between: float = 0.0) -> Answer:
        """The same answer there; at the stamp `otherwise`, if no input has told a time.

        `between`: standard deviation, radians, of a pose that is interpolated between two of the odometry, as those of
        the pictures are; regions are as much wider.
        """
        pose = self._pose
        if pose is None:
            return replace(answer, stamp=self._picture if self._picture > 0 else otherwise)
        estimate = answer.estimate.turned(answer.estimate.stamp, pose.world_R_body, deviation(between**2 / 2))
        return replace(answer, stamp=pose.stamp if pose.stamp > 0 else otherwise, estimate=estimate)


@dataclass(frozen=True, eq=False)
class OutgoingAnswer:
    """An `answer`, `given` then, to the query of this `number` of `count`; `told`: further values for diagnostics.

    `looks`: who tells where the camera should look next.
    """

    answer: Answer
    given: float
    number: int
    count: int
    body_R_camera: np.ndarray
    camera: str
    told: Mapping[str, str]
    looks: NextLooks | None = None


class Outbox:
    """Publishes the newest answers on a `graph`, as `settings` (`NodeSettings`) say; a context manager.

    It has a thread of its own, so that a reader that hangs holds up no answer.
    ``~/direction``, ``~/direction_pose``, ``~/belief_image``, ``~/belief`` and ``~/next_look`` (of an ordinary camera)
    are of the first query; every further one
    has ``~/NAME/direction`` and ``~/NAME/direction_pose``. ``~/markers`` and ``/diagnostics`` are of all. `now`: the
    time of the node, for what rests on no picture. `failed`: how many messages could not be sent.
    """

    def __init__(self, graph: Graph, settings: Any, now: Callable[[], float]) -> None:
        self.failed = 0
        self._graph, self._settings, self._now = graph, settings, now
        self._writers: dict[str, GraphWriter] = {}
        self._news = threading.Condition()
        self._items: dict[str, OutgoingAnswer] = {}
        self._words: list[Any] = []
        self._shown: set[str] = set()
        self._newest: dict[str, OutgoingAnswer] = {}
        self._diagnosed = self._believed = 0.0
        self._closed = False
        for topic in ("~/direction", "~/direction_pose", "~/markers", "~/belief_image", "~/belief"):
            self._writer(topic)
        self._thread = threading.Thread(target=self._serve, name="eagor outbox", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def put(self, answer: OutgoingAnswer) -> None:
        """Send an answer; it replaces one to the same query that waits."""
        with self._news:
            self._items[answer.answer.query] = answer
            self._news.notify()

    def say(self, diagnostic: Any) -> None:
        """Send a DiagnosticArray, beside those of the answers."""
        with self._news:
            self._words.append(diagnostic)
            self._news.notify()

    def close(self) -> None:
        """Say the words that wait, take the markers away, and end; answers are of no use any more."""
        with self._news:
            self._closed = True
            self._news.notify()
        self._thread.join()
        for writer in self._writers.values():
            writer.close()

    def _serve(self) -> None:
        while True:
            with self._news:
                while not (self._items or self._words or self._closed):
                    self._news.wait()
                items, self._items = self._items, {}
                words, self._words = self._words, []
                closed = self._closed
                if closed:
                    items = {}
            for diagnostic in words:
                self._send("/diagnostics", diagnostic)
            for item in items.values():
                self._publish(item)
            if items:
                self._tidy(items)
                self._diagnose(items)
            if closed:
                for query in self._shown:
                    self._send("~/markers", gone(query, self._now(), self._settings.body))
                return

    def _publish(self, item: OutgoingAnswer) -> None:
        answer, turn, body = item.answer, item.body_R_camera, self._settings.body
        space = "~" if item.number == 0 else f"~/{topic_of(answer.query)}"
        if (direction := direction_message(answer, turn, body)) is not None:
            self._send(f"{space}/direction", direction)
            self._send(f"{space}/direction_pose", direction_pose(answer, turn, body))
        self._send("~/markers", markers(answer, turn, body, item.number))
        self._shown.add(answer.query)
        toward = None if item.looks is None or item.number else item.looks.of(answer)
        if toward is not None:
            self._send("~/next_look", vector_message(turn @ toward, answer.stamp, body))
        rate = self._settings.belief_rate
        due = rate > 0 and _over(item.given - self._believed, 1 / rate)
        if item.number == 0 and due and answer.direction is not None:
            self._believed = item.given
            self._send("~/belief_image", belief_image(answer, item.camera, encoding=self._settings.belief_encoding))
            self._send("~/belief", belief_coefficients(answer))

    def _tidy(self, items: Mapping[str, OutgoingAnswer]) -> None:
        """Take away the markers of what is no longer followed."""
        self._newest |= items
        newest = max(items.values(), key=lambda item: item.given)
        now = sorted(self._newest.values(), key=lambda item: -item.given)[: newest.count]
        self._newest = {item.answer.query: item for item in now}
        for query in self._shown - self._newest.keys():
            self._send("~/markers", gone(query, newest.answer.stamp, self._settings.body))
            self._shown = self._shown - {query}

    def _diagnose(self, items: Mapping[str, OutgoingAnswer]) -> None:
        now = max(item.given for item in items.values())
        if not _over(now - self._diagnosed, DIAGNOSED):
            return
        self._diagnosed = now
        order = sorted(self._newest.values(), key=lambda item: item.number)
        told = {**order[0].told, "not_sent": str(self.failed)}
        found = diagnostics(self._now(), [item.answer for item in order], order[0].body_R_camera, PARTS, told)
        self._send("/diagnostics", found)

    def _send(self, topic: str, message: Any) -> None:
        try:
            self._writer(topic).write(message)
        except EagorError:  # a reader that does not keep up
            self.failed += 1

    def _writer(self, topic: str) -> GraphWriter:
        if topic not in self._writers:
            kinds = {
                "direction": VECTOR, "direction_pose": POSE, "markers": MARKERS, "belief_image": IMAGE,
                "belief": NUMBERS, "diagnostics": DIAGNOSTICS, "next_look": VECTOR,
            }  # fmt: skip
            self._writers[topic] = self._graph.publish(topic, kinds[topic.rpartition("/")[2]], reliable=True, depth=10)
        return self._writers[topic]


def _over(gone: float, seconds: float) -> bool:
    """Whether so many seconds have gone; also where the clock has been set back."""
    return not 0 <= gone < seconds
