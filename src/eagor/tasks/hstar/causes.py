"""Why an episode failed, told from its record and the annotations: one cause each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eagor.conventions import direction_from_hstar
from eagor.sphere import angular_distance
from eagor.tasks.hstar.agents import RESPONDS
from eagor.tasks.hstar.rules import Scoring, window_of
from eagor.tasks.hstar.words import head_of

# In the order in which they are asked; the first that fits is the cause.
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


def cause_of(
    item: Mapping[str, Any],
    steps: Sequence[Mapping[str, Any]],
    answer: Mapping[str, Any] | None,
    others: Sequence[Mapping[str, Any]],
    scoring: Scoring,
) -> str:
    """The cause of a failure.

    Args:
        item: the target, as an entry of annotation.json.
        steps: of the record, see `eagor.tasks.hstar.play`.
        answer: the submission, with yaw and pitch in degrees; None if there was none.
        others: the scene's other entries.
        scoring: what counts as success.
    """
    if answer is None:
        return "format" if any(step.get("valid") is False for step in steps) else "budget"
    same = [other for other in others if head_of(str(other["task"])) == head_of(str(item["task"]))]
    if any(window_of(other).contains(answer["yaw"], answer["pitch"], "strict") for other in same):
        return "wrong_instance"
    if any((step.get("would") or {}).get(scoring) for step in steps):
        return "stopped_wrongly"
    if all(step["shown"] == 0 for step in steps):
        return "never_in_view"
    peaks = [step["peak"] for step in steps if "peak" in step]
    if not peaks:
        return "false_detection"
    window = window_of(item)
    loud = [peak for peak in peaks if peak["score"] >= RESPONDS]
    if any(window.contains(peak["yaw"], peak["pitch"], "strict") for peak in loud):
        return "fusion_error"
    return "false_detection" if any(_near(peak, answer) for peak in loud) else "missed"


def _near(peak: Mapping[str, Any], answer: Mapping[str, Any], degrees: float = 25.0) -> bool:
    yaws, pitches = (np.array([peak[key], answer[key]], dtype=np.float64) for key in ("yaw", "pitch"))
    ends = direction_from_hstar(yaws, pitches)
    return float(np.degrees(angular_distance(ends[0], ends[1]))) <= degrees
