"""The prompts for the model, in the three published forms of replies, and the part of the conversation that it sees.

Everything that the protocol defines is verbatim: names of the actions and their arguments, tags, order of a turn's
parts, "Human Instruction:", and the environment's feedback. The explanations and the worked example are in our own
words (a kettle instead of a coffee machine, the same three actions with the same angles). Figures of models that were
tuned on the published wording can therefore differ a little: report that with them.
"""

from __future__ import annotations

import numpy as np

from eagor.lab.tasks.hstar.data import Episode, open_panorama
from eagor.lab.tasks.hstar.rules import (
    Reply,
    View,
    parse_action,
    render_view,
)
from eagor.perception.vlm import IMAGE, Message

WINDOW = 5  # turns of conversation that the published runner keeps; its paper finds that two suffice

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


class Talk:
    """The conversation about one episode, turn by turn: `look`, send the `messages`, `hear` the reply."""

    def __init__(self, episode: Episode, form: str, window: int, resolution: int) -> None:
        self.episode, self.form, self.window, self.resolution = episode, form, window, resolution
        self._shown: list[tuple[View, str]] = []  # for each turn the view, and the text with it
        self._pictures: dict[int, np.ndarray] = {}
        self._said: list[str] = []
        self._last: Reply | None = None

    def look(self, view: View) -> None:
        """Begin a turn at this view."""
        task = self.episode.task
        text = first_text(task, self.form) if self._last is None else next_text(task, self.form, self._last, view)
        self._shown.append((view, text))

    def hear(self, said: str) -> Reply:
        """The parsed reply to the `messages`."""
        self._said.append(said)
        self._last = parse_action(said, self.form)
        return self._last

    def messages(self) -> list[Message]:
        """The system message and the last `window` turns, including the current one."""
        found = [Message("system", system_text(self.episode.kind, self.form))]
        for turn in range(max(0, len(self._shown) - self.window), len(self._shown)):
            view, text = self._shown[turn]
            if turn not in self._pictures:
                self._pictures[turn] = self.picture(view)
            found.append(Message("user", text, (self._pictures[turn],)))
            found += [Message("assistant", said) for said in self._said[turn : turn + 1]]
        return found

    def picture(self, view: View) -> np.ndarray:
        """The picture ``(rows, columns, 3)`` of a view for the model."""
        return render_view(open_panorama(self.episode.panorama), view.yaw, view.pitch, self.resolution)


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
    return f"{_GOAL[kind]}\n{_ACTIONS}\n\n" + "\n".join(lines) + f"\n{_form_text(form)}\ne.g. {shortest}"


def first_text(task: str, form: str) -> str:
    """The text with the first view."""
    return f"[initial observation]:\n{_instruction(task, form)}"


def next_text(task: str, form: str, reply: Reply, view: View) -> str:
    """The text with a later view: the action as understood, its outcome, and the camera's direction now."""
    valid, said = "[]", "Last action is not executed successfully."
    if reply.action is not None:
        valid, said = f"[{reply.actions[0]!r}]", succeeded(f"({view.yaw:g},{view.pitch:g})")
    return (
        f"After your answer, the extracted valid action is {valid}.\nThe environment feedback is: {said}\ndone: False\n"
        f"After that, the observation is:\n{_instruction(task, form)}"
    )


def succeeded(pose: str) -> str:
    """The environment's feedback after a successful turn."""
    return f"Last action executed successfully, your current direction (yaw,pitch) is {pose}"


def _instruction(task: str, form: str) -> str:
    return f"{IMAGE}\nHuman Instruction: {task}\nDecide your next action.\n{_form_text(form)}"


def _form_text(form: str) -> str:
    """The required form of replies, which ends every turn."""
    rules = f"You can take 1 action(s) at a time.\n{_MANNER[form]}"
    return f"{rules}\nYour response should be in the format of:\n{_FORMAT[form]}"


def _reply(thought: str, action: str, form: str) -> str:
    answer = f"<answer>{action}</answer>"
    if form == "no_think":
        return answer
    if form == "grounding":
        seen, _, reason = thought.partition(". ")
        thought = f"<observation>{seen.rstrip('.')}.</observation><reasoning>{reason or 'So this is it.'}</reasoning>"
    return f"<think>{thought}</think>{answer}"
