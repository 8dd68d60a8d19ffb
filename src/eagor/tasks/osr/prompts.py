"""The prompts of the `vlm` agent.

The questions are the data's own. The published runner puts a sentence before a question without a map, and instructions
for the form of the answer after it: "vanilla" (brief) or "think" (reasoning and answer between tags). Ours are worded
differently but ask for the same: the same tags, the same eight directions, an integer, a name, or "the exact error
message if applicable" without saying which messages there are.
"""

from __future__ import annotations

import numpy as np

from eagor.perception.vlm.talk import IMAGE, Message

FORMS = ("vanilla", "think")

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


def plain_text(question: str, form: str) -> str:
    """The prompt for a question without a map."""
    return f"{_BEFORE} {next_text(question, form)}"


def next_text(question: str, form: str) -> str:
    """The prompt for a question after the map was asked for and given."""
    return f"{question} {_AFTER[form]}"


def with_picture(text: str, image: np.ndarray) -> list[Message]:
    """The conversation that shows the panorama with one prompt."""
    return [Message("user", f"{text}\n{IMAGE}", (image,))]
