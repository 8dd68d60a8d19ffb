"""The rules of the simulated tasks. All of them are parameters, and every report prints them.

Lengths are in metres, angles in degrees (for typing and printing), times in seconds. Names are Habitat's where it has
them. The paper fixes none of these numbers, so a figure without its rules means nothing.

Rules that make the task impossible raise a `WorldError` that names the rule.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from eagor.errors import WorldError

LEGS = ("L1", "L2", "L3", "L4")  # of a route

VISIBLE = 2  # pixels of a panorama of 64 x 128 that make a target visible
RATIO, WINDING = 1.5, 1.2  # of geodesic to straight distance at a start: the largest, and that of a winding way
FACING_AWAY = 20.0  # degrees from straight behind within which the target is at a start
TURNS = ((0.0, 45.0), (45.0, 90.0), (90.0, 135.0), (135.0, 180.0))  # degrees, at the beginning of each leg
OCCLUDED = (0.08, 0.5)  # of the steps of a route, those at which the target is out of sight: from, to
SEEN = 0.7  # of its steps, those at which a ball is shown: an invisible one tells nothing about any estimator
LOST = 30.0  # degrees of error beyond which a target counts as lost

# The types of the rules. Every number has an upper bound: no infinity.
MOST = 1e9
Positive = Annotated[float, Meta(gt=0, le=MOST)]
FromZero = Annotated[float, Meta(ge=0, le=MOST)]
Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1, le=int(MOST))]


class _Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rejects values outside the types of the rules."""

    def __post_init__(self) -> None:
        for field in msgspec.structs.fields(self):
            try:
                msgspec.convert(getattr(self, field.name), field.type)
            except msgspec.ValidationError as error:
                self._require(field.name, False, str(error))

    def _require(self, name: str, holds: bool, wanted: str) -> None:
        if not holds:
            raise WorldError(f"{type(self).__name__}: {name} = {getattr(self, name)!r}; {wanted}")


class Camera(_Rules, frozen=True):
    """How the camera is carried, and how fast. It sees all around.

    - `height`: of the camera above the floor. `radius`: of the body that carries it.
    - `step`: length of one step; `turn`: the largest turn per step.
    - `seconds`: from one step to the next; matters only for forgetting and late responses.
    """

    height: Positive = 1.25
    radius: FromZero = 0.18
    step: Positive = 0.25
    turn: Annotated[float, Meta(gt=0, le=360)] = 30.0
    seconds: Positive = 0.5


class NoiseModel(_Rules, frozen=True):
    """The noise of a real body; all off by default.

    - `bob`: amplitude, metres, of the camera's rise and fall, twice per second, and `sway`: amplitude, degrees, of its
      roll and pitch. The odometry measures both.
    - `yaw_drift`: degrees per root metre walked, and `scale_drift`: relative error of the odometry's lengths (standard
      deviation, drawn per episode). The estimators do not know either.
    - `latency`: a response arrives this many steps after its panorama was taken.
    """

    bob: FromZero = 0.0
    sway: FromZero = 0.0
    yaw_drift: FromZero = 0.0
    scale_drift: FromZero = 0.0
    latency: Annotated[int, Meta(ge=0, le=int(MOST))] = 0

    @classmethod
    def walking(cls, latency: int = 0) -> NoiseModel:
        """A walking robot: 3 cm and 2 degrees of bobbing, 2 degrees per root metre and 3 % of drift."""
        return cls(bob=0.03, sway=2.0, yaw_drift=2.0, scale_drift=0.03, latency=latency)


class NavigationRules(_Rules, frozen=True):
    """Map-Free Navigation: start facing away, walk in fixed steps until the target is reached.

    - `max_steps`: the episode then ends as a failure (Habitat's limit). `sliding`: along walls (Habitat's default).
    - `success_distance`: geodesic metres to the target's footprint, strict as in Habitat.
    - `stop`: "reach": the episode ends as soon as that distance is reached (the paper names no stop action);
      "call": the agent has to call stop there (Habitat's rule). It does when its estimator believes that it has
      arrived; one that knows no distances never does.
    - `policy`, for every estimator alike: "search" while too little is believed, and walk by the floor that looks show
      (`eagor.lab.agents.steering`), or "follow" the estimate always, as published, with `detour` around what blocks.
    - `commit_threshold`: a search ends while each metre along the estimate brings the body this many metres nearer, as
      the estimator believes. `birth_rate`: per second, at which hidden things come into sight of a searching body.
    - `nearest`, `farthest`: geodesic metres from the start to the target's footprint.
    """

    max_steps: Count = 500
    success_distance: Positive = 1.0
    stop: Literal["reach", "call"] = "reach"
    sliding: bool = True
    detour: bool = True
    policy: Literal["follow", "search"] = "search"
    commit_threshold: Annotated[float, Meta(gt=0, le=1)] = 0.2
    birth_rate: FromZero = 0.1
    nearest: FromZero = 2.0
    farthest: Positive = 8.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require("farthest", self.farthest >= self.nearest, f"wanted no less than nearest = {self.nearest!r}")

    @property
    def near(self) -> float:
        """Metres along the floor to the thing within which a body calls stop; 0: it need not call."""
        return self.success_distance if self.stop == "call" else 0.0

    @property
    def success_criterion(self) -> str:
        """What success means, in words."""
        ended = "on arrival, without a call" if self.stop == "reach" else "when the agent calls stop"
        return (
            f"success: less than {self.success_distance:g} m along the floor from the target's footprint; the episode "
            f"ends {ended}; at most {self.max_steps} steps, {'with' if self.sliding else 'without'} sliding along walls"
        )


class WaypointRules(_Rules, frozen=True):
    """Waypoint Following: four legs along a given route, each beginning with a sharper turn; name the direction.

    `leg_steps`: least number of steps per leg.
    """

    leg_steps: Count = 15


class TrackingRules(_Rules, frozen=True):
    """Target Direction Estimation: a ball in the apartment; the camera moves, the ball moves, or neither.

    - `steps`: of an episode. `speed`: metres per second of a moving ball.
    - `gone`: in the third scenario the ball is away for this part of the episode (from, to), then elsewhere.
    """

    steps: Count = 60
    speed: Positive = 0.4
    gone: tuple[Share, Share] = (0.4, 0.6)

    def __post_init__(self) -> None:
        super().__post_init__()
        away, back = self.away
        wanted = f"wanted an ascending pair, with the ball present at step 1 of {self.steps}"
        self._require("gone", away <= back and (away > 0 or back == 0), wanted)

    @property
    def away(self) -> tuple[int, int]:
        """In the third scenario, the first step at which the ball is away, and the first at which it is back."""
        return round(self.gone[0] * self.steps), round(self.gone[1] * self.steps)
