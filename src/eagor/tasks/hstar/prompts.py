"""What the model is told, in the three published forms of replies, and how much of the conversation it is shown.

What the protocol dictates is kept to the letter: the names of the actions and their arguments, the tags, the order of
a turn's parts, "Human Instruction:", what the environment says about an action. The explanations around them and
the worked example are in our own words (a kettle instead of a coffee machine, the same three actions in the same
angles), so figures of models that were tuned on the published wording can differ a little: say so beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eagor.tasks.chat import IMAGE, Message
from eagor.tasks.hstar.rules import Action

WINDOW = 5  # turns of conversation that the published runner keeps; its paper finds two to be enough

_FORMAT = {
    "free_think": "<think>...</think><answer>...</answer>",
    "no_think": "<answer>...</answer>",
    "grounding": "<think><observation>...</observation><reasoning>...</reasoning></think><answer>...</answer>",
}
_MANNER = {
    "free_think": "Think first, then give your answer.",
    "no_think": "Give nothing but your answer.",
    "grounding": "Describe what you see in detail, reason about it, then give your answer.",
}
_GOAL = {
    "hos": (
        "You are a robot that looks for an object. Turn the camera until the object that the instruction names is in "
        "the middle of the picture, then submit. A green cross marks the middle of the picture."
    ),
    "hps": (
        "You are a robot that is about to walk. Turn the camera until its middle points in the direction in which you "
        "have to walk to get where the instruction says, then submit. A green cross marks the middle of the picture. "
        "Do not choose a direction in which you cannot walk, such as into an obstacle or a gap."
    ),
}
_ACTIONS = """Your actions are rotate(yaw:int,pitch:int) and submit(yaw:int,pitch:int).
rotate(yaw:int,pitch:int): turn the camera by these angles (degrees) from where it looks now. Yaw > 0 turns right, \
yaw < 0 turns left. Pitch > 0 looks up, pitch < 0 looks down.
submit(yaw:int,pitch:int): end the task with this direction, in absolute angles; the environment tells you the angles \
of the current view.
One action at a time. The instruction comes with every picture."""
_EXAMPLE = (
    ("A worktop begins on my left. A kettle would stand there, so I turn left.", "rotate(-45,0)"),
    ("The kettle is on the worktop, a little further left and lower than the cross.", "rotate(-30,-5)"),
    ("The kettle is in the middle of the picture now.", "submit(285,-5)"),
)
_POSES = ("(315,0)", "(285,-5)")


@dataclass(frozen=True, eq=False)
class Exchange:
    """A turn that is over: what was shown and said, what the model replied."""

    user: Message
    reply: str


def system_text(kind: str, form: str) -> str:
    """The system message for ``hos`` or ``hps`` and a form of replies."""
    lines = ["Example:"]
    for index, (thought, action) in enumerate(_EXAMPLE):
        lines.append(f"Round {index + 1}:")
        if index:
            lines.append(f"Env_feedback: {succeeded(_POSES[index - 1])}.")
        lines += [f"image_{index + 1}", _reply(thought, action, form)]
    lines += ["Round 4:", "Env_feedback: Success"]
    shortest = _reply(*_EXAMPLE[0], form)
    return f"{_GOAL[kind]}\n{_ACTIONS}\n\n" + "\n".join(lines) + f"\n{form_text(form)}\ne.g. {shortest}"


def form_text(form: str) -> str:
    """How replies have to look; stands at the end of every turn."""
    rules = f"You can take 1 action(s) at a time.\n{_MANNER[form]}"
    return f"{rules}\nYour response should be in the format of:\n{_FORMAT[form]}"


def first_text(task: str, form: str) -> str:
    """What is said with the first view."""
    return f"[initial observation]:\n{IMAGE}\nHuman Instruction: {task}\nDecide your next action.\n{form_text(form)}"


def next_text(task: str, form: str, action: Action | None, text: str, yaw: float, pitch: float) -> str:
    """What is said with a later view: what was understood, what came of it, where the camera looks now.

    `action` is the one that was carried out (None: none was), `text` how it stood in the reply.
    """
    valid = f"[{text!r}]" if action is not None else "[]"
    said = succeeded(f"({yaw:g},{pitch:g})") if action is not None else "Last action is not executed successfully."
    return (
        f"After your answer, the extracted valid action is {valid}.\nThe environment feedback is: {said}\ndone: False\n"
        f"After that, the observation is:\n{IMAGE}\nHuman Instruction: {task}\nDecide your next action.\n"
        f"{form_text(form)}"
    )


def succeeded(pose: str) -> str:
    """The environment's words after a turn."""
    return f"Last action executed successfully, your current direction (yaw,pitch) is {pose}"


def conversation(
    system: str, past: Sequence[Exchange], text: str, image: np.ndarray, window: int = WINDOW
) -> list[Message]:
    """The system message and the last `window` turns, the present one included."""
    messages = [Message("system", system)]
    for exchange in past[max(0, len(past) - (window - 1)) :] if window > 1 else ():
        messages += [exchange.user, Message("assistant", exchange.reply)]
    return [*messages, Message("user", text, (image,))]


def _reply(thought: str, action: str, form: str) -> str:
    answer = f"<answer>{action}</answer>"
    if form == "no_think":
        return answer
    if form == "grounding":
        seen, _, reason = thought.partition(". ")
        thought = f"<observation>{seen.rstrip('.')}.</observation><reasoning>{reason or 'So this is it.'}</reasoning>"
    return f"<think>{thought}</think>{answer}"
