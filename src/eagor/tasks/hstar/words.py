"""The target in a task's words, and what makes it hard, known before any run."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from eagor.queries import singular

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
