"""EAGLE-360: "locate X" in one panorama; the answer is an azimuth and an elevation, after at most six projections.

Xu and others, EAGLE-360: Embodied Active Global-to-Local Exploration in 360 degrees, arXiv 2607.02479, 2026. Angles are
degrees, and azimuth is positive to the RIGHT, as there. Success is an answer within half of the box's diagonal. The
tags, the tool's name, its arguments and the order of turns are the published ones; explanations are in our words.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from eagor.grids import PerspectiveGrid
from eagor.lab.tasks import published
from eagor.lab.tasks.published import TALKING, PublishedConfig, PublishedTask, Recalibrate, score_metric
from eagor.lab.tasks.task import Metric, Payload, Record, Sample
from eagor.perception.partial import infer_view
from eagor.perception.vlm import IMAGE, Message
from eagor.sources.panorama import read_panorama, resized, view
from eagor.sphere import angular_distance, azimuth_elevation, direction, world_R_body
from eagor.tracking import DirectionTracker

PROJECTIONS = 6
NO_ANSWER = 180.0  # degrees that a missing answer counts as
UNKNOWN_BOX = 30.0  # degrees: the diagonal where the metadata name no box
WIDEST, NARROWEST = 100.0, 20.0  # degrees of a projection
PIXELS = 512  # of the published projection
ROWS = 1024  # of the panorama that a model is shown
FACES = ("front", "right", "back", "left", "top", "bottom")
TOOL = "rotate_and_project_panorama"

Angles = tuple[float | None, float | None]
Step = dict[str, Any]  # a look: its "view" (azimuth, elevation, field of view; or the whole), "answer", "raw" reply

AGENTS = {
    "eagor": "one belief: the whole panorama first, then projections where it is, narrower each time",
    "global": "one look at the whole panorama",
    TALKING: "the model alone, with the published tool",
    "oracle": "knows the answer",
}
CAUSES = {"no_answer": "no azimuth and elevation could be read", "elsewhere": "not within half of the box's diagonal"}


def parse_answer(text: str, strict: bool = False) -> Angles:
    """Azimuth and elevation in a model's answer, None for what is not there; `strict`: only between answer tags."""
    tagged = re.search(r"<answer>(.*?)</answer>", text, re.DOTALL | re.IGNORECASE)
    if strict and not tagged:
        return None, None
    body = tagged[1] if tagged else text
    return _angle(body, "azimuth", 180.0), _angle(body, "elevation", 90.0)


def _angle(text: str, name: str, most: float) -> float | None:
    """The first number after `name`, if it is an angle; else the first after a dash and `name`."""
    for lead in ("", r"-\s*"):
        found = re.search(rf"{lead}{name}[:=\s]+(-?\d+(?:\.\d*)?)", text, re.IGNORECASE)
        if found and abs(float(found[1])) <= most:
            return float(found[1])
    return None


def parse_call(text: str) -> dict[str, float] | None:
    """The arguments of the tool call in a model's reply: azimuth, elevation, fov_degrees; None without a valid one."""
    found = re.search(r"<tool_call>\s*(\{.*?\})\s*</tool_call>", text, re.DOTALL)
    try:
        call: Any = json.loads(found[1]) if found else None
        arguments = call.get("arguments", call)
        defaults = {"azimuth": 0, "elevation": 0, "fov_degrees": WIDEST}
        return {name: float(arguments.get(name, value)) for name, value in defaults.items()}
    except (AttributeError, TypeError, ValueError):
        return None


def question_of(item: Mapping[str, Any]) -> str | None:
    """The question of an item of the data; None if it has none."""
    turns = [turn.get("value", "") for turn in item.get("conversations", ()) if turn.get("from") == "human"]
    text = item.get("question") or next(iter(turns), None)
    return None if text is None else text.replace("<panoramic_image>", "").strip()


def score(metadata: Mapping[str, Any], azimuth: float | None, elevation: float | None) -> dict[str, Any]:
    """The great-circle "distance" of an answer, whether it is "in_bfov", and the "face" of the cube that it is on."""
    true = metadata["azimuth_degrees"], metadata["elevation_degrees"]
    face = ("front", "right", "back", "left")[math.floor((true[0] + 45) % 360 / 90)]
    if abs(true[1]) >= 45:
        face = "top" if true[1] > 0 else "bottom"
    if azimuth is None or elevation is None:
        return {"distance": NO_ANSWER, "in_bfov": False, "face": face}
    ends = [direction(-math.radians(a), math.radians(e)) for a, e in (true, (azimuth, elevation))]
    off = math.degrees(float(angular_distance(*ends)))
    sides = metadata.get("bbox_width_degrees", 0.0), metadata.get("bbox_height_degrees", 0.0)
    diagonal = metadata.get("bbox_diagonal_degrees") or (math.hypot(*sides) if any(sides) else UNKNOWN_BOX)
    return {"distance": off, "in_bfov": off <= diagonal / 2, "face": face}


class Metadata(msgspec.Struct, omit_defaults=True):
    """Where the thing is."""

    azimuth_degrees: Annotated[float, Meta(ge=-180, le=180)]
    elevation_degrees: Annotated[float, Meta(ge=-90, le=90)]
    bbox_width_degrees: float = 0.0
    bbox_height_degrees: float = 0.0
    bbox_diagonal_degrees: float | None = None


class Item(msgspec.Struct, omit_defaults=True):
    """One question."""

    panoramic_image: str
    metadata: Metadata
    question: str | None = None
    conversations: list[dict[str, Any]] = []


def read_samples(data: str) -> list[Sample]:
    """The questions in ``test.json`` below `data`; pictures are there or in ``images``. Raises `FormatError`."""
    items = published.read_json(Path(data) / "test.json", list[Item], "is not EAGLE-360's list of questions")
    found = []
    for number, item in enumerate(items):
        parts = item.panoramic_image.strip("/").split("/")  # absolute ones are of another machine
        places = [Path(data, *parts), Path(data, parts[-1]), Path(data, "images", parts[-1])]
        picture = next((place for place in places if place.is_file()), places[-1])
        case, plain = f"{picture.stem}/{number}", msgspec.to_builtins(item)
        payload = {"case": case, "picture": str(picture), "question": question_of(plain), "metadata": plain["metadata"]}
        if payload["question"]:  # the official evaluator skips an item without one
            found.append(Sample(case, picture.stem, payload))
    return found


def grid_of(azimuth: float, elevation: float, fov: float) -> PerspectiveGrid:
    """The published projection, in the frame of a body that faces the panorama's middle."""
    turn = world_R_body(-math.radians(azimuth), -math.radians(elevation))
    return PerspectiveGrid(PIXELS, PIXELS, math.radians(min(max(fov, 1.0), 170.0)), turn)


def explore(perception: Any, image: np.ndarray, question: str, looks: int, read: Recalibrate) -> Iterator[Step]:
    """Global first, then local: at the belief's best place that was not looked at so closely yet."""
    tracker, views, seen = DirectionTracker(), list[tuple[np.ndarray, float]](), {}
    words = re.sub(r"\b(in|within|from) (this|the) (panorama|panoramic|image|picture|scene)\b.*", "", question)
    query, evidence = published.first_known(words, lambda query: perception(image, query, stamp=0.0))
    for number in range(looks + 1):
        stamp = 1e-3 * number  # the camera stands still
        tracker.add_pose(stamp, np.eye(3))
        if views:
            seen = {"view": [*_angles(views[-1][0]), views[-1][1]]}
            grid = grid_of(*seen["view"])
            evidence = infer_view(perception, view(image, grid), grid, query, stamp=stamp)
        tracker.observe(read(evidence))
        estimate = tracker.estimate(stamp)
        best = estimate.direction if estimate.direction is not None else np.array([1.0, 0.0, 0.0])
        yield {"answer": _angles(best), **seen}
        width = math.degrees(4 * float(estimate.credible_angle))  # of a view: what is believed, with room about it
        for place in [mode.direction for mode in estimate.modes] or [best]:
            # Half of each field of view in whose middle half the place was.
            half = [fov / 2 for other, fov in views if math.degrees(float(angular_distance(place, other))) < fov / 4]
            if (fov := min(WIDEST, max(width, NARROWEST), *half)) >= NARROWEST:
                views.append((place, fov))
                break
        else:
            return


def _angles(where: np.ndarray) -> tuple[float, float]:
    azimuth, elevation = azimuth_elevation(where)
    return round(-math.degrees(float(azimuth)), 2), round(math.degrees(float(elevation)), 2)


SYSTEM = f"""You look for a thing in a panorama that shows 360 degrees around a camera.

<tools>
[{{"type": "function", "function": {{"name": "{TOOL}", "description": "Shows an ordinary view of the panorama. Use it \
again and again, nearer to the thing and with a smaller field of view each time.", "parameters": {{"type": "object", \
"properties": {{"azimuth": {{"type": "number", "description": "degrees, -180 to 180; 0 is ahead, positive is right"}}, \
"elevation": {{"type": "number", "description": "degrees, -90 to 90; positive is up"}}, "fov_degrees": {{"type": \
"number", "description": "field of view in degrees, by default 100"}}}}, "required": ["azimuth", "elevation"]}}}}}}]
</tools>

To look, reply with <think>...</think> <tool_call>{{"name": "{TOOL}", "arguments": {{...}}}}</tool_call> and nothing
after it. To answer, reply with <think>...</think> <answer>The object is located at:
- Azimuth: X°
- Elevation: Y°</answer>. Never do both in one reply, and never look twice in the same way.
You have at most {PROJECTIONS} looks; then you have to answer."""


def converse(chat: Any, image: np.ndarray, question: str, looks: int) -> Iterator[Step]:
    """The model alone. Of earlier views only the latest is shown again."""
    whole = resized(image, (ROWS, 2 * ROWS), wrap=True) if image.shape[0] > ROWS else image
    messages = [Message("system", SYSTEM), Message("user", f"{IMAGE}\n{question}", (whole,))]
    for turn in range(looks + 1):
        text = chat(messages).text
        yield {"answer": parse_answer(text, strict=True), "raw": text}
        call = parse_call(text)
        if ("<answer>" in text and "</answer>" in text) or call is None or turn == looks:
            return
        azimuth, elevation, fov = call.values()
        last = "This was your last look: answer now." if turn + 1 == looks else "Look again, or answer."
        picture = view(image, grid_of(azimuth, elevation, fov))
        earlier = [Message(m.role, m.text.replace(IMAGE, "<project_image>")) for m in messages[2:]]
        messages = [*messages[:2], *earlier, Message("assistant", text)]
        messages.append(Message("user", f"{IMAGE}\nTurn {turn + 1} of {looks}. {last}", (picture,)))


class Config(PublishedConfig, kw_only=True):
    """The settings of a run of EAGLE-360."""

    projections: Annotated[int, Meta(ge=0, le=6, description="looks closer, at most; six are official")] = PROJECTIONS


class Eagle360(PublishedTask):
    """EAGLE-360; see `eagor.lab.tasks.task.Task`."""

    name, title = "eagle360", "EAGLE-360"
    what = "name the direction of a thing in a panorama, looking closer at most six times"
    agents, causes, looking = AGENTS, CAUSES, ("eagor", "global")
    Config = Config
    metrics = (
        score_metric("overall", "bFOV", "answers within half of the box's diagonal"),
        *(score_metric(face, face.capitalize(), f"the same of things {face}", of=face) for face in FACES),
        score_metric("within_50", "Within 50°", "answers within 50 degrees", lambda r: float(r["error"] < 50)),
        score_metric("answered", "Answered", "with an answer", lambda r: float(r["answer"] is not None)),
        Metric("distance", "Distance", "from the truth; none counts as 180", lambda r: r["error"], "°", "low", 1.0),
        Metric("views", "Looks", "closer looks", lambda r: r["views"], "", "low", 1.0, 2),
    )

    def info(self, data: Path) -> dict[str, Any]:
        payloads = [sample.payload for sample in read_samples(str(data))]
        pictures = {Path(payload["picture"]) for payload in payloads}
        faces = Counter(score(payload["metadata"], None, None)["face"] for payload in payloads)
        missing = sum(not picture.is_file() for picture in pictures)
        return {"questions": len(payloads), "pictures": len(pictures), "missing": missing, "faces": dict(faces)}

    def samples(self, config: Config) -> list[Sample]:
        return read_samples(config.data)

    def player(self, config: Config, perception: Any, chat: Any, read: Recalibrate) -> Callable[[Payload], Record]:
        def play(payload: Payload) -> Record:
            metadata, question = payload["metadata"], payload["question"]
            if config.agent == "oracle":
                return record_of(payload, [{"answer": (metadata["azimuth_degrees"], metadata["elevation_degrees"])}])
            image, looks = read_panorama(payload["picture"]), config.projections if config.agent != "global" else 0
            talks, looking = (chat, image, question, looks), (perception, image, question, looks, read)
            return record_of(payload, list(converse(*talks) if chat is not None else explore(*looking)))

        return play

    def score(self, sample: Sample, prediction: Mapping[str, Any], config: Config) -> Record:
        if {"azimuth", "elevation"} <= prediction.keys():
            text = "<answer>azimuth {azimuth} elevation {elevation}</answer>".format(**prediction)
        else:
            text = published.words_of(prediction, ("text",), "azimuth and elevation, or text")
        return record_of(sample.payload, [{"answer": parse_answer(text, strict=True), "raw": text}])


def record_of(payload: Payload, steps: Sequence[Step]) -> dict[str, Any]:
    """The record of an episode: as published, the last answer that can be read counts."""
    azimuth, elevation = next(
        (step["answer"] for step in reversed(steps) if step["answer"][0] is not None), (None, None)
    )
    found = score(payload["metadata"], azimuth, elevation)
    answer = {"azimuth": azimuth, "elevation": elevation} if None not in (azimuth, elevation) else None
    return {
        "case": payload["case"],
        "cluster": Path(payload["picture"]).stem,
        "level": found["face"],
        "question": payload["question"],
        "score": float(found["in_bfov"]),
        "cause": None if found["in_bfov"] else "elsewhere" if answer else "no_answer",
        "error": round(found["distance"], 3),
        "answer": answer,
        "views": len(steps) - 1,
        "steps": steps,
    }


EAGLE360 = Eagle360()
