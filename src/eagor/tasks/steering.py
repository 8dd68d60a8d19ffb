"""What steers the body of a walked task: the rule `policy` chooses it, the same for every method.

- `follow`: along the estimate, always (`eagor.tasks.policy`): the published policy, with a feeling for obstacles.
- `search`: the thing's place is walked to while it is believed; otherwise the body goes where looks would tell most
  (`eagor.tasks.searcher`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from eagor.tasks.policy import Policy
from eagor.tasks.rules import Camera
from eagor.tasks.searched_ground import SearchedGround
from eagor.tasks.searcher import Searcher
from eagor.tasks.situation import Situation, Steering
from eagor.tracking import TrackerConfig


@dataclass
class Following:
    """Walks along the estimate, whatever it is worth."""

    policy: Policy
    searching: bool = False
    looks_down: bool = False

    def walk(self, now: Situation) -> tuple[float, float]:
        return self.policy.heading(now.azimuth, now.position[:2], now.yaw), self.policy.step


def seeking(rules: Any, tracker: TrackerConfig) -> TrackerConfig:
    """The tracker's configuration for a body that searches: what is out of sight may come into sight at any step."""
    if getattr(rules, "policy", "follow") == "follow":
        return tracker
    return replace(tracker, target_motion=replace(tracker.target_motion, birth=rules.appears))


def steering_for(rules: Any, camera: Camera) -> Steering:
    """The steering that the rules ask for; a task whose rules do not speak of it follows."""
    if getattr(rules, "policy", "follow") == "follow":
        return Following(Policy(camera.step, getattr(rules, "detour", True)))
    turn = math.inf if camera.around else math.radians(camera.turn)
    return Searcher(ground_of(camera), camera.step, rules.handover, turn)


def ground_of(camera: Camera) -> SearchedGround:
    """The ground about a body with this camera, before its first look."""
    return SearchedGround(camera.radius, 2 * math.pi if camera.around else math.radians(camera.hfov))
