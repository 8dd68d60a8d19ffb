"""Every method behind one face: told where the odometry believes the camera to be, fed evidence, asked for a direction.

A method is named by text: ``eagor``, ``vmf``, or a variant such as ``eagor:degree=7,decode=mean``. Late evidence counts
for the moment of its panorama: our tracker sees to that itself, filters are rewound and brought forward again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from eagor.baselines import (
    GRID,
    Centroid,
    CircularCentroid,
    DirectionFilter,
    GridFilter,
    HistogramFilter,
    ParticleFilter,
    Plain,
    VonMisesFisherFilter,
)
from eagor.calibration import Calibration
from eagor.detector import DetectorModel
from eagor.errors import EagorError, TimeError
from eagor.estimate import Estimate, TrackerConfig
from eagor.evidence import Evidence
from eagor.motion import MotionModel
from eagor.perception import is_model
from eagor.ranged import log_ranges
from eagor.sphere import FORWARD
from eagor.tasks.fitted import fitted
from eagor.tracker import DirectionTracker

PARTICLES = 2000
REWIND = 64  # steps that a filter can be rewound by
FLOOR = 0.0  # metres: z of the floor in the worlds' odometry
BASE = TrackerConfig(floor=FLOOR)  # our tracker, where nothing else is said

# What each is, for reports; the order of tables.
DESCRIPTIONS = {
    "centroid": "mean pixel of the response, frame by frame",
    "cent_circ": "the same, with a circular mean of the azimuth",
    "grid": "log responses on a pixel grid, resampled at each turn, read at the maximum",
    "eagor_paper": "EAGOR as published: degree 7, log(l + 0.001) scaled per frame, spherical mean",
    "vmf": "von Mises-Fisher filter: one direction and one concentration",
    "grid_filter": "Bayes filter on a grid of probabilities",
    "particle_filter": f"particle filter, {PARTICLES} directions",
    "eagor": "our tracker: direction and distance; absent, standing, wandering or turning; the heaviest mode",
}
NAMES = tuple(DESCRIPTIONS)
PLAIN = "plain"  # a model that is asked anew at each step, and nothing else: what vision-language models are without us
EVERY = (PLAIN, *NAMES)
ORACLE = "oracle"  # is told the true direction: the ceiling that geometry and policy leave


class Method(Protocol):
    """What estimates the direction of the target."""

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """The pose at `stamp`, as the odometry has it; every step once, before its evidence."""
        ...

    def see(self, evidence: Evidence) -> None:
        """Evidence, stamped with a time at which the method was moved, perhaps some steps ago."""
        ...

    def direction(self) -> np.ndarray:
        """The estimate ``(3,)``, in the body frame of the last pose; forward while nothing is known."""
        ...

    def mass_above(self, direction: np.ndarray) -> float | None:
        """Mass of the smallest credible region that reaches `direction`; None for methods without a distribution."""
        ...

    def distance(self) -> float | None:
        """Metres to the target; None for methods that do not know."""
        ...


@dataclass(frozen=True, eq=False)
class _Step:
    """A moment of a filter: its pose, and the filter just before the evidence of that moment, and that evidence."""

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray | None
    before: DirectionFilter
    looks: tuple[Evidence, ...] = ()

    def after(self) -> DirectionFilter:
        """The filter with this moment's evidence."""
        state = self.before
        for look in self.looks:
            state = state.update(look)
        return state


@dataclass
class FilterMethod:
    """A filter of `eagor.baselines`, with a bounded memory of its steps so that it can be rewound."""

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


def _carried(state: DirectionFilter, last: _Step, world_R_body: np.ndarray, position: np.ndarray | None) -> Any:
    """`state` after the motion from `last` to here."""
    known = position is not None and last.position is not None
    moved = world_R_body.T @ (position - last.position) if known else None  # type: ignore[operator]
    return state.predict(world_R_body.T @ last.world_R_body, moved)


@dataclass
class TrackerMethod:
    """Our tracker, or a variant of it."""

    tracker: DirectionTracker
    now: float = 0.0
    _estimate: Estimate | None = None

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        self.tracker.rotate(stamp, world_R_body, position if self.tracker.config.ranges is not None else None)
        self.now = stamp
        self._estimate = None

    def see(self, evidence: Evidence) -> None:
        self.tracker.observe(evidence)
        self._estimate = None

    @property
    def estimate(self) -> Estimate:
        """The tracker's answer at the last pose, computed once."""
        if self._estimate is None:
            self._estimate = self.tracker.estimate(self.now)
        return self._estimate

    def direction(self) -> np.ndarray:
        found = self.estimate.direction
        return np.array(FORWARD) if found is None else found

    def mass_above(self, direction: np.ndarray) -> float | None:
        return self.estimate.mass_above(direction)

    def distance(self) -> float | None:
        return self.estimate.distance


def default_methods(perception: str) -> tuple[str, ...]:
    """The methods that are compared where nothing else is said; with vision-language models the plain model as well."""
    return EVERY if is_model(perception) else NAMES


def make_method(
    name: str,
    rng: np.random.Generator,
    perception: str = "",
    calibration: Calibration | None = None,
    ours: TrackerConfig | None = None,
    detector: DetectorModel | None = None,
) -> Method:
    """The method that `name` says; `rng` is for those that draw. Raises `EagorError` for a name that is none.

    A rival starts from the settings fitted for `perception`, ours from `ours`, with its `calibration` or `detector`.
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
        return TrackerMethod(DirectionTracker(tracker_config(config, settings, calibration, detector)))
    except KeyError as error:
        known = ", ".join(SETTINGS[base]) or "none"
        raise EagorError(f"method {name!r}: there is no setting {error}; known for {base}: {known}") from None
    except EagorError as error:
        raise EagorError(f"method {name!r}: {error}") from None
    except ValueError as error:
        raise EagorError(f"method {name!r}: a setting wants a number ({error})") from None


def _settings(name: str, text: str) -> dict[str, str]:
    pairs = [item.partition("=") for item in text.split(",") if item]
    found = {key: value for key, _, value in pairs}
    if any(not (key and equals and value) for key, equals, value in pairs) or len(found) < len(pairs):
        raise EagorError(
            f"method {name!r}: wanted name:key=value,key=value, each key once, such as eagor:degree=7,decode=mean"
        )
    return found


def _numbers(settings: dict[str, str]) -> dict[str, float]:
    """Settings from text, angles in radians. Raises ValueError for what is no number."""
    return {key: _number(key, text) for key, text in settings.items()}


def _number(key: str, text: str) -> float:
    found = math.radians(float(text)) if key in _ANGLES else float(text)
    if math.isnan(found):
        raise ValueError(f"{key} = nan")
    return found


_READING = ("floor", "neutral", "temperature")
_REPEATING = (*_READING, "persistence", "persists_for", "persists_within", "spread")
_DETECTING = {  # of a detector's model, by their names here
    "pd": "detection_probability",
    "clutter": "false_alarms_per_look",
    "dspread": "spread",
    "repeats": "repeats",
    "repeats_for": "repeats_for",
    "repeats_within": "repeats_within",
}
_KINDS = ("wander", "turn")  # of moving targets
_MOVING = ("start", "stop", "jump", "birth", "death")
_OURS = ("degree", "decode", *_REPEATING, *_DETECTING, "shells", "heights", *_KINDS, *_MOVING, "drift")
_ANGLES = ("noise", "diffusion", "roughening", "kernel", *_KINDS, "spread", "dspread", "drift")  # typed in degrees
SETTINGS: dict[str, tuple[str, ...]] = {
    "plain": (),
    "centroid": (),
    "cent_circ": (),
    "grid": (),
    "eagor_paper": _OURS,
    "vmf": (*_READING, "noise"),
    "grid_filter": (*_READING, "diffusion", "mixing"),
    "particle_filter": (*_READING, "roughening", "reborn", "kernel"),
    "eagor": _OURS,
}


def tracker_config(
    config: TrackerConfig,
    settings: dict[str, str],
    calibration: Calibration | None = None,
    detector: DetectorModel | None = None,
) -> TrackerConfig:
    """`config` with settings from text; raises KeyError for one that there is not, ValueError for what is no number.

    - degree, decode; shells (0: directions only), heights (0: it is not known where the floor is);
    - of how targets move: wander (degrees per root second) and turn (degrees per second; several kinds are joined
      by +, 0: none), and start, stop, jump, birth, death (rates per second); drift (degrees per root second);
    - of how response maps are read: floor, neutral, temperature, persistence, persists_for (seconds), persists_within
      (metres), spread (degrees). They change `calibration` where the config has none of its own;
    - of how detections are read: pd, clutter (?: to be learnt), dspread (degrees), repeats, repeats_for (seconds),
      repeats_within (metres). They change `detector` where the config has none of its own.
    """
    if unknown := [key for key in settings if key not in _OURS]:
        raise KeyError(unknown[0])
    if settings.get("decode", "mode") not in ("mode", "mean"):
        raise EagorError(f"decode = {settings['decode']!r}; wanted mode or mean")
    learnt = [key for key in ("pd", "clutter") if settings.get(key) == "?"]
    numbers = _numbers({key: text for key, text in settings.items() if key not in ("decode", *_KINDS, *learnt)})
    changes: dict[str, Any] = {"motion": _motion(config.motion, settings, numbers)}
    if "drift" in numbers:
        changes["drift"] = numbers["drift"]
    if "degree" in numbers:
        changes["degree"] = _whole("degree", numbers)
    if "decode" in settings:
        changes["decode"] = settings["decode"]
    if "heights" in numbers:
        changes["floor"] = FLOOR if _whole("heights", numbers, 1) else None
    if "shells" in numbers:
        count = _whole("shells", numbers)
        changes["ranges"] = tuple(log_ranges(count=count).tolist()) if count else None
    if reading := {key: numbers[key] for key in _REPEATING if key in numbers}:
        read = config.calibration or calibration or Calibration()
        changes["calibration"] = replace(read, scale_to_max=False, **reading)
    detecting: dict[str, Any] = {name: numbers.get(key) for key, name in _DETECTING.items() if key in settings}
    if detecting:
        changes["detector"] = replace(config.detector or detector or DetectorModel(), **detecting)
    return replace(config, **changes)


def _motion(motion: MotionModel, settings: dict[str, str], numbers: dict[str, float]) -> MotionModel:
    """`motion` with the settings that are about it."""
    found: dict[str, Any] = {key: numbers[key] for key in _MOVING if key in numbers}
    for kind in (kind for kind in _KINDS if kind in settings):
        angles = tuple(_number(kind, text) for text in settings[kind].split("+"))
        found[kind] = () if angles == (0.0,) else angles
    return replace(motion, **found)


def _whole(key: str, numbers: dict[str, float], most: float = math.inf) -> int:
    """The setting of this name as a whole number from 0 to `most`. Raises `EagorError`."""
    if not (numbers[key].is_integer() and 0 <= numbers[key] <= most):
        wanted = "a whole number, 0 or more" if most == math.inf else f"a whole number from 0 to {most:g}"
        raise EagorError(f"{key} = {numbers[key]:g}; wanted {wanted}")
    return int(numbers[key])


def _filter(base: str, settings: dict[str, str], rng: np.random.Generator) -> Method:
    if unknown := [key for key in settings if key not in SETTINGS[base]]:
        raise KeyError(unknown[0])
    state: Any = _FILTERS[base](rng)
    numbers = _numbers(settings)
    changes: dict[str, Any] = {key: value for key, value in numbers.items() if key not in _READING}
    if reading := {key: numbers[key] for key in _READING if key in numbers}:
        changes["calibration"] = replace(state.calibration, **reading)
    return FilterMethod(replace(state, **changes) if changes else state)


_FILTERS: dict[str, Callable[[np.random.Generator], DirectionFilter]] = {
    "plain": lambda rng: Plain(),
    "centroid": lambda rng: Centroid(),
    "cent_circ": lambda rng: CircularCentroid(),
    "grid": lambda rng: GridFilter(),
    "vmf": lambda rng: VonMisesFisherFilter(),
    "grid_filter": lambda rng: HistogramFilter(),
    "particle_filter": lambda rng: ParticleFilter.uniform(PARTICLES, rng),
}
