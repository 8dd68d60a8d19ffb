"""What steers the body of a walked task: the rule `policy` chooses it, the same for every method.

- `follow`: along the estimate, always (`eagor.tasks.policy`): the published policy, with a feeling for obstacles.
- `search`: the thing's place is walked to while it is believed; otherwise the body goes where looks would tell most
  (`eagor.tasks.searcher`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from eagor.errors import WorldError
from eagor.sphere import heading
from eagor.tasks.policy import Policy
from eagor.tasks.rules import Camera

FLOORS = ("floor", "rug")  # categories that one walks on


@dataclass(frozen=True, eq=False)
class Situation:
    """What is known at a step.

    - `azimuth` of the estimate, radians, body frame; `share`: how much of the method's belief lies about it, 0 to 1;
      `distance` to the thing along the floor, metres, None if not known.
    - `position` ``(3,)``: of the camera by odometry, z in metres above the floor; `world_R_body` ``(3, 3)``.
    - `floor` ``(H, W)`` bool: which pixels of an equirectangular look show the floor; None if the policy needs none.
    """

    azimuth: float
    share: float
    distance: float | None
    position: np.ndarray
    world_R_body: np.ndarray
    floor: np.ndarray | None = None


class Steering(Protocol):
    """Chooses headings for one episode."""

    searching: bool  # whether the last heading was one of a search

    def heading(self, now: Situation) -> float:
        """The heading to walk in, radians from straight ahead, positive left, in (-pi, pi]."""
        ...


@dataclass
class Following:
    """Walks along the estimate, whatever it is worth."""

    policy: Policy
    searching: bool = False

    def heading(self, now: Situation) -> float:
        return self.policy.heading(now.azimuth, now.position[:2], heading(now.world_R_body))


def steering_for(rules: Any, camera: Camera) -> Steering:
    """The steering that the rules ask for; a task whose rules do not speak of it follows."""
    if getattr(rules, "policy", "follow") == "follow":
        return Following(Policy(camera.step, getattr(rules, "detour", True)))
    from eagor.tasks.searcher import Searcher

    return Searcher(camera.step, camera.radius)


def floors_of(labels: Sequence[Any], source: str) -> np.ndarray:
    """The ids ``(n,)`` of what one walks on. Raises `WorldError` if nothing is called that."""
    found = [index for index, thing in enumerate(labels) if thing.category in FLOORS]
    if not found:
        raise WorldError(
            f"{source} names no {' or '.join(FLOORS)}, so a search cannot tell where one can walk; "
            "leave the rule policy at follow"
        )
    return np.array(found)


def along_floor(distance: float | None, direction: np.ndarray) -> float | None:
    """Metres along the floor to what is `distance` metres away in a direction ``(3,)`` of a level frame."""
    return None if distance is None else distance * math.hypot(float(direction[0]), float(direction[1]))
