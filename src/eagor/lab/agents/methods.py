"""All estimators behind one interface: `move` to a pose of the odometry, `see` evidence, read the `direction`.

An estimator is named by text: ``eagor``, ``vmf``, or a variant such as ``eagor:degree=7,decode=mean``. Late evidence
counts for the time of its panorama: our tracker handles that itself, filters are rewound and replayed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

import numpy as np

from eagor import baselines
from eagor.baselines import GRID, DirectionFilter
from eagor.belief.ranged import log_ranges
from eagor.errors import EagorError, TimeError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.perception import is_model
from eagor.sphere import FORWARD
from eagor.tracking import Estimate, MotionModel, TrackerConfig
from eagor.tracking.config import AnswerSettings
from eagor.tracking.refresh import Follower

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

    def belief(self) -> tuple[float, float, float | None]:
        """What steers a body: progress, presence, distance.

        Metres nearer to the target, if it is here, per metre walked along `direction`; the probability that it is here;
        metres to it, None unless their logarithm is known to within `MAX_DISTANCE_SPREAD`.
        """
        return 1.0, 1.0, None


class Oracle(Estimator):
    """Knows the target's true `state` (``info["truth"]``), or with `sign` -1 always says the opposite.

    It is the upper bound for geometry and policy. While the target is away, its last direction counts.
    """

    def __init__(self, sign: float = 1.0) -> None:
        self.sign, self.state, self._direction = sign, dict[str, Any](), np.array(FORWARD)

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        if self.state["present"]:
            self._direction = self.sign * self.state["direction"]

    def see(self, evidence: Evidence) -> None:
        pass

    def direction(self) -> np.ndarray:
        return self._direction

    def belief(self) -> tuple[float, float, float | None]:
        return 1.0, 1.0, float(self.state["distance"])


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
        if (density := getattr(self.filter, "log_density", None)) is None:
            return None
        values, truth = density(GRID.directions), float(density(np.asarray(direction)[None])[0])
        return float(np.sum((np.exp(values) * GRID.weights)[values > truth]))

    def belief(self) -> tuple[float, float, float | None]:
        if (density := getattr(self.filter, "log_density", None)) is None:
            return super().belief()
        mass = np.exp(density(GRID.directions)) * GRID.weights
        return float(np.sum(mass * (GRID.directions @ self.direction()))), 1.0, None


class TrackerEstimator(Estimator):
    """Our tracker, or a variant of it."""

    def __init__(self, config: TrackerConfig) -> None:
        self.config, self._follower, self._now = config, Follower(config), 0.0

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        self._follower.move(stamp, world_R_body, position)
        self._now = stamp

    def see(self, evidence: Evidence) -> None:
        self._follower.observe(evidence)

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

    def belief(self) -> tuple[float, float, float | None]:
        found, spread = self.estimate, self.estimate.distance_spread
        sure = spread is not None and spread <= MAX_DISTANCE_SPREAD
        return found.progress, found.presence, found.distance if sure else None


def default_methods(perception: str) -> tuple[str, ...]:
    """The estimators that are compared by default; with vision-language models also the plain model."""
    return EVERY if is_model(perception) else NAMES


def answer_at(
    method: Estimator, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None, evidence: Evidence | None
) -> np.ndarray:
    """The estimator's direction ``(3,)`` at a pose of the odometry, given the evidence that has arrived."""
    method.move(stamp, world_R_body, position)
    if evidence is not None:
        method.see(evidence)
    return method.direction()


# --- estimators by name, with settings --------------------------------------------------------------------------------

_READING = ("calibration.floor", "calibration.neutral", "calibration.temperature")
_FILTERS: dict[str, Callable[[], DirectionFilter]] = {
    "plain": baselines.Plain,
    "centroid": baselines.Centroid,
    "cent_circ": baselines.CircularCentroid,
    "grid": baselines.GridFilter,
    "best_detection": baselines.BestDetection,
    "last_detection": baselines.LastDetection,
    "vmf": baselines.VonMisesFisherFilter,
    "grid_filter": baselines.HistogramFilter,
}
# The settings of our tracker are the fields of its configuration and of its parts (of two parts with a field of one
# name the first, the other as detector.spread), but for shells=0: directions only; heights=0: the floor is not known.
_OWN = ("degree", "shells", "heights", "drift")
_PARTS = {
    "answers": AnswerSettings,
    "target_motion": MotionModel,
    "calibration": Calibration,
    "detector": DetectorModel,
}
_TRACKER = (*_OWN, *(f"{part}.{each.name}" for part, kind in _PARTS.items() for each in fields(kind)))
_DEGREES = ("noise", "diffusion", "roughening", "kernel", "wander", "turn", "spread", "offset", "drift")  # in radians
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
        if base in _FILTERS or base == "particle_filter":
            made: Any = _FILTERS[base]() if base in _FILTERS else baselines.ParticleFilter.uniform(PARTICLES, rng)
            own = [each.name for each in fields(made) if isinstance(getattr(made, each.name), float)]
            reading = _READING if hasattr(made, "calibration") else ()
            return FilterEstimator(_with_settings(made, settings, (*reading, *own), {}))
        config = TrackerConfig.paper() if base == "eagor_paper" else ours or TrackerConfig()
        parts = {"calibration": calibration or Calibration(), "detector": detector or DetectorModel()}
        return TrackerEstimator(_with_settings(config, settings, _TRACKER, parts))
    except EagorError as error:
        raise EagorError(f"method {name!r}: {error}") from None


def _settings(text: str) -> dict[str, str]:
    pairs = [item.partition("=") for item in text.split(",") if item]
    found = {key: value for key, _, value in pairs}
    if any(not (key and equals and value) for key, equals, value in pairs) or len(found) < len(pairs):
        raise EagorError("wanted name:key=value,key=value, each key once, such as eagor:degree=7,decode=mean")
    return found


def _with_settings(made: Any, settings: dict[str, str], known: tuple[str, ...], parts: dict[str, Any]) -> Any:
    """A filter or config with settings from text; `parts`: those it takes where it has none. Raises `EagorError`."""
    for key, text in settings.items():
        path = next((each for each in known if key in (each, each.rpartition(".")[2])), None)
        if path is None:
            names = ", ".join(each.rpartition(".")[2] for each in known)
            raise EagorError(f"there is no setting {key!r}; known: {names or 'none'}")
        part, _, name = path.rpartition(".")
        if name == "shells":
            count = _value(name, text, 0)
            made = replace(made, ranges=tuple(log_ranges(count=count).tolist()) if count else None)
        elif name == "heights":
            made = replace(made, floor_height=FLOOR if _value(name, text, 0) else None)
        else:
            owner = made if not part else getattr(made, part) or parts[part]
            if part == "calibration":
                owner = replace(owner, scale_to_max=False)
            owner = replace(owner, **{name: _value(name, text, getattr(owner, name))})
            made = replace(made, **{part: owner}) if part else owner
    return made


def _value(name: str, text: str, now: Any) -> Any:
    """The value of a setting, an angle in radians; `now`: the value that it replaces. Raises `EagorError`."""
    if isinstance(now, str):
        return text
    if text == "?":  # to be learnt
        return None
    if isinstance(now, int):
        if not text.isdecimal():
            raise EagorError(f"{name} = {text}; wanted a whole number, 0 or more")
        return int(text)
    try:
        numbers = [float(each) for each in text.split("+")]
    except ValueError:
        raise EagorError(f"{name} = {text}; wanted a number") from None
    numbers = [math.radians(number) if name in _DEGREES else number for number in numbers]
    if not isinstance(now, tuple):
        return numbers[0]
    return tuple(numbers) if any(numbers) else ()  # no such kind
