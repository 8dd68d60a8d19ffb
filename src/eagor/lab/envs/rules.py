"""The rules of the simulated tasks. All of them are parameters, and every report prints them.

Lengths are in metres, angles in degrees (for typing and printing), times in seconds. Names are Habitat's where it has
them. The paper fixes none of these numbers, so a figure without its rules means nothing.

Rules that make the task impossible raise a `WorldError` that names the rule.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal, TypeVar, get_args, get_type_hints

import msgspec
from msgspec import Meta

from eagor.errors import WorldError

AROUND = 360.0  # degrees
SURROUNDS = 0.75  # metres from a thing to its view points, at most
LEGS = ("L1", "L2", "L3", "L4")  # of a route

# The types of the rules: their bounds, and the words of the error text. Every number has an upper bound: no infinity.
MOST = 1e9
Positive = Annotated[float, Meta(gt=0, le=MOST, description="a number above 0")]
FromZero = Annotated[float, Meta(ge=0, le=MOST, description="a number from 0 on")]
FromOne = Annotated[float, Meta(ge=1, le=MOST, description="a number from 1 on")]
Share = Annotated[float, Meta(ge=0, le=1, description="a share from 0 to 1")]
PositiveShare = Annotated[float, Meta(gt=0, le=1, description="a number above 0 and up to 1")]
Metres = Annotated[float, Meta(gt=0, le=MOST, description="metres above 0")]
Degrees = Annotated[float, Meta(ge=0, le=180, description="degrees from 0 to 180")]
Turn = Annotated[float, Meta(gt=0, le=AROUND, description="degrees above 0 and up to 360")]
Count = Annotated[int, Meta(ge=1, le=int(MOST), description="a whole number from 1 on")]
CountFromZero = Annotated[int, Meta(ge=0, le=int(MOST), description="a whole number from 0 on")]
Shares = Annotated[tuple[Share, Share], Meta(description="two shares (from, to), from 0 to 1, ascending")]
Turns = Annotated[
    tuple[tuple[Degrees, Degrees], ...],
    Meta(min_length=4, max_length=4, description="4 pairs of degrees (from, to), from 0 to 180, ascending"),
]


class _Rules:
    """Rejects values outside the types of the rules, and ranges (from, to) that fall."""

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(type(self), include_extras=True).items():
            wanted = "true or false" if kind is bool else " or ".join(map(str, get_args(kind)))
            wanted = next((meta.description for meta in getattr(kind, "__metadata__", ())), wanted)
            try:
                found: Any = msgspec.convert(getattr(self, name), kind)
                ranges = (found,) if kind is Shares else found if kind is Turns else ()
                fits = all(low <= high for low, high in ranges)
            except msgspec.ValidationError:
                fits = False
            self._require(name, fits, wanted)

    def _require(self, name: str, holds: bool, wanted: str) -> None:
        if not holds:
            raise WorldError(f"{type(self).__name__}: {name} = {getattr(self, name)!r}; wanted {wanted}")


@dataclass(frozen=True)
class Camera(_Rules):
    """How the camera is carried, and how fast.

    - `height`: of the camera above the floor. `radius`: of the body that carries it.
    - `step`: length of one step; `turn`: the largest turn per step.
    - `seconds`: from one step to the next; matters only for forgetting and late responses.
    - `hfov`: degrees that it sees across. 360: all around; less: straight ahead, in a picture of 4:3.
    """

    height: Metres = 1.25
    radius: FromZero = 0.18
    step: Metres = 0.25
    turn: Turn = 30.0
    seconds: Positive = 0.5
    hfov: Turn = AROUND

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require("hfov", self.around or 10 <= self.hfov <= 170, "degrees: 10 to 170, or 360")

    @property
    def around(self) -> bool:
        """Whether it sees all around."""
        return self.hfov == AROUND


@dataclass(frozen=True)
class NoiseModel(_Rules):
    """The noise of a real body; all off by default.

    - `bob`: amplitude, metres, of the camera's rise and fall, twice per second, and
    - `sway`: amplitude, degrees, of its roll and pitch. The odometry measures both.
    - `yaw_drift`: degrees per square root of a metre walked, and `scale_drift`: relative error of the odometry's
      lengths (one standard deviation, drawn per episode). The estimators do not know either.
    - `latency`: a response arrives this many steps after its panorama was taken.
    """

    bob: FromZero = 0.0
    sway: FromZero = 0.0
    yaw_drift: FromZero = 0.0
    scale_drift: FromZero = 0.0
    latency: CountFromZero = 0

    @classmethod
    def walking(cls, latency: int = 0) -> NoiseModel:
        """A walking robot: 3 cm and 2 degrees of bobbing, 2 degrees per root metre and 3 % of drift."""
        return cls(bob=0.03, sway=2.0, yaw_drift=2.0, scale_drift=0.03, latency=latency)


@dataclass(frozen=True)
class NavigationRules(_Rules):
    """Map-Free Navigation: start facing away, walk in fixed steps until the target is reached.

    - `max_steps`: the episode then ends as a failure (Habitat's limit).
    - `success_distance`: geodesic metres to the goal, strict as in Habitat.
    - `goal`: the target's "footprint", or the nearest of the "view_points" that the episodes of a file have.
    - `stop`: "reach": the episode ends as soon as that distance is reached (the paper names no stop action);
      "call": the agent has to call stop there (Habitat's rule). It does when its estimator believes that it has
      arrived; one that knows no distances never does.
    - `sliding`: along walls (Habitat's default); otherwise a step ends at the contact.
    - `detour`: a blocked body feels its way around (`eagor.lab.agents.steering`), for every estimator alike; otherwise
      it pushes on along the estimate, as published.
    - `policy`: "search" while too little is believed, and walk by the floor that looks show
      (`eagor.lab.agents.steering`), or "follow" the estimate always, as published; for every estimator alike.
      `commit_threshold`: a search ends while each metre along the estimate brings the body this many metres nearer, as
      the estimator believes. `birth_rate`: with "search", the rate (per second) at which a thing that is hidden comes
      into sight, for an estimator that doubts that it is here.
    - `nearest`, `farthest`: geodesic metres from the start to the target's footprint.
    - `ratio`: largest ratio of geodesic to straight distance at the start; `winding` starts have more than
      `winding_above`.
    - `facing_away`: at the start the target is within this many degrees of straight behind.
    - `visible_pixels`: pixels of a 64 x 128 panorama that make a target visible.
    """

    max_steps: Count = 500
    success_distance: Metres = 1.0
    goal: Literal["footprint", "view_points"] = "footprint"
    stop: Literal["reach", "call"] = "reach"
    sliding: bool = True
    detour: bool = True
    policy: Literal["follow", "search"] = "search"
    commit_threshold: PositiveShare = 0.2
    birth_rate: FromZero = 0.1
    nearest: FromZero = 2.0
    farthest: Metres = 8.0
    ratio: FromOne = 1.5
    winding_above: FromZero = 1.2
    facing_away: Degrees = 20.0
    visible_pixels: Count = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require("farthest", self.farthest >= self.nearest, f"no less than nearest = {self.nearest!r}")

    @classmethod
    def objectnav(cls) -> NavigationRules:
        """The rules of Habitat's ObjectNav challenges: stop within 0.1 m of a view point, without sliding."""
        return cls(success_distance=0.1, goal="view_points", stop="call", sliding=False)

    @property
    def near(self) -> float:
        """Metres along the floor to the thing within which a body calls stop; 0: it need not call.

        Nobody is told where the view points are, but that they surround the thing.
        """
        if self.stop == "reach":
            return 0.0
        return SURROUNDS if self.goal == "view_points" else self.success_distance

    @property
    def success_criterion(self) -> str:
        """What success means, in words."""
        where = "a view point of the goal" if self.goal == "view_points" else "the target's footprint"
        ended = "on arrival, without a call" if self.stop == "reach" else "when the agent calls stop"
        slide = "with" if self.sliding else "without"
        return (
            f"success: less than {self.success_distance:g} m along the floor from {where}; the episode ends {ended}; "
            f"at most {self.max_steps} steps, {slide} sliding along walls"
        )


@dataclass(frozen=True)
class WaypointRules(_Rules):
    """Waypoint Following: four legs along a given route, each beginning with a sharper turn; name the direction.

    - `turns`: range, degrees, of the turn at the beginning of each leg.
    - `leg_steps`: least number of steps per leg.
    - `occluded`: range of the share of the route's steps at which the target is out of sight.
    - `visible_pixels`: as for navigation.
    """

    turns: Turns = ((0.0, 45.0), (45.0, 90.0), (90.0, 135.0), (135.0, 180.0))
    leg_steps: Count = 15
    occluded: Shares = (0.08, 0.5)
    visible_pixels: Count = 2


@dataclass(frozen=True)
class TrackingRules(_Rules):
    """Target Direction Estimation: a ball in the apartment; the camera moves, the ball moves, or neither.

    - `steps`: of an episode. `speed`: metres per second of a moving ball.
    - `gone`: in the third scenario the ball is away for this part of the episode (from, to), then elsewhere.
    - `seen`: plans are drawn until one shows the ball at this share of the steps (an invisible ball tells nothing
      about any estimator).
    - `lost_above`: degrees of error beyond which the target counts as lost. `visible_pixels`: as for navigation.
    """

    steps: Count = 60
    speed: Positive = 0.4
    gone: Shares = (0.4, 0.6)
    seen: Share = 0.7
    lost_above: Degrees = 30.0
    visible_pixels: Count = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        away, back = self.away
        wanted = f"the ball present at step 1 of {self.steps}: begin later, or take more steps"
        self._require("gone", away > 0 or back == 0, wanted)

    @property
    def away(self) -> tuple[int, int]:
        """In the third scenario, the first step at which the ball is away, and the first at which it is back."""
        return round(self.gone[0] * self.steps), round(self.gone[1] * self.steps)


Rules = TypeVar("Rules")


def from_dict(kind: type[Rules], values: dict[str, Any]) -> Rules:
    """The rules from JSON. Raises `WorldError` for an unknown rule or an invalid value."""
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    if unknown := set(values) - known:
        raise WorldError(f"{kind.__name__} has no {sorted(unknown)}; it has {sorted(known)}")
    return kind(**{key: _tupled(value) for key, value in values.items()})


def _tupled(value: Any) -> Any:
    return tuple(_tupled(item) for item in value) if isinstance(value, list) else value
