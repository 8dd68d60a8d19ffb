"""The agents of H*Bench: ours, a fixed sweep, the model alone, single-view baselines, and one that knows.

An agent gets the current view, may look, and returns an action. At every turn it also returns the answer that it would
submit if the episode ended there, so that success by turn needs no further runs. Those that look are given a
`Detector`: any perception, or ``truth``, a simulated detector of known quality based on the annotations.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from msgspec import Meta
from scipy.ndimage import convolve1d

from eagor._arrays import to_numpy
from eagor.baselines import Centroid, HistogramFilter
from eagor.belief import Belief
from eagor.conventions import hstar_from_direction
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.coverage import looked_at
from eagor.evidence.detections import resolved
from eagor.evidence.shapes import MIN_SPREAD
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.harmonics.peaks import decoding_grid
from eagor.lab.agents.steering import next_heading
from eagor.lab.tasks import hstar
from eagor.lab.tasks.hstar import HFOV_DEG, PITCH_TOLERANCE, YAW_TOLERANCE, View
from eagor.lab.tasks.published import PublishedConfig, Recalibrate, first_known
from eagor.perception import Perception
from eagor.perception.partial import coverage, infer_view
from eagor.perception.truth import Noise, Report, displaced, render_response
from eagor.perception.vlm import Chat, Message
from eagor.sphere import world_R_body
from eagor.tracking.next_view import even_and_usual, information

AGENTS = {
    "eagor": "one belief over all directions from all views; looks where it expects to learn most, submits when sure",
    "vlm": "the model alone, shown view after view, answers with actions",
    "centroid": "submits the mean pixel of the first view that responds; follows a fixed sweep until then",
    "grid": "a Bayes filter on a grid of directions, over the fixed sweep",
    "sweep": "ten views in a fixed order, then the best single response of them",
    "single": "submits what the first view says",
    "oracle": "knows the answer; submits it at once",
}
LOOKING = ("eagor", "centroid", "grid", "sweep", "single")
# Offsets in yaw from the start, and pitches, degrees: around the horizon first, then below, then above.
SWEEP = ((0, 0), (90, 0), (180, 0), (270, 0), (0, -45), (120, -45), (240, -45), (0, 45), (120, 45), (240, 45))
RESPONDS = 0.3  # response from which on a per-view agent counts a detection
CALIBRATION = Calibration(floor=0.125, neutral=0.124, temperature=2.59)  # of truth; tuned as ours was


# Tuned on development apartments (random trials, benchmarks/search.py --fit of commit 5a35d191): the model of a look
# and the probability that is stated; the prior on development scenes with things at all heights.
DEGREE = 15  # of the harmonics
HIT, ALARM = 0.7, 0.2  # model of a look: probabilities of a detection of a target in view, and of a false alarm
# Share of a look that repeats the one before, as a model's errors persist; of the one before that, its square; ...
REPEATS = 0.48
HEIGHT, TILT = -15.0, 20.0  # degrees: mean and standard deviation of the elevation where things usually are
SURE, ELSEWHERE = 0.95, 0.5  # defaults of the settings of these names
# Of the probability stated for a window with the share p of the belief: logit(stated) = SHIFT + SLOPE logit(p) (Platt
# 1999), by the log score at each of ten turns. Looks are read cautiously, so the belief is underconfident.
SHIFT, SLOPE = 1.44, 1.24

STEP = 5  # degrees: cells of the map for planning and decisions
CELLS = PatchGrid(180 // STEP, 360 // STEP)
YAWS = np.arange(0, 360, 15)
PITCHES = (-60, -30, 0, 30, 60)
# Of the views that are weighed: azimuth and elevation ``(n, 2)``, radians, world frame.
HEADINGS = np.radians([(-yaw, pitch) for pitch in PITCHES for yaw in YAWS])


class HStarConfig(PublishedConfig, kw_only=True):
    """The settings of a run of H*Bench."""

    scoring: Annotated[hstar.Scoring, Meta(description="what counts as success")] = "official"
    turns: Annotated[int, Meta(ge=1, le=50, description="views at most; the benchmark allows ten")] = hstar.MAX_TURNS
    sure: Annotated[float, Meta(gt=0, le=1, description="probability of success from which on eagor submits")] = SURE
    elsewhere: Annotated[float, Meta(gt=0, le=1, description="share of eagor's prior that is even")] = ELSEWHERE
    resolution: Annotated[int, Meta(ge=18, le=8640, description="rows of a view; 1080 is official")] = hstar.RESOLUTION
    window: Annotated[int, Meta(ge=1, le=50, description="turns of conversation that the model is shown")] = 5


class ViewEvidence(NamedTuple):
    """The evidence of one view, and the pose ``(3, 3)`` of its frame."""

    evidence: Evidence
    world_R_capture: np.ndarray

    def response(self) -> np.ndarray:
        """The response ``(H, W)``, -1 in cells that were not looked at."""
        response, seen = to_numpy(self.evidence.response).astype(np.float64), self.evidence.seen
        return response if seen is None or not seen[-1] else np.where(looked_at(seen), response, -1.0)

    def middle(self) -> np.ndarray:
        """Direction ``(3,)``, world frame, of the middle cell of the part that was looked at."""
        rows, columns = np.nonzero(self.response() >= 0)
        nearest = int(np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2))
        return self.world_R_capture @ np.asarray(self.evidence.grid.directions[rows[nearest], columns[nearest]])

    def peak(self) -> tuple[np.ndarray, float]:
        """Direction ``(3,)``, world frame, and value of the response's maximum; the middle of the view if flat."""
        response = self.response()
        if np.ptp(response[response >= 0]) < 1e-6:
            return self.middle(), max(float(response.max()), 0.0)
        place = np.unravel_index(int(response.argmax()), response.shape)
        return self.world_R_capture @ np.asarray(self.evidence.grid.directions[place]), float(response.max())

    def notes(self) -> dict[str, Any]:
        """The strongest response and its source, for the record."""
        direction, height = self.peak()
        yaw, pitch = hstar_from_direction(direction)
        peak = {"yaw": round(float(yaw), 1), "pitch": round(float(pitch), 1), "score": round(height, 3)}
        return {"peak": peak} | ({"source": dict(source)} if (source := self.evidence.source) else {})


Detector = Callable[[View], ViewEvidence]  # for the target of one episode


def open_detector(
    perception: Perception | Noise,
    episode: hstar.Episode,
    seed: int,
    resolution: int = hstar.RESOLUTION,
    read: Recalibrate = lambda evidence: evidence,
) -> Detector:
    """A perception, or the noise of ``truth``, for one episode; `seed`: of truth's mistakes, `read`: recalibrates.

    A perception sees the view as the benchmark draws it, with the cross filled in: it is no evidence.
    """
    if isinstance(perception, Noise):
        yaw, pitch = episode.item["yaw"], episode.item.get("pitch")
        luck = [seed, zlib.crc32(episode.id.encode())]  # independent of all other cases
        detect = SimulatedDetector(yaw, pitch, perception, luck)
        return lambda view: (look := detect(view))._replace(evidence=read(look.evidence))

    def look(view: View) -> ViewEvidence:
        panorama = hstar.open_panorama(episode.panorama)
        image = hstar.without_cross(hstar.render_view(panorama, view.yaw, view.pitch, resolution))
        upright = world_R_body(0.0, -math.radians(view.pitch))  # a body that faces where the view does
        grid = PerspectiveGrid(image.shape[0], image.shape[1], math.radians(HFOV_DEG), upright)
        _, evidence = first_known(episode.item["task"], lambda query: infer_view(perception, image, grid, query))
        return ViewEvidence(read(evidence), world_R_body(-math.radians(view.yaw)))

    return look


LENS = PerspectiveGrid(27, 48, math.radians(HFOV_DEG))  # the cells of truth's response: 2 degrees in the middle
NARROWEST = resolved(DEGREE)  # radians, standard deviation of truth's reports: what a belief can hold
WHOLE = 0.5  # visible share of a box from which on it is detected as well as a whole one


class SimulatedDetector:
    """A detector of known quality in one episode, which remembers its mistakes from look to look.

    The noise is that of simulated worlds (`eagor.perception.truth.Noise`), but detection depends on the visible part of
    the target's box, and a false alarm lies anywhere in the view and stays there in the world. Each look draws the same
    number of random values: agents that look elsewhere get the same draws.
    """

    def __init__(
        self, yaw: tuple[float, float], pitch: tuple[float, float] | None, noise: Noise, seed: int | list[int]
    ) -> None:
        self._points, self._noise, self._rng = hstar.box_points(yaw, pitch), noise, np.random.default_rng(seed)
        self._persistence = 0.0  # of the first look, which has nothing to keep
        # Of the target and of the false alarm, from 0 to 1: reported or not, score, place in the view (of the false
        # alarm); and the error, standard normal, in the world's axes.
        self._luck = np.zeros((2, 7))
        self._alarm: np.ndarray | None = None  # direction of the false alarm in the world, once a view had it

    def __call__(self, view: View) -> ViewEvidence:
        response = render_response(self.reports(view), LENS, self._noise.floor)
        return ViewEvidence(Evidence.from_response(response, LENS, CALIBRATION), view.world_R_view)

    def reports(self, view: View) -> list[Report]:
        """The next look as a list of reports, in the view's own frame. Mistakes persist or are drawn anew."""
        draws = np.hstack([self._rng.random((2, 5)), self._rng.standard_normal((2, 3))])
        fresh = draws[:, 0] >= self._persistence
        self._persistence, self._luck[fresh] = self._noise.persistence, draws[fresh, 1:]
        if fresh[1]:
            self._alarm = None
        noise, pose, reports = self._noise, view.world_R_view, []
        visible, (target, alarm) = view.shows(self._points), self._luck
        share = min(1.0, float(visible.mean()) / WHOLE)
        if visible.any() and target[0] < (1 - noise.miss) * share:
            error = pose.T @ target[4:] * noise.spread
            reports.append(self._report("found", target[1], self._points[visible] @ pose, error))
        if alarm[0] < noise.false_alarm:
            if self._alarm is None:
                self._alarm = pose @ LENS.unproject(*(alarm[2:4] * (LENS.width, LENS.height)))
            if view.shows(self._alarm[None])[0]:
                reports.append(self._report("false alarm", alarm[1], (self._alarm @ pose)[None], np.zeros(3)))
        return reports

    def _report(self, kind: str, luck: float, points: np.ndarray, error: np.ndarray) -> Report:
        """A report of a thing at `points` ``(n, 3)``, displaced by `error` ``(3,)``."""
        centre = points.mean(axis=0)
        centre /= np.linalg.norm(centre)
        offsets = points - (points @ centre)[:, None] * centre
        placed, carry = displaced(centre, error)
        # Narrower, a belief could not hold it, and the report would say less the sharper it is.
        width = max(self._noise.spread**2 + MIN_SPREAD**2, NARROWEST**2)
        covariance = carry @ (offsets.T @ offsets / len(points)) @ carry.T
        covariance = covariance + width * (np.eye(3) - np.outer(placed, placed))
        score = self._noise.weakest + (1 - self._noise.weakest) * float(luck)
        return Report(kind, None, placed, covariance, score)


class Answer(NamedTuple):
    """A submission in whole degrees, and its probability of success according to the belief, NaN if it has none."""

    yaw: int
    pitch: int
    probability: float = math.nan


# An action (None: an invalid one), the answer that it would submit now, and notes for the record.
Turn = tuple[hstar.Action | None, Answer, Mapping[str, Any]]
Agent = Callable[[View, bool], Turn]  # the turn at this view; True: it is the last one


def make_agent(
    config: HStarConfig, episode: hstar.Episode, detector: Detector | None = None, chat: Chat | None = None
) -> Agent:
    """The agent of a run for one episode; those in `LOOKING` need a detector, the one that talks a model."""
    if chat is not None:
        return VlmAgent(episode, chat, config.window, config.resolution)
    if detector is None:
        answer = _answer(hstar.middle_of(episode.item), 1.0)
        return lambda view, last: (hstar.Action("submit", *answer[:2]), answer, {})
    if config.agent == "eagor":
        return EagorAgent(episode.kind, detector, config.sure, config.elsewhere)
    return SweepAgent(config.agent, episode.start, detector)


def _answer(at: Any, probability: float = math.nan) -> Answer:
    return Answer(round(float(at[0])) % 360, round(float(at[1])), probability)


def _rotate(now: View, yaw: float, pitch: float) -> hstar.Action:
    """The rotation from a view to a direction, the short way around."""
    return hstar.Action("rotate", round((yaw - now.yaw + 180) % 360 - 180), round(pitch - now.pitch))


class EagorAgent:
    """Our agent: looks where that tells most, and submits the window with the most belief if it is `sure`.

    It keeps a belief about the target's direction in the world frame. Directions that were looked at without a response
    lose belief, others keep theirs. What a view tells is the mutual information between the outcome of the look and the
    direction. Per cell of `CELLS`: `prior`, up to a factor (a share `elsewhere` is even over the sphere; the rest has a
    normal density in the elevation; for paths all is even); `shown`, the visible fraction so far; `stale`, the fraction
    of the next look that repeats earlier ones. A look counts for less towards the border of its view.
    """

    def __init__(self, kind: hstar.Kind, detector: Detector, sure: float = SURE, elsewhere: float = ELSEWHERE) -> None:
        self._kind, self._detector, self._sure = kind, detector, sure
        elevations = np.degrees(CELLS.latitudes)[:, None]
        usual = even_and_usual(elevations, CELLS.weights, HEIGHT, TILT, elsewhere)
        self.prior, self.belief = CELLS.weights if kind == "hps" else usual, Belief.uniform(DEGREE)
        self.shown = self.stale = np.zeros(CELLS.shape)

    def __call__(self, view: View, last: bool) -> Turn:
        look = self._detector(view)
        self.update(look, view)
        answer = self.answer()
        sure, action = answer.probability >= self._sure, hstar.Action("submit", *answer[:2])
        if not (last or sure):
            to = next_heading(HEADINGS, self.tells(), np.radians([-view.yaw, view.pitch]))
            yaw, pitch = np.degrees(to).round(6).tolist()
            action = _rotate(view, -yaw, pitch)
        return action, answer, look.notes() | {"sure": sure}

    def update(self, look: ViewEvidence, view: View) -> None:
        """One more look, at this view. It counts for less where it repeats recent ones: a model's errors persist."""
        evidence, pose = look
        if not self.stale.any():
            self.belief = self.belief.update(evidence, pose)
        elif evidence.detections is None:
            new = self._new_at(evidence.grid.directions @ pose.T)
            self.belief = self.belief.update(replace(evidence, drawn=evidence.log_ratio * new), pose)
        else:
            basis, grid = self.belief.basis, decoding_grid(DEGREE)
            log_ratio = basis.synthesise(evidence.coefficients(DEGREE), grid) * self._new_at(grid.directions @ pose.T)
            self.belief = self.belief.plus(basis.rotate(basis.analyse(log_ratio, grid), pose))
        shares, weights = _shown_by(view)
        self.shown, self.stale = np.maximum(self.shown, shares), REPEATS * np.maximum(self.stale, weights)

    def _new_at(self, directions: np.ndarray) -> np.ndarray:
        """The fraction ``(...)`` of a look at directions ``(..., 3)`` of the world that is new."""
        x, y, _ = CELLS.project(directions)
        return 1 - self.stale[np.clip(y.astype(np.intp), 0, CELLS.height - 1), x.astype(np.intp) % CELLS.width]

    def probability(self) -> np.ndarray:
        """The probability of each cell of `CELLS` ``(H, W)``; sums to 1.

        The belief counts only where something was looked at: elsewhere it is ringing from its finite degree.
        """
        field = np.asarray(self.belief.log_ratio(CELLS)) * self.shown
        found = np.exp(field - field.max()) * self.prior
        return found / found.sum()

    def answer(self) -> Answer:
        """The submission whose window holds most of the belief, centred on that belief."""
        p, path = self.probability(), self._kind == "hps"
        high, wide = (CELLS.height if path else PITCH_TOLERANCE // STEP), YAW_TOLERANCE[self._kind] // STEP
        # What the smallest window around each cell holds; cells at its border count half.
        mass = _sums(p, np.r_[0.5, np.ones(2 * high - 1), 0.5], np.r_[0.5, np.ones(2 * wide - 1), 0.5])
        # Of equal windows the one with its belief in the middle.
        near = np.where(mass >= mass.max() - 1e-9, _sums(p, np.ones(3), np.ones(3)), -1.0)
        row, column = np.unravel_index(int(near.argmax()), p.shape)
        rows = np.arange(max(0, row - high), min(CELLS.height, row + high + 1))
        columns = np.arange(column - wide, column + wide + 1) % CELLS.width
        part, yaws = p[np.ix_(rows, columns)], -np.degrees(CELLS.longitudes)[columns]
        offset = (yaws - yaws[wide] + 180.0) % 360.0 - 180.0
        yaw = yaws[wide] + float((part * offset).sum() / part.sum())
        pitch = float((part * np.degrees(CELLS.latitudes)[rows][:, None]).sum() / part.sum())
        return _answer((yaw, 0.0 if path else pitch), stated(float(mass[row, column])))

    def tells(self) -> np.ndarray:
        """Expected information of looks at `HEADINGS` ``(n,)`` about the target's direction, nats."""
        p = self.probability()
        return np.concatenate([_information(p, 1 - self.stale, pitch) for pitch in PITCHES])


def stated(share: float) -> float:
    """The calibrated probability that the window with this share of the belief is right."""
    share = min(max(share, 1e-6), 1 - 1e-6)
    return 1 / (1 + math.exp(-SHIFT - SLOPE * math.log(share / (1 - share))))


def _information(p: np.ndarray, new: np.ndarray, pitch: float) -> np.ndarray:
    """Mutual information (nats) of a look with this pitch, for each of `YAWS`; `new`: the fraction of each cell's look.

    A target in view is reported with the probability `HIT`; else there is a false report, anywhere, with `ALARM`.
    """
    shown = _shown_by(View(0.0, float(pitch)))[1]
    rows, columns = np.nonzero(shown)
    places = (columns[None] + (YAWS // STEP)[:, None]) % CELLS.width  # cells in view, for each yaw
    here, share = p[rows[None], places], HIT * shown[rows, columns] * new[rows[None], places]
    area = CELLS.weights[rows, columns]
    return information(here, share, ALARM, area / area.sum())


@lru_cache(maxsize=256)
def _shown_by(view: View) -> tuple[np.ndarray, np.ndarray]:
    """The fraction of each cell ``(H, W)`` that a view shows, and its weight: less towards the border.

    The evidence of a view rises from its border as sin^2 and is full pi / (DEGREE + 1) inside.
    """
    rays, grid = CELLS.directions @ view.world_R_view, view.grid()
    half_width = math.tan(math.radians(HFOV_DEG) / 2)
    half_height = half_width * grid.height / grid.width
    to_sides = (half_width * rays[..., 0] - np.abs(rays[..., 1])) / math.hypot(1, half_width)
    to_ends = (half_height * rays[..., 0] - np.abs(rays[..., 2])) / math.hypot(1, half_height)
    depth = np.arcsin(np.clip(np.minimum(to_sides, to_ends), -1, 1))
    shares = coverage(*CELLS.shape, grid)
    return shares, shares * np.sin(np.clip(depth * (DEGREE + 1) / 2, 0, math.pi / 2)) ** 2


def _sums(p: np.ndarray, tall: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """The sums of `p` about each cell ``(H, W)``, with these weights of the rows and of the columns around it."""
    return convolve1d(convolve1d(p, wide, axis=1, mode="wrap"), tall, axis=0, mode="constant")


class VlmAgent:
    """Asks a `Chat`, which sees the last `window` turns. Until it submits, its answer is the camera's direction."""

    def __init__(self, episode: hstar.Episode, chat: Chat, window: int, resolution: int) -> None:
        self._episode, self._chat, self._resolution = episode, chat, resolution
        self._most = 2 * window - 1  # messages beside that of the system
        self._messages: list[Message] = []
        self._reply: hstar.Reply | None = None

    def __call__(self, view: View, last: bool) -> Turn:
        picture = hstar.render_view(hstar.open_panorama(self._episode.panorama), view.yaw, view.pitch, self._resolution)
        text = hstar.turn_text(self._episode.item["task"], view, self._reply)
        self._messages.append(Message("user", text, (picture,)))
        system = Message("system", hstar.system_text(self._episode.kind))
        reply = self._chat([system, *self._messages[-self._most :]])
        self._messages.append(Message("assistant", reply.text))
        self._reply = hstar.parse_action(reply.text)
        action, kept = self._reply.action, self._reply.format_correct
        notes = {"raw": reply.text, "format": kept, "valid": action is not None, "pixels": list(picture.shape[:2])}
        if reply.prompt_tokens is not None:
            notes["tokens"] = [reply.prompt_tokens, reply.completion_tokens]
        if action is not None and action.kind == "submit":
            return action, Answer(action.yaw, action.pitch), notes
        return action, _answer((view.yaw, view.pitch)), notes


class SweepAgent:
    """Looks along `SWEEP`, and submits after the last look what it reads then; `name` says how it reads.

    ``sweep``: the strongest response of all views so far. ``single``: that of the first view, at once. ``grid``: a
    Bayes filter on a grid of directions, fixed in the world. ``centroid``: the mean pixel of the first view that
    responds, at once; until then the middle of the view.
    """

    def __init__(self, name: str, start: float, detector: Detector) -> None:
        self._name, self._start, self._detector = name, start, detector
        self._left, self._filter = iter(SWEEP[1:]), HistogramFilter()
        self._best, self._strongest = np.zeros(3), -1.0

    def __call__(self, view: View, last: bool) -> Turn:
        look = self._detector(view)
        direction, done = self._read(look)
        answer = _answer(hstar_from_direction(direction))
        to = None if last or done else next(self._left, None)
        action = hstar.Action("submit", *answer[:2]) if to is None else _rotate(view, self._start + to[0], to[1])
        return action, answer, look.notes()

    def _read(self, look: ViewEvidence) -> tuple[np.ndarray, bool]:
        """The answer ``(3,)``, world frame, and whether to stop with it."""
        evidence, pose = look
        direction, height = look.peak()
        if self._name == "grid":
            turned = replace(self._filter, body_R_grid=pose.T, calibration=evidence.calibration)
            self._filter = turned.update(evidence)
            return pose @ self._filter.direction(), False
        if self._name == "centroid":
            if height < RESPONDS:
                return look.middle(), False
            # Without its lowest response, which would draw the mean towards the middle of the view.
            response = look.response()
            floor = max(0.5 * response.max(), float(response[response >= 0].min()) + 1e-6)
            high = np.clip(np.where(response < floor, 0.0, response), 0, 1)
            cleared = Evidence.from_response(high, evidence.grid, evidence.calibration)
            return pose @ Centroid().update(cleared).direction(), True
        if height > self._strongest + 1e-6:
            self._best, self._strongest = direction, height
        return self._best, self._name == "single"
