"""H*Bench as a task of lmms-eval: what the exported task files call (`output_type: generate_until_agentic`).

lmms-eval shows its model one text and some pictures at a time, so every turn carries the whole conversation that the
model may see: the system message, then the last turns, whose pictures come first and are named in the text. Nothing is
remembered between calls; where the camera looks follows from the replies so far.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from eagor._json import number, parsed
from eagor.tasks.chat import IMAGE
from eagor.tasks.hstar.camera import RESOLUTION, View, render_view
from eagor.tasks.hstar.data import Episode
from eagor.tasks.hstar.files import open_panorama
from eagor.tasks.hstar.prompts import WINDOW, first_text, next_text, system_text
from eagor.tasks.hstar.rules import MAX_TURNS, Action, parse_action, submit_succeeds, turned

Doc = Mapping[str, Any]


def doc_to_visual(doc: Doc) -> list[Any]:
    """The first view, as a PIL image in a list."""
    return [_picture(doc, _start(doc))]


def doc_to_text(
    doc: Doc,
    lmms_eval_specific_kwargs: Any = None,
    previous_output: Any = None,
    round_idx: int | None = None,
    previous_round_info: Any = None,
    **_: Any,
) -> Any:
    """The first text; or, after a reply, (pictures, next text, whether it is over, outputs, state).

    When it is over the last output is JSON: {"submit": [yaw, pitch] or null, "turns", "replies", "success"}.
    """
    if not round_idx or not previous_output:
        return _conversation(doc, [])[1]
    replies = [previous_output] if isinstance(previous_output, str) else [str(reply) for reply in previous_output]
    turns = _replayed(doc, replies)
    last = turns[-1][2]
    state = {"state": {"turns": len(turns)}, "invalid_steps": sum(action is None for _, _, action in turns)}
    over = (last is not None and last.kind == "submit") or len(turns) >= int(doc.get("turns", MAX_TURNS))
    if over:
        return [], None, True, [*replies[:-1], json.dumps(_outcome(doc, replies))], state
    pictures, text = _conversation(doc, replies)
    return pictures, text, False, replies, state


def doc_to_target(doc: Doc) -> str:
    """The target's box as JSON, for people who read the samples."""
    episode = _episode(doc)
    return json.dumps({"yaw": episode.yaw, "pitch": episode.pitch})


def process_results(doc: Doc, results: Sequence[str]) -> dict[str, Any]:
    """Success of one episode, overall and for its level: 0 or 1. Aggregate with `mean`, which skips other levels."""
    episode = _episode(doc)
    try:
        yaw, pitch = map(number, parsed(results[0])["submit"])
        submitted = yaw, pitch
    except (ValueError, TypeError, LookupError):  # nothing was submitted, or it is not our JSON but a model's words
        submitted = None
    way = str(doc.get("scoring", "official"))
    good = float(submitted is not None and submit_succeeds(episode.item, *submitted, way))
    return {"success": good} | {
        f"success_{level}": good if level == episode.level_name else None for level in doc["levels"]
    }


def mean(values: Sequence[float | None]) -> float:
    """The mean of those that are not None, in per cent; 0 where there are none."""
    there = [value for value in values if value is not None]
    return 100 * sum(there) / len(there) if there else 0.0


def _episode(doc: Doc) -> Episode:
    return Episode.from_json(json.loads(doc["episode"]))


def _start(doc: Doc) -> View:
    return View(float(_episode(doc).start), 0.0)


def _picture(doc: Doc, view: View) -> Any:
    from PIL import Image

    resolution = int(doc.get("resolution", RESOLUTION))
    return Image.fromarray(render_view(open_panorama(_episode(doc).panorama), view.yaw, view.pitch, resolution))


def _replayed(doc: Doc, replies: Sequence[str]) -> list[tuple[View, str, Action | None]]:
    """For each reply: where the camera looked, the action's text, and the action."""
    view, found = _start(doc), []
    for reply in replies:
        parsed = parse_action(reply, str(doc.get("form", "free_think")))
        action = parsed.action
        found.append((view, parsed.actions[0] if parsed.actions else "", action))
        if action is not None and action.kind == "rotate":
            view = View(*map(float, turned(view.yaw, view.pitch, action)))
    return found


def _conversation(doc: Doc, replies: Sequence[str]) -> tuple[list[Any], str]:
    """The pictures and the text of the turn after `replies`."""
    episode, form = _episode(doc), str(doc.get("form", "free_think"))
    turns = _replayed(doc, replies)
    view = _start(doc)
    users = [(view, first_text(episode.task, form))]
    for before, text, action in turns:
        view = before
        if action is not None and action.kind == "rotate":
            view = View(*map(float, turned(before.yaw, before.pitch, action)))
        users.append((view, next_text(episode.task, form, action, text, view.yaw, view.pitch)))
    first = max(0, len(users) - int(doc.get("window", WINDOW)))
    parts, pictures = [system_text(episode.kind, form)], []
    for index in range(first, len(users)):
        seen, text = users[index]
        pictures.append(_picture(doc, seen))
        parts.append(text.replace(IMAGE, f"(picture {len(pictures)})", 1))
        if index < len(replies):
            parts.append(f"Your answer was:\n{replies[index]}")
    return pictures, "\n\n".join(parts)


def _outcome(doc: Doc, replies: Sequence[str]) -> dict[str, Any]:
    episode = _episode(doc)
    action = _replayed(doc, replies)[-1][2]
    submitted = [action.yaw, action.pitch] if action is not None and action.kind == "submit" else None
    way = str(doc.get("scoring", "official"))
    good = bool(submitted and submit_succeeds(episode.item, submitted[0], submitted[1], way))
    return {"submit": submitted, "turns": len(replies), "replies": list(replies), "success": good}
