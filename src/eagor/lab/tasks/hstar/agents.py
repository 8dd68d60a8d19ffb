"""The agents of H*Bench, what they see, how they play an episode, its record, and the cause of a failure.

Agents: ours, a fixed sweep, the model alone, single-view baselines, and blind ones. An agent gets the current view, may
look, and returns an action. At every turn it also returns the answer that it would submit if the episode ended there,
so that success by turn needs no further runs. Those that look are given a `Detector`: any perception, or ``truth``, a
simulated detector of known quality based on the annotations.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor._arrays import to_numpy
from eagor.baselines import Centroid, CircularCentroid, DirectionFilter, HistogramFilter
from eagor.conventions import direction_from_hstar, hstar_from_direction
from eagor.errors import EagorError, QueryError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.coverage import looked_at
from eagor.evidence.detections import resolved
from eagor.evidence.shapes import MIN_SPREAD
from eagor.grids import PerspectiveGrid
from eagor.lab.agents.models import digest, recalibrator, shared, shared_chat
from eagor.lab.agents.steering import Searcher
from eagor.lab.tasks.hstar.data import Episode, open_panorama
from eagor.lab.tasks.hstar.prompts import first_text, head_of, next_text, phrase_of, system_text, tag_of, thing_of
from eagor.lab.tasks.hstar.rules import (
    HFOV_DEG,
    MAX_TURNS,
    SCORINGS,
    Action,
    Reply,
    Scoring,
    View,
    box_points,
    checked_scoring,
    inside,
    parse_action,
    render_view,
    submit_succeeds,
    visible_share,
    window_of,
    without_cross,
)
from eagor.lab.tasks.hstar.search import Answer, Search, SearchRules
from eagor.lab.tasks.published import case_seed
from eagor.perception import Perception
from eagor.perception.partial import look_at_view
from eagor.perception.truth import Noise, Report, displaced, drawn
from eagor.perception.vlm import Chat, Message
from eagor.sphere import angular_distance, world_R_body

AGENTS = {
    "eagor": "one belief over all directions from all views; looks where it expects to learn most, submits when sure",
    "vlm": "the model alone, shown view after view, answers with actions",
    "centroid": "submits the mean pixel of the first view that responds; follows a fixed sweep until then",
    "cent-circ": "the same with a circular mean of the yaw",
    "grid": "a Bayes filter on a grid of directions, over the fixed sweep",
    "sweep": "ten views in a fixed order, then the best single response of them",
    "single": "submits what the first view says",
    "oracle": "knows the answer; submits it at once",
    "random": "submits a random direction near the horizon at once",
    "constant": "submits straight ahead at once",
}
LOOKING = ("eagor", "centroid", "cent-circ", "grid", "sweep", "single")
# Offsets in yaw from the start, and pitches, degrees: around the horizon first, then below, then above.
SWEEP = ((0, 0), (90, 0), (180, 0), (270, 0), (0, -45), (120, -45), (240, -45), (0, 45), (120, 45), (240, 45))
RESPONDS = 0.3  # response from which on a per-view agent counts a detection
# In order of precedence: the first that applies is the cause.
CAUSES = {
    "format": "no valid submission: replies could not be read",
    "budget": "no submission within the turns",
    "wrong_instance": "submitted another annotated target with the same noun",
    "stopped_wrongly": "an answer at an earlier turn would have succeeded",
    "never_in_view": "no part of the target was ever in view",
    "fusion_error": "some view's strongest response was at the target, the answer was not",
    "missed": "the target was in view and nothing responded there",
    "false_detection": "something else responded, or was taken for it",
}
NEAR = 25.0  # degrees from the answer: a response there counts as taken for the target
# Tuned on development apartments (benchmarks/search.py --fit of commit 5a35d191).
CALIBRATION = Calibration(floor=0.125, neutral=0.124, temperature=2.59)
LENS = PerspectiveGrid(27, 48, math.radians(HFOV_DEG))  # the cells of truth's response: 2 degrees in the middle
NARROWEST = resolved(15)  # radians, standard deviation of truth's reports: what a belief of the default degree holds
WHOLE = 0.5  # visible share of a box from which on it is detected as well as a whole one


# --- what an agent sees -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ViewEvidence:
    """The evidence of one view, and the pose ``(3, 3)`` of its frame."""

    evidence: Evidence
    world_R_capture: np.ndarray


Detector = Callable[[View], ViewEvidence]  # for the target of one episode


def open_perception(spec: str) -> Perception | Noise:
    """A perception, or the noise of ``truth``, ``truth:ideal``, ``truth:miss=0.3,spread=4``.

    A perception is made once per process. Raises `EagorError` if it cannot be made, and errors of its server.
    """
    name, _, text = spec.partition(":")
    return Noise.parse(text) if name == "truth" else shared(spec)


def open_detector(
    perception: Any,
    episode: Episode,
    seed: int,
    resolution: int,
    read: Callable[[Evidence], Evidence] = lambda evidence: evidence,
) -> Detector:
    """`perception` (from `open_perception`) for one episode; `seed`: of truth's mistakes, `read`: recalibrates."""
    if isinstance(perception, Noise):
        detect = SimulatedDetector(episode.yaw, episode.pitch, perception, case_seed(seed, episode.id))
    elif isinstance(perception, Perception):
        detect = _on_pixels(perception, episode, resolution)
    else:
        raise EagorError(f"the perception is a {type(perception).__name__}; wanted what open_perception returns")

    def recalibrated(view: View) -> ViewEvidence:
        look = detect(view)
        return replace(look, evidence=read(look.evidence))

    return recalibrated


def _on_pixels(perception: Perception, episode: Episode, resolution: int) -> Detector:
    """A perception that is shown the view as the benchmark draws it, with the cross filled in: it is no evidence.

    It is asked for the target in the task's words; a perception that knows only single nouns gets shorter phrases.
    """
    queries = list(dict.fromkeys((thing_of(episode.task), phrase_of(episode.task), head_of(episode.task))))

    def detect(view: View) -> ViewEvidence:
        image = without_cross(render_view(open_panorama(episode.panorama), view.yaw, view.pitch, resolution))
        upright = world_R_body(0.0, -math.radians(view.pitch))  # a body that faces where the view does
        grid = PerspectiveGrid(image.shape[0], image.shape[1], math.radians(HFOV_DEG), upright)
        while True:
            try:
                evidence = look_at_view(perception, image, grid, queries[0])
                return ViewEvidence(evidence, world_R_body(-math.radians(view.yaw)))
            except QueryError:
                if len(queries) == 1:
                    raise
                del queries[0]

    return detect


class SimulatedDetector:
    """A detector of known quality in one episode, which remembers its mistakes from look to look.

    The noise is that of simulated worlds (`eagor.perception.truth.Noise`), with two differences. Detection depends on
    the visible fraction of the target's box, and a false alarm lies anywhere in the view and stays there in the world.
    Each look draws the same number of random values: agents that look elsewhere get the same draws. Nothing is
    rendered.
    """

    def __init__(
        self, yaw: tuple[float, float], pitch: tuple[float, float] | None, noise: Noise, seed: int | list[int]
    ) -> None:
        self._points, self._noise = box_points(yaw, pitch), noise
        self._rng = np.random.default_rng(seed)
        self._started = False
        self._luck = np.zeros((2, 2))  # of the target and of the false alarm: reported or not, and the score
        self._error = np.zeros((2, 3))  # standard normal, in the world's axes
        self._place = np.zeros(2)  # of the false alarm in its view, 0 to 1
        self._alarm: np.ndarray | None = None  # its direction in the world, once a view had it

    def __call__(self, view: View) -> ViewEvidence:
        response = drawn(self.reports(view), LENS, self._noise.floor)
        return ViewEvidence(Evidence.from_response(response, LENS, CALIBRATION), view.world_R_view)

    def reports(self, view: View) -> list[Report]:
        """The next look as a list of reports, in the view's own frame."""
        self._advance()
        noise, world_R_view, reports = self._noise, view.world_R_view, []
        visible = inside(view, self._points)
        share = min(1.0, float(visible.mean()) / WHOLE)
        if visible.any() and self._luck[0, 0] < (1 - noise.miss) * share:
            centre, covariance = _moments(self._points[visible] @ world_R_view)
            error = world_R_view.T @ self._error[0] * noise.spread
            reports.append(self._report("found", 0, centre, covariance, error))
        if self._luck[1, 0] < noise.false_alarm:
            if self._alarm is None:
                x, y = self._place * (LENS.width, LENS.height)
                self._alarm = world_R_view @ LENS.unproject(np.array(x), np.array(y))
            if inside(view, self._alarm[None])[0]:
                at = self._alarm @ world_R_view
                reports.append(self._report("false alarm", 1, at, np.zeros((3, 3)), np.zeros(3)))
        return reports

    def _advance(self) -> None:
        """Advance by one look: mistakes persist or are drawn anew."""
        draws, error = self._rng.random((2, 5)), self._rng.standard_normal((2, 3))
        fresh = draws[:, 0] >= self._noise.persistence if self._started else np.ones(2, dtype=bool)
        self._luck[fresh], self._error[fresh] = draws[fresh, 1:3], error[fresh]
        if fresh[1]:
            self._place, self._alarm = draws[1, 3:5], None
        self._started = True

    def _report(self, kind: str, row: int, centre: np.ndarray, covariance: np.ndarray, error: np.ndarray) -> Report:
        placed, carry = displaced(centre, error)
        # Narrower, a belief could not hold it, and the report would say less the sharper it is.
        width = max(self._noise.spread**2 + MIN_SPREAD**2, NARROWEST**2)
        covariance = carry @ covariance @ carry.T + width * (np.eye(3) - np.outer(placed, placed))
        score = self._noise.weakest + (1 - self._noise.weakest) * float(self._luck[row, 1])
        return Report(kind, None, placed, covariance, score)


def _moments(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean direction ``(3,)`` of points ``(n, 3)``, and their covariance ``(3, 3)`` in the tangent plane there."""
    centre = points.mean(axis=0)
    centre /= np.linalg.norm(centre)
    offsets = points - (points @ centre)[:, None] * centre
    return centre, offsets.T @ offsets / len(points)


# --- agents -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Turn:
    """One turn: an action (None: an invalid one), the answer it would submit now, and notes for the record."""

    action: Action | None
    would: Answer
    notes: dict[str, Any] = field(default_factory=dict)


Agent = Callable[[View, bool], Turn]  # the turn at this view; True: it is the last one
Reading = Callable[[ViewEvidence], tuple[np.ndarray, bool]]  # answer ``(3,)``, world frame; whether to stop with it


def _submit(answer: Answer) -> Action:
    return Action("submit", answer.yaw, answer.pitch)


def _rotate(now: View, to: View) -> Action:
    """The rotation from one view to another, the short way around."""
    return Action("rotate", round((to.yaw - now.yaw + 180) % 360 - 180), round(to.pitch - now.pitch))


class EagorAgent:
    """Our agent: an `eagor.lab.agents.steering.Searcher` over the views of `eagor.lab.tasks.hstar.search`.

    Every turn of the camera costs one of the episode's turns, whatever its angle.
    """

    def __init__(self, kind: str, detector: Detector, rules: SearchRules) -> None:
        self._detector = detector
        self.searcher = Searcher(Search.begin(kind, rules), commit_threshold=rules.sure)

    def __call__(self, view: View, last: bool) -> Turn:
        look = self._detector(view)
        search = self.searcher.space = self.searcher.space.update(look.evidence, look.world_R_capture, view)
        answer = search.answer()
        to = self.searcher.face(view.heading, answer.probability)
        action = _submit(answer) if last or to is None else _rotate(view, View.facing(to))
        return Turn(action, answer, _peak(look) | {"sure": to is None})


class VlmAgent:
    """Asks a `Chat`, which sees the last `window` turns. Until it submits, its answer is the camera's direction."""

    def __init__(self, episode: Episode, chat: Chat, form: str, window: int, resolution: int) -> None:
        self._episode, self._chat, self._form, self._resolution = episode, chat, form, resolution
        self._most = 2 * window - 1  # messages beside that of the system
        self._system = Message("system", system_text(episode.kind, form))
        self._messages: list[Message] = []
        self._reply: Reply | None = None

    def __call__(self, view: View, last: bool) -> Turn:
        task, form = self._episode.task, self._form
        text = first_text(task, form) if self._reply is None else next_text(task, form, self._reply, view)
        picture = render_view(open_panorama(self._episode.panorama), view.yaw, view.pitch, self._resolution)
        self._messages.append(Message("user", text, (picture,)))
        messages = [self._system, *self._messages[-self._most :]]
        answer = self._chat(messages)
        self._messages.append(Message("assistant", answer.text))
        self._reply = parse_action(answer.text, form)
        action = self._reply.action
        notes: dict[str, Any] = {
            "raw": answer.text,
            "prompt": digest(messages),
            "format": self._reply.format_correct,
            "valid": action is not None,
            "pixels": list(picture.shape[:2]),
        }
        if answer.prompt_tokens is not None:
            notes["tokens"] = [answer.prompt_tokens, answer.completion_tokens]
        if action is not None and action.kind == "submit":
            return Turn(action, Answer(action.yaw, action.pitch, math.nan), notes)
        return Turn(action, Answer(round(view.yaw) % 360, round(view.pitch), math.nan), notes)


def blind(yaw: float, pitch: float, probability: float = math.nan) -> Agent:
    """Submits one direction immediately."""
    answer = Answer(round(yaw) % 360, round(pitch), probability)
    return lambda view, last: Turn(_submit(answer), answer)


def sweep(start: float, detector: Detector, read: Reading, views: int = len(SWEEP)) -> Agent:
    """Looks along `SWEEP`, passes each look to `read`, and submits after `views` looks or when `read` says so."""
    offsets = iter(SWEEP[1:views])

    def turn(view: View, last: bool) -> Turn:
        look = detector(view)
        direction, content = read(look)
        yaw, pitch = hstar_from_direction(direction)
        answer = Answer(round(float(yaw)) % 360, round(float(pitch)), math.nan)
        to = None if last or content else next(offsets, None)
        action = _submit(answer) if to is None else _rotate(view, View((start + to[0]) % 360, to[1]))
        return Turn(action, answer, _peak(look))

    return turn


def best_view() -> Reading:
    """The strongest single response of all views so far; without any, the middle of the first view."""
    best, where = -1.0, np.zeros(3)

    def read(look: ViewEvidence) -> tuple[np.ndarray, bool]:
        nonlocal best, where
        direction, height = peak_of(look)
        if height > best + 1e-6:
            best, where = height, direction
        return where, False

    return read


def per_view(baseline: DirectionFilter) -> Reading:
    """A per-frame baseline; it stops at the first view that responds."""

    def read(look: ViewEvidence) -> tuple[np.ndarray, bool]:
        if peak_of(look)[1] >= RESPONDS:
            return look.world_R_capture @ baseline.update(_without_floor(look)).direction(), True
        return look.world_R_capture @ np.asarray(look.evidence.grid.directions[_middle(look)]), False

    return read


def on_grid() -> Reading:
    """A Bayes filter on a grid of directions, fixed in the world."""
    state: HistogramFilter | None = None

    def read(look: ViewEvidence) -> tuple[np.ndarray, bool]:
        nonlocal state
        calibration = look.evidence.calibration
        start = state or HistogramFilter(calibration=calibration, mixing=1e-4)
        turned = HistogramFilter(
            start.log_map, look.world_R_capture.T, calibration, diffusion=start.diffusion, mixing=start.mixing
        )
        state = turned.update(look.evidence)
        return look.world_R_capture @ state.direction(), False

    return read


_READINGS: dict[str, Callable[[], Reading]] = {
    "sweep": best_view,
    "grid": on_grid,
    "centroid": lambda: per_view(Centroid()),
    "cent-circ": lambda: per_view(CircularCentroid()),
    "single": lambda: lambda look: (peak_of(look)[0], True),
}


def make_agent(
    name: str, episode: Episode, detector: Detector | None, rules: SearchRules, views: int, seed: int
) -> Agent:
    """The agent with this name for one episode, for agents that ask no model; those in `LOOKING` need a detector."""
    if detector is not None:
        if name == "eagor":
            return EagorAgent(episode.kind, detector, rules)
        return sweep(episode.start, detector, _READINGS[name](), views)
    if name == "oracle":
        yaw, pitch = window_of(episode.item).centre
        return blind(yaw, max(-90, min(90, pitch)), 1.0)
    if name == "random":
        rng = np.random.default_rng(case_seed(seed, episode.id))
        return blind(int(rng.integers(360)), float(rng.normal(-10, 15)))
    return blind(episode.start, 0)


def peak_of(look: ViewEvidence) -> tuple[np.ndarray, float]:
    """Direction ``(3,)`` in the world frame and value of the response's maximum; the middle of the view if flat."""
    response = _response(look)
    if np.ptp(response[response >= 0]) < 1e-6:
        place = _middle(look)
    else:
        place = np.unravel_index(int(response.argmax()), response.shape)
    direction = look.world_R_capture @ np.asarray(look.evidence.grid.directions[place])
    return direction, max(float(response.max()), 0.0)


def _peak(look: ViewEvidence) -> dict[str, Any]:
    """The strongest response of a look, for the record."""
    direction, height = peak_of(look)
    yaw, pitch = hstar_from_direction(direction)
    peak = {"yaw": round(float(yaw), 1), "pitch": round(float(pitch), 1), "score": round(height, 3)}
    source = look.evidence.source
    return {"peak": peak} | ({"source": dict(source)} if source else {})


def _response(look: ViewEvidence) -> np.ndarray:
    """The response ``(H, W)``, -1 in cells that were not looked at."""
    response, seen = to_numpy(look.evidence.response).astype(np.float64), look.evidence.seen
    return response if seen is None or not seen[-1] else np.where(looked_at(seen), response, -1.0)


def _middle(look: ViewEvidence) -> tuple[int, int]:
    """The middle cell of the part that was looked at."""
    rows, columns = np.nonzero(_response(look) >= 0)
    nearest = int(np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2))
    return int(rows[nearest]), int(columns[nearest])


def _without_floor(look: ViewEvidence) -> Evidence:
    """The evidence minus its lowest response; otherwise per-view means would be biased towards the middle."""
    response = _response(look)
    floor = float(response[response >= 0].min())
    cleared = np.where(response < max(0.5 * response.max(), floor + 1e-6), 0.0, response)
    return Evidence.from_response(np.clip(cleared, 0, 1), look.evidence.grid, look.evidence.calibration)


# --- an episode and its record ----------------------------------------------------------------------------------------


def work(settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that plays each episode of a run with these settings; the perception is made once."""
    name, seed, resolution = settings["agent"], settings["seed"], settings["resolution"]
    perception = open_perception(settings["perception"]) if name in LOOKING else None
    chat = shared_chat(settings["model"]) if name == "vlm" else None
    rules, read = SearchRules.of(settings), recalibrator(settings)

    def do(payload: Mapping[str, Any]) -> dict[str, Any]:
        episode = Episode.from_json(payload["episode"])
        detector = None if perception is None else open_detector(perception, episode, seed, resolution, read)
        if chat is not None:
            agent: Agent = VlmAgent(episode, chat, settings["form"], settings["window"], resolution)
        else:
            agent = make_agent(name, episode, detector, rules, settings["views"], seed)
        return run_episode(episode, agent, settings["scoring"], settings["turns"], payload.get("siblings", ()))

    return do


def run_episode(
    episode: Episode, agent: Agent, scoring: str = "official", turns: int = MAX_TURNS, siblings: Any = ()
) -> dict[str, Any]:
    """The record of one episode; see `eagor.lab.tasks.published.Benchmark` for the common keys.

    `scoring` decides "score" and "by_turn" ("scores" has both); `turns`: views at most; `siblings`: the scene's other
    entries of annotation.json, for causes and tags.

    Each step has "turn", "view" (yaw, pitch), "shown" (visible fraction of the target), "action" (as text, None if
    invalid), "would" (its answer at this turn: yaw, pitch, official, strict, p), "ms", and the agent's notes.
    """
    way, view = checked_scoring(scoring), episode.first_view
    steps: list[dict[str, Any]] = []
    answer = None
    while answer is None and len(steps) < turns:
        began = time.perf_counter()
        turn = agent(view, len(steps) + 1 == turns)
        yaw, pitch, p = turn.would.yaw, turn.would.pitch, turn.would.probability
        succeeds = {each: submit_succeeds(episode.item, yaw, pitch, each) for each in SCORINGS}
        steps.append(
            {
                "turn": len(steps) + 1,
                "view": {"yaw": view.yaw, "pitch": view.pitch},
                "shown": round(visible_share(view, episode.yaw, episode.pitch), 3),
                "action": None if turn.action is None else str(turn.action),
                "would": {"yaw": yaw, "pitch": pitch, **succeeds, "p": None if math.isnan(p) else round(p, 4)},
                "ms": round(1000 * (time.perf_counter() - began), 2),
                **turn.notes,
            }
        )
        if turn.action is not None and turn.action.kind == "submit":
            answer = {"yaw": turn.action.yaw, "pitch": turn.action.pitch}
        view = view.after(turn.action)
    record = score_submission(episode, answer, way, siblings, steps)
    by_turn = [int(step["would"][way]) for step in steps]
    return record | {
        "scoring": way,
        "by_turn": by_turn + [int(record["score"])] * (turns - len(steps)),
        "views": len(steps),
        "stated": steps[-1]["would"]["p"] if answer is not None else None,
        "sure": bool(steps[-1].get("sure", False)) and answer is not None,
        "steps": steps,
    }


def score_submission(
    episode: Episode,
    answer: Mapping[str, Any] | None,
    scoring: Scoring,
    siblings: Any,
    steps: Sequence[Mapping[str, Any]],
    reason: str | None = None,
) -> dict[str, Any]:
    """The part of a record about the submission (None: none, for the `reason`), with the errors in degrees."""
    scores = dict.fromkeys(SCORINGS, 0.0)
    errors: dict[str, float | None] = {"yaw_error": None, "pitch_error": None, "error": None}
    if answer is not None:
        at = answer["yaw"], answer["pitch"]
        scores = {way: float(submit_succeeds(episode.item, *at, way)) for way in SCORINGS}
        middle = window_of(episode.item).centre
        turn = abs((at[0] - middle[0] + 180.0) % 360.0 - 180.0)
        lift = None if episode.pitch is None else round(abs(at[1] - middle[1]), 2)
        errors = {"yaw_error": round(turn, 2), "pitch_error": lift, "error": round(_apart(at, middle), 2)}
    reason = reason or ("submitted" if answer is not None else cause_of(episode.item, steps, None, (), scoring))
    cause = None
    if not scores[scoring]:
        cause = reason if answer is None else cause_of(episode.item, steps, answer, siblings, scoring)
    return {
        "case": episode.id,
        "cluster": episode.cluster,
        "level": episode.level_name,
        "tags": [tag_of(episode.item, siblings)],
        "words": episode.task,
        "start": episode.start,
        "target": {"yaw": list(episode.yaw), "pitch": None if episode.pitch is None else list(episode.pitch)},
        "score": scores[scoring],
        "scores": scores,
        "cause": cause,
        "reason": reason,
        "answer": answer,
        **errors,
    }


def cause_of(
    item: Mapping[str, Any],
    steps: Sequence[Mapping[str, Any]],
    answer: Mapping[str, Any] | None,
    others: Sequence[Mapping[str, Any]],
    scoring: Scoring,
) -> str:
    """The cause of a failure, one of `CAUSES`.

    `item` and `others` are entries of annotation.json, the target and the rest of its scene; `steps` and `answer` (None
    if there was none) are those of the record.
    """
    if answer is None:
        return "format" if any(step.get("valid") is False for step in steps) else "budget"
    at = answer["yaw"], answer["pitch"]
    same = [other for other in others if head_of(str(other["task"])) == head_of(str(item["task"]))]
    if any(window_of(other).contains(*at, "strict") for other in same):
        return "wrong_instance"
    if any((step.get("would") or {}).get(scoring) for step in steps):
        return "stopped_wrongly"
    if all(step["shown"] == 0 for step in steps):
        return "never_in_view"
    peaks = [step["peak"] for step in steps if "peak" in step]
    if not peaks:
        return "false_detection"
    loud = [(peak["yaw"], peak["pitch"]) for peak in peaks if peak["score"] >= RESPONDS]
    if any(window_of(item).contains(*peak, "strict") for peak in loud):
        return "fusion_error"
    return "false_detection" if any(_apart(peak, at) <= NEAR for peak in loud) else "missed"


def _apart(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Degrees between two directions (yaw, pitch) on the great circle."""
    ends = direction_from_hstar(*np.array([a, b], dtype=np.float64).T)
    return float(np.degrees(angular_distance(ends[0], ends[1])))
