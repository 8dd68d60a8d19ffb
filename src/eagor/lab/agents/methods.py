"""All methods behind one interface: `move` to a pose of the odometry, `see` evidence, read the `direction`.

A method is named by text: ``eagor``, ``vmf``, or a variant such as ``eagor:degree=7,decode=mean``. Late evidence counts
for the time of its panorama: our tracker handles that itself, filters are rewound and replayed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from eagor.baselines import (
    GRID,
    BestDetection,
    Centroid,
    CircularCentroid,
    DirectionFilter,
    GridFilter,
    HistogramFilter,
    LastDetection,
    ParticleFilter,
    Plain,
    VonMisesFisherFilter,
)
from eagor.belief.ranged import log_ranges
from eagor.conventions import rotation_from_wxyz
from eagor.errors import EagorError, TimeError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.perception import is_model
from eagor.sphere import FORWARD
from eagor.tracking import Estimate, TrackerConfig
from eagor.tracking.follower import Follower

PARTICLES = 2000
SURE_DISTANCE = 0.6  # standard deviation of the logarithm of a distance that one can walk by
REWIND = 64  # steps by which a filter can be rewound
FLOOR = 0.0  # metres: z of the floor in the worlds' odometry
BASE = TrackerConfig(floor_height=FLOOR)  # default of our tracker

# A description of each, for reports; in the order of tables.
DESCRIPTIONS = {
    "centroid": "mean pixel of the response, frame by frame",
    "cent_circ": "the same, with a circular mean of the azimuth",
    "grid": "log responses on a pixel grid, resampled at each turn, read at the maximum",
    "eagor_paper": "EAGOR as published: degree 7, log(l + 0.001) scaled per frame, spherical mean",
    "best_detection": "the detection with the best score so far, turned with the camera",
    "last_detection": "the newest detection, turned with the camera",
    "vmf": "von Mises-Fisher filter: one direction and one concentration",
    "grid_filter": "Bayes filter on a grid of probabilities",
    "particle_filter": f"particle filter, {PARTICLES} directions",
    "eagor": "our tracker: direction and distance; absent, standing, wandering or turning; the heaviest mode",
}
NAMES = tuple(DESCRIPTIONS)
PLAIN = "plain"  # asks the model anew at each step, without a filter: the baseline of vision-language models
EVERY = (PLAIN, *NAMES)
ORACLE = "oracle"  # knows the true direction: the upper bound for geometry and policy


class Method(Protocol):
    """An estimator of the target's direction."""

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """Set the pose at `stamp`, from the odometry; once for every step, before its evidence."""
        ...

    def see(self, evidence: Evidence) -> None:
        """Add evidence, stamped with the time of an earlier `move`, perhaps some steps ago."""
        ...

    def direction(self) -> np.ndarray:
        """The estimate ``(3,)`` in the body frame of the last pose; forward while nothing is known."""
        ...

    def mass_above(self, direction: np.ndarray) -> float | None:
        """Mass of the smallest credible region that contains `direction`; None for methods without a distribution."""
        ...

    def distance(self) -> float | None:
        """Metres to the target; None for methods without ranges."""
        ...


class Steers(Method, Protocol):
    """A method that says what a search needs to know of its belief."""

    def sure_distance(self) -> float | None:
        """`distance`, but None unless its logarithm is known to within `SURE_DISTANCE`."""
        ...

    def progress(self) -> float:
        """Metres nearer to the target, if it is here, per metre walked along `direction`; 1 without a belief."""
        ...

    def presence(self) -> float:
        """Probability that the target is here; 1 for methods that take that for granted."""
        ...


@dataclass(frozen=True, eq=False)
class _Step:
    """One step of a filter: its pose, the filter before the evidence of that step, and that evidence."""

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray | None
    before: DirectionFilter
    looks: tuple[Evidence, ...] = ()

    def after(self) -> DirectionFilter:
        """The filter after this step's evidence."""
        state = self.before
        for look in self.looks:
            state = state.update(look)
        return state


@dataclass
class FilterMethod:
    """A filter of `eagor.baselines`, with a bounded history of its steps for rewinding."""

    filter: DirectionFilter
    steps: list[_Step] = field(default_factory=list)

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        if self.steps:
            self.filter = _carried(self.filter, self.steps[-1], world_R_body, position)
        self.steps.append(_Step(stamp, world_R_body, position, self.filter))
        del self.steps[:-REWIND]

    def see(self, evidence: Evidence) -> None:
        place = next((i for i in reversed(range(len(self.steps))) if self.steps[i].stamp == evidence.stamp), None)
        if place is None:
            raise TimeError(f"evidence of t = {evidence.stamp} s fits none of the last {len(self.steps)} steps")
        self.steps[place] = replace(self.steps[place], looks=(*self.steps[place].looks, evidence))
        if place == len(self.steps) - 1:
            self.filter = self.filter.update(evidence)
            return
        state = self.steps[place].after()
        for index in range(place + 1, len(self.steps)):
            step = self.steps[index]
            self.steps[index] = step = replace(
                step, before=_carried(state, self.steps[index - 1], step.world_R_body, step.position)
            )
            state = step.after()
        self.filter = state

    def direction(self) -> np.ndarray:
        return np.asarray(self.filter.direction())

    def mass_above(self, direction: np.ndarray) -> float | None:
        density = getattr(self.filter, "log_density", None)
        if density is None:
            return None
        values, truth = density(GRID.directions), float(density(np.asarray(direction)[None])[0])
        return float(np.sum((np.exp(values) * GRID.weights)[values > truth]))

    def distance(self) -> float | None:
        return None

    def sure_distance(self) -> float | None:
        return None

    def progress(self) -> float:
        density = getattr(self.filter, "log_density", None)
        if density is None:
            return 1.0
        mass = np.exp(density(GRID.directions)) * GRID.weights
        return float(np.sum(mass * (GRID.directions @ self.direction())))

    def presence(self) -> float:
        return 1.0


def _carried(state: DirectionFilter, last: _Step, world_R_body: np.ndarray, position: np.ndarray | None) -> Any:
    """`state` after the motion from `last` to here."""
    known = position is not None and last.position is not None
    moved = world_R_body.T @ (position - last.position) if known else None  # type: ignore[operator]
    return state.predict(world_R_body.T @ last.world_R_body, moved)


@dataclass
class TrackerMethod:
    """Our tracker, or a variant of it."""

    follower: Follower
    now: float = 0.0

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        self.follower.move(stamp, world_R_body, position)
        self.now = stamp

    def see(self, evidence: Evidence) -> None:
        self.follower.look(evidence)

    @property
    def config(self) -> TrackerConfig:
        """The tracker's configuration."""
        return self.follower.tracker.config

    @property
    def estimate(self) -> Estimate:
        """The tracker's answer at the last pose, computed once."""
        return self.follower.estimate(self.now)

    def direction(self) -> np.ndarray:
        found = self.estimate.direction
        return np.array(FORWARD) if found is None else found

    def mass_above(self, direction: np.ndarray) -> float | None:
        return self.estimate.mass_above(direction)

    def distance(self) -> float | None:
        return self.estimate.distance

    def sure_distance(self) -> float | None:
        spread = self.estimate.distance_spread
        return None if spread is None or spread > SURE_DISTANCE else self.estimate.distance

    def progress(self) -> float:
        return self.estimate.progress

    def presence(self) -> float:
        return self.estimate.presence


def default_methods(perception: str) -> tuple[str, ...]:
    """The methods that are compared by default; with vision-language models also the plain model."""
    return EVERY if is_model(perception) else NAMES


def make_method(
    name: str,
    rng: np.random.Generator,
    perception: str = "",
    calibration: Calibration | None = None,
    ours: TrackerConfig | None = None,
    detector: DetectorModel | None = None,
) -> Steers:
    """The method with this name; `rng` is for those that draw. Raises `EagorError` for an unknown name.

    A baseline starts from the settings fitted for `perception`, ours from `ours`, with its `calibration` or `detector`.
    """
    base, _, text = name.partition(":")
    if base not in EVERY:
        raise EagorError(
            f"there is no method {base!r}; known are {', '.join(EVERY)}, and variants such as eagor:degree=7"
        )
    settings = _settings(name, fitted(perception, base)) | _settings(name, text)
    try:
        if base in _FILTERS:
            return _filter(base, settings, rng)
        config = TrackerConfig.paper() if base == "eagor_paper" else ours or TrackerConfig()
        return TrackerMethod(Follower(tracker_config(config, settings, calibration, detector)))
    except KeyError as error:
        known = ", ".join(SETTINGS[base]) or "none"
        raise EagorError(f"method {name!r}: there is no setting {error}; known for {base}: {known}") from None
    except EagorError as error:
        raise EagorError(f"method {name!r}: {error}") from None
    except ValueError as error:
        raise EagorError(f"method {name!r}: a setting wants a number ({error})") from None


def method_for(name: str, perception: Any, called: str, rng: np.random.Generator, ours: TrackerConfig = BASE) -> Steers:
    """A new method of this name, configured for a perception and the text it was `called` by."""
    calibration, detector = (getattr(perception, part, None) for part in ("calibration", "detector"))
    return make_method(name, rng, called, calibration, ours, detector)


def answer_at(method: Method, stamp: float, pose: np.ndarray, evidence: Evidence | None) -> np.ndarray:
    """The method's direction ``(3,)`` at a `pose` ``(7,)`` of the odometry, given the evidence that has arrived."""
    method.move(stamp, rotation_from_wxyz(pose[3:]), pose[:3])
    if evidence is not None:
        method.see(evidence)
    return method.direction()


def _settings(name: str, text: str) -> dict[str, str]:
    pairs = [item.partition("=") for item in text.split(",") if item]
    found = {key: value for key, _, value in pairs}
    if any(not (key and equals and value) for key, equals, value in pairs) or len(found) < len(pairs):
        raise EagorError(
            f"method {name!r}: wanted name:key=value,key=value, each key once, such as eagor:degree=7,decode=mean"
        )
    return found


def _number(key: str, text: str) -> float:
    """A number from text, an angle in radians. Raises ValueError for anything else."""
    found = math.radians(float(text)) if key in _ANGLES else float(text)
    if math.isnan(found):
        raise ValueError(f"{key} = nan")
    return found


def _whole(key: str, text: str, most: float = math.inf) -> int:
    """A whole number from 0 to `most`. Raises `EagorError`."""
    found = _number(key, text)
    if not (found.is_integer() and 0 <= found <= most):
        wanted = "a whole number, 0 or more" if most == math.inf else f"a whole number from 0 to {most:g}"
        raise EagorError(f"{key} = {found:g}; wanted {wanted}")
    return int(found)


def _decode(key: str, text: str) -> str:
    if text not in ("mode", "mean"):
        raise EagorError(f"{key} = {text!r}; wanted mode or mean")
    return text


def _shells(key: str, text: str) -> tuple[float, ...] | None:
    return tuple(log_ranges(count=count).tolist()) if (count := _whole(key, text)) else None


def _heights(key: str, text: str) -> float | None:
    return FLOOR if _whole(key, text, 1) else None


def _rate(key: str, text: str) -> float | None:
    return None if text == "?" else _number(key, text)


def _beta(key: str, text: str) -> tuple[float, ...]:
    return tuple(_number(key, each) for each in text.split("+"))


def _kinds(key: str, text: str) -> tuple[float, ...]:
    found = _beta(key, text)
    return () if found == (0.0,) else found


_READING = ("floor", "neutral", "temperature")
# In degrees.
_ANGLES = ("noise", "diffusion", "roughening", "kernel", "wander", "turn", "spread", "dspread", "offset", "drift")
# The settings of our tracker: the part of its configuration that each belongs to, its field, and its parser.
_OURS: dict[str, tuple[str, str, Callable[[str, str], Any]]] = {
    "degree": ("", "degree", _whole),
    "decode": ("answers", "decode", _decode),
    **{key: ("calibration", key, _number) for key in (*_READING, "persistence", "spread")},
    **{
        key: ("detector", key, _rate)
        for key in ("detection_probability", "false_alarms_per_look", "kept_for", "kept_within")
    },
    **{key: ("detector", key, _beta) for key in ("habit", "look_alike_habit")},
    **{
        key: ("detector", key, _number)
        for key in ("look_alikes", "offset", "spread_of_size", "offset_of_size", "parts")
    },
    "dspread": ("detector", "spread", _number),
    "shells": ("", "ranges", _shells),
    "heights": ("", "floor_height", _heights),
    **{key: ("target_motion", key, _kinds) for key in ("wander", "turn")},
    **{key: ("target_motion", key, _number) for key in ("start", "stop", "jump", "birth", "death")},
    "drift": ("", "drift", _rate),
}
SETTINGS: dict[str, tuple[str, ...]] = {
    "plain": (),
    "centroid": (),
    "cent_circ": (),
    "grid": (),
    "eagor_paper": tuple(_OURS),
    "best_detection": (),
    "last_detection": (),
    "vmf": (*_READING, "noise"),
    "grid_filter": (*_READING, "diffusion", "mixing"),
    "particle_filter": (*_READING, "roughening", "reborn", "kernel"),
    "eagor": tuple(_OURS),
}


def tracker_config(
    config: TrackerConfig,
    settings: dict[str, str],
    calibration: Calibration | None = None,
    detector: DetectorModel | None = None,
) -> TrackerConfig:
    """`config` with settings from text; raises KeyError for an unknown setting, ValueError for a wrong number.

    - degree, decode; shells (0: directions only), heights (0: unknown floor height);
    - target motion: wander (degrees per root second) and turn (degrees per second; several kinds are joined by +,
      0: none), and start, stop, jump, birth, death (rates per second); drift (degrees per root second, ?: learnt);
    - response maps: floor, neutral, temperature, persistence, spread (degrees). They change `calibration` if the config
      has none of its own;
    - detections: detection_probability (?: differs from place to place), false_alarms_per_look (?: learnt online),
      dspread and offset (degrees), spread_of_size and offset_of_size (shares of a box's deviation), parts (a share of
      the boxes), look_alikes, habit and look_alike_habit (two numbers joined by +), kept_for (seconds), kept_within
      (metres). They change `detector` if the config has none of its own.
    """
    found: dict[str, dict[str, Any]] = {
        part: {} for part in ("", "calibration", "detector", "target_motion", "answers")
    }
    for key, (part, name, read) in ((key, _OURS[key]) for key in settings):
        found[part][name] = read(key, settings[key])
    changes = found[""]
    if found["calibration"]:
        read_by = config.calibration or calibration or Calibration()
        changes["calibration"] = replace(read_by, scale_to_max=False, **found["calibration"])
    if found["detector"]:
        changes["detector"] = replace(config.detector or detector or DetectorModel(), **found["detector"])
    for part in ("target_motion", "answers"):
        changes[part] = replace(getattr(config, part), **found[part])
    return replace(config, **changes)


def _filter(base: str, settings: dict[str, str], rng: np.random.Generator) -> Steers:
    if unknown := [key for key in settings if key not in SETTINGS[base]]:
        raise KeyError(unknown[0])
    state: Any = _FILTERS[base](rng)
    changes: dict[str, Any] = {key: _number(key, text) for key, text in settings.items()}
    if reading := {key: changes.pop(key) for key in _READING if key in changes}:
        changes["calibration"] = replace(state.calibration, **reading)
    return FilterMethod(replace(state, **changes) if changes else state)


_FILTERS: dict[str, Callable[[np.random.Generator], DirectionFilter]] = {
    "plain": lambda rng: Plain(),
    "centroid": lambda rng: Centroid(),
    "cent_circ": lambda rng: CircularCentroid(),
    "grid": lambda rng: GridFilter(),
    "best_detection": lambda rng: BestDetection(),
    "last_detection": lambda rng: LastDetection(),
    "vmf": lambda rng: VonMisesFisherFilter(),
    "grid_filter": lambda rng: HistogramFilter(),
    "particle_filter": lambda rng: ParticleFilter.uniform(PARTICLES, rng),
}


FITTED: dict[str, dict[str, str]] = {
    "scout": {  # the von Mises-Fisher filter did best with its defaults, in 48 trials each
        "grid_filter": "floor=0.326,neutral=0.127,temperature=7.34,diffusion=6.54,mixing=0.00291",
        "particle_filter": "floor=0.326,neutral=0.127,temperature=7.34,roughening=4.4,reborn=0.032,kernel=4.21",
    },
    "truth": {
        "vmf": "floor=0.125,neutral=0.144,temperature=1.47,noise=11.6",
        "grid_filter": "floor=0.175,neutral=0.0153,temperature=1.74,diffusion=6.96,mixing=2.85e-05",
        "particle_filter": "floor=0.0543,neutral=0.0909,temperature=1.39,roughening=2.29,reborn=0.00461,kernel=7.83",
    },
}


def fitted(perception: str, base: str) -> str:
    """The fitted settings of a method for a perception, "" if there are none."""
    return FITTED.get(perception.partition(":")[0], {}).get(base, "")
