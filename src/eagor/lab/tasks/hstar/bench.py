"""H*Bench for `eagor bench`: its files, an episode and its record, the causes of failures, the two tasks.

The layout is ``<anything>/<scene>/annotation.json`` beside the scene's panorama, as in the unpacked archives: the first
``*.png`` by name, otherwise the first ``*.jpg``. As in the published environment, ``.PNG`` and ``.jpeg`` are other
endings, whose scenes are skipped (`read_data` names them). An entry with ``pitch`` is an object to find (HOS), one
without is a path to take (HPS). There is one episode per entry and start.
"""

from __future__ import annotations

import math
import random
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta, field

from eagor._checks import shown
from eagor.conventions import direction_from_hstar
from eagor.errors import FormatError
from eagor.lab.tasks import hstar, published
from eagor.lab.tasks.hstar.agents import AGENTS, LOOKING, RESPONDS, Agent, HStarConfig, make_agent, open_detector
from eagor.lab.tasks.published import PublishedTask, Recalibrate, score_metric
from eagor.lab.tasks.task import Metric, Payload, Record, Sample
from eagor.perception.truth import Noise
from eagor.sphere import angular_distance

ANNOTATION = "annotation.json"
STARTS = (0, 90, 180, 270)  # degrees of yaw, for entries without any
SHUFFLE = 42  # the published environment shuffles its episodes with this seed
FAULT = (
    'is no list of targets, each with a task such as "Find the red chair", yaw and pitch as two angles of at most 3600 '
    "degrees, initial yaw as a list of such, level as 0, 1, 2, ..."
)
Level = Annotated[int, Meta(ge=0)] | None


class Entry(hstar.Box, kw_only=True):
    """One target in annotation.json: its task, its box, the yaws to begin at, and the level of each or of all."""

    task: str
    starts: list[Annotated[float, Meta(ge=-3600, le=3600)]] | None = field(name="initial yaw", default=None)
    level: list[Level] | Level = None


def read_data(data: Path) -> tuple[list[hstar.Episode], list[str]]:
    """All episodes in `data`, by scene, and the folders with annotations but no such picture, skipped as published.

    A scene is named by its folder alone if that is unique. Raises `FormatError` if there is none, or one is malformed.
    """
    folders = sorted(path.parent for path in data.rglob(ANNOTATION))
    pictures = {folder: sorted(folder.glob("*.png")) or sorted(folder.glob("*.jpg")) for folder in folders}
    skipped = [str(folder) for folder in folders if not pictures[folder]]
    if len(skipped) == len(folders):
        raise FormatError(
            f"{data} holds no scene of H*Bench, {ANNOTATION} beside a .png or .jpg (lower case). Give the folder of "
            f"the unpacked archive{f'; {skipped[0]} has {ANNOTATION}, but no such picture' if skipped else ''}"
        )
    folders = [folder for folder in folders if pictures[folder]]
    count = Counter(folder.name for folder in folders)
    named = {f.name if count[f.name] == 1 else f.relative_to(data).as_posix(): f for f in folders}
    episodes = []
    for scene, folder in sorted(named.items()):
        entries = published.read_json(folder / ANNOTATION, list[Entry], FAULT)
        episodes += _episodes(scene, str(pictures[folder][0]), entries)
    return episodes, skipped


def read_episodes(data: Path, kind: hstar.Kind) -> list[hstar.Episode]:
    """The episodes of one kind, in the published order: by folder, then shuffled with the seed 42.

    Raises `FormatError` if there is none of this kind, or the data is not H*Bench's.
    """
    episodes = [episode for episode in read_data(data)[0] if episode.kind == kind]
    if not episodes:
        wanted = "with pitch (objects)" if kind == "hos" else "without pitch (paths)"
        raise FormatError(f"{data} has no annotation {wanted}: it is not {kind.upper()} data")
    random.Random(SHUFFLE).shuffle(episodes)
    return episodes


def _episodes(scene: str, panorama: str, entries: list[Entry]) -> Iterator[hstar.Episode]:
    items = [{"task": e.task, "yaw": [*e.yaw]} | ({"pitch": [*e.pitch]} if e.pitch else {}) for e in entries]
    for index, entry in enumerate(entries):
        kind: hstar.Kind = "hos" if entry.pitch is not None else "hps"
        starts = STARTS if entry.starts is None else entry.starts
        levels = entry.level if isinstance(entry.level, list) else [entry.level] * len(starts)
        cluster, others, names = f"{scene}/{index}", items[:index] + items[index + 1 :], Counter[str]()
        for start, level in zip(starts, levels, strict=False):  # the shorter of the two lists decides, as published
            name = f"{cluster}/{start:g}"
            names[name] += 1
            name += f"-{names[name]}" if names[name] > 1 else ""
            if level is None and kind == "hos":  # half of the box is in the first view, some of it, none
                share = hstar.View(start, 0.0).share(items[index])
                level = 0 if share >= 0.5 else 1 if share > 0 else 2
            title = dict(enumerate(hstar.LEVELS[kind])).get(-1 if level is None else level, "unknown")
            yield hstar.Episode(name, cluster, scene, kind, items[index], others, start, title, panorama)


FINE = 4.0  # degrees: a box smaller than this in both directions is fine detail
COMMON = frozenset(hstar.TEXTS["nouns"])  # things that any detector knows well: of homes, offices, shops and streets
_TEXT = (
    r"""["“”«»]|(?<!\w)'[^']+'|\b(?:sign|says?|saying|labell?ed|logo|number|letters?|word|text|reading|written|named|"""
    r"""called|brand)\b|\d"""
)


def tag_of(item: Mapping[str, Any], others: Sequence[Mapping[str, Any]] = ()) -> str:
    """The tag of a target; `others` are the scene's other entries. The paper names the tags; the rules are ours.

    ``ocr_fine``: the words quote or name text, numbers or a brand (a capital inside the words), or the box is tiny.
    ``multi_instance``: another entry of the scene has the same noun. ``rare``: the noun is not among `COMMON`.
    """
    task, yaw, pitch = str(item["task"]), item["yaw"], item.get("pitch")
    phrase, head = published.phrase_of(task), published.head_of(task)
    branded = phrase.isupper() or any(word[:1].isupper() for word in phrase.split())
    tiny = pitch is not None and (yaw[1] - yaw[0]) % 360.0 < FINE and pitch[1] - pitch[0] < FINE
    if re.search(_TEXT, published.thing_of(task).lower()) or branded or tiny:
        return "ocr_fine"
    if any(published.head_of(str(other["task"])) == head for other in others):
        return "multi_instance"
    return "plain" if head in COMMON else "rare"


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


class Submission(msgspec.Struct):
    """A direction in a prediction, degrees."""

    yaw: Annotated[float, Meta(ge=-hstar.FARTHEST_ANSWER, le=hstar.FARTHEST_ANSWER)]
    pitch: Annotated[float, Meta(ge=-hstar.FARTHEST_ANSWER, le=hstar.FARTHEST_ANSWER)] = 0.0


class HStar(PublishedTask):
    """One half of H*Bench; see `eagor.lab.tasks.task.Task`."""

    Config = HStarConfig
    agents, causes, looking = AGENTS, CAUSES, LOOKING
    truth: ClassVar = "the annotations through noise, for studies"

    def __init__(self, kind: hstar.Kind, title: str, what: str) -> None:
        self.kind: hstar.Kind = kind
        self.title, self.what, self.name = title, what, f"hstar-{kind}"
        levels = hstar.LEVELS[kind]
        self.metrics: tuple[Metric, ...] = (
            score_metric("overall", "Overall", "success of all episodes"),
            *(
                score_metric(name, name.capitalize(), f"success of episodes of level {name}", of=name)
                for name in levels
            ),
            score_metric("official", "Official", "success by the published rule", by="official"),
            score_metric("strict", "Strict", "success with the pitch always counted", by="strict"),
            Metric("views", "Views", "number of views", lambda r: r.get("views"), "", "low", 1.0, 2),
        )

    def info(self, data: Path) -> dict[str, Any]:
        episodes, skipped = read_data(Path(data))
        kinds = {kind: [episode for episode in episodes if episode.kind == kind] for kind in hstar.LEVELS}
        return {
            "scenes": len({episode.scene for episode in episodes}),
            "targets": len({episode.cluster for episode in episodes}),
            "episodes": {kind: len(found) for kind, found in kinds.items()},
            "levels": {kind: Counter(each.level for each in found) for kind, found in kinds.items() if found},
            "skipped": skipped,
        }

    def samples(self, config: HStarConfig) -> list[Sample]:
        episodes = read_episodes(Path(config.data), self.kind)
        return [Sample(episode.id, episode.scene, msgspec.to_builtins(episode)) for episode in episodes]

    def open_perception(self, config: HStarConfig) -> Any:
        name, _, text = str(config.perception).partition(":")
        return Noise.parse(text) if name == "truth" else super().open_perception(config)

    def player(self, config: HStarConfig, perception: Any, chat: Any, read: Recalibrate) -> Callable[[Payload], Record]:
        def play(payload: Payload) -> Record:
            episode, detector = msgspec.convert(payload, hstar.Episode), None
            if perception is not None:
                detector = open_detector(perception, episode, config.seed, config.resolution, read)
            return run_episode(episode, make_agent(config, episode, detector, chat), config.scoring, config.turns)

        return play

    def score(self, sample: Sample, prediction: Mapping[str, Any], config: HStarConfig) -> Record:
        if "yaw" in prediction:
            try:
                given = msgspec.convert(prediction, Submission)
            except msgspec.ValidationError as error:
                raise FormatError(f"{shown(prediction)}: wanted yaw and pitch in degrees ({error})") from None
            action = hstar.Action("submit", round(given.yaw), round(given.pitch))
        else:
            text = published.words_of(prediction, ("text",), "yaw and pitch, or text, the model's last reply")
            action = hstar.parse_action(text).action
        episode, steps = msgspec.convert(sample.payload, hstar.Episode), [{"shown": 1.0, "valid": action is not None}]
        return record_of(episode, config.scoring, action, steps)


HOS = HStar("hos", "H*Bench: object search (HOS)", "look around in a photograph for a thing, and name its direction")
HPS = HStar("hps", "H*Bench: path search (HPS)", "look around in a photograph for the way to go, and name it")


def run_episode(
    episode: hstar.Episode, agent: Agent, scoring: hstar.Scoring = "official", turns: int = hstar.MAX_TURNS
) -> Record:
    """The record of one episode, with the common keys of `eagor.lab.tasks.published.PublishedRecord`.

    `scoring` decides "score" and "by_turn" ("scores" has both); `turns`: views at most. Each step has "turn", "view",
    "shown" (visible fraction of the target), "action", "would" (its answer now), and the agent's notes.
    """
    item, view, action = episode.item, hstar.View(float(episode.start), 0.0), None
    steps: list[dict[str, Any]] = []
    while len(steps) < turns and (action is None or action.kind != "submit"):
        action, (yaw, pitch, p), notes = agent(view, len(steps) + 1 == turns)
        succeeds = {each: hstar.submit_succeeds(item, yaw, pitch, each) for each in hstar.SCORINGS}
        steps.append(
            {
                "turn": len(steps) + 1,
                "view": {"yaw": view.yaw, "pitch": view.pitch},
                "shown": round(view.share(item), 3),
                "action": None if action is None else str(action),
                "would": {"yaw": yaw, "pitch": pitch, **succeeds, "p": None if math.isnan(p) else round(p, 4)},
                **notes,
            }
        )
        view = view.after(action)
    record = record_of(episode, scoring, action, steps)
    answered, by_turn = record["answer"] is not None, [int(step["would"][scoring]) for step in steps]
    return record | {
        "scoring": scoring,
        "by_turn": by_turn + [int(record["score"])] * (turns - len(steps)),
        "views": len(steps),
        "stated": steps[-1]["would"]["p"] if answered else None,
        "sure": answered and bool(steps[-1].get("sure", False)),
        "steps": steps,
    }


def record_of(
    episode: hstar.Episode, scoring: hstar.Scoring, last: hstar.Action | None, steps: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The part of a record about the `last` action, with the errors in degrees; None: it could not be read."""
    item, pitch = episode.item, episode.item.get("pitch")
    reason = "format" if any(step.get("valid") is False for step in steps) else "budget"
    scores, cause, answer = dict.fromkeys(hstar.SCORINGS, 0.0), reason, None
    errors: dict[str, float | None] = {"yaw_error": None, "pitch_error": None, "error": None}
    if last is not None and last.kind == "submit":
        reason, at, middle = "submitted", (last.yaw, last.pitch), hstar.middle_of(item)
        answer = {"yaw": last.yaw, "pitch": last.pitch}
        scores = {way: float(hstar.submit_succeeds(item, *at, way)) for way in hstar.SCORINGS}
        cause = None if scores[scoring] else cause_of(item, steps, at, episode.others, scoring)
        turn, lift = abs((at[0] - middle[0] + 180.0) % 360.0 - 180.0), abs(at[1] - middle[1])
        errors = {"yaw_error": round(turn, 2), "pitch_error": None if pitch is None else round(lift, 2)}
        errors["error"] = round(_apart(at, middle), 2)
    return {
        "case": episode.id,
        "cluster": episode.cluster,
        "level": episode.level,
        "tags": [tag_of(item, episode.others)],
        "words": item["task"],
        "start": episode.start,
        "target": {"yaw": item["yaw"], "pitch": pitch},
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
    at: tuple[float, float],
    others: Sequence[Mapping[str, Any]],
    scoring: hstar.Scoring,
) -> str:
    """Why an answer `at` (yaw, pitch) failed, one of `CAUSES`; `others`: the rest of its scene; `steps`: recorded."""
    same = [other for other in others if published.head_of(other["task"]) == published.head_of(item["task"])]
    if any(hstar.submit_succeeds(other, *at, "strict") for other in same):
        return "wrong_instance"
    if any((step.get("would") or {}).get(scoring) for step in steps):
        return "stopped_wrongly"
    if all(step["shown"] == 0 for step in steps):
        return "never_in_view"
    peaks = [step["peak"] for step in steps if "peak" in step]
    loud = [(peak["yaw"], peak["pitch"]) for peak in peaks if peak["score"] >= RESPONDS]
    if any(hstar.submit_succeeds(item, *peak, "strict") for peak in loud):
        return "fusion_error"
    return "false_detection" if not peaks or any(_apart(peak, at) <= NEAR for peak in loud) else "missed"


def _apart(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Degrees between two directions (yaw, pitch) on the great circle."""
    ends = direction_from_hstar(*np.array([a, b], dtype=np.float64).T)
    return float(np.degrees(angular_distance(ends[0], ends[1])))
