"""All estimators behind one interface: `move` to a pose of the odometry, `see` evidence, read the `direction`.

An estimator is named by text: ``eagor``, ``vmf``, or a variant such as ``eagor:degree=7,decode=mean``. Late evidence
counts for the time of its panorama: our tracker handles that itself, filters are rewound and replayed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from eagor import baselines
from eagor.baselines import GRID, DirectionFilter
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
MAX_DISTANCE_SPREAD = 0.6  # standard deviation of the logarithm of a distance that one can walk by
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


class Estimator(Protocol):
    """An estimator of the target's direction; a subclass without a belief inherits what that means for a search."""

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
        """Mass of the smallest credible region that contains `direction`; None without a distribution."""
        return None

    def distance(self) -> float | None:
        """Metres to the target; None without ranges."""
        return None

    def sure_distance(self) -> float | None:
        """`distance`, but None unless its logarithm is known to within `MAX_DISTANCE_SPREAD`."""
        return None

    def progress(self) -> float:
        """Metres nearer to the target, if it is here, per metre walked along `direction`; 1 without a belief."""
        return 1.0

    def presence(self) -> float:
        """Probability that the target is here; 1 for estimators that take that for granted."""
        return 1.0


@dataclass
class _Step:
    """One step of a filter: its pose, the filter before the evidence of that step, and that evidence."""

    stamp: float
    world_R_body: np.ndarray
    before: DirectionFilter
    evidence: list[Evidence] = field(default_factory=list)

    def after(self) -> DirectionFilter:
        state = self.before
        for evidence in self.evidence:
            state = state.update(evidence)
        return state


class FilterEstimator(Estimator):
    """A filter of `eagor.baselines`, with a bounded history of its steps for rewinding."""

    def __init__(self, filter: DirectionFilter) -> None:
        self.filter = filter
        self._steps: list[_Step] = []

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        if self._steps:
            self.filter = self.filter.predict(world_R_body.T @ self._steps[-1].world_R_body)
        self._steps = [*self._steps, _Step(stamp, world_R_body, self.filter)][-REWIND:]

    def see(self, evidence: Evidence) -> None:
        index = next((i for i, step in enumerate(self._steps) if step.stamp == evidence.stamp), None)
        if index is None:
            raise TimeError(f"evidence of t = {evidence.stamp} s fits none of the last {len(self._steps)} steps")
        last = self._steps[index]
        last.evidence.append(evidence)
        self.filter = last.after()
        for step in self._steps[index + 1 :]:
            step.before = self.filter.predict(step.world_R_body.T @ last.world_R_body)
            self.filter, last = step.after(), step

    def direction(self) -> np.ndarray:
        return np.asarray(self.filter.direction())

    def mass_above(self, direction: np.ndarray) -> float | None:
        if self._density is None:
            return None
        values, truth = self._density(GRID.directions), float(self._density(np.asarray(direction)[None])[0])
        return float(np.sum((np.exp(values) * GRID.weights)[values > truth]))

    def progress(self) -> float:
        if self._density is None:
            return 1.0
        mass = np.exp(self._density(GRID.directions)) * GRID.weights
        return float(np.sum(mass * (GRID.directions @ self.direction())))

    @property
    def _density(self) -> Any:
        return getattr(self.filter, "log_density", None)


class TrackerEstimator(Estimator):
    """Our tracker, or a variant of it."""

    def __init__(self, config: TrackerConfig) -> None:
        self.config, self._follower, self._now = config, Follower(config), 0.0

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        self._follower.move(stamp, world_R_body, position)
        self._now = stamp

    def see(self, evidence: Evidence) -> None:
        self._follower.look(evidence)

    @property
    def estimate(self) -> Estimate:
        """The tracker's answer at the last pose, computed once."""
        return self._follower.estimate(self._now)

    def direction(self) -> np.ndarray:
        found = self.estimate.direction
        return np.array(FORWARD) if found is None else found

    def mass_above(self, direction: np.ndarray) -> float | None:
        return self.estimate.mass_above(direction)

    def distance(self) -> float | None:
        return self.estimate.distance

    def sure_distance(self) -> float | None:
        spread = self.estimate.distance_spread
        return None if spread is None or spread > MAX_DISTANCE_SPREAD else self.estimate.distance

    def progress(self) -> float:
        return self.estimate.progress

    def presence(self) -> float:
        return self.estimate.presence


def default_methods(perception: str) -> tuple[str, ...]:
    """The estimators that are compared by default; with vision-language models also the plain model."""
    return EVERY if is_model(perception) else NAMES


def make_estimator(
    name: str,
    rng: np.random.Generator,
    perception: str = "",
    calibration: Calibration | None = None,
    ours: TrackerConfig | None = None,
    detector: DetectorModel | None = None,
) -> Estimator:
    """The estimator with this name; `rng` is for those that draw. Raises `EagorError` for an unknown name.

    A baseline starts from the settings fitted for `perception`, ours from `ours`, with its `calibration` or `detector`.
    """
    base, _, text = name.partition(":")
    if base not in EVERY:
        raise EagorError(
            f"there is no method {base!r}; known are {', '.join(EVERY)}, and variants such as eagor:degree=7"
        )
    try:
        settings = _settings(fitted(perception, base)) | _settings(text)
        known = _FILTERS[base][1] if base in _FILTERS else tuple(_OURS)
        if unknown := [key for key in settings if key not in known]:
            raise EagorError(f"there is no setting {unknown[0]!r}; known for {base}: {', '.join(known) or 'none'}")
        if base in _FILTERS:
            return FilterEstimator(_set(_FILTERS[base][0](rng), settings))
        config = TrackerConfig.paper() if base == "eagor_paper" else ours or TrackerConfig()
        return TrackerEstimator(tracker_config(config, settings, calibration, detector))
    except EagorError as error:
        raise EagorError(f"method {name!r}: {error}") from None


def answer_at(method: Estimator, stamp: float, pose: np.ndarray, evidence: Evidence | None) -> np.ndarray:
    """The estimator's direction ``(3,)`` at a `pose` ``(7,)`` of the odometry, given the evidence that has arrived."""
    method.move(stamp, rotation_from_wxyz(pose[3:]), pose[:3])
    if evidence is not None:
        method.see(evidence)
    return method.direction()


def _settings(text: str) -> dict[str, str]:
    pairs = [item.partition("=") for item in text.split(",") if item]
    found = {key: value for key, _, value in pairs}
    if any(not (key and equals and value) for key, equals, value in pairs) or len(found) < len(pairs):
        raise EagorError("wanted name:key=value,key=value, each key once, such as eagor:degree=7,decode=mean")
    return found


# --- the values of settings: each function reads a text, or raises ValueError ---------------------------------------

Read = Callable[[str], Any]
_ANGLES = ("noise", "diffusion", "roughening", "kernel", "wander", "turn", "spread", "dspread", "offset", "drift")


def _number(text: str) -> float:
    if math.isnan(found := float(text)):
        raise ValueError(text)
    return found


def _count(text: str) -> int:
    if (found := int(text)) < 0:
        raise ValueError(text)
    return found


def _shells(text: str) -> tuple[float, ...] | None:
    return tuple(log_ranges(count=count).tolist()) if (count := _count(text)) else None


def _heights(text: str) -> float | None:
    return (None, FLOOR)[_count(text)]


def _rate(text: str) -> float | None:
    return None if text == "?" else _number(text)


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(_number(each) for each in text.split("+"))


def _kinds(text: str) -> tuple[float, ...]:
    return () if _numbers(text) == (0.0,) else _numbers(text)


def _value(read: Read, key: str, text: str) -> Any:
    """The value of a setting, an angle in radians. Raises `EagorError`."""
    try:
        found = read(text)
    except (ValueError, IndexError):
        wanted = {_count: "a whole number, 0 or more", _shells: "a whole number, 0 or more", _heights: "0 or 1"}
        raise EagorError(f"{key} = {text}; wanted {wanted.get(read, 'a number')}") from None
    if key not in _ANGLES or found is None:
        return found
    return tuple(math.radians(angle) for angle in found) if isinstance(found, tuple) else math.radians(found)


_READING = ("floor", "neutral", "temperature")
_FILTERS: dict[str, tuple[Callable[[np.random.Generator], Any], tuple[str, ...]]] = {  # and their settings
    "plain": (lambda rng: baselines.Plain(), ()),
    "centroid": (lambda rng: baselines.Centroid(), ()),
    "cent_circ": (lambda rng: baselines.CircularCentroid(), ()),
    "grid": (lambda rng: baselines.GridFilter(), ()),
    "best_detection": (lambda rng: baselines.BestDetection(), ()),
    "last_detection": (lambda rng: baselines.LastDetection(), ()),
    "vmf": (lambda rng: baselines.VonMisesFisherFilter(), (*_READING, "noise")),
    "grid_filter": (lambda rng: baselines.HistogramFilter(), (*_READING, "diffusion", "mixing")),
    "particle_filter": (
        lambda rng: baselines.ParticleFilter.uniform(PARTICLES, rng),
        (*_READING, "roughening", "reborn", "kernel"),
    ),
}
# The settings of our tracker: the part of its configuration that each belongs to, its field there, and its reader.
_OURS: dict[str, tuple[str, str, Read]] = {
    "degree": ("", "degree", _count),
    "decode": ("answers", "decode", str),
    **{key: ("calibration", key, _number) for key in (*_READING, "persistence", "spread")},
    **{key: ("detector", key, _rate) for key in ("detection_probability", "false_alarms_per_look")},
    **{key: ("detector", key, _rate) for key in ("kept_for", "kept_within")},
    **{key: ("detector", key, _numbers) for key in ("habit", "look_alike_habit")},
    **{key: ("detector", key, _number) for key in ("look_alikes", "offset", "spread_of_size", "offset_of_size")},
    "parts": ("detector", "parts", _number),
    "dspread": ("detector", "spread", _number),
    "shells": ("", "ranges", _shells),
    "heights": ("", "floor_height", _heights),
    **{key: ("target_motion", key, _kinds) for key in ("wander", "turn")},
    **{key: ("target_motion", key, _number) for key in ("start", "stop", "jump", "birth", "death")},
    "drift": ("", "drift", _rate),
}


def _set(state: Any, settings: dict[str, str]) -> Any:
    """A filter with these settings."""
    changes = {key: _value(_number, key, text) for key, text in settings.items()}
    reading = {key: changes.pop(key) for key in _READING if key in changes}
    if reading:
        changes["calibration"] = replace(state.calibration, **reading)
    return replace(state, **changes)


def tracker_config(
    config: TrackerConfig,
    settings: dict[str, str],
    calibration: Calibration | None = None,
    detector: DetectorModel | None = None,
) -> TrackerConfig:
    """`config` with settings from text. Raises `EagorError` for a wrong value.

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
    found: dict[str, dict[str, Any]] = {}
    for key, text in settings.items():
        part, name, read = _OURS[key]
        found.setdefault(part, {})[name] = _value(read, key, text)
    changes = found.pop("", {})
    for part, values in found.items():
        own: Any = getattr(config, part)
        if part == "calibration":
            own, values["scale_to_max"] = own or calibration or Calibration(), False
        elif part == "detector":
            own = own or detector or DetectorModel()
        changes[part] = replace(own, **values)
    return replace(config, **changes)


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
    """The fitted settings of an estimator for a perception, "" if there are none."""
    return FITTED.get(perception.partition(":")[0], {}).get(base, "")
