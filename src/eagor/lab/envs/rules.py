"""The rules of the simulated tasks. All of them are parameters, and every report prints them.

Lengths are in metres, angles in degrees (for typing and printing), times in seconds. Names are Habitat's where it has
them. The paper fixes none of these numbers, so a figure without its rules means nothing.

Rules that make the task impossible raise a `WorldError` that names the rule.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal, TypeVar, get_args

from eagor._checks import above, require, stretch, whole, within
from eagor.errors import WorldError

Stop = Literal["reach", "call"]
Goal = Literal["footprint", "view_points"]
PolicyName = Literal["follow", "search"]
AROUND = 360.0  # degrees
SURROUNDS = 0.75  # metres from a thing to its view points, at most
LEGS = ("L1", "L2", "L3", "L4")  # of a route

Fits = Callable[[Any], bool]
Wanted = tuple[Fits, str]


def _from(low: float, what: str, high: float | None = None) -> Wanted:
    return (lambda value: within(value, low) if high is None else within(value, low, high)), what


def _above(low: float, what: str) -> Wanted:
    return (lambda value: above(value, low)), what


def _count(least: int, what: str) -> Wanted:
    return (lambda value: whole(value, least)), what


def _is_turns(value: Any) -> bool:
    pairs = value if isinstance(value, tuple | list) else ()
    return len(pairs) == len(LEGS) and all(stretch(pair, 0, 180) for pair in pairs)


_METRES = _above(0, "metres above 0")
_STEPS = _count(1, "a whole number of steps, from 1 on")
_PIXELS = _count(1, "a whole number of pixels, from 1 on")  # no pixel means not in sight
_SHARES = (lambda value: stretch(value, 0, 1)), "two shares (from, to), from 0 to 1, the second not below the first"
_STOP = get_args(Stop).__contains__, " or ".join(get_args(Stop))
_GOAL = get_args(Goal).__contains__, " or ".join(get_args(Goal))
_POLICY = get_args(PolicyName).__contains__, " or ".join(get_args(PolicyName))
_BOOL = (lambda value: isinstance(value, bool)), "true or false"


def _rule(default: Any, wanted: Wanted) -> Any:
    """A rule: its default, and its valid values."""
    return field(default=default, metadata={"wanted": wanted})


class _Rules:
    """Rejects rules that make the task impossible."""

    def __post_init__(self) -> None:
        asked = [(rule.name, rule.metadata["wanted"]) for rule in fields(self)]  # type: ignore[arg-type]
        require(self, {name: (fits(getattr(self, name)), text) for name, (fits, text) in asked}, WorldError)


@dataclass(frozen=True)
class Camera(_Rules):
    """How the camera is carried, and how fast.

    - `height`: of the camera above the floor. `radius`: of the body that carries it.
    - `step`: length of one step; `turn`: the largest turn per step.
    - `seconds`: from one step to the next; matters only for forgetting and late responses.
    - `hfov`: degrees that it sees across. 360: all around; less: straight ahead, in a picture of 4:3.
    """

    height: float = _rule(1.25, _METRES)
    radius: float = _rule(0.18, _from(0, "metres from 0 on"))
    step: float = _rule(0.25, _METRES)
    turn: float = _rule(30.0, ((lambda value: above(value, 0, 360)), "degrees above 0 and up to 360"))
    seconds: float = _rule(0.5, _above(0, "seconds above 0"))
    hfov: float = _rule(
        AROUND, ((lambda value: value == AROUND or within(value, 10, 170)), "degrees: 10 to 170, or 360")
    )

    @property
    def around(self) -> bool:
        """Whether it sees all around."""
        return self.hfov == AROUND


@dataclass(frozen=True)
class Disturbances(_Rules):
    """Disturbances from a real body; all off by default.

    - `bob`: amplitude, metres, of the camera's rise and fall, twice per second, and
    - `sway`: amplitude, degrees, of its roll and pitch. The odometry measures both.
    - `yaw_drift`: degrees per square root of a metre walked, and `scale_drift`: relative error of the odometry's
      lengths (one standard deviation, drawn per episode). The methods do not know either.
    - `latency`: a response arrives this many steps after its panorama was taken.
    """

    bob: float = _rule(0.0, _from(0, "metres from 0 on"))
    sway: float = _rule(0.0, _from(0, "degrees from 0 on"))
    yaw_drift: float = _rule(0.0, _from(0, "degrees per root metre, from 0 on"))
    scale_drift: float = _rule(0.0, _from(0, "a relative error from 0 on"))
    latency: int = _rule(0, _count(0, "a whole number of steps, from 0 on"))

    @classmethod
    def walking(cls, latency: int = 0) -> Disturbances:
        """A walking robot: 3 cm and 2 degrees of bobbing, 2 degrees per root metre and 3 % of drift."""
        return cls(bob=0.03, sway=2.0, yaw_drift=2.0, scale_drift=0.03, latency=latency)


@dataclass(frozen=True)
class NavigationRules(_Rules):
    """Map-Free Navigation: start facing away, walk in fixed steps until the target is reached.

    - `max_steps`: the episode then ends as a failure (Habitat's limit).
    - `success_distance`: geodesic metres to the goal, strict as in Habitat.
    - `goal`: the target's "footprint", or the nearest of the "view_points" that the episodes of a file have.
    - `stop`: "reach": the episode ends as soon as that distance is reached (the paper names no stop action);
      "call": the agent has to call stop there (Habitat's rule). It does when its method believes that it has
      arrived; one that knows no distances never does.
    - `sliding`: along walls (Habitat's default); otherwise a step ends at the contact.
    - `detour`: a blocked body feels its way around (`eagor.lab.agents.steering`), for every method alike; otherwise it
      pushes on along the estimate, as published.
    - `policy`: "search" while too little is believed, and walk by the floor that looks show
      (`eagor.lab.agents.steering`), or "follow" the estimate always, as published; for every method alike.
      `handover`: a search ends while each metre along the estimate brings the body this many metres nearer, as the
      method believes. `appears`: with "search", the rate (per second) at which a thing that is hidden comes into
      sight, for a method that doubts that it is here.
    - `nearest`, `farthest`: geodesic metres from the start to the target's footprint.
    - `ratio`: largest ratio of geodesic to straight distance at the start; `winding` starts have more than
      `winding_above`.
    - `facing_away`: at the start the target is within this many degrees of straight behind.
    - `visible_pixels`: pixels of a 64 x 128 panorama that make a target visible.
    """

    max_steps: int = _rule(500, _STEPS)
    success_distance: float = _rule(1.0, _METRES)
    goal: Goal = _rule("footprint", _GOAL)  # noqa: RUF009 (it is a field)
    stop: Stop = _rule("reach", _STOP)  # noqa: RUF009 (it is a field)
    sliding: bool = _rule(True, _BOOL)
    detour: bool = _rule(True, _BOOL)
    policy: PolicyName = _rule("search", _POLICY)  # noqa: RUF009 (it is a field)
    handover: float = _rule(0.2, ((lambda value: above(value, 0, 1)), "a number above 0 and up to 1"))
    appears: float = _rule(0.1, _from(0, "a rate per second, from 0 on"))
    nearest: float = _rule(2.0, _from(0, "metres from 0 on"))
    farthest: float = _rule(8.0, _METRES)
    ratio: float = _rule(1.5, _from(1, "a number from 1 on: no path is shorter than the straight line"))
    winding_above: float = _rule(1.2, _from(0, "a number from 0 on"))
    facing_away: float = _rule(20.0, _from(0, "degrees from 0 to 180", 180))
    visible_pixels: int = _rule(2, _PIXELS)

    def __post_init__(self) -> None:
        super().__post_init__()
        order = (self.farthest >= self.nearest, f"no less than nearest = {self.nearest!r}")
        require(self, {"farthest": order}, WorldError)

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
    def judged(self) -> str:
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

    turns: tuple[tuple[float, float], ...] = _rule(
        ((0.0, 45.0), (45.0, 90.0), (90.0, 135.0), (135.0, 180.0)),
        (_is_turns, f"{len(LEGS)} pairs of degrees (from, to), from 0 to 180, the second not below the first"),
    )
    leg_steps: int = _rule(15, _STEPS)
    occluded: tuple[float, float] = _rule((0.08, 0.5), _SHARES)
    visible_pixels: int = _rule(2, _PIXELS)


@dataclass(frozen=True)
class TrackingRules(_Rules):
    """Target Direction Estimation: a ball in the apartment; the camera moves, the ball moves, or neither.

    - `steps`: of an episode. `speed`: metres per second of a moving ball.
    - `gone`: in the third scenario the ball is away for this part of the episode (from, to), then elsewhere.
    - `seen`: plans are drawn until one shows the ball at this share of the steps (an invisible ball tells nothing
      about any method).
    - `lost_above`: degrees of error beyond which the target counts as lost. `visible_pixels`: as for navigation.
    """

    steps: int = _rule(60, _STEPS)
    speed: float = _rule(0.4, _above(0, "metres per second, above 0"))
    gone: tuple[float, float] = _rule((0.4, 0.6), _SHARES)
    seen: float = _rule(0.7, _from(0, "a share from 0 to 1", 1))
    lost_above: float = _rule(30.0, _from(0, "degrees from 0 to 180", 180))
    visible_pixels: int = _rule(2, _PIXELS)

    def __post_init__(self) -> None:
        super().__post_init__()
        away, back = self.away
        shown = (away > 0 or back == 0, f"the ball present at step 1 of {self.steps}: begin later, or take more steps")
        require(self, {"gone": shown}, WorldError)

    @property
    def away(self) -> tuple[int, int]:
        """In the third scenario, the first step at which the ball is away, and the first at which it is back."""
        return round(self.gone[0] * self.steps), round(self.gone[1] * self.steps)


Rules = TypeVar("Rules")


def as_dict(rules: Any) -> dict[str, Any]:
    """Rules, or another dataclass, as plain JSON."""
    return json.loads(json.dumps(asdict(rules)))  # tuples become lists


def from_dict(kind: type[Rules], values: dict[str, Any]) -> Rules:
    """The rules from JSON. Raises `WorldError` for an unknown rule or an invalid value."""
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    if unknown := set(values) - known:
        raise WorldError(f"{kind.__name__} has no {sorted(unknown)}; it has {sorted(known)}")
    return kind(**{key: _tupled(value) for key, value in values.items()})


def _tupled(value: Any) -> Any:
    return tuple(_tupled(item) for item in value) if isinstance(value, list) else value
