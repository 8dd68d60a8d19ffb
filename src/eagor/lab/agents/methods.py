"""All estimators behind one interface: `move` to a pose of the odometry, `see` evidence, read the `direction`.

An estimator is named by text: ``eagor``, ``vmf``, or a variant such as ``eagor:degree=7,decode=mean``. Late evidence
counts for the time of its panorama: our tracker handles that itself, filters are rewound and replayed.
"""

from __future__ import annotations

import math
from collections import defaultdict
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
        self.filter = last.before
        for step in self._steps[index:]:
            if step is not last:
                self.filter = step.before = self.filter.predict(step.world_R_body.T @ last.world_R_body)
            for each in step.evidence:
                self.filter = self.filter.update(each)
            last = step

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
        make, known = _FILTERS.get(base, (None, tuple(_PART_OF)))
        if unknown := [key for key in settings if key not in known]:
            raise EagorError(f"there is no setting {unknown[0]!r}; known for {base}: {', '.join(known) or 'none'}")
        if make is not None:
            return FilterEstimator(_with_settings(make(rng), settings))
        config = TrackerConfig.paper() if base == "eagor_paper" else ours or TrackerConfig()
        return TrackerEstimator(_with_settings(config, settings, calibration, detector))
    except EagorError as error:
        raise EagorError(f"method {name!r}: {error}") from None


def answer_at(method: Estimator, stamp: float, pose: np.ndarray, evidence: Evidence | None) -> np.ndarray:
    """The estimator's direction ``(3,)`` at a `pose` ``(7,)`` of the odometry, given the evidence that has arrived."""
    method.move(stamp, rotation_from_wxyz(pose[3:]), pose[:3])
    if evidence is not None:
        method.see(evidence)
    return method.direction()


# --- the settings of variants ----------------------------------------------------------------------------------------

_READING = ("floor", "neutral", "temperature")
# What makes each filter, and its settings.
_FILTERS: dict[str, tuple[Callable[[np.random.Generator], DirectionFilter], tuple[str, ...]]] = {
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
# The settings of our tracker, by the part of its configuration ("": itself). shells=0: directions only; heights=0: the
# floor's height is unknown; dspread: the spread of detections, spread: that of response maps.
_TRACKER = {
    "": ("degree", "shells", "heights", "drift"),
    "answers": ("decode",),
    "target_motion": ("wander", "turn", "start", "stop", "jump", "birth", "death"),
    "calibration": (*_READING, "persistence", "spread"),
    "detector": (
        "detection_probability", "false_alarms_per_look", "kept_for", "kept_within", "habit", "look_alike_habit",
        "look_alikes", "offset", "spread_of_size", "offset_of_size", "parts", "dspread",
    ),
}  # fmt: skip
_PART_OF = {key: part for part, keys in _TRACKER.items() for key in keys}
_FIELDS = {"shells": "ranges", "heights": "floor_height", "dspread": "spread"}  # those with another name
_DEGREES = ("noise", "diffusion", "roughening", "kernel", "wander", "turn", "spread", "dspread", "offset", "drift")
_SEVERAL = ("wander", "turn", "habit", "look_alike_habit")  # numbers joined by +; of motion, 0: no such kind
_LEARNT = ("drift", "detection_probability", "false_alarms_per_look", "kept_for", "kept_within")  # where they are ?


def _settings(text: str) -> dict[str, str]:
    pairs = [item.partition("=") for item in text.split(",") if item]
    found = {key: value for key, _, value in pairs}
    if any(not (key and equals and value) for key, equals, value in pairs) or len(found) < len(pairs):
        raise EagorError("wanted name:key=value,key=value, each key once, such as eagor:degree=7,decode=mean")
    return found


def _value(key: str, text: str) -> Any:
    """The value of a setting, an angle in radians. Raises `EagorError`."""
    if key == "decode":
        return text
    if text == "?" and key in _LEARNT:
        return None
    if key in ("degree", "shells", "heights"):
        count, most = int(text) if text.isdecimal() else -1, 1 if key == "heights" else math.inf
        if not 0 <= count <= most:
            raise EagorError(f"{key} = {text}; wanted {'0 or 1' if most == 1 else 'a whole number, 0 or more'}")
        if key == "heights":
            return FLOOR if count else None
        return count if key == "degree" else tuple(log_ranges(count=count).tolist()) if count else None
    try:
        numbers = tuple(float(each) for each in (text.split("+") if key in _SEVERAL else [text]))
    except ValueError:
        numbers = (math.nan,)
    if any(map(math.isnan, numbers)):
        raise EagorError(f"{key} = {text}; wanted a number")
    if key in _DEGREES:
        numbers = tuple(map(math.radians, numbers))
    if key not in _SEVERAL:
        return numbers[0]
    return () if key in ("wander", "turn") and numbers == (0.0,) else numbers


def _with_settings(
    made: Any,
    settings: dict[str, str],
    calibration: Calibration | None = None,
    detector: DetectorModel | None = None,
) -> Any:
    """A filter, or the configuration of a tracker, with settings from text. Raises `EagorError` for a wrong value.

    They change `calibration` and `detector` if it has none of its own.
    """
    changes: dict[str, dict[str, Any]] = defaultdict(dict)
    for key, text in settings.items():
        changes[_PART_OF.get(key, "")][_FIELDS.get(key, key)] = _value(key, text)
    own = changes.pop("", {})
    for part, values in changes.items():
        before: Any = getattr(made, part)
        if part == "calibration":
            before = replace(before or calibration or Calibration(), scale_to_max=False)
        elif part == "detector":
            before = before or detector or DetectorModel()
        own[part] = replace(before, **values)
    return replace(made, **own)


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
