"""Who searches: ours, the fixed sweep, those that answer from single views, and those that do not look.

An agent is told where the camera looks, may look, and says what it does. At every turn it also says what it would
submit if the episode ended there, so that success by turn needs no further runs.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from eagor._arrays import to_numpy
from eagor.baselines import Centroid, CircularCentroid, DirectionFilter, HistogramFilter
from eagor.conventions import hstar_from_direction
from eagor.tasks.hstar.camera import View
from eagor.tasks.hstar.data import Episode
from eagor.tasks.hstar.eyes import Eye, Look
from eagor.tasks.hstar.rules import Action, window_of
from eagor.tasks.hstar.search import Answer, Search, SearchRules

AGENTS = {
    "eagor": "one belief over all directions from every view; looks where most is to be learnt, submits when sure",
    "vlm": "the model alone, shown view after view, answers with actions",
    "centroid": "submits the mean pixel of the first view that responds; turns on by a fixed sweep until then",
    "cent-circ": "the same with a circular mean of the yaw",
    "grid": "a Bayes filter on a grid of directions, over the fixed sweep",
    "sweep": "ten views in a fixed order, then the best single response of them",
    "single": "submits what the first view says",
    "oracle": "told the answer; submits it at once",
    "random": "submits a random direction near the horizon at once",
    "constant": "submits straight ahead at once",
}
LOOKING = ("eagor", "centroid", "cent-circ", "grid", "sweep", "single")
# Offsets in yaw from the start, and pitches, degrees: around the horizon first, then below, then above.
SWEEP = ((0, 0), (90, 0), (180, 0), (270, 0), (0, -45), (120, -45), (240, -45), (0, 45), (120, 45), (240, 45))
RESPONDS = 0.3  # of a response: what a per-view agent takes for a detection


@dataclass(frozen=True)
class Turn:
    """What an agent does: an action (None: an invalid one), what it would submit now, and what to keep of it."""

    action: Action | None
    would: Answer | None
    notes: dict[str, Any] = field(default_factory=dict)


class Agent(Protocol):
    """Decides turn by turn."""

    def step(self, view: View, last: bool) -> Turn:
        """The move at this view; `last` says that no other will follow."""
        ...


def submit(answer: Answer) -> Action:
    """The submission of an answer."""
    return Action("submit", answer.yaw, answer.pitch)


def rotate(now: View, to: View) -> Action:
    """The turn from one view to another, the short way around."""
    return Action("rotate", round((to.yaw - now.yaw + 180) % 360 - 180), round(to.pitch - now.pitch))


class EagorAgent:
    """Ours: see `eagor.tasks.hstar.search`."""

    def __init__(self, episode: Episode, eye: Eye, rules: SearchRules) -> None:
        self._eye, self._rules = eye, rules
        self.search = Search.begin(episode.kind, rules)

    def step(self, view: View, last: bool) -> Turn:
        look = self._eye.look(view)
        self.search = self.search.seen(look.evidence, look.world_R_capture, view)
        answer = self.search.answer()
        notes = _peak(look) | {"sure": answer.probability >= self._rules.sure}
        if last or answer.probability >= self._rules.sure:
            return Turn(submit(answer), answer, notes)
        return Turn(rotate(view, self.search.next_view(view)), answer, notes)


class SweepAgent:
    """Looks along `SWEEP`, keeps what `read` makes of it, and submits after `views` of them or when it is content."""

    def __init__(self, episode: Episode, eye: Eye, reading: Reading, views: int = len(SWEEP)) -> None:
        self._eye, self._reading, self._start = eye, reading, episode.start
        self._views, self._turn = min(views, len(SWEEP)), 0

    def step(self, view: View, last: bool) -> Turn:
        look = self._eye.look(view)
        direction, content = self._reading(look)
        yaw, pitch = hstar_from_direction(direction)
        answer = Answer(round(float(yaw)) % 360, round(float(pitch)), float("nan"))
        self._turn += 1
        if last or content or self._turn >= self._views:
            return Turn(submit(answer), answer, _peak(look))
        to = View((self._start + SWEEP[self._turn][0]) % 360, SWEEP[self._turn][1])
        return Turn(rotate(view, to), answer, _peak(look))


Reading = Callable[[Look], tuple[np.ndarray, bool]]  # the answer ``(3,)`` in the world, and whether to stop with it


class BestView:
    """The strongest single response of all views so far; where there is none, the middle of the first view."""

    def __init__(self) -> None:
        self._best, self._direction = -1.0, np.zeros(3)

    def __call__(self, look: Look) -> tuple[np.ndarray, bool]:
        direction, height = peak_of(look)
        if height > self._best + 1e-6:
            self._best, self._direction = height, direction
        return self._direction, False


class PerView:
    """A per-frame baseline: content with the first view that responds."""

    def __init__(self, baseline: DirectionFilter, always: bool = False) -> None:
        self._baseline, self._always = baseline, always

    def __call__(self, look: Look) -> tuple[np.ndarray, bool]:
        _, height = peak_of(look)
        found = look.world_R_capture @ self._baseline.update(_without_floor(look)).direction()
        if height < RESPONDS:
            found = look.world_R_capture @ np.asarray(look.evidence.grid.directions[_middle(look)])
        return found, self._always or height >= RESPONDS


class SinglePeak:
    """The peak of the view, whatever it is."""

    def __call__(self, look: Look) -> tuple[np.ndarray, bool]:
        return peak_of(look)[0], True


class OnGrid:
    """A Bayes filter on a grid of directions, fixed in the world."""

    def __init__(self) -> None:
        self._filter: HistogramFilter | None = None

    def __call__(self, look: Look) -> tuple[np.ndarray, bool]:
        start = self._filter or HistogramFilter(calibration=look.evidence.calibration, mixing=1e-4)
        turned = HistogramFilter(
            start.log_map, look.world_R_capture.T, look.evidence.calibration, start.diffusion, start.mixing
        )
        self._filter = turned.update(look.evidence)
        return look.world_R_capture @ self._filter.direction(), False


class BlindAgent:
    """Submits one direction at once."""

    def __init__(self, answer: Answer) -> None:
        self._answer = answer

    def step(self, view: View, last: bool) -> Turn:
        return Turn(submit(self._answer), self._answer)


def make_agent(name: str, episode: Episode, eye: Eye | None, rules: SearchRules, views: int, seed: int) -> Agent:
    """The agent with this name for one episode; those in `LOOKING` need an eye."""
    if eye is not None:
        if name == "eagor":
            return EagorAgent(episode, eye, rules)
        readings: dict[str, Callable[[], Reading]] = {
            "sweep": BestView,
            "grid": OnGrid,
            "centroid": lambda: PerView(Centroid()),
            "cent-circ": lambda: PerView(CircularCentroid()),
            "single": SinglePeak,
        }
        return SweepAgent(episode, eye, readings[name](), views)
    if name == "oracle":
        window = window_of(episode.item)
        yaw, pitch = window.centre
        return BlindAgent(_inside(round(yaw) % 360, round(pitch)))
    if name == "random":
        rng = np.random.default_rng([seed, zlib.crc32(episode.id.encode())])
        return BlindAgent(Answer(int(rng.integers(360)), round(float(rng.normal(-10, 15))), float("nan")))
    return BlindAgent(Answer(round(episode.start) % 360, 0, float("nan")))


def peak_of(look: Look) -> tuple[np.ndarray, float]:
    """Where the response is highest ``(3,)``, in the world's frame, and how high; the middle of the view if flat."""
    response = _response(look)
    height = float(response.max())
    if np.ptp(response[response >= 0]) < 1e-6:
        place = _middle(look)
    else:
        place = np.unravel_index(int(response.argmax()), response.shape)
    return look.world_R_capture @ np.asarray(look.evidence.grid.directions[place]), max(height, 0.0)


def _response(look: Look) -> np.ndarray:
    """The response ``(H, W)``, -1 in cells that were not looked at."""
    response = to_numpy(look.evidence.response).astype(np.float64)
    return np.where(_looked_at(look), response, -1.0)


def _looked_at(look: Look) -> np.ndarray:
    from eagor.coverage import looked_at

    seen = look.evidence.seen
    if seen is None or not seen[-1]:
        return np.ones(look.evidence.grid.shape, dtype=bool)
    return looked_at(seen)


def _middle(look: Look) -> tuple[int, int]:
    """The cell in the middle of what was looked at."""
    rows, columns = np.nonzero(_looked_at(look))
    middle = rows.mean(), columns.mean()
    nearest = int(np.argmin((rows - middle[0]) ** 2 + (columns - middle[1]) ** 2))
    return int(rows[nearest]), int(columns[nearest])


def _without_floor(look: Look) -> Any:
    """The evidence with its lowest response taken as nothing: per-view means would lean towards the middle else."""
    from eagor.evidence import Evidence

    response = _response(look)
    floor = float(response[response >= 0].min())
    cleared = np.where(response < max(0.5 * response.max(), floor + 1e-6), 0.0, response)
    return Evidence.from_response(np.clip(cleared, 0, 1), look.evidence.grid, look.evidence.calibration)


def _peak(look: Look) -> dict[str, Any]:
    """The strongest response of a look, for the record."""
    direction, height = peak_of(look)
    yaw, pitch = hstar_from_direction(direction)
    peak = {"yaw": round(float(yaw), 1), "pitch": round(float(pitch), 1), "score": round(height, 3)}
    found: dict[str, Any] = {"peak": peak}
    source = getattr(look.evidence, "source", None)
    return found | ({"source": dict(source)} if source else {})


def _inside(yaw: int, pitch: int) -> Answer:
    return Answer(yaw, max(-90, min(90, pitch)), 1.0)
