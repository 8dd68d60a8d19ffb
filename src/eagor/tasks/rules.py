"""The rules of the simulated tasks. All of them are parameters, and every report prints them.

Lengths in metres, angles in degrees (they are typed and printed), times in seconds. Habitat's names where it has them;
the paper fixes none of these numbers, so a figure without its rules says nothing.

Rules under which nothing can be played are refused when they are made, with a `WorldError` that names the rule.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, TypeVar, get_args

from eagor._checks import above, require, stretch, whole, within
from eagor.errors import WorldError

Stop = Literal["reach", "call"]
LEGS = ("L1", "L2", "L3", "L4")  # of a route

_ABOVE = "metres above 0"
_STEPS = "a whole number of steps, from 1 on"
_SHARES = "two shares (from, to), from 0 to 1, the second not below the first"


@dataclass(frozen=True)
class Camera:
    """How the camera is carried, and how fast.

    - `height`: of the camera above the floor. `radius`: of the body that carries it.
    - `step`: length of one step; `turn`: the most that the body turns in one step (discrete actions turn by this much).
    - `seconds`: from one step to the next; only forgetting and late responses depend on it.
    """

    height: float = 1.25
    radius: float = 0.18
    step: float = 0.25
    turn: float = 30.0
    seconds: float = 0.5

    def __post_init__(self) -> None:
        wanted = {
            "height": (above(self.height, 0), _ABOVE),
            "radius": (within(self.radius, 0), "metres from 0 on"),
            "step": (above(self.step, 0), _ABOVE),
            "turn": (above(self.turn, 0, 360), "degrees above 0 and up to 360"),
            "seconds": (above(self.seconds, 0), "seconds above 0"),
        }
        require(self, wanted, WorldError)


@dataclass(frozen=True)
class Disturbances:
    """What a real body does to a camera; all off by default.

    - `bob`: the camera rises and falls by so many metres (amplitude), twice per second, and
    - `sway`: rolls and pitches by so many degrees (amplitude). The odometry measures both.
    - `yaw_drift`: degrees per square root of a metre walked, and `scale_drift`: relative error of the odometry's
      lengths (one standard deviation, drawn per episode). Nobody tells the methods.
    - `latency`: a response arrives so many steps after its panorama was taken.
    """

    bob: float = 0.0
    sway: float = 0.0
    yaw_drift: float = 0.0
    scale_drift: float = 0.0
    latency: int = 0

    def __post_init__(self) -> None:
        wanted = {
            "bob": (within(self.bob, 0), "metres from 0 on"),
            "sway": (within(self.sway, 0), "degrees from 0 on"),
            "yaw_drift": (within(self.yaw_drift, 0), "degrees per root metre, from 0 on"),
            "scale_drift": (within(self.scale_drift, 0), "a relative error from 0 on"),
            "latency": (whole(self.latency, 0), "a whole number of steps, from 0 on"),
        }
        require(self, wanted, WorldError)

    @classmethod
    def walking(cls, latency: int = 0) -> Disturbances:
        """A walking robot: 3 cm and 2 degrees of bobbing, 2 degrees per root metre and 3 % of drift."""
        return cls(bob=0.03, sway=2.0, yaw_drift=2.0, scale_drift=0.03, latency=latency)


@dataclass(frozen=True)
class NavigationRules:
    """Map-Free Navigation: start facing away, go a fixed step along the estimate, until the target is reached.

    - `max_steps`: then the episode is over, and lost (Habitat's limit).
    - `success_distance`: geodesic metres to the target's footprint, strict as in Habitat.
    - `stop`: "reach": the episode ends as soon as that distance is reached (the paper names no stop action);
      "call": the agent has to call stop there (Habitat's rule).
    - `sliding`: along walls (Habitat's default); without, a step ends where it touches.
    - `detour`: a body that does not get on feels its way around (`eagor.tasks.policy`), for every method alike;
      without, it pushes on along the estimate, as published.
    - `nearest`, `farthest`: geodesic metres of the start from the target's footprint.
    - `ratio`: at most so much longer is the geodesic than the straight line at the start; `winding` starts have more
      than `winding_above`.
    - `facing_away`: the target is within so many degrees of straight behind at the start.
    - `visible_pixels`: so many pixels of a 64 x 128 panorama make a target visible.
    """

    max_steps: int = 500
    success_distance: float = 1.0
    stop: Stop = "reach"
    sliding: bool = True
    detour: bool = True
    nearest: float = 2.0
    farthest: float = 8.0
    ratio: float = 1.5
    winding_above: float = 1.2
    facing_away: float = 20.0
    visible_pixels: int = 2

    def __post_init__(self) -> None:
        wanted = {
            "max_steps": (whole(self.max_steps, 1), _STEPS),
            "success_distance": (above(self.success_distance, 0), _ABOVE),
            "stop": (self.stop in get_args(Stop), " or ".join(get_args(Stop))),
            "sliding": (isinstance(self.sliding, bool), "true or false"),
            "detour": (isinstance(self.detour, bool), "true or false"),
            "nearest": (within(self.nearest, 0), "metres from 0 on"),
            "farthest": (above(self.farthest, 0), _ABOVE),
            "ratio": (within(self.ratio, 1), "a number from 1 on: no way is shorter than the straight line"),
            "winding_above": (within(self.winding_above, 0), "a number from 0 on"),
            "facing_away": (within(self.facing_away, 0, 180), "degrees from 0 to 180"),
            **_pixels(self.visible_pixels),
        }
        require(self, wanted, WorldError)
        order = (self.farthest >= self.nearest, f"no less than nearest = {self.nearest!r}")
        require(self, {"farthest": order}, WorldError)


@dataclass(frozen=True)
class WaypointRules:
    """Waypoint Following: four legs along a given route, each beginning with a sharper turn; name the direction.

    - `turns`: degrees between which the turn at the beginning of each leg lies.
    - `leg_steps`: at least so many steps in each leg.
    - `occluded`: share of the route's steps at which the target is out of sight, at least and at most.
    - `visible_pixels`: as for navigation.
    """

    turns: tuple[tuple[float, float], ...] = ((0.0, 45.0), (45.0, 90.0), (90.0, 135.0), (135.0, 180.0))
    leg_steps: int = 15
    occluded: tuple[float, float] = (0.08, 0.5)
    visible_pixels: int = 2

    def __post_init__(self) -> None:
        turns = self.turns if isinstance(self.turns, tuple | list) else ()
        wanted = {
            "turns": (
                len(turns) == len(LEGS) and all(stretch(turn, 0, 180) for turn in turns),
                f"{len(LEGS)} pairs of degrees (from, to), from 0 to 180, the second not below the first",
            ),
            "leg_steps": (whole(self.leg_steps, 1), _STEPS),
            "occluded": (stretch(self.occluded, 0, 1), _SHARES),
            **_pixels(self.visible_pixels),
        }
        require(self, wanted, WorldError)


@dataclass(frozen=True)
class TrackingRules:
    """Target Direction Estimation: a ball in the apartment; the camera, the ball, or neither keeps still.

    - `steps`: of an episode. `speed`: metres per second of a moving ball.
    - `gone`: in the third scenario the ball is away for this share of the episode (from, to), then elsewhere.
    - `seen`: plans are drawn until one shows the ball at this share of the steps (a ball that rolls about
      elsewhere tells nothing about any method).
    - `lost_above`: degrees of error beyond which the target counts as lost. `visible_pixels`: as for navigation.
    """

    steps: int = 60
    speed: float = 0.4
    gone: tuple[float, float] = (0.4, 0.6)
    seen: float = 0.7
    lost_above: float = 30.0
    visible_pixels: int = 2

    def __post_init__(self) -> None:
        wanted = {
            "steps": (whole(self.steps, 1), _STEPS),
            "speed": (above(self.speed, 0), "metres per second, above 0"),
            "gone": (stretch(self.gone, 0, 1), _SHARES),
            "seen": (within(self.seen, 0, 1), "a share from 0 to 1"),
            "lost_above": (within(self.lost_above, 0, 180), "degrees from 0 to 180"),
            **_pixels(self.visible_pixels),
        }
        require(self, wanted, WorldError)
        away, back = self.away
        shown = (away > 0 or back == 0, f"the ball there at the first of {self.steps} steps: begin later, or take more")
        require(self, {"gone": shown}, WorldError)

    @property
    def away(self) -> tuple[int, int]:
        """The first step at which the ball is away in the third scenario, and the first at which it is back."""
        return round(self.gone[0] * self.steps), round(self.gone[1] * self.steps)


Rules = TypeVar("Rules")


def as_dict(rules: Any) -> dict[str, Any]:
    """Rules as plain JSON."""
    return {key: _plain(value) for key, value in asdict(rules).items()}


def from_dict(kind: type[Rules], values: dict[str, Any]) -> Rules:
    """The rules back from JSON. Raises `WorldError` for a rule that does not exist, or what the rules refuse."""
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    if unknown := set(values) - known:
        raise WorldError(f"{kind.__name__} has no {sorted(unknown)}; it has {sorted(known)}")
    return kind(**{key: _tupled(value) for key, value in values.items()})


def _pixels(count: Any) -> dict[str, tuple[bool, str]]:
    """What `visible_pixels` has to be in every task: what no pixel shows is in no sight."""
    return {"visible_pixels": (whole(count, 1), "a whole number of pixels, from 1 on")}


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _tupled(value: Any) -> Any:
    return tuple(_tupled(item) for item in value) if isinstance(value, list) else value
