"""An answer of the live loop as ROS 2 messages: direction, pose, markers, belief, diagnostics.

Directions are in the frame of the body (REP-103: x forward, y left, z up); `body_R_camera` leads there from the
camera's axes, in which the answer is. Pictures of the belief are in the camera's own axes: pixel by pixel over its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.live.events import Answer
from eagor.media.bags.messages import (
    header,
    image_message,
    message,
    point,
    pose_part,
    time_message,
    vector,
    vector_message,
)
from eagor.sphere import azimuth_elevation, world_R_body

__all__ = [
    "DIAGNOSTICS", "MARKERS", "NUMBERS", "belief_coefficients", "belief_image", "diagnostics", "direction_message",
    "direction_pose", "gone", "markers", "topic_of", "trouble",
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
    made = [
        _marker(answer, body, 0, ARROW, _pointing(d), scale=(REACH, 0.03, 0.06), colour=(*rgb, 1.0)),
        _marker(answer, body, 1, TRIANGLES, np.eye(3), scale=(1, 1, 1), colour=(*rgb, 0.25), points=_cone(d, angle)),
        _marker(
            answer, body, 2, TEXT, np.eye(3), scale=(0, 0, 0.1), colour=(1, 1, 1, 1), place=1.1 * REACH * d, text=told
        ),
    ]
    return message(MARKERS, markers=made)


def gone(query: str, stamp: float, body: str) -> Any:
    """A MarkerArray that deletes the markers of a query."""
    return message(MARKERS, markers=[_blank(query, stamp, body, number, DELETE) for number in range(IDS)])


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
    answer: Answer,
    body: str,
    number: int,
    kind: int,
    turn: np.ndarray,
    *,
    scale: Sequence[float],
    colour: Sequence[float],
    place: Any = (0, 0, 0),
    points: Sequence[Any] = (),
    text: str = "",
) -> Any:
    made = _blank(answer.query, answer.stamp, body, number, ADD)
    made.type, made.pose, made.scale = kind, pose_part(turn, place), vector(scale)
    made.color = message("std_msgs/msg/ColorRGBA", **dict(zip("rgba", map(float, colour), strict=True)))
    made.points, made.text = list(points), text
    return made


def _blank(query: str, stamp: float, body: str, number: int, action: int) -> Any:
    lasting = time_message(LASTING)
    return message(
        MARKER,
        header=header(stamp, body),
        ns=query,
        id=number,
        type=ARROW,
        action=action,
        pose=pose_part(np.eye(3)),
        scale=vector((0, 0, 0)),
        color=message("std_msgs/msg/ColorRGBA", r=0.0, g=0.0, b=0.0, a=0.0),
        lifetime=message("builtin_interfaces/msg/Duration", sec=lasting.sec, nanosec=lasting.nanosec),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=message(
            "sensor_msgs/msg/CompressedImage", header=header(0.0, ""), format="", data=np.zeros(0, np.uint8)
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=message("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )
