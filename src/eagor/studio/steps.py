"""What a session believes, as a step of the page: our tracker, the other methods, and both as JSON and coefficients."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from eagor.drawing.words import STATUS, answer_in_words, far_in_words
from eagor.errors import EagorError, PoseError, TimeError
from eagor.evidence import Calibration, Evidence
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.sphere import angular_distance
from eagor.studio.density import DEGREE, MASS, Density, density_of
from eagor.studio.messages import Blob, rounded
from eagor.tasks.methods import DESCRIPTIONS, NAMES, Method, make_method
from eagor.tracking import DirectionTracker, Estimate, TrackerConfig

__all__ = [
    "OFFERED",
    "Following",
    "Rivals",
    "belief_of",
    "calibration_of",
    "error_deg",
    "estimate_json",
    "evidence_of",
    "modes_json",
    "stage",
    "warm",
]

FLOATS = "float32"


def estimate_json(estimate: Estimate, entropy: float) -> dict[str, Any]:
    """The answer, in the body frame; angles in radians."""
    e = estimate
    known = e.direction is not None
    near = known and e.status != "searching"
    return rounded(
        {
            "direction": e.direction,
            "azimuth": e.azimuth,
            "elevation": e.elevation,
            "credible_angle": e.credible_angle if known else None,
            "presence": e.presence,
            "entropy": entropy,
            "distance": e.distance if near else None,
            "distance_spread": e.distance_spread if near else None,
            "moving": e.moving,
            "status": e.status,
            "words": in_words(e),
        }
    )


def in_words(estimate: Estimate) -> str:
    """The answer in a sentence: where, how far, how sure."""
    e = estimate
    if e.direction is None:
        return "No direction is known yet."
    where, far = answer_in_words(e), far_in_words(e)
    cone = f"90 % within {math.degrees(e.credible_angle):.0f} degrees"
    parts = [where, *([f"{far} away"] if far else []), cone]
    said = f"{', '.join(parts)}. Presence {100 * e.presence:.0f} %, {e.status}: {STATUS[e.status]}."
    return said[0].upper() + said[1:]


def modes_json(estimate: Estimate) -> list[dict[str, Any]]:
    """The candidates, heaviest first, in the body frame."""
    return [{"direction": rounded(mode.direction), "weight": rounded(mode.weight)} for mode in estimate.modes]


def belief_of(estimate: Estimate, stamp: float, degree: int = DEGREE) -> tuple[dict[str, Any], bytes]:
    """The belief of an estimate in world axes: what the header says of it, and its coefficients."""
    density = density_of(estimate.posterior, degree)
    mode = estimate.world_R_body @ estimate.modes[0].direction if estimate.modes else None
    return belief_json(density, stamp, mode), density.blob


def belief_json(density: Density, stamp: float, mode: np.ndarray | None) -> dict[str, Any]:
    """What the header says of a density; `mode` ``(3,)``: its heaviest candidate, in world axes."""
    return {
        "frame": "world",
        "stamp": rounded(stamp),
        "mass": MASS,
        "level": float(f"{density.level:.6g}"),
        "mode": rounded(mode),
        "terms": [{"weight": float(f"{term.weight:.6g}"), "degree": term.degree} for term in density.terms],
    }


def evidence_of(
    evidence: Evidence, world_R_body: np.ndarray, stamp: float, degree: int = DEGREE
) -> tuple[dict[str, Any], Blob]:
    """A look's log-likelihood ratio in world axes: what the header says of it, and its coefficients."""
    basis = RealHarmonics(degree)
    turned = np.asarray(basis.rotate(np.asarray(evidence.coefficients(degree)), world_R_body))
    header = {"degree": degree, "frame": "world", "stamp": rounded(stamp)}
    return header, Blob(FLOATS, turned.astype("<f4").tobytes())


def stage(estimate: Estimate, stamp: float, position: np.ndarray | None) -> dict[str, Any]:
    """The part of a step that says when and where the camera is."""
    return {
        "stamp": rounded(stamp),
        "world_R_camera": rounded(estimate.world_R_body.reshape(9), 6),
        "position": rounded(position, 4),
        "look": {"age": rounded(estimate.age, 3), "fresh": False},
    }


def error_deg(direction: np.ndarray | None, truth: np.ndarray | None) -> float | None:
    """The angle between an answer and the truth, degrees; None where either is not known."""
    if direction is None or truth is None:
        return None
    return round(math.degrees(float(angular_distance(direction, truth))), 2)


def calibration_of(perception: Any, config: TrackerConfig) -> dict[str, Any]:
    """How looks are read, in words and numbers: by the tracker's settings, else as the perception reads itself."""
    detector = config.detector or getattr(perception, "detector", None)
    calibration = config.calibration or getattr(perception, "calibration", None)
    source = "from the settings of this run" if config.detector or config.calibration else "the perception's own"
    if detector is not None:
        return {"words": f"Detections, read with a model of the detector ({source}).", "numbers": _numbers(detector)}
    if calibration is None:
        calibration, source = Calibration(), "the default"
    words = (
        f"Response maps, read with a calibration ({source}): evidence is temperature x log((response + floor) / "
        "(neutral + floor))."
    )
    return {"words": words, "numbers": _numbers(calibration)}


def _numbers(settings: Any) -> dict[str, Any]:
    found: Mapping[str, Any] = asdict(settings)
    return {
        key.replace("_", " "): rounded(value) if isinstance(value, float | int) else str(value)
        for key, value in found.items()
        if value is not None
    }


SOONEST = 0.05  # seconds between two computations, at least: every step, where the machine can bear it
LATEST = 1.0  # seconds after which the belief is computed anew without news: targets may come and go
HISTORY = 60.0  # seconds by which a look may be late: many pages share one eye
MOVED = 0.02  # metres of the camera that are worth a computation


@dataclass
class Following:
    """One query, followed with one configuration; stamps are seconds of the session.

    `belief` and `coefficients` are those of the newest computation; `news` says whether they have been taken.
    """

    config: TrackerConfig
    tracker: DirectionTracker = field(init=False)
    estimate: Estimate | None = None
    entropy: float = math.log(4 * math.pi)
    belief: dict[str, Any] = field(default_factory=dict)
    coefficients: bytes = b""
    news: bool = False
    took: float = 0.0  # seconds of the newest answer, if it was a computation
    _fresh: bool = True
    _at: np.ndarray | None = None
    _stamp: float = -math.inf

    def __post_init__(self) -> None:
        self.tracker = DirectionTracker(replace(self.config, history=max(self.config.history, HISTORY)))

    def pose(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """A pose of the camera; once for every stamp, in order."""
        self.tracker.add_pose(stamp, world_R_body, position)

    def look(self, evidence: Evidence) -> None:
        """A look, stamped with the time of a pose. One that comes later than the history reaches is left out."""
        with suppress(PoseError, TimeError):
            self.tracker.observe(evidence)
            self._fresh = True

    def answer(self, stamp: float, soonest: float = SOONEST) -> Estimate:
        """The estimate at the newest pose, computed anew not more often than every `soonest` seconds."""
        pose, position = self.tracker.pose_at(stamp)
        moved = position is not None and self._at is not None and float(np.linalg.norm(position - self._at)) > MOVED
        due = self.estimate is None or self._fresh or moved or stamp - self._stamp >= max(LATEST, soonest)
        self.took = 0.0
        if self.estimate is None or (due and stamp - self._stamp >= soonest):
            began = time.perf_counter()
            self.estimate = self.tracker.estimate(stamp)
            self.entropy = self.estimate.posterior.entropy()
            self.belief, self.coefficients = belief_of(self.estimate, stamp, self.config.degree)
            self._fresh, self._at, self._stamp, self.news = False, position, stamp, True
            self.took = time.perf_counter() - began
            return self.estimate
        return self.estimate.turned(stamp, pose)


def warm(config: TrackerConfig) -> None:
    """Make the tables that the first answers need, which take tenths of a second."""
    following = Following(config)
    for number in range(3):
        stamp = float(number)
        following.pose(stamp, np.eye(3), np.array([0.1 * number, 0.0, 1.25]))
        following.look(Evidence.from_points(np.array([[1.0, 0.1, 0.0]]), scores=np.full(1, 0.8), stamp=stamp))
        following.look(Evidence.from_response(np.full((32, 64), 0.1), ErpGrid(32, 64), stamp=stamp))
        estimate_json(following.answer(stamp, 0.0), following.entropy)


OURS = "eagor"
OFFERED = tuple({"name": name, "words": DESCRIPTIONS[name]} for name in NAMES if name != OURS)


@dataclass
class Rivals:
    """The chosen methods, with settings for `perception`. A method that is chosen late begins with the next look."""

    perception: str
    _methods: dict[str, Method] = field(default_factory=dict)
    _answers: dict[str, np.ndarray] = field(default_factory=dict)  # world frame
    _last: float = -np.inf

    def choose(self, names: Sequence[str]) -> None:
        """Keep those that are chosen still, begin the others. Unknown names are left out."""
        wanted = [name for name in NAMES if name in names and name != OURS]
        made = {}
        for name in wanted:
            made[name] = self._methods.get(name) or make_method(name, np.random.default_rng(0), self.perception)
        self._methods = made
        self._answers = {name: each for name, each in self._answers.items() if name in made}

    def look(
        self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None, looks: Sequence[Evidence]
    ) -> None:
        """A look from a pose; looks come in order of time."""
        if stamp <= self._last:
            return
        self._last = stamp
        for name, method in self._methods.items():
            try:
                method.move(stamp, world_R_body, position)
                for evidence in looks:
                    method.see(replace(evidence, stamp=stamp))
                self._answers[name] = world_R_body @ method.direction()
            except EagorError:  # it cannot read such evidence: it has no answer
                self._answers.pop(name, None)

    def answers(self, world_R_body: np.ndarray, truth: np.ndarray | None) -> dict[str, Any]:
        """Each one's direction in the body frame now, and its error, if the truth is known."""
        found = {name: world_R_body.T @ direction for name, direction in self._answers.items()}
        return {
            name: {"direction": rounded(direction), "error_deg": error_deg(direction, truth)}
            for name, direction in found.items()
        }
