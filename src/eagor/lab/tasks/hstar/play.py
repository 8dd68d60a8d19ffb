"""The agents of H*Bench, how they play an episode, its record, and the cause of a failure.

Agents: ours, a fixed sweep, the model alone, single-view baselines, and blind ones. An agent gets the current view, may
look, and returns an action. At every turn it also returns the answer that it would submit if the episode ended there,
so that success by turn needs no further runs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from eagor._arrays import to_numpy
from eagor.baselines import Centroid, CircularCentroid, DirectionFilter, HistogramFilter
from eagor.conventions import direction_from_hstar, hstar_from_direction
from eagor.evidence import Evidence
from eagor.evidence.coverage import looked_at
from eagor.lab.agents.models import digest, recalibrator, shared_chat
from eagor.lab.agents.steering import Searcher
from eagor.lab.tasks.hstar.data import Episode
from eagor.lab.tasks.hstar.perception import Eye, ViewEvidence, head_of, open_eye, open_perception, tag_of
from eagor.lab.tasks.hstar.prompts import Talk
from eagor.lab.tasks.hstar.rules import (
    MAX_TURNS,
    SCORINGS,
    Action,
    Scoring,
    View,
    checked_scoring,
    submit_succeeds,
    visible_share,
    window_of,
)
from eagor.lab.tasks.hstar.search import Answer, Search, SearchRules
from eagor.lab.tasks.published import case_seed
from eagor.perception.vlm import Chat
from eagor.sphere import angular_distance

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
Reading = Callable[[ViewEvidence], tuple[np.ndarray, bool]]  # answer ``(3,)``, world frame; whether to stop with it
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


@dataclass(frozen=True)
class Turn:
    """One turn: an action (None: an invalid one), the answer it would submit now, and notes for the record."""

    action: Action | None
    would: Answer
    notes: dict[str, Any] = field(default_factory=dict)


Agent = Callable[[View, bool], Turn]  # the turn at this view; True: it is the last one


def _submit(answer: Answer) -> Action:
    return Action("submit", answer.yaw, answer.pitch)


def _rotate(now: View, to: View) -> Action:
    """The rotation from one view to another, the short way around."""
    return Action("rotate", round((to.yaw - now.yaw + 180) % 360 - 180), round(to.pitch - now.pitch))


class EagorAgent:
    """Our agent: an `eagor.lab.agents.steering.Searcher` over the views of `eagor.lab.tasks.hstar.search`.

    Every turn of the camera costs one of the episode's turns, whatever its angle.
    """

    def __init__(self, episode: Episode, eye: Eye, rules: SearchRules) -> None:
        self._eye = eye
        self.searcher = Searcher(Search.begin(episode.kind, rules), commit_threshold=rules.sure)

    def __call__(self, view: View, last: bool) -> Turn:
        look = self._eye(view)
        search = self.searcher.space = self.searcher.space.seen(look.evidence, look.world_R_capture, view)
        answer = search.answer()
        to = self.searcher.face(view.heading, answer.probability)
        action = _submit(answer) if last or to is None else _rotate(view, View.facing(to))
        return Turn(action, answer, _peak(look) | {"sure": to is None})


class VlmAgent:
    """Asks a `Chat`. Until it submits, its answer is the camera's direction."""

    def __init__(self, episode: Episode, chat: Chat, form: str, window: int, resolution: int) -> None:
        self._talk, self._chat = Talk(episode, form, window, resolution), chat

    def __call__(self, view: View, last: bool) -> Turn:
        self._talk.look(view)
        messages = self._talk.messages()
        said = self._chat(messages)
        reply = self._talk.hear(said.text)
        action = reply.action
        notes: dict[str, Any] = {
            "raw": said.text,
            "prompt": digest(messages),
            "format": reply.format_correct,
            "valid": action is not None,
            "pixels": list(messages[-1].images[0].shape[:2]),
        }
        if said.prompt_tokens is not None:
            notes["tokens"] = [said.prompt_tokens, said.completion_tokens]
        if action is not None and action.kind == "submit":
            return Turn(action, Answer(action.yaw, action.pitch, math.nan), notes)
        return Turn(action, Answer(round(view.yaw) % 360, round(view.pitch), math.nan), notes)


def blind(yaw: float, pitch: float, probability: float = math.nan) -> Agent:
    """Submits one direction immediately."""
    answer = Answer(round(yaw) % 360, round(pitch), probability)
    return lambda view, last: Turn(_submit(answer), answer)


class SweepAgent:
    """Looks along `SWEEP`, passes each look to `read`, and submits after `views` looks or when `read` says so."""

    def __init__(self, episode: Episode, eye: Eye, read: Reading, views: int = len(SWEEP)) -> None:
        self._eye, self._read, self._start = eye, read, episode.start
        self._views, self._turn = min(views, len(SWEEP)), 0

    def __call__(self, view: View, last: bool) -> Turn:
        look = self._eye(view)
        direction, content = self._read(look)
        yaw, pitch = hstar_from_direction(direction)
        answer = Answer(round(float(yaw)) % 360, round(float(pitch)), math.nan)
        self._turn += 1
        if last or content or self._turn >= self._views:
            return Turn(_submit(answer), answer, _peak(look))
        to = View((self._start + SWEEP[self._turn][0]) % 360, SWEEP[self._turn][1])
        return Turn(_rotate(view, to), answer, _peak(look))


class BestView:
    """The strongest single response of all views so far; without any, the middle of the first view."""

    def __init__(self) -> None:
        self._best, self._direction = -1.0, np.zeros(3)

    def __call__(self, look: ViewEvidence) -> tuple[np.ndarray, bool]:
        direction, height = peak_of(look)
        if height > self._best + 1e-6:
            self._best, self._direction = height, direction
        return self._direction, False


class PerView:
    """A per-frame baseline; it stops at the first view that responds."""

    def __init__(self, baseline: DirectionFilter) -> None:
        self._baseline = baseline

    def __call__(self, look: ViewEvidence) -> tuple[np.ndarray, bool]:
        if peak_of(look)[1] >= RESPONDS:
            return look.world_R_capture @ self._baseline.update(_without_floor(look)).direction(), True
        return look.world_R_capture @ np.asarray(look.evidence.grid.directions[_middle(look)]), False


class OnGrid:
    """A Bayes filter on a grid of directions, fixed in the world."""

    def __init__(self) -> None:
        self._filter: HistogramFilter | None = None

    def __call__(self, look: ViewEvidence) -> tuple[np.ndarray, bool]:
        calibration = look.evidence.calibration
        start = self._filter or HistogramFilter(calibration=calibration, mixing=1e-4)
        turned = HistogramFilter(
            start.log_map, look.world_R_capture.T, calibration, diffusion=start.diffusion, mixing=start.mixing
        )
        self._filter = turned.update(look.evidence)
        return look.world_R_capture @ self._filter.direction(), False


_READINGS: dict[str, Callable[[], Reading]] = {
    "sweep": BestView,
    "grid": OnGrid,
    "centroid": lambda: PerView(Centroid()),
    "cent-circ": lambda: PerView(CircularCentroid()),
    "single": lambda: lambda look: (peak_of(look)[0], True),
}


def make_agent(name: str, episode: Episode, eye: Eye | None, rules: SearchRules, views: int, seed: int) -> Agent:
    """The agent with this name for one episode, for agents that ask no model; those in `LOOKING` need an eye."""
    if eye is not None:
        if name == "eagor":
            return EagorAgent(episode, eye, rules)
        return SweepAgent(episode, eye, _READINGS[name](), views)
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
    found: dict[str, Any] = {
        "peak": {"yaw": round(float(yaw), 1), "pitch": round(float(pitch), 1), "score": round(height, 3)}
    }
    source = look.evidence.source
    return found | ({"source": dict(source)} if source else {})


def _looked_at(look: ViewEvidence) -> np.ndarray:
    seen = look.evidence.seen
    if seen is None or not seen[-1]:
        return np.ones(look.evidence.grid.shape, dtype=bool)
    return looked_at(seen)


def _response(look: ViewEvidence) -> np.ndarray:
    """The response ``(H, W)``, -1 in cells that were not looked at."""
    return np.where(_looked_at(look), to_numpy(look.evidence.response).astype(np.float64), -1.0)


def _middle(look: ViewEvidence) -> tuple[int, int]:
    """The middle cell of the part that was looked at."""
    rows, columns = np.nonzero(_looked_at(look))
    nearest = int(np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2))
    return int(rows[nearest]), int(columns[nearest])


def _without_floor(look: ViewEvidence) -> Evidence:
    """The evidence minus its lowest response; otherwise per-view means would be biased towards the middle."""
    response = _response(look)
    floor = float(response[response >= 0].min())
    cleared = np.where(response < max(0.5 * response.max(), floor + 1e-6), 0.0, response)
    return Evidence.from_response(np.clip(cleared, 0, 1), look.evidence.grid, look.evidence.calibration)


def work(settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that plays each episode of a run with these settings; the perception is made once."""
    agent = settings["agent"]
    perception = open_perception(settings["perception"]) if agent in LOOKING else None
    chat = shared_chat(settings["model"]) if agent == "vlm" else None
    rules, read = SearchRules.of(settings), recalibrator(settings)

    def do(payload: Mapping[str, Any]) -> dict[str, Any]:
        episode, eye = Episode.from_json(payload["episode"]), None
        if perception is not None:
            eye = open_eye(perception, episode, settings["seed"], settings["resolution"], read)
        if chat is not None:
            player: Agent = VlmAgent(episode, chat, settings["form"], settings["window"], settings["resolution"])
        else:
            player = make_agent(agent, episode, eye, rules, settings["views"], settings["seed"])
        return play(episode, player, settings["scoring"], settings["turns"], payload.get("siblings", ()))

    return do


def play(
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
    record = judged(episode, answer, way, siblings, steps)
    by_turn = [int(step["would"][way]) for step in steps]
    return record | {
        "scoring": way,
        "by_turn": by_turn + [int(record["score"])] * (turns - len(steps)),
        "views": len(steps),
        "stated": steps[-1]["would"]["p"] if answer is not None else None,
        "sure": bool(steps[-1].get("sure", False)) and answer is not None,
        "steps": steps,
    }


def judged(
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
