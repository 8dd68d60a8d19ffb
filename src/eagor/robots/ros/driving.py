"""``cmd_vel``: the velocity that walks a base to the thing, through the rules of the safety gate.

For bases that another node of ROS drives. That node has to stop by itself when no message comes (Nav2's velocity
smoother and diff_drive_controller do): this is a thread of the node, not a process of its own as a Go2's guard is.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Self

import numpy as np

from eagor.errors import EagorError
from eagor.live.events import Answer, Event, PoseCame
from eagor.media import Pose
from eagor.media.ros_messages import message, vector
from eagor.robots.ros.graph import Graph
from eagor.robots.safety.gate import Gate, Mode, State, Stop
from eagor.robots.safety.limits import STILL, Body, Limits, Velocity
from eagor.robots.safety.messages import GateClient, GuardState, inputs_from
from eagor.sphere import heading

__all__ = ["BASE", "TWIST", "TwistGate", "body_of"]

TWIST = "geometry_msgs/msg/Twist"
# Odometry of bases comes 10 to 50 times a second, over Wi-Fi late.
BASE = Limits(state_age=0.5, pose_age=0.5, silence=0.5)
SPAN = 0.2  # seconds of odometry from which the base's speed is read


class TwistGate(GateClient):
    """The gate in front of a Twist topic: what a guard is to a Go2. A context manager.

    It is a watcher of the live loop, too, whose poses tell how the base moves. `mount(stamp)` gives `body_R_camera`.
    While the gate stands it sends nothing, so that others may drive; at a fault it sends zeros until the odometry says
    that the base stands.
    """

    def __init__(self, graph: Graph, topic: str, mount: Callable[[float], np.ndarray], limits: Limits = BASE) -> None:
        self.gate = Gate(limits, armed=True, obeys=False)
        self._writer = graph.publish(topic, TWIST, reliable=True, depth=1)
        self._mount = mount
        self._turn = threading.Lock()
        self._state, self._said = State(), dict[str, Any]()
        self._body: Body | None = None
        self._poses: deque[tuple[float, Pose]] = deque()
        self._guard = GuardState(time.monotonic(), Mode.STANDING)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="eagor cmd_vel", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the base, and end."""
        if self._over.is_set():
            return
        self._over.set()
        self._thread.join()
        if self._state.mode is not Mode.STANDING:
            self._send(STILL)
        self._writer.close()

    # --- what steering tells ---

    @property
    def state(self) -> GuardState:
        return self._guard

    def _say(self, **news: Any) -> None:
        with self._turn:
            self._said |= news

    # --- what the loop tells ---

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop: poses are the base's state."""
        if isinstance(event, PoseCame) and event.pose.position is not None:
            now = time.monotonic()
            self._poses.append((now, event.pose))
            while len(self._poses) > 2 and event.pose.stamp - self._poses[1][1].stamp >= SPAN:
                self._poses.popleft()
            body = body_of(self._poses[0][1], event.pose, self._mount(event.pose.stamp), now)
            with self._turn:
                self._body = body

    # --- the thread ---

    def _serve(self) -> None:
        while not self._over.wait(self.gate.limits.period):
            now = time.monotonic()
            with self._turn:
                inputs, body = inputs_from(self._said), self._body
            # Nobody acknowledges a Twist: the odometry alone says that the base stands.
            inputs = replace(inputs, body=body, acknowledged=self._state.stops)
            self._state, output = self.gate.step(self._state, now, inputs)
            if output.send is not None:
                self._send(STILL if isinstance(output.send, Stop) else output.send)
            self._guard = GuardState.of(now, output, body, stops=self._state.stops)

    def _send(self, velocity: Velocity) -> None:
        twist = message(
            TWIST, linear=vector((velocity.forward, velocity.left, 0.0)), angular=vector((0.0, 0.0, velocity.turn))
        )
        with suppress(EagorError):  # a reader that does not keep up: the next one comes soon
            self._writer.write(twist)


def body_of(before: Pose, pose: Pose, body_R_camera: np.ndarray, now: float) -> Body:
    """The state of a base that got from one pose of its camera to another; NaN speeds if both are of one time."""
    gone = pose.stamp - before.stamp
    assert before.position is not None
    assert pose.position is not None
    speed = turn = math.nan
    if gone > 0:
        speed = float(np.linalg.norm((pose.position - before.position)[:2])) / gone
        turn = math.remainder(heading(pose.world_R_body) - heading(before.world_R_body), 2 * math.pi) / gone
    return Body.of(now, pose.world_R_body @ body_R_camera.T, speed, turn)
