"""The rules of the simulated tasks. All of them are parameters, and every report prints them.

Lengths in metres, angles in degrees (they are typed and printed), times in seconds. Habitat's names where it has them;
the paper fixes none of these numbers, so a figure without its rules says nothing.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, TypeVar

from eagor.errors import WorldError


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
        if min(self.bob, self.sway, self.yaw_drift, self.scale_drift, self.latency) < 0:
            raise WorldError(f"{self}: wanted no negative number")

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
    stop: Literal["reach", "call"] = "reach"
    sliding: bool = True
    detour: bool = True
    nearest: float = 2.0
    farthest: float = 8.0
    ratio: float = 1.5
    winding_above: float = 1.2
    facing_away: float = 20.0
    visible_pixels: int = 2


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


Rules = TypeVar("Rules")


def as_dict(rules: Any) -> dict[str, Any]:
    """Rules as plain JSON."""
    return {key: _plain(value) for key, value in asdict(rules).items()}


def from_dict(kind: type[Rules], values: dict[str, Any]) -> Rules:
    """The rules back from JSON. Raises `WorldError` for a rule that does not exist."""
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    if unknown := set(values) - known:
        raise WorldError(f"{kind.__name__} has no {sorted(unknown)}; it has {sorted(known)}")
    return kind(**{key: _tupled(value) for key, value in values.items()})


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _tupled(value: Any) -> Any:
    return tuple(_tupled(item) for item in value) if isinstance(value, list) else value
