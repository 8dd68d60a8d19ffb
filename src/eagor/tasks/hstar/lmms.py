"""H*Bench as a task of lmms-eval (`output_type: generate_until_agentic`): its files, and the functions that they call.

lmms-eval shows its model one text and some pictures at a time. So every turn repeats the visible conversation: the
system message, then the last turns, whose pictures come first and are named in the text. Nothing is stored between
calls; the camera's direction follows from the replies so far.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._json import number, parsed
from eagor.perception.vlm import IMAGE
from eagor.tasks.hstar.camera import RESOLUTION
from eagor.tasks.hstar.data import LEVELS, Episode, Kind, read_episodes
from eagor.tasks.hstar.prompts import WINDOW, Talk
from eagor.tasks.hstar.rules import FORMS, MAX_TURNS, Action, submit_succeeds
from eagor.tasks.published import write_task

Doc = Mapping[str, Any]


def write(kind: Kind, settings: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the task ``eagor_hstar_<kind>`` into `folder` (`eagor.tasks.published`); returns the files.

    The episodes hold the paths of their panoramas on this machine.
    """
    levels = list(LEVELS[kind])
    kept = {key: settings[key] for key in ("turns", "window", "form", "resolution", "scoring") if key in settings}
    documents = (
        # The episode is stored as text: a table of nested lists needs the same types in all rows.
        {"id": episode.id, "task": episode.task, "level": episode.level_name, "levels": levels, **kept}
        | {"episode": json.dumps(episode.as_json())}
        for episode in read_episodes(Path(settings["data"]), kind)
    )
    metrics = ["success", *(f"success_{level}" for level in levels)]
    return write_task(folder, f"eagor_hstar_{kind}", __name__, documents, metrics, _turns(settings))


def doc_to_visual(doc: Doc) -> list[Any]:
    """The first view, as a PIL image in a list."""
    return _flat(_talked(doc, ())[0])[0]


def doc_to_text(
    doc: Doc,
    lmms_eval_specific_kwargs: Any = None,
    previous_output: Any = None,
    round_idx: int | None = None,
    previous_round_info: Any = None,
    **_: Any,
) -> Any:
    """The first text; after a reply, (pictures, next text, whether it is over, outputs, state).

    At the end the last output is JSON: {"submit": [yaw, pitch] or null, "turns", "replies", "success"}.
    """
    if not round_idx or not previous_output:
        return _flat(_talked(doc, ())[0])[1]
    replies = [previous_output] if isinstance(previous_output, str) else [str(reply) for reply in previous_output]
    talk, actions = _talked(doc, replies)
    state = {"state": {"turns": len(replies)}, "invalid_steps": actions.count(None)}
    last = actions[-1]
    submitted = (last.yaw, last.pitch) if last is not None and last.kind == "submit" else None
    if submitted or len(replies) >= _turns(doc):
        good = bool(submitted and submit_succeeds(talk.episode.item, *submitted, _scoring(doc)))
        outcome = {"submit": submitted, "turns": len(replies), "replies": list(replies), "success": good}
        return [], None, True, [*replies[:-1], json.dumps(outcome)], state
    pictures, text = _flat(talk)
    return pictures, text, False, replies, state


def doc_to_target(doc: Doc) -> str:
    """The target's box as JSON, for human readers of the samples."""
    episode = _episode(doc)
    return json.dumps({"yaw": episode.yaw, "pitch": episode.pitch})


def process_results(doc: Doc, results: Sequence[str]) -> dict[str, Any]:
    """Success of one episode, overall and for its level: 0 or 1. Aggregate with `mean`, which skips other levels."""
    episode = _episode(doc)
    try:
        yaw, pitch = map(number, parsed(results[0])["submit"])
    except (ValueError, TypeError, LookupError):  # nothing was submitted, or it is a model's text and not our JSON
        good = 0.0
    else:
        good = float(submit_succeeds(episode.item, yaw, pitch, _scoring(doc)))
    return {"success": good} | {
        f"success_{level}": good if level == episode.level_name else None for level in doc["levels"]
    }


def mean(values: Sequence[float | None]) -> float:
    """The mean of all values except None, in per cent; 0 without any."""
    there = [value for value in values if value is not None]
    return 100 * sum(there) / len(there) if there else 0.0


def _episode(doc: Doc) -> Episode:
    return Episode.from_json(json.loads(doc["episode"]))


def _turns(settings: Mapping[str, Any]) -> int:
    return int(settings.get("turns", MAX_TURNS))


def _scoring(doc: Doc) -> str:
    return str(doc.get("scoring", "official"))


def _talked(doc: Doc, replies: Sequence[str]) -> tuple[Talk, list[Action | None]]:
    """The conversation at the turn after `replies`, and the action of each."""
    window, resolution = int(doc.get("window", WINDOW)), int(doc.get("resolution", RESOLUTION))
    talk, actions = Talk(_episode(doc), str(doc.get("form", FORMS[0])), window, resolution), []
    view = talk.episode.first_view
    talk.look(view)
    for reply in replies:
        actions.append(talk.hear(reply).action)
        view = view.after(actions[-1])
        talk.look(view)
    return talk, actions


def _flat(talk: Talk) -> tuple[list[Any], str]:
    """The pictures of a conversation, and its whole text, which names them."""
    from PIL import Image

    parts: list[str] = []
    pictures: list[Any] = []
    for message in talk.messages():
        pictures += [Image.fromarray(image) for image in message.images]
        text = message.text.replace(IMAGE, f"(picture {len(pictures)})", 1) if message.images else message.text
        parts.append(f"Your answer was:\n{text}" if message.role == "assistant" else text)
    return pictures, "\n\n".join(parts)
