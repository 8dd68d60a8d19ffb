"""OSR-Bench for `eagor bench`: its agents, the record of an answer, and the task.

The questions are the data's own. The published runner puts a sentence before a question without a map, and instructions
for the form of the answer after it: "vanilla" (brief) or "think" (reasoning and answer between tags). Ours are worded
differently but ask for the same: the same tags, the same eight directions, an integer, a name, or "the exact error
message if applicable" without saying which messages there are.
"""

from __future__ import annotations

import math
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from msgspec import Meta

from eagor.errors import FormatError, QueryError
from eagor.lab.tasks import osr, published
from eagor.lab.tasks.osr import Question, Scene, geometry, questions_of
from eagor.lab.tasks.published import TALKING, PublishedConfig, PublishedTask, Recalibrate, score_metric
from eagor.lab.tasks.task import Payload, Record, Sample
from eagor.perception import Perception
from eagor.perception.vlm import IMAGE, Chat, Message
from eagor.sources.panorama import read_panorama

TITLES = {osr.COUNTING: "Counting", osr.DISTANCE: "Distance", osr.DIRECTION: "Direction", osr.MAP: "Map"}
AGENTS = {
    "eagor": "bearings from a belief, ranges from floor contacts",
    TALKING: "asks the model, with the map or without it (--set suffix=...)",
    "oracle": "knows the label (the official one, if both are asked for)",
}

_BEFORE = "Answer this question about the PANORAMA, using where the centers of its objects are:"
_DIRECTIONS = "front, back, left, right, front-left, front-right, back-left or back-right"
_RULES = (
    "- how many: one integer, 0 if there are none;\n"
    "- which is the closest: the name of that object alone, or the exact error message if one applies;\n"
    f"- in which direction: one of {_DIRECTIONS}, or the exact error message if one applies."
)
_AFTER = {
    "vanilla": f"Keep the answer brief, without explanation or any other text. It is for questions that ask\n{_RULES}",
    "think": (
        "Think step by step and put all of your reasoning between <think> and </think>. To count, find the objects one "
        "by one; for the closest, find the object and every candidate and compare the distances; for a direction, "
        "locate all objects that are named and work out how they lie to each other. Then give the final answer, and "
        f"nothing else, between <answer> and </answer>. It is for questions that ask\n{_RULES}"
    ),
}


class OsrConfig(PublishedConfig, kw_only=True):
    """The settings of a run of OSR-Bench."""

    labels: Annotated[
        Literal["official", "corrected", "both"],
        Meta(description="left and right as published (mirrored), as they are in the room, or both side by side"),
    ] = "official"
    suffix: Annotated[osr.Suffix, Meta(description="which of the published files")] = "qa_without_cogmap"
    prompt: Annotated[
        Literal["vanilla", "think"],
        Meta(description="what the model is asked for: an answer, or its reasoning first"),
    ] = "vanilla"


class Reply(NamedTuple):
    """An answer for scoring, and notes for the record."""

    text: str
    notes: Mapping[str, Any] = {}


Agent = Callable[[Scene, Question], Reply]  # raises if there is no reply: that is not a wrong answer


class Vlm:
    """Asks a model as the benchmark's runner does; if the scene asks for a map, after the model has drawn it."""

    def __init__(self, chat: Chat, form: str = "vanilla") -> None:
        self._chat, self._form = chat, form
        self._ask = lru_cache(maxsize=1)(self._asked)  # the map of a scene is asked for once

    def __call__(self, scene: Scene, question: Question) -> Reply:
        mapped, text = scene.map_question, f"{question.text} {_AFTER[self._form]}"
        request, reply = self._ask(scene, f"{_BEFORE} {text}" if mapped is None else mapped.text)
        if mapped is None or question.skill == osr.MAP:
            return Reply(reply)
        messages = [request, Message("assistant", reply), Message("user", text)]
        return Reply(self._chat(messages).text, {"map": reply})

    def _asked(self, scene: Scene, text: str) -> tuple[Message, str]:
        request = Message("user", f"{text}\n{IMAGE}", (read_panorama(scene.image),))
        return request, self._chat([request]).text


class Eagor:
    """Answers from the places on the floor of what `look` sees, as they are.

    `negative`: whether questions may ask about absent things; only then does it answer with errors.
    """

    def __init__(self, look: Callable[[Scene], geometry.SceneLayout], negative: bool = False) -> None:
        self.around, self._negative = lru_cache(maxsize=1)(look), negative  # looked at once, for all questions

    def __call__(self, scene: Scene, question: Question) -> Reply:
        around, skill, names = self.around(scene), question.skill, question.names
        places = around.places
        if skill == osr.MAP:
            wanted = names or scene.categories
            return Reply(osr.map_text(geometry.layout_from({name: places[name] for name in wanted if name in places})))
        if not names:
            return Reply(_guess(question), {"problem": "the question was not understood"})
        notes, first, others = around.notes(names), places.get(names[0], []), names[1:]
        if skill == osr.COUNTING:
            return Reply(str(len(first)), notes)
        there = [name for name in others if name in places]
        enough = there if skill == osr.DISTANCE else len(there) == len(others)  # one of the choices; O and Q
        if self._negative and not (len(first) == 1 and enough):
            missing = osr.NO_OBJECT if skill == osr.DIRECTION else osr.NO_CANDIDATE
            return Reply(osr.NOT_UNIQUE if len(first) > 1 else missing if first else osr.NO_POSITION, notes)
        if not (first and enough):
            notes["problem"] = "not seen: " + ", ".join(name for name in names if name not in places)
            return Reply(_guess(question), notes)
        start = first[0]  # of several the likeliest
        if skill == osr.DIRECTION:
            found = geometry.direction_between(start, *(places[name] for name in others))
            return Reply(found or _guess(question), notes)
        return Reply(min(there, key=lambda name: math.dist(start, geometry.nearest(start, places[name]))), notes)


def _guess(question: Question) -> str:
    """An answer about things that were not seen: ahead, on either side; the first choice; none."""
    if question.skill == osr.DIRECTION:
        return ("Front Left", "Front Right")[zlib.crc32(question.id.encode()) % 2]
    return question.names[1] if question.skill == osr.DISTANCE and len(question.names) > 1 else "0"


def seen_layout(perception: Perception, read: Recalibrate, scene: Scene) -> geometry.SceneLayout:
    """What a perception sees of a scene; `read`: recalibrates looks."""
    panorama, things, unknown = read_panorama(scene.image), list[geometry.Detection](), []
    for name in scene.categories:
        try:
            things += geometry.detections_in(read(perception(panorama, name.replace("_", " "), stamp=0.0)), name)
        except QueryError:
            unknown.append(name)
    return geometry.SceneLayout(geometry.place(things), unknown)


def record_of(scene: Scene, question: Question, reply: Reply, config: OsrConfig) -> dict[str, Any]:
    """The record of a reply."""
    skill, think = question.skill, config.prompt == "think"
    wanted = ("official", "corrected") if config.labels == "both" else (config.labels,)
    truths = {labels: question.truth(labels) for labels in wanted}
    values = [osr.score(skill, truth, reply.text, think) for truth in truths.values()]
    scores, truth, cause = dict(zip(wanted, values, strict=True)), truths[wanted[0]], None
    if values[0] < 1:
        guessed = "range guessed" if reply.notes.get("guessed") else "wrong"
        formal = osr.mistake(truth, reply.text, think) if skill == osr.DIRECTION else None
        cause = "missed" if reply.notes.get("problem") else formal or guessed
    record: dict[str, Any] = {
        "case": question.id,
        "cluster": scene.id,
        "score": values[0],
        "scores": scores,
        "skill": skill,
        "level": TITLES[skill],
        "question": question.text,
        "tags": osr.tags(scene.layout, question.names, question.answer) if skill == osr.DIRECTION else [],
        "answer": reply.text,
        "cause": cause,
    }
    if skill == osr.MAP:
        found = osr.score_map(truth, reply.text)
        record["map_range"] = {"least": values[0], "most": found.pop("most")}
        record["map"] = found | {"truth": truth}
    else:
        record["truth"] = truth
    return record | ({"steps": [reply.notes]} if reply.notes else {})


def _most(record: Record) -> float | None:
    return record.get("map_range", {}).get("most")


class OsrBench(PublishedTask):
    """OSR-Bench; see `eagor.lab.tasks.task.Task`."""

    name, title = "osr", "OSR-Bench"
    what = "questions about what stands where around a camera"
    Config = OsrConfig
    agents, looking = AGENTS, ("eagor",)
    metrics = (
        score_metric("overall", "Overall", "mean over the kinds of questions", over=lambda r: r["level"]),
        score_metric("direction", "Direction", "relative direction, by the labels of the run", of="Direction"),
        score_metric("direction_official", "official", "by the published labels", of="Direction", by="official"),
        score_metric(
            "direction_corrected", "corrected", "with left and right put right", of="Direction", by="corrected"
        ),
        score_metric("direction_clear", "clear", "both products above one squared cell", of="clear"),
        score_metric("direction_border", "border", "a product of at most one squared cell", of="near a border"),
        score_metric("distance", "Distance", "which is the closest", of="Distance"),
        score_metric("counting", "Counting", "how many, with the partial credit of the benchmark", of="Counting"),
        score_metric("map", "Map F1", "the map: the least that the published code gives", of="Map"),
        score_metric("map_most", "at most", "the most it gives: it depends on PYTHONHASHSEED", _most),
    )

    def info(self, data: Path) -> dict[str, Any]:
        files = {}
        for suffix in osr.SUFFIXES:
            with suppress(FormatError):
                scenes = osr.load(Path(data), suffix)
                questions = [question for scene in scenes for question in scene.questions]
                files[suffix] = {
                    "scenes": len(scenes),
                    "pictures_missing": sum(not scene.image.is_file() for scene in scenes),
                    "questions": Counter(question.skill for question in questions),
                    "empty_labels_skipped": sum(scene.skipped for scene in scenes),
                    "direction_labels": Counter(each.answer for each in questions if each.skill == osr.DIRECTION),
                }
        if not files:
            osr.load(Path(data))  # raises with the reason
        return {"files": files}

    def samples(self, config: OsrConfig) -> list[Sample]:
        found = questions_of(config.data, config.suffix)
        return [Sample(id, scene.id, {"question": id}) for id, (scene, _) in found.items()]

    def player(self, config: OsrConfig, perception: Any, chat: Any, read: Recalibrate) -> Callable[[Payload], Record]:
        labels = "corrected" if config.labels == "corrected" else "official"

        def oracle(scene: Scene, question: Question) -> Reply:
            truth = question.truth(labels)
            return Reply(osr.map_text(osr.layout_of(truth)) if question.skill == osr.MAP else str(truth))

        agents: dict[str, Agent] = {"oracle": oracle, TALKING: Vlm(chat, config.prompt)}
        agent = agents.get(config.agent) or Eagor(partial(seen_layout, perception, read), "negative" in config.suffix)

        def play(payload: Payload) -> Record:
            scene, question = questions_of(config.data, config.suffix)[payload["question"]]
            return record_of(scene, question, agent(scene, question), config)

        return play

    def score(self, sample: Sample, prediction: Mapping[str, Any], config: OsrConfig) -> Record:
        answer = published.words_of(prediction, ("text", "answer", "model_answer"), '"text": words')
        return record_of(*questions_of(config.data, config.suffix)[sample.id], Reply(answer), config)


OSR = OsrBench()
