"""The words of a task, and the prompts for the model in the three published forms of replies.

Everything that the protocol defines is verbatim: names of the actions and their arguments, tags, order of a turn's
parts, "Human Instruction:", and the environment's feedback. The explanations and the worked example are in our own
words (a kettle instead of a coffee machine, the same three actions with the same angles). Figures of models that were
tuned on the published wording can therefore differ a little: report that with them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from eagor.lab.tasks.hstar.rules import Reply, View
from eagor.perception.vlm import IMAGE
from eagor.queries import singular

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
    valid, feedback = "[]", "Last action is not executed successfully."
    if reply.action is not None:
        valid, feedback = f"[{reply.actions[0]!r}]", succeeded(f"({view.yaw:g},{view.pitch:g})")
    return (
        f"After your answer, the extracted valid action is {valid}.\nThe environment feedback is: {feedback}\n"
        f"done: False\nAfter that, the observation is:\n{_instruction(task, form)}"
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


# --- the words of a task ----------------------------------------------------------------------------------------------

FINE = 4.0  # degrees: a box smaller than this in both directions is fine detail
# Things that any detector knows well: everyday nouns of homes, offices, shops and streets.
COMMON = frozenset(
    """
    air conditioner airplane apple armchair backpack bag ball banana barrel basin basket bathtub bed bench bicycle
    bike bin bird blanket blender blind board boat book bookcase bookshelf bottle bowl box bread broom bucket
    building bus cabinet cake camera candle car carpet cart cat ceiling chair chandelier clock closet coat coffee
    computer cone cooker couch counter cup cupboard curtain cushion desk dishwasher dog door drawer dress dresser
    dryer elevator entrance escalator exit extinguisher fan faucet fence fireplace flag floor flower fork fountain
    frame fridge glass guitar handbag hat headphones heater helmet house jacket jar kettle keyboard kitchen knife
    ladder lamp laptop lid light locker luggage machine magazine man mat mattress microwave mirror monitor
    motorcycle mouse mug newspaper nightstand notebook ottoman oven painting pan paper pen person phone photo piano
    picture pillar pillow pipe plant plate platform pool pot poster printer projector radiator railing refrigerator
    road robot rug scooter screen sculpture seat shampoo shelf ship shirt shoe shop shower sign sink skateboard sky
    sofa speaker spoon staircase stair stand statue stool stove street suitcase sunglasses switch table tablet tap
    teapot telephone television tent tie tile toilet towel toy train trash tray tree truck tub tv umbrella urinal
    vacuum van vase vehicle wall wallet wardrobe washer watch water whiteboard window wine woman
    """.split()  # noqa: SIM905
)
_VERBS = r"(?:please\s+)?(?:find|locate|look for|search for|go to|navigate to|get to|move to|reach|walk to|show me)\s+"
_ARTICLES = r"^(?:the|a|an|some|any|your|my|one of the|way to the|path to the|way to|path to)\s+"
_BREAKS = re.compile(
    r"\s+(?:of|on|in|at|by|with|near|next|under|above|behind|below|beside|between|from|that|which|whose|to|for|along|"
    r"inside|outside|against|across|around|where|labell?ed|named|called|saying|showing|reading)\s+|[,;(]"
)
_TEXT = re.compile(
    r"""["“”«»]|(?<!\w)'[^']+'|\b(?:sign|says?|saying|labell?ed|logo|number|letters?|word|text|reading|written|named|"""
    r"""called|brand)\b|\d"""
)


def thing_of(task: str) -> str:
    """The target of a task such as "Find the red chair by the door.": "red chair by the door"."""
    text = " ".join(task.split()).rstrip(".!? ")
    text = re.sub(f"^{_VERBS}", "", text, flags=re.IGNORECASE)
    text = re.sub(_ARTICLES, "", text, flags=re.IGNORECASE)
    return text or task


def phrase_of(task: str) -> str:
    """The target without its surroundings: "red chair"."""
    return _BREAKS.split(thing_of(task), maxsplit=1)[0].strip() or thing_of(task)


def head_of(task: str) -> str:
    """The noun of the target, singular and lower case: "chair"."""
    words = re.findall(r"[a-z][a-z-]*", phrase_of(task).lower())
    return singular(words[-1]) if words else thing_of(task).lower()


def tag_of(item: Mapping[str, Any], others: Sequence[Mapping[str, Any]] = ()) -> str:
    """The tag of a target; `others` are the scene's other entries. The paper names the tags; the rules are ours.

    ``ocr_fine``: the words quote or name text, numbers or a brand (a capital inside the words), or the box is tiny.
    ``multi_instance``: another entry of the scene has the same noun. ``rare``: the noun is not among `COMMON`.
    """
    task = str(item["task"])
    phrase = phrase_of(task)
    branded = any(word[:1].isupper() for word in phrase.split()) and not phrase.isupper()
    yaw, pitch = item["yaw"], item.get("pitch")
    tiny = pitch is not None and (yaw[1] - yaw[0]) % 360.0 < FINE and pitch[1] - pitch[0] < FINE
    if _TEXT.search(thing_of(task).lower()) or branded or phrase.isupper() or tiny:
        return "ocr_fine"
    head = head_of(task)
    if any(head_of(str(other["task"])) == head for other in others):
        return "multi_instance"
    return "plain" if head in COMMON or singular(head) in COMMON else "rare"
